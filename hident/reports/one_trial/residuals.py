"""The figure of what a model leaves of one record: the residuals, and what they still depend on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hident.config.spec import component
from hident.engine.experiment import Plan
from hident.engine.replay import OneTrial
from hident.engine.results import Results
from hident.errors import EstimationError
from hident.ledger.verdicts import Verdict
from hident.metrics.outputs import OnOutput
from hident.metrics.residuals import judged
from hident.numerics.judgement import Residuals
from hident.numerics.residuals import Correlations, Tested
from hident.reports.base import Misfit
from hident.reports.one_trial.base import OneTrialFigure, Shown, say_failed
from hident.reports.style import DATA, LINES, TRUE_LEVEL, Look, band_edge, beside, subplots

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BESIDE = 0.2
"""Half the distance of the marks of two signals at one lag, relative to that of two lags."""


@component("figure", "residuals")
class ResidualFigure(OnOutput, OneTrialFigure):
    """Residuals of one model in time, their correlations with themselves and the input, and their shape.

    Bands are those that a single correlation of a right model leaves in 1 of 100 cases; p is that of the
    test over all lags. Of the nonlinear functions that one is shown which stands out most. The last panel
    has the quantiles of the innovations, which an autoregression leaves, beside those of the normal
    distribution.
    """

    curve: Shown
    """The estimate, and the case."""
    t_label: str = "time t"
    """Label of the time, with its unit."""
    y_label: str = "residual e"
    """Label of the residuals, with the unit of the output."""

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        unit = self.curve.unit(plan)
        if unit.estimator.provides().isdisjoint(self.needed_part().split(" or ")):
            said = f"the estimator '{self.curve.estimator}' does not give a {self.needed_part()}"
            yield ("curve", "estimator"), said
        data = unit.data
        lengths = [stretch.samples for stretch in data.excitation.stretches(data.samples, data.dt or 1.0)]
        try:
            self.check_lengths(lengths, validated=data.validated)
        except ValueError as error:
            yield ("on" if self.on == "validation" else "n_init",), str(error)

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        columns = beside(2, 3.4)
        figure, panels = subplots(4 // columns, columns, figsize=(3.4 * columns, 9.6 / columns))
        grid = panels.reshape(2, 2)
        realised = OneTrial(results.plan, self.trial).of(self.curve.estimator, self.curve.at)
        failure, found = realised.failure, None
        if realised.found is not None and realised.record is not None:
            try:
                with np.errstate(all="ignore"):
                    found = judged(self.compared(realised.found, realised.record), realised.found, self.by)
                    failure = found.sentences[0] if found.vanish else ""
            except EstimationError as error:
                failure = str(error)
        if failure or found is None:
            say_failed(grid[0, 0], f"{self.curve.text} failed: {failure}")
            return figure
        figure.suptitle(f"{self.curve.text}, {self.described()}", fontsize=9)
        draw_residuals(grid, found, realised.unit.data.dt or 1.0, self.n_init, (self.t_label, self.y_label))
        return figure


def residual_figure(found: Residuals, dt: float, labels: tuple[str, str]) -> Figure:
    """The residuals of a model that stands in no configuration; see :func:`draw_residuals`."""
    figure, grid = subplots(2, 2, figsize=(6.8, 4.8))
    draw_residuals(grid, found, dt, 0, labels)
    return figure


def draw_residuals(grid: Any, found: Residuals, dt: float, n_init: int, labels: tuple[str, str]) -> None:
    """Residuals in time, their correlations and their quantiles, in a grid of two by two axes.

    ``labels`` are those of time and residuals; the first ``n_init`` samples were left out.
    """
    _in_time(grid[0, 0], found, dt, n_init)
    grid[0, 0].set_xlabel(labels[0])
    grid[0, 0].set_ylabel(labels[1])
    _correlations(grid[0, 1], "autocorrelation of e", [found.whiteness], "lag (samples)")
    tried = found.nonlinear_input.values()
    both = [found.input, max(tried, key=lambda one: one.test.statistic, default=None)]
    named = "correlation of e with the past"
    _correlations(grid[1, 0], named, [one for one in both if one], "samples before")
    _quantiles(grid[1, 1], found)


def _in_time(axes: Axes, found: Residuals, dt: float, n_init: int) -> None:
    several = len(found.experiments) > 1
    t = (np.arange(len(found.e)) + (0 if several else n_init)) * dt
    axes.plot(t, found.e, rasterized=True, **{**DATA, "color": "0.35"})
    for part in found.experiments[1:]:
        axes.axvline(float(t[part.start]) - dt / 2.0, color="black", linewidth=0.8, linestyle=":")
    axes.axhline(0.0, **TRUE_LEVEL)
    axes.set_title("residuals" + (" (dotted: a new experiment)" if several else ""))


def _correlations(axes: Axes, title: str, shown: Sequence[Correlations], x_label: str) -> None:
    for i, (one, line) in enumerate(zip(shown, LINES, strict=False)):
        look: Look = {**line, "linestyle": "none", "markersize": 3.5}
        if i:
            look["markerfacecolor"] = "white"
        x = one.lags + (i - (len(shown) - 1) / 2.0) * 2.0 * _BESIDE * (one.lags[1] - one.lags[0])
        axes.vlines(x, 0.0, one.values, color=line["color"], linewidth=0.9)
        label = f"{one.of}, {_p(one.test)}" if len(shown) > 1 else _p(one.test)
        axes.plot(x, one.values, label=label, zorder=5, **look)
        edge: dict[str, Any] = {**band_edge(line), "linewidth": 1.0, "alpha": 0.9}
        for sign in (-1.0, 1.0):
            axes.plot(one.lags, sign * one.band, **{**edge, "linestyle": line["linestyle"] if i else "--"})
    axes.axhline(0.0, **TRUE_LEVEL)
    axes.set_title(title)
    axes.set_xlabel(x_label)
    axes.set_ylabel("correlation")
    low, high = axes.get_ylim()
    # Room for the legend above.
    axes.set_ylim(low, high + 0.25 * (high - low))
    if shown:
        axes.legend(loc="upper right", ncols=len(shown))


def _quantiles(axes: Axes, found: Residuals) -> None:
    from scipy.special import ndtri

    w = np.sort(found.innovations.white(found.e - np.mean(found.e)))
    w = w / np.std(w)
    normal = ndtri((np.arange(len(w)) + 0.5) / len(w))
    axes.plot(normal[[0, -1]], normal[[0, -1]], label="normal", **TRUE_LEVEL)
    look = {**LINES[0], "linestyle": "none", "markersize": 2.5}
    axes.plot(normal, w, label=f"innovations, {_p(found.normality.test)}", rasterized=True, **look)
    axes.set_title("quantiles of the innovations of e")
    axes.set_xlabel("normal (standard deviations)")
    axes.set_ylabel("innovations (std. dev.)")
    axes.legend(loc="upper left", markerscale=1.6)


def _p(test: Tested) -> str:
    return "p < 0.001" if test.p_value < 1e-3 else f"p = {test.p_value:.2g}"
