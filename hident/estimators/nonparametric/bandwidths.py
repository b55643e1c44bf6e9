"""Bandwidths of kernel regression that the data give at once, without a search.

Where the input's density has no slope, the mean integrated squared error of a local constant estimate with
the kernel K is least at

    h = [ R(K) sigma^2 (b - a) / (mu(K)^2 theta n) ]^(1/5),

with R = int K^2, mu = int x^2 K, the noise's variance sigma^2, an input on [a, b] and theta, the mean of
m''^2 over the n samples. The two rules differ in how they estimate sigma^2 and theta.

===============  ==================================================================
m, r             the regression, and its derivatives
theta_rs         mean of m^(r) m^(s) over the samples; theta is theta_22
g, lambda        bandwidths of the pilot estimates of theta_22 and of sigma^2
===============  ==================================================================
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hident.arrays import Array
from hident.errors import EstimationError
from hident.numerics.choices import ROUNDING, first_least
from hident.numerics.least_squares import Factorisation

_FEWEST = 10
_DEGREE = 4
# Of Ruppert, Sheather, Wand 1995 and of their program dpill (KernSmooth): at most five blocks of at least 20
# samples, a grid of 401 points, 1 % of the samples cut off at either end, 5 % of the grid for theta.
_MOST_BLOCKS, _LEAST_BLOCK = 5, 20
_GRID = 401
_TRIMMED = 0.01
_TRUNCATED = 0.05


@dataclass(frozen=True)
class KernelConstants:
    """Of a kernel that integrates to one: ``roughness``, the integral of its square, and ``variance``."""

    roughness: float
    variance: float

    def bandwidth(self, noise: float, length: float, theta: float, n: int) -> float:
        """The optimal h for the noise's variance, the input's range and theta; at most the range."""
        with np.errstate(divide="ignore", over="ignore"):
            fifth = np.float64(self.roughness * noise * length) / (self.variance**2 * theta * n)
        return float(min(fifth**0.2, length))


def rule_of_thumb(u: Array, y: Array, kernel: KernelConstants) -> float:
    """The bandwidth for which one polynomial of degree four over the whole record stands in for m.

    Parameters
    ----------
    u, y : arrays, shape (N,)
        Input and output, or filtered output, the input in increasing order.
    kernel : KernelConstants
        Of the kernel in use.

    Raises
    ------
    EstimationError
        If there are fewer than ten samples, the input takes too few values, or no noise is left.

    Notes
    -----
    Fan, Gijbels 1996, Local Polynomial Modelling and Its Applications, section 4.2, eq. (4.3), with the
    weight one on the central 90 % of the samples. It is for a local linear estimate; a local constant one has
    the same optimum but for a term of the density's slope, which is left out: zero for a uniform input.
    """
    _require(u)
    fit = _quartic(u, y)
    cut = math.floor(_TRUNCATED * len(u))
    inner = u[cut : len(u) - cut]
    curvature = float(np.sum(fit.derivative(inner, 2) ** 2))
    noise = _noise(fit.rss, len(u) - _DEGREE - 1, y)
    return kernel.bandwidth(noise, float(inner[-1] - inner[0]), curvature / len(u), len(u))


def plug_in(u: Array, y: Array, kernel: KernelConstants) -> float:
    """The bandwidth with sigma^2 and theta from pilot estimates, whose own bandwidths come from quartics.

    Parameters and errors are those of :func:`rule_of_thumb`.

    Notes
    -----
    Ruppert, Sheather, Wand 1995, J. Amer. Statist. Assoc. 90, 1257-1270, their h_DPI, with the grid and the
    constants of their program dpill. It is for a local linear estimate with a Gaussian kernel; here the last
    step takes the kernel in use, and as in :func:`rule_of_thumb` a local constant estimate lacks a term.
    """
    _require(u)
    cut = math.floor(_TRIMMED * len(u))
    u, y = u[cut : len(u) - cut], y[cut : len(u) - cut]
    n, length = len(u), float(u[-1] - u[0])
    noise, theta_24 = _blocked(u, y)
    binned = _Binned.of(u, y)
    # Their section 3.2: g for theta_22 by local cubic fits.
    factor = 15.0 / (16.0 * math.sqrt(math.pi)) if theta_24 > 0.0 else 3.0 / (8.0 * math.sqrt(math.pi))
    g = _root(factor * noise * length, abs(theta_24) * n, 7, length)
    theta = binned.theta(g)
    # Their section 3.3: lambda for sigma^2 by a local linear fit.
    factor = 4.0 * (0.5 + 2.0 * math.sqrt(2.0) - 4.0 / 3.0 * math.sqrt(3.0)) / math.sqrt(2.0 * math.pi)
    width = _root(factor * noise**2 * length, (theta * n) ** 2, 9, length)
    residual, freedom = binned.residual(width, y)
    return kernel.bandwidth(_noise(residual, freedom, y), length, theta, n)


def _root(numerator: float, denominator: float, power: int, most: float) -> float:
    """The root of a fraction, at most ``most``."""
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        found = float((np.float64(numerator) / denominator) ** (1.0 / power))
    return min(found, most)


def _require(u: Array) -> None:
    if len(u) < _FEWEST:
        raise EstimationError(f"a bandwidth from the data needs at least {_FEWEST} samples, not {len(u)}")


def _noise(rss: float, freedom: float, y: Array) -> float:
    """The noise's variance from a sum of squared residuals."""
    if not rss > ROUNDING * float(y @ y) or not freedom > 0.0:
        raise EstimationError(
            "no noise is left beside a smooth curve, so that no bandwidth follows from it: give 'bandwidth' "
            "as a number"
        )
    return rss / freedom


