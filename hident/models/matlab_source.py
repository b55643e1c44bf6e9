"""A model as a MATLAB function, which Octave runs too."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from hident.errors import ConfigError
from hident.fitted_model import FittedModel
from hident.models.formula_source import MATLAB
from hident.models.plain_blocks import (
    BrokenLine,
    ChebyshevSum,
    CubicPieces,
    Filter,
    FormulaSum,
    PlainBlock,
    plain_blocks,
)
from hident.models.python_source import numbers
from hident.models.source_text import added, facts, kind_of, one_line, title, wrapped

_LONGEST = 63
_KEYWORD = re.compile(
    "break|case|catch|classdef|continue|else|elseif|end|for|function|global|if|otherwise|parfor|persistent|"
    "return|spmd|switch|try|while"
)
_FUNCTIONS: dict[type[PlainBlock], tuple[str, str]] = {
    Filter: (
        "linear_block",
        """\
function y = linear_block(x, b, a, state)
  % a(1) y(k) + a(2) y(k-1) + ... = b(1) x(k) + ...; the state is that of a first input of 1
  y = x;
  if ~isempty(x)
    y = filter(b, a, x, state(:) * x(1));
  end
end
""",
    ),
    BrokenLine: (
        "broken_line",
        """\
function y = broken_line(x, left, right, knots, values)
  % straight lines between points
  inside = min(max(x, knots(1)), knots(end));
  y = interp1(knots(:), values(:), inside) + beyond(x, knots(1), knots(end), left, right);
end
""",
    ),
    CubicPieces: (
        "cubic_pieces",
        """\
function y = cubic_pieces(x, left, right, knots, pieces)
  % a cubic polynomial of x - knot between each knot and the next, its coefficients by rising power
  inside = min(max(x, knots(1)), knots(end));
  y = ppval(mkpp(knots, pieces(:, 4:-1:1)), inside) + beyond(x, knots(1), knots(end), left, right);
end
""",
    ),
    ChebyshevSum: (
        "chebyshev_sum",
        """\
function y = chebyshev_sum(x, left, right, low, high, coefficients)
  % a sum of Chebyshev polynomials of x brought from [low, high] to [-1, 1], by Clenshaw's recurrence
  t = min(max((2 * x - low - high) / (high - low), -1), 1);
  next = zeros(size(x));
  second = next;
  for k = numel(coefficients):-1:2
    third = second;
    second = next;
    next = coefficients(k) + 2 * t .* second - third;
  end
  y = coefficients(1) + t .* next - second + beyond(x, low, high, left, right);
end
""",
    ),
}
_FUNCTIONS[FormulaSum] = (
    "formulas",
    """\
function y = formulas(x, functions, coefficients)
  % a sum of functions
  y = zeros(size(x));
  for k = 1:numel(functions)
    y = y + coefficients(k) * functions{k}(x);
  end
end
""",
)
_CHOOSE = """\
function y = choose(condition, first, second)
  % the first where the condition is not zero, else the second
  none = zeros(size(condition)) + zeros(size(first)) + zeros(size(second));
  y = none + second;
  first = none + first;
  chosen = none + (condition ~= 0) == 1;
  y(chosen) = first(chosen);
end
"""
_BEYOND = """\
function y = beyond(x, low, high, left, right)
  % what lines of these slopes add beyond the ends
  y = left * min(x - low, 0) + right * max(x - high, 0);
end
"""


def matlab_source(model: FittedModel, name: str = "response") -> str:
    """Source of the file ``name.m``: a function of an input vector.

    Raises
    ------
    ConfigError
        If MATLAB allows no function of that name.
    """
    require_name(name)
    blocks = plain_blocks(model)
    lines = [
        f"function y = {name}(u)",
        f"  % {one_line(title(model))}",
        f"  % y = {name}(u) is the output to an input, of its shape.",
        *(f"  % {one_line(fact)}" for fact in facts(model)),
        "  if ~(isvector(u) || isempty(u))",
        f"    error('{name}: the input must be a vector');",
        "  end",
        f"  x = double(u(:)){added(-model.offsets[0])};",
    ]
    for label, block, plain in zip(model.chain.names, model.chain.blocks, blocks, strict=True):
        lines.append(f"  % {label}: {kind_of(block)}")
        lines.append(f"  x = {called(plain, 'x')};")
    lines += [f"  y = reshape(x{added(model.offsets[1])}, size(u));", "end", ""]
    return "\n".join(["\n".join(lines), *functions(blocks, lines)])


def require_name(name: str, reserved: int = 0) -> None:
    """ConfigError if MATLAB allows no function of this name, with so many letters behind it."""
    longest = _LONGEST - reserved
    if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII) or _KEYWORD.fullmatch(name) or len(name) > longest:
        raise ConfigError(
            f"'{name}' cannot be the name of a MATLAB function: it must be letters, digits and underscores, "
            f"begin with a letter, and have at most {longest} of them"
        )


def functions(blocks: Iterable[PlainBlock], lines: Iterable[str]) -> list[str]:
    """The functions that compute blocks, and those that formulas in some lines use."""
    used = {type(plain) for plain in blocks}
    known = [source for kind, (_, source) in _FUNCTIONS.items() if kind in used]
    beyond = [_BEYOND] if used - {Filter, FormulaSum} else []
    choose = [_CHOOSE] if any("choose(" in line for line in lines) else []
    return [*known, *beyond, *choose]


def called(plain: PlainBlock, signal: str) -> str:
    """The call of a block's function with a signal."""
    arguments = [signal, *(written(value) for value in numbers(plain, MATLAB).values())]
    return f"{_FUNCTIONS[type(plain)][0]}(" + ", ...\n    ".join(arguments) + ")"


def written(value: Any) -> str:
    """A number, a row, a matrix, or a cell array of functions."""
    if not isinstance(value, tuple):
        return repr(value)
    if texts := [text for text in value if isinstance(text, str)]:
        return "{" + ", ...\n     ".join(wrapped([text], "", " ...") for text in texts) + "}"
    rows = [row for row in value if isinstance(row, tuple)]
    if rows:
        return "[" + "; ...\n     ".join(wrapped(map(repr, row), "", " ...") for row in rows) + "]"
    return f"[{wrapped(map(repr, value), '     ', ' ...').strip()}]"
