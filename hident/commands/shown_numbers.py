"""Printed numbers and series in a terminal, each with a histogram of its trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hident.commands.results_folders import FoundRun
from hident.commands.sparkline import MARK, PLAIN_BARS, PLAIN_MARK, sparkline
from hident.commands.terminal import COLOURS, has_unicode, signed, text_of
from hident.engine.run_files import TRIALS
from hident.errors import HidentError
from hident.ledger.judged import Judged, by_table
from hident.ledger.trial_values import TrialValues
from hident.ledger.verify import table_states
from hident.numerics.rounding import is_constant
from hident.reports.tables.writing import SIGNS, written

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

_PRINTED = "printed"
_BARS = (8, 24)
"""The fewest and the most bars of a histogram."""
_MOST_SERIES = 40
"""The series that are listed; of more, the first."""


def print_numbers(console: Console, run: FoundRun, results: Path) -> None:
    """Every printed number beside ours, with its interval and the trials behind it."""
    try:
        states = {state.table: state for state in table_states(run.folder.path, results)}
    except (HidentError, OSError):
        states = {}
    mark = MARK if has_unicode(console) else PLAIN_MARK
    console.print()
    console.print(text_of("Printed numbers, and the trials behind ours", "bold underline"))
    for name, numbers in by_table(run.numbers).items():
        state, said = states.get(name), ""
        if state is not None:
            joint = "" if np.isnan(state.joint_p) else f"joint p {state.joint_p:.2g}"
            score = "" if not state.tried else f"alternatives rejected: {state.score}"
            said = "; ".join(filter(None, (joint, score)))
        console.print(text_of(f"{name}{f': {said}' if said else ''}", "bold"))
        rows = [(_name(one), *_of_number(one)) for one in numbers]
        histograms = [_histogram_of(run, one) for one in numbers]
        _print_rows(console, ("", _PRINTED, "", "ours [interval]", "excludes", "flips"), rows, histograms)
        if state is not None and state.survivors:
            console.print(text_of(f"Not told apart by {name}: {'; '.join(state.survivors)}."))
    console.print(
        text_of(
            f"{mark} stands where the printed number lies among the trials. excludes: from how many "
            "of the alternatives it differs; flips: how likely as many other trials would decide otherwise."
        )
    )


def print_series(console: Console, run: FoundRun) -> None:
    """The trials of what stands beside no printed number."""
    if run.values is None:
        return
    judged_ones = {one.series for one in run.numbers}
    series = [key for key in run.values.series if key not in judged_ones]
    # Of a single trial, the tables say all.
    if not series or run.values.trials < 2:
        return
    shown = series[:_MOST_SERIES]
    console.print()
    console.print(text_of("Trials of all else" if run.numbers else "Trials", "bold underline"))
    rows = [(_named(run.values, key), *_spread(run.values.series[key])) for key in shown]
    histograms = [_histogram(run.values.series[key]) for key in shown]
    _print_rows(console, ("", "median [5 %, 95 %]", "failed"), rows, histograms)
    if more := len(series) - len(shown):
        console.print(text_of(f"and {more} more: table.csv has their statistics, {TRIALS} their trials"))


def _histogram(values: np.ndarray) -> _Histogram | None:
    """None of what no trial changes."""
    return None if is_constant(values[np.isfinite(values)]) else _Histogram(values)


def _named(values: TrialValues, key: tuple[str, ...]) -> str:
    """A series by its labels, its estimator and its metric."""
    return ", ".join([*_labels(values, key), *key[-2:]])


def _labels(values: TrialValues, key: tuple[str, ...]) -> list[str]:
    return [f"{axis} {label}" for axis, label in zip(values.axes, key, strict=False) if label]


def _spread(values: np.ndarray) -> tuple[str, str]:
    valid = values[np.isfinite(values)]
    failed = str(len(values) - len(valid))
    if not len(valid):
        return "-", failed
    if is_constant(valid):
        return f"{written(valid[0], 4)} in all", failed
    low, middle, high = np.quantile(valid, [0.05, 0.5, 0.95])
    return f"{written(middle, 4)} [{written(low, 4)}, {written(high, 4)}]", failed


def _name(one: Judged) -> str:
    """Its row and quantity; where several of ours stand beside one printed number, also which it is."""
    return f"{one.printed.row} / {one.printed.quantity}{f' ({one.case})' if one.case else ''}"


def _of_number(one: Judged) -> tuple[str, ...]:
    mark = f" ({one.mark})" if one.mark else ""
    # Where digits are equal or differ there is no interval.
    interval = f" [{_end(one.low)}, {_end(one.high)}]" if one.low < one.high else ""
    ours = f"{written(one.ours, 4)}{interval}"
    of = f"{one.excluded} of {one.alternatives}" if one.alternatives else "-"
    flips = "-" if np.isnan(one.flips) else f"{100.0 * one.flips:.0f} %"
    return one.printed.printed, f"{SIGNS[one.word]} {one.word}{mark}", ours, of, flips


def _end(value: float) -> str:
    return str(value) if np.isinf(value) else written(value, 4)


def _histogram_of(run: FoundRun, one: Judged) -> _Histogram | None:
    if run.values is None or one.series is None:
        return None
    # A standard deviation lies nowhere among the values of single trials.
    printed = np.nan if one.statistic == "std" else one.printed.value
    return _Histogram(run.values.series[one.series], printed, one.printed.slack, COLOURS[one.word])


@dataclass(frozen=True, eq=False)
class _Histogram:
    values: np.ndarray
    printed: float = np.nan
    slack: float = 0.0
    colour: str = ""

    def drawn(self, width: int, *, unicode: bool) -> Text:
        from rich.text import Text

        letters = {} if unicode else {"bars": PLAIN_BARS, "mark": PLAIN_MARK}
        before, at, behind = sparkline(self.values, width, self.printed, self.slack, **letters)
        return Text.assemble(before, (at, self.colour), behind)


def _print_rows(
    console: Console,
    header: Sequence[str],
    rows: Sequence[tuple[str, ...]],
    histograms: Sequence[_Histogram | None],
) -> None:
    """Rows of texts, each with a histogram; the first cell on a line of its own where they do not fit."""
    from rich.text import Text

    widths = [max(map(len, column)) + 2 for column in zip(header, *rows, strict=True)]
    few, many = _BARS
    room = console.width - 2
    in_one = sum(widths) + few <= room
    free = room - (sum(widths) if in_one else widths[0])
    bars = max(few, min(free, many))
    for row, histogram in zip([tuple(header), *rows], [None, *histograms], strict=True):
        numbers = Text()
        for cell, width in zip(row[1:], widths[1:], strict=True):
            numbers.append(signed(cell)).append(" " * (width - len(cell)))
        drawn = Text("trials") if row is header else Text()
        if histogram is not None:
            drawn = histogram.drawn(bars, unicode=has_unicode(console))
        named = row[0].ljust(widths[0])
        lines = [Text.assemble(named, numbers, drawn)]
        if not in_one:
            lines = [Text.assemble(named, drawn), Text.assemble("  ", numbers)]
        for line in lines:
            line.rstrip()
            line.stylize("bold" if row is header else "")
            console.print(line)
