"""What the residuals of a model say against it, in sentences."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from hident.arrays import Array
from hident.errors import EstimationError
from hident.numerics.parts import Parts, whole
from hident.numerics.residuals import (
    Correlations,
    Drift,
    Innovations,
    Normality,
    Tested,
    count_of_lags,
    dependence,
    drift,
    lag_stride,
    nonlinear_functions,
    normality,
    offset,
    uneven_spread,
    whiteness,
)
from hident.numerics.rounding import is_constant

LEVEL = 0.01
"""The chance with which each test blames a model that is right."""
# Residuals this small, relative to how the output varies, are those of a computer.
_VANISHING = 1e-10


def judgement(
    u: Array,
    y: Array,
    y_hat: Array,
    experiments: Parts | None = None,
    *,
    by: Literal["simulation", "prediction"] = "simulation",
    level: float = LEVEL,
    fitted: int = 0,
    scale: float = 0.0,
) -> Residuals:
    """What the residuals of a model say of it.

    Parameters
    ----------
    u, y, y_hat : arrays, shape (N,)
        The input, the measured output and the model's, without the samples in which the model settles.
    experiments : sequence of slices, optional
        Where each experiment stands; one by default.
    by : {"simulation", "prediction"}
        How ``y_hat`` was made, from the input alone or from past outputs too: what colour of the residuals
        means depends on it.
    level : float
        The chance with which each test blames a model that is right.
    fitted : int
        The number of parameters of the noise model, if there is one.
    scale : float
        How far the output is from its mean elsewhere, if these are samples in which it may stand still.

    Raises
    ------
    EstimationError
        If there are fewer than 40 residuals, or fewer than 20 in the longest experiment, or some are not
        finite.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> u, e = rng.normal(size=(2, 1000))
    >>> found = judgement(u, u + 0.5 * u**2 + e, u)
    >>> found.sound, found.nonlinear_input["u^2"].test.p_value < 1e-6
    (False, True)
    >>> print(found.sentences[2])
    The residuals depend on u^2 (at lag 0 the correlation 0.55, band ±0.08; p < 0.001) beyond what depends \
