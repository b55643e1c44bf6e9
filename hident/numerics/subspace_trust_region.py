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
T          problems at once, each with the same numbers as by itself
=========  ========================================================================
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Literal

import numpy as np

from hident.arrays import Array, Flags, Index
from hident.numerics.gauss_newton import P
from hident.numerics.least_squares import lengths
from hident.numerics.stacks import applied, chosen, copied, dots, put

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
    """Where T problems ended, and how; ``iterations`` (T,) counts the steps that were tried."""

    point: P
    status: tuple[Status, ...]
    iterations: Index


def subspace_trust_region(
    start: P,
    moved: Callable[[P, Array], P],
    *,
    tolerance: float = 1e-6,
    max_iterations: int = 400,
    radius: float = 10.0,
) -> Reached[P]:
    """Minimise the sum of squared residuals from ``start``, in T problems at once.

    Parameters
    ----------
    start : Points
        The first models: a dataclass of arrays (T, ...), see :mod:`hident.numerics.stacks`.
    moved : callable
        The models a step (T, P) away from some of them.
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
    >>> t = np.arange(4.0)
    >>> @dataclass(frozen=True)
    ... class Decays:
    ...     rate: np.ndarray
    ...     model = property(lambda self: np.exp(-self.rate[:, None] * t))
    ...     residuals = property(lambda self: np.exp(-0.5 * t) - self.model)
    ...     jacobian = property(lambda self: (-t * self.model)[..., None])
    ...     loss = property(lambda self: np.sum(self.residuals**2, axis=-1))
    >>> start = Decays(np.array([2.0, 1.0]))
    >>> found = subspace_trust_region(start, lambda at, step: Decays(at.rate + step[:, 0]))
    >>> found.status, found.point.rate.round(3).tolist()
    (('converged', 'converged'), [0.5, 0.5])
    """
    point, loss = start, start.loss
    rows = np.arange(len(loss))
    found, iterations = copied(start), np.full(len(rows), max_iterations)
    status: list[Status] = ["exhausted"] * len(rows)
    radii, rejected = np.full(len(rows), radius), np.zeros(len(rows), dtype=int)

    def ends(which: Flags, how: Status, after: int) -> None:
        put(found, rows[which], chosen(point, which))
        iterations[rows[which]] = after
        for row in rows[which].tolist():
            status[row] = how

    for tried in range(max_iterations):
        transposed = point.jacobian.swapaxes(-1, -2)
        gradient, hessian = applied(-transposed, point.residuals), transposed @ point.jacobian
        step = _steps(hessian, gradient, radii)
        promised = -dots(step, 2.0 * gradient + applied(hessian, step))
        if (flat := promised <= 0.0).any():
            ends(flat, "converged", tried)
            left = np.flatnonzero(~flat)
            point, rows, radii, rejected = chosen(point, left), rows[left], radii[left], rejected[left]
            loss, step, promised = loss[left], step[left], promised[left]
        if not len(rows):
            break
        length, new = np.sqrt(dots(step, step)), moved(point, step)
        after = new.loss
        gained, little = loss - after, tolerance * (1.0 + loss)
        # The promise is looked at too: a bad step may come out at the same loss by chance.
        rests = (length < _HELD * radii) & (np.abs(gained) < little) & (promised < little / _POOR)
        # A loss that is not a number is no gain.
        poor = ~(gained > _POOR * promised)
        grows = ~poor & (gained >= _GOOD * promised) & (length >= _HELD * radii)
        radii = np.where(poor, np.minimum(length, radii) / 4.0, np.where(grows, 2.0 * radii, radii))
        lower = gained > 0.0
        if not lower.all():
            put(new, ~lower, chosen(point, ~lower))
            after = np.where(lower, after, loss)
        loss, point, rejected = after, new, np.where(lower, 0, rejected + 1)
        stalls = ~rests & (rejected == _MOST_REJECTED)
        if (over := rests | stalls).any():
            ends(rests, "converged", tried + 1)
            ends(stalls, "stalled", tried + 1)
            left = np.flatnonzero(~over)
            point, rows, radii, rejected = chosen(point, left), rows[left], radii[left], rejected[left]
            loss = loss[left]
    put(found, rows, point)
    return Reached(found, tuple(status), iterations)


