"""How far a method goes: the largest label of an axis up to which a metric stays below a limit."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from hident.config.references import CaseLabels, EstimatorName, MetricLabel, NumericAxis, TableName
from hident.config.spec import Flag, Interval, NonEmpty, Real, component
from hident.engine.experiment import Plan
from hident.engine.results import Results, Series
from hident.ledger.verdicts import Verdict
from hident.reports.base import (
    FigureSpec,
    Misfit,
    Table,
    TableSpec,
    not_numeric,
)
from hident.reports.one_trial.base import true_curve
from hident.reports.style import LINES, panel_grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_POINTS = 2001
_UP = 10
"""Matplotlib's marker of a triangle that stands on its point."""


@dataclass(frozen=True)
class Reach:
    """How far one estimator goes at one label: nan if nowhere, ``open`` if to the last label tried."""

    estimator: str
    x: float
    limit: float
    open: bool

    @property
    def text(self) -> str:
        """The limit in words."""
        if not np.isfinite(self.limit):
            return "none"
        return f">= {self.limit:g}" if self.open else f"{self.limit:g}"


@component("table", "limit", source="Chen, Hwang, Chang 2009, figure 9b")
class Limit(TableSpec):
    """For each label of one axis, the largest label of another up to which a metric stays below a limit.

    The median over the trials must stay below it there and at all smaller labels. Failed trials count as
    infinite, so that a method cannot gain by failing.
    """

    x: Annotated[str, NumericAxis()]
    """The axis that goes down; its labels are numbers."""
    along: Annotated[str, NumericAxis()]
    """The axis whose largest label is sought; its labels are numbers."""
    metric: MetricLabel
    """Label of the metric."""
    below: Real
    """The limit of the metric's median."""
    estimators: NonEmpty[EstimatorName]
    """Names of the estimators, one column each."""
    at: CaseLabels = {}
    """Labels of the other axes; the first ones by default."""

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        labels = {axis.name: axis.labels for axis in plan.axes}
        for i, estimator in enumerate(self.estimators):
            # No limit reaches beyond a case in which the estimator is left out.
            for x, far in itertools.product(labels[self.x], labels[self.along]):
                at = {**self.at, self.x: x, self.along: far}
                if not any(unit.name == estimator and unit.is_at(at) for unit in plan.units):
                    message = f"the estimator '{estimator}' is left out at {self.x} {x}, {self.along} {far}"
                    yield ("estimators", i), message

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        import pandas as pd

        found = {name: self.reaches(results, name) for name in self.estimators}
        rows = tuple(
            (f"{x:g}", *(reaches[i].text for reaches in found.values()))
            for i, x in enumerate(sorted(map(float, results.labels(self.x))))
        )
        data = pd.DataFrame(
            [(r.estimator, r.x, r.limit, r.open) for reaches in found.values() for r in reaches],
            columns=["estimator", self.x, self.along, "open"],
        )
        notes = (
            f"Largest {self.along} up to which the median of {self.metric} stays below {self.below:g}; "
            "failed trials count as infinite; >= where it does so at every label tried.",
        )
        return Table(self.title, (self.x, *self.estimators), rows, notes, data)

    def reaches(self, results: Results, estimator: str) -> list[Reach]:
        """How far an estimator goes at every label of ``x``, in increasing order."""
        along = sorted(results.labels(self.along), key=float)
        found = []
        for label in sorted(results.labels(self.x), key=float):
            medians = [
                _median(next(results.select(estimator, self.metric, {**at, self.along: far})))
                for at in [{**self.at, self.x: label}]
                for far in along
            ]
            fails = [i for i, median in enumerate(medians) if not median < self.below]
            last = (fails[0] if fails else len(along)) - 1
            limit = float(along[last]) if last >= 0 else float("nan")
            found.append(Reach(estimator, float(label), limit, not fails))
        return found


def _median(series: Series) -> float:
    """The median over all trials, a failed one being infinite."""
    return float(np.median(np.where(np.isfinite(series.values), series.values, np.inf)))


@component("figure", "limit", source="Chen, Hwang, Chang 2009, figure 9")
class LimitFigure(FigureSpec):
    """How far each estimator goes along one axis against the label of another, as a table of kind limit.

    A first panel shows the true characteristic at each label where an interval is given.
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
        yield from ((("table",), said) for said in not_numeric(plan, source.x, positive=self.log_x))
        if self.interval is not None and "nonlinearity" not in plan.units[0].data.system.provides():
            yield (
                ("interval",),
                f"the system '{plan.units[0].data.system.kind}' has no true nonlinearity to show",
            )

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        source = results.plan.experiment.tables[self.table]
        assert isinstance(source, Limit)
        count = 1 if self.interval is None else 2
        figure, grid = panel_grid(count, 2, 4.8 if count == 1 else 3.6, 3.0)
        if self.interval is not None:
            self._characteristics(grid[0], results, source, self.interval)
        self._limits(grid[-1], results, source)
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

    def _limits(self, axes: Axes, results: Results, source: Limit) -> None:
        beyond: list[tuple[float, float]] = []
        highest = 0.0
        for i, estimator in enumerate(source.estimators):
            reaches, line = source.reaches(results, estimator), LINES[i % len(LINES)]
            heights = [reach.limit for reach in reaches]
            somewhere = np.any(np.isfinite(heights))
            label = estimator if somewhere else f"{estimator}, nowhere"
            axes.plot([reach.x for reach in reaches], heights, label=label, **line)
            beyond += [(reach.x, reach.limit) for reach in reaches if reach.open]
            highest = float(np.nanmax([highest, *heights]))
        if beyond:
            x, y = zip(*beyond, strict=True)
            axes.plot(x, y, color="black", linestyle="none", marker=_UP, markersize=9, label="goes beyond")
        if self.log_x:
            axes.set_xscale("log")
        axes.set_ylim(0.0, 1.15 * highest if highest > 0.0 else 1.0)
        ticks = sorted(map(float, results.labels(source.x)))
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.set_xticks([], minor=True)
        axes.set_xlabel(self.x_label)
        axes.set_ylabel(self.y_label)
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
