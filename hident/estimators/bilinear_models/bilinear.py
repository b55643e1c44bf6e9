"""Linear regressions with bilinear parameters, as Hammerstein systems give them.

=======  ====================================================================================
x, y     input and output
phi_j    the m known functions whose combination sum_j a_j phi_j is the nonlinearity
b        the n coefficients of the linear block, of length one, the first non-zero one positive
Phi      regressors phi_j(x(t-i)), shape (rows, n m): the lag i runs faster than j
Theta    the n x m matrix of the coefficients of Phi; b a' for a Hammerstein system
F        a root of the weighting matrix, W = F'F, given as a map of signals
k        constant of the output, if there is one: y = Phi theta + k + noise
=======  ====================================================================================

Equation numbers are those of Wang, Zhang, Ljung 2009. They have no constant k: with the best k the problem
is the one in Phi and y less their weighted means (Frisch and Waugh), so that all else stays as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from hident.arrays import Array
from hident.errors import EstimationError
from hident.numerics.least_squares import Factorisation, lengths
from hident.numerics.stacks import times

Root = Callable[[Array], Array]
"""Multiplies signals (..., N) by F, giving (..., M)."""

_ZERO = 1e-12
"""Modulus up to which an entry of the unit vector b counts as zero."""


def identity(signals: Array) -> Array:
    """The root of W = I."""
    return signals


def regressors(basis: Array, n: int, delay: int = 1) -> Array:
    """The matrix Phi of (7).

    Parameters
    ----------
    basis : array, shape (m, N)
        The functions phi_j(x(t)) of the input.
    n : int
        Number of lags.
    delay : int
        The first lag.

    Returns
    -------
    array, shape (N - delay - n + 1, n m)
        One row for each t whose lagged inputs are all on record, beginning with t = delay + n - 1 (from 0).
    """
    # Eq. (6): x(t-delay), x(t-delay-1), ... within each phi_j
    windows = sliding_window_view(basis[:, : basis.shape[1] - delay], n, axis=1)[:, :, ::-1]
    return windows.transpose(0, 2, 1).reshape(n * len(basis), -1).T


@dataclass(frozen=True, eq=False)
class Level:
    """The constant of a weighted output, whose regressor F 1 is ``ones`` (M,) under the ``root`` F."""

    root: Root
    ones: Array

    @classmethod
    def of(cls, root: Root, rows: int) -> Self:
        return cls(root, root(np.ones(rows)))

    def best(self, residuals: Array) -> Array:
        """The constant (...) that fits ``residuals`` (..., rows) best."""
        return times(self.root(residuals), self.ones[:, None])[..., 0] / float(self.ones @ self.ones)

    def without(self, signals: Array) -> Array:
        """F times the signals (..., rows) less the best constant of each, shape (..., M)."""
        weighted = self.root(signals)
        unit = self.ones / np.linalg.norm(self.ones)
        return weighted - times(weighted, unit[:, None]) * unit


@dataclass(frozen=True, eq=False)
class Regression:
    """The weighted regressors F Phi = Q R, factored once for the outputs of any number of trials.

    ``phi`` has shape (rows, n m), ``q`` (M, n m), ``r`` and its inverse ``g`` (n m, n m); so
    (Phi'W Phi)^-1 = g g'. With a ``level``, F leaves no constant of a signal.
    """

    phi: Array
    n: int
    root: Root
    q: Array
    r: Array
    g: Array
    level: Level | None = None

    @classmethod
    def of(cls, phi: Array, n: int, root: Root = identity, delay: int = 1, *, constant: bool = False) -> Self:
        """Factor the regressors ``phi`` of ``n`` lags; ``delay`` only names them in messages.

        With ``constant`` the output has one that is not known, under any ``root`` that keeps some of it.

        Raises
        ------
        EstimationError
            If there are fewer rows than regressors, or the regressors are linearly dependent (assumption 2
            fails); the message names them and says what would separate them.
        """
        if len(phi) < (unknowns := phi.shape[1] + constant):
            raise EstimationError(
                f"{len(phi)} equations cannot determine {unknowns} coefficients: "
                "use a longer record, fewer lags or fewer basis functions"
            )
        level = Level.of(root, len(phi)) if constant else None
        if level is not None:
            # Without its constant, a regressor that is one would be rounding, and of any direction.
            with_ones = Factorisation.of(np.column_stack([root(phi.T).T, level.ones]))
            if len(null := with_ones.null):
                raise EstimationError(_dependence(phi, n, delay, null[:, :-1], constant=True))
            root = level.without
        factors = Factorisation.of(root(phi.T).T)
        if len(null := factors.null):
            raise EstimationError(_dependence(phi, n, delay, null))
        upper = factors.r * factors.length
        return cls(phi, n, root, factors.q, upper, factors.inverse_root, level)

    def projected(self, y: Array) -> Array:
        """Q'F y: all that the estimates need of the outputs ``y`` (..., rows)."""
        return times(self.root(y), self.q)

    def theta(self, y: Array) -> Array:
        """The unconstrained weighted estimate of Theta (..., n, m) from ``y`` (..., rows), Eq. (12)."""
        stacked = times(self.projected(y), self.g.T)
        return stacked.reshape(*stacked.shape[:-1], -1, self.n).swapaxes(-1, -2)

    def residuals(self, y: Array, theta: Array) -> Array:
        """y - Phi Theta, of the shape of ``y`` (..., rows), for Theta (..., n, m); less the best constant."""
        stacked = theta.swapaxes(-1, -2).reshape(*theta.shape[:-2], -1)
        residuals = y - times(stacked, self.phi.T)
        return residuals if self.level is None else residuals - self.level.best(residuals)[..., None]

    def constants(self, y: Array, b: Array, a: Array) -> Array:
        """The constants (...) of outputs ``y`` (..., rows) beside b (..., n) and a (..., m)."""
        assert self.level is not None
        theta = (a[..., :, None] * b[..., None, :]).reshape(*b.shape[:-1], -1)
        return self.level.best(y - times(theta, self.phi.T))

    def covariance_roots(self, b: Array, a: Array) -> tuple[Array, Array]:
        """Roots of the covariances of b and a by the delta method, for a noise with W^-1 as covariance.

        ``b`` has shape (..., n) and ``a`` (..., m); the results are (..., n, n m) and (..., m, n m), and
        each times its transpose is the covariance.
        """
        # At Theta = b a': db = (I - b b') dTheta a / |a|^2 and da = dTheta' b, for dTheta from g.
        n, m, columns = b.shape[-1], a.shape[-1], len(self.g)
        g = self.g.reshape(m, n, columns)
        along = times(a, g.reshape(m, -1)).reshape(*b.shape, columns)
        along /= np.sum(a * a, axis=-1)[..., None, None]
        within = np.matmul(b[..., None, :], along)
        of_a = times(b, g.swapaxes(0, 1).reshape(n, -1)).reshape(*a.shape, columns)
        return along - b[..., :, None] * within, of_a

    def standard_errors(self, b: Array, a: Array, variance: Array) -> tuple[Array, Array]:
        """Those of b (..., n) and a (..., m), for a noise of covariance ``variance`` (...) times W^-1."""
        std = np.sqrt(variance)[..., None]
        of_b, of_a = self.covariance_roots(b, a)
        return std * np.linalg.norm(of_b, axis=-1), std * np.linalg.norm(of_a, axis=-1)

    def variance(self, y: Array, theta: Array) -> Array:
        """The unbiased variance (...) of the weighted residuals of the unconstrained Theta.

        It is nan if there are no more rows than regressors.
        """
        spare = len(self.phi) - self.phi.shape[1] - (self.level is not None)
        weighted = self.root(self.residuals(y, theta))
        return np.asarray(np.sum(weighted**2, axis=-1) / (spare or np.nan))


def inverse_gram(regression: Regression) -> Root:
    """The root of W-check = (Phi Phi')^+, Eq. (17), for the regressors of an unweighted regression.

    It is Phi^+ itself, since (Phi Phi')^+ = (Phi^+)'Phi^+. So F Phi = I, and the loss under W-check is the
    squared distance between Theta and b a', which the singular value decomposition minimises: theorem 2.
    Composed with a root F, and for F's own regression, it is the root of theorem 3's W-tilde.
    """
    return lambda signals: times(regression.projected(signals), regression.g.T)


def normalised(b: Array, a: Array) -> tuple[Array, Array]:
    """Scale b (..., n) and a (..., m) to assumption 1, keeping b a'; entries up to 1e-12 count as zero."""
    length = np.linalg.norm(b, axis=-1, keepdims=True)
    b = b / length
    first = np.argmax(np.abs(b) > _ZERO, axis=-1)[..., None]
    sign = np.where(np.take_along_axis(b, first, axis=-1) < 0.0, -1.0, 1.0)
    return sign * b, sign * length * a


def loss(regression: Regression, y: Array, b: Array, a: Array, root: Root) -> Array:
    """r'W r for the residuals r of b (..., n) and a (..., m): what the paper prints, without (10)'s 1/2."""
    weighted = root(regression.residuals(y, b[..., :, None] * a[..., None, :]))
    return np.asarray(np.sum(weighted**2, axis=-1))


def _dependence(phi: Array, n: int, delay: int, null: Array, *, constant: bool = False) -> str:
    """What to say of regressors whose null space has the basis ``null`` (columns scaled to length one).

    With ``constant`` that of the output is one more of them, and its column of ``null`` is left out.
    """
    involved = np.flatnonzero(np.abs(null).max(axis=0) > 1e-6)
    names = [f"phi_{k // n + 1}(x(t-{k % n + delay}))" for k in involved]
    shown = ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
    count, also = phi.shape[1] + constant, " and the constant of the output" * constant
    return (
        f"the regressors {shown}{also} are linearly dependent (rank {count - len(null)} "
        f"of {count}): {_remedy(phi[:, ::n], n, constant)}"
    )


def _remedy(basis: Array, n: int, constant: bool) -> str:
    """Which input or basis would separate the regressors; ``basis`` (rows, m) holds those of one lag."""
    m = basis.shape[1]
    levels = len(np.unique(basis, axis=0))
    # Over several lags, a constant among the combinations of phi_j cannot be told from its own lags.
    needed = m if n == 1 and not constant else m + 1
    if levels < needed:
        return (
            f"the input takes {levels} different value{'s' if levels > 1 else ''}, "
            f"and {m} basis function{'s' if m > 1 else ''} over {n} lag{'s' if n > 1 else ''} "
            f"{'beside a constant ' * constant}need{'s' if m == 1 else ''} at least {needed}"
        )
    if np.linalg.matrix_rank(basis / lengths(basis), tol=1e-10) < m:
        return "the basis functions coincide where the input is: use a wider input or other functions"
    with_constant = np.column_stack([basis, np.ones(len(basis))])
    if constant and np.linalg.matrix_rank(with_constant / lengths(with_constant), tol=1e-10) <= m:
        return (
            "a combination of the basis functions is constant, as 'constant' is: leave one function out, or "
            "'constant'"
        )
    if n > 1 and np.linalg.matrix_rank(with_constant / lengths(with_constant), tol=1e-10) <= m:
        return (
            "a combination of the basis functions is constant and equals its own lags: leave one function "
            "out and set 'constant: true' instead"
        )
    return (
        "past inputs repeat one another: use an input that varies irregularly from sample to sample, "
        "such as white noise, or fewer lags"
    )
