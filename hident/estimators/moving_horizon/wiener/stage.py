"""The first stage for Wiener systems: the iteration and the search for the partition points.

Chen, Hwang and Chang 2009, sections 4.2 and 5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from hident.arrays import Array, Characteristic, Flags
from hident.config.spec import Count, Spec
from hident.errors import EstimationError
from hident.estimators.base import POWERS
from hident.estimators.convergence import History
from hident.estimators.moving_horizon.partition import Partition, require_inside
from hident.estimators.moving_horizon.searches import PartitionSearch, best_pair
from hident.estimators.moving_horizon.transform.linear_transform import block_of
from hident.estimators.moving_horizon.wiener.batched_blocks import time_constants
from hident.estimators.moving_horizon.wiener.four_segment import FourSegment, forward, inverse
from hident.estimators.moving_horizon.wiener.iteration import (
    FourSegments,
    Internal,
    Iterates,
    Powers,
    Rule,
    Wiener,
    iterate,
)
from hident.linear_blocks import ContinuousTransferFunction
from hident.numerics.parts import in_each, longer_than
from hident.systems.nonlinearity import Polynomial

# Iterations after which the search gives up a pair whose model stays inadmissible.
_PATIENCE = 10
# Samples of internal variables that the search holds at once.
_AT_ONCE = 2**22
# The spread of x relative to that of y below which the iteration has fallen to the solution x = 0.
_TRIVIAL = 0.02


class FourSegmentSpec(Spec):
    """The four-segment inverse function (13)."""

    kind: Literal["four_segment"]
    """The kind."""
    partition: Partition = "search"
    """Partition points [y_-1, y_1], or search for those that minimise (31)."""
    points: Annotated[Count, Field(ge=2)] = 8
    """Partition points of either sign that the search tries; twice as many if no pair of them will do."""
    refinements: Annotated[Count, Field(ge=0)] = 2
    """Refinements of the search around the best pair."""

    def coefficients(self) -> list[str]:
        """The names of the nonlinearity's estimated coefficients."""
        return ["e_-2", "e_-1", "e_2"]

    def names(self) -> list[str]:
        """The names of all parameters."""
        return [*self.coefficients(), "y_-1", "y_1"]

    def letters(self) -> Mapping[str, str]:
        """What the coefficients are, by their letter."""
        return {"e": "slopes of the inverse nonlinearity's segments"}


class PolynomialSpec(Spec):
    """A polynomial y = x + c_2 x^2 + ... + c_p x^p (10)."""

    kind: Literal["polynomial"]
    """The kind."""
    degree: Annotated[Count, Field(ge=2, le=20)]
    """Degree p."""

    def coefficients(self) -> list[str]:
        """The names of the nonlinearity's estimated coefficients."""
        return [f"c_{i}" for i in range(2, self.degree + 1)]

    def names(self) -> list[str]:
        """The names of all parameters."""
        return self.coefficients()

    def letters(self) -> Mapping[str, str]:
        """What the coefficients are, by their letter."""
        return {"c": POWERS}


NonlinearitySpec = FourSegmentSpec | PolynomialSpec


@dataclass(frozen=True, eq=False)
class WienerStage:
    """What the first stage found.

    ``nonlinearity`` is y(v) with x = b_0 v, ``parameters`` are its own as the spec names them, ``x`` (N,) is
    the internal variable (28b), ``phi`` (K, P) the regressors; x was updated ``iterations`` times. The last
    regressor is that of the ``constant`` of the output, None if that is not estimated.
    """

    wiener: Wiener
    block: ContinuousTransferFunction
    nonlinearity: Characteristic
    parameters: tuple[float, ...]
    x: Array
    phi: Array
    iterations: int
    history: History
    constant: float | None
    partition: PartitionSearch | None = None

    @property
    def regressors(self) -> Array:
        """Those of the block and the nonlinearity."""
        return self.phi if self.constant is None else self.phi[:, :-1]


def first_stage(wiener: Wiener, spec: NonlinearitySpec, rule: Rule, start: float) -> WienerStage:
    """The iteration of section 4.2, after a search for the partition points if none are given.

    ``start`` is t_0, from which on the search compares the outputs (31) of each experiment.

    Raises
    ------
    EstimationError
        If a regression is singular, or no iteration ends in a stable block and a function from x to y.
    """
    if isinstance(spec, PolynomialSpec):
        return _polynomial_stage(wiener, spec, rule)
    if spec.partition != "search":
        return _four_segment_stage(wiener, spec, rule, spec.partition)
    search = search_partition(wiener, rule, start, spec.points, spec.refinements)
    return replace(_four_segment_stage(wiener, spec, rule, search.best), partition=search)


