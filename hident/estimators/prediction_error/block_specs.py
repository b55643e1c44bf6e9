"""The blocks of a chain as a configuration writes them: orders of linear ones, kinds of static ones."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from hident.arrays import Array, Characteristic
from hident.block_chain import Block
from hident.config.spec import Component, Count, Flag, Interval, NonEmpty, Of, Real, component
from hident.estimators.prediction_error.continuous_structure import ContinuousStructure
from hident.estimators.prediction_error.parameters import LinearStructure
from hident.estimators.prediction_error.structure import StaticKind
from hident.linear_blocks import MOST_POLES, ContinuousTransferFunction, TransferFunction
from hident.sampled_blocks import Intersample, SampledTransferFunction
from hident.static_functions import (
    Basis,
    Chebyshev,
    CubicSpline,
    DeadZone,
    PiecewiseLinear,
    Saturation,
    StaticFunction,
)
from hident.systems.base import NonlinearitySpec, OfStatic
from hident.systems.continuous import ContinuousSpec
from hident.systems.function_basis import Functions, Series
from hident.systems.linear import DiscreteSpec, LinearSpec

_POINTS = 2001
# Functions that a user gives have a unit of their own: where in it a signal lies is not known, nor its sign.
_SPREADS = tuple(sign * size for size in (1.0, 0.3, 3.0, 0.1, 10.0) for sign in (1.0, -1.0))


class BlockSpec(Component):
    """Base of the blocks of a chain."""

    held: Flag = False
    """Whether the block stays as ``start`` says."""

    def structure(self, dt: float = 1.0) -> LinearStructure | StaticKind:
        """What is to be found of the block, for samples every ``dt``."""
        raise NotImplementedError

    def given(self, dt: float = 1.0) -> Block | None:
        """The block that the search starts from, or that is held; None if it is for the method to find."""
        raise NotImplementedError

    def fewest_numbers(self) -> int:
        """How many numbers are to be found, at least."""
        raise NotImplementedError

    def numbers(self) -> int:
        """How many numbers are to be found, of a signal with enough levels to tell them."""
        return self.fewest_numbers()


class DynamicSpec(BlockSpec):
    """Base of the linear blocks."""

    def number_names(self) -> list[str]:
        """The names of the numbers that are to be found."""
        return self._orders(1.0).names()

    def fewest_numbers(self) -> int:
        return self._orders(1.0).size

    def structure(self, dt: float = 1.0) -> LinearStructure:
        return self._orders(dt)

    def _orders(self, dt: float) -> LinearStructure:
        raise NotImplementedError


@component("block", "linear", source="Ljung, System Identification, 2nd ed., (4.41)")
class LinearBlock(DynamicSpec):
    """Linear block (b_nk q^-nk + ... + b_(nk+nb-1) q^-(nk+nb-1))/(1 + f_1 q^-1 + ... + f_nf q^-nf).

    Examples
    --------
    >>> LinearBlock(nb=2, nf=1, nk=1).structure()
    LinearStructure(nb=2, nf=1, nk=1)
    """

    nb: Annotated[Count, Field(ge=1, le=1000)]
    """Coefficients of the numerator."""
    nf: Annotated[Count, Field(ge=0, le=MOST_POLES)] = 0
    """Poles."""
    nk: Annotated[Count, Field(ge=0, le=100_000)] = 0
    """Delay in samples."""
    start: Annotated[LinearSpec, Of("linear")] | None = None
    """A discrete block to start from, in place of what the record suggests."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.start is None:
            if self.held:
                raise ValueError("'held' needs 'start', the block that stays")
            return self
        if not isinstance(self.start, DiscreteSpec):
            raise ValueError(f"'start' must be a discrete block, not {self.start.kind}")
        block = self.start.transfer_function()
        assert isinstance(block, TransferFunction)
        if block.integrators():
            raise ValueError("'start' has a pole at 1, and the blocks that are fitted are stable")
        if any(block.b[: self.nk]) or len(block.b) > self.nk + self.nb or len(block.a) > self.nf:
            raise ValueError(
                f"'start' has coefficients beyond nb = {self.nb}, nf = {self.nf}, nk = {self.nk}"
            )
        return self

    def _orders(self, dt: float) -> LinearStructure:
        return LinearStructure(self.nb, self.nf, self.nk)

    def given(self, dt: float = 1.0) -> TransferFunction | None:
        if self.start is None:
            return None
        block = self.start.transfer_function()
        assert isinstance(block, TransferFunction)
        structure = self.structure()
        return structure.made(structure.numbers(block))


