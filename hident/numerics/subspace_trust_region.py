"""Nonlinear least squares by a trust region in two dimensions, with preconditioned conjugate gradients.

Each step minimises Gauss and Newton's model of the loss, inside a ball, over the plane of the gradient and
an approximate Gauss-Newton step (Byrd, Schnabel, Shultz 1988, Math. Programming 40, 247). That step takes a
few conjugate gradients only, so columns of the Jacobian that depend on one another (a factor between two
blocks) do no harm. It is the method of Coleman and Li 1996 (SIAM J. Optim. 6, 418) and Branch, Coleman, Li
1999 (SIAM J. Sci. Comput. 21, 1) for problems without bounds, where their scaling matrix is the identity.
The papers leave the preconditioner and the rule of rest open: here they are those of MATLAB 7's lsqnonlin,
as the constants are. Where H is badly conditioned even after its scaling, the few conjugate gradients make
it slow: it may come to rest, or to the end of its steps, before the minimum.

=========  ========================================================================
r, J       residuals (N,), output less model, and the model's derivative (N, P)
g, H       gradient -J'r and Gauss and Newton's second derivative J'J of r'r / 2
M          preconditioner: the lengths of the columns of H
radius     the longest step
=========  ========================================================================
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Literal

import numpy as np

from hident.arrays import Array
from hident.numerics.gauss_newton import P
from hident.numerics.least_squares import lengths

Status = Literal["converged", "stalled", "exhausted"]
"""How it ended: at rest, no step lowers the loss, no iteration is left."""

# Where the last residual of the conjugate gradients is this part of the first, they end.
_ENOUGH = 0.1
# A step that keeps less than the first part of its promise was too long; one that keeps the second may grow.
_POOR, _GOOD = 0.25, 0.75
# A step that is longer than this part of the radius was held by it.
_HELD = 0.9
# What remains of a unit vector beside another, up to which they are parallel.
_PARALLEL = float(np.sqrt(np.finfo(float).eps))
# An eigenvalue that is less than this part of the largest is rounding.
_NULL = 10.0 * float(np.finfo(float).eps)
_MOST_REJECTED = 30


@dataclass(frozen=True, eq=False)
class Reached(Generic[P]):
    """Where it ended, and how; ``iterations`` counts the steps that were tried."""

    point: P
    status: Status
    iterations: int


def subspace_trust_region(
    start: P,
    moved: Callable[[P, Array], P],
    *,
    tolerance: float = 1e-6,
    max_iterations: int = 400,
    radius: float = 10.0,
) -> Reached[P]:
    """Minimise the sum of squared residuals from ``start``.

    Parameters
    ----------
    start : Point
        The first model.
    moved : callable
        The model a step (P,) away from another.
    tolerance : float
        At rest, a step that the radius does not hold changes the loss by less than this times one more than
        the loss, and has not promised more than four times that.
    max_iterations : int
        The most steps.
    radius : float
        The first one, in the parameters' units.

    Examples
    --------
    >>> import numpy as np
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class Decay:
    ...     rate: float
    ...     t = np.arange(4.0)
    ...     residuals = property(lambda self: np.exp(-0.5 * self.t) - np.exp(-self.rate * self.t))
    ...     jacobian = property(lambda self: (-self.t * np.exp(-self.rate * self.t))[:, None])
    ...     loss = property(lambda self: float(self.residuals @ self.residuals))
    >>> found = subspace_trust_region(Decay(2.0), lambda at, step: Decay(at.rate + float(step[0])))
    >>> found.status, round(found.point.rate, 3)
    ('converged', 0.5)
    """
    point, iterations, rejected = start, 0, 0
    while iterations < max_iterations:
        gradient = -point.jacobian.T @ point.residuals
        hessian = point.jacobian.T @ point.jacobian
        step = _step(hessian, gradient, radius)
        length = float(np.linalg.norm(step))
        promised = -float(step @ (2.0 * gradient + hessian @ step))
        if promised <= 0.0:
            return Reached(point, "converged", iterations)
        new = moved(point, step)
        iterations += 1
        gained = point.loss - new.loss
        little = tolerance * (1.0 + point.loss)
        # The promise is looked at too: a bad step may come out at the same loss by chance.
        rests = length < _HELD * radius and abs(gained) < little and promised < little / _POOR
        # A loss that is not a number is no gain.
        if not gained > _POOR * promised:
            radius = min(length, radius) / 4.0
        elif gained >= _GOOD * promised and length >= _HELD * radius:
            radius *= 2.0
        point, rejected = (new, 0) if gained > 0.0 else (point, rejected + 1)
        if rests:
            return Reached(point, "converged", iterations)
        if rejected == _MOST_REJECTED:
            return Reached(point, "stalled", iterations)
    return Reached(point, "exhausted", iterations)


def conjugate_gradients(hessian: Array, gradient: Array, most: int) -> Array:
    """An approximate solution (P,) of H s = -g by at most so many preconditioned conjugate gradients.

    ``hessian`` (P, P) is positive semidefinite.
    """
    scale = lengths(hessian)
    step, residual = np.zeros_like(gradient), -gradient
    scaled = residual / scale
    enough = _ENOUGH * np.linalg.norm(scaled)
    direction, product = scaled, residual @ scaled
    for _ in range(most):
        curved = hessian @ direction
        curvature = direction @ curved
        if curvature <= 0.0:
            break
        step = step + product / curvature * direction
        residual = residual - product / curvature * curved
        scaled = residual / scale
        if np.linalg.norm(scaled) <= enough:
            break
        product, last = residual @ scaled, product
        direction = scaled + product / last * direction
    return step


def _step(hessian: Array, gradient: Array, radius: float) -> Array:
    """The least of the quadratic model in the plane of the gradient and the conjugate gradients' step."""
    along = conjugate_gradients(hessian, gradient, max(1, len(gradient) // 2))
    basis = _orthonormal(along, gradient)
    inner = least_in_ball(basis.T @ hessian @ basis, basis.T @ gradient, radius)
    return np.asarray(basis @ inner)


def _orthonormal(*vectors: Array) -> Array:
    """An orthonormal basis (P, K) of the span of the vectors (P,), without those that are (nearly) in it."""
    basis = np.zeros((len(vectors[0]), 0))
    for vector in vectors:
        if size := np.linalg.norm(vector):
            rest = vector / size
            rest = rest - basis @ (basis.T @ rest)
            if (left := np.linalg.norm(rest)) > _PARALLEL:
                basis = np.column_stack([basis, rest / left])
    return basis


def least_in_ball(hessian: Array, gradient: Array, radius: float) -> Array:
    """The s (K,), no longer than ``radius``, with the least g's + s'H s / 2, for g = -J'r and H = J'J."""
    from scipy.optimize import brentq

    values, vectors = np.linalg.eigh(hessian)
    # Along what is in the null space of H, g is rounding.
    known = values > _NULL * np.max(values, initial=0.0)
    values, vectors = values[known], vectors[:, known]
    sides = vectors.T @ gradient

    def shifted(shift: float) -> Array:
        return np.asarray(-vectors @ (sides / (values + shift)))

    newton = shifted(0.0)
    if np.linalg.norm(newton) <= radius:
        return newton
    # Of H + shift I no eigenvalue is less than the shift, so no step is longer than |g| / shift.
    highest = float(np.linalg.norm(sides)) / radius
    return shifted(brentq(lambda shift: radius / np.linalg.norm(shifted(shift)) - 1.0, 0.0, highest))