def _four_segment_stage(
    wiener: Wiener, spec: FourSegmentSpec, rule: Rule, points: tuple[float, float]
) -> WienerStage:
    run = _run(wiener, lambda x: FourSegments.of_points(wiener, np.array(points)[:, None], x), rule)
    lower, upper = points
    a, b, c = wiener.split(run.path[:, 0])
    e = 1.0 - c
    block = block_of(a[-1], b[-1], wiener.delay)
    slopes = tuple(e[-1].tolist())
    constants = wiener.constants(run.path[:, 0])
    return WienerStage(
        wiener,
        block,
        FourSegment(slopes, lower, upper, block.b[0]),
        (*slopes, lower, upper),
        inverse(wiener.y - constants[-1], e[-1], lower, upper),
        run.phi[0],
        int(run.iterations[0]),
        _history(wiener, run, dict(zip(spec.coefficients(), e.T, strict=True))),
        float(constants[-1]) if wiener.constant else None,
    )


def _history(wiener: Wiener, run: Iterates, coefficients: dict[str, Array]) -> History:
    """The parameters of the only iteration, the constant of the output among the coefficients."""
    a, b, _ = wiener.split(run.path[:, 0])
    constant = {"constant": wiener.constants(run.path[:, 0])} if wiener.constant else {}
    return History(a, b, {**coefficients, **constant}, bool(run.converged[0]))


def _polynomial_stage(wiener: Wiener, spec: PolynomialSpec, rule: Rule) -> WienerStage:
    run = _run(wiener, lambda x: Powers(wiener, spec.degree, x[:, None]), rule)
    a, b, c = wiener.split(run.path[:, 0])
    block = block_of(a[-1], b[-1], wiener.delay)
    # In v = x/b_0, the polynomial (10) with c_1 = 1.
    scaled = np.concatenate(([0.0, 1.0], c[-1])) * block.b[0] ** np.arange(spec.degree + 1)
    x_lin, constants = wiener.internal(run.theta), wiener.constants(run.theta)
    return WienerStage(
        wiener,
        block,
        Polynomial(coefficients=tuple(scaled.tolist())),
        tuple(c[-1].tolist()),
        Powers(wiener, spec.degree, x_lin).updated(x_lin, c[-1:], 0.0, constants).x[:, 0],
        run.phi[0],
        int(run.iterations[0]),
        _history(wiener, run, dict(zip(spec.coefficients(), c.T, strict=True))),
        float(constants[0]) if wiener.constant else None,
    )


def _run(wiener: Wiener, begin: Callable[[Array], Internal], rule: Rule) -> Iterates:
    """The one iteration from x = y or, if that ends badly or wanders, from the linear model's output.

    Where the output has a constant, y is far from x, and the linear model's output is the first.

    Raises
    ------
    EstimationError
        If both end badly.
    """
    starts = [lambda: wiener.y, wiener.linear_output]
    first, other = reversed(starts) if wiener.constant else starts
    found = iterate(wiener, begin(first()), rule)
    trouble = _trouble(wiener, found)
    if found.converged[0] and not trouble:
        return found
    again = iterate(wiener, begin(other()), rule)
    wrong = _trouble(wiener, again)
    if wrong and trouble:
        raise EstimationError(
            f"the first stage's iteration {wrong}, also from the linear model's output: "
            "try longer horizons, another structure or other partition points"
        )
    # If both wander, the first counts.
    return found if wrong or not (trouble or again.converged[0]) else again


def _trouble(wiener: Wiener, found: Iterates) -> str:
    """What is wrong with the end of the only iteration; empty if nothing is."""
    theta = found.theta
    if not np.all(np.isfinite(theta)):
        return "met linearly dependent regressors or diverged"
    if np.std(wiener.internal(theta)) < _TRIVIAL * np.std(wiener.y):
        return "fell to the trivial solution x = 0"
    if found.admissible[0]:
        return ""
    stable = np.all(time_constants(wiener.split(theta)[0]).real > 0.0)
    return "ended in " + ("slopes e_i that are not all positive" if stable else "an unstable linear block")