@component("block", "continuous", source="Chen, Hwang, Chang 2009, eq. (1), (9)")
class ContinuousBlock(DynamicSpec):
    """Continuous block (b_0 + ... + b_m s^m) e^(-delay s) / (1 + a_1 s + ... + a_n s^n).

    It is exact at the samples, and stable. Records need a sampling interval, in whose unit times and
    coefficients are.

    Examples
    --------
    >>> ContinuousBlock(n=2, delay=0.5).structure(dt=0.25).names()
    ['b_0', 'a_1', 'a_2']
    """

    n: Annotated[Count, Field(ge=1, le=12)]
    """Order n of the denominator: poles."""
    m: Annotated[Count, Field(ge=0)] = 0
    """Order m of the numerator, below n."""
    delay: Annotated[Real, Field(ge=0)] | None = None
    """Delay, in the unit of dt; need not be a multiple of dt. None by default."""
    nk: Annotated[Count, Field(ge=0, le=100_000)] | None = None
    """Delay in samples, in the place of 'delay'."""
    intersample: Intersample | None = None
    """What the block's input is between samples: held, or linear, along straight lines.

    By default linear behind another continuous block, whose output moves between samples, else held.
    """
    start: Annotated[LinearSpec, Of("linear")] | None = None
    """A continuous block to start from, in place of what the record suggests."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.m >= self.n:
            raise ValueError(f"the order m = {self.m} of the numerator must be below n = {self.n}")
        if self.delay is not None and self.nk is not None:
            raise ValueError("give either 'delay', in the unit of dt, or 'nk', in samples")
        if self.start is None:
            if self.held:
                raise ValueError("'held' needs 'start', the block that stays")
            return self
        if not isinstance(self.start, ContinuousSpec):
            raise ValueError(f"'start' must be a continuous block, not {self.start.kind}")
        block = self.start.transfer_function()
        if block.integrators:
            raise ValueError("'start' has a pole at 0, and the blocks that are fitted are stable")
        if len(block.a) != self.n or len(np.trim_zeros(block.b, "b")) > self.m + 1:
            raise ValueError(
                f"'start' has the orders {len(block.a)} and {len(block.b) - 1}, not n = {self.n} and "
                f"m = {self.m}"
            )
        if self.nk is None and block.delay != (self.delay or 0.0):
            raise ValueError(f"'start' has the delay {block.delay:g}, and the block {self.delay or 0.0:g}")
        return self

    def delay_at(self, dt: float) -> float:
        """The delay, in the unit of dt."""
        return (self.delay or 0.0) if self.nk is None else self.nk * dt

    def _orders(self, dt: float) -> ContinuousStructure:
        return ContinuousStructure.of(self.n, self.m, self.delay_at(dt), dt, self.intersample or "held")

    def given(self, dt: float = 1.0) -> SampledTransferFunction | None:
        if self.start is None:
            return None
        block = self.start.transfer_function()
        assert isinstance(block, ContinuousTransferFunction)
        made = replace(block, b=block.b[: self.m + 1], delay=self.delay_at(dt))
        return SampledTransferFunction(made, dt, self.intersample or "held")


class StaticSpec(BlockSpec):
    """Base of the static blocks."""

    range: Interval | None = None
    """Ends [low, high] of what the basis spans, beyond which it is a line; those of the signal by default."""
    start: Annotated[NonlinearitySpec, OfStatic()] | None = None
    """A nonlinearity to start from: the nearest function of this kind over ``range``."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.held and self.start is None:
            raise ValueError("'held' needs 'start', the function that stays")
        if self.start is not None and self.range is None:
            raise ValueError("'start' needs 'range', over which the nearest function of this kind is taken")
        return self

    def structure(self, dt: float = 1.0) -> StaticKind:
        return self

    def fewest_numbers(self) -> int:
        # A basis may take its knots from a few levels.
        x = np.array([0.0, 1.0])
        basis = self.basis_for(x, 0.0, 1.0)
        return len(basis.shape) + basis.size

    def numbers(self) -> int:
        basis = self.basis_for(np.linspace(0.0, 1.0, _POINTS), 0.0, 1.0)
        return len(basis.shape) + basis.size

    def functions(self) -> tuple[Characteristic, ...]:
        """The functions whose sums it is, on some range: the one that is held, or those of its basis."""
        if self.held and self.start is not None:
            return (self.start,)
        low, high = self.range or (-1.0, 1.0)
        basis = self.basis_for(np.linspace(low, high, _POINTS), low, high)
        return tuple(partial(_row, basis, k) for k in range(basis.size))

    def is_fixed(self) -> bool:
        """Whether its range does not follow the signal."""
        return self.range is not None

    def has_unit(self) -> bool:
        """Whether a factor in its argument is no matter of its coefficients, but a property of the data."""
        return False

    def spreads(self) -> tuple[float, ...]:
        """Standard deviations that its input is tried with at a start, where a block before can give any."""
        return (1.0,)

    def basis_for(self, x: Array, low: float, high: float) -> Basis:
        """The basis for a signal x (N,), which spans [low, high]."""
        return self._basis(x, *(self.range or (low, high)))

    def _basis(self, x: Array, low: float, high: float) -> Basis:
        raise NotImplementedError

    def given(self, dt: float = 1.0) -> StaticFunction | None:
        if self.start is None or self.range is None:
            return None
        x = np.linspace(*self.range, _POINTS)
        basis = self.basis_for(x, *self.range)
        if len(points := self.start.break_points()) == len(basis.shape) == 2:
            basis = basis.reshaped(points)
        coefficients = np.linalg.lstsq(basis.rows(x).T, self.start(x), rcond=None)[0]
        return StaticFunction(basis, tuple(coefficients.tolist()))


