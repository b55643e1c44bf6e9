"""Structured output-error fits of continuous-time Hammerstein and Wiener models by Gauss-Newton.

======  =====================================================================================
A, B    1 + a_1 s + ... + a_n s^n and b_0 + b_1 s + ... + b_m s^m; the block is B e^(-ds) / A
c       coefficients of the nonlinearity in a given basis (Hammerstein), where b_0 = 1
e       slopes e_-2, e_-1, e_2 of the inverse nonlinearity (Wiener), where e_1 = 1
J       derivative of the output by all parameters, shape (N, P)
======  =====================================================================================

Beyond Chen, Hwang and Chang 2009, whose regression equations weigh the noise as the integral transform
does: for white noise at the output, the minimum of the squared output error is the efficient estimate. It
needs a start near it, such as theirs. Equation numbers are those of their paper.

The criterion of a Wiener model has kinks where a sample of x lies on a bend of f. A minimum on a kink has no
derivative that vanishes: the step does not shrink, and the criterion rises along it both ways. It is a
minimum all the same, and so is accepted where the step is short; that the iteration stalled is said.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hident.errors import EstimationError
from hident.estimators.base import require_finite
from hident.estimators.bilinear_models.bilinear import lengths
from hident.estimators.moving_horizon.four_segment import (
    FourSegment,
    forward,
    forward_by_slopes,
    forward_slope,
)
from hident.estimators.moving_horizon.linear_transform import responses_in
from hident.estimators.nonparametric.least_squares import ILL_CONDITIONED
from hident.numerics.parts import Parts
from hident.records import Array
from hident.systems.continuous import ContinuousTransferFunction

_HALVINGS = 30
_MAX_ITERATIONS = 100
_RESTS = 1e-4
"""Length of a step, in standard errors, up to which it does not matter."""
_STALLS = 0.5
"""The same where the minimum lies on a kink of the criterion."""
_ROUNDING = 1e-12
"""Length of a step, as a change of the output relative to it, up to which it is rounding."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """A structured output-error fit.

    ``coefficients`` are c (J,) or e_-2, e_-1, e_2; ``covariance`` (P, P) is that of a_1, ..., a_n, of b_1,
    ..., b_m (Hammerstein) or b_0, ..., b_m (Wiener), then of the coefficients; ``variance`` is the noise's.
    ``left`` is the length of the step that is left at the end, in standard errors; ``stalled`` says that the
    iteration ended on a kink of the criterion, where it is no measure of the distance to the minimum.
    """

    block: ContinuousTransferFunction
    coefficients: Array
    covariance: Array
    variance: float
    iterations: int
    left: float
    stalled: bool

    @property
    def standard_errors(self) -> Array:
        """Those of the parameters in the order of ``covariance``, shape (P,)."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, eq=False)
class _Solved:
    """A linear least squares problem solved: Q'y (P,), and R^-1 (P, P) for columns = Q R."""

    projected: Array
    inverse: Array

    @property
    def solution(self) -> Array:
        return self.inverse @ self.projected


@dataclass(frozen=True, eq=False)
class _Point:
    """A model: the residuals (N,) and J (N, P) at ``theta``, and the coefficients of the nonlinearity."""

    theta: Array
    coefficients: Array
    residuals: Array
    jacobian: Array

    @property
    def loss(self) -> float:
        return float(self.residuals @ self.residuals)

    @property
    def variance(self) -> float:
        rows, columns = self.jacobian.shape
        spare: int = rows - columns
        return self.loss / spare


_Model = Callable[[Array], _Point | None]
"""The model at ``theta``, None where there is none: an unstable block, a slope that is not positive."""


def sensitivities(
    block: ContinuousTransferFunction, x: Array, dt: float, parts: Parts | None = None
) -> Array:
    """The derivatives of ``block.respond(x, dt)`` by a_1, ..., a_n, b_0, ..., b_m, shape (N, n + m + 1).

    Each experiment begins at rest; ``parts`` say where they stand, one by default.

    They are responses to the held input ``x`` (N,) themselves, of -s^i B/A^2 and of s^i/A, and as exact.
    """
    denominator = (1.0, *block.a)
    square = tuple(np.convolve(denominator, denominator)[1:].tolist())
    falling = tuple(-b for b in block.b)
    by_a = [
        ContinuousTransferFunction((0.0,) * i + falling, square, block.delay)
        for i in range(1, len(denominator))
    ]
    by_b = [
        ContinuousTransferFunction((0.0,) * i + (1.0,), block.a, block.delay) for i in range(len(block.b))
    ]
    return np.column_stack([responses_in(parts, derivative, x, dt) for derivative in (*by_a, *by_b)])


def _solved(columns: Array, y: Array) -> _Solved:
    if len(columns) <= columns.shape[1]:
        raise EstimationError(f"{len(columns)} samples cannot determine {columns.shape[1]} parameters")
    length = lengths(columns)
    q, r = np.linalg.qr(columns / length)
    singular_values = np.linalg.svd(r, compute_uv=False)
    if singular_values[-1] * ILL_CONDITIONED <= singular_values[0]:
        raise EstimationError(
            f"the output does not tell the {columns.shape[1]} parameters apart: the input varies too little, "
            "an order is too high, or a segment holds too few samples"
        )
    return _Solved(q.T @ y, np.linalg.solve(r, np.eye(len(r))) / length[:, None])


def _stable(a: Array, b: Array, delay: float) -> ContinuousTransferFunction | None:
    # All a_i > 0 is necessary.
    if not np.all(a > 0.0):
        return None
    block = ContinuousTransferFunction(tuple(b.tolist()), tuple(a.tolist()), delay)
    return block if block.is_stable() else None


