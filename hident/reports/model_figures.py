"""The blocks of a fitted model as pictures, and its output beside the measured one."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hident.arrays import Array, Complex
from hident.block_chain import BlockChain
from hident.fitted_model import FittedModel
from hident.linear_blocks import MOST_POLES, TransferFunction
from hident.models.formulas import time_unit
from hident.reports.style import (
    ESTIMATE,
    LINES,
    TRUE_LEVEL,
    draw_band,
    label_edges,
    legend_above,
    panel_rows,
)
from hident.sampled_blocks import SampledTransferFunction
from hident.static_functions import StaticFunction

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_POINTS = 600
_AROUND = (0.4, 0.5)
_SHORTEST, _LONGEST = 20, 2000
"""Samples of a step response."""
_REACH = 2.5
"""How far from the origin poles and zeros are shown."""
_CURVE = {**LINES[0], "marker": ""}
_BAND = 0.9


def figures(model: FittedModel, others: Sequence[BlockChain] = ()) -> Mapping[str, Callable[[], Figure]]:
    """What can be drawn of a model, by the name of its file; nothing where there are no such blocks.

    ``others`` are the same chain fitted to other data, such as bootstraps, whose spread is a band.
    """
    chain = model.chain
    found: dict[str, Callable[[], Figure]] = {}
    if chain.static:
        found["static_functions.png"] = lambda: _static_functions(model, others)
    if chain.linear:
        found["bode.png"] = lambda: _bode(model, others)
        found["step_responses.png"] = lambda: _step_responses(model, others)
        found["poles_zeros.png"] = lambda: _poles_zeros(model)
    return found


def _named(model: FittedModel, kind: type[TransferFunction | StaticFunction]) -> list[tuple[int, str]]:
    return [
        (i, name)
        for i, (name, block) in enumerate(zip(model.chain.names, model.chain.blocks, strict=True))
        if isinstance(block, kind)
    ]


def _signal_label(model: FittedModel, side: str, place: int, name: str) -> str:
    """The input or output of a block, with its unit and offset where it is the model's own."""
    outer = place == (0 if side == "input" else len(model.chain.blocks) - 1)
    unit = model.about.get("units", {}).get(side, "")
    less = dict(zip(("input", "output"), model.offsets, strict=True))[side]
    said = f" less {less:.4g}" if outer and less else ""
    return f"{side} of {name}{said}" + (f" ({unit})" if outer and unit else "")


def _static_functions(model: FittedModel, others: Sequence[BlockChain]) -> Figure:
    blocks = _named(model, StaticFunction)
    figure, grid = panel_rows(len(blocks), 3, (3.4, 2.6), _AROUND)
    for axes, (place, name) in zip(grid.flat, blocks, strict=False):
        function = model.chain.blocks[place]
        assert isinstance(function, StaticFunction)
        _static_function(axes, function, model.range_of(place), [other.blocks[place] for other in others])
        axes.set_title(f"{name}: {function.basis.kind.replace('_', ' ')}")
        axes.set_xlabel(_signal_label(model, "input", place, name))
        axes.set_ylabel(_signal_label(model, "output", place, name))
    grid.flat[0].legend(loc="best")
    return figure


def _static_function(
    axes: Axes, function: StaticFunction, fitted: tuple[float, float] | None, others: Sequence[Any]
) -> None:
    """The curve where it was fitted, and a little beyond: there it is a line that no sample supports."""
    basis: Any = function.basis
    corners = function.range
    low, high = fitted or corners
    wide = (high - low) or abs(low) or 1.0
    first, last = (low - 0.2 * wide, high + 0.2 * wide) if fitted else (low - wide, high + wide)
    x = np.union1d(np.linspace(first, last, _POINTS), [low, high, *(c for c in corners if first < c < last)])
    y = function(x)
    inside = (x >= low) & (x <= high) if fitted else np.full(len(x), True)
    if others:
        draw_band(axes, x, np.array([other(x) for other in others]), _CURVE, "bootstrap", _BAND)
    axes.plot(x[inside], y[inside], label="where it was fitted" if fitted else None, **_CURVE)
    for beyond in (x <= low, x >= high) if fitted else ():
        label = "beyond" if beyond[0] else None
        axes.plot(x[beyond], y[beyond], color=_CURVE["color"], linestyle=(0, (2, 2)), label=label)
    knots = np.asarray(getattr(basis, "knots", corners))
    knots = knots[(knots >= first) & (knots <= last)]
    if hasattr(basis, "knots") or basis.shape:
        word = "knots" if hasattr(basis, "knots") else "corners"
        axes.plot(knots, function(knots), label=word, **{**ESTIMATE, "marker": "o", "linestyle": "none"})
    axes.set_xlim(first, last)


