"""The figures of a first look at a record: signals, histograms, spectra, the correlation for the delay."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hident.arrays import Array
from hident.measurements.delay import Correlation, Delay
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


def figures(record: Record, look: FirstLook) -> dict[str, Callable[[], Figure]]:
    """What draws each figure, by its name, inside :func:`hident.reports.style.style`.

    ValueError or ArithmeticError, when it is drawn or saved, of numbers that matplotlib cannot draw.
    """
    known: dict[str, Callable[[], Figure]] = {
        "signals": partial(_signals, record),
        "histogram": partial(_histograms, record),
        "spectrum": partial(_spectra, record),
    }
    found = look.correlation
    return known if found is None else {**known, "correlation": partial(_correlation, found, look.delay)}


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
        heights, edges = _histogram(signal)
        axes.stairs(heights, edges, fill=True, color=LINES[0]["color"])
        axes.set_xlabel(_named(record, name))
        axes.set_ylabel("samples")
    return figure


def _histogram(signal: Array) -> tuple[NDArray[np.int64], Array]:
    """Counts in bins of one width, and the bins' edges; a constant signal has one bin."""
    low, high = float(np.min(signal)), float(np.max(signal))
    middle, half = low / 2 + high / 2, high / 2 - low / 2
    if half == 0.0:
        return np.array([len(signal)]), middle + np.array([-0.5, 0.5]) * (abs(middle) / 100 or 1.0)
    bins = min(_BINS, len(np.unique(signal)))
    heights, edges = np.histogram((signal - middle) / half, bins=bins, range=(-1.0, 1.0))
    return heights, middle + half * edges


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
    piece = min(_PIECE, max(lengths))
    if piece < 8:
        return
    power = np.zeros(piece // 2 + 1)
    for part, length in zip(record.experiments, lengths, strict=True):
        frequency, density = welch(
            signal[part] - np.mean(signal), fs=1.0 / _step(record), nperseg=min(piece, length), nfft=piece
        )
        power += length / len(signal) * density
    there = power > 0.0
    axes.plot(frequency[there], 10.0 * np.log10(power[there]), **_LINE)


def _correlation(found: Correlation, delay: Delay | None) -> Figure:
    figure, axes = subplots(figsize=(6.4, 2.8))
    axes.vlines(found.lags, 0.0, found.values, color=LINES[0]["color"], linewidth=1.0)
    band = {"color": "0.85", "zorder": 0, "linewidth": 0.0, "step": "mid"}
    axes.fill_between(found.lags, -found.bound, found.bound, label="none, at 99 %", **band)
    if delay is not None:
        low, high = delay.low, delay.high
        label = f"delay: {low}" if low == high else f"delay: {low} to {high}"
        axes.axvspan(low - 0.5, high + 0.5, color=LINES[1]["color"], alpha=0.25, label=label)
    # The far lags are there for the bound; what matters is near.
    near = min(int(found.lags[-1]), max(30, 0 if delay is None else 3 * delay.high))
    axes.set_xlim(-near / 3, near)
    axes.set_xlabel("lag of the output behind the input (samples)")
    axes.set_ylabel("correlation")
    legend_above(figure)
    return figure
