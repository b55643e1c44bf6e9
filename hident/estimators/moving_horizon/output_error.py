"""Structured output-error fits of continuous-time Hammerstein and Wiener models by Gauss-Newton.

======  =====================================================================================
A, B    1 + a_1 s + ... + a_n s^n and b_0 + b_1 s + ... + b_m s^m; the block is B e^(-ds) / A
c       coefficients of the nonlinearity in a given basis (Hammerstein), where b_0 = 1
e       slopes e_-2, e_-1, e_2 of the inverse nonlinearity (Wiener), where e_1 = 1
k       constant of the output, if there is one
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
from functools import cached_property

import numpy as np

from hident.arrays import Array
from hident.errors import EstimationError
from hident.estimators.base import require_finite
from hident.estimators.moving_horizon.transform.linear_transform import responses_in
from hident.estimators.moving_horizon.wiener.four_segment import (
    FourSegment,
    forward,
    forward_by_slopes,
    forward_slope,
)
from hident.linear_blocks import ContinuousTransferFunction
from hident.numerics.gauss_newton import descended, gauss_newton
from hident.numerics.least_squares import Factorisation
from hident.numerics.parts import Parts, in_each, whole

_MAX_ITERATIONS = 100
_DEPENDENT = (
    "the output does not tell the {} parameters apart: the input varies too little, an order is too high, "
    "or a segment holds too few samples"
)
_RESTS = 1e-4
"""Length of a step, in standard errors, up to which it does not matter."""
_STALLS = 0.5
"""The same where the minimum lies on a kink of the criterion."""
_ROUNDING = 1e-12
"""Length of a step, as a change of the output relative to it, up to which it is rounding."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """A structured output-error fit.

    ``coefficients`` are c (J,) or e_-2, e_-1, e_2, then k; ``standard_errors`` (P,) are those of a_1, ...,
    a_n, of b_1, ..., b_m (Hammerstein) or b_0, ..., b_m (Wiener), then of the coefficients. ``left`` is the
    length of the step that is left at the end, in standard errors; ``stalled`` says that the iteration ended
    on a kink of the criterion, where it is no measure of the distance to the minimum.
    """

    block: ContinuousTransferFunction
    coefficients: Array
    standard_errors: Array
    iterations: int
    left: float
    stalled: bool


@dataclass(frozen=True, eq=False)
class _Point:
    """A model: the residuals (N,) and J (N, P) at ``theta``, its block, and the nonlinearity's coefficients.

    Of most models that a halved step tries, only the loss is asked for: ``derivatives`` gives J.
    """

    theta: Array
    block: ContinuousTransferFunction
    coefficients: Array
    residuals: Array
    derivatives: Callable[[], Array]

    @cached_property
    def jacobian(self) -> Array:
        return self.derivatives()

    @cached_property
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
    by_a = [(0.0,) * i + falling for i in range(1, len(denominator))]
    by_b = [(0.0,) * i + (1.0,) for i in range(len(block.b))]
    twice = ContinuousTransferFunction(by_a[0], square, block.delay)

    def build(held_input: Array) -> Array:
        return np.hstack([twice.responses(by_a, held_input, dt), block.responses(by_b, held_input, dt)])

    return in_each(parts or whole(len(x)), build, x)


def _factored(columns: Array) -> Factorisation:
    if len(columns) <= columns.shape[1]:
        raise EstimationError(f"{len(columns)} samples cannot determine {columns.shape[1]} parameters")
    factors = Factorisation.of(columns)
    if factors.is_dependent:
        raise EstimationError(_DEPENDENT.format(columns.shape[1]))
    return factors


def _stable(a: Array, b: Array, delay: float) -> ContinuousTransferFunction | None:
    # All a_i > 0 is necessary.
    if not np.all(a > 0.0):
        return None
    block = ContinuousTransferFunction(tuple(b.tolist()), tuple(a.tolist()), delay)
    return block if block.is_stable() else None


def _minimised(model: _Model, theta: Array, size: float, *, kinks: bool) -> Refinement:
    """Minimise the squared residuals from ``theta`` (p,) for an output of norm ``size``.

    ``kinks`` says that the criterion may have some.
    """
    current = model(theta)
    if current is None:
        raise EstimationError("the start is unstable, or a slope is not positive")
    rows, columns = current.jacobian.shape
    if rows <= columns:
        raise EstimationError(f"{rows} samples cannot determine {columns} parameters")

    def moved(point: _Point, step: Array) -> _Point | None:
        return model(point.theta + step[: len(theta)])

    found = gauss_newton(
        current,
        moved,
        lambda point, length: length <= max(_RESTS * float(np.sqrt(point.variance)), _ROUNDING * size),
        max_iterations=_MAX_ITERATIONS,
    )
    point, factors = found.point, found.factors
    error = float(np.sqrt(point.variance))
    match found.status:
        case "singular":
            raise EstimationError(_DEPENDENT.format(columns))
        case "exhausted":
            raise EstimationError(f"the output error did not settle in {_MAX_ITERATIONS} steps")
        case "stalled":
            back = -factors.solution(point.residuals)
            on_a_kink = kinks and found.length <= _STALLS * error and descended(point, back, moved)[0] is None
            if not on_a_kink:
                raise EstimationError(f"no step lowers the output error after {found.iterations} steps")
    root = factors.inverse_root
    errors = np.sqrt(np.diag(point.variance * root @ root.T))
    left = found.length / error if error else 0.0
    return Refinement(
        point.block, point.coefficients, errors, found.iterations, left, found.status == "stalled"
    )


def refine_hammerstein(
    basis_values: Array,
    y: Array,
    block: ContinuousTransferFunction,
    dt: float,
    parts: Parts | None = None,
    *,
    constant: bool = False,
) -> Refinement:
    """Fit y = B e^(-ds)/A sum_j c_j phi_j(u) + k + white noise, with b_0 = 1.

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
    constant : bool
        Whether k is estimated; else it is zero.

    Returns
    -------
    Refinement
        With J coefficients c, and k.

    Raises
    ------
    EstimationError
        If the start is unstable or has no static gain, the parameters cannot be told apart, or the
        iteration does not settle.
    """
    require_finite(y)
    if block.static_gain() == 0.0:
        raise EstimationError("the start has no static gain: its b_0 is zero")
    n, size = len(block.a), basis_values.shape[1]
    added = [np.ones(len(y))] if constant else []

    def model(theta: Array) -> _Point | None:
        at = _stable(theta[:n], np.concatenate(([1.0], theta[n:])), block.delay)
        if at is None:
            return None
        responses = np.column_stack([*(responses_in(parts, at, phi, dt) for phi in basis_values.T), *added])
        c = _factored(responses).solution(y)

        def derivatives() -> Array:
            outer = np.delete(sensitivities(at, basis_values @ c[:size], dt, parts), n, axis=1)
            return np.hstack([outer, responses])

        return _Point(theta, at, c, y - responses @ c, derivatives)

    start = np.concatenate((block.a, np.array(block.b[1:]) / block.b[0]))
    return _minimised(model, start, float(np.linalg.norm(y)), kinks=False)


def refine_wiener(
    u: Array,
    y: Array,
    block: ContinuousTransferFunction,
    nonlinearity: FourSegment,
    dt: float,
    parts: Parts | None = None,
    *,
    constant: float | None = None,
) -> Refinement:
    """Fit y = f(B e^(-ds)/A u) + k + white noise, f being the four-segment function of eq. (32).

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
    constant : float, optional
        The start of k; without it k is zero.

    Returns
    -------
    Refinement
        With the coefficients e_-2, e_-1, e_2, and k.

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
        at, e, k = _stable(theta[:n], theta[n:p], block.delay), theta[p : p + 3], theta[p + 3 :]
        if at is None or not np.all(e > 0.0):
            return None
        x = responses_in(parts, at, u, dt)

        def derivatives() -> Array:
            by_block = forward_slope(x, e, *points)[:, None] * sensitivities(at, u, dt, parts)
            by_constant = np.ones((len(y), len(k)))
            return np.hstack([by_block, forward_by_slopes(x, e, *points), by_constant])

        return _Point(theta, at, theta[p:], y - forward(x, e, *points) - k.sum(), derivatives)

    start = np.array([*block.a, *block.b, *nonlinearity.e, *([] if constant is None else [constant])])
    return _minimised(model, start, float(np.linalg.norm(y)), kinks=True)
