"""The figures of a first look at a record: signals, histograms, spectra, the correlation for the delay."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hident.arrays import Array
from hident.measurements.first_look import FirstLook
from hident.records import Record
from hident.reports.style import LINES, TRUE_LEVEL, legend_above, subplots

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BINS = 60
_LINE = {**LINES[0], "marker": ""}
# A longer piece says no more, and its periodogram is rougher.
_PIECE = 1024


def figures(record: Record, look: FirstLook) -> dict[str, Figure]:
    """Every figure by its name; to be called, and saved, inside :func:`hident.reports.style.style`."""
    drawn = {"signals": _signals(record), "histogram": _histograms(record), "spectrum": _spectra(record)}
    return drawn if look.correlation is None else {**drawn, "correlation": _correlation(record, look)}


def _named(record: Record, signal: str) -> str:
    unit = record.units.get(signal, "")
    return f"{signal} ({unit})" if unit else signal


def _time(record: Record) -> str:
    return "sample" if record.dt is None else _named(record, "time")


def _step(record: Record) -> float:
    return 1.0 if record.dt is None else record.dt


def _signals(record: Record) -> Figure:
    figure, panels = subplots(2, 1, sharex=True, figsize=(6.4, 4.0))
    for axes, name, signal in zip(panels, ("input", "output"), (record.u, record.y), strict=True):
        t = _step(record) * np.arange(len(signal))
        for part in record.experiments:
            axes.plot(t[part], signal[part], **{**_LINE, "linewidth": 0.8}, rasterized=True)
            if part.start:
                axes.axvline(t[part.start], **{**TRUE_LEVEL, "linestyle": ":"})
        axes.set_ylabel(_named(record, name))
    panels[1].set_xlabel(_time(record))
    return figure


def _histograms(record: Record) -> Figure:
    figure, panels = subplots(1, 2, figsize=(6.4, 2.8))
    for axes, name, signal in zip(panels, ("input", "output"), (record.u, record.y), strict=True):
        # Halves of large numbers have a difference.
        heights, edges = np.histogram(signal / 2, bins=min(_BINS, max(1, len(np.unique(signal)))))
        axes.stairs(heights, 2 * edges, fill=True, color=LINES[0]["color"])
        axes.set_xlabel(_named(record, name))
        axes.set_ylabel("samples")
    return figure


def _spectra(record: Record) -> Figure:
    figure, panels = subplots(2, 1, sharex=True, figsize=(6.4, 4.0))
    for axes, name, signal in zip(panels, ("input", "output"), (record.u, record.y), strict=True):
        _spectrum(axes, record, signal)
        axes.set_ylabel(f"{name}, power (dB)")
    unit = record.units.get("time", "")
    per = f"1/{unit}" if unit else "1/time"
    panels[1].set_xlabel("frequency (1/sample)" if record.dt is None else f"frequency ({per})")
    return figure


def _spectrum(axes: Axes, record: Record, signal: Array) -> None:
    """The power density by Welch's method, of the experiments by their lengths, without the mean."""
    from scipy.signal import welch

    lengths = [part.stop - part.start for part in record.experiments]
    piece = min(_PIECE, *lengths, len(signal))
    if piece < 8:
        return
    power = np.zeros(piece // 2 + 1)
    for part, length in zip(record.experiments, lengths, strict=True):
        frequency, density = welch(signal[part] - np.mean(signal), fs=1.0 / _step(record), nperseg=piece)
        power += length / len(signal) * density
    there = power > 0.0
    axes.plot(frequency[there], 10.0 * np.log10(power[there]), **_LINE)


def _correlation(record: Record, look: FirstLook) -> Figure:
    found = look.correlation
    assert found is not None
    figure, axes = subplots(figsize=(6.4, 2.8))
    axes.vlines(found.lags, 0.0, found.values, color=LINES[0]["color"], linewidth=1.0)
    axes.axhspan(-found.bound, found.bound, color="0.85", zorder=0, label="none, at 99 %")
    if look.delay is not None:
        low, high = look.delay.low, look.delay.high
        label = f"delay: {low}" if low == high else f"delay: {low} to {high}"
        axes.axvspan(low - 0.5, high + 0.5, color=LINES[1]["color"], alpha=0.25, label=label)
    # The far lags are there for the bound; what matters is near.
    near = min(int(found.lags[-1]), max(30, 0 if look.delay is None else 3 * look.delay.high))
    axes.set_xlim(-near / 3, near)
    axes.set_xlabel("lag of the output behind the input (samples)")
    axes.set_ylabel("correlation")
    legend_above(figure)
    return figure
