"""The figure of how far methods go."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hident.arrays import Array
from hident.config.references import TableName
from hident.config.spec import Flag, Interval, component
from hident.engine.experiment import Plan
from hident.engine.results import Results
from hident.ledger.verdicts import Verdict
from hident.reports.base import FigureSpec, Misfit, not_numeric
from hident.reports.one_trial.base import true_curve
from hident.reports.style import LINES, Look, panel_grid
from hident.reports.tables.limits import Limit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_POINTS = 2001
# Of the range of the labels, the room beside them.
_MARGIN = 0.1
# Inches between the marks of neighbours, and from a mark up to the arrow over it.
_APART = 0.1
_ABOVE = 0.12
# Without an edge, which would make them so bold that those of neighbours touch.
_BEYOND: Look = {
    "color": "black",
    "linestyle": "none",
    "marker": r"$\uparrow$",
    "markersize": 8,
    "markeredgewidth": 0,
}


@component("figure", "limit", source="Chen, Hwang, Chang 2009, figure 9")
class LimitFigure(FigureSpec):
    """How far each estimator goes along one axis against the label of another, as a table of kind limit.

    Estimators stand side by side at each label, under an arrow where no label is too far. A first panel shows
    the true characteristic at each label where an interval is given.
    """

    table: TableName
    """Name of the table of kind limit that it draws."""
    x_label: str
    """Label of the abscissa."""
    y_label: str
    """Label of the ordinate, with its unit."""
    log_x: Flag = False
    """Logarithmic abscissa."""
    interval: Interval | None = None
    """Range of the abscissa of a panel with the true characteristics; no such panel by default."""
    characteristic_labels: tuple[str, str] = ("x", "y")
    """Labels of that panel's abscissa and ordinate."""

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        source = plan.experiment.tables[self.table]
        if not isinstance(source, Limit):
            yield ("table",), f"the table '{self.table}' must be of kind limit, not {source.kind}"
            return
        for axis, positive in ((source.x, self.log_x), (source.along, False)):
            yield from ((("table",), said) for said in not_numeric(plan, axis, positive=positive))
        systems = [unit.data.system for unit in plan.units if self.interval is not None]
        lacking = [one.kind for one in systems if "nonlinearity" not in one.provides()]
        if lacking:
            yield ("interval",), f"the system '{lacking[0]}' has no true nonlinearity to show"

    def looks_needed(self, plan: Plan) -> int:
        source = plan.experiment.tables[self.table]
        if not isinstance(source, Limit):
            return 0
        labels = next((axis.labels for axis in plan.axes if axis.name == source.x), ())
        return max(len(source.estimators), 0 if self.interval is None else len(labels))

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        source = results.plan.experiment.tables[self.table]
        assert isinstance(source, Limit)
        count = 1 if self.interval is None else 2
        figure, grid = panel_grid(count, 2, 4.8 if count == 1 else 3.6, 3.0)
        if self.interval is not None:
            self._characteristics(grid[0], results, source, self.interval)
        self._limits(figure, grid[-1], results, source)
        return figure

    def _characteristics(
        self, axes: Axes, results: Results, source: Limit, interval: tuple[float, float]
    ) -> None:
        x = np.linspace(*interval, _POINTS)
        for i, label in enumerate(results.labels(source.x)):
            unit = next(results.select(labels={**source.at, source.x: label})).unit
            line = {**LINES[i % len(LINES)], "marker": ""}
            y = true_curve(unit.data.system.truth(), x)
            axes.plot(x, y, label=f"{self.x_label} = {label}", **line)
        axes.set_xlim(*interval)
        axes.set_xlabel(self.characteristic_labels[0])
        axes.set_ylabel(self.characteristic_labels[1])
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)

    def _ends(self, ticks: Sequence[float]) -> Array:
        """The ends of the abscissa, with room beside the first and the last of the increasing ticks."""
        ends = np.array([ticks[0], ticks[-1]])
        ends = np.log10(ends) if self.log_x else ends
        ends += np.array([-1.0, 1.0]) * (_MARGIN * (ends[1] - ends[0]) or 0.5)
        return np.asarray(10.0**ends if self.log_x else ends)

    def _limits(self, figure: Figure, axes: Axes, results: Results, source: Limit) -> None:
        from matplotlib.transforms import ScaledTranslation

        highest = 0.0
        inches = figure.dpi_scale_trans
        beyond = []
        for i, estimator in enumerate(source.estimators):
            reaches, line = source.reaches(results, estimator), LINES[i % len(LINES)]
            heights = [reach.limit for reach in reaches]
            somewhere = np.any(np.isfinite(heights))
            label = estimator if somewhere else f"{estimator}, nowhere"
            # Side by side, so that estimators that go equally far are all seen.
            aside = _APART * (i - 0.5 * (len(source.estimators) - 1))
            moved = axes.transData + ScaledTranslation(aside, 0.0, inches)
            axes.plot([reach.x for reach in reaches], heights, label=label, transform=moved, **line)
            beyond += [(reach, moved) for reach in reaches if reach.open]
            highest = float(np.nanmax([highest, *heights]))
        for place, (reach, moved) in enumerate(beyond):
            above = moved + ScaledTranslation(0.0, _ABOVE, inches)
            label = "_" if place else "goes beyond"
            axes.plot(reach.x, reach.limit, label=label, transform=above, **_BEYOND)
        if self.log_x:
            axes.set_xscale("log")
        axes.set_ylim(0.0, 1.15 * highest if highest > 0.0 else 1.0)
        ticks = sorted(map(float, results.labels(source.x)))
        axes.set_xlim(*self._ends(ticks))
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.set_xticks([], minor=True)
        axes.set_xlabel(self.x_label)
        axes.set_ylabel(self.y_label)
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