def _frequency(model: FittedModel) -> tuple[float, str]:
    """What a frequency in radians per sample is multiplied with, and the label of its axis."""
    dt, unit = model.chain.dt, time_unit(model)
    if dt is None:
        return 1.0, "frequency (rad/sample)"
    named = {"s": "Hz", "ms": "kHz", "": "cycles per unit of time"}.get(unit, f"cycles/{unit}")
    return 1.0 / (2.0 * math.pi * dt), f"frequency ({named})"


def _bode(model: FittedModel, others: Sequence[BlockChain]) -> Figure:
    blocks = _named(model, TransferFunction)
    count = len(blocks)
    figure, grid = panel_rows(2 * count, count, (3.4, 2.0), _AROUND, sharex=True)
    scale, label = _frequency(model)
    omega = np.geomspace(0.1 * min(0.1, *map(_slowest, model.chain.linear), 0.1), math.pi, _POINTS)
    for column, (place, name) in enumerate(blocks):
        block = model.chain.blocks[place]
        assert isinstance(block, TransferFunction)
        gains, phases = grid[0, column], grid[1, column]
        curves = [_gain_and_phase(other.blocks[place], omega) for other in others]
        for axes, values, spread in zip(
            (gains, phases),
            _gain_and_phase(block, omega),
            np.moveaxis(np.array(curves), 1, 0) if curves else ((), ()),
            strict=True,
        ):
            if curves:
                draw_band(axes, scale * omega, spread, _CURVE, "bootstrap", _BAND)
            axes.semilogx(scale * omega, values, **_CURVE)
        gains.set_title(name)
        gains.set_xlim(scale * omega[0], 1.25 * scale * math.pi)
    label_edges(grid, label, "")
    grid[0, 0].set_ylabel("gain (dB)")
    grid[1, 0].set_ylabel("phase (degrees)")
    legend_above(figure)
    return figure


def _gain_and_phase(block: Any, omega: Array) -> tuple[Array, Array]:
    """Gain in dB and phase in degrees at frequencies in radians per sample, unwound from the first.

    Those of a continuous block are without the hold.
    """
    response: Complex
    if isinstance(block, SampledTransferFunction):
        response = block.continuous.frequency_response(omega / block.dt)
    else:
        response = block.frequency_response(omega)
    size = np.maximum(np.abs(response), np.finfo(float).tiny)
    return 20.0 * np.log10(size), np.degrees(np.unwrap(np.angle(response)))


def _slowest(block: TransferFunction) -> float:
    """How far the slowest pole is from the unit circle, in radians per sample."""
    return max(1e-5, abs(1.0 - block.radius())) if len(block.a) <= MOST_POLES else 1e-3


def _step_responses(model: FittedModel, others: Sequence[BlockChain]) -> Figure:
    blocks = _named(model, TransferFunction)
    figure, grid = panel_rows(len(blocks), 3, (3.4, 2.4), _AROUND)
    dt, unit = model.chain.dt or 1.0, time_unit(model)
    for axes, (place, name) in zip(grid.flat, blocks, strict=False):
        block = model.chain.blocks[place]
        assert isinstance(block, TransferFunction)
        radius = block.radius() if len(block.a) <= MOST_POLES else 0.999
        decay = math.log(1e-3) / math.log(radius) if 0.0 < radius < 1.0 else 0.0
        samples = int(np.clip(decay + 2 * len(block.b), _SHORTEST, _LONGEST))
        step = np.ones(samples)
        response = block.filter(step)
        if others:
            spread = np.array([_filtered(other.blocks[place], step) for other in others])
            draw_band(axes, np.asarray(dt * np.arange(samples)), spread, _CURVE, "bootstrap", _BAND)
        axes.step(dt * np.arange(samples), response, where="post", **_CURVE)
        if block.is_stable():
            gain = block.static_gain()
            axes.axhline(gain, label=f"static gain {gain:.4g}", **{**TRUE_LEVEL, "linestyle": ":"})
            axes.legend(loc="best")
        axes.set_title(name)
        axes.set_xlim(0.0, dt * (samples - 1))
        axes.set_xlabel(f"time ({unit})" if unit else "time")
    grid.flat[0].set_ylabel("response to a step of 1")
    return figure


