"""Figures of how the estimates of one trial move: responses to an unseen input, settling times."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Protocol, runtime_checkable

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.spec import Count, Interval, NonEmpty, Of, Spec, component
from hident.engine.experiment import Plan
from hident.engine.replay import OneTrial
from hident.engine.results import Results
from hident.engine.trial import Data
from hident.errors import TrialFailed
from hident.ledger.verdicts import Verdict
from hident.metrics.models import fit_error, validation_input
from hident.model_output import has_stable_block
from hident.numerics.rounding import is_constant
from hident.records import Response, needed
from hident.reports.base import Misfit
from hident.reports.one_trial.base import (
    Offset,
    OneTrialFigure,
    Shown,
    list_failures,
    offset_misfits,
    offset_of,
    say_failed,
)
from hident.reports.style import TRUTH, Look, legend_above, looks, marked, panel_grid, subplots
from hident.signals.base import ExcitationSpec

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_OPERATING_POINTS = 401


class ResponsePanel(Spec):
    """The responses of one panel."""

    title: str = ""
    """Title of the panel."""
    curves: NonEmpty[Shown]
    """The estimates that predict; the first one's system gives the actual response."""
    y_offset: Offset = 0.0
    """Added to the ordinate: a number, or the name of a true value such as steady_output."""


@component("figure", "validation", source="Chen, Hwang, Chang 2009, figures 11b, 13 and 15b")
class Validation(OneTrialFigure):
    """An input that the estimates have not seen, and below it the actual and predicted responses.

    All start from rest and are free of noise. The legend has the root mean square of each error in percent
    of the standard deviation of the actual response.
    """

    excitation: Annotated[ExcitationSpec, Of("excitation")]
    """The input of the validation; a random one is the same as that of the metric validation_error."""
    samples: Annotated[Count, Field(ge=2)]
    """Its length, at the sampling interval of the data."""
    panels: NonEmpty[ResponsePanel]
    """The panels, one below the other."""
    x_offset: Offset = 0.0
    """Added to the input: a number, or a true value of the first system such as steady_input."""
    t_label: str
    """Label of the abscissa, with the unit of time."""
    u_label: str
    """Label of the input, with its unit."""
    u_title: str = ""
    """Title of the panel of the input."""
    y_label: str
    """Label of the output, with its unit."""

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        for i, panel in enumerate(self.panels):
            for j, curve in enumerate(panel.curves):
                at = ("panels", i, "curves", j)
                part = "" if j else "response"
                yield from curve.misfits(plan, at, of_estimate="response", of_truth=part)
            yield from offset_misfits(plan, ("panels", i), panel.curves[:1], {"y_offset": panel.y_offset})
        yield from offset_misfits(plan, (), self.panels[0].curves[:1], {"x_offset": self.x_offset})
        try:
            self.excitation.check(self.samples, self.panels[0].curves[0].unit(plan).data.dt or 1.0)
        except ValueError as error:
            yield ("excitation",), str(error)

    def looks_needed(self, plan: Plan) -> int:
        return len({curve.text for panel in self.panels for curve in panel.curves})

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        trial = OneTrial(results.plan, self.trial)
        lines = looks(curve.text for panel in self.panels for curve in panel.curves)
        count = len(self.panels)
        figure, grid = subplots(
            count + 1,
            squeeze=False,
            sharex=True,
            figsize=(6.6, 1.6 + 2.3 * count),
            height_ratios=(1.0, *[1.6] * count),
        )
        first = self.panels[0].curves[0]
        realised = trial.of(first.estimator, first.at)
        u, t = self._input(realised.unit.data)
        axes = grid[0, 0]
        axes.plot(t, u + offset_of(realised.truth, self.x_offset), drawstyle="steps-post", **TRUTH)
        axes.set_ylabel(self.u_label)
        axes.set_title(self.u_title)
        for panel, axes in zip(self.panels, grid[1:, 0], strict=True):
            self._panel(axes, panel, trial, lines)
        grid[-1, 0].set_xlabel(self.t_label)
        return figure

    def _input(self, data: Data) -> tuple[Array, Array]:
        """The input and its times."""
        dt = 1.0 if data.dt is None else data.dt
        t = dt * np.arange(self.samples, dtype=float)
        return validation_input(self.excitation, self.samples, dt), t

    def _panel(self, axes: Axes, panel: ResponsePanel, trial: OneTrial, lines: Mapping[str, Look]) -> None:
        axes.set_ylabel(self.y_label)
        axes.set_title(panel.title)
        first = trial.of(panel.curves[0].estimator, panel.curves[0].at)
        offset = offset_of(first.truth, panel.y_offset)
        u, t = self._input(first.unit.data)
        dt = 1.0 if first.unit.data.dt is None else first.unit.data.dt
        actual, failure = _respond(first.truth.response, u, dt)
        if actual is None:
            say_failed(axes, f"the actual response failed: {failure}")
            return
        axes.plot(t, actual + offset, label="actual", **TRUTH)
        failures = []
        for place, curve in enumerate(panel.curves):
            realised = trial.of(curve.estimator, curve.at)
            predicted, failure = None, realised.failure
            if realised.found is not None and not has_stable_block(realised.found):
                failure = "its linear block is unstable"
            elif realised.found is not None:
                predicted, failure = _respond(realised.found.response, u, dt)
            if predicted is not None and is_constant(actual):
                predicted, failure = None, "the actual response does not vary, and has no percentage"
            if predicted is None:
                failures.append(f"{curve.text} failed: {failure}")
                continue
            label = f"{curve.text}: {fit_error(predicted, actual):.3g} %"
            look = marked(lines[curve.text], place, len(t))
            axes.plot(t, predicted + offset, label=label, zorder=5, **look)
        list_failures(axes, failures)
        # Beside the panel: steps leave no corner of it free.
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), title="error, % of std", title_fontsize=8)


