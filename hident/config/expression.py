"""Formulas in configurations, parsed against a whitelist and never passed to ``eval``."""

from __future__ import annotations

import ast
import math
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hident.config import scalars
from hident.config.suggest import did_you_mean, one_of

CONSTANTS: dict[str, float] = {"pi": math.pi, "e": math.e}
FUNCTIONS: dict[str, tuple[Callable[..., Any], int]] = {
    "abs": (np.abs, 1),
    "sign": (np.sign, 1),
    "sqrt": (np.sqrt, 1),
    "exp": (np.exp, 1),
    "log": (np.log, 1),
    "log10": (np.log10, 1),
    "sin": (np.sin, 1),
    "cos": (np.cos, 1),
    "tan": (np.tan, 1),
    "arcsin": (np.arcsin, 1),
    "arccos": (np.arccos, 1),
    "arctan": (np.arctan, 1),
    "sinh": (np.sinh, 1),
    "cosh": (np.cosh, 1),
    "tanh": (np.tanh, 1),
    "floor": (np.floor, 1),
    "ceil": (np.ceil, 1),
    "minimum": (np.minimum, 2),
    "maximum": (np.maximum, 2),
    "clip": (np.clip, 3),
    "where": (np.where, 3),
}
_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.power,
}
_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: np.less,
    ast.LtE: np.less_equal,
    ast.Gt: np.greater,
    ast.GtE: np.greater_equal,
    ast.Eq: np.equal,
    ast.NotEq: np.not_equal,
}
# What is not rounded correctly by every processor and library, as IEEE 754 has it for the others.
_INEXACT: dict[Callable[..., Any], Callable[..., float]] = {
    np.power: scalars.power,
    np.exp: scalars.exp,
    np.log: scalars.log,
    np.log10: scalars.log10,
    np.sin: scalars.sin,
    np.cos: scalars.cos,
    np.tan: scalars.tan,
    np.arcsin: scalars.arcsin,
    np.arccos: scalars.arccos,
    np.arctan: scalars.arctan,
    np.sinh: scalars.sinh,
    np.cosh: scalars.cosh,
    np.tanh: scalars.tanh,
}
_LONGEST = 1000
_DEEPEST = 100
_LARGEST = sys.float_info.max


class FormulaError(ValueError):
    """A formula uses something outside the whitelist."""


@dataclass(frozen=True)
class Formula:
    """A formula over named variables, built of + - * / **, comparisons and whitelisted functions.

    Parameters
    ----------
    text : str
        The formula, at most 1000 characters, e.g. ``"0.5*abs(u) + 2*sin(u)"``.
    variables : tuple of str
        The names that the formula may use besides the constants ``pi`` and ``e``.

    FormulaError if the text is not a formula; the message names the part and what is allowed.
    """

    text: str
    variables: tuple[str, ...] = ()
    _tree: ast.expr = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if len(self.text) > _LONGEST:
            raise FormulaError(f"a formula has at most {_LONGEST} characters, not {len(self.text)}")
        try:
            with warnings.catch_warnings():
                # Python warns of what it finds odd, such as '1if'; nothing of that kind is allowed here.
                warnings.simplefilter("ignore")
                tree = ast.parse(self.text.strip(), mode="eval").body
        except SyntaxError as error:
            raise FormulaError(f"cannot read the formula {self.text!r}: {error.msg}") from None
        except (ValueError, MemoryError, RecursionError):
            raise FormulaError(f"cannot read the formula {self.text!r}") from None
        _check(tree, self.text, self.variables)
        object.__setattr__(self, "_tree", tree)

    def __call__(self, **values: NDArray[np.float64] | float) -> Any:
        """Evaluate on scalars or arrays of one shape; invalid operations give nan or inf.

        What is computed of Python's floats alone has the same bits on every machine.
        """
        with np.errstate(all="ignore"):
            return _evaluate(self._tree, values)

    def slope(self, variable: str, **values: NDArray[np.float64] | float) -> Any:
        """The derivative by a variable, on scalars or arrays of one shape; exact, but for rounding.

        It follows the formula's tree (Griewank and Walther 2008, Evaluating Derivatives, 3.1). Where the
        formula jumps or bends it is the derivative of one side, and a jump counts for nothing.

        Examples
        --------
        >>> Formula("u**3 + abs(u)", ("u",)).slope("u", u=np.array([-2.0, 1.0]))
        array([11.,  4.])
        """
        with np.errstate(all="ignore"):
            return _with_slope(self._tree, values, variable)[1]

    @property
    def tree(self) -> ast.expr:
        """What the text says, of the nodes that are allowed."""
        return self._tree


