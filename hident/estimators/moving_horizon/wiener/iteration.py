"""The iteration for Wiener systems, for many forms of the nonlinearity at once.

Chen, Hwang and Chang 2009, section 4.2. Symbols:

======  =============================================================================================
x       the internal variable, from the linear block (28a), from the nonlinearity (28b), or both (29)
theta   a_1, ..., a_n, b_0, ..., b_m of the linear block, then c_1, ..., c_r of the nonlinearity, then k
k       the constant of the output, if one is estimated: y - k stands in the place of y
terms   g_1, ..., g_r with x = y - sum c_i g_i: (15) with c = 1 - e, or the powers x^2, ..., x^p (11)
J       regressions at once, such as pairs of partition points
K       horizons
======  =============================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Protocol, Self

import numpy as np

from hident.arrays import Array, Complex, Flags, Index
from hident.estimators.moving_horizon.transform.horizon_least_squares import solve
from hident.estimators.moving_horizon.transform.time_weighted import Horizons, Knots
from hident.estimators.moving_horizon.wiener.batched_blocks import responses, time_constants
from hident.estimators.moving_horizon.wiener.four_segment import (
    inverse_slope,
    left_segments,
    right_segment,
    segments,
)
from hident.numerics.parts import in_each

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True, eq=False)
class Wiener:
    """A record, the orders n and m and the delay of the linear block, and the record's transforms.

    ``inputs`` (K, m + 1) are the transforms of u(t - d) and its derivatives, ``outputs`` (K, n + 1) those
    of y; ``operator`` gives those of sampled signals.
    """

    u: Array
    y: Array
    dt: float
    n: int
    m: int
    delay: float
    horizons: Horizons
    operator: csr_array
    inputs: Array
    outputs: Array
    constant: bool = False

    @classmethod
    def of(
        cls,
        u: Array,
        y: Array,
        dt: float,
        *,
        m: int,
        delay: float,
        horizons: Horizons,
        constant: bool = False,
    ) -> Self:
        """The transforms of input and output, both (N,), over ``horizons`` of order n."""
        operator = horizons.sampled(Knots.of(u, delay, dt, horizons.parts))
        inputs = horizons.transform(horizons.held(delay), u)[: m + 1].T
        outputs = horizons.transform(operator, y).T
        return cls(u, y, dt, horizons.order, m, delay, horizons, operator, inputs, outputs, constant)

    def transforms(self, signals: Array, operator: csr_array | None = None) -> Array:
        """The transforms of sampled ``signals`` (N, J) and their derivatives, shape (J, K, n + 1).

        With another ``operator``, such as :attr:`derivatives`, those that it gives.
        """
        return self.horizons.transform(self.operator if operator is None else operator, signals).T

    @cached_property
    def means(self) -> csr_array:
        """The rows of the operator for the signal itself."""
        return self.operator[: self.horizons.count]

    @cached_property
    def derivatives(self) -> csr_array:
        """The rows of the operator for the derivatives 1, ..., n."""
        return self.operator[self.horizons.count :]

    def linear_output(self) -> Array:
        """The output (N,) of the linear model from u to y, by the same transform."""
        added = [self.horizons.constant[:, None]] if self.constant else []
        theta = solve(np.hstack((-self.outputs[:, 1:], self.inputs, *added)), self.outputs[:, 0])
        return self.internal(theta[None])[:, 0] if np.all(np.isfinite(theta)) else self.y

    def internal(self, theta: Array, tau: Complex | None = None) -> Array:
        """x_lin (N, J) of (28a) for parameters (J, P), from rest, poles reflected into the left half plane.

        ``tau`` (J, n) are the blocks' :func:`time_constants`, if they are known.
        """
        a, b, _ = self.split(theta)
        return in_each(self.horizons.parts, lambda u: responses(a, b, self.delay, u, self.dt, tau), self.u)

    def split(self, theta: Array) -> tuple[Array, Array, Array]:
        """a (..., n), b (..., m + 1) and c (..., r) in ``theta``."""
        return (
            theta[..., : self.n],
            theta[..., self.n : self.n + self.m + 1],
            theta[..., self.n + self.m + 1 : theta.shape[-1] - self.constant],
        )

    def constants(self, theta: Array) -> Array:
        """k (...) in ``theta``, zero if it is not estimated."""
        return np.asarray(theta[..., -1]) if self.constant else np.zeros(theta.shape[:-1])


class Internal(Protocol):
    """The internal variable as the regression sees it.

    ``terms`` (J, K, r) are the transforms of g_1, ..., g_r, ``derivatives`` (J, K, n) those of the
    derivatives of x. ``level`` (J, K) is what multiplies the constant k, and ``target`` (J, K) what all
    regressors together are to make.
    """

    @property
    def terms(self) -> Array: ...

    @property
    def derivatives(self) -> Array: ...

    @property
    def level(self) -> Array: ...

    @property
    def target(self) -> Array: ...

    def updated(self, x_lin: Array, c: Array, weight: float, constants: Array) -> Self:
        """The next internal variable (29), from the blocks' outputs (N, J) and the parameters.

        These are ``c`` (J, r) and the ``constants`` k (J,).
        """

    def of(self, chosen: Flags) -> Self:
        """That of the ``chosen`` (J,) regressions alone."""

    def has_forward(self, c: Array) -> Flags:
        """Whether the parameters (J, r) belong to a function from x to y."""


@dataclass(frozen=True, eq=False)
class FourSegments:
    """The internal variable by four-segment functions, held as transforms ``g`` (J, K, n + 1, 3) alone.

    Where the output has a constant, the segments meet at the ``points`` (2, J) and zero of y - k. Around the
    last k in ``shift`` (J,) the function is linear in k, with the slope dx/dy, whose transform is ``level``.
    """

    wiener: Wiener
    g: Array
    derivatives: Array
    points: Array
    shift: Array
    level: Array

    @classmethod
    def of_points(cls, wiener: Wiener, points: Array, x: Array) -> Self:
        """For the break points y_-1 and y_1 in ``points`` (2, J), beginning with ``x`` (N,)."""
        # A grid of pairs has few different points.
        lowers, left = np.unique(points[0], return_inverse=True)
        uppers, right = np.unique(points[1], return_inverse=True)
        y = wiener.y[:, None]
        lefts = left_segments(y, lowers)
        g = np.stack(
            (
                wiener.transforms(lefts[..., 0])[left],
                wiener.transforms(lefts[..., 1])[left],
                wiener.transforms(right_segment(y, uppers))[right],
            ),
            axis=-1,
        )
        count = points.shape[1]
        first = wiener.transforms(x[:, None], wiener.derivatives)
        derivatives = np.broadcast_to(first, (count, *first.shape[1:]))
        level = np.tile(wiener.horizons.constant, (count, 1))
        return cls(wiener, g, derivatives, points, np.zeros(count), level)

    @property
    def terms(self) -> Array:
        return self.g[:, :, 0]

    @property
    def target(self) -> Array:
        moved = self.shift[:, None] * (self.level - self.wiener.horizons.constant)
        return np.asarray(self.wiener.outputs[:, 0] + moved)

    def updated(self, x_lin: Array, c: Array, weight: float, constants: Array) -> Self:
        around = self._around(constants, c) if self.wiener.constant else self
        x_nl = self.wiener.outputs[:, 1:] - np.einsum("jkir,jr->jki", around.g[:, :, 1:], c)
        forward = self.wiener.transforms(x_lin, self.wiener.derivatives)
        return replace(around, derivatives=weight * forward + (1.0 - weight) * x_nl)

    def _around(self, constants: Array, c: Array) -> Self:
        """The segments of y - k for the constants k (J,), and the slopes of the inverse there."""
        y = self.wiener.y[:, None] - constants
        signals = segments(y, *self.points)
        g = self.wiener.transforms(signals.reshape(len(y), -1))
        g = np.moveaxis(g.reshape(*signals.shape[1:], *g.shape[1:]), 1, -1)
        slopes = inverse_slope(y, 1.0 - c.T, *self.points)
        level = self.wiener.transforms(slopes, self.wiener.means)[..., 0]
        return replace(self, g=g, shift=constants, level=level)

    def of(self, chosen: Flags) -> Self:
        return replace(
            self,
            g=self.g[chosen],
            derivatives=self.derivatives[chosen],
            points=self.points[:, chosen],
            shift=self.shift[chosen],
            level=self.level[chosen],
        )

    def has_forward(self, c: Array) -> Flags:
        # All slopes e = 1 - c must be positive.
        return np.asarray(np.all(c < 1.0, axis=-1))


@dataclass(frozen=True, eq=False)
class Powers:
    """The internal variable by polynomials of one degree, held as samples ``x`` (N, J)."""

    wiener: Wiener
    degree: int
    x: Array

    @property
    def terms(self) -> Array:
        powers = [self.wiener.transforms(self.x**i, self.wiener.means)[..., 0] for i in self._exponents]
        return np.stack(powers, axis=-1)

    @property
    def derivatives(self) -> Array:
        return self.wiener.transforms(self.x, self.wiener.derivatives)

    @property
    def _exponents(self) -> range:
        return range(2, self.degree + 1)

    @property
    def level(self) -> Array:
        return np.tile(self.wiener.horizons.constant, (self.x.shape[1], 1))

    @property
    def target(self) -> Array:
        return np.tile(self.wiener.outputs[:, 0], (self.x.shape[1], 1))

    def updated(self, x_lin: Array, c: Array, weight: float, constants: Array) -> Self:
        # Eq. (11)
        x_nl = self.wiener.y[:, None] - constants - sum(c[:, i - 2] * self.x**i for i in self._exponents)
        return replace(self, x=weight * x_lin + (1.0 - weight) * x_nl)

    def of(self, chosen: Flags) -> Self:
        return replace(self, x=self.x[:, chosen])

    def has_forward(self, c: Array) -> Flags:
        return np.ones(len(c), dtype=bool)


@dataclass(frozen=True)
class Rule:
    """The weight of x_lin in (29), and when to stop.

    With ``patience`` a regression is given up when its model has been inadmissible (an unstable block, or no
    function from x to y) for that many iterations in a row.
    """

    weight: float = 0.5
    tolerance: float = 1e-3
    max_iterations: int = 60
    patience: int | None = None


@dataclass(frozen=True, eq=False)
class Iterates:
    """What J iterations gave.

    ``path`` (S, J, P) holds theta after 0, 1, ... updates of x, repeated once an iteration has ended;
    ``phi`` (J, K, P) are the regressors of the last; ``iterations`` (J,) counts the updates. ``admissible``
    (J,) says whether the block is stable and the nonlinearity a function.
    """

    path: Array
    phi: Array
    iterations: Index
    converged: Flags
    admissible: Flags

    @property
    def theta(self) -> Array:
        """The last parameters (J, P); not finite where a regression was singular."""
        return np.asarray(self.path[-1])


# What overflows or is singular ends in parameters that are not finite.
@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def iterate(wiener: Wiener, internal: Internal, rule: Rule) -> Iterates:
    """Least squares for theta (26) and the update of x (29) in turn, for J internal variables.

    Notes
    -----
    Differs from the paper, which names no criterion: an iteration has converged when the parameters, each
    weighted by the length of its regressor, change by less than the tolerance relative to their length; so
    the units of time and signals do not matter. An unstable block is simulated with its poles reflected into
    the left half plane.
    """
    phi = _regressors(wiener, internal)
    theta = _solved(wiener, internal, phi)
    count = len(theta)
    path = [theta]
    iterations = np.zeros(count, dtype=np.intp)
    inadmissible = np.zeros(count, dtype=np.intp)
    converged, admissible = np.zeros((2, count), dtype=bool)
    going = np.all(np.isfinite(theta), axis=-1)
    rows, internal, tau = np.flatnonzero(going), internal.of(going), None
    for _ in range(rule.max_iterations):
        if len(rows) == 0:
            break
        old = theta[rows]
        x_lin, c = wiener.internal(old, tau), wiener.split(old)[2]
        internal = internal.updated(x_lin, c, rule.weight, wiener.constants(old))
        phi[rows] = now = _regressors(wiener, internal)
        new = _solved(wiener, internal, now)
        length = np.linalg.norm(now, axis=-2)
        change = np.linalg.norm((new - old) * length, axis=-1)
        theta = theta.copy()
        theta[rows] = new
        path.append(theta)
        iterations[rows] += 1
        converged[rows] = change <= rule.tolerance * np.linalg.norm(new * length, axis=-1)
        finite = np.all(np.isfinite(new), axis=-1)
        a, _, c = wiener.split(np.where(finite[:, None], new, 0.0))
        tau = time_constants(a)
        admissible[rows] = finite & np.all(tau.real > 0.0, axis=-1) & internal.has_forward(c)
        inadmissible[rows] = np.where(admissible[rows], 0, inadmissible[rows] + 1)
        going = np.isfinite(change) & ~converged[rows]
        if rule.patience is not None:
            going &= inadmissible[rows] < rule.patience
        if not np.all(going):
            rows, internal, tau = rows[going], internal.of(going), tau[going]
    return Iterates(np.array(path), phi, iterations, converged, admissible)


def _regressors(wiener: Wiener, internal: Internal) -> Array:
    """phi (J, K, P) of (23) or, with powers for terms, of (12); that of the constant comes last."""
    x = internal.derivatives
    inputs = np.broadcast_to(wiener.inputs, (len(x), *wiener.inputs.shape))
    added = [internal.level[..., None]] if wiener.constant else []
    return np.concatenate((-x, inputs, internal.terms, *added), axis=-1)


def _solved(wiener: Wiener, internal: Internal, phi: Array) -> Array:
    """theta (J, P), eq. (26)."""
    if wiener.constant:
        return solve(phi, internal.target)
    return solve(phi, np.broadcast_to(wiener.outputs[:, 0], phi.shape[:-1]))