def _respond(response: Response | None, u: Array, dt: float) -> tuple[Array | None, str]:
    """The response, or None and why it failed."""
    try:
        with np.errstate(all="ignore"):
            return needed(response)(u, dt), ""
    except TrialFailed as error:
        return None, str(error)


@runtime_checkable
class Settles(Protocol):
    """A system whose linearised dynamics change with the operating point."""

    def settling_time(self, flow: float) -> float:
        """The settling time of the system linearised at a constant input."""


@component("figure", "settling_map", source="Chen, Hwang, Chang 2009, figure 12b")
class SettlingMap(OneTrialFigure):
    """Settling time of the linearised system against the operating point, and of the estimated blocks."""

    curves: NonEmpty[Shown]
    """The estimates; the first one's system gives the truth."""
    interval: Interval
    """Range of the operating points."""
    y_limits: Interval | None = None
    """Range of the ordinate; by what is shown by default."""
    x_label: str
    """Label of the abscissa, with the unit of the input."""
    y_label: str
    """Label of the ordinate, with the unit of time."""

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        for i, curve in enumerate(self.curves):
            if "continuous" not in curve.unit(plan).estimator.provides():
                without = f"the estimator '{curve.estimator}' does not give a linear block in continuous time"
                yield ("curves", i, "estimator"), without
        system = self.curves[0].unit(plan).data.system
        if not isinstance(system, Settles):
            yield ("kind",), f"the system '{system.kind}' has no settling time that varies with its input"

    def looks_needed(self, plan: Plan) -> int:
        return len({curve.text for curve in self.curves})

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        trial = OneTrial(results.plan, self.trial)
        lines = looks(curve.text for curve in self.curves)
        figure, (axes,) = panel_grid(1, 1, 4.8, 2.9)
        system = trial.of(self.curves[0].estimator, self.curves[0].at).unit.data.system
        assert isinstance(system, Settles)
        x = np.linspace(*self.interval, _OPERATING_POINTS)
        times = np.array([system.settling_time(float(point)) for point in x])
        axes.plot(x, np.where(np.isfinite(times), times, np.nan), label="linearised system", **TRUTH)
        failures = []
        for place, curve in enumerate(self.curves):
            realised = trial.of(curve.estimator, curve.at)
            if realised.found is None:
                failures.append(f"{curve.text} failed: {realised.failure}")
                continue
            constant = np.full(_OPERATING_POINTS, needed(realised.found.continuous).settling_time())
            look = marked(lines[curve.text], place, _OPERATING_POINTS)
            axes.plot(x, constant, label=curve.text, **look)
        list_failures(axes, failures)
        axes.set_xlim(*self.interval)
        axes.set_ylim(*(self.y_limits or (0.0, None)))
        axes.set_xlabel(self.x_label)
        axes.set_ylabel(self.y_label)
        legend_above(figure)
        return figure
