"""The figure of a metric against a numeric axis."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from hident.arrays import Array
from hident.config.references import EstimatorName, Metric, NumericAxis
from hident.config.spec import Flag, NonEmpty, Real, Spec, component
from hident.engine.experiment import Plan, Statistic
from hident.engine.results import Results, Series
from hident.ledger.verdicts import Beside, Verdict, beside
from hident.reports.base import FigureSpec, Misfit, unscored
from hident.reports.style import (
    LINES,
    PRINTED,
    TRUE_LEVEL,
    band_edge,
    composed,
    label_edges,
    legend_above,
    panel_rows,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_TICKS = 7


class Slope(Spec):
    """A reference line of a given slope on log axes."""

    slope: Real
    """The slope, e.g. -2/5."""
    label: str
    """Its text in the legend."""


@component("figure", "curve")
class Curve(FigureSpec):
    """A metric against a numeric axis: mean, band of the central 90 % of trials, printed numbers."""

    x: Annotated[str, NumericAxis(positive="log_x")]
    """The axis along the abscissa; its labels are numbers."""
    metric: Annotated[str, Metric(scores=("panels",))]
    """Label of the metric."""
    statistic: Statistic = "mean"
    """The statistic drawn as a line."""
    root: Flag = False
    """Draw the square root, as for a mean squared error."""
    band: Flag = True
    """Shade from the 5 % to the 95 % quantile of the trials."""
    bars: Flag = False
    """Draw bars of two standard errors of the statistic to either side."""
    level: Real | None = None
    """A level to hold the curves against, drawn as a line."""
    x_label: str
    """Label of the abscissa, with its unit."""
    y_label: str
    """Label of the ordinate, with its unit."""
    log_x: Flag = True
    """Logarithmic abscissa."""
    log_y: Flag = True
    """Logarithmic ordinate."""
    slopes: tuple[Slope, ...] = ()
    """Reference lines, each starting at half the height of the lowest curve."""
    panels: tuple[NonEmpty[EstimatorName], ...] = ()
    """Names of estimators for each panel, on common axes; one panel with all by default."""

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        for name in () if self.panels else plan.experiment.estimators:
            yield from unscored(plan, ("metric",), name, self.metric)

    def looks_needed(self, plan: Plan) -> int:
        axes = [axis.name for axis in plan.axes if axis.name != self.x]
        curves = {
            (unit.name, *(unit.labels.get(axis) for axis in axes))
            for unit in plan.units
            if self.metric in unit.metric_labels
        }
        return max(sum(curve[0] in names for curve in curves) for names in self._panels(plan))

    def _panels(self, plan: Plan) -> tuple[tuple[str, ...], ...]:
        return self.panels or (tuple(plan.experiment.estimators),)

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        panels = self._panels(results.plan)
        around = 1.4 * (len(panels) == 1), 0.7 * (len(panels) <= 2)
        figure, grid = panel_rows(len(panels), 2, (3.4, 2.6), around, sharex=True, sharey=True)
        printed = beside(verdicts)
        # Panels share the looks; the last one is for a panel that needs all.
        lines = itertools.cycle(LINES[: max(len(LINES) - 1, self.looks_needed(results.plan))])
        for axes, names in zip(grid.flat, panels, strict=False):
            curves = self._curves(results, names)
            for name, curve in curves.items():
                self._draw_curve(axes, name, curve, next(lines), printed)
            if curves:
                self._finish(axes, [*curves.values()])
            if len(panels) > 1 and not composed():
                # Each panel has curves of its own.
                axes.legend()
        if len(panels) == 1 or composed():
            legend_above(figure)
        label_edges(grid, self.x_label, self.y_label)
        return figure

    def _curves(self, results: Results, names: Sequence[str]) -> dict[str, list[Series]]:
        """The series of each curve; axes other than x tell curves of one estimator apart."""
        curves: dict[str, list[Series]] = {}
        for name in names:
            for series in results.select(name, self.metric):
                rest = [f"{axis} = {v}" for axis, v in results.varied(series).items() if axis != self.x]
                curves.setdefault(", ".join([name, *rest]), []).append(series)
        return curves

    def _draw_curve(
        self,
        axes: Axes,
        name: str,
        curve: Sequence[Series],
        line: dict[str, Any],
        printed: Beside,
    ) -> None:
        x = np.array([float(series.unit.labels[self.x]) for series in curve])

        def rooted(values: Array) -> Array:
            return np.sqrt(values) if self.root else values

        def heights(statistic: str) -> Array:
            return rooted(np.array([series.statistics[statistic] for series in curve]))

        if self.band:
            low, high = heights("q05"), heights("q95")
            axes.fill_between(x, low, high, color=line["color"], alpha=0.15, linewidth=0)
            for edge in (low, high):
                axes.plot(x, edge, **band_edge(line))
        axes.plot(x, heights(self.statistic), label=name, **line)
        if self.bars:
            middle = np.array([series.statistics[self.statistic] for series in curve])
            reach = 2.0 * np.array([series.standard_error(self.statistic) for series in curve])
            axes.vlines(x, rooted(middle - reach), rooted(middle + reach), color=line["color"], linewidth=1.0)
        theirs = [printed.get((id(series), self.statistic)) for series in curve]
        if any(theirs):
            values = np.array([np.nan if v is None else v.printed.value for v in theirs])
            axes.plot(x, rooted(values), zorder=5, label=f"{name}, printed", **line | PRINTED)

    def _finish(self, axes: Axes, curves: Sequence[Sequence[Series]]) -> None:
        if self.level is not None:
            axes.axhline(self.level, **TRUE_LEVEL)
        if self.log_x:
            axes.set_xscale("log")
        if self.log_y:
            axes.set_yscale("log")
        x = np.array([float(series.unit.labels[self.x]) for series in curves[0]])
        if len(x) <= _MOST_TICKS:
            axes.set_xticks(x, [f"{label:g}" for label in x], minor=False)
            axes.set_xticks([], minor=True)
        lowest = np.fmin.reduce([curve[0].statistics[self.statistic] for curve in curves])
        start = 0.5 * lowest ** (0.5 if self.root else 1.0)
        for i, reference in enumerate(self.slopes):
            axes.plot(
                x,
                start * (x / x[0]) ** reference.slope,
                color="0.4",
                linestyle=[":", "-."][i % 2],
                linewidth=1.0,
                label=reference.label,
            )
