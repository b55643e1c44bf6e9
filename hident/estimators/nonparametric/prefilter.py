"""Mzyk 2009's prefilter, and what the two nonparametric estimators share because of it."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Annotated, Any, Literal, Protocol, Self

import numpy as np
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from hident.arrays import Array, Characteristic, Index
from hident.config.spec import Component, Count, Of, Real, Spec, components
from hident.config.suggest import one_of
from hident.errors import EstimationError
from hident.estimators.base import EstimatorSpec, Experiments, require_varying
from hident.estimators.discrete_response import at_step
from hident.estimators.nonparametric.delay import (
    FEWEST_PAIRS,
    Delay,
    DelaySearch,
    SomeSamples,
    delayed,
    late,
    search_delay,
)
from hident.estimators.normalisation import (
    Normalisation,
    behind,
    behind_found,
    behind_noticed,
    first_coefficient,
)
from hident.linear_blocks import TransferFunction, significant
from hident.numerics.parts import Parts, in_each, longer_than, whole
from hident.numerics.rounding import apart
from hident.records import Estimate, Record, needed


def prefilter(y: Array, linear: TransferFunction, parts: Parts | None = None) -> Array:
    """The output with the linear block undone: y^f = (A/B) y, an estimate of w.

    Parameters
    ----------
    y : array, shape (N,)
        The output of the linear block B/A.
    linear : TransferFunction
        The block, with p coefficients a_1, ..., a_p.
    parts : sequence of slices, optional
        Where the experiments stand, one by default: each is filtered by itself.

    Returns
    -------
    array, shape (N - p,) for one experiment
        y^f_k for k = p, ..., N-1 of each experiment.

    Raises
    ------
    EstimationError
        If the block has no stable causal inverse: b_0 = 0, or a zero on or outside the unit circle; or if no
        experiment holds more than p samples.

    Notes
    -----
    Mzyk 2009, eq. (14), extended by 1/B for remark 3's invertible ARMA block; 1/B starts from the mean of
    what it filters, so that a constant passes as a constant.

    Differs from the paper: eq. (14) is summed from k = 1 and so takes the p outputs before the record as
    measured. An experiment has none, so its first p filtered samples are dropped and N - p remain.
    """
    if significant(linear.b)[0] == 0.0:
        raise EstimationError(
            "the linear block has b_0 = 0: it delays its input and has no causal inverse; leave its leading "
            "zeros out and give their number as 'delay' of the estimator"
        )
    if not (long := longer_than(parts or whole(len(y)), len(linear.a))):
        raise EstimationError(
            f"no experiment holds more than the {len(linear.a)} samples that the filter drops"
        )
    return in_each(long, lambda part: _undone(part, linear), y)


def _undone(y: Array, linear: TransferFunction) -> Array:
    p = len(linear.a)
    # Eq. (14)
    filtered = y[p:].copy()
    for lag, a in enumerate(linear.a, start=1):
        filtered -= a * y[p - lag : len(y) - lag]
    if len(linear.b) == 1:
        filtered /= linear.b[0]
        return filtered
    # Adding zero turns -0 into 0 for the message.
    zeros = linear.zeros() + 0.0
    if np.any(np.abs(zeros) >= 1.0):
        found = ", ".join(apart(z.real if z.imag == 0.0 else z, 1.0, 4) for z in zeros)
        raise EstimationError(
            f"the linear block has no stable inverse: its zeros {found} do not all lie inside the unit circle"
        )
    inverse = TransferFunction(b=linear.b).inverse()
    steady = filtered.mean() / sum(linear.b)
    return inverse.filter(filtered, np.full(len(inverse.a), steady))


@dataclass(frozen=True, eq=False)
class FilteredRecord(SomeSamples):
    """The samples of a record that are kept, with a filtered output; their order follows from its own."""

    @classmethod
    def of(cls, record: Record, linear: TransferFunction) -> Self:
        """The record with ``linear`` undone, without the samples that the filter drops in each experiment."""
        filtered = prefilter(record.y, linear, record.experiments)
        kept = np.ones(len(record), dtype=bool)
        for part in record.experiments:
            kept[part.start : min(part.start + len(linear.a), part.stop)] = False
        u = record.u[kept]
        u.flags.writeable = filtered.flags.writeable = False
        return cls(u, filtered, whole=record, kept=kept)

    @cached_property
    def order(self) -> Index:
        """An order that sorts u."""
        assert self.whole is not None
        assert self.kept is not None
        order = self.whole.order
        return (np.cumsum(self.kept) - 1)[order[self.kept[order]]]


class Regression(Protocol):
    """An estimated regression of the output on the input, which each of its samples can be taken out of."""

    def __call__(self, u: Array, /) -> Array:
        """The values at points (M,)."""

    def left_out(self, samples: Index, points: Array) -> Array:
        """The values at increasing ``points`` (M,), the m-th from all samples but ``samples[m]``."""


class KnownPoint(Spec):
    """An input, and the characteristic there."""

    u: Real
    """The input."""
    value: Real
    """The characteristic there."""


@dataclass(frozen=True)
class Anchored:
    """A characteristic plus a constant."""

    regression: Characteristic
    constant: float

    def __call__(self, u: Array) -> Array:
        return self.regression(u) + self.constant


@dataclass(frozen=True, eq=False)
class EachLeftOut:
    """The estimate at its own ``samples``, each without its own; what undid the linear block stays."""

    regression: Regression
    samples: Record
    known_point: KnownPoint | None = None

    def __call__(self, low: float, high: float) -> tuple[Array, Array]:
        order = self.samples.order
        u = self.samples.u[order]
        inside = slice(np.searchsorted(u, low), np.searchsorted(u, high, "right"))
        order, u = order[inside], u[inside]
        values = self.regression.left_out(order, u)
        if self.known_point is not None:
            there = self.regression.left_out(order, np.full(len(u), self.known_point.u))
            values += self.known_point.value - there
        return u, values

    def errors(self) -> Array:
        """The samples less the estimates without them, (N,), in the order of the samples."""
        order = self.samples.order
        errors = np.empty(len(order))
        errors[order] = self.samples.y[order] - self.regression.left_out(order, self.samples.u[order])
        return errors


class _OfDynamics(Of):
    """Pydantic annotation: an estimator that provides a linear block."""

    def validate(self, value: Any) -> Component:
        spec = super().validate(value)
        assert isinstance(spec, EstimatorSpec)
        if not spec.identifies_dynamics:
            allowed = one_of(
                kind
                for kind, cls in components(self.family).items()
                if issubclass(cls, EstimatorSpec) and cls.identifies_dynamics
            )
            raise PydanticCustomError(
                "config", f"'{spec.kind}' does not estimate a linear block (allowed: {allowed})"
            )
        return spec


def _placed(errors: Array, samples: Record, estimate: Estimate) -> Array:
    """Errors of the samples (N,) as errors of the output, where its record has them; nan elsewhere."""
    if not np.isfinite(errors).all():
        raise EstimationError("the regression is not finite at some sample")
    if isinstance(samples, FilteredRecord):
        # y_k = b_0 y^f_k + what is past, so that this is the error of y_k given the past; a delay leaves the
        # first coefficient at its lag.
        errors = next(b for b in needed(estimate.linear).b if b) * errors
    while isinstance(samples, SomeSamples):
        placed = np.full(len(needed(samples.whole)), np.nan)
        placed[needed(samples.kept)] = errors
        errors, samples = placed, needed(samples.whole)
    return errors


def _searched(estimate: Estimate) -> int | None:
    """The delay that a search has found."""
    return int(estimate.values["delay"]) if "delay" in estimate.values else None


def _noticed(estimate: Estimate) -> int | None:
    """The delay that was noticed though none was given; None if there was none."""
    return estimate.details.get("late")


def _filtered(
    spec: EstimatorSpec, record: Record, rng: np.random.Generator | None
) -> tuple[Estimate, Record]:
    """The linear block, and the record with it undone."""
    dynamics = spec.fit(record, rng)
    return dynamics, FilteredRecord.of(record, needed(dynamics.linear))


class NonparametricSpec(EstimatorSpec):
    """Base of the estimators of a characteristic by regression, on the output or the filtered output.

    With a prefilter the estimate also holds what the prefilter estimated, and the response of both. The first
    p samples of each experiment are dropped (see :func:`prefilter`), so N - p pairs (u_k, y^f_k) of each
    remain. With a delay d all is done with the pairs (u_{k-d}, y_k), and the linear block that is found is
    delayed by d.
    """

    prefilter: Annotated[EstimatorSpec, _OfDynamics("estimator")] | None = None
    """Estimator of the linear block, to be undone first (drops p samples); none: the plain output is used."""
    known_point: KnownPoint | None = None
    """A point where the characteristic is known: a constant is added so that the estimate agrees there."""
    delay: Delay | None = None
    """Samples by which the linear block delays its input; search: those on whose input y depends most. Left
    out, 0; without a prefilter a later one where the output depends on that input, and not on the newest."""
    largest_delay: Annotated[Count, Field(ge=1)] = 10
    """Largest delay that is tried (search), which fails where none up to it explains more than chance."""

    @model_validator(mode="after")
    def _only_a_search_has_a_largest_delay(self) -> Self:
        if self.delay != "search" and "largest_delay" in self.model_fields_set:
            raise ValueError("only 'delay: search' takes largest_delay")
        return self

    @property
    def _given(self) -> Literal["search"] | int:
        """The delay as far as it is known before there is a record."""
        return 0 if self.delay is None else self.delay

    def takes_experiments(self) -> Experiments:
        if self.prefilter:
            return self.prefilter.takes_experiments()
        # Without a prefilter and a delay the order of the samples does not matter.
        return "any" if self._given == 0 else "at_one_interval"

    def draws(self) -> bool:
        return self.prefilter is not None and self.prefilter.draws()

    def regression(self, samples: Record) -> Regression:
        """The estimated regression of the output on the input."""
        raise NotImplementedError

    def values_of(self, regression: Regression) -> dict[str, float]:
        """What the regression adds to the values of the prefilter."""
        return {}

    def names(self) -> Sequence[str]:
        names = self.prefilter.names() if self.prefilter else ()
        if self._given == 0:
            return names
        return [*self._later(dict.fromkeys(names, 0.0), 0 if self._given == "search" else self._given)]

    def _later(self, values: Mapping[str, float], delay: int) -> dict[str, float]:
        """The values of a prefilter behind a delay, b_0, ... at its lags, and the delay itself.

        Which lags these are is not known before a search, so that they have no names there.
        """
        named = {
            f"b_{int(name[2:]) + delay}" if name.startswith("b_") else name: value
            for name, value in values.items()
            if not (self._given == "search" and name.startswith("b_"))
        }
        return {**named, "delay": float(delay)}

    def provides(self) -> frozenset[str]:
        more = self.prefilter.provides() | {"unfiltered", "response"} if self.prefilter else frozenset()
        parts = {part for part in more if not part.startswith("value ")}
        return frozenset({"nonlinearity", "left_out", *parts, *(f"value {name}" for name in self.names())})

    def fewest_samples(self) -> int:
        fewest = self.prefilter.fewest_samples() if self.prefilter else 1
        if self._given == "search":
            return self.largest_delay + max(fewest, FEWEST_PAIRS)
        return self._given + fewest

    def explains(self) -> bool:
        return True

    def errors(self, estimate: Estimate, record: Record) -> Array:
        """What the regression leaves of the filtered output, times b_0: the errors of one-step prediction.

        The samples that the filter drops are nan.
        """
        regression = estimate.nonlinearity
        if isinstance(regression, Anchored):
            regression = regression.regression
        samples = self._regressed(estimate, record)
        return _placed(samples.y - needed(regression)(samples.u), samples, estimate)

    def left_out_errors(self, estimate: Estimate, record: Record) -> Array:
        without = needed(estimate.left_out)
        assert isinstance(without, EachLeftOut)
        return _placed(without.errors(), without.samples, estimate)

    def _regressed(self, estimate: Estimate, record: Record) -> Record:
        """What the regression was, or would be, estimated from."""
        delay = estimate.details.get("late", 0) if self._given == 0 else int(estimate.values["delay"])
        pairs = self._pairs(record, delay) if delay or self._given != 0 else record
        if self.prefilter is None:
            return pairs
        linear = needed(estimate.linear)
        return FilteredRecord.of(pairs, replace(linear, b=linear.b[delay:]))

    def free_parameters(self) -> None:
        return None

    def letters(self) -> Mapping[str, str]:
        return {} if self.prefilter is None else self.prefilter.letters()

    def normalisations(self) -> tuple[Normalisation, ...] | None:
        search, delay = self._given == "search", 0 if self._given == "search" else self._given
        if self.prefilter is not None:
            rules = self.prefilter.normalisations()
            if rules is None:
                return None
            return tuple(behind_found(rule, _searched) if search else behind(rule, delay) for rule in rules)
        # The regression on the newest input: gamma_0 times the characteristic, and the mean of all the rest.
        plain = first_coefficient(symbol="gamma")
        rule = plain if self.known_point else plain.leaving("constant", says=", a constant left open")
        if self.delay is None:
            return (behind_noticed(rule, _noticed, self.largest_delay),)
        if search:
            return (behind_found(rule, _searched, responses=True),)
        return (behind(rule, delay, responses=True),)

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        self.require_experiments(record)
        record.once("its input varies", lambda: require_varying(record.u, "input"))
        if self.delay is None and self.prefilter is None and (noticed := self._late(record)):
            # Behind a delay, the regression on the newest input is a constant and noise.
            found = self._fitted(record, self._pairs(record, noticed), noticed, rng)
            return replace(found, details={**found.details, "late": noticed})
        if self._given == 0:
            return self._fitted(record, record, 0, rng)
        search = self._search(record, rng) if self._given == "search" else None
        delay = self._given if search is None else search.chosen
        assert isinstance(delay, int)
        pairs = self._pairs(record, delay)
        require_varying(pairs.u, "input")
        found = self._fitted(record, pairs, delay, rng)
        return found if search is None else replace(found, details={**found.details, "delay": search})

    def _late(self, record: Record) -> int:
        return record.once(("late", self.largest_delay), lambda: late(record, self.largest_delay))

    def _pairs(self, record: Record, delay: int) -> Record:
        """The pairs behind a delay, the same ones for all estimators of this record."""
        return record.once(("delayed", delay), partial(delayed, record, delay))

    def _fitted(self, record: Record, pairs: Record, delay: int, rng: np.random.Generator | None) -> Estimate:
        """The estimate from the pairs of the record behind a delay, as if they were at one time."""
        dynamics, samples = (Estimate(), pairs) if self.prefilter is None else self._undone(pairs, rng)
        regression = self.regression(samples)
        values = dynamics.values if self._given == 0 else self._later(dynamics.values, delay)
        values = {**values, **self.values_of(regression)}
        left_out = EachLeftOut(regression, samples, self.known_point)
        if self.prefilter is None:
            return Estimate(self._anchored(regression), left_out, values=values)
        linear, step = needed(dynamics.linear), 1.0 if record.dt is None else record.dt
        if delay:
            linear = replace(linear, b=(0.0,) * delay + linear.b)
        found = self._anchored(regression)
        return replace(
            dynamics,
            nonlinearity=found,
            left_out=left_out,
            linear=linear,
            response=at_step(lambda u: linear.filter(found(u)), step),
            unfiltered=lambda: self.model_copy(update={"prefilter": None, "delay": delay}).fit(record),
            values=values,
        )

    def _undone(self, pairs: Record, rng: np.random.Generator | None) -> tuple[Estimate, Record]:
        """The prefilter's linear block, and the pairs with it undone."""
        assert self.prefilter is not None
        make = partial(_filtered, self.prefilter, pairs, rng)
        return make() if self.prefilter.draws() else pairs.once(self._shared, make)

    def _search(self, record: Record, rng: np.random.Generator | None) -> DelaySearch:
        def outputs(delay: int, first: int) -> Record:
            pairs = delayed(record, delay, first)
            return pairs if self.prefilter is None else self._undone(pairs, rng)[1]

        make = partial(search_delay, outputs, self.largest_delay)
        return make() if self.draws() else record.once(("delay", self.largest_delay, self._shared), make)

    @cached_property
    def _shared(self) -> Hashable:
        """What estimators with one and the same prefilter have in common; a plugin's may have no hash."""
        return type(self.prefilter), repr(self.prefilter)

    def _anchored(self, regression: Regression) -> Characteristic:
        if self.known_point is None:
            return regression
        there = float(regression(np.array([self.known_point.u]))[0])
        if not math.isfinite(there):
            raise EstimationError(f"the regression at the known point u = {self.known_point.u:g} is {there}")
        return Anchored(regression, self.known_point.value - there)
