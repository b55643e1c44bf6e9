"""The first stage of the two-stage algorithm for Hammerstein models: the static function.

Chen, Hwang and Chang 2009, section 4.4 (stage 1) and the search for partition points of section 5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from hident.arrays import Array, Flags
from hident.config.spec import Count, Spec
from hident.errors import EstimationError
from hident.estimators.convergence import History
from hident.estimators.moving_horizon.hammerstein.iteration import Iteration, iterate
from hident.estimators.moving_horizon.hammerstein.static_functions import (
    PolynomialFunction,
    ThreeSegmentFunction,
    powers,
    three_segments,
)
from hident.estimators.moving_horizon.partition import Partition, require_inside
from hident.estimators.moving_horizon.searches import PartitionSearch, best_pair
from hident.estimators.moving_horizon.transform.linear_transform import StageSpec, block_of
from hident.estimators.moving_horizon.transform.time_weighted import Horizons, Knots
from hident.linear_blocks import ContinuousTransferFunction
from hident.numerics.parts import Parts

StaticFunction = PolynomialFunction | ThreeSegmentFunction

# Offsets of a refinement, in steps of the grid before it.
_FINER = np.array([-0.5, -0.25, 0.0, 0.25, 0.5])
# Levels times partition pairs that the search evaluates at once.
_AT_ONCE = 2**17


class Polynomial(Spec):
    """A polynomial without constant term (2)."""

    kind: Literal["polynomial"]
    """The kind."""
    degree: Annotated[Count, Field(ge=1, le=20)]
    """Degree p."""

    @property
    def size(self) -> int:
        """The number of coefficients."""
        return self.degree


class ThreeSegment(Spec):
    """A cubic between two partition points and straight lines beyond (4)."""

    kind: Literal["three_segment"]
    """The kind."""
    partition: Partition = "search"
    """Partition points [u_-1, u_1], or search for those that minimise (30)."""
    points: Annotated[Count, Field(ge=2)] = 12
    """Partition points of either sign that the search tries, evenly spaced over the input's range."""
    refinements: Annotated[Count, Field(ge=0)] = 1
    """Refinements of the search around the best pair, each on a grid four times as fine."""

    size: ClassVar[int] = 5


@dataclass(frozen=True, eq=False)
class FirstStage:
    """What the first stage found.

    ``phi`` (N, P) are the regressors of the last iteration; ``jacobian`` (N, P) also counts what the
    coefficients c_j do to the internal variable; the last are those of the output's ``constant``, None if
    that is not estimated. ``partition`` is the search for partition points.
    """

    function: StaticFunction
    block: ContinuousTransferFunction
    phi: Array
    jacobian: Array
    horizons: Horizons
    knots: Knots
    iteration: Iteration
    partition: PartitionSearch | None
    constant: float | None = None

    @property
    def regressors(self) -> Array:
        """Those of the block and the static function."""
        return self.phi if self.constant is None else self.phi[:, :-1]

    def history(self) -> History:
        """The parameters against the iteration."""
        n = len(self.block.a)
        a, b, c = np.split(self.iteration.history, [n, n + len(self.block.b) - 1], axis=1)
        size = len(self.function.c)
        coefficients = {f"c_{j}": one for j, one in enumerate(c.T[:size], start=1)}
        if self.constant is not None:
            coefficients["constant"] = c[:, size]
        converged = bool(self.iteration.converged[0])
        return History(a, np.insert(b, 0, 1.0, axis=1), coefficients, converged)