def number(text: str) -> float:
    """Evaluate a formula without variables, e.g. ``number("2*pi")``.

    FormulaError if the text is not a formula or its value is not a finite number.
    """
    value = float(Formula(text)())
    if not math.isfinite(value):
        raise FormulaError(f"the formula {text!r} gives {value}, not a finite number")
    return value


def _check(node: ast.expr, text: str, variables: tuple[str, ...], depth: int = 1) -> None:
    if depth > _DEEPEST:
        raise FormulaError(f"the formula {text!r} is nested more than {_DEEPEST} deep")
    children: list[ast.expr]
    match node:
        case ast.Constant(value=bool()):
            raise FormulaError(f"{node.value!r} is not allowed in a formula ({text!r})")
        case ast.Constant(value=int() | float() as value):
            if value > _LARGEST:
                raise FormulaError(f"a number in the formula {text!r} is too large")
            children = []
        case ast.Name(id=name):
            if name not in CONSTANTS and name not in variables:
                known = (*variables, *CONSTANTS, *FUNCTIONS)
                allowed = one_of((*variables, *CONSTANTS))
                raise FormulaError(
                    f"unknown name '{name}' in the formula {text!r}{did_you_mean(name, known)}"
                    f" (allowed: {allowed} and the functions {one_of(FUNCTIONS)})"
                )
            children = []
        case ast.UnaryOp(op=ast.UAdd() | ast.USub(), operand=operand):
            children = [operand]
        case ast.BinOp(left=left, op=operator, right=right) if type(operator) in _BINARY:
            children = [left, right]
        case ast.Compare(left=left, ops=[operator], comparators=[right]) if type(operator) in _COMPARE:
            children = [left, right]
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
            if name not in FUNCTIONS:
                raise FormulaError(
                    f"unknown function '{name}' in the formula {text!r}"
                    f"{did_you_mean(name, FUNCTIONS)} (allowed: {one_of(FUNCTIONS)})"
                )
            wanted = FUNCTIONS[name][1]
            if len(arguments) != wanted:
                raise FormulaError(
                    f"'{name}' takes {wanted} argument{'s' if wanted > 1 else ''}, "
                    f"not {len(arguments)}, in the formula {text!r}"
                )
            children = list(arguments)
        case _:
            part = ast.get_source_segment(text.strip(), node) or text
            raise FormulaError(
                f"{part!r} is not allowed in a formula "
                "(allowed: numbers, + - * / **, one comparison, and function calls)"
            )
    for child in children:
        _check(child, text, variables, depth + 1)


def _evaluate(node: ast.expr, values: dict[str, Any]) -> Any:
    match node:
        case ast.Constant(value=value):
            return float(value)  # type: ignore[arg-type]
        case ast.Name(id=name):
            return values[name] if name in values else CONSTANTS[name]
        case ast.UnaryOp(op=operator, operand=operand):
            value = _evaluate(operand, values)
            return _applied(np.negative, value) if isinstance(operator, ast.USub) else value
        case ast.BinOp(left=left, op=operation, right=right):
            return _applied(_BINARY[type(operation)], _evaluate(left, values), _evaluate(right, values))
        case ast.Compare(left=left, ops=[comparison], comparators=[right]):
            # As numbers, since numpy's booleans do not add up.
            return 1.0 * _applied(
                _COMPARE[type(comparison)], _evaluate(left, values), _evaluate(right, values)
            )
        case ast.Call(func=ast.Name(id=name), args=arguments):
            return _applied(FUNCTIONS[name][0], *(_evaluate(argument, values) for argument in arguments))
    raise AssertionError(f"unchecked node {node!r}")