def _row(basis: Basis, k: int, x: Array) -> Array:
    return np.asarray(basis.rows(x)[k])


@component("block", "polynomial")
class PolynomialBlock(StaticSpec):
    """Polynomial, as a sum of Chebyshev polynomials over the range.

    Examples
    --------
    >>> PolynomialBlock(degree=3).basis_for(np.zeros(1), -1.0, 1.0).size
    4
    """

    degree: Annotated[Count, Field(ge=1, le=50)]
    """Degree."""

    def _basis(self, x: Array, low: float, high: float) -> Basis:
        return Chebyshev(self.degree, low, high)


def _knots(x: Array, low: float, high: float, count: int, *, is_given: bool) -> tuple[float, ...]:
    """Knots from low to high: evenly spaced over a range that was given.

    Else each is half-way between its even place and a quantile of the signal: where there are many samples,
    they can tell more, and the greatest of many samples is far out.
    """
    even = np.linspace(low, high, count)
    if is_given:
        return tuple(even.tolist())
    middle = np.quantile(x, np.linspace(0.0, 1.0, count))
    middle[0], middle[-1] = low, high
    return tuple((0.5 * (even + middle)).tolist())


def _levels(x: Array, most: int) -> tuple[float, ...]:
    """The levels of a signal that has from 2 to so many; none of any other."""
    levels = np.unique(x)
    return tuple(levels.tolist()) if 2 <= len(levels) <= most else ()


@component("block", "piecewise_linear")
class PiecewiseLinearBlock(StaticSpec):
    """Straight lines between knots, more of them where there are more samples; or between a few levels.

    Examples
    --------
    >>> PiecewiseLinearBlock(knots=3).basis_for(np.linspace(0, 1, 9), 0.0, 1.0).knots
    (0.0, 0.5, 1.0)
    """

    knots: Annotated[Count, Field(ge=2, le=500)]
    """Number of knots, evenly spaced where ``range`` is given."""

    def _basis(self, x: Array, low: float, high: float) -> Basis:
        knots = _knots(x, low, high, self.knots, is_given=self.is_fixed())
        return PiecewiseLinear(_levels(x, self.knots) or knots)


