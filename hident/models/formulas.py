"""A model in words and formulas, each number with its standard error."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from decimal import Decimal

import numpy as np

from hident.fitted_model import FittedModel
from hident.linear_blocks import MOST_POLES, TransferFunction
from hident.models.plain_blocks import CubicPieces, as_curve
from hident.models.source_text import kind_of, level, wrapped
from hident.sampled_blocks import SampledTransferFunction
from hident.static_functions import Chebyshev, DeadZone, PiecewiseLinear, Saturation, StaticFunction
from hident.systems.base import NonlinearitySpec
from hident.systems.function_basis import Functions, Series

_DIGITS = 5
_SMALLEST = 15
"""The last decimal of which a standard error can tell anything."""
_POWERS = 5
"""The highest degree of a polynomial that is also written in powers."""
_STARTS = {
    "settled": "settled to the first input",
    "rest": "at rest before the first sample",
    "estimated": "begun with the states that the first samples tell",
}


def formulas(model: FittedModel) -> str:
    """A model in words: what it is, and a formula for each block.

    Figures in brackets are the standard error of a number, in units of its last digits: 0.512(13) stands for
    0.512 with a standard error of 0.013.

    Examples
    --------
    >>> import hident as hi
    >>> from hident.block_chain import BlockChain
    >>> tank = hi.TransferFunction(b=(0.0, 0.5), a=(0.512,))
    >>> print(hi.formulas(hi.FittedModel(BlockChain((tank,)), errors=({"a_1": 0.013},))))
    L: one sample is the unit of time, settled to the first input
    <BLANKLINE>
    L: linear
      y_k = 0.512(13) y_{k-1} + 0.5 x_{k-1}
      static gain 1.0246
      pole 0.512 (time constant 1.494 samples)
    """
    with np.errstate(all="ignore"):
        return "\n\n".join(_parts(model))


def _parts(model: FittedModel) -> Iterator[str]:
    chain = model.chain
    yield _head(model)
    errors = model.errors or ({},) * len(chain.blocks)
    for i, (name, block) in enumerate(zip(chain.names, chain.blocks, strict=True)):
        if isinstance(block, SampledTransferFunction):
            lines = _continuous(block, errors[i], model)
        elif isinstance(block, TransferFunction):
            lines = _linear(block, errors[i], model)
        else:
            lines = _static(block, errors[i])
        fitted = model.range_of(i)
        said = f", fitted to inputs from {fitted[0]:.{_DIGITS}g} to {fitted[1]:.{_DIGITS}g}" if fitted else ""
        yield "\n".join([f"{name}: {kind_of(block)}{said}", *(f"  {line}" for line in lines)])
    if model.noise.ar or model.noise.ma or model.noise.variance:
        yield _noise(model)


def time_unit(model: FittedModel) -> str:
    """The unit of the sampling interval; empty if it is not known."""
    unit = model.about.get("units", {}).get("time", "")
    return str(unit) if model.chain.dt is not None else "samples"


def _head(model: FittedModel) -> str:
    about, chain = model.about, model.chain
    units = about.get("units", {})
    signals = [
        f"{word} '{about[name]}'" + (f" ({units[name]})" if units.get(name) else "")
        for word, name in (("from", "input"), ("to", "output"))
        if about.get(name)
    ]
    clock = (
        "one sample is the unit of time"
        if chain.dt is None
        else f"sampling interval {chain.dt:g} {time_unit(model)}".strip()
    )
    start = _STARTS[model.start]
    lines = [
        f"{chain.structure}: {', '.join([' '.join(signals), clock, start] if signals else [clock, start])}"
    ]
    made = [f"by {about['method']}"] if about.get("method") else []
    made += [f"with hident {about['hident']}"] if about.get("hident") else []
    made += [f"from {name} (SHA-256 {digest[:12]})" for name, digest in about.get("data", {}).items()]
    if made:
        lines.append(f"made {', '.join(made)}")
    if about.get("command"):
        lines.append(f"command: {about['command']}")
    if said := level(model):
        lines.append(said)
    return "\n".join(lines)


def _linear(block: TransferFunction, errors: Mapping[str, float], model: FittedModel) -> Iterator[str]:
    terms = [(value, errors.get(f"a_{i}"), f"y_{{k-{i}}}") for i, value in enumerate(block.a, start=1)]
    terms += [
        (value, errors.get(f"b_{i}"), f"x_{{k-{i}}}" if i else "x_k") for i, value in enumerate(block.b)
    ]
    yield from _sum("y_k = ", terms)
    yield f"static gain {block.static_gain():.{_DIGITS}g}"
    if 0 < len(block.a) <= MOST_POLES:
        yield from (
            f"pole {_pole(pole, model)}"
            for pole in sorted(block.poles(), key=abs, reverse=True)
            if pole.imag >= 0.0
        )


def _continuous(
    block: SampledTransferFunction, errors: Mapping[str, float], model: FittedModel
) -> Iterator[str]:
    continuous = block.continuous
    top = [
        (value, errors.get(f"b_{i}"), ("", "s")[i] if i < 2 else f"s^{i}")
        for i, value in enumerate(continuous.b)
    ]
    bottom: list[tuple[float, float | None, str]] = [(1.0, None, "")]
    bottom += [
        (value, errors.get(f"a_{i}"), "s" if i == 1 else f"s^{i}")
        for i, value in enumerate(continuous.a, start=1)
    ]
    unit = time_unit(model)
    if continuous.delay:
        yield f"Y(s) = exp(-{continuous.delay:.{_DIGITS}g} s) B(s)/A(s) X(s)"
    else:
        yield "Y(s) = B(s)/A(s) X(s)"
    yield from _sum("B(s) = ", top)
    yield from _sum("A(s) = ", bottom)
    between = "held" if block.intersample == "held" else "along straight lines"
    yield f"between samples its input is {between}"
    yield f"static gain {continuous.static_gain():.{_DIGITS}g}"
    for pole in sorted(continuous.poles(), key=lambda one: -one.real):
        if pole.imag < 0.0:
            continue
        said = [f"time constant {f'{-1.0 / pole.real:.4g} {unit}'.strip()}"] if pole.real < 0.0 else []
        if pole.imag:
            said.append(f"period {f'{2.0 * math.pi / pole.imag:.4g} {unit}'.strip()}")
        value = f"{pole.real:.{_DIGITS}g}" + (f" +- {pole.imag:.{_DIGITS}g}i" if pole.imag else "")
        yield f"pole {value}" + (f" ({', '.join(said)})" if said else "")


def _pole(pole: complex, model: FittedModel) -> str:
    dt, unit = model.chain.dt or 1.0, time_unit(model)
    modulus = abs(pole)
    said = []
    if 0.0 < modulus < 1.0:
        said.append(f"time constant {f'{-dt / math.log(modulus):.4g} {unit}'.strip()}")
    if pole.imag > 0.0:
        said.append(f"period {f'{2.0 * math.pi * dt / np.angle(pole):.4g} {unit}'.strip()}")
    value = f"{pole.real:.{_DIGITS}g}" + (f" +- {pole.imag:.{_DIGITS}g}i" if pole.imag else "")
    return f"{value} ({', '.join(said)})" if said else value


def _static(function: StaticFunction, errors: Mapping[str, float]) -> Iterator[str]:
    basis = function.basis
    known = [errors.get(f"c_{i}") for i in range(1, basis.size + 1)]
    c = function.coefficients
    match basis:
        case Chebyshev():
            names = ["", "t", *(f"T_{k}(t)" for k in range(2, basis.size))]
            yield from _sum("f(x) = ", list(zip(c, known, names[: basis.size], strict=True)))
            half, middle = (basis.high - basis.low) / 2.0, (basis.high + basis.low) / 2.0
            sign = "-" if middle > 0.0 else "+"
            shift = f"(x {sign} {abs(middle):.{_DIGITS}g})" if middle else "x"
            yield (
                f"with t = {shift}"
                + (f"/{half:.{_DIGITS}g}" if half != 1.0 else "")
                + (
                    " and the Chebyshev polynomials T_2(t) = 2 t^2 - 1, T_k = 2 t T_{k-1} - T_{k-2}"
                    if basis.degree > 1
                    else ""
                )
            )
            if 1 < basis.degree <= _POWERS:
                series = np.polynomial.Chebyshev(c, domain=[basis.low, basis.high])
                powers = np.atleast_1d(series.convert(kind=np.polynomial.Polynomial).coef).tolist()
                terms = [(value, None, ("", "x")[k] if k < 2 else f"x^{k}") for k, value in enumerate(powers)]
                yield from _sum("     = ", terms)
            yield f"a line beyond {_ends(function)}"
        case PiecewiseLinear():
            points = zip(basis.knots, c, known, strict=True)
            yield "straight lines between"
            yield from _table([("x", "f(x)"), *((_number(x), _number(y, error)) for x, y, error in points)])
            yield f"which go on beyond {_ends(function)}"
        case Saturation() | DeadZone():
            low, high = _number(basis.low, errors.get("low")), _number(basis.high, errors.get("high"))
            inner = (
                ["min(max(x, low), high)"]
                if basis.kind == Saturation.kind
                else ["min(x - low, 0)", "max(x - high, 0)"]
            )
            yield from _sum("f(x) = ", list(zip(c, known, ["", *inner], strict=True)))
            yield f"with low = {low} and high = {high}"
        case Functions():
            words = [_words(function) for function in basis.functions]
            yield from _sum("f(u) = ", list(zip(c, known, words, strict=True)))
        case Series():
            names = [f"phi_{k}(u)" for k in range(basis.size)]
            yield from _sum("f(u) = ", list(zip(c, known, names, strict=True)))
            yield f"with the functions of the {basis.basis.kind} basis on {_domain(basis)}"
        case _:
            curve = as_curve(function)
            assert isinstance(curve, CubicPieces)
            heading = ("from", "f = 1", "+ s", "+ s^2", "+ s^3", "with s = x - from")
            pieces = zip(curve.knots, curve.pieces, strict=False)
            yield from _table([heading, *((_number(x), *map(_number, piece), "") for x, piece in pieces)])
            yield f"a line beyond {_ends(function)}"
            if any(error is not None for error in known):
                yield "coefficients of the B-splines:"
                yield from wrapped(map(_number, c, known), "  ").split("\n")


def _domain(series: Series) -> str:
    """Where the functions of a series live, and what is beyond."""
    low, high = series.basis.domain()
    ends = [f"{end:.{_DIGITS}g}" for end in (low, high) if math.isfinite(end)]
    between = f"{low:.{_DIGITS}g} to {high:.{_DIGITS}g}"
    return f"{between}, a line beyond {' and '.join(ends)}" if ends else between


def _words(function: NonlinearitySpec) -> str:
    """A function of u as a factor."""
    text = function.formula()
    if text is None:
        return f"{function.kind}(u)"
    simple = re.fullmatch(r"\w+|\w+\*\*\d+|\w+\([^()]*\)", text)
    return text if simple else f"({text})"


def _ends(function: StaticFunction) -> str:
    low, high = function.range
    return f"{low:.{_DIGITS}g} and {high:.{_DIGITS}g}"


def _noise(model: FittedModel) -> str:
    noise = model.noise
    terms = [(value, None, f"v_{{k-{i}}}") for i, value in enumerate(noise.ar, start=1)]
    terms.append((1.0, None, "e_k"))
    terms += [(value, None, f"e_{{k-{i}}}") for i, value in enumerate(noise.ma, start=1)]
    spread = f"standard deviation of e_k {math.sqrt(noise.variance):.{_DIGITS}g}"
    if len(terms) == 1:
        return f"noise: white, {spread}"
    return "\n".join(["noise:", *(f"  {line}" for line in _sum("v_k = ", terms)), f"  {spread}"])


def _sum(left: str, terms: Sequence[tuple[float, float | None, str]]) -> Iterator[str]:
    """A sum of products in lines; what is zero and has no error is left out, as a delay is."""
    line, first = left, True
    for value, error, factor in terms:
        if value == 0.0 and not error:
            continue
        size = _number(abs(value), error)
        word = factor if size == "1" and factor else f"{size} {factor}".strip()
        sign = ("-" if value < 0.0 else "") if first else ("- " if value < 0.0 else "+ ")
        if len(line) + len(word) > 96:
            yield line.rstrip()
            line = " " * len(left)
        line += f"{sign}{word} "
        first = False
    yield (f"{left}0" if first else line).rstrip()


def _number(value: float, error: float | None = None) -> str:
    """A number with its standard error in units of the last digits; five digits if there is none."""
    if not error or not math.isfinite(value):
        return f"{value:.{_DIGITS}g}"
    power = math.floor(math.log10(max(abs(value), error)))
    if -4 < power < 6:
        power = 0
    # Decimals have exponents to spare.
    scaled, spread = (Decimal(repr(float(number))).scaleb(-power) for number in (value, error))
    decimals = max(0, 1 - spread.adjusted())
    if decimals > _SMALLEST:
        return f"{value:.{_DIGITS}g}"
    digits = f"{spread:.{decimals}f}" if spread >= 1 else f"{spread.scaleb(decimals):.0f}"
    return f"{scaled:.{decimals}f}({digits})" + (f"e{power:+03d}" if power else "")


def _table(rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        yield "  " + "  ".join(f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()
