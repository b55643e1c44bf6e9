"""Curves of estimates, with the bands in which they lie over the trials."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.references import EstimatorName
from hident.config.spec import Count, NonEmpty, Spec, component
from hident.config.suggest import counted, one_of, there_is_no
from hident.config.yaml12 import Location
from hident.engine.experiment import Plan, Unit
from hident.engine.replay import OneTrial
from hident.engine.results import Results
from hident.ledger.verdicts import Verdict
from hident.metrics.curves import CurveMetric, Points
from hident.reports.base import FigureSpec, Misfit, first_case, unscored
from hident.reports.style import DATA, draw_band, legend_above, looks, marked, panel_grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LOGARITHMIC = ("gain", "phase")
_BAND = 0.9


class BandPanel(Spec):
    """One curve of a metric, of some estimators."""

    metric: str
    """Name of the metric: of kind static_function, frequency_response or model_output."""
    curve: str | None = None
    """Which of its curves: gain or phase of a frequency_response."""
    estimators: NonEmpty[EstimatorName]
    """Names of the estimators."""
    title: str = ""
    """Title of the panel."""
    x_label: str
    """Label of the abscissa, with its unit."""
    y_label: str
    """Label of the ordinate, with its unit."""

    def of(self, plan: Plan) -> tuple[CurveMetric, Points]:
        """The metric, and the points of the curve."""
        metric = plan.experiment.metrics[self.metric]
        assert isinstance(metric, CurveMetric)
        curves = metric.curves(self.metric, self.unit(plan, self.estimators[0]).data.dt)
        return metric, curves[self.curve] if self.curve else next(iter(curves.values()))

    def unit(self, plan: Plan, estimator: str) -> Unit:
        """The first case of an estimator."""
        return next(unit for unit in plan.units if unit.name == estimator)

    def misfits(self, plan: Plan, place: Location) -> Iterator[Misfit]:
        """What cannot be shown of this plan."""
        metrics = plan.experiment.metrics
        fitting = [name for name, metric in metrics.items() if isinstance(metric, CurveMetric)]
        if self.metric not in metrics:
            yield (*place, "metric"), there_is_no("metric", self.metric, fitting)
            return
        metric = metrics[self.metric]
        if not isinstance(metric, CurveMetric):
            said = f"the metric '{self.metric}' gives no curve (those that do: {one_of(fitting) or 'none'})"
            yield (*place, "metric"), said
            return
        curves = metric.curves(self.metric, plan.units[0].data.dt)
        if self.curve is None and len(curves) > 1:
            yield (*place, "curve"), f"must say which curve: {' or '.join(curves)}"
        if self.curve is not None and self.curve not in curves:
            yield (*place, "curve"), there_is_no("curve", self.curve, curves)
        for i, name in enumerate(self.estimators):
            label = next(iter(curves.values())).labels[0]
            yield from unscored(plan, (*place, "estimators", i), name, label)


@component("figure", "bands")
class Bands(FigureSpec):
    """Curves of estimates and the bands that hold the central 90 % of them at each point, over the trials.

    Of a measured record the line is the estimate from the record itself, and the band that of its bootstraps;
    of a simulated one, the line is the median. What was measured stands behind a model's output.
    """

    panels: NonEmpty[BandPanel]
    """The panels."""
    columns: Annotated[Count, Field(ge=1)] = 2
    """Panels in a row."""

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        for i, panel in enumerate(self.panels):
            yield from panel.misfits(plan, ("panels", i))

    def looks_needed(self, plan: Plan) -> int:
        return len({name for panel in self.panels for name in panel.estimators})

    def says(self, results: Results) -> str:
        plan = results.plan
        names = list(dict.fromkeys(name for panel in self.panels for name in panel.estimators))
        measured = any(self.panels[0].unit(plan, name).data.resampled for name in names)
        of = counted(plan.trials - 1, "bootstrap") if measured else counted(plan.trials, "trial")
        band = f"bands: central {100 * _BAND:g} % of {of}, at each point" if plan.trials > 2 else ""
        return "; ".join(filter(None, (band, first_case(plan, names))))

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        lines = looks(name for panel in self.panels for name in panel.estimators)
        figure, grid = panel_grid(len(self.panels), self.columns, 3.6, 2.6)
        for panel, axes in zip(self.panels, grid, strict=True):
            self._draw_panel(axes, panel, results, lines)
        legend_above(figure)
        return figure

    def _draw_panel(
        self, axes: Axes, panel: BandPanel, results: Results, lines: Mapping[str, dict[str, object]]
    ) -> None:
        metric, points = panel.of(results.plan)
        record, _ = OneTrial(results.plan, 0).record(panel.unit(results.plan, panel.estimators[0]).data)
        y = None if record is None else metric.measured(record)
        if y is not None:
            axes.plot(points.x, y, label="measured", **DATA)
        for place, name in enumerate(panel.estimators):
            unit = panel.unit(results.plan, name)
            values = np.array(
                [next(results.select(name, label, unit.labels)).values for label in points.labels]
            ).T
            line, others = _split(values, is_measured=unit.data.resampled)
            draw_band(axes, points.x, others, lines[name], name, _BAND)
            axes.plot(points.x, line, label=name, **marked(lines[name], place, len(points.x)))
        if panel.curve in _LOGARITHMIC:
            axes.set_xscale("log")
        axes.set_xlim(points.x[0], points.x[-1])
        axes.set_title(panel.title)
        axes.set_xlabel(panel.x_label)
        axes.set_ylabel(panel.y_label)


def _split(values: Array, *, is_measured: bool) -> tuple[Array, Array]:
    """The line (K,), and the curves (T, K) of the band, from those of all trials (T, K)."""
    if is_measured or len(values) == 1:
        return values[0], values[1:]
    return np.nanmedian(values, axis=0), values
