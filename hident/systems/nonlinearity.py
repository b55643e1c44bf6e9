"""Static nonlinearities; the simple ones serve as instruments and known functions too."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, Any, Self

import numpy as np
from numpy.polynomial.polynomial import polyval
from pydantic import BeforeValidator, PrivateAttr, field_validator, model_validator

from hident.arrays import Array
from hident.config.expression import Formula
from hident.config.spec import Count, Limit, Real, component
from hident.systems.base import Coefficients, NonlinearitySpec

# A polynomial or a broken line of more numbers is no formula that anybody reads.
_LONGEST = 12


def _clipped(low: float, high: float) -> str:
    """The formula of u between two limits, one of which may be infinite."""
    if math.isinf(low):
        return f"minimum(u, {high!r})"
    return f"maximum(u, {low!r})" if math.isinf(high) else f"clip(u, {low!r}, {high!r})"


class _BreaksAtZero(NonlinearitySpec):
    def break_points(self) -> tuple[float, ...]:
        return (0.0,)


@component("nonlinearity", "identity")
class Identity(NonlinearitySpec):
    """The input itself: u.

    Examples
    --------
    >>> Identity()(np.array([-2.0, 1.0]))
    array([-2.,  1.])
    """

    def __call__(self, u: Array) -> Array:
        return np.positive(u)

    def formula(self) -> str:
        return "u"


@component("nonlinearity", "abs")
class Abs(_BreaksAtZero):
    """Absolute value: |u|.

    Examples
    --------
    >>> Abs()(np.array([-2.0, 1.0]))
    array([2., 1.])
    """

    def __call__(self, u: Array) -> Array:
        return np.abs(u)

    def formula(self) -> str:
        return "abs(u)"


@component("nonlinearity", "sign")
class Sign(_BreaksAtZero):
    """Sign: -1, 0 or 1.

    Examples
    --------
    >>> Sign()(np.array([-2.0, 0.0, 3.0]))
    array([-1.,  0.,  1.])
    """

    def __call__(self, u: Array) -> Array:
        return np.sign(u)

    def formula(self) -> str:
        return "sign(u)"


@component("nonlinearity", "power")
class Power(NonlinearitySpec):
    """Whole power: u^exponent.

    Examples
    --------
    >>> Power(exponent=2)(np.array([-2.0, 3.0]))
    array([4., 9.])
    """

    exponent: Count
    """Exponent, 0 or more."""

    @field_validator("exponent")
    @classmethod
    def _check_exponent(cls, exponent: int) -> int:
        if exponent < 0:
            raise ValueError(f"must be 0 or more, not {exponent}")
        return exponent

    def __call__(self, u: Array) -> Array:
        return u**self.exponent

    def formula(self) -> str:
        return f"u**{self.exponent}"


@component("nonlinearity", "polynomial")
class Polynomial(NonlinearitySpec):
    """Polynomial: c_0 + c_1 u + c_2 u^2 + ...

    Examples
    --------
    >>> Polynomial(coefficients=[1, 0, 2])(np.array([0.0, 3.0]))
    array([ 1., 19.])
    """

    coefficients: Coefficients
    """Coefficients c_0, c_1, ..., the constant first."""

    def __call__(self, u: Array) -> Array:
        return np.asarray(polyval(u, self.coefficients))

    def formula(self) -> str | None:
        # By Horner's rule, as polyval has it.
        text = repr(self.coefficients[-1])
        for c in self.coefficients[-2::-1]:
            text = f"{c!r} + u*({text})"
        return text if len(self.coefficients) <= _LONGEST else None

    def coefficients_by_power(self) -> dict[int, float]:
        return dict(enumerate(self.coefficients))


@component("nonlinearity", "exponential", source="Brouri, eq. (42b), (43b)")
class Exponential(NonlinearitySpec):
    """Exponential: scale * exp(rate * u).

    Examples
    --------
    >>> Exponential(scale=2)(np.array([0.0, 1.0])).round(3)
    array([2.   , 5.437])
    """

    scale: Real = 1.0
    """Value at u = 0."""
    rate: Real = 1.0
    """Growth rate, in units of 1/u."""

    def __call__(self, u: Array) -> Array:
        return self.scale * np.exp(self.rate * u)

    def formula(self) -> str:
        return f"{self.scale!r}*exp({self.rate!r}*u)"


def _as_point(value: Any) -> Any:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ValueError("must be a pair [u, value]")
    return value


@component("nonlinearity", "piecewise_linear")
class PiecewiseLinear(NonlinearitySpec):
    """Straight lines between given points, continued beyond the ends.

    Examples
    --------
    >>> PiecewiseLinear(points=[[0, 0], [1, 2]], right_slope=0)(np.array([-1.0, 0.5, 3.0]))
    array([-2.,  1.,  2.])
    """

    points: tuple[Annotated[tuple[Real, Real], BeforeValidator(_as_point)], ...]
    """At least two points [u, value], in increasing order of u."""
    left_slope: Real | None = None
    """Slope before the first point; that of the first segment if left out."""
    right_slope: Real | None = None
    """Slope after the last point; that of the last segment if left out."""

    @field_validator("points")
    @classmethod
    def _check_points(cls, points: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        if len(points) < 2:
            raise ValueError(f"must be at least two points, not {len(points)}")
        for (before, _), (after, _) in pairwise(points):
            if after <= before:
                raise ValueError(f"u must increase from point to point: {after:.10g} follows {before:.10g}")
        return points

    def _slopes(self) -> Array:
        """The slopes from left to right, shape (points + 1,)."""
        u, value = np.array(self.points).T
        inner = np.diff(value) / np.diff(u)
        left = inner[0] if self.left_slope is None else self.left_slope
        right = inner[-1] if self.right_slope is None else self.right_slope
        return np.concatenate(([left], inner, [right]))

    def __call__(self, u: Array) -> Array:
        knots, values = np.array(self.points).T
        slopes = self._slopes()
        outside = slopes[0] * np.minimum(u - knots[0], 0.0) + slopes[-1] * np.maximum(u - knots[-1], 0.0)
        return np.asarray(np.interp(u, knots, values) + outside)

    def slope(self, u: Array) -> Array:
        knots = np.array(self.points)[:, 0]
        return np.asarray(self._slopes()[np.searchsorted(knots, u, side="right")])

    def formula(self) -> str | None:
        if len(self.points) > _LONGEST:
            return None
        slopes = self._slopes().tolist()
        (first, value), (last, _) = self.points[0], self.points[-1]
        terms = [f"{value!r} + {slopes[0]!r}*minimum(u - {first!r}, 0)"]
        for (left, _), (right, _), slope in zip(self.points, self.points[1:], slopes[1:], strict=False):
            terms.append(f"{slope!r}*(clip(u, {left!r}, {right!r}) - {left!r})")
        return " + ".join([*terms, f"{slopes[-1]!r}*maximum(u - {last!r}, 0)"])

    def break_points(self) -> tuple[float, ...]:
        slopes = self._slopes()
        bends = ~np.isclose(slopes[:-1], slopes[1:], rtol=1e-12, atol=0.0)
        return tuple(u for (u, _), bend in zip(self.points, bends, strict=True) if bend)


class _Interval(NonlinearitySpec):
    low: Limit
    """Lower end of the interval; -.inf for none."""
    high: Limit
    """Upper end of the interval; .inf for none."""
    gain: Real = 1.0
    """Slope of the rising part."""

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.low >= self.high:
            raise ValueError(f"'low' must be below 'high', not {self.low:.10g} and {self.high:.10g}")
        if not self.break_points():
            raise ValueError("'low' and 'high' are infinite: one of them must be a number")
        return self

    def break_points(self) -> tuple[float, ...]:
        return tuple(end for end in (self.low, self.high) if math.isfinite(end))


@component("nonlinearity", "saturation")
class Saturation(_Interval):
    """Saturation: gain * u between low and high, constant outside.

    Examples
    --------
    >>> Saturation(low=-1, high=1)(np.array([-2.0, 0.5, 3.0]))
    array([-1. ,  0.5,  1. ])
    >>> Saturation(low=-1, high=math.inf)(np.array([-2.0, 0.5, 3.0]))
    array([-1. ,  0.5,  3. ])
    """

    def __call__(self, u: Array) -> Array:
        return self.gain * np.clip(u, self.low, self.high)

    def formula(self) -> str:
        return f"{self.gain!r}*{_clipped(self.low, self.high)}"


@component("nonlinearity", "dead_zone")
class DeadZone(_Interval):
    """Dead zone: zero between low and high, slope gain outside.

    Examples
    --------
    >>> DeadZone(low=-1, high=1)(np.array([-2.0, 0.5, 3.0]))
    array([-1.,  0.,  2.])
    """

    def __call__(self, u: Array) -> Array:
        return self.gain * (u - np.clip(u, self.low, self.high))

    def formula(self) -> str:
        return f"{self.gain!r}*(u - {_clipped(self.low, self.high)})"


@component("nonlinearity", "expression")
class Expression(NonlinearitySpec):
    """A formula in u, such as 0.5*abs(u) + 2*sin(u).

    Examples
    --------
    >>> Expression(expression="0.5*abs(u) + u**2")(np.array([-2.0, 0.0]))
    array([5., 0.])
    """

    expression: str
    """The formula: numbers, pi, e, + - * / **, one comparison, and functions of u."""
    breaks: tuple[Real, ...] = ()
    """Points where the formula or its derivative jumps, if any."""
    _formula: Formula = PrivateAttr()

    @field_validator("expression")
    @classmethod
    def _check_expression(cls, expression: str) -> str:
        Formula(expression, ("u",))
        return expression

    def model_post_init(self, context: Any) -> None:
        self._formula = Formula(self.expression, ("u",))

    def __call__(self, u: Array) -> Array:
        return np.full(u.shape, self._formula(u=u), dtype=float)

    def formula(self) -> str:
        return self.expression

    def break_points(self) -> tuple[float, ...]:
        return tuple(sorted(set(self.breaks)))


@component("nonlinearity", "mzyk2009", source="Mzyk 2009, section V")
class Mzyk2009(_BreaksAtZero):
    """(1/2 + sgn u)(|u| - pi) + 2 sin u: it jumps at 0, from pi/2 by way of -pi/2 to -3 pi/2.

    Examples
    --------
    >>> Mzyk2009()(np.array([-1.0, 0.0, 1.0])).round(3)
    array([-0.612, -1.571, -1.529])
    """

    def __call__(self, u: Array) -> Array:
        return (0.5 + np.sign(u)) * (np.abs(u) - np.pi) + 2.0 * np.sin(u)

    def formula(self) -> str:
        return "(0.5 + sign(u))*(abs(u) - pi) + 2*sin(u)"


def _wigren(u: Array, d: float) -> Array:
    return u / np.sqrt(d + 0.9 * u**2)


def _soft_dead_zone(u: Array) -> Array:
    return u**2 * np.expm1(0.7 * u)


@component("nonlinearity", "chen_type_1", source="Chen, Hwang, Chang 2009, example 1")
class ChenType1(NonlinearitySpec):
    """Smooth saturation: u / sqrt(0.1 + 0.9 u^2).

    Examples
    --------
    >>> ChenType1()(np.array([-1.0, 0.0, 3.0])).round(3)
    array([-1.   ,  0.   ,  1.048])
    """

    def __call__(self, u: Array) -> Array:
        return _wigren(u, 0.1)

    def formula(self) -> str:
        return "u/sqrt(0.1 + 0.9*u**2)"


@component("nonlinearity", "chen_type_2", source="Chen, Hwang, Chang 2009, example 1")
class ChenType2(NonlinearitySpec):
    """A kind of dead zone: -u^2 (1 - exp(0.7 u)).

    Examples
    --------
    >>> ChenType2()(np.array([-1.0, 0.0, 1.0])).round(3)
    array([-0.503,  0.   ,  1.014])
    """

    def __call__(self, u: Array) -> Array:
        return _soft_dead_zone(u)

    def formula(self) -> str:
        return "u**2*(exp(0.7*u) - 1)"


@component("nonlinearity", "chen_type_3", source="Chen, Hwang, Chang 2009, example 2")
class ChenType3(_BreaksAtZero):
    """Type 1 for u >= 0, type 2 for u < 0.

    Examples
    --------
    >>> ChenType3()(np.array([-1.0, 0.0, 1.0])).round(3)
    array([-0.503,  0.   ,  1.   ])
    """

    def __call__(self, u: Array) -> Array:
        # Both vanish at zero, and exp never sees a large positive argument.
        return _wigren(np.maximum(u, 0.0), 0.1) + _soft_dead_zone(np.minimum(u, 0.0))

    def formula(self) -> str:
        above, below = "maximum(u, 0)", "minimum(u, 0)"
        return f"{above}/sqrt(0.1 + 0.9*{above}**2) + {below}**2*(exp(0.7*{below}) - 1)"


@component("nonlinearity", "chen_type_4", source="Chen, Hwang, Chang 2009, example 2")
class ChenType4(NonlinearitySpec):
    """Smooth saturation of adjustable degree: u / sqrt(D + 0.9 u^2).

    Examples
    --------
    >>> ChenType4(d=1)(np.array([-1.0, 0.0, 3.0])).round(3)
    array([-0.725,  0.   ,  0.994])
    """

    d: Real
    """D, positive: the smaller, the harder the saturation."""

    @field_validator("d")
    @classmethod
    def _check_d(cls, d: float) -> float:
        if d <= 0.0:
            raise ValueError(f"must be positive, not {d:.10g}")
        return d

    def __call__(self, u: Array) -> Array:
        return _wigren(u, self.d)

    def formula(self) -> str:
        return f"u/sqrt({self.d!r} + 0.9*u**2)"
