"""The figure of one trial: its record, and the estimates from it beside the truth."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hident.arrays import Array
from hident.engine.estimate_curves import Curve
from hident.records import Record
from hident.reports.style import (
    DATA,
    LINES,
    TRUTH,
    few_log_ticks,
    legend_above,
    looks,
    marked,
    panel_grid,
    write_below,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NAMES = {
    "nonlinearity": ("input of the nonlinearity", "its output"),
    "step_response": ("time", "response to a step of 1"),
    "gain": ("angular frequency (rad per unit of time)", "gain"),
    "phase": ("angular frequency (rad per unit of time)", "phase (rad)"),
}
"""The labels of each sort of panel, in the order of the panels."""
_DECADES = 300.0
"""Of a smaller ratio, powers of ten alone are too few ticks."""
_DASHES = ("-", "--", ":", "-.")
"""Of the truths, where methods fix what no data determine by different rules."""
_MOST = 1.5
"""How far, in units of the truth's range, an estimate is shown beyond it."""


def trial_figure(
    record: Record, noise_free: Array | None, found: Mapping[str, Sequence[Curve]], trial: int
) -> Figure:
    """Input and output of a record, and a panel for each sort of curve of the estimates, by their names.

    The output before noise is drawn where it is known. The number of the ``trial`` stands below.
    """
    parts = [part for part in _NAMES if any(one.part == part for one in _all(found))]
    figure, (inputs, outputs, *panels) = panel_grid(2 + len(parts), 2, 3.4, 2.3)
    _signals(inputs, outputs, record, noise_free)
    lines = looks(found)
    for axes, part in zip(panels, parts, strict=True):
        shown = {name: one for name, of in found.items() for one in of if one.part == part}
        axes.set_xlabel(_NAMES[part][0])
        axes.set_ylabel(_NAMES[part][1])
        if part in ("gain", "phase"):
            axes.set_xscale("log")
        if part == "gain" and all(np.all(one.values > 0.0) for one in shown.values()):
            axes.set_yscale("log")
        _panel(axes, shown, lines)
    legend_above(figure)
    write_below(figure, f"trial {trial}")
    return figure


def _all(found: Mapping[str, Sequence[Curve]]) -> list[Curve]:
    return [one for of in found.values() for one in of]


def _signals(inputs: Axes, outputs: Axes, record: Record, noise_free: Array | None) -> None:
    line = {**LINES[0], "marker": "", "linewidth": 0.8, "color": "0.35"}
    for number, part in enumerate(record.experiments):
        dt = next((p.dt for p in record.parts.values() if p.start == part.start), record.dt or 1.0)
        t = dt * np.arange(part.stop - part.start)
        inputs.plot(t, record.u[part], rasterized=True, **line)
        label = None if number else "measured output"
        outputs.plot(t, record.y[part], label=label, rasterized=True, **DATA)
        if noise_free is not None:
            label = None if number else "output before noise"
            outputs.plot(t, noise_free[part], label=label, rasterized=True, **{**TRUTH, "linewidth": 0.7})
    for axes, name in ((inputs, "input"), (outputs, "output")):
        axes.set_xlabel("sample" if record.dt is None and not record.parts else "time")
        axes.set_ylabel(name)


def _truths(shown: Mapping[str, Curve]) -> dict[str, Curve]:
    """The curves whose truths are known and differ: each is in the form that the estimator declares."""
    found: dict[str, Curve] = {}
    for name, one in shown.items():
        known = np.isfinite(one.true).any()
        if known and not any(
            np.array_equal(one.x, other.x) and np.allclose(one.true, other.true, equal_nan=True)
            for other in found.values()
        ):
            found[name] = one
    return found


def _panel(axes: Axes, shown: Mapping[str, Curve], lines: Mapping[str, dict[str, object]]) -> None:
    truths = _truths(shown)
    for (name, one), dashes in zip(truths.items(), itertools.cycle(_DASHES)):
        # An estimate that is near it must not hide it.
        label = "true" if len(truths) == 1 else f"true, as {name} has it"
        axes.plot(one.x, one.true, label=label, **{**TRUTH, "linewidth": 2.4, "linestyle": dashes})
    for place, (name, one) in enumerate(shown.items()):
        axes.plot(one.x, one.values, label=name, zorder=5, **marked(dict(lines[name]), place, len(one.x)))
    if axes.get_yscale() == "log":
        low, high = axes.get_ylim()
        if high / low < _DECADES:
            few_log_ticks(axes.yaxis)
        return
    if not truths:
        return
    # Of an estimate that is far off, the truth must still be seen.
    low = min(np.nanmin(one.true) for one in truths.values())
    high = max(np.nanmax(one.true) for one in truths.values())
    wide = _MOST * ((high - low) or abs(high) or 1.0)
    bottom, top = axes.get_ylim()
    axes.set_ylim(max(bottom, low - wide), min(top, high + wide))