@component("block", "cubic_spline")
class CubicSplineBlock(StaticSpec):
    """Cubic spline on knots, more of them where there are more samples: two more coefficients than knots.

    Examples
    --------
    >>> CubicSplineBlock(knots=3).basis_for(np.linspace(0, 1, 9), 0.0, 1.0).size
    5
    """

    knots: Annotated[Count, Field(ge=2, le=500)]
    """Number of knots, the ends of the range among them."""

    def _basis(self, x: Array, low: float, high: float) -> Basis:
        return CubicSpline(_knots(x, low, high, self.knots, is_given=self.is_fixed()))


@component("block", "expansion")
class ExpansionBlock(StaticSpec):
    """Sum of given functions with coefficients that are found; they hold beyond the signal as well.

    Where they are no powers, abs or sign, the unit of their argument matters: a linear block before them
    keeps its gain.

    Examples
    --------
    >>> block = ExpansionBlock(basis=["identity", {"kind": "expression", "expression": "tanh(2*u)"}])
    >>> block.basis_for(np.zeros(1), -1.0, 1.0).rows(np.array([0.5])).round(3)
    array([[0.5  ],
           [0.762]])
    """

    basis: NonEmpty[Annotated[NonlinearitySpec, OfStatic()]]
    """The basis functions phi_1, ..., phi_m, e.g. [abs, {kind: expression, expression: tanh(2*u)}]."""
    range: Interval | None = None
    """Interval over which the nearest function to ``start`` is taken."""

    def is_fixed(self) -> bool:
        return True

    def has_unit(self) -> bool:
        return not Functions(self.basis, -1.0, 1.0).is_free_of_scale()

    def spreads(self) -> tuple[float, ...]:
        return _SPREADS if self.has_unit() else (1.0,)

    def _basis(self, x: Array, low: float, high: float) -> Basis:
        return Functions(self.basis, low, high)


@component("block", "series")
class SeriesBlock(StaticSpec):
    """Series of orthonormal functions up to a cutoff level, with lines beyond their domain.

    Examples
    --------
    >>> block = SeriesBlock(basis={"kind": "trigonometric", "interval": [0, 4]}, q=2)
    >>> block.basis_for(np.zeros(1), -1.0, 1.0).size
    5
    """

    basis: Annotated[Any, Of("basis")]
    """The orthonormal functions, on a domain in the unit of the block's input."""
    q: Annotated[Count, Field(ge=1, le=500)]
    """Cutoff level; the trigonometric basis has 2q + 1 functions up to it, the others q + 1."""
    range: Interval | None = None
    """Interval over which the nearest function to ``start`` is taken."""

    def is_fixed(self) -> bool:
        return True

    def has_unit(self) -> bool:
        return not Series(self.basis, self.q, -1.0, 1.0).is_free_of_scale()

    def spreads(self) -> tuple[float, ...]:
        low, high = self.basis.domain()
        # Nearly all of a signal lies within two and a half standard deviations.
        size = 0.2 * (high - low) if np.isfinite(high - low) else 1.0
        return tuple(size * spread for spread in (_SPREADS if self.has_unit() else _SPREADS[:4]))

    def _basis(self, x: Array, low: float, high: float) -> Basis:
        return Series(self.basis, self.q, low, high)


class _WithCorners(StaticSpec):
    def is_fixed(self) -> bool:
        return True


@component("block", "saturation")
class SaturationBlock(_WithCorners):
    """Line between two corners that are found, constant beyond them.

    Examples
    --------
    >>> SaturationBlock().basis_for(np.linspace(-2, 2, 101), -2.0, 2.0).kind
    'saturation'
    """

    def _basis(self, x: Array, low: float, high: float) -> Basis:
        return Saturation(*_corners(x, 0.15, low, high))


@component("block", "dead_zone")
class DeadZoneBlock(_WithCorners):
    """Constant between two corners that are found, a line beyond each.

    Examples
    --------
    >>> DeadZoneBlock().basis_for(np.linspace(-2, 2, 101), -2.0, 2.0).kind
    'dead_zone'
    """

    def _basis(self, x: Array, low: float, high: float) -> Basis:
        return DeadZone(*_corners(x, 0.35, low, high))


def _corners(x: Array, share: float, low: float, high: float) -> tuple[float, float]:
    """Corners that leave this share of the signal beyond each of them."""
    left, right = (float(value) for value in np.quantile(x, [share, 1.0 - share]))
    return (left, right) if left < right else (low + share * (high - low), high - share * (high - low))
