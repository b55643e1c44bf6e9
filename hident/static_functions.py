"""Static functions as numbers: a basis, and the coefficients that an estimate gives it.

Beyond the range that a basis spans, a function goes on as a straight line: what was never measured is not
extrapolated by a power.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Protocol

import numpy as np

from hident.arrays import Array


class Basis(Protocol):
    """Functions phi_1, ..., phi_K of one variable, which may have a shape of their own.

    ``f(x) = sum_k c_k phi_k(x)``. What is linear in the estimate are the coefficients c, what is not are the
    entries of ``shape``, such as the corners of a dead zone.
    """

    kind: ClassVar[str]

    @property
    def size(self) -> int:
        """The number K of functions."""

    @property
    def shape(self) -> tuple[float, ...]:
        """What the functions depend on besides x and is estimated with them; mostly nothing."""

    def reshaped(self, shape: Sequence[float]) -> Basis:
        """The basis with another shape; ValueError where there is none."""

    def rows(self, x: Array) -> Array:
        """phi_k(x), shape (K, N)."""

    def value(self, coefficients: Array, x: Array) -> Array:
        """f(x), shape (N,)."""

    def slope(self, coefficients: Array, x: Array) -> Array:
        """f'(x), shape (N,)."""

    def shape_rows(self, coefficients: Array, x: Array) -> Array:
        """The derivatives of f(x) by the entries of ``shape``, of shape (S, N)."""

    @property
    def range(self) -> tuple[float, float]:
        """The ends of what it spans."""

    def constant(self) -> Array:
        """The coefficients (K,) of the function that is 1 everywhere; ValueError if there are none."""

    def moved(self, coefficients: Array, factor: float, offset: float) -> tuple[Basis, Array]:
        """Basis and coefficients of f as a function of z = factor x + offset, with a factor other than 0.

        ValueError if the basis holds for x alone.
        """


@dataclass(frozen=True)
class _Fixed:
    """A basis without a shape of its own."""

    @property
    def shape(self) -> tuple[float, ...]:
        return ()

    def reshaped(self, shape: Sequence[float]) -> Any:
        return self

    def shape_rows(self, coefficients: Array, x: Array) -> Array:
        return np.zeros((0, len(x)))


@dataclass(frozen=True)
class Chebyshev(_Fixed):
    """Chebyshev polynomials T_0, ..., T_degree of x brought from [low, high] to [-1, 1].

    Examples
    --------
    >>> Chebyshev(degree=2, low=0.0, high=2.0).rows(np.array([0.0, 1.0, 2.0]))
    array([[ 1.,  1.,  1.],
           [-1.,  0.,  1.],
           [ 1., -1.,  1.]])
    """

    degree: int
    low: float
    high: float
    kind: ClassVar[str] = "polynomial"

    @property
    def size(self) -> int:
        return self.degree + 1

    def rows(self, x: Array) -> Array:
        t, beyond = self._inside(x)
        rows = np.array(np.polynomial.chebyshev.chebvander(t, self.degree).T, dtype=float)
        if np.any(beyond):
            # T_k'(1) = k^2, T_k'(-1) = (-1)^(k+1) k^2.
            k = np.arange(self.size, dtype=float)[:, None]
            rows += k**2 * np.where(t < 0.0, -((-1.0) ** k), 1.0) * beyond
        return rows

    def value(self, coefficients: Array, x: Array) -> Array:
        t, beyond = self._inside(x)
        value = np.polynomial.chebyshev.chebval(t, coefficients)
        return np.asarray(value + self._derivative(coefficients, t) * beyond if np.any(beyond) else value)

    def slope(self, coefficients: Array, x: Array) -> Array:
        slope = self._derivative(coefficients, self._inside(x)[0])
        return np.asarray(2.0 / (self.high - self.low) * slope)

    def moved(self, coefficients: Array, factor: float, offset: float) -> tuple[Chebyshev, Array]:
        low, high = sorted((factor * self.low + offset, factor * self.high + offset))
        signs = np.sign(factor) ** np.arange(self.size)
        return replace(self, low=low, high=high), np.asarray(coefficients * signs)

    @property
    def range(self) -> tuple[float, float]:
        return self.low, self.high

    def constant(self) -> Array:
        return np.asarray(np.eye(1, self.size)[0])

    def _inside(self, x: Array) -> tuple[Array, Array]:
        t = (2.0 * x - self.low - self.high) / (self.high - self.low)
        inside = np.clip(t, -1.0, 1.0)
        return inside, t - inside

    @staticmethod
    def _derivative(coefficients: Array, t: Array) -> Array:
        if len(coefficients) == 1:
            return np.zeros_like(t)
        return np.asarray(np.polynomial.chebyshev.chebval(t, np.polynomial.chebyshev.chebder(coefficients)))


