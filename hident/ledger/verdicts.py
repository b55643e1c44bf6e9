"""Verdicts: how our numbers stand to the printed ones.

``exact``: ours rounds to the printed digits. ``agrees``: the printed number lies in the interval that the
trials give, widened by its rounding. ``differs``: else, and then a reason is owed. The interval is

- the central 95 % of single trials where the paper ran one realisation or does not say how many it averaged;
- the statistic +- 3 standard errors where it averaged: its own Monte Carlo error counts too, from the number
  of its runs, except where it printed a formula's value.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from hident.engine.experiment import Published, PublishedCells, Statistic
from hident.engine.results import Results, Series
from hident.ledger.published import Printed, printed_beside, published_of, reasons_of

if TYPE_CHECKING:
    import pandas as pd

Word = Literal["exact", "agrees", "differs"]
COLUMNS = ("table", "row", "quantity", "printed", "ours", "low", "high", "verdict", "reason", "interval")


@dataclass(frozen=True, eq=False)
class Verdict:
    """One printed number beside ours."""

    printed: Printed
    cell: PublishedCells
    series: Series
    ours: float
    low: float
    high: float
    word: Word
    reason: str
    interval: str

    def row(self) -> tuple[object, ...]:
        """The row of verdicts.csv."""
        p = self.printed
        head = (p.table, p.row, p.quantity, p.printed)
        return (*head, self.ours, self.low, self.high, self.word, self.reason, self.interval)


Beside = dict[tuple[int, str], "Verdict"]
"""The verdicts by series (its id) and statistic."""


def beside(verdicts: Iterable[Verdict]) -> Beside:
    """Each verdict by what it stands beside: a series' mean and its std are two numbers."""
    return {(id(verdict.series), verdict.cell.statistic): verdict for verdict in verdicts}


def beside_trials(verdicts: Iterable[Verdict]) -> dict[int, Verdict]:
    """By series (its id) the verdict that stands beside its trials: on the mean or median, not on the std."""
    return {id(verdict.series): verdict for verdict in verdicts if verdict.cell.statistic != "std"}


def judge(results: Results) -> tuple[Verdict, ...]:
    """The verdicts on all printed numbers that the configuration names.

    ConfigError if a cell that the configuration names is not among the printed numbers.
    """
    published = results.plan.experiment.published
    if published is None or results.plan.paper is None:
        return ()
    numbers, reasons = published_of(results.plan), reasons_of(results.plan)
    verdicts = []
    every = ((cell, *pair) for cell in published.cells for pair in cell.pairs())
    for cell, quantity, metric in every:
        for series in results.select(cell.estimator, metric, cell.at):
            printed = printed_beside(cell, quantity, series.unit.labels, numbers)
            ours, low, high, interval = _interval(series, cell.statistic, published)
            word = _word(printed, ours, low, high)
            why = next((r.reason for r in reasons if r.covers(results.plan.name, printed.key)), "")
            reason = why if word == "differs" else ""
            verdicts.append(Verdict(printed, cell, series, ours, low, high, word, reason, interval))
    return tuple(verdicts)


def frame(verdicts: Sequence[Verdict]) -> pd.DataFrame:
    """The table verdicts.csv."""
    import pandas as pd

    return pd.DataFrame([verdict.row() for verdict in verdicts], columns=list(COLUMNS))


def _word(printed: Printed, ours: float, low: float, high: float) -> Word:
    # The slack is for a number that stands exactly on a rounding boundary.
    slack = printed.half_unit * (1 + 1e-9)
    if abs(ours - printed.value) <= slack:
        return "exact"
    return "agrees" if low - slack <= printed.value <= high + slack else "differs"


@np.errstate(all="ignore")
def _interval(series: Series, statistic: Statistic, published: Published) -> tuple[float, float, float, str]:
    ours, runs = series.value(statistic), published.paper_trials
    if not len(series.valid):
        return ours, ours, ours, "no trial succeeded"
    if runs in ("unknown", 1):
        low, high = np.quantile(series.valid, [0.025, 0.975])
        why = "the paper ran one" if runs == 1 else "the paper does not say how many runs it averages"
        return ours, float(low), float(high), f"central 95 % of single trials: {why}"
    theirs = 0.0 if runs == "exact" else len(series.valid) / float(runs)
    reach = 3.0 * series.standard_error(statistic) * (1.0 + theirs) ** 0.5
    source = "a formula" if runs == "exact" else f"{runs} runs"
    return ours, ours - reach, ours + reach, f"{statistic} +- 3 standard errors; the paper: {source}"
