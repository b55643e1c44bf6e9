"""The figure of two metrics against each other, one point for each trial, beside the printed pair."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.references import CaseLabels, EstimatorName, MetricLabel
from hident.config.spec import Count, Flag, NonEmpty, Spec, component
from hident.engine.results import Results, Series
from hident.ledger.verdicts import Verdict, beside_trials
from hident.metrics.base import MetricSpec
from hident.metrics.values import Value
from hident.reports.base import FigureSpec
from hident.reports.style import LINES, PRINTED, TRUE_LEVEL, few_log_ticks, legend_above, panel_grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class Coordinate(Spec):
    """What is shown along one axis of a panel."""

    estimator: EstimatorName
    """Name of the estimator."""
    metric: MetricLabel
    """Label of the metric."""
    at: CaseLabels = {}
    """Labels of axes that choose the case; the first case by default."""
    label: str | None = None
    """Label of the axis, with its unit; estimator and metric by default."""

    @property
    def text(self) -> str:
        """What stands at the axis."""
        return f"{self.estimator}, {self.metric}" if self.label is None else self.label

    def series(self, results: Results) -> Series:
        """The trials that it shows."""
        return next(results.select(self.estimator, self.metric, self.at))

    def truth(self, results: Results) -> float | None:
        """The true number behind it; None if the metric gives no value of the system.

        Nor is there one where the method fixes the factor between the blocks in another way than the system:
        a slope at zero is not that of a first segment.
        """
        unit = self.series(results).unit
        of = {label: value for name, metric in unit.metrics.items() for label, value in _values(name, metric)}
        value = of.get(self.metric, "")
        true = unit.truth().values.get(value)
        return true if true == unit.data.system.truth().values.get(value) else None


class ScatterPanel(Spec):
    """Two metrics over the same trials."""

    x: Coordinate
    """The abscissa."""
    y: Coordinate
    """The ordinate."""
    title: str = ""
    """Title of the panel."""


@component("figure", "scatter")
class Scatter(FigureSpec):
    """One metric against another, a point for each trial, with the true pair and the printed one.

    Lines stand at true numbers where the metrics give values of the system that no factor between the blocks
    moves. The title gives Spearman's coefficient of rank correlation.
    """

    panels: NonEmpty[ScatterPanel]
    """The panels."""
    columns: Annotated[Count, Field(ge=1)] = 2
    """Panels in a row."""
    log: Flag = False
    """Logarithmic axes."""

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        printed = {series: verdict.printed.value for series, verdict in beside_trials(verdicts).items()}
        figure, grid = panel_grid(len(self.panels), self.columns, 3.4, 2.8)
        for panel, axes in zip(self.panels, grid, strict=True):
            pair = [one.series(results) for one in (panel.x, panel.y)]
            draw_pairs(axes, *(series.values for series in pair))
            if all(id(series) in printed for series in pair):
                x, y = (printed[id(series)] for series in pair)
                axes.plot(x, y, label="printed", zorder=5, **LINES[1] | PRINTED)
            for one, draw_line in ((panel.x, axes.axvline), (panel.y, axes.axhline)):
                if (true := one.truth(results)) is not None:
                    draw_line(true, label="true", **TRUE_LEVEL)
            correlation = f"rank correlation {rank_correlation(*(s.values for s in pair)):.2f}"
            axes.set_title(f"{panel.title}, {correlation}" if panel.title else correlation)
            axes.set_xlabel(panel.x.text)
            axes.set_ylabel(panel.y.text)
            if self.log:
                axes.set_xscale("log")
                axes.set_yscale("log")
                for axis in (axes.xaxis, axes.yaxis):
                    few_log_ticks(axis)
        legend_above(figure)
        return figure


def _values(name: str, metric: MetricSpec) -> list[tuple[str, str]]:
    """The labels of a metric that gives values themselves, with the names of the values."""
    return list(zip(metric.labels(name), metric.of, strict=True)) if isinstance(metric, Value) else []


def draw_pairs(axes: Axes, x: Array, y: Array) -> None:
    """One point for each trial (K,)."""
    look = {"color": LINES[0]["color"], "marker": "o", "markersize": 2.5, "linestyle": "none", "alpha": 0.45}
    axes.plot(x, y, label="our trials", markeredgewidth=0.0, **look)


def rank_correlation(x: Array, y: Array) -> float:
    """Spearman's coefficient over the trials (K,) in which both are finite; nan if either does not vary."""
    both = np.isfinite(x) & np.isfinite(y)
    ranks = [_ranks(values[both]) for values in (x, y)]
    varying = all(len(np.unique(one)) > 1 for one in ranks)
    return float(np.asarray(np.corrcoef(ranks))[0, 1]) if varying else float("nan")


def _ranks(values: Array) -> Array:
    """The ranks of values (K,), equal ones sharing their mean."""
    _, place, count = np.unique(values, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(count) - 0.5 * (count + 1))[place])
