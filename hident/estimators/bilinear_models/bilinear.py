"""Linear regressions with bilinear parameters, as Hammerstein systems give them.

=======  ====================================================================================
x, y     input and output
phi_j    the m known functions whose combination sum_j a_j phi_j is the nonlinearity
b        the n coefficients of the linear block, of length one, the first non-zero one positive
Phi      regressors phi_j(x(t-i)), shape (rows, n m): the lag i runs faster than j
Theta    the n x m matrix of the coefficients of Phi; b a' for a Hammerstein system
F        a root of the weighting matrix, W = F'F, given as a map of signals
=======  ====================================================================================

Equation numbers are those of Wang, Zhang, Ljung 2009.
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
class Regression:
    """The weighted regressors F Phi = Q R, factored once for the outputs of any number of trials.

    ``phi`` has shape (rows, n m), ``q`` (M, n m), ``r`` and its inverse ``g`` (n m, n m); so
    (Phi'W Phi)^-1 = g g'.
    """

    phi: Array
    n: int
    root: Root
    q: Array
    r: Array
    g: Array

    @classmethod
    def of(cls, phi: Array, n: int, root: Root = identity, delay: int = 1) -> Self:
        """Factor the regressors ``phi`` of ``n`` lags; ``delay`` only names them in messages.

        Raises
        ------
        EstimationError
            If there are fewer rows than regressors, or the regressors are linearly dependent (assumption 2
            fails); the message names them and says what would separate them.
        """
        if len(phi) < phi.shape[1]:
            raise EstimationError(
                f"{len(phi)} equations cannot determine {phi.shape[1]} coefficients: "
                "use a longer record, fewer lags or fewer basis functions"
            )
        factors = Factorisation.of(root(phi.T).T)
        if len(null := factors.null):
            raise EstimationError(_dependence(phi, n, delay, null))
        upper = factors.r * factors.length
        return cls(phi, n, root, factors.q, upper, factors.inverse_root)

    def projected(self, y: Array) -> Array:
        """Q'F y: all that the estimates need of the outputs ``y`` (..., rows)."""
        return times(self.root(y), self.q)

    def theta(self, y: Array) -> Array:
        """The unconstrained weighted estimate of Theta (..., n, m) from ``y`` (..., rows), Eq. (12)."""
        stacked = times(self.projected(y), self.g.T)
        return stacked.reshape(*stacked.shape[:-1], -1, self.n).swapaxes(-1, -2)

    def residuals(self, y: Array, theta: Array) -> Array:
        """y - Phi Theta, of the shape of ``y`` (..., rows), for Theta (..., n, m)."""
        stacked = theta.swapaxes(-1, -2).reshape(*theta.shape[:-2], -1)
        return y - times(stacked, self.phi.T)

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
        spare = len(self.phi) - self.phi.shape[1]
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


def _dependence(phi: Array, n: int, delay: int, null: Array) -> str:
    """What to say of regressors whose null space has the basis ``null`` (columns scaled to length one)."""
    involved = np.flatnonzero(np.abs(null).max(axis=0) > 1e-6)
    names = [f"phi_{k // n + 1}(x(t-{k % n + delay}))" for k in involved]
    shown = ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
    return (
        f"the regressors {shown} are linearly dependent (rank {phi.shape[1] - len(null)} "
        f"of {phi.shape[1]}): {_remedy(phi[:, ::n], n)}"
    )


def _remedy(basis: Array, n: int) -> str:
    """Which input or basis would separate the regressors; ``basis`` (rows, m) holds those of one lag."""
    m = basis.shape[1]
    levels = len(np.unique(basis, axis=0))
    # Over several lags, a constant among the combinations of phi_j cannot be told from its own lags.
    needed = m if n == 1 else m + 1
    if levels < needed:
        return (
            f"the input takes {levels} different value{'s' if levels > 1 else ''}, "
            f"and {m} basis function{'s' if m > 1 else ''} over {n} lag{'s' if n > 1 else ''} "
            f"need{'s' if m == 1 else ''} at least {needed}"
        )
    if np.linalg.matrix_rank(basis / lengths(basis), tol=1e-10) < m:
        return "the basis functions coincide where the input is: use a wider input or other functions"
    with_constant = np.column_stack([basis, np.ones(len(basis))])
    if n > 1 and np.linalg.matrix_rank(with_constant / lengths(with_constant), tol=1e-10) <= m:
        return (
            "a combination of the basis functions is constant and equals its own lags: leave one function out"
        )
    return (
        "past inputs repeat one another: use an input that varies irregularly from sample to sample, "
        "such as white noise, or fewer lags"
    )
