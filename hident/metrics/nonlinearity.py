"""Distances between the estimated and the true characteristic."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal, assert_never

import numpy as np
from pydantic import Field

from hident.arrays import Array, Characteristic
from hident.config.spec import Count, Interval, NonEmpty, Real, component
from hident.errors import TrialFailed
from hident.metrics.base import ONE_UNIT, Best, Comparing, MetricSpec, Scored
from hident.numerics.freedoms import Freedom, multiple, nearest, nearest_argument
from hident.records import Estimate, Record, Truth, needed

_NODES = 8
_PROBES = 65
_PARTS = frozenset({"nonlinearity"})


def quadrature(low: float, high: float, breaks: Sequence[float], points: int) -> tuple[Array, Array]:
    """Nodes and weights of a composite Gauss-Legendre rule on [low, high], split at the breaks.

    Each panel has 8 nodes, so a smooth piece is integrated to rounding; an integrand with jumps of its own
    (a window estimate) to the order of the panel width. Shapes (M,), with M at least ``points``.
    """
    edges = np.array([low, *(b for b in breaks if low < b < high), high])
    # Panels are shared out in proportion to the lengths of the pieces.
    shares = np.ceil(np.diff(edges) / (high - low) * points / _NODES).astype(int)
    grid = np.concatenate(
        [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(edges, edges[1:], shares, strict=False)]
    )
    widths = np.diff(grid, append=high)
    x, w = np.polynomial.legendre.leggauss(_NODES)
    nodes = grid[:, None] + widths[:, None] * (x + 1.0) / 2.0
    return nodes.ravel(), np.outer(widths / 2.0, w).ravel()


def _of(truth: Truth | None) -> tuple[Characteristic, tuple[float, ...]]:
    if truth is None or truth.nonlinearity is None:
        raise ValueError("the record has no true nonlinearity")
    return truth.nonlinearity, truth.breakpoints


def _has_factor_inside(truth: Truth) -> bool:
    """Whether a linear block before the nonlinearity has a factor of its argument to give."""
    return truth.structure in ("L-N", "L-N-L")


def _finite(values: Array, u: Array, whose: str) -> Array:
    """The values of a characteristic at u, if all are finite."""
    if not np.isfinite(values).all():
        at = int(np.flatnonzero(~np.isfinite(values))[0])
        raise TrialFailed(f"the {whose} nonlinearity is {values[at]} at u = {u[at]:g}")
    return values


class _OnInterval(Comparing):
    best: ClassVar[Best | None] = "lowest"
    choices: ClassVar[tuple[Freedom, ...]] = ("gain", "sign", "constant")

    interval: Interval
    """The input range [low, high] that the error is taken over."""
    points: Annotated[Count, Field(ge=_NODES)] = 4096
    """Least number of quadrature nodes on the interval."""

    def needs_of_truth(self) -> frozenset[str]:
        return _PARTS

    def needs_of_estimate(self) -> frozenset[str]:
        return _PARTS

    def in_one_unit(self, one: Truth, other: Truth) -> tuple[bool, ...]:
        # A relative error is the same of a multiple; a factor of the argument makes none.
        return (self._scaled(one, other) is not None,)

    def _scaled(self, one: Truth, other: Truth) -> float | None:
        """The factor between the nonlinearities of two forms on the interval; None if there is none."""
        u = np.linspace(*self.interval, _PROBES)
        with np.errstate(all="ignore"):
            return multiple(needed(one.nonlinearity)(u), needed(other.nonlinearity)(u))

    def integrals(self, estimate: Estimate, record: Record) -> tuple[float, float]:
        """The integrals of the squared error and of the squared truth over the interval."""
        truth, breaks = _of(record.truth)
        nodes, weights = quadrature(*self.interval, breaks, self.points)
        true = _finite(truth(nodes), nodes, "true")
        error = self._nearest(estimate, record, nodes, true, weights) - true
        return float(weights @ error**2), float(weights @ true**2)

    def _nearest(self, estimate: Estimate, record: Record, u: Array, true: Array, weights: Array) -> Array:
        """The estimate at ``u`` (M,), with what is free chosen for the least error against ``true`` (M,)."""
        found, truth, free = needed(estimate.nonlinearity), needed(record.truth), {*(self.up_to or ())}
        factors = free & {"gain", "sign"}
        if not factors or not _has_factor_inside(truth):
            return nearest(_finite(found(u), u, "estimated"), true, weights, free)
        outside = free if truth.structure == "L-N-L" else free - factors
        return _finite(nearest_argument(found, u, true, weights, factors, outside), u, "estimated")


@component("metric", "mise", source="Mzyk 2009, section V")
class IntegratedSquaredError(_OnInterval):
    """Integrated squared error of the nonlinearity; its mean over trials is the MISE.

        the integral over the interval of (f_est(u) - f(u))^2 du

    ``at: grid`` integrates over the interval, piece by piece between the characteristic's jumps. ``at:
    samples`` is the interval's length times the mean squared error at the record's inputs inside it, which
    estimates the same integral when the input is uniform there, but scores the estimate only where a sample
    supports it, and each estimate there holds its own sample. ``at: left_out_samples`` is the same mean over
    the samples that the estimator used, each estimate without its own (leave one out): bandwidth, cutoff
    level and prefilter stay. A constant that the estimator leaves open is taken off; in the paper it counts,
    as by ``up_to: []``.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Ar(a=[0.5]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> estimate = hi.Estimate(nonlinearity=lambda u: np.abs(u) + 0.5)
    >>> scores = hi.score(estimate, record, ise=hi.IntegratedSquaredError(interval=[-1, 1]))
    >>> round(scores["ise"], 6)
    0.5
    """

    at: Literal["grid", "samples", "left_out_samples"] = "grid"
    """Where the error is taken: on a quadrature grid, at the inputs, or there with each sample left out."""

    def in_one_unit(self, one: Truth, other: Truth) -> tuple[bool, ...]:
        factor = self._scaled(one, other)
        return (factor is not None and abs(abs(factor) - 1.0) <= ONE_UNIT,)

    def needs_of_estimate(self) -> frozenset[str]:
        return _PARTS | {"left_out"} if self.at == "left_out_samples" else _PARTS

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        match self.at:
            case "grid":
                return (self.integrals(estimate, record)[0],)
            case "samples":
                return (self._at_samples(estimate, record),)
            case "left_out_samples":
                u, values = needed(estimate.left_out)(*self.interval)
                return (self._mean(u, values, _finite(_of(record.truth)[0](u), u, "true")),)
        assert_never(self.at)

    def check(self, scored: Scored) -> None:
        if self.at != "grid" and self.up_to and _has_factor_inside(scored.truth):
            raise ValueError(
                f"is 'at: {self.at}' of the input, and the nonlinearity's argument is the output of a linear "
                "block, of which a factor is free: take 'at: grid'"
            )

    def _mean(self, u: Array, values: Array, true: Array) -> float:
        """The interval's length times the mean squared error at the points u."""
        low, high = self.interval
        values = _finite(values, u, "estimated")
        error = nearest(values, true, np.ones(len(u)), self.up_to or ()) - true
        return (high - low) * float(error @ error) / len(u) if len(u) else float("nan")

    def _at_samples(self, estimate: Estimate, record: Record) -> float:
        truth, _ = _of(record.truth)
        low, high = self.interval

        def samples() -> tuple[Array, Array]:
            # In increasing order, in which an estimate is evaluated with fewer jumps through memory.
            u = record.u[record.order]
            u = u[np.searchsorted(u, low) : np.searchsorted(u, high, "right")]
            true = _finite(truth(u), u, "true")
            u.flags.writeable = true.flags.writeable = False
            return u, true

        u, true = record.once(("truth at the samples", self.interval), samples)
        return self._mean(u, needed(estimate.nonlinearity)(u), true)


@component("metric", "mise_reduction", source="Mzyk 2009, section V")
class ErrorReduction(IntegratedSquaredError):
    """The integrated squared error without the prefilter over that with it, on the same record.

    Undoing the linear block determines the constant that the estimate without it leaves open: so it counts,
    unless ``up_to: [constant]`` takes it off both.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Ar(a=[0.8]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> known = hi.KnownDynamics(a=[0.8])
    >>> kernel = hi.Kernel(kernel="gaussian", bandwidth={"h0": 0.3, "alpha": "1/5"}, prefilter=known)
    >>> scores = hi.score(hi.fit(kernel, record), record, times=hi.ErrorReduction(interval=[-1, 1]))
    >>> scores["times"] > 10
    True
    """

    best: ClassVar[Best | None] = "highest"

    def in_one_unit(self, one: Truth, other: Truth) -> tuple[bool, ...]:
        return (self._scaled(one, other) is not None,)

    def needs_of_estimate(self) -> frozenset[str]:
        return super().needs_of_estimate() | {"unfiltered"}

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        (without,) = super().evaluate(needed(estimate.unfiltered)(), record)
        (left,) = super().evaluate(estimate, record)
        return (without / left if left else float("nan"),)


@component("metric", "nonlinearity_value")
class NonlinearityValue(MetricSpec):
    """The estimated nonlinearity at given inputs: its std over trials is that of the estimate there.

    Examples
    --------
    >>> import hident as hi
    >>> metric = hi.NonlinearityValue(at=[1, -2])
    >>> hi.score(hi.Estimate(nonlinearity=np.abs), hi.Record([0], [0]), there=metric)
    {'there 1': 1.0, 'there -2': 2.0}
    """

    at: NonEmpty[Real]
    """The inputs."""
    factor: Real = 1.0
    """What the values are multiplied by, such as the root of the number of samples."""

    def labels(self, name: str) -> tuple[str, ...]:
        return tuple(f"{name} {u:g}" for u in self.at)

    def needs_of_estimate(self) -> frozenset[str]:
        return _PARTS

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        values: list[float] = (self.factor * needed(estimate.nonlinearity)(np.array(self.at))).tolist()
        return values


@component("metric", "nonlinearity_percent_error")
class NonlinearityPercentError(_OnInterval):
    """Root of the integrated squared error in percent of the root of the integrated squared truth.

        100 (integral of (f_est(u) - f(u))^2 du / integral of f(u)^2 du)^(1/2)

    A constant that the estimator leaves open is taken off, unless ``up_to`` is written and does not list it.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Ar(a=[0.5]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> estimate = hi.Estimate(nonlinearity=lambda u: 1.1 * np.abs(u))
    >>> scores = hi.score(estimate, record, percent=hi.NonlinearityPercentError(interval=[-1, 1]))
    >>> round(scores["percent"], 6)
    10.0
    >>> metric = hi.NonlinearityPercentError(interval=[-1, 1], up_to=["gain"])
    >>> round(hi.score(estimate, record, percent=metric)["percent"], 6)
    0.0
    """

    def check(self, scored: Scored) -> None:
        truth = scored.truth
        with np.errstate(all="ignore"):
            nodes, _ = quadrature(*self.interval, truth.breakpoints, self.points)
            if not np.any(needed(truth.nonlinearity)(nodes)):
                raise ValueError(
                    "is in percent of the true nonlinearity, which is zero throughout the interval: "
                    "take a wider interval, or the kind mise"
                )

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        error, energy = self.integrals(estimate, record)
        return (100.0 * float(np.sqrt(error / energy)) if energy else float("nan"),)