@dataclass(frozen=True)
class PiecewiseLinear(_Fixed):
    """Straight lines between increasing knots; the coefficients are the values at the knots.

    Examples
    --------
    >>> PiecewiseLinear(knots=(0.0, 1.0, 3.0)).value(np.array([0.0, 2.0, 2.0]), np.array([-1.0, 0.5, 9.0]))
    array([-2.,  1.,  2.])
    """

    knots: tuple[float, ...]
    kind: ClassVar[str] = "piecewise_linear"

    @property
    def size(self) -> int:
        return len(self.knots)

    @cached_property
    def _knots(self) -> Array:
        return np.asarray(self.knots, dtype=float)

    def rows(self, x: Array) -> Array:
        piece, right = self._place(x)
        rows = np.zeros((self.size, len(x)))
        samples = np.arange(len(x))
        rows[piece, samples] = 1.0 - right
        rows[piece + 1, samples] = right
        return rows

    def value(self, coefficients: Array, x: Array) -> Array:
        piece, right = self._place(x)
        return np.asarray(coefficients[piece] * (1.0 - right) + coefficients[piece + 1] * right)

    def slope(self, coefficients: Array, x: Array) -> Array:
        return np.asarray((np.diff(coefficients) / np.diff(self._knots))[self._place(x)[0]])

    def moved(self, coefficients: Array, factor: float, offset: float) -> tuple[PiecewiseLinear, Array]:
        way = slice(None, None, 1 if factor > 0.0 else -1)
        knots = tuple(float(factor * knot + offset) for knot in self.knots[way])
        return PiecewiseLinear(knots), coefficients[way]

    @property
    def range(self) -> tuple[float, float]:
        return self.knots[0], self.knots[-1]

    def constant(self) -> Array:
        return np.ones(self.size)

    def _place(self, x: Array) -> tuple[Any, Array]:
        piece = np.clip(np.searchsorted(self._knots, x, side="right") - 1, 0, self.size - 2)
        return piece, (x - self._knots[piece]) / np.diff(self._knots)[piece]


