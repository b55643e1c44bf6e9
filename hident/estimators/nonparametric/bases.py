"""Orthonormal bases for series estimates.

Polynomial bases are evaluated by their three-term recurrences, one function at a time, so that memory
stays O(N) for any number of functions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hident.arrays import Array
from hident.config.spec import Component, Interval, component
from hident.estimators.nonparametric.fourier import trigonometric_series, trigonometric_sums

# Far out, a weight such as exp(-x^2/2) underflows long before the high orders are negligible: what exceeds
# exp(-_HELD) is held back, and released as the polynomials grow beyond exp(_RELEASED).
_HELD = 600.0
_RELEASED = 200.0
_STEP = float(np.finfo(float).eps) ** (1.0 / 3.0)
# The powers of a polynomial of a higher degree cancel each other.
_HIGHEST_DEGREE = 12


class BasisSpec(Component):
    """Base of all orthonormal bases phi_0, phi_1, ..."""

    def domain(self) -> tuple[float, float]:
        """The closed interval that the functions live on."""
        raise NotImplementedError

    def size(self, q: int) -> int:
        """The number of functions up to the cutoff level ``q``."""
        return q + 1

    def sums(self, x: Array, weights: Array, q: int) -> Array:
        """Sums over n of w_n phi_i(x_n): ``x`` (N,) and ``weights`` (K, N) to (K, size(q))."""
        raise NotImplementedError

    def series(self, x: Array, coefficients: Array) -> Array:
        """Sums over i of c_i phi_i(x): ``x`` (M,) and ``coefficients`` (K, size(q)) to (K, M)."""
        raise NotImplementedError

    def products(self, x: Array, points: Array, q: int) -> Array:
        """Sums over i of phi_i(x_m) phi_i(points_m): both (M,), and so is the answer."""
        raise NotImplementedError

    def slopes(self, x: Array, coefficients: Array) -> Array:
        """Sums over i of c_i phi_i'(x), as :meth:`series`; by default difference quotients, to ten digits.

        Points lie in the domain, and so do those of the quotients, which have half the digits at its ends.
        """
        low, high = self.domain()
        step = _STEP * np.maximum(np.abs(x), 1.0)
        below, above = np.maximum(x - step, low), np.minimum(x + step, high)
        rise = self.series(above, coefficients) - self.series(below, coefficients)
        return np.asarray(rise / (above - below))

    def moved(self, coefficients: Array, factor: float, offset: float) -> tuple[BasisSpec, Array]:
        """Basis and coefficients (size(q),) of the same function of z = factor x + offset.

        ValueError, as by default, where the functions hold in the unit of x alone.
        """
        raise ValueError(f"the {self.kind} basis holds in the unit of its argument")

    def formulas(self, q: int) -> tuple[str, ...] | None:
        """The functions up to the cutoff level as formulas in u; None if there are none that are accurate."""
        return None


class _WithInterval(BasisSpec):
    interval: Interval
    """The interval [low, high] of the input; samples outside are left out."""

    def domain(self) -> tuple[float, float]:
        return self.interval

    @property
    def _length(self) -> float:
        return self.interval[1] - self.interval[0]


@component("basis", "trigonometric", source="Mzyk 2009, section V")
class Trigonometric(_WithInterval):
    """Constant, cosines and sines of period L = high - low; q counts harmonics, so 2q + 1 functions.

    1/sqrt(L), sqrt(2/L) cos(2 pi x/L), sqrt(2/L) sin(2 pi x/L), sqrt(2/L) cos(4 pi x/L), ...

    Examples
    --------
    >>> basis = Trigonometric(interval=[0, 4])
    >>> basis.series(np.full(1, 0.5), np.eye(basis.size(1))).T.round(3)
    array([[0.5, 0.5, 0.5]])
    """

    def size(self, q: int) -> int:
        return 2 * q + 1

    def sums(self, x: Array, weights: Array, q: int) -> Array:
        harmonics = trigonometric_sums(self._angles(x), weights, q)
        sums = np.empty((len(weights), self.size(q)))
        sums[:, 0] = harmonics[:, 0].real / math.sqrt(self._length)
        sums[:, 1::2] = harmonics[:, 1:].real * math.sqrt(2.0 / self._length)
        sums[:, 2::2] = harmonics[:, 1:].imag * math.sqrt(2.0 / self._length)
        return sums

    def series(self, x: Array, coefficients: Array) -> Array:
        harmonics = np.empty((len(coefficients), coefficients.shape[1] // 2 + 1), dtype=complex)
        harmonics[:, 0] = coefficients[:, 0] / math.sqrt(self._length)
        harmonics[:, 1:] = (coefficients[:, 1::2] - 1j * coefficients[:, 2::2]) * math.sqrt(
            2.0 / self._length
        )
        return trigonometric_series(self._angles(x), harmonics)

    def products(self, x: Array, points: Array, q: int) -> Array:
        # Cosines of the differences.
        harmonics = np.full((1, q + 1), 2.0 / self._length, dtype=complex)
        harmonics[:, 0] /= 2.0
        products: Array = trigonometric_series(self._angles(x - points), harmonics)[0]
        return products

    def slopes(self, x: Array, coefficients: Array) -> Array:
        omega = 2.0 * math.pi / self._length * np.arange(1, coefficients.shape[1] // 2 + 1)
        turned = np.zeros_like(coefficients)
        turned[:, 1::2], turned[:, 2::2] = omega * coefficients[:, 2::2], -omega * coefficients[:, 1::2]
        return self.series(x, turned)

    def formulas(self, q: int) -> tuple[str, ...]:
        first, size = 1.0 / math.sqrt(self._length), math.sqrt(2.0 / self._length)
        found = [f"{first!r}"]
        for k in range(1, q + 1):
            omega = 2.0 * math.pi * k / self._length
            found += [f"{size!r}*cos({omega!r}*u)", f"{size!r}*sin({omega!r}*u)"]
        return tuple(found)

    def _angles(self, x: Array) -> Array:
        turns = x / self._length
        turns -= np.floor(turns + 0.5)
        turns *= 2.0 * math.pi
        return turns


class _ByRecurrence(BasisSpec):
    """phi_{k+1} = (slope_k x + offset_k) phi_k - back_k phi_{k-1}, from phi_0 = exp(log_first(x))."""

    def _log_first(self, x: Array) -> Array:
        raise NotImplementedError

    def _recurrence(self, k: int) -> tuple[float, float, float]:
        """slope_k, offset_k and back_k."""
        raise NotImplementedError

    def functions(self, x: Array, q: int) -> Iterator[Array]:
        """phi_0(x), ..., phi_q(x), each of the shape of ``x``."""
        log_first = self._log_first(x)
        held = np.minimum(log_first + _HELD, 0.0)
        far = bool(held.any())
        current, previous = np.exp(log_first - held), np.zeros_like(x)
        for k in range(q + 1):
            yield current * np.exp(held) if far else current
            slope, offset, back = self._recurrence(k)
            current, previous = (slope * x + offset) * current - back * previous, current
            if far:
                large = (held < 0.0) & (np.abs(current) > math.exp(_RELEASED))
                release = np.where(large, np.minimum(_RELEASED, -held), 0.0)
                current, previous = current * np.exp(-release), previous * np.exp(-release)
                held += release

    def sums(self, x: Array, weights: Array, q: int) -> Array:
        return np.stack([weights @ phi for phi in self.functions(x, q)], axis=1)

    def series(self, x: Array, coefficients: Array) -> Array:
        values = np.zeros((len(coefficients), len(x)))
        for c, phi in zip(coefficients.T, self.functions(x, coefficients.shape[1] - 1), strict=True):
            values += c[:, None] * phi
        return values

    def products(self, x: Array, points: Array, q: int) -> Array:
        values = np.zeros(len(x))
        for phi, there in zip(self.functions(x, q), self.functions(points, q), strict=True):
            values += phi * there
        return values


def _horner(coefficients: Array, argument: str) -> str:
    """The formula of a polynomial by rising power."""
    text = repr(float(coefficients[-1]))
    for c in coefficients[-2::-1].tolist():
        text = f"{c!r} + {argument}*({text})"
    return text


@component("basis", "legendre")
class Legendre(_ByRecurrence, _WithInterval):
    """Legendre polynomials on [low, high], orthonormal.

    Examples
    --------
    >>> Legendre(interval=[-1, 1]).series(np.ones(1), np.eye(3)).T.round(3)
    array([[0.707, 1.225, 1.581]])
    """

    def _log_first(self, x: Array) -> Array:
        return np.full(x.shape, -0.5 * math.log(self._length))

    def _recurrence(self, k: int) -> tuple[float, float, float]:
        # (k+1) P_{k+1} = (2k+1) t P_k - k P_{k-1}, normalised by sqrt((2k+1)/L)
        step = math.sqrt((2 * k + 1) * (2 * k + 3)) / (k + 1)
        back = k / (k + 1) * math.sqrt((2 * k + 3) / (2 * k - 1)) if k else 0.0
        slope = 2.0 / self._length
        offset = -sum(self.interval) / self._length
        return step * slope, step * offset, back

    def slopes(self, x: Array, coefficients: Array) -> Array:
        # P_k' = (2k-1) P_{k-1} + (2k-5) P_{k-3} + ..., normalised
        size = coefficients.shape[1]
        matrix = np.zeros((size, size))
        for k in range(size):
            below = np.arange(k - 1, -1, -2)
            matrix[k, below] = 2.0 / self._length * np.sqrt((2 * k + 1) * (2 * below + 1))
        return self.series(x, coefficients @ matrix)

    def moved(self, coefficients: Array, factor: float, offset: float) -> tuple[BasisSpec, Array]:
        low, high = sorted(factor * end + offset for end in self.interval)
        signs = np.sign(factor) ** np.arange(len(coefficients))
        return Legendre(interval=(low, high)), coefficients * signs * math.sqrt(abs(factor))

    def formulas(self, q: int) -> tuple[str, ...] | None:
        if q > _HIGHEST_DEGREE:
            return None
        argument = f"({2.0 / self._length!r}*u - {sum(self.interval) / self._length!r})"
        sizes = np.sqrt((2 * np.arange(q + 1) + 1) / self._length)
        return tuple(
            _horner(np.polynomial.legendre.leg2poly(size * np.eye(k + 1)[k]), argument)
            for k, size in enumerate(sizes)
        )


@component("basis", "laguerre")
class Laguerre(_ByRecurrence):
    """Laguerre functions exp(-x/2) L_k(x) on [0, inf); negative samples are left out.

    Examples
    --------
    >>> Laguerre().series(np.zeros(1), np.eye(3)).T.round(3)
    array([[1., 1., 1.]])
    """

    def domain(self) -> tuple[float, float]:
        return 0.0, math.inf

    def _log_first(self, x: Array) -> Array:
        return -0.5 * x

    def _recurrence(self, k: int) -> tuple[float, float, float]:
        # (k+1) L_{k+1} = (2k+1-x) L_k - k L_{k-1}
        return -1.0 / (k + 1), (2 * k + 1) / (k + 1), k / (k + 1)

    def slopes(self, x: Array, coefficients: Array) -> Array:
        # l_k' = -l_k/2 - l_{k-1} - ... - l_0
        size = coefficients.shape[1]
        return self.series(x, -coefficients @ (np.tri(size, k=-1) + 0.5 * np.eye(size)))

    def formulas(self, q: int) -> tuple[str, ...] | None:
        if q > _HIGHEST_DEGREE:
            return None
        units = (np.eye(k + 1)[k] for k in range(q + 1))
        return tuple(f"exp(-0.5*u)*({_horner(np.polynomial.laguerre.lag2poly(unit), 'u')})" for unit in units)


@component("basis", "hermite")
class Hermite(_ByRecurrence):
    """Hermite functions H_k(x) exp(-x^2/2) / sqrt(2^k k! sqrt(pi)) on the real line.

    Examples
    --------
    >>> Hermite().series(np.zeros(1), np.eye(3)).T.round(3)
    array([[ 0.751,  0.   , -0.531]])
    """

    def domain(self) -> tuple[float, float]:
        return -math.inf, math.inf

    def _log_first(self, x: Array) -> Array:
        return -0.5 * x**2 - 0.25 * math.log(math.pi)

    def _recurrence(self, k: int) -> tuple[float, float, float]:
        # H_{k+1} = 2x H_k - 2k H_{k-1}, normalised
        return math.sqrt(2.0 / (k + 1)), 0.0, math.sqrt(k / (k + 1))

    def slopes(self, x: Array, coefficients: Array) -> Array:
        # h_k' = sqrt(k/2) h_{k-1} - sqrt((k+1)/2) h_{k+1}
        roots = np.sqrt(0.5 * np.arange(1, coefficients.shape[1] + 1))
        turned = np.zeros((len(coefficients), coefficients.shape[1] + 1))
        turned[:, : coefficients.shape[1] - 1] = coefficients[:, 1:] * roots[:-1]
        turned[:, 1:] -= coefficients * roots
        return self.series(x, turned)

    def formulas(self, q: int) -> tuple[str, ...] | None:
        if q > _HIGHEST_DEGREE:
            return None
        found = []
        for k in range(q + 1):
            size = 1.0 / math.sqrt(2.0**k * math.factorial(k) * math.sqrt(math.pi))
            polynomial = _horner(np.polynomial.hermite.herm2poly(size * np.eye(k + 1)[k]), "u")
            found.append(f"exp(-0.5*u**2)*({polynomial})")
        return tuple(found)
