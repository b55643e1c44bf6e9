"""What the sources that models are converted to have in common: their head, and how numbers are written."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

import hident
from hident.block_chain import Block
from hident.fitted_model import FittedModel
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction
from hident.sampled_blocks import SampledTransferFunction

WIDTH = 100
_SETTLED = "Before the first sample the input was its first value, and all blocks had settled to it."


def title(model: FittedModel) -> str:
    """One line on what the model is."""
    about = model.about
    signals = f" from '{about['input']}' to '{about['output']}'" if {"input", "output"} <= {*about} else ""
    return f"A block-oriented model{signals}: {model.chain.structure}."


def level(model: FittedModel) -> str:
    """What was done to the samples before the fit and is done with others, in words; empty if nothing was."""
    if model.is_detrended:
        return (
            "straight lines were taken off the input and the output before the fit: both are what is left of "
            "them"
        )
    u, y = model.offsets
    return f"{u:.6g} is taken off the input, and {y:.6g} added to the output" if u or y else ""


def facts(model: FittedModel, settled: str = _SETTLED) -> list[str]:
    """Sentences on how the model is to be used, and where it comes from.

    ``settled`` says how one begins that is not at rest.
    """
    about, chain = model.about, model.chain
    units = about.get("units", {})
    said = []
    if chain.dt is not None:
        unit = units.get("time", "")
        said.append(f"The sampling interval is {float(chain.dt)!r}{unit and f' {unit}'}.")
    said += [f"The {name} is in {units[name]}." for name in ("input", "output") if units.get(name)]
    said += textwrap.wrap(f"{text[0].upper()}{text[1:]}.", WIDTH) if (text := level(model)) else []
    rest = f"Before the first sample the input was {model.offsets[0]:.6g}, and all states were zero."
    said.append(rest if model.past == "rest" else settled)
    for name, block in zip(chain.names, chain.blocks, strict=True):
        if isinstance(block, SampledTransferFunction):
            between = "held between samples" if block.intersample == "held" else "straight between samples"
            sentence = f"{name} is {in_s(block.continuous)}, for an input that is {between}."
            said += textwrap.wrap(sentence, WIDTH, break_long_words=False, break_on_hyphens=False)
    said += [f"Fitted to {name} (SHA-256 {digest})." for name, digest in about.get("data", {}).items()]
    return [*said, f"Written by hident {hident.__version__}."]


def in_s(block: ContinuousTransferFunction) -> str:
    """A continuous block as a formula in s, to the last digit of its numbers."""

    def polynomial(coefficients: Sequence[float]) -> str:
        terms = [
            f"{float(value)!r}{('', ' s')[i] if i < 2 else f' s^{i}'}"
            for i, value in enumerate(coefficients)
            if value or len(coefficients) == 1
        ]
        return " + ".join(terms).replace("+ -", "- ")

    delay = f" exp(-{float(block.delay)!r} s)" if block.delay else ""
    return f"({polynomial(block.b)})/({polynomial((1.0, *block.a))}){delay}"


def kind_of(block: Block) -> str:
    """The kind of a block in words."""
    if isinstance(block, SampledTransferFunction):
        return "linear, continuous"
    if isinstance(block, TransferFunction):
        return "linear"
    return block.basis.kind.replace("_", " ")


def one_line(text: str) -> str:
    """A text from a model's file where source code must not end: no line breaks, quotes or backslashes."""
    printed = "".join(letter if letter.isprintable() else "?" for letter in " ".join(text.split()))
    return printed.translate({ord('"'): "'", ord("\\"): "/"})


def added(value: float) -> str:
    """What adds a number that is not zero."""
    return f" {'-' if value < 0.0 else '+'} {abs(value)!r}" if value else ""


def wrapped(words: Iterable[str], indent: str, end: str = "") -> str:
    """Words with commas between, in lines; ``end`` is what continues a line."""
    lines = textwrap.wrap(
        ", ".join(words),
        WIDTH - len(end),
        initial_indent=indent,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return f"{end}\n".join(lines)