def _descended(model: _Model, current: _Point, step: Array) -> _Point | None:
    """The first model along the halved steps that has a lower loss."""
    for halving in range(_HALVINGS):
        new = model(current.theta + 0.5**halving * step)
        if new is not None and new.loss < current.loss:
            return new
    return None


@dataclass(frozen=True, eq=False)
class _End:
    """Where an iteration ended: see :class:`Refinement`."""

    point: _Point
    covariance: Array
    iterations: int
    left: float
    stalled: bool


def _gauss_newton(model: _Model, theta: Array, size: float, *, kinks: bool) -> _End:
    """Minimise the squared residuals from ``theta`` (p,) for an output of norm ``size``.

    Further columns of J belong to parameters that the model solves for, and the step is then that of variable
    projection in Kaufman's form. ``kinks`` says that the criterion may have some.
    """
    current = model(theta)
    if current is None:
        raise EstimationError("the start is unstable, or a slope is not positive")
    for iteration in range(_MAX_ITERATIONS):
        solved = _solved(current.jacobian, current.residuals)
        step = solved.solution[: len(theta)]
        length, error = float(np.linalg.norm(solved.projected)), float(np.sqrt(current.variance))
        rests = length <= max(_RESTS * error, _ROUNDING * size)
        new = None if rests else _descended(model, current, step)
        if new is None:
            stalled = not rests
            if stalled and not (
                kinks and length <= _STALLS * error and _descended(model, current, -step) is None
            ):
                raise EstimationError(f"no step lowers the output error after {iteration} steps")
            covariance = current.variance * solved.inverse @ solved.inverse.T
            left = length / error if error else 0.0
            return _End(current, covariance, iteration, left, stalled)
        current = new
    raise EstimationError(f"the output error did not settle in {_MAX_ITERATIONS} steps")


def _refinement(block: ContinuousTransferFunction | None, end: _End) -> Refinement:
    assert block is not None  # it is that of a model
    point = end.point
    return Refinement(
        block, point.coefficients, end.covariance, point.variance, end.iterations, end.left, end.stalled
    )


def refine_hammerstein(
    basis_values: Array,
    y: Array,
    block: ContinuousTransferFunction,
    dt: float,
    parts: Parts | None = None,
) -> Refinement:
    """Fit y = B e^(-ds)/A sum_j c_j phi_j(u) + white noise, with b_0 = 1.

    Parameters
    ----------
    basis_values : array, shape (N, J)
        The basis functions phi_j of the held input.
    y : array, shape (N,)
        The output; the system is at rest before the first sample of each experiment.
    block : ContinuousTransferFunction
        The start, with b_0 other than zero; its delay is kept.
    dt : float
        Sampling interval.
    parts : sequence of slices, optional
        Where the experiments stand; one by default.

    Returns
    -------
    Refinement
        With J coefficients c.

    Raises
    ------
    EstimationError
        If the start is unstable or has no static gain, the parameters cannot be told apart, or the
        iteration does not settle.
    """
    require_finite(y)
    if block.b[0] == 0.0:
        raise EstimationError("the start has no static gain: its b_0 is zero")
    n = len(block.a)

    def unpacked(theta: Array) -> ContinuousTransferFunction | None:
        return _stable(theta[:n], np.concatenate(([1.0], theta[n:])), block.delay)

    def model(theta: Array) -> _Point | None:
        at = unpacked(theta)
        if at is None:
            return None
        responses = np.column_stack([responses_in(parts, at, phi, dt) for phi in basis_values.T])
        c = _solved(responses, y).solution
        outer = np.delete(sensitivities(at, basis_values @ c, dt, parts), n, axis=1)
        return _Point(theta, c, y - responses @ c, np.hstack([outer, responses]))

    start = np.concatenate((block.a, np.array(block.b[1:]) / block.b[0]))
    end = _gauss_newton(model, start, float(np.linalg.norm(y)), kinks=False)
    return _refinement(unpacked(end.point.theta), end)


def refine_wiener(
    u: Array,
    y: Array,
    block: ContinuousTransferFunction,
    nonlinearity: FourSegment,
    dt: float,
    parts: Parts | None = None,
) -> Refinement:
    """Fit y = f(B e^(-ds)/A u) + white noise, f being the four-segment function of eq. (32).

    Parameters
    ----------
    u, y : array, shape (N,)
        The held input, and the output; the system is at rest before the first sample of each experiment.
    block : ContinuousTransferFunction
        The start; its delay is kept.
    nonlinearity : FourSegment
        The start, with the gain 1; its partition points are kept.
    dt : float
        Sampling interval.
    parts : sequence of slices, optional
        Where the experiments stand; one by default.

    Returns
    -------
    Refinement
        With the coefficients e_-2, e_-1, e_2.

    Raises
    ------
    EstimationError
        If the start is unstable or has a slope that is not positive, the parameters cannot be told apart, or
        the iteration does not settle.
    """
    require_finite(y)
    n, p = len(block.a), len(block.a) + len(block.b)
    points = nonlinearity.lower, nonlinearity.upper

    def model(theta: Array) -> _Point | None:
        at, e = _stable(theta[:n], theta[n:p], block.delay), theta[p:]
        if at is None or not np.all(e > 0.0):
            return None
        x = responses_in(parts, at, u, dt)
        by_block = forward_slope(x, e, *points)[:, None] * sensitivities(at, u, dt, parts)
        jacobian = np.hstack([by_block, forward_by_slopes(x, e, *points)])
        return _Point(theta, e, y - forward(x, e, *points), jacobian)

    start = np.array([*block.a, *block.b, *nonlinearity.e])
    end = _gauss_newton(model, start, float(np.linalg.norm(y)), kinks=True)
    return _refinement(_stable(end.point.theta[:n], end.point.theta[n:p], block.delay), end)