def first_stage(
    u: Array,
    y: Array,
    dt: float,
    nonlinearity: Polynomial | ThreeSegment,
    stage: StageSpec,
    *,
    delay: float,
    start: float,
    tolerance: float,
    max_iterations: int,
    constant: bool = False,
    parts: Parts | None = None,
) -> FirstStage:
    """Stage 1 from a held input ``u`` (N,) and the output ``y`` (N,), of one experiment or several ``parts``.

    ``constant`` says whether one is added to the output. It is a function beside those of the input that is 1
    and passes the block, whose static gain is 1, as it is.

    Raises
    ------
    EstimationError
        If the regression is singular, or the input does not suit the partition points.
    ValueError
        If the horizons do not suit the record.
    """
    horizons = stage.horizons(len(u), dt, start, stage.n + stage.m + nonlinearity.size + constant, parts)
    knots = Knots.of(u, delay, dt, parts)
    output = horizons.transform(horizons.sampled(knots), y)
    # The input's transforms are sums over the levels that it is held at, of which there are few.
    operator, levels = horizons.held_runs(u, delay, stage.m + 1)
    identity = horizons.transform(operator, levels)

    def iterated(functions: Array) -> tuple[Array, Iteration]:
        """The transforms (B, m + 1, N, p) of functions (levels, B, p), and the iteration with them."""
        count, size = functions.shape[1:]
        basis = horizons.transform(operator, functions.reshape(len(levels), -1))
        basis = basis.reshape(stage.m + 1, horizons.count, count, size).transpose(2, 0, 1, 3)
        if constant:
            one = np.zeros((*basis.shape[:-1], 1))
            one[:, 0, :, 0] = horizons.constant
            basis = np.concatenate((basis, one), axis=-1)
        found = iterate(
            output, basis, identity, m=stage.m, tolerance=tolerance, max_iterations=max_iterations
        )
        return basis, found

    partition, build = None, _polynomial
    if isinstance(nonlinearity, Polynomial):
        functions = powers(levels, nonlinearity.degree)
    else:
        require_inside(nonlinearity.partition, u, "input")
        if nonlinearity.partition == "search":
            scale = float(output[0] @ output[0])
            partition = _search(levels, nonlinearity, lambda functions: iterated(functions)[1], scale)
            lower, upper = partition.best
        else:
            lower, upper = nonlinearity.partition
        functions = three_segments(levels, lower, upper)
        build = partial(_three_segment, lower=lower, upper=upper)
    (basis,), iteration = iterated(functions[:, None])
    theta, n = iteration.theta[0], stage.n
    a, b, c = theta[:n], theta[n : n + stage.m], theta[n + stage.m :]
    block = block_of(a, [1.0, *b], delay)
    derivatives = basis @ c
    phi = np.column_stack((*-output[1:], *derivatives[1:], basis[0]))
    jacobian = phi.copy()
    jacobian[:, n + stage.m :] += np.einsum("mkp,m->kp", basis[1:], b)
    c, k = (c[:-1], float(c[-1])) if constant else (c, None)
    return FirstStage(build(c), block, phi, jacobian, horizons, knots, iteration, partition, k)


def _polynomial(c: Array) -> StaticFunction:
    return PolynomialFunction(tuple(c.tolist()))


def _three_segment(c: Array, lower: float, upper: float) -> StaticFunction:
    return ThreeSegmentFunction(tuple(c.tolist()), lower, upper)


def _search(
    levels: Array, spec: ThreeSegment, iterated: Callable[[Array], Iteration], scale: float
) -> PartitionSearch:
    """The partition points that minimise (30), on a grid over the input's range and finer ones around.

    The first of the pairs that tie counts, and pairs whose iteration has not converged only if all have not.
    ``scale`` is the criterion of the model zero.

    Raises
    ------
    EstimationError
        If every pair gives a singular regression.
    """
    low, high = float(levels.min()), float(levels.max())

    def evaluated(lower: Array, upper: Array) -> tuple[Array, Flags]:
        # Long records are searched in pieces, so that memory does not grow with the number of pairs.
        pieces = min(len(lower), -(-len(levels) * len(lower) * len(upper) // _AT_ONCE))
        loss, converged = [], []
        for some in np.array_split(lower, pieces):
            pairs = np.meshgrid(some, upper, indexing="ij")
            functions = three_segments(levels[:, None, None], *pairs).reshape(len(levels), -1, spec.size)
            found = iterated(functions)
            loss.append(found.loss)
            converged.append(found.converged)
        shape = len(lower), len(upper)
        every = np.concatenate(loss).reshape(shape)
        return np.where(np.isfinite(every), every, np.nan), np.concatenate(converged).reshape(shape)

    inner = np.arange(1, spec.points + 1) / (spec.points + 1)
    lower, upper = low * inner, high * inner
    loss, converged = evaluated(lower, upper)
    first = loss
    grid = (lower, upper)
    steps = -low / (spec.points + 1), high / (spec.points + 1)
    for refinement in range(spec.refinements + 1):
        if not np.any(np.isfinite(loss)):
            raise EstimationError("no partition points give a regression that is not singular")
        i, j = np.unravel_index(best_pair(loss, converged, scale), loss.shape)
        best, least = (float(lower[i]), float(upper[j])), float(loss[i, j])
        if refinement < spec.refinements:
            finer = _FINER / 4.0**refinement
            lower, upper = best[0] + steps[0] * finer, best[1] + steps[1] * finer
            loss, converged = evaluated(lower, upper)
    return PartitionSearch(*grid, first, best, least)
