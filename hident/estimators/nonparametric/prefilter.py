"""Mzyk 2009's prefilter, and what the two nonparametric estimators share because of it."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Annotated, Any, Protocol, Self

import numpy as np
from pydantic_core import PydanticCustomError

from hident.arrays import Array, Characteristic, Flags, Index
from hident.config.spec import Component, Of, Real, Spec, components
from hident.config.suggest import one_of
from hident.errors import EstimationError
from hident.estimators.base import EstimatorSpec, Experiments, require_varying
from hident.estimators.normalisation import Normalisation, first_coefficient
from hident.linear_blocks import TransferFunction, significant
from hident.numerics.parts import Parts, in_each, longer_than, whole
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
        raise EstimationError("the linear block has b_0 = 0: it delays its input and has no causal inverse")
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
        found = ", ".join(f"{z.real:.4g}" if z.imag == 0.0 else f"{z:.4g}" for z in zeros)
        raise EstimationError(
            f"the linear block has no stable inverse: its zeros {found} do not all lie inside the unit circle"
        )
    inverse = TransferFunction(b=linear.b).inverse()
    steady = filtered.mean() / sum(linear.b)
    return inverse.filter(filtered, np.full(len(inverse.a), steady))


@dataclass(frozen=True, eq=False)
class FilteredRecord(Record):
    """The samples of ``whole`` that are ``kept``, with a filtered output; their order follows from its own.

    ``kept`` (N of ``whole``,) tells of each sample whether it is.
    """

    whole: Record | None = None
    kept: Flags | None = None

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
    """A point at which the characteristic is known."""

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
    if not isinstance(samples, FilteredRecord):
        return errors
    # y_k = b_0 y^f_k + what is past, so that this is the error of y_k given the past.
    placed = np.full(len(needed(samples.whole)), np.nan)
    placed[needed(samples.kept)] = needed(estimate.linear).b[0] * errors
    return placed


def _filtered(
    spec: EstimatorSpec, record: Record, rng: np.random.Generator | None
) -> tuple[Estimate, Record]:
    """The linear block, and the record with it undone."""
    dynamics = spec.fit(record, rng)
    return dynamics, FilteredRecord.of(record, needed(dynamics.linear))


class NonparametricSpec(EstimatorSpec):
    """Base of the estimators of a characteristic by regression, on the output or the filtered output.

    With a prefilter the estimate also holds what the prefilter estimated. The first p samples of each
    experiment are dropped (see :func:`prefilter`), so N - p pairs (u_k, y^f_k) of each remain.
    """

    prefilter: Annotated[EstimatorSpec, _OfDynamics("estimator")] | None = None
    """Estimator of the linear block, to be undone first (drops p samples); none: the plain output is used."""
    known_point: KnownPoint | None = None
    """A point where the characteristic is known: a constant is added so that the estimate agrees there."""

    def takes_experiments(self) -> Experiments:
        # Without a prefilter the order of the samples does not matter.
        return self.prefilter.takes_experiments() if self.prefilter else "any"

    def draws(self) -> bool:
        return self.prefilter is not None and self.prefilter.draws()

    def regression(self, samples: Record) -> Regression:
        """The estimated regression of the output on the input."""
        raise NotImplementedError

    def values_of(self, regression: Regression) -> dict[str, float]:
        """What the regression adds to the values of the prefilter."""
        return {}

    def names(self) -> Sequence[str]:
        return self.prefilter.names() if self.prefilter else ()

    def provides(self) -> frozenset[str]:
        more = self.prefilter.provides() | {"unfiltered"} if self.prefilter else frozenset()
        own = frozenset(f"value {name}" for name in self.names())
        return more | own | {"nonlinearity", "left_out"}

    def fewest_samples(self) -> int:
        return self.prefilter.fewest_samples() if self.prefilter else 1

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
        return record if self.prefilter is None else FilteredRecord.of(record, needed(estimate.linear))

    def free_parameters(self) -> None:
        return None

    def normalisations(self) -> tuple[Normalisation, ...] | None:
        if self.prefilter is not None:
            return self.prefilter.normalisations()
        # The regression on the newest input: gamma_0 times the characteristic, and the mean of all the rest.
        plain = first_coefficient(symbol="gamma")
        left_in = "" if self.known_point else ", a constant left in"
        return (replace(plain, rule=plain.rule + left_in),)

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        self.require_experiments(record)
        record.once("its input varies", lambda: require_varying(record.u, "input"))
        if self.prefilter is None:
            regression = self.regression(record)
            left_out = EachLeftOut(regression, record, self.known_point)
            return Estimate(self._anchored(regression), left_out, values=self.values_of(regression))
        make = partial(_filtered, self.prefilter, record, rng)
        dynamics, samples = make() if self.prefilter.draws() else record.once(self._shared, make)
        regression = self.regression(samples)
        return replace(
            dynamics,
            nonlinearity=self._anchored(regression),
            left_out=EachLeftOut(regression, samples, self.known_point),
            unfiltered=lambda: self.model_copy(update={"prefilter": None}).fit(record),
            values={**dynamics.values, **self.values_of(regression)},
        )

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
