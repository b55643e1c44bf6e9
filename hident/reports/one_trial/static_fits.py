"""The figure of true and estimated characteristics of one trial."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from pydantic import Field

from hident.arrays import Array
from hident.config.spec import Count, Flag, Interval, NonEmpty, Spec, component
from hident.config.yaml12 import Location
from hident.engine.experiment import Plan
from hident.engine.replay import OneTrial, Realised
from hident.engine.results import Results
from hident.ledger.verdicts import Verdict
from hident.records import Estimate, Truth, needed
from hident.reports.base import Misfit
from hident.reports.one_trial.base import (
    Offset,
    OneTrialFigure,
    Shown,
    list_failures,
    offset_misfits,
    offset_of,
    true_curve,
)
from hident.reports.style import DATA, TRUTH, Look, legend_above, looks, marked, panel_grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_POINTS = 2001
EXPANSION: Look = {"color": "0.5", "linestyle": ":", "linewidth": 1.6}
# A Taylor polynomial is interpolated within this share of the interval, with so many orders more.
_NEAR, _MORE = 0.02, 4
_PARTITION = {"input": ("u_-1", "u_1"), "output": ("y_-1", "y_1")}


class StaticCurve(Shown):
    """What a panel shows of one estimate; the curve of a linear model is its static gain."""

    show: Annotated[tuple[Literal["curve", "points", "smoothed"], ...], Field(min_length=1)] = ("curve",)
    """Any of curve, points (output against internal variable) and smoothed (means of their clusters)."""
    linear: Literal["before", "after"] | None = None
    """Give the curve the static gain of a linear block before or after it; not by default."""

    def of(self, found: Estimate, x: Array) -> Array:
        """The estimated characteristic at points (K,), with the linear block's gain if that is asked for.

        A linear model's is its static gain.
        """
        if found.nonlinearity is None:
            return _static_gain(found) * x
        match self.linear:
            case "before":
                return found.nonlinearity(_static_gain(found) * x)
            case "after":
                return _static_gain(found) * found.nonlinearity(x)
            case None:
                return found.nonlinearity(x)


def _static_gain(found: Estimate) -> float:
    if found.continuous is not None:
        return found.continuous.b[0]
    linear = needed(found.linear)
    return float(np.sum(linear.b) / np.sum(linear.denominator))


class StaticPanel(Spec):
    """The characteristics of one panel."""

    title: str = ""
    """Title of the panel."""
    curves: NonEmpty[StaticCurve]
    """The estimates; the first one's system gives the truth."""
    interval: Interval
    """Range of the abscissa, as shown."""
    x_label: str | None = None
    """Label of its abscissa, with the unit; that of the figure by default."""
    y_label: str | None = None
    """Label of its ordinate, with the unit; that of the figure by default."""
    y_limits: Interval | None = None
    """Range of the ordinate; by what is shown by default."""
    x_offset: Offset = 0.0
    """Added to the abscissa: a number, or the name of a true value such as steady_input."""
    y_offset: Offset = 0.0
    """Added to the ordinate: a number, or the name of a true value such as steady_output."""
    partition: Literal["input", "output"] | None = None
    """Mark the partition points on the abscissa (input: u_-1, u_1) or the ordinate (output: y_-1, y_1)."""
    beyond: Flag = True
    """Draw the curves beyond the range of the internal variable that the trial reached, too."""
    expansion: Annotated[Count, Field(ge=1, le=5)] | None = None
    """Order of the truth's Taylor polynomial around the origin, drawn beside it; none by default."""

    def misfits(self, plan: Plan, place: Location) -> Iterator[Misfit]:
        """What cannot be shown of this plan."""
        first = {"of_truth": "nonlinearity"}
        for i, curve in enumerate(self.curves):
            provided = curve.unit(plan).estimator.provides()
            linear = not provided.isdisjoint({"linear", "continuous"})
            part = "nonlinearity" if "curve" in curve.show and not linear else ""
            yield from curve.misfits(plan, (*place, "curves", i), of_estimate=part, **first)
            first = {}
            if curve.linear and not linear:
                without = f"the estimator '{curve.estimator}' does not give a linear block"
                yield (*place, "curves", i, "linear"), without
        offsets = {"x_offset": self.x_offset, "y_offset": self.y_offset}
        yield from offset_misfits(plan, place, self.curves, offsets)
        if self.partition is not None:
            names = _PARTITION[self.partition]
            given = (curve.unit(plan).estimator.provides() for curve in self.curves)
            if not any(parts.issuperset(f"value {name}" for name in names) for parts in given):
                yield (*place, "partition"), f"no estimator of this panel gives {' and '.join(names)}"


