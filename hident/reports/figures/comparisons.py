"""Figures of methods against each other: their paired differences, and their average ranks over cases."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

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
from hident.reports.canvas import canvas
from hident.reports.mathematics import wrapped
from hident.reports.style import (
    DATA,
    LINES,
    TRUE_LEVEL,
    Look,
    few_log_ticks,
    legend_above,
    subplots,
)
from hident.reports.tables.comparison import Case, Comparison, Versus, as_compared, series_of_units
from hident.reports.tables.writing import written

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FEWEST_CASES = 10
_FEWEST_METHODS = 3
# Inches: a row of a panel, a panel, and what stands above and below its rows and around all panels.
_ROW, _PANEL = 0.24, 2.1
_AROUND_ROWS = 0.55
_AROUND = (1.2, 0.7)
# Inches: a letter, one at the right of a panel, a line of them, and the space between panels.
_LETTER, _SMALL_LETTER, _LINE, _GAP = 0.062, 0.048, 0.14, 0.12
# Inches that a panel is wide in any case, and that a number of an abscissa takes, also one such as 0.9995.
_NARROWEST, _NUMBER, _LONG_NUMBER = 0.85, 0.28, 0.6
# The share of the width that labels of rows may take, and lines of a name over panels beside each other.
_LABELS, _LINES = 0.4, 2
# Of the distance of two rows, how far the points of one spread, and by which steps.
_SPREAD = 0.5
_STEP = 0.6180339887
# Inches of the average ranks: all, the least of the scale, and a letter of the heading.
_WIDE, _SCALE, _HEADING = 6.4, 1.2, 0.064
_SEVERAL_DECADES = 100.0
_MANY_DECADES = 1e4
_TOLD: Look = {"color": "black", "marker": "o", "linestyle": "none", "markersize": 5, "zorder": 5}
_FAILED = "failed"
_PARTIAL = (0, (1, 0.8))
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

    A grey point is a trial in which neither method failed; how often each failed stands in a strip at the
    right. Over them stands the table's statistic with its interval: a triangle that points to the better
    method by the test of the table, a hollow circle where it tells nothing. Its p-values are adjusted over
    the whole table, of which the figure may show a part. An interval is dotted if it leaves out trials in
    which a method failed, as that of a mean does, and has an arrow where it goes on beyond the panel.
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
        sign = "\N{MINUS SIGN}" if source.of == "difference" else "/"
        layout = _Layout.of(list(pairs), sign, _names(cases), min(self.columns, len(pairs)), _failed(pairs))
        figure, grid = layout.axes(len(pairs))
        for title, some, axes in zip(layout.titles, pairs.values(), grid.flat, strict=False):
            axes.set_title(title, fontsize="small")
            self._panel(axes, some, {id(case): i for i, case in enumerate(cases)}, source, layout)
        grid.flat[0].set_ylim(len(cases) - 0.4, -0.6)
        for axes in grid[:, 0]:
            axes.set_yticks(range(len(cases)), layout.labels, fontsize="small")
        sides = ("second", "first") if source.best_of(results.plan) == "highest" else ("first", "second")
        letters = int(layout.width / _LETTER)
        below = [line for part in self.x_label.split("\n") for line in wrapped(part, letters)]
        below.append(f"← {sides[0]} is better    {sides[1]} is better →")
        figure.supxlabel("\n".join(below), fontsize="medium")
        legend_above(figure)
        return figure

    def _panel(
        self,
        axes: Axes,
        some: Sequence[Versus],
        place: Mapping[int, int],
        source: Comparison,
        layout: _Layout,
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
                _draw_interval(axes, (low, high), (left, right), y, partial=one.leaves_out)
            if np.isfinite(estimate):
                geometric = "geometric " * (ratios and source.statistic == "mean")
                told = {1: "first is better", -1: "second is better", 0: "tied"}[one.side]
                words = f"{geometric}{source.statistic}, 95 % interval; {told}"
                axes.plot(estimate, y, label=words, **_look(one))
        axes.set_xlim(left, right)
        if ratios:
            _ratio_ticks(axes, left, right, layout.panel)
        axes.grid(visible=False, axis="y")
        if any(any(one.pair.failed) for one in some):
            self._strip(axes, some, place, layout.strip / layout.panel)

    def _strip(self, axes: Axes, some: Sequence[Versus], place: Mapping[int, int], share: float) -> None:
        """How often each method of each row failed, in a strip that joins the panel at the right."""
        strip = axes.inset_axes((1.0, 0.0, share, 1.0), facecolor="0.95", sharey=axes)
        strip.set_xticks([])
        strip.tick_params(left=False, labelleft=False)
        strip.grid(visible=False)
        strip.spines[:].set_visible(False)
        strip.set_xlabel(f"{_FAILED}\nof {len(some[0].pair.outcomes)}", fontsize="x-small", labelpad=4)
        for one in some:
            if any(one.pair.failed):
                strip.text(
                    0.5, place[id(one.case)], _failures(one), ha="center", va="center", fontsize="x-small"
                )


def _look(one: Versus) -> Look:
    """The look of a statistic: a triangle towards the values that are good of the better method."""
    if not one.side:
        return _TIED
    to_left = (one.side > 0) != (one.best == "highest")
    return _TOLD | {"marker": "<" if to_left else ">"}


def _draw_interval(
    axes: Axes, ends: tuple[float, float], limits: tuple[float, float], y: float, *, partial: bool
) -> None:
    """An interval, with an arrow where it goes on beyond the panel."""
    shown = np.clip(ends, *limits)
    words = "_95 % interval"
    look: Look = {"color": "black", "linewidth": 1.4, "zorder": 4}
    if partial:
        words, look["linestyle"] = "interval without the trials in which one failed", _PARTIAL
    axes.plot(shown, [y, y], label=words, **look)
    for end, edge, sign in zip(ends, limits, (-1, 1), strict=True):
        if sign * (end - edge) > 0:
            axes.annotate(
                "",
                (edge, y),
                xytext=(-7 * sign, 0),
                textcoords="offset points",
                arrowprops={
                    "arrowstyle": "-|>,head_width=0.22,head_length=0.4",
                    "color": "black",
                    "shrinkA": 0,
                    "shrinkB": 0,
                },
                zorder=4,
            )


def _names(cases: Sequence[Case]) -> list[str]:
    """The labels of each case on the axes in which the cases differ."""
    differ = [axis for axis in cases[0].labels if len({case.labels[axis] for case in cases}) > 1]
    return [", ".join(f"{axis} {case.labels[axis]}" for axis in differ) or case.described() for case in cases]


@dataclass(frozen=True)
class _Layout:
    """How the panels of pairs stand, in inches: what they say is broken into lines that fit."""

    columns: int
    panel: float
    strip: float
    width: float
    height: float
    lines: int
    titles: list[str]
    labels: list[str]

    @classmethod
    def of(
        cls, pairs: Sequence[tuple[str, str]], sign: str, rows: Sequence[str], most: int, failures: int
    ) -> _Layout:
        """The most columns whose titles are short; ValueError where the paper has no room for any."""
        if (paper := canvas()) is None:
            return cls._of(pairs, sign, rows, most, failures, None)
        every = [cls._of(pairs, sign, rows, n, failures, paper.room) for n in range(most, 0, -1)]
        wider = "take a wider 'size', " * paper.can_be_wider
        if not (wide := [one for one in every if one.panel >= _NARROWEST]):
            raise ValueError(
                f"beside the labels of its rows a panel has {25.4 * max(every[-1].panel, 0.0):.0f} mm of "
                f"{25.4 * paper.room:.0f}: {wider}hold labels with 'at', or give shorter ones"
            )
        lowest = min(wide, key=lambda one: one.height)
        paper.fit(lowest.height, f"{wider}hold labels with 'at', or name fewer estimators")
        short = [one for one in wide if one.lines <= 2 * _LINES and paper.fits(one.height)]
        return (short or [lowest])[0]

    @classmethod
    def _of(
        cls,
        pairs: Sequence[tuple[str, str]],
        sign: str,
        rows: Sequence[str],
        columns: int,
        failures: int,
        room: float | None,
    ) -> _Layout:
        width = _PANEL * columns + _AROUND[0] if room is None else room
        labels = [wrapped(row, int(_LABELS * width / _LETTER)) for row in rows]
        beside = _LETTER * max(len(line) for lines in labels for line in lines)
        # A title may stand over the failures, too.
        above = (width - beside) / columns - _GAP
        strip = _SMALL_LETTER * (max(failures, len(_FAILED)) + 1) if failures else 0.0
        panel = above - strip
        titles = [_title(*pair, sign, int(above / _LETTER)) for pair in pairs]
        lines = max(map(len, titles))
        row = max(_ROW, _LINE * max(map(len, labels)) + 0.06)
        if room is None:
            over, around = _LINE * (lines - 1) * (lines > 2), _AROUND[1]
        else:
            # There the legend has a line for each of its labels.
            over, around = _LINE * lines, _AROUND[1] + 4 * _LINE
        height = (row * len(rows) + _AROUND_ROWS + over) * -(-len(pairs) // columns) + around
        joined = [["\n".join(lines) for lines in some] for some in (titles, labels)]
        return cls(columns, panel, strip, width, height, lines, *joined)

    def axes(self, count: int) -> tuple[Figure, Any]:
        """The figure and the rows of its axes."""
        rows = -(-count // self.columns)
        figsize = (self.width, self.height)
        figure, grid = subplots(rows, self.columns, squeeze=False, figsize=figsize, sharey=True)
        for axes in grid.flat[count:]:
            axes.set_visible(False)
        return figure, grid


def _title(first: str, second: str, sign: str, letters: int) -> list[str]:
    """The lines of the title of a pair: one if it fits."""
    if len(whole := f"{first} {sign} {second}") <= letters:
        return [whole]
    return [*wrapped(first, letters), *wrapped(f"{sign} {second}", letters)]


def _failures(one: Versus) -> str:
    return f"{one.pair.failed[0]}, {one.pair.failed[1]}"


def _failed(pairs: Mapping[tuple[str, str], Sequence[Versus]]) -> int:
    """The letters that stand at the right of the panels."""
    failed = [one for some in pairs.values() for one in some if any(one.pair.failed)]
    return max((len(_failures(one)) for one in failed), default=0)


def _ratio_ticks(axes: Axes, left: float, right: float, width: float) -> None:
    """Numbers at 1, 2 and 5 of each decade; where there is no room, or several decades, at fewer.

    Where a panel holds one of these, at a few others.
    """
    from matplotlib.ticker import LogLocator, MaxNLocator

    few_log_ticks(axes.xaxis)
    span = right / left
    decades = 10.0 ** np.arange(np.floor(np.log10(left)), np.ceil(np.log10(right)) + 1.0)
    numbers = np.outer(decades, (1.0, 2.0, 5.0))
    if np.count_nonzero((left <= numbers) & (numbers <= right)) < 2:
        few = max(int(width / _LONG_NUMBER), 1)
        axes.xaxis.set_major_locator(MaxNLocator(few, steps=(1, 2, 2.5, 5, 10), min_n_ticks=2))
    elif span > _SEVERAL_DECADES:
        axes.xaxis.set_major_locator(LogLocator(numticks=5 if span < _MANY_DECADES else 3))
    elif 3.0 * np.log10(span) * _NUMBER > width:
        decades = np.floor(np.log10(right)) - np.ceil(np.log10(left)) + 1
        axes.xaxis.set_major_locator(LogLocator(subs=(1,) if decades > 1 else (1, 3)))


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
        values = as_compared(np.array(rows), best or "lowest")
        failed = dict(zip(names, np.sum(np.isinf(values), axis=(0, 2)).tolist(), strict=True))
        return np.median(-values if best == "highest" else values, axis=2), failed

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        source = self.comparison(results.plan)
        scores, failed = self.scores(results)
        ranked = np.array([shared_ranks(row, source.equal) for row in scores])
        ranks, names = ranked.mean(axis=0), source.named(results.plan)
        order = np.argsort(ranks, kind="stable")
        reach = critical_difference(len(names), len(scores))
        groups = groups_within([float(ranks[i]) for i in order], reach)
        half = (len(names) + 1) // 2
        width = _WIDE if (paper := canvas()) is None else paper.room
        words = [
            f"{name} ({rank:.2f})" + f", {failed[name]} failed" * (failed[name] > 0)
            for name, rank in zip(names, ranks, strict=True)
        ]
        # No word is broken: the scale gives way.
        longest = max(len(word) for text in words for word in text.split())
        letters = max(int((width - _SCALE) / 2.0 / _LETTER), longest)
        if (left := width - 2.0 * letters * _LETTER) < _NARROWEST:
            wider = "take a wider 'size', " * (paper is not None and paper.can_be_wider)
            raise ValueError(
                f"beside the names of the methods the scale has {25.4 * max(left, 0.0):.0f} mm of "
                f"{25.4 * width:.0f}: repeat it over 'rows', {wider}or give shorter names"
            )
        said = [wrapped(text, letters) for text in words]
        # One line has the place of one.
        step = 1.0 + 0.5 * (max(map(len, said)) - 1)
        lowest = half * step + 0.35 * len(groups)
        heading = wrapped(
            f"average rank by the median of {source.metric} over {len(scores)} cases; Friedman's p = "
            f"{written(friedman_p(ranked), 2)}",
            int(width / _HEADING),
        )
        beside = max(len(line) for lines in said for line in lines) * _LETTER
        scale = width - 2.0 * beside
        told = f"critical difference {reach:.2f}"
        # Where there is no room at the right of its bar, it stands above.
        above = beside + scale * reach / (len(names) - 1) + len(told) * _LETTER > width
        height = 0.85 + 0.26 * (lowest + above) + _LINE * (len(heading) - 1)
        if paper is not None:
            paper.fit(height, "name fewer estimators, or shorter ones")
        figure, axes = subplots(figsize=(width, height))
        _scale(axes, len(names), reach, told, above)
        for place, i in enumerate(order):
            at_left = place < half
            below = 0.35 * len(groups) + step * (place if at_left else len(names) - 1 - place) + 0.9
            end = 1.0 - 0.12 if at_left else len(names) + 0.12
            line = [ranks[i], ranks[i], end], [0.0, below, below]
            axes.plot(*line, label=f"_{names[i]}", color="0.45", linewidth=0.8)
            text = "\n".join(f" {line} " for line in said[i])
            axes.text(end, below, text, ha="right" if at_left else "left", va="center")
        for row, (first, last) in enumerate(groups):
            ends = [ranks[order[first]] - 0.04, ranks[order[last]] + 0.04]
            look: dict[str, Any] = {"color": "black", "linewidth": 3.5, "solid_capstyle": "butt"}
            axes.plot(ends, 2 * [0.35 * (row + 1)], label="_not told apart", **look)
        axes.set_ylim(lowest + 0.6, -1.5 - above)
        axes.set_title("\n".join(heading), fontsize="medium")
        return figure


def _scale(axes: Axes, methods: int, reach: float, told: str, above: bool) -> None:
    """The line of ranks with its numbers, and the critical difference above it."""
    axes.axis("off")
    axes.plot([1, methods], [0, 0], label="_ranks", **{**LINES[0], "color": "black", "marker": ""})
    for rank in range(1, methods + 1):
        axes.plot([rank, rank], [0, -0.15], label="_ranks", color="black", linewidth=1.0)
        axes.text(rank, -0.25, str(rank), ha="center", va="bottom")
    bar: dict[str, Any] = {"color": "black", "linewidth": 1.2, "marker": "|", "markersize": 6}
    axes.plot([1, 1 + reach], [-1.15, -1.15], label="_critical difference", **bar)
    if above:
        axes.text(1, -1.5, told, ha="left", va="bottom")
    else:
        axes.text(1 + reach, -1.15, f"  {told}", ha="left", va="center")