def search_partition(
    wiener: Wiener, rule: Rule, start: float, points: int = 8, refinements: int = 2
) -> PartitionSearch:
    """The partition points that minimise the output error (31), on a grid that is refined.

    The grid, of ``points`` of either sign, lies at Chebyshev points of the output's range on either side of
    zero, dense towards zero and the ends. A refinement tries the neighbours of the best pair at half the
    distance. Pairs that end in an unstable block or a slope e_i that is not positive are rejected. If no
    other pair converges, the search starts again on a grid twice as fine, its iterations from the linear
    model's output; where the output has a constant, all begin there. Of pairs that tie the first counts, and
    pairs that have not converged count if no pair has.

    Raises
    ------
    EstimationError
        If the output has no values of either sign, or all pairs are rejected.
    """
    ends = np.array([wiener.y.min(), wiener.y.max()])
    require_inside("search", wiener.y, "output")
    rule, scale = replace(rule, patience=_PATIENCE), wiener.dt * float(wiener.y @ wiener.y)
    wandering = None
    linear = wiener.linear_output()
    for count, x in ((points, linear if wiener.constant else wiener.y), (2 * points, linear)):
        grid = 0.5 * np.pi * np.arange(1, count + 1) / (count + 1)
        tried = _tried(wiener, rule, start, ends, _pairs(grid[::-1], grid), x)
        if np.any(tried.converged):
            break
        if wandering is None and np.any(np.isfinite(tried.loss)):
            wandering = count, x, grid, tried
    else:
        if wandering is None:
            raise EstimationError(
                "no pair of partition points gives a stable linear block and rising segments"
            )
        count, x, grid, tried = wandering
    first, step = tried.loss, 0.5 * np.pi / (count + 1)
    for _ in range(refinements):
        step /= 2.0
        centre = tried.angles[:, best_pair(tried.loss, tried.converged, scale), None]
        near = _pairs(*(centre + step * np.arange(-1.0, 2.0)))
        near = near[:, np.all((near > 0.0) & (near < 0.5 * np.pi), axis=0)]
        tried = tried.joined(_tried(wiener, rule, start, ends, near, x))
    best = best_pair(tried.loss, tried.converged, scale)
    lower, upper = _points(ends, np.array([grid[::-1], grid]))
    below, above = _points(ends, tried.angles[:, best]).tolist()
    return PartitionSearch(lower, upper, first.reshape(count, count), (below, above), float(tried.loss[best]))


def _pairs(lower: ArrayLike, upper: ArrayLike) -> Array:
    """All pairs of a value of ``lower`` (L,) and one of ``upper`` (U,), shape (2, L U)."""
    return np.reshape(np.meshgrid(lower, upper, indexing="ij"), (2, -1))


def _points(ends: Array, angles: Array) -> Array:
    """The partition points at ``angles`` (2, ...) between 0 and pi/2, from zero to the ``ends`` (2,)."""
    return np.asarray((ends * np.sin(angles.T) ** 2).T)


@dataclass(frozen=True, eq=False)
class _Tried:
    """Pairs of partition points at the ``angles`` (2, J).

    ``loss`` (J,) is the criterion (31), nan where the pair was rejected; ``converged`` (J,) holds of the
    others whose iteration did.
    """

    angles: Array
    loss: Array
    converged: Flags

    def joined(self, other: _Tried) -> _Tried:
        """These pairs, then the others."""
        return _Tried(
            np.hstack((self.angles, other.angles)),
            np.append(self.loss, other.loss),
            np.append(self.converged, other.converged),
        )


def _tried(wiener: Wiener, rule: Rule, start: float, ends: Array, angles: Array, x: Array) -> _Tried:
    at_once = max(1, _AT_ONCE // len(x))
    pieces = [angles[:, i : i + at_once] for i in range(0, angles.shape[1], at_once)]
    found = [_some_losses(wiener, rule, start, _points(ends, piece), x) for piece in pieces]
    loss, converged = (np.concatenate(part) for part in zip(*found, strict=True))
    return _Tried(angles, loss, converged)


def _some_losses(wiener: Wiener, rule: Rule, start: float, points: Array, x: Array) -> tuple[Array, Flags]:
    found = iterate(wiener, FourSegments.of_points(wiener, points, x), rule)
    sound = found.admissible
    theta = found.theta[sound]
    e = 1.0 - wiener.split(theta)[2]
    first = round(start / wiener.dt)
    parts = longer_than(wiener.horizons.parts, first)
    x, y = (in_each(parts, lambda part: part[first:], one) for one in (wiener.internal(theta), wiener.y))
    output = forward(x, e.T, *points[:, sound]) + wiener.constants(theta)
    losses = np.full(len(sound), np.nan)
    losses[sound] = wiener.dt * np.sum((y[:, None] - output) ** 2, axis=0)
    return losses, found.converged & np.isfinite(losses)
