"""Figures of methods against each other: their paired differences, and their average ranks over cases."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.references import TableName
from hident.config.spec import Count, component
from hident.engine.experiment import Plan
from hident.engine.results import Results
from hident.ledger.verdicts import Verdict
from hident.numerics.paired import critical_difference, friedman_p, groups_within, shared_ranks
from hident.reports.base import FigureSpec, Misfit
from hident.reports.style import (
    DATA,
    LINES,
    TRUE_LEVEL,
    Look,
    few_log_ticks,
    legend_above,
    panel_rows,
    subplots,
)
from hident.reports.tables.comparison import Case, Comparison, Versus, series_of_units
from hident.reports.tables.writing import written

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FEWEST_CASES = 10
_FEWEST_METHODS = 3
# Inches: a row of a panel, and what stands above and below its rows.
_ROW = 0.24
_AROUND_ROWS = 0.55
# Of the distance of two rows, how far the points of one spread, and by which steps.
_SPREAD = 0.5
_STEP = 0.6180339887
# Letters of both names that fit over a panel.
_TITLE = 30
_SEVERAL_DECADES = 100.0
_MANY_DECADES = 1e4
_TOLD: Look = {"color": "black", "marker": "o", "linestyle": "none", "markersize": 5, "zorder": 5}
_TIED: Look = {**_TOLD, "markerfacecolor": "white"}


class _OfComparison(FigureSpec):
    table: TableName
    """Name of the table of kind comparison that it draws."""

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        source = plan.experiment.tables[self.table]
        if not isinstance(source, Comparison):
            yield ("table",), f"the table '{self.table}' must be of kind comparison, not {source.kind}"
        elif not source.cases(plan):
            yield ("table",), f"the table '{self.table}' compares no two methods there"

    def comparison(self, plan: Plan) -> Comparison:
        """The table."""
        table = plan.experiment.tables[self.table]
        assert isinstance(table, Comparison)
        return table


@component("figure", "paired_differences")
class PairedDifferences(_OfComparison):
    """The differences or ratios of a table of kind comparison: a panel for each pair, a row for each case.

    A grey point is a trial in which neither method failed; how often each failed stands at the right. Over
    them stands the table's statistic with its interval, hollow where the test of the table tells nothing: its
    p-values are adjusted over the whole table, of which the figure may show a part.
    """

    x_label: str
    """Label of the abscissas, with the unit."""
    columns: Annotated[Count, Field(ge=1)] = 3
    """Panels in a row."""

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        source = self.comparison(results.plan)
        pairs: dict[tuple[str, str], list[Versus]] = {}
        for one in source.compared(results):
            pairs.setdefault((one.first, one.second), []).append(one)
        cases = list({id(one.case): one.case for some in pairs.values() for one in some}.values())
        size = (2.1, _ROW * len(cases) + _AROUND_ROWS)
        figure, grid = panel_rows(len(pairs), self.columns, size, (1.2, 0.7), sharey=True)
        sign = "\N{MINUS SIGN}" if source.of == "difference" else "/"
        for ((first, second), some), axes in zip(pairs.items(), grid.flat, strict=False):
            apart = " " if len(first) + len(second) < _TITLE else "\n"
            axes.set_title(f"{first}{apart}{sign} {second}", fontsize="small")
            self._panel(axes, some, {id(case): i for i, case in enumerate(cases)}, source)
        grid.flat[0].set_ylim(len(cases) - 0.4, -0.6)
        for axes in grid[:, 0]:
            axes.set_yticks(range(len(cases)), _names(cases), fontsize="small")
        sides = ("second", "first") if source.best_of(results.plan) == "highest" else ("first", "second")
        figure.supxlabel(
            f"{self.x_label}\n← {sides[0]} is better    {sides[1]} is better →", fontsize="medium"
        )
        legend_above(figure)
        return figure

    def _panel(
        self, axes: Axes, some: Sequence[Versus], place: Mapping[int, int], source: Comparison
    ) -> None:
        ratios = source.of == "log_ratio"
        if ratios:
            axes.set_xscale("log")
        for one in some:
            known = one.pair.differences[one.pair.worked]
            known = known[np.isfinite(known)]
            aside = _SPREAD * ((np.arange(len(known)) * _STEP) % 1.0 - 0.5)
            axes.plot(
                np.exp(known) if ratios else known, place[id(one.case)] + aside, label="a trial", **DATA
            )
        axes.axvline(1.0 if ratios else 0.0, label="no difference", **TRUE_LEVEL | {"linestyle": "--"})
        # The ends of an interval may be infinite.
        left, right = axes.get_xlim()
        for one in some:
            y = place[id(one.case)]
            estimate, low, high = np.exp(one.interval) if ratios else np.array(one.interval)
            if np.isfinite([low, high]).any() or np.isinf([low, high]).all():
                axes.plot(np.clip([low, high], left, right), [y, y], color="black", linewidth=1.4, zorder=4)
            if np.isfinite(estimate):
                geometric = "geometric " * (ratios and source.statistic == "mean")
                told = "told apart" if one.side else "tied"
                words = f"{geometric}{source.statistic}, 95 % interval; {told}"
                axes.plot(estimate, y, label=words, **(_TOLD if one.side else _TIED))
            if any(one.pair.failed):
                said = f"{one.pair.failed[0]}, {one.pair.failed[1]} failed"
                axes.annotate(
                    said,
                    (1.0, y),
                    xycoords=("axes fraction", "data"),
                    xytext=(3, 0),
                    textcoords="offset points",
                    va="center",
                    fontsize="x-small",
                )
        axes.set_xlim(left, right)
        if ratios:
            _ratio_ticks(axes, right / left)
        axes.grid(visible=False, axis="y")


def _names(cases: Sequence[Case]) -> list[str]:
    """The labels of each case on the axes in which the cases differ."""
    differ = [axis for axis in cases[0].labels if len({case.labels[axis] for case in cases}) > 1]
    return [", ".join(f"{axis} {case.labels[axis]}" for axis in differ) or case.described() for case in cases]


def _ratio_ticks(axes: Axes, span: float) -> None:
    """Numbers at 1, 2 and 5 of each decade, or at decades alone where there are several."""
    from matplotlib.ticker import LogLocator

    few_log_ticks(axes.xaxis)
    if span > _SEVERAL_DECADES:
        axes.xaxis.set_major_locator(LogLocator(numticks=5 if span < _MANY_DECADES else 3))


@component("figure", "critical_differences", source="Demsar 2006, figure 1")
class CriticalDifferences(_OfComparison):
    """Average ranks of methods over at least 10 cases, joined by a bar where Nemenyi's test tells nothing.

    In each case that holds all methods of a table of kind comparison, they are ranked by the median of the
    metric, failures being worst; equal medians share a rank. Cases must not share random numbers, as the test
    takes them as independent.
    """

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        yield from (found := list(super().misfits(plan)))
        if found:
            return
        source = self.comparison(plan)
        names, cases = source.named(plan), self._cases(plan)
        if len(names) < _FEWEST_METHODS:
            yield (
                ("table",),
                f"ranks at least {_FEWEST_METHODS} methods, and the table '{self.table}' has {len(names)}: "
                "its rows tell two apart",
            )
        elif len(cases) < _FEWEST_CASES:
            yield (
                ("table",),
                f"averages ranks over at least {_FEWEST_CASES} cases, and {len(cases)} of the table "
                f"'{self.table}' hold{'s' * (len(cases) == 1)} all {len(names)} methods",
            )
        elif any(unit.data.streams.share for case in cases for unit in case.units.values()):
            yield (
                ("table",),
                "takes the cases as independent, and they share random numbers: leave out 'streams.share'",
            )

    def _cases(self, plan: Plan) -> list[Case]:
        """The cases that hold all methods."""
        source = self.comparison(plan)
        return [case for case in source.cases(plan) if len(case.units) == len(source.named(plan))]

    def scores(self, results: Results) -> tuple[Array, dict[str, int]]:
        """The score of each method in each case, (cases, methods), low ones good; and its failed trials."""
        source = self.comparison(results.plan)
        series, best = series_of_units(results, source.metric), source.best_of(results.plan)
        names = source.named(results.plan)
        rows = [[series[id(case.units[name])].values for name in names] for case in self._cases(results.plan)]
        values = np.array(rows)
        failed = dict(zip(names, np.sum(~np.isfinite(values), axis=(0, 2)).tolist(), strict=True))
        if best == "zero":
            values = np.abs(values)
        elif best == "highest":
            values = -values
        # The upper of the two middle ones where one of them is infinite, and their mean has no meaning.
        return np.median(np.where(np.isfinite(values), values, np.inf), axis=2), failed

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        source = self.comparison(results.plan)
        scores, failed = self.scores(results)
        ranked = np.array([shared_ranks(row, source.equal) for row in scores])
        ranks, names = ranked.mean(axis=0), source.named(results.plan)
        order = np.argsort(ranks, kind="stable")
        reach = critical_difference(len(names), len(scores))
        groups = groups_within([float(ranks[i]) for i in order], reach)
        half = (len(names) + 1) // 2
        lowest = half + 0.35 * len(groups)
        figure, axes = subplots(figsize=(6.4, 0.85 + 0.26 * lowest))
        _scale(axes, len(names), reach)
        for place, i in enumerate(order):
            at_left = place < half
            below = 0.35 * len(groups) + (place if at_left else len(names) - 1 - place) + 0.9
            end = 1.0 - 0.12 if at_left else len(names) + 0.12
            axes.plot([ranks[i], ranks[i], end], [0.0, below, below], color="0.45", linewidth=0.8)
            said = f"{names[i]} ({ranks[i]:.2f})" + (
                f", {failed[names[i]]} failed" if failed[names[i]] else ""
            )
            axes.text(end, below, f" {said} ", ha="right" if at_left else "left", va="center")
        for row, (first, last) in enumerate(groups):
            ends = [ranks[order[first]] - 0.04, ranks[order[last]] + 0.04]
            axes.plot(ends, 2 * [0.35 * (row + 1)], color="black", linewidth=3.5, solid_capstyle="butt")
        axes.set_ylim(lowest + 0.6, -1.5)
        axes.set_title(
            f"average rank by the median of {source.metric} over {len(scores)} cases; Friedman's p = "
            f"{written(friedman_p(ranked), 2)}",
            fontsize="medium",
        )
        return figure


def _scale(axes: Axes, methods: int, reach: float) -> None:
    """The line of ranks with its numbers, and the critical difference above it."""
    axes.axis("off")
    axes.plot([1, methods], [0, 0], **{**LINES[0], "color": "black", "marker": ""})
    for rank in range(1, methods + 1):
        axes.plot([rank, rank], [0, -0.15], color="black", linewidth=1.0)
        axes.text(rank, -0.25, str(rank), ha="center", va="bottom")
    axes.plot([1, 1 + reach], [-1.15, -1.15], color="black", linewidth=1.2, marker="|", markersize=6)
    axes.text(1 + reach, -1.15, f"  critical difference {reach:.2f}", ha="left", va="center")
