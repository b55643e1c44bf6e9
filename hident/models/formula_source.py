"""Formulas of configurations in the languages that models are converted to."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass

from hident.config.expression import CONSTANTS, FUNCTIONS, Formula

_OPERATORS: Mapping[type[ast.operator], str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.Pow: "**",
}
_COMPARISONS: Mapping[type[ast.cmpop], str] = {
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.Eq: "==",
    ast.NotEq: "!=",
}


@dataclass(frozen=True)
class Language:
    """How a language writes operators, comparisons and functions that it has by other names.

    Templates of functions take their arguments by place.
    """

    operators: Mapping[str, str]
    comparisons: Mapping[str, str]
    functions: Mapping[str, str]
    function: str

    def written(self, formula: str) -> str:
        """A formula in u as a function of one argument."""
        return self.function.format(self._node(Formula(formula, ("u",)).tree))

    def _node(self, node: ast.expr) -> str:
        match node:
            case ast.Constant(value=value):
                return repr(float(value))  # type: ignore[arg-type]
            case ast.Name(id=name):
                return repr(CONSTANTS[name]) if name in CONSTANTS else name
            case ast.UnaryOp(op=operator, operand=operand):
                return f"({'-' if isinstance(operator, ast.USub) else '+'}{self._node(operand)})"
            case ast.BinOp(left=left, op=operation, right=right):
                sign = _OPERATORS[type(operation)]
                return f"({self._node(left)} {self.operators.get(sign, sign)} {self._node(right)})"
            case ast.Compare(left=left, ops=[comparison], comparators=[right]):
                sign = _COMPARISONS[type(comparison)]
                inner = f"{self._node(left)} {self.comparisons.get(sign, sign)} {self._node(right)}"
                return f"(1.0 * ({inner}))"
            case ast.Call(func=ast.Name(id=name), args=arguments):
                return self.functions[name].format(*map(self._node, arguments))
        raise AssertionError(f"unchecked node {node!r}")


NUMPY = Language(
    {},
    {},
    {name: f"np.{name}({', '.join(['{}'] * count)})" for name, (_, count) in FUNCTIONS.items()},
    "lambda u: {}",
)
"""Python with numpy as np."""

MATLAB = Language(
    {"*": ".*", "/": "./", "**": ".^"},
    {"!=": "~="},
    {
        **{name: f"{name}({', '.join(['{}'] * count)})" for name, (_, count) in FUNCTIONS.items()},
        "arcsin": "asin({})",
        "arccos": "acos({})",
        "arctan": "atan({})",
        "minimum": "min({}, {})",
        "maximum": "max({}, {})",
        "clip": "min(max({}, {}), {})",
        "where": "choose({}, {}, {})",
    },
    "@(u) {}",
)
"""MATLAB, with a function 'choose' where a formula has 'where'."""