def conjugate_gradients(hessian: Array, gradient: Array, most: int) -> Array:
    """Approximate solutions (T, P) of H s = -g by at most so many preconditioned conjugate gradients.

    ``hessian`` (T, P, P) is positive semidefinite, ``gradient`` has the shape (T, P).
    """
    steps, rows = np.zeros_like(gradient), np.arange(len(gradient))
    scale = lengths(hessian)
    scaled = -gradient / scale
    enough = _ENOUGH * np.sqrt(dots(scaled, scaled))
    at = _Conjugate(hessian, scale, enough, steps, -gradient, scaled, dots(-gradient, scaled))
    for left in reversed(range(most)):
        curved = applied(at.hessian, at.direction)
        curvature = dots(at.direction, curved)
        if (flat := curvature <= 0.0).any():
            if flat.all():
                break
            at, rows, curved, curvature = chosen(at, ~flat), rows[~flat], curved[~flat], curvature[~flat]
        factor = (at.product / curvature)[:, None]
        steps[rows] = step = at.step + factor * at.direction
        if not left:
            break
        residual = at.residual - factor * curved
        scaled = residual / at.scale
        going = ~(np.sqrt(dots(scaled, scaled)) <= at.enough)
        if not going.any():
            break
        product = dots(residual, scaled)
        direction = scaled + (product / at.product)[:, None] * at.direction
        at = _Conjugate(at.hessian, at.scale, at.enough, step, residual, direction, product)
        if not going.all():
            at, rows = chosen(at, going), rows[going]
    return steps


@dataclass(frozen=True, eq=False)
class _Conjugate:
    """Where the conjugate gradients of some problems stand."""

    hessian: Array
    scale: Array
    enough: Array
    step: Array
    residual: Array
    direction: Array
    product: Array


def _steps(hessian: Array, gradient: Array, radii: Array) -> Array:
    """The least of the quadratic models in the planes of the gradient and the conjugate gradients' step."""
    along = conjugate_gradients(hessian, gradient, max(1, gradient.shape[-1] // 2))
    bases, sizes = _orthonormal(along, gradient)
    if sizes.min(initial=2) == 2:
        return _within(bases, hessian, gradient, radii)
    steps = np.zeros_like(gradient)
    for size in (1, 2):
        rows = np.flatnonzero(sizes == size)
        basis = np.ascontiguousarray(bases[rows, :, :size])
        steps[rows] = _within(basis, hessian[rows], gradient[rows], radii[rows])
    return steps


def _within(bases: Array, hessian: Array, gradient: Array, radii: Array) -> Array:
    """The least of the quadratic models in the spans of orthonormal bases (T, P, K)."""
    transposed = bases.swapaxes(-1, -2)
    return applied(bases, least_in_ball(transposed @ hessian @ bases, applied(transposed, gradient), radii))


def _orthonormal(first: Array, second: Array) -> tuple[Array, Index]:
    """Orthonormal bases (T, P, 2) of the spans of two vectors (T, P) each, and how many columns they have.

    A vector that is zero, or is (nearly) in the span of the one before, has no column.
    """
    one, there = _beside(first, None)
    two, also = _beside(second, one)
    bases = np.empty((*first.shape, 2))
    bases[..., 0], bases[..., 1] = one, two
    if not there.all():
        bases[~there, :, 0] = two[~there]
    return bases, there.astype(np.intp) + also


def _beside(vectors: Array, column: Array | None) -> tuple[Array, Flags]:
    """What the vectors have beside a column, at length one, and where it is not rounding (else zero)."""
    size = np.sqrt(dots(vectors, vectors))
    if not (some := size != 0.0).all():
        size = np.where(some, size, 1.0)
    rest = vectors / size[:, None]
    if column is not None:
        rest = rest - column * dots(column, rest)[:, None]
    left = np.sqrt(dots(rest, rest))
    if not (there := left > _PARALLEL).all():
        rest[~there], left[~there] = 0.0, 1.0
    return rest / left[:, None], there


def least_in_ball(hessian: Array, gradient: Array, radius: Array) -> Array:
    """The s (T, K) no longer than ``radius`` (T,) with the least g's + s'H s / 2; g = -J'r, H = J'J."""
    values, vectors = np.linalg.eigh(hessian)
    # They rise. Along what is in the null space of H, g is rounding.
    known = values > _NULL * np.maximum(values[:, -1:], 0.0)
    transposed = np.ascontiguousarray(vectors.swapaxes(-1, -2))
    divisors = values if (whole := known.all()) else np.where(known, values, 1.0)
    sides = applied(transposed, gradient) / divisors
    steps = applied(-transposed.swapaxes(-1, -2), sides)
    newton = np.sqrt(dots(steps, steps)) <= radius
    if not whole:
        newton &= known.all(axis=-1)
    if not newton.all():
        for i in np.flatnonzero(~newton).tolist():
            steps[i] = _held(values[i, known[i]], vectors[i][:, known[i]], gradient[i], float(radius[i]))
    return steps


def _held(values: Array, vectors: Array, gradient: Array, radius: float) -> Array:
    """:func:`least_in_ball` of one problem, by the eigenvectors (K, R) of the eigenvalues (R,) above zero."""
    from scipy.optimize import brentq

    sides = vectors.T @ gradient

    def shifted(shift: float) -> Array:
        return np.asarray(-vectors @ (sides / (values + shift)))

    newton = shifted(0.0)
    if np.linalg.norm(newton) <= radius:
        return newton
    # Of H + shift I no eigenvalue is less than the shift, so no step is longer than |g| / shift.
    highest = float(np.linalg.norm(sides)) / radius
    return shifted(brentq(lambda shift: radius / np.linalg.norm(shifted(shift)) - 1.0, 0.0, highest))