def _applied(function: Callable[..., Any], *arguments: Any) -> Any:
    """numpy's function, except for what it does not round correctly of Python's floats alone."""
    value = function(*arguments)
    if any(type(argument) is not float for argument in arguments):
        return value
    exact = _INEXACT.get(function)
    # At zero, and where a value is not finite, numpy's is the right one everywhere.
    if exact is None or not all(math.isfinite(number) and number for number in (*arguments, value)):
        return float(value)
    return exact(*arguments)


# The derivative of each function of one argument, by the argument and the value.
_SLOPES: dict[str, Callable[[Any, Any], Any]] = {
    "abs": lambda x, y: np.sign(x),
    "sqrt": lambda x, y: 0.5 / y,
    "exp": lambda x, y: y,
    "log": lambda x, y: 1.0 / x,
    "log10": lambda x, y: 1.0 / (x * math.log(10.0)),
    "sin": lambda x, y: np.cos(x),
    "cos": lambda x, y: -np.sin(x),
    "tan": lambda x, y: 1.0 + y * y,
    "arcsin": lambda x, y: 1.0 / np.sqrt(1.0 - x * x),
    "arccos": lambda x, y: -1.0 / np.sqrt(1.0 - x * x),
    "arctan": lambda x, y: 1.0 / (1.0 + x * x),
    "sinh": lambda x, y: np.cosh(x),
    "cosh": lambda x, y: np.sinh(x),
    "tanh": lambda x, y: 1.0 - y * y,
}


def _with_slope(node: ast.expr, values: dict[str, Any], variable: str) -> tuple[Any, Any]:
    """The value of a node and its derivative by the variable, which is 0.0 where it does not depend on it."""
    match node:
        case ast.Name(id=name) if name == variable:
            return values[name], 1.0 + 0.0 * values[name]
        case ast.UnaryOp(op=operator, operand=operand):
            value, slope = _with_slope(operand, values, variable)
            return (-value, -slope) if isinstance(operator, ast.USub) else (value, slope)
        case ast.BinOp(left=left, op=operation, right=right):
            x, dx = _with_slope(left, values, variable)
            y, dy = _with_slope(right, values, variable)
            return _BINARY[type(operation)](x, y), _slope_of_two(operation, (x, dx), (y, dy))
        case ast.Call(func=ast.Name(id=name), args=arguments):
            found = [_with_slope(argument, values, variable) for argument in arguments]
            value = FUNCTIONS[name][0](*(x for x, _ in found))
            return value, _slope_of_call(name, found, value)
    return _evaluate(node, values), 0.0


def _is_nothing(slope: Any) -> bool:
    return isinstance(slope, float) and slope == 0.0


def _slope_of_two(operation: ast.operator, left: tuple[Any, Any], right: tuple[Any, Any]) -> Any:
    (x, dx), (y, dy) = left, right
    match operation:
        case ast.Add():
            return dx + dy
        case ast.Sub():
            return dx - dy
        case ast.Mult():
            return dx * y + x * dy
        case ast.Div():
            return dx / y if _is_nothing(dy) else (dx - x / y * dy) / y
    # A constant exponent has no logarithm in it, which a negative base would not have either.
    of_base = 0.0 if _is_nothing(dx) else np.where(np.equal(y, 0.0), 0.0, y * np.power(x, y - 1.0)) * dx
    return of_base if _is_nothing(dy) else of_base + np.power(x, y) * np.log(x) * dy


def _slope_of_call(name: str, found: list[tuple[Any, Any]], value: Any) -> Any:
    slopes = [slope for _, slope in found]
    if all(map(_is_nothing, slopes)):
        return 0.0
    arguments = [argument for argument, _ in found]
    match name:
        case "sign" | "floor" | "ceil":
            return 0.0 * slopes[0]
        case "minimum":
            return np.where(arguments[0] <= arguments[1], *slopes)
        case "maximum":
            return np.where(arguments[0] >= arguments[1], *slopes)
        case "clip":
            x, low, high = arguments
            return np.where(x < low, slopes[1], np.where(x > high, slopes[2], slopes[0]))
        case "where":
            return np.where(arguments[0], slopes[1], slopes[2])
    return _SLOPES[name](arguments[0], value) * slopes[0]