@component("figure", "static_fit", source="Chen, Hwang, Chang 2009, figures 4, 7, 10a, 11a, 12a and 15a")
class StaticFit(OneTrialFigure):
    """The true characteristic and the estimates of one trial, with the points that they rest on."""

    panels: NonEmpty[StaticPanel]
    """The panels."""
    x_label: str
    """Label of the abscissa, with its unit."""
    y_label: str
    """Label of the ordinate, with its unit."""
    columns: Annotated[Count, Field(ge=1)] = 2
    """Panels in a row."""

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        for i, panel in enumerate(self.panels):
            yield from panel.misfits(plan, ("panels", i))

    def looks_needed(self, plan: Plan) -> int:
        return len({curve.text for panel in self.panels for curve in panel.curves})

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        trial = OneTrial(results.plan, self.trial)
        lines = looks(curve.text for panel in self.panels for curve in panel.curves)
        width = 3.6 if len(self.panels) > 1 else 4.8
        figure, grid = panel_grid(len(self.panels), self.columns, width, 2.9)
        for panel, axes in zip(self.panels, grid, strict=True):
            draw_static(axes, panel, trial, lines)
            axes.set_xlabel(panel.x_label or self.x_label)
            axes.set_ylabel(panel.y_label or self.y_label)
        legend_above(figure)
        return figure


def draw_static(axes: Axes, panel: StaticPanel, trial: OneTrial, lines: Mapping[str, Look]) -> None:
    """One panel: truth, estimates, their points and their partition points."""
    shown = np.linspace(*panel.interval, _POINTS)
    truth = trial.of(panel.curves[0].estimator, panel.curves[0].at).truth
    x = shown - offset_of(truth, panel.x_offset)
    axes.plot(shown, true_curve(truth, x) + offset_of(truth, panel.y_offset), label="true", **TRUTH)
    if panel.expansion is not None:
        near = _NEAR * (panel.interval[1] - panel.interval[0])
        y = taylor(truth, panel.expansion, near)(x) + offset_of(truth, panel.y_offset)
        axes.plot(shown, y, label=f"its expansion of order {panel.expansion}", **EXPANSION)
    failures = []
    for place, curve in enumerate(panel.curves):
        realised = trial.of(curve.estimator, curve.at)
        if realised.found is None:
            failures.append(f"{curve.text} failed: {realised.failure}")
        else:
            _draw_estimate(axes, panel, curve, realised, marked(lines[curve.text], place, _POINTS))
    list_failures(axes, failures)
    axes.set_xlim(*panel.interval)
    if panel.y_limits is not None:
        axes.set_ylim(*panel.y_limits)
    axes.set_title(panel.title)


def _draw_estimate(
    axes: Axes, panel: StaticPanel, curve: StaticCurve, realised: Realised, line: Look
) -> None:
    found = needed(realised.found)
    x_offset, y_offset = (offset_of(realised.truth, offset) for offset in (panel.x_offset, panel.y_offset))
    if "points" in curve.show:
        x, y = realised.detail("internal_variable")
        look = {**DATA, "marker": line["marker"], "markersize": 1.5}
        axes.plot(x + x_offset, y + y_offset, label=f"{curve.text}, points", **look)
    if "curve" in curve.show:
        shown = np.linspace(*panel.interval, _POINTS)
        with np.errstate(all="ignore"):
            y = curve.of(found, shown - x_offset)
        if not panel.beyond:
            reached = realised.detail("internal_variable")[0]
            y[(shown - x_offset < reached.min()) | (shown - x_offset > reached.max())] = np.nan
        axes.plot(shown, y + y_offset, label=curve.text, zorder=5, **line)
    if "smoothed" in curve.show:
        x, y = realised.detail("smoothed")
        look = {"linestyle": "none", "markerfacecolor": "white", "markersize": 5, "zorder": 6}
        look |= {"color": line["color"], "marker": line["marker"]}
        axes.plot(x + x_offset, y + y_offset, label=f"{curve.text}, smoothed", **look)
    if panel.partition is not None and found.values.keys() >= {*_PARTITION[panel.partition]}:
        points = np.array([found.values[name] for name in _PARTITION[panel.partition]])
        offset = x_offset if panel.partition == "input" else y_offset
        _mark(axes, panel.partition, points + offset, line)


def taylor(truth: Truth, order: int, near: float) -> Polynomial:
    """The Taylor polynomial of the true characteristic around zero, by interpolation within ``near``."""
    nonlinearity = needed(truth.nonlinearity)
    found = Chebyshev.interpolate(nonlinearity, order + _MORE, [-near, near])
    return found.convert(kind=Polynomial).cutdeg(order)


def _mark(axes: Axes, axis: str, points: Array, line: Look) -> None:
    """Ticks at points of an axis, standing inward."""
    look = {"color": line["color"], "linestyle": "none", "markersize": 12, "markeredgewidth": 2.0}
    if axis == "input":
        where = axes.get_xaxis_transform()
        axes.plot(points, np.zeros(2), marker="|", transform=where, label="partition points", **look)
    else:
        where = axes.get_yaxis_transform()
        axes.plot(np.zeros(2), points, marker="_", transform=where, label="partition points", **look)
