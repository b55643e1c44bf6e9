"""Levenberg and Marquardt's method on a chain of blocks, with the linear coefficients projected out.

Columns have length one, so that no unit matters. Directions that change nothing (a factor between two blocks)
are left out of each step, which fixes them without a rule. Steps are bent by their geodesic acceleration
(Transtrum and Sethna 2012, arXiv:1201.5885, eq. (12)). Where noise is left, Gauss and Newton's steps shrink
by a constant factor only; near the end they are mixed (Anderson 1965, J. ACM 12, 547).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hident.arrays import Array
from hident.estimators.prediction_error.criterion import FREE, Point

Status = Literal["converged", "stalled", "exhausted"]
"""How it ended: at rest, no step lowers the loss, or no iteration is left."""

_FIRST_DAMPING, _LEAST_DAMPING = 1e-5, 1e-12
# At rest, a step promises to change the model by less than this part of a parameter's variance.
_OF_STANDARD_ERROR = 1e-3
# Less than this of the output's energy is rounding.
_ROUNDING = 1e-26
# How far ahead the second derivative along a step is looked for, relative to the step.
_AHEAD = 0.1
# A longer bend than this part of the step: the second order says nothing.
_LONGEST_BEND = 0.75
# The end is near where a step promises less than this part of the loss; so many steps are mixed.
_NEAR, _MIXED = 1e-3, 4
# A mixed step must keep this part of what the plain one promises.
_KEPT = 0.5


@dataclass(frozen=True, eq=False)
class Descent:
    """Where it ended, and how; ``evaluations`` counts the models that were tried."""

    point: Point
    status: Status
    iterations: int
    evaluations: int


def descend(point: Point, max_iterations: int, damping: float = _FIRST_DAMPING) -> Descent:
    """Minimise the sum of squared prediction errors from a point.

    ``damping`` is that of the first step, for columns of length one: with little, a search from near the end
    is soon there.
    """
    evaluations, iterations = 0, 0
    steps: deque[tuple[Array, Array]] = deque(maxlen=_MIXED + 1)
    nothing = _ROUNDING * float(point.data.y @ point.data.y)
    while True:
        normal = _Normal.of(point)
        promised = normal.promised(0.0)
        enough = max(_OF_STANDARD_ERROR * point.loss / point.data.count, nothing)
        if promised <= enough:
            return Descent(point, "converged", iterations, evaluations)
        if iterations == max_iterations:
            return Descent(point, "exhausted", iterations, evaluations)
        iterations += 1
        step, _ = normal.step(damping)
        steps.append((point.theta, step))
        if len(steps) > 2 and promised < _NEAR * point.loss:
            evaluations += 1
            new = point.moved(_mixture(steps, normal.sizes[: len(step)]))
            if new is not None and point.loss - new.loss > _KEPT * promised:
                point, damping = new, max(damping / 5.0, _LEAST_DAMPING)
                continue
        tried, growth = 0, 2.0
        while True:
            evaluations += 1
            new = point.moved(point.theta + _bent(point, normal, damping))
            if new is not None and new.loss < point.loss:
                damping = max(damping / 5.0, _LEAST_DAMPING) if tried == 0 else damping
                point = new
                break
            tried, damping, growth = tried + 1, damping * growth, growth * 2.0
            # At a kink no step lowers the loss, and what a shorter one promises is soon nothing.
            if normal.promised(damping) <= enough:
                return Descent(point, "stalled", iterations, evaluations)


def _mixture(steps: deque[tuple[Array, Array]], sizes: Array) -> Array:
    """Anderson's mixture of the points (P,) and their steps (P,), each measured by what it changes."""
    points, moves = (np.array(values) for values in zip(*steps, strict=True))
    apart, bends = np.diff(points, axis=0), np.diff(moves, axis=0)
    weights = np.linalg.lstsq((bends * sizes).T, moves[-1] * sizes, rcond=1e-8)[0]
    return np.asarray(points[-1] + moves[-1] - weights @ (apart + bends))


def _bent(point: Point, normal: _Normal, damping: float) -> Array:
    """The step (P,) with its geodesic acceleration."""
    step, solved = normal.step(damping)
    ahead = point.prediction(point.theta + _AHEAD * step, _AHEAD * solved)
    if ahead is None:
        return step
    straight = _AHEAD * (normal.rows.T @ np.concatenate((step, solved)))
    curvature = (2.0 / _AHEAD**2) * (ahead - (point.counted_output - point.residuals) - straight)
    bend = normal.bend(curvature, damping)
    lengths = normal.lengths[: len(step)]
    return step + bend if norm(bend * lengths) <= _LONGEST_BEND * norm(step * lengths) else step


def norm(values: Array) -> float:
    """The Euclidean length."""
    return float(np.linalg.norm(values))


@dataclass(frozen=True, eq=False)
class _Normal:
    """The normal equations of the steps, in the directions that change the output.

    ``rows`` (P + K, M) are the derivatives by theta and by the coefficients that are solved for, ``sizes``
    their lengths, ``lengths`` the same with 1 for one that is nothing; ``root`` (K, R) and ``shared`` (P, R)
    say what the latter take over of the former. ``values`` and ``vectors`` are of the P x P matrix that is
    left, ``right`` is the gradient along them.
    """

    rows: Array
    sizes: Array
    lengths: Array
    root: Array
    shared: Array
    values: Array
    vectors: Array
    right: Array

    @classmethod
    def of(cls, point: Point) -> _Normal:
        rows, count = point.rows(), len(point.theta)
        normal = rows @ rows.T
        sizes = np.sqrt(np.diag(normal))
        lengths = np.where(sizes > 0.0, sizes, 1.0)
        normal /= np.outer(lengths, lengths)
        root = _inverse_root(normal[count:, count:])
        shared = normal[:count, count:] @ root
        values, vectors = np.linalg.eigh(normal[:count, :count] - shared @ shared.T)
        # Columns have length one: what is far below one is nothing, also where all of it was taken over.
        known = values > FREE * np.max(values, initial=FREE)
        right = rows @ point.residuals / lengths
        reduced = right[:count] - shared @ (root.T @ right[count:])
        vectors = vectors[:, known]
        return cls(rows, sizes, lengths, root, shared, values[known], vectors, vectors.T @ reduced)

    def promised(self, damping: float) -> float:
        """By how much a linear model says that the step lowers the loss."""
        return float(np.sum(self.right**2 * (self.values + 2.0 * damping) / (self.values + damping) ** 2))

    def step(self, damping: float) -> tuple[Array, Array]:
        """The step (P,), without a part along what is free, and that of the solved coefficients (K,)."""
        step = self.vectors @ (self.right / (self.values + damping))
        count = len(step)
        return step / self.lengths[:count], -(self.root @ (self.shared.T @ step)) / self.lengths[count:]

    def bend(self, curvature: Array, damping: float) -> Array:
        """Half the step (P,) that takes back what the second derivative (M,) along the step adds."""
        gradient = self.rows @ curvature / self.lengths
        count = len(self.vectors)
        reduced = gradient[:count] - self.shared @ (self.root.T @ gradient[count:])
        along = (self.vectors.T @ reduced) / (self.values + damping)
        return -0.5 * (self.vectors @ along) / self.lengths[:count]


def _inverse_root(matrix: Array) -> Array:
    """R (K, rank) with R R^T the pseudoinverse of a symmetric matrix (K, K) of unit diagonal."""
    if not len(matrix):
        return np.zeros((0, 0))
    values, vectors = np.linalg.eigh(matrix)
    known = values > FREE * values[-1]
    return np.asarray(vectors[:, known] / np.sqrt(values[known]))