def _filtered(block: Any, x: Array) -> Array:
    return np.asarray(block.filter(x))


def _poles_zeros(model: FittedModel) -> Figure:
    blocks = _named(model, TransferFunction)
    figure, grid = panel_rows(len(blocks), 3, (3.0, 3.0), _AROUND)
    angle = np.linspace(0.0, 2.0 * math.pi, _POINTS)
    for axes, (place, name) in zip(grid.flat, blocks, strict=False):
        block = model.chain.blocks[place]
        assert isinstance(block, TransferFunction)
        found: list[Any]
        if isinstance(block, SampledTransferFunction):
            found = [block.continuous.poles(), block.continuous.zeros()]
            axes.axvline(0.0, **{**TRUE_LEVEL, "linewidth": 0.8})
            most = reach = 1.2 * float(np.max(np.abs(np.concatenate(found))))
        else:
            top, bottom = block.in_z()
            axes.plot(np.cos(angle), np.sin(angle), **{**TRUE_LEVEL, "linewidth": 0.8})
            # Those of a long block without feedback take too long to find.
            found = [np.roots(row) if len(row) <= MOST_POLES + 1 else np.zeros(0) for row in (bottom, top)]
            most = _REACH
            reach = min(most, 1.1 * float(np.max(np.abs(np.concatenate(found)), initial=1.0)))
        for roots, look, label in zip(
            found,
            ({"marker": "x", "color": LINES[1]["color"]}, {"marker": "o", "color": LINES[0]["color"]}),
            ("poles", "zeros"),
            strict=True,
        ):
            if len(roots):
                mark = {"linestyle": "none", "fillstyle": "none", "markersize": 6, **look}
                axes.plot(roots.real, roots.imag, label=label, **mark)
        sizes = np.abs(np.concatenate(found))
        far = int(np.sum(sizes > most))
        axes.set_title(name + (f" ({far} beyond the frame)" if far else ""))
        axes.set_xlim(-reach, reach)
        axes.set_ylim(-reach, reach)
        axes.set_aspect("equal")
        axes.set_xlabel("real part" + (_of_time(model) if isinstance(block, SampledTransferFunction) else ""))
    grid.flat[0].set_ylabel("imaginary part")
    legend_above(figure)
    return figure


def _of_time(model: FittedModel) -> str:
    """The unit of a continuous pole."""
    unit = time_unit(model)
    return f" (1/{unit})" if unit else " (1/time)"


def comparison(
    time: Array,
    label: str,
    u: Array,
    made: Array,
    y: Array | None,
    names: tuple[str, str, str],
    others: Sequence[Array] = (),
    begins: Sequence[float] = (),
) -> Figure:
    """The model's output over time beside the measured one, their difference, and the input.

    ``others`` are the outputs of the same chain fitted to other data, such as bootstraps. ``names`` are the
    labels of the input, of the output, and what the model's output is. A dotted line stands where another
    experiment ``begins``.
    """
    count = 2 if y is None else 3
    figure, grid = panel_rows(count, 1, (6.4, 1.8), (0.4, 0.4), sharex=True)
    outputs, *rest = grid[:, 0]
    if y is not None:
        outputs.plot(time, y, label="measured", color="black", linewidth=0.9)
    if others:
        draw_band(outputs, time, np.array(others), ESTIMATE, "bootstrap", _BAND)
    outputs.plot(time, made, label=names[2], **{**ESTIMATE, "linestyle": "--" if y is not None else "-"})
    outputs.set_ylabel(names[1])
    if y is not None:
        rest[0].axhline(0.0, **TRUE_LEVEL)
        rest[0].plot(time, y - made, color=LINES[0]["color"], linewidth=0.8)
        rest[0].set_ylabel("residual")
    rest[-1].step(time, u, where="post", color=LINES[2]["color"], linewidth=0.9)
    rest[-1].set_ylabel(names[0])
    rest[-1].set_xlabel(label)
    for axes, begin in itertools.product(grid[:, 0], begins):
        axes.axvline(begin, color="black", linewidth=0.8, linestyle=":")
    rest[-1].set_xlim(time[0], time[-1] if len(time) > 1 else time[0] + 1.0)
    legend_above(figure)
    return figure
