"""The blocks of a model as numbers that any program can compute with.

A linear block is a filter of direct form II transposed with its state at the first sample. A static function
of any basis is one of three curves between two ends, and a line of a slope of its own beyond each:

    broken line        between points (knots, values); a saturation and a dead zone are such
    cubic pieces       d_0 + d_1 s + d_2 s^2 + d_3 s^3 with s = x - knot, on each piece
    Chebyshev sum      sum_k c_k T_k(t) with t = (2 x - low - high)/(high - low)

Functions that a user gave are formulas, which hold everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hident.block_chain import settled_state
from hident.errors import ConfigError
from hident.fitted_model import FittedModel
from hident.linear_blocks import TransferFunction
from hident.static_functions import (
    Chebyshev,
    CubicSpline,
    DeadZone,
    PiecewiseLinear,
    Saturation,
    StaticFunction,
)
from hident.systems.base import NonlinearitySpec
from hident.systems.function_basis import Functions, Series

Row = tuple[float, ...]


@dataclass(frozen=True)
class Filter:
    """a_0 y_k + ... + a_n y_{k-n} = b_0 x_k + ... + b_n x_{k-n} with a_0 = 1 and n >= 1.

    ``state`` (n,) times the first input is the state at the first sample.
    """

    b: Row
    a: Row
    state: Row


@dataclass(frozen=True)
class Curve:
    """A curve between two ends, and lines of the slopes ``left`` and ``right`` beyond them."""

    left: float
    right: float


@dataclass(frozen=True)
class BrokenLine(Curve):
    """Straight lines from point to point."""

    knots: Row
    values: Row


@dataclass(frozen=True)
class CubicPieces(Curve):
    """A cubic polynomial from each knot to the next: its coefficients by rising power of x - knot."""

    knots: Row
    pieces: tuple[Row, ...]


@dataclass(frozen=True)
class ChebyshevSum(Curve):
    """A sum of Chebyshev polynomials of x brought from [low, high] to [-1, 1]."""

    low: float
    high: float
    coefficients: Row


@dataclass(frozen=True)
class FormulaSum:
    """A sum of formulas in u, as configurations write them, each times a coefficient."""

    functions: tuple[str, ...]
    coefficients: Row


PlainBlock = Filter | BrokenLine | CubicPieces | ChebyshevSum | FormulaSum


def plain_blocks(model: FittedModel) -> tuple[PlainBlock, ...]:
    """The blocks of a model, in their order.

    Raises
    ------
    ConfigError
        If a basis is not one of hident's own, a block cannot start settled, or a slope or a state is too
        large for a number.
    """
    found: list[PlainBlock] = []
    for name, block in zip(model.chain.names, model.chain.blocks, strict=True):
        with np.errstate(all="ignore"):
            found.append(
                as_filter(block, settled=model.past == "settled")
                if isinstance(block, TransferFunction)
                else as_curve(block)
            )
        numbers = {key: value for key, value in vars(found[-1]).items() if key != "functions"}
        if not all(np.all(np.isfinite(value)) for value in numbers.values()):
            raise ConfigError(
                f"the numbers of {name} are too large to be converted: a slope or state overflows"
            )
    return tuple(found)


def as_filter(block: TransferFunction, *, settled: bool) -> Filter:
    """The filter of a linear block, which starts settled to its first input or at rest."""
    length = max(len(block.b), len(block.a) + 1, 2)
    b, a = (np.pad(row, (0, length - len(row))) for row in (np.asarray(block.b), block.denominator))
    try:
        state = settled_state(b, a) if settled else np.zeros(length - 1)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    return Filter(_row(b), _row(a), _row(state))


def as_curve(function: StaticFunction) -> BrokenLine | CubicPieces | ChebyshevSum | FormulaSum:
    """The curve of a static function."""
    basis, c = function.basis, _row(function.coefficients)
    match basis:
        case Saturation():
            corners = _row((basis.low, basis.high))
            return BrokenLine(0.0, 0.0, corners, tuple(c[0] + c[1] * corner for corner in corners))
        case DeadZone():
            return BrokenLine(c[1], c[2], _row((basis.low, basis.high)), (c[0], c[0]))
        case PiecewiseLinear():
            return BrokenLine(*_end_slopes(function, basis.knots), _row(basis.knots), c)
        case CubicSpline():
            return CubicPieces(*_end_slopes(function, basis.knots), _row(basis.knots), _pieces(basis, c))
        case Chebyshev():
            low, high = _row((basis.low, basis.high))
            return ChebyshevSum(*_end_slopes(function, (low, high)), low, high, c)
        case Functions():
            return FormulaSum(tuple(map(_formula, basis.functions)), c)
        case Series():
            if (found := basis.formulas(np.asarray(c))) is None:
                raise ConfigError(
                    f"a series of the basis '{basis.basis.kind}' with q = {basis.q} has no formula that is "
                    "accurate, and cannot be converted"
                )
            return FormulaSum(found[0], _row(found[1]))
    raise ConfigError(f"a static function of the basis '{basis.kind}' cannot be converted")


def _formula(function: NonlinearitySpec) -> str:
    if (text := function.formula()) is None:
        raise ConfigError(f"a function of the kind '{function.kind}' has no formula and cannot be converted")
    return text


def _end_slopes(function: StaticFunction, points: Row) -> tuple[float, float]:
    left, right = function.slope(np.array([points[0], points[-1]])).tolist()
    return left, right


def _pieces(basis: CubicSpline, coefficients: Row) -> tuple[Row, ...]:
    """The Taylor coefficients of the spline at the left end of each piece."""
    from scipy.interpolate import BSpline

    ends = [basis.knots[0]] * 3, [basis.knots[-1]] * 3
    spline = BSpline(np.concatenate((ends[0], basis.knots, ends[1])), coefficients, 3)
    left = np.asarray(basis.knots[:-1])
    rows = np.stack([spline(left, nu) / (1.0, 1.0, 2.0, 6.0)[nu] for nu in range(4)], axis=1)
    return tuple(map(_row, rows))


def _row(values: ArrayLike) -> Row:
    """The numbers as Python's own, whatever numpy made them."""
    return tuple(np.asarray(values, dtype=float).tolist())