@dataclass(frozen=True)
class CubicSpline(_Fixed):
    """Cubic B-splines on increasing knots, of which the first and the last are the ends of the range.

    There are two more than knots: every cubic polynomial is a sum of them, and they sum to one.

    Examples
    --------
    >>> basis = CubicSpline(knots=(0.0, 1.0, 2.0))
    >>> basis.size, basis.rows(np.array([0.3, 1.0])).sum(axis=0)
    (5, array([1., 1.]))
    """

    knots: tuple[float, ...]
    kind: ClassVar[str] = "cubic_spline"

    @property
    def size(self) -> int:
        return len(self.knots) + 2

    @cached_property
    def _knots(self) -> Array:
        return np.concatenate(([self.knots[0]] * 3, self.knots, [self.knots[-1]] * 3))

    @cached_property
    def _end_slopes(self) -> tuple[Array, Array]:
        """The slopes (K,) of the functions at both ends, which are those beyond them."""
        from scipy.interpolate import BSpline

        rise = BSpline(self._knots, np.eye(self.size), 3).derivative()
        return rise(self.knots[0]), rise(self.knots[-1])

    def rows(self, x: Array) -> Array:
        inside, beyond = self._inside(x)
        rows = np.zeros((self.size, len(x)))
        piece, samples = self._piece(inside), np.arange(len(x))
        for j, weight in enumerate(self._weights(inside, piece)):
            rows[piece + j, samples] = weight
        for outside, slopes in zip((beyond < 0.0, beyond > 0.0), self._end_slopes, strict=True):
            if np.any(outside):
                rows[:, outside] += slopes[:, None] * beyond[outside]
        return rows

    def _piece(self, inside: Array) -> Any:
        return np.clip(np.searchsorted(self.knots, inside, side="right") - 1, 0, len(self.knots) - 2)

    def _weights(self, x: Array, piece: Any) -> list[Array]:
        """The four functions that are not zero at x, by de Boor and Cox's recursion.

        ``BSpline.design_matrix`` gives the same in ten times the time.
        """
        knots, place = self._knots, piece + 3
        weights = [np.ones_like(x)]
        for degree in (1, 2, 3):
            following = [np.zeros_like(x)]
            for j, weight in enumerate(weights):
                low, high = knots[place + j + 1 - degree], knots[place + j + 1]
                share = weight / (high - low)
                following[j] += (high - x) * share
                following.append((x - low) * share)
            weights = following
        return weights

    def value(self, coefficients: Array, x: Array) -> Array:
        from scipy.interpolate import BSpline

        inside, beyond = self._inside(x)
        value = BSpline(self._knots, coefficients, 3)(inside)
        if np.any(beyond):
            left, right = (float(end @ coefficients) for end in self._end_slopes)
            value = value + np.where(beyond < 0.0, left, right) * beyond
        return np.asarray(value)

    def slope(self, coefficients: Array, x: Array) -> Array:
        from scipy.interpolate import BSpline

        return np.asarray(BSpline(self._knots, coefficients, 3).derivative()(self._inside(x)[0]))

    def moved(self, coefficients: Array, factor: float, offset: float) -> tuple[CubicSpline, Array]:
        way = slice(None, None, 1 if factor > 0.0 else -1)
        knots = tuple(float(factor * knot + offset) for knot in self.knots[way])
        return CubicSpline(knots), coefficients[way]

    @property
    def range(self) -> tuple[float, float]:
        return self.knots[0], self.knots[-1]

    def constant(self) -> Array:
        return np.ones(self.size)

    def _inside(self, x: Array) -> tuple[Array, Array]:
        inside = np.clip(x, self.knots[0], self.knots[-1])
        return inside, x - inside


@dataclass(frozen=True)
class _Corners:
    low: float
    high: float
    size: ClassVar[int]

    @property
    def shape(self) -> tuple[float, ...]:
        return (self.low, self.high)

    def reshaped(self, shape: Sequence[float]) -> Any:
        low, high = map(float, shape)
        if not low < high:
            raise ValueError(f"the corners {low:g} and {high:g} are not in increasing order")
        return replace(self, low=low, high=high)

    @property
    def range(self) -> tuple[float, float]:
        return self.low, self.high

    def constant(self) -> Array:
        return np.asarray(np.eye(1, self.size)[0])

    def _moved(self, factor: float, offset: float) -> Any:
        low, high = sorted((factor * self.low + offset, factor * self.high + offset))
        return replace(self, low=low, high=high)


@dataclass(frozen=True)
class Saturation(_Corners):
    """A line between two corners, constant beyond them: c_1 + c_2 min(max(x, low), high).

    Examples
    --------
    >>> Saturation(low=-1.0, high=2.0).value(np.array([0.0, 3.0]), np.array([-5.0, 1.0, 5.0]))
    array([-3.,  3.,  6.])
    """

    kind: ClassVar[str] = "saturation"
    size: ClassVar[int] = 2

    def rows(self, x: Array) -> Array:
        return np.stack((np.ones_like(x), np.clip(x, self.low, self.high)))

    def value(self, coefficients: Array, x: Array) -> Array:
        return np.asarray(coefficients[0] + coefficients[1] * np.clip(x, self.low, self.high))

    def slope(self, coefficients: Array, x: Array) -> Array:
        return np.asarray(coefficients[1] * ((x > self.low) & (x < self.high)))

    def shape_rows(self, coefficients: Array, x: Array) -> Array:
        return np.asarray(coefficients[1] * np.stack((x <= self.low, x >= self.high)))

    def moved(self, coefficients: Array, factor: float, offset: float) -> tuple[Saturation, Array]:
        constant, slope = coefficients
        return self._moved(factor, offset), np.array([constant - slope * offset / factor, slope / factor])