@dataclass(frozen=True, eq=False)
class _Polynomial:
    """A polynomial in (u - middle)/scale, and the sum of squares that it leaves."""

    middle: float
    scale: float
    coefficients: Array
    rss: float

    def derivative(self, u: Array, order: int) -> Array:
        inner = np.polynomial.polynomial.polyder(self.coefficients, order)
        found = np.polynomial.polynomial.polyval((u - self.middle) / self.scale, inner)
        return np.asarray(found / self.scale**order, dtype=float)


def _quartic(u: Array, y: Array) -> _Polynomial:
    middle, scale = 0.5 * (u[0] + u[-1]), 0.5 * (u[-1] - u[0])
    if not scale > 0.0:
        raise _few_values()
    phi = np.polynomial.polynomial.polyvander((u - middle) / scale, _DEGREE)
    factors = Factorisation.of(phi)
    if factors.is_dependent:
        raise _few_values()
    coefficients = factors.solution(y)
    return _Polynomial(middle, scale, coefficients, float(np.sum((y - phi @ coefficients) ** 2)))


def _few_values() -> EstimationError:
    return EstimationError(
        "the input takes too few different values for a bandwidth from the data: give 'bandwidth' as a number"
    )


def _blocked(u: Array, y: Array) -> tuple[float, float]:
    """sigma^2 and theta_24 by quartics on blocks, as many as Mallows's C_p asks for (their section 3.1)."""
    n = len(u)
    most = max(min(n // _LEAST_BLOCK, _MOST_BLOCKS), 1)
    fits = []
    for blocks in range(1, most + 1):
        bounds = [round(k * n / blocks) for k in range(blocks + 1)]
        pieces = [slice(start, stop) for start, stop in pairwise(bounds)]
        fits.append([(piece, _quartic(u[piece], y[piece])) for piece in pieces])
    rss = np.array([sum(fit.rss for _, fit in fitted) for fitted in fits])
    parameters = (_DEGREE + 1) * np.arange(1, most + 1)
    noise = _noise(float(rss[-1]), n - parameters[-1], y)
    # C_p, without the n that all have in common.
    chosen = first_least(rss / noise + 2.0 * parameters)
    products = [float(fit.derivative(u[at], 2) @ fit.derivative(u[at], 4)) for at, fit in fits[chosen]]
    return _noise(float(rss[chosen]), n - parameters[chosen], y), sum(products) / n


@dataclass(frozen=True, eq=False)
class _Binned:
    """Samples shared out between the two nearest points of a grid: their ``counts`` and sums ``y`` (M,)."""

    step: float
    counts: Array
    y: Array

    @classmethod
    def of(cls, u: Array, y: Array) -> _Binned:
        step = float(u[-1] - u[0]) / (_GRID - 1)
        at = (u - u[0]) / step
        low = np.minimum(np.floor(at).astype(np.int64), _GRID - 2)
        right = at - low
        weights = np.concatenate((1.0 - right, right))
        places = np.concatenate((low, low + 1))
        counts, sums = (
            np.asarray(np.bincount(places, shared, _GRID), dtype=float)
            for shared in (weights, weights * np.concatenate((y, y)))
        )
        return cls(step, counts, sums)

    def theta(self, g: float) -> float:
        """theta_22 by local cubic fits with the bandwidth ``g``, without the ends of the grid."""
        moments = self._moments(self.counts, g, 7)
        right = self._moments(self.y, g, 4)
        cut = math.floor(_TRUNCATED * _GRID)
        inner = np.flatnonzero(self.counts[cut : _GRID - cut]) + cut
        normal = np.stack([moments[i : i + 4, inner] for i in range(4)])
        try:
            beta = np.linalg.solve(normal.transpose(2, 0, 1), right[:, inner].T[..., None])
        except np.linalg.LinAlgError:
            raise _few_values() from None
        curvature = 2.0 * beta[:, 2, 0] / g**2
        return float(self.counts[inner] @ curvature**2 / self.counts.sum())

    def residual(self, width: float, y: Array) -> tuple[float, float]:
        """The squares that a local linear fit leaves, and their degrees of freedom."""
        filled = self.counts > 0.0
        s0, s1, s2 = self._moments(self.counts, width, 3)[:, filled]
        t0, t1 = self._moments(self.y, width, 2)[:, filled]
        q0, q1, q2 = self._moments(self.counts, width, 3, squared=True)[:, filled]
        counts, sums = self.counts[filled], self.y[filled]
        with np.errstate(divide="ignore", invalid="ignore"):
            determinant = s0 * s2 - s1**2
            fit = (s2 * t0 - s1 * t1) / determinant
            own = s2 / determinant
            squared = (s2**2 * q0 - 2.0 * s1 * s2 * q1 + s1**2 * q2) / determinant**2
        freedom = float(np.sum(counts) - 2.0 * (own @ counts) + squared @ counts)
        residual = float(y @ y - 2.0 * (fit @ sums) + fit**2 @ counts)
        if not math.isfinite(residual) or not math.isfinite(freedom):
            raise _few_values()
        return residual, freedom

    def _moments(self, weights: Array, width: float, count: int, *, squared: bool = False) -> Array:
        """Sums over i of w_i K(d) d^r with d = (x_i - x_j)/width, at all points j: shape (count, M)."""
        d = np.arange(1 - _GRID, _GRID) * (self.step / width)
        kernel = np.exp(-0.5 * d**2) ** (2 if squared else 1)
        return np.stack([np.correlate(kernel * d**r, weights, "valid")[::-1] for r in range(count)])


Rule = Callable[[Array, Array, KernelConstants], float]
RULES: dict[str, Rule] = {"rule_of_thumb": rule_of_thumb, "plug_in": plug_in}
