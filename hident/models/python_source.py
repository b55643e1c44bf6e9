"""A model as a Python function that needs numpy alone, or scipy.signal."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any

from hident.fitted_model import FittedModel
from hident.linear_blocks import TransferFunction
from hident.models.formula_source import NUMPY, Language
from hident.models.plain_blocks import (
    BrokenLine,
    ChebyshevSum,
    CubicPieces,
    Curve,
    Filter,
    FormulaSum,
    PlainBlock,
    Row,
    plain_blocks,
)
from hident.models.source_text import WIDTH, added, facts, kind_of, one_line, title, wrapped

CURVES: dict[type[PlainBlock], tuple[str, str]] = {
    BrokenLine: (
        "broken_line",
        '''\
def broken_line(x, left, right, knots, values):
    """Straight lines between points."""
    return np.interp(x, knots, values) + beyond(x, knots[0], knots[-1], left, right)
''',
    ),
    CubicPieces: (
        "cubic_pieces",
        '''\
def cubic_pieces(x, left, right, knots, pieces):
    """A cubic polynomial of x - knot between each knot and the next, its coefficients by rising power."""
    inside = np.clip(x, knots[0], knots[-1])
    i = np.clip(np.searchsorted(knots, inside, side="right") - 1, 0, len(pieces) - 1)
    s, (d0, d1, d2, d3) = inside - np.take(knots, i), np.transpose(np.take(pieces, i, axis=0))
    return d0 + s * (d1 + s * (d2 + s * d3)) + beyond(x, knots[0], knots[-1], left, right)
''',
    ),
    ChebyshevSum: (
        "chebyshev_sum",
        '''\
def chebyshev_sum(x, left, right, low, high, coefficients):
    """A sum of Chebyshev polynomials of x brought from [low, high] to [-1, 1]."""
    t = np.clip((2.0 * x - low - high) / (high - low), -1.0, 1.0)
    return np.polynomial.chebyshev.chebval(t, coefficients) + beyond(x, low, high, left, right)
''',
    ),
}
CURVES[FormulaSum] = (
    "formulas",
    '''\
def formulas(x, functions, coefficients):
    """A sum of functions."""
    return sum((c * f(x) for c, f in zip(coefficients, functions)), np.zeros(np.shape(x)))
''',
)
_BEYOND = '''\
def beyond(x, low, high, left, right):
    """What lines of these slopes add beyond the ends."""
    return left * np.minimum(x - low, 0.0) + right * np.maximum(x - high, 0.0)
'''
_LINEAR = '''\
def linear(x, b, a, state):
    """y with sum_i a[i] y[k-i] = sum_i b[i] x[k-i]; the state is that of a first input of 1."""
    z = [s * first for first in x[:1].tolist() for s in state]
    y = []
    for value in x.tolist():
        y.append(b[0] * value + z[0])
        z = [zi + bi * value - ai * y[-1] for zi, bi, ai in zip([*z[1:], 0.0], b[1:], a[1:])]
    return np.array(y)
'''
_LFILTER = '''\
def linear(x, b, a, state):
    """y with sum_i a[i] y[k-i] = sum_i b[i] x[k-i]; the state is that of a first input of 1."""
    return lfilter(b, a, x, zi=np.multiply(state, x[0]))[0] if len(x) else x
'''


def python_source(model: FittedModel) -> str:
    """Source of a module with a function ``response(u)``: numpy is all that it needs.

    Examples
    --------
    >>> import hident as hi
    >>> from hident.block_chain import BlockChain
    >>> source = python_source(hi.FittedModel(BlockChain((hi.TransferFunction(b=(0.5,), a=(0.5,)),))))
    >>> exec(source)
    >>> response([1.0, 1.0, 0.0])
    array([1. , 1. , 0.5])
    """
    blocks = plain_blocks(model)
    linear = [_LINEAR] if any(isinstance(block, Filter) for block in blocks) else []
    return joined(
        head(model, ["response(u) is the output (N,) to an input (N,)."]) + "import numpy as np\n",
        *linear,
        *curves(blocks),
        _response(model, blocks),
    )


def scipy_source(model: FittedModel) -> str:
    """Source of a module with a ``scipy.signal.dlti`` for each linear block, and ``response(u)``."""
    blocks = plain_blocks(model)
    made = []
    for name, block in zip(model.chain.names, model.chain.blocks, strict=True):
        if isinstance(block, TransferFunction):
            top, bottom = as_rows(block)
            made.append(f'    "{name}": {call("dlti", (top, bottom), {"dt": dt(model)}, "    ")},\n')
    systems = f"LINEAR = {{\n{''.join(made)}}}\n" if made else "LINEAR = {}\n"
    return joined(
        head(
            model,
            [
                "LINEAR holds the linear blocks by their names.",
                "response(u) is the output (N,) to an input (N,).",
            ],
        )
        + "import numpy as np\nfrom scipy.signal import dlti, lfilter\n\n"
        + systems,
        *([_LFILTER] if made else []),
        *curves(blocks),
        _response(model, blocks),
    )


def head(model: FittedModel, uses: Iterable[str]) -> str:
    """The docstring of a module."""
    lines = map(one_line, [*uses, *facts(model)])
    return '"""' + one_line(title(model)) + "\n\n" + "\n".join(lines) + '\n"""\n\n'


def joined(*parts: str) -> str:
    """The parts of a module, two lines apart."""
    return "\n\n".join(parts)


def curves(blocks: Iterable[PlainBlock]) -> list[str]:
    """The functions that compute the static blocks."""
    used = {type(block) for block in blocks}
    known = [source for kind, (_, source) in CURVES.items() if kind in used]
    return [*([_BEYOND] if used - {Filter, FormulaSum} else []), *known]


def _response(model: FittedModel, blocks: Sequence[PlainBlock]) -> str:
    lines = ["def response(u):", '    """The output (N,) to an input (N,)."""']
    lines.append("    x = np.asarray(u, dtype=float)")
    lines.append("    if x.ndim != 1:")
    lines.append('        raise ValueError(f"the input must be of shape (N,), not {x.shape}")')
    before, after = model.offsets
    lines += [f"    x = x{added(-before)}"] if before else []
    for name, block, plain in zip(model.chain.names, model.chain.blocks, blocks, strict=True):
        function = "linear" if isinstance(plain, Filter) else CURVES[type(plain)][0]
        lines.append(f"    # {name}: {kind_of(block)}")
        lines.append(f"    x = {call(function, ['x'], numbers(plain), '    ')}")
    return "\n".join([*lines, f"    return x{added(after)}", ""])


def numbers(block: PlainBlock, language: Language = NUMPY) -> dict[str, Any]:
    """The numbers of a block by the names of the parameters of its function; formulas in a language."""
    names = [field.name for field in fields(block)]
    if isinstance(block, Curve):
        assert names[:2] == ["left", "right"]
    found = {name: getattr(block, name) for name in names}
    if isinstance(block, FormulaSum):
        found["functions"] = tuple(map(language.written, block.functions))
    return found


def as_rows(block: TransferFunction) -> tuple[Row, Row]:
    """Numerator and denominator by falling power of z."""
    top, bottom = block.in_z()
    return tuple(top.tolist()), tuple(bottom.tolist())


def dt(model: FittedModel) -> float:
    """The sampling interval, 1 where times count samples."""
    return 1.0 if model.chain.dt is None else float(model.chain.dt)


def call(function: str, given: Sequence[object], named: Mapping[str, object], indent: str) -> str:
    """A call, on one line or with each argument on a line of its own; texts stand as they are."""
    arguments = [*(("", value) for value in given), *named.items()]
    line = f"{function}({', '.join(_assigned(name, value) for name, value in arguments)})"
    if len(indent) + len(line) + 8 <= WIDTH:
        return line
    inner = f"{indent}    "
    lines = [f"{inner}{_assigned(name, value, inner)},\n" for name, value in arguments]
    return f"{function}(\n{''.join(lines)}{indent})"


def _assigned(name: str, value: object, indent: str = "") -> str:
    """An argument, in several lines if an indent is given and it is long."""
    key = f"{name}=" if name else ""
    line = f"{key}{_written(value)}"
    if not isinstance(value, tuple) or not indent or len(indent) + len(line) + 1 <= WIDTH:
        return line
    inner = f"{indent}    "
    rows = [f"{inner}{_written(row)}" for row in value if isinstance(row, tuple)]
    lines = ",\n".join(rows) or wrapped(map(_written, value), inner)
    return f"{key}[\n{lines},\n{indent}]"


def _written(value: object) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_written, value))}]"
    return value if isinstance(value, str) else repr(value)