linearly on u: the static nonlinearity, its place among the blocks or its memory is not the model's.
    """
    e = np.asarray(y, dtype=float) - np.asarray(y_hat, dtype=float)
    if wrong := len(e) - np.count_nonzero(np.isfinite(e)):
        raise EstimationError(f"{wrong} of {len(e)} residuals are not finite")
    parts = whole(len(e)) if experiments is None else experiments
    count_of_lags(parts)
    u, y_hat = np.asarray(u, dtype=float), np.asarray(y_hat, dtype=float)
    return Residuals(u, e, y_hat, parts, by, level, fitted, scale)


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals ``e`` (N,) and what they are held against: each test is made when it is asked for.

    ``u`` and ``y_hat`` (N,) are the input and the model's output, the others as :func:`judgement` takes them.
    """

    u: Array
    e: Array
    y_hat: Array
    experiments: Parts
    by: Literal["simulation", "prediction"] = "simulation"
    level: float = LEVEL
    fitted: int = 0
    scale: float = 0.0

    @cached_property
    def vanish(self) -> bool:
        """Whether they are no more than rounding, of which no test says anything."""
        y = self.y_hat + self.e
        scale = max(self.scale, float(np.max(np.abs(y - np.mean(y)))))
        return bool(np.max(np.abs(self.e)) <= _VANISHING * scale)

    @cached_property
    def innovations(self) -> Innovations:
        """What makes them white."""
        return Innovations.of(self.e, self.experiments)

    @cached_property
    def whiteness(self) -> Correlations:
        """Their autocorrelations."""
        return whiteness(self.e, self.experiments, level=self.level, fitted=self.fitted)

    @cached_property
    def input(self) -> Correlations | None:
        """Their correlations with past inputs; None if the input is constant."""
        if is_constant(self.u):
            return None
        return self._dependence("u", self.u, self.innovations)

    @cached_property
    def nonlinear_input(self) -> dict[str, Correlations]:
        """Their correlations with functions of the past, by name, beyond what depends linearly on the input.

        Functions that are none of their own on this record are left out.
        """
        found: dict[str, Correlations] = {}
        if is_constant(self.u):
            return found
        innovations = Innovations.beyond(self.e, self.u, self.experiments, self.stride)
        for name, x in nonlinear_functions(self.u, self.y_hat).items():
            try:
                found[name] = self._dependence(name, x, innovations, beside=(self.u,))
            except EstimationError:
                continue
        return found

    def _dependence(
        self, name: str, x: Array, innovations: Innovations, beside: tuple[Array, ...] = ()
    ) -> Correlations:
        return dependence(name, self.e, x, innovations, beside=beside, stride=self.stride, level=self.level)

    @cached_property
    def stride(self) -> int:
        """Samples from one lag to the next in the tests against the input."""
        return lag_stride(self.y_hat + self.e, self.experiments)

    @property
    def nonlinearity(self) -> Tested | None:
        """The tests of all nonlinear functions as one: the least p-value times their number (Bonferroni)."""
        tests = [correlations.test for correlations in self.nonlinear_input.values()]
        if not tests:
            return None
        least = min(tests, key=lambda test: test.p_value)
        return Tested(least.statistic, min(1.0, len(tests) * least.p_value))

    @cached_property
    def normality(self) -> Normality:
        """Whether their innovations are normal."""
        return normality(self.innovations.white(self.e - np.mean(self.e)))

    @cached_property
    def drift(self) -> Drift:
        """Whether they change with time."""
        return drift(self.e, self.experiments)

    @cached_property
    def offset(self) -> Tested:
        """Whether their mean is zero."""
        return offset(self.e, self.innovations)

    @cached_property
    def spread(self) -> Tested | None:
        """Whether their variance depends on the model's output; None if that is constant."""
        if is_constant(self.y_hat):
            return None
        return uneven_spread(self.e, self.y_hat, self.innovations)

    @property
    def sound(self) -> bool:
        """Whether no test says anything against the model."""
        return not self.complaints

    @property
    def complaints(self) -> tuple[str, ...]:
        """The sentences that say something against the model."""
        return tuple(sentence for sound, sentence in self._verdicts if not sound)

    @property
    def sentences(self) -> tuple[str, ...]:
        """A verdict on each test, in words."""
        return tuple(sentence for _, sentence in self._verdicts)

    @cached_property
    def _verdicts(self) -> tuple[tuple[bool, str], ...]:
        if self.vanish:
            return ((True, "The model gives the output up to rounding: there are no residuals to judge."),)
        return tuple(
            verdict
            for verdicts in (
                self._of_whiteness(),
                self._of_input(),
                self._of_nonlinear_functions(),
                self._of_offset_and_drift(),
                self._of_spread(),
                self._of_normality(),
            )
            for verdict in verdicts
        )

    def _fails(self, test: Tested | None) -> bool:
        return test is not None and test.p_value < self.level

    def _of_whiteness(self) -> Iterator[tuple[bool, str]]:
        found, count = self.whiteness, len(self.whiteness.lags)
        if not self._fails(found.test):
            yield True, f"The residuals are white up to lag {count} ({_p(found.test)})."
            return
        others = (self.input.test if self.input else None, self.nonlinearity, self.offset, self.drift.test)
        if any(map(self._fails, others)):
            means = "what stands below does this too"
        elif self.by == "prediction":
            means = "the noise model leaves this unexplained, try a higher order"
        else:
            means = (
                "the noise is coloured; a fit of the simulation error stays consistent, but its standard "
                "errors need the sandwich or an AR model of the noise"
            )
        yield False, f"The residuals are not white: {_largest(found)}, {_p(found.test)}: {means}."

    def _of_input(self) -> Iterator[tuple[bool, str]]:
        if (found := self.input) is None:
            yield True, "Whether the residuals depend on the input cannot be told: it is constant."
        elif self._fails(found.test):
            yield (
                False,
                f"The residuals depend on the input: {_largest(found)}, {_p(found.test)}: the linear "
                "dynamics leave something out, look at the delay and the orders.",
            )
        else:
            lags = f"lags 0 to {int(found.lags[-1])}"
            yield True, f"The residuals do not depend linearly on the input ({lags}, {_p(found.test)})."

    def _of_nonlinear_functions(self) -> Iterator[tuple[bool, str]]:
        tried, together = self.nonlinear_input, self.nonlinearity
        if together is None:
            yield (
                True,
                "Whether the residuals depend on nonlinear functions of the input cannot be told: "
                "on this input all of them are lines.",
            )
            return
        if not self._fails(together):
            names = ", ".join(tried)
            yield True, f"The residuals do not depend on {names} of the model's past ({_p(together)})."
            return
        name = min(tried, key=lambda name: tried[name].test.p_value)
        # Where several are beyond all doubt, the one that stands out most is the one to look at.
        if tried[name].test.p_value < 1e-12:
            name = max(tried, key=lambda name: tried[name].test.statistic)
        found = tried[name]
        place = found.largest
        yield (
            False,
            f"The residuals depend on {name} (at lag {int(found.lags[place])} the correlation "
            f"{found.values[place]:.2f}, band ±{found.band[place]:.2f}; {_p(together)}) beyond what depends "
            "linearly on u: the static nonlinearity, its place among the blocks or its memory is not the "
            "model's.",
        )

    def _of_offset_and_drift(self) -> Iterator[tuple[bool, str]]:
        if self._fails(self.offset):
            yield (
                False,
                f"The residuals have the mean {np.mean(self.e):.3g}, {_p(self.offset)}: the level of the "
                "model is off.",
            )
        found = self.drift
        if self._fails(found.test):
            if found.mean.p_value <= found.variance.p_value:
                yield (
                    False,
                    f"The residuals drift: their mean changes by {found.change:.3g} from the beginning to "
                    f"the end of an experiment, {_p(found.test)}: the system or the sensor changes with "
                    "time.",
                )
            else:
                yield (
                    False,
                    f"The spread of the residuals {'grows' if found.growth > 0 else 'shrinks'} with time, "
                    f"{_p(found.test)}: the noise is not stationary.",
                )
        else:
            yield True, f"The residuals do not drift ({_p(found.test)})."

    def _of_spread(self) -> Iterator[tuple[bool, str]]:
        if (found := self.spread) is None:
            return
        if self._fails(found):
            yield (
                False,
                f"The spread of the residuals depends on the output, {_p(found)}: standard errors need the "
                "sandwich, weights would gain accuracy; a nonlinearity before noise does this too.",
            )
        else:
            yield True, f"The spread of the residuals does not depend on the output ({_p(found)})."

    def _of_normality(self) -> Iterator[tuple[bool, str]]:
        found = self.normality
        if self._fails(found.test):
            yield (
                False,
                f"The residuals are not normal: skewness {found.skewness:.2f}, excess kurtosis "
                f"{found.excess_kurtosis:.2f}, {_p(found.test)}: "
                + ("look for outliers; " if found.excess_kurtosis > 0.0 else "")
                + "least squares stays consistent, but is not the most accurate.",
            )
        else:
            yield True, f"The residuals look normal ({_p(found.test)})."


def _largest(found: Correlations) -> str:
    place = found.largest
    return (
        f"lag {int(found.lags[place])} has the correlation {found.values[place]:.2f} "
        f"(band ±{found.band[place]:.2f})"
    )


def _p(test: Tested) -> str:
    return "p < 0.001" if test.p_value < 1e-3 else f"p = {test.p_value:.2g}"