@dataclass(frozen=True)
class DeadZone(_Corners):
    """Constant between two corners, a line beyond each: c_1 + c_2 min(x - low, 0) + c_3 max(x - high, 0).

    Examples
    --------
    >>> DeadZone(low=-1.0, high=1.0).value(np.array([0.0, 1.0, 2.0]), np.array([-3.0, 0.0, 2.0]))
    array([-2.,  0.,  2.])
    """

    kind: ClassVar[str] = "dead_zone"
    size: ClassVar[int] = 3

    def rows(self, x: Array) -> Array:
        return np.stack((np.ones_like(x), np.minimum(x - self.low, 0.0), np.maximum(x - self.high, 0.0)))

    def value(self, coefficients: Array, x: Array) -> Array:
        return np.asarray(coefficients @ self.rows(x))

    def slope(self, coefficients: Array, x: Array) -> Array:
        return np.asarray(coefficients[1] * (x < self.low) + coefficients[2] * (x > self.high))

    def shape_rows(self, coefficients: Array, x: Array) -> Array:
        return np.stack((-coefficients[1] * (x < self.low), -coefficients[2] * (x > self.high)))

    def moved(self, coefficients: Array, factor: float, offset: float) -> tuple[DeadZone, Array]:
        order = [0, 1, 2] if factor > 0.0 else [0, 2, 1]
        return self._moved(factor, offset), coefficients[order] / np.array([1.0, factor, factor])


BASES: dict[str, type[Any]] = {
    basis.kind: basis for basis in (Chebyshev, PiecewiseLinear, CubicSpline, Saturation, DeadZone)
}
"""The bases by their kind."""


@dataclass(frozen=True)
class StaticFunction:
    """The function sum_k c_k phi_k(x) of a basis; elementwise.

    Examples
    --------
    >>> square = StaticFunction(Chebyshev(degree=2, low=-1.0, high=1.0), (0.5, 0.0, 0.5))
    >>> square(np.array([0.5, 1.0, 2.0])), square.slope(np.array([0.5]))
    (array([0.25, 1.  , 3.  ]), array([1.]))
    """

    basis: Basis
    coefficients: tuple[float, ...]

    def __call__(self, x: Array) -> Array:
        x = np.asarray(x, dtype=float)
        return self.basis.value(np.asarray(self.coefficients), x.ravel()).reshape(x.shape)

    @property
    def range(self) -> tuple[float, float]:
        """The ends of what the basis spans; the function is a line beyond."""
        return self.basis.range

    def scaled(self, factor: float, offset: float) -> StaticFunction:
        """The function factor f(x) + offset; ValueError if the basis has no constant to hold an offset."""
        one = self.basis.constant() if offset else np.zeros(self.basis.size)
        return StaticFunction(
            self.basis, tuple((factor * np.asarray(self.coefficients) + offset * one).tolist())
        )

    def moved(self, factor: float, offset: float) -> StaticFunction:
        """The function of z = factor x + offset that is f(x): in other units, or the other way round.

        ValueError if the basis holds for x alone.
        """
        basis, coefficients = self.basis.moved(np.asarray(self.coefficients), factor, offset)
        return StaticFunction(basis, tuple(coefficients.tolist()))

    def slope(self, x: Array) -> Array:
        """f'(x), of the shape of x."""
        x = np.asarray(x, dtype=float)
        return self.basis.slope(np.asarray(self.coefficients), x.ravel()).reshape(x.shape)
