"""The figure of the searches behind the estimates of one trial."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from hident.arrays import Array, Flags
from hident.config.spec import Count, NonEmpty, component
from hident.engine.replay import OneTrial
from hident.engine.results import Results
from hident.estimators.moving_horizon.searches import PartitionSearch, StructureSearch
from hident.estimators.selection.select import Criterion, Selection
from hident.ledger.verdicts import Verdict
from hident.reports.one_trial.base import NOTE, OneTrialFigure, Shown, say_failed
from hident.reports.style import LINES, Look, few_log_ticks, legend_above, panel_grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WORST = 10.0
_CRITERIA: dict[Criterion, str] = {
    "cross_validation": "mean squared prediction error\n(cross-validation)",
    "holdout": "mean squared prediction error\n(samples held out)",
    "validation": "mean squared prediction error\n(validation)",
    "leave_one_out": "mean squared prediction error\n(leave-one-out)",
    "aic": "AIC",
    "bic": "BIC",
    "fpe": "final prediction error (FPE)",
}
# A setting whose values span this factor has a logarithmic axis.
_WIDE = 8.0
# As many values are written at their places.
_MOST_TICKS = 8
# Shares of a panel's width and height that a contour's number reaches.
_EDGE = 0.06
_RING: Look = {
    "color": "black",
    "marker": "o",
    "markersize": 10,
    "markerfacecolor": "none",
    "linestyle": "none",
    "zorder": 6,
}
# Fewer pairs than this that were not rejected are shown by numbers, since contours need neighbours.
_FEWEST = 16
# Between two contour lines lie these shares of the searched pairs, so that any valley shows.
_SHARES = (0.03, 0.08, 0.16, 0.28, 0.44, 0.62, 0.8)


class SearchPanel(Shown):
    """The search behind one estimate."""

    show: Literal["structure", "partition", "selection"]
    """The search: over the structure (n, m), over the partition points, or among the candidates of select."""
    x_label: str | None = None
    """Label of the abscissa: n, the lower partition point, or a setting."""
    y_label: str | None = None
    """Label of the ordinate: the relative output error, the upper partition point, or the criterion."""


@component("figure", "search", source="Chen, Hwang, Chang 2009, figures 3 and 6")
class Search(OneTrialFigure):
    """The searches of one trial, one panel each.

    A structure panel shows the error of every candidate against n, one line for each m (of several delays
    the best), and a ring around the chosen one. A partition panel shows contours of the criterion relative
    to its least value on the grid, and a cross at the best pair after the refinements. A panel of a selection
    shows the criterion against the setting with the most values, one line for each choice of the others; a
    candidate that failed leaves a gap. What is chosen stands in numbers under the title, where it covers
    nothing.
    """

    panels: NonEmpty[SearchPanel]
    """The panels; the label of each is its title."""
    columns: Annotated[Count, Field(ge=1)] = 2
    """Panels in a row."""

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        trial = OneTrial(results.plan, self.trial)
        figure, grid = panel_grid(len(self.panels), self.columns, 3.3, 2.7)
        for panel, axes in zip(self.panels, grid, strict=True):
            realised = trial.of(panel.estimator, panel.at)
            if realised.found is None:
                axes.set_title(panel.text)
                axes.set_axis_off()
                say_failed(axes, f"failed: {realised.failure}")
            elif panel.show == "structure":
                chosen = draw_structure(axes, realised.detail("structure"))
                axes.set_title(f"{panel.text}\n{chosen}")
                axes.set_xlabel(panel.x_label or "n")
                axes.set_ylabel(panel.y_label or "output error / std of output")
            elif panel.show == "selection":
                selection: Selection = realised.detail("selection")
                axes.set_title(f"{panel.text}\n{draw_selection(axes, selection)}")
                axes.set_xlabel(panel.x_label or abscissa_of(selection))
                axes.set_ylabel(panel.y_label or _CRITERIA[selection.by])
            else:
                best = draw_partition(axes, realised.detail("partition"))
                axes.set_title(f"{panel.text}\n{best}")
                axes.set_xlabel(panel.x_label or "lower partition point")
                axes.set_ylabel(panel.y_label or "upper partition point")
        legend_above(figure)
        return figure


def draw_structure(axes: Axes, search: StructureSearch) -> str:
    """The error against n, one line for each m, and a ring around the chosen structure; returns its words."""
    orders = np.unique(search.n)
    for i, m in enumerate(np.unique(search.m)):
        best = [np.min(search.error[(search.n == n) & (search.m == m)], initial=np.inf) for n in orders]
        errors = np.where(np.isfinite(best), best, np.nan)
        axes.plot(orders, errors, label=f"m = {m}", **LINES[i % len(LINES)])
    axes.set_yscale("log")
    few_log_ticks(axes.yaxis)
    low, high = axes.get_ylim()
    # A candidate that is far worse than no model at all would flatten the others.
    axes.set_ylim(low, max(min(high, _WORST), 2.0 * low))
    axes.set_xticks(orders)
    n, m, delay = search.n[search.chosen], search.m[search.chosen], search.delay[search.chosen]
    several = f", d = {delay:g}" if len(np.unique(search.delay)) > 1 else ""
    axes.plot(n, search.error[search.chosen], label="chosen", **_RING)
    return f"chosen: n = {n}, m = {m}{several}"


def abscissa_of(selection: Selection) -> str:
    """The setting with the most values, the first of several, numbers before all else."""
    return max(
        selection.over,
        key=lambda path: (_is_numeric(selection.over[path]), len(selection.over[path])),
    )


def draw_selection(axes: Axes, selection: Selection) -> str:
    """The criterion against one setting, a line for each choice of the others; returns what was chosen."""
    along = abscissa_of(selection)
    places = list(itertools.product(*(range(len(values)) for values in selection.over.values())))
    others = [path for path in selection.over if path != along]
    values = selection.over[along]
    x = np.array(values, dtype=float) if _is_numeric(values) else np.arange(1.0, len(values) + 1.0)
    lines: dict[tuple[int, ...], Array] = {}
    for at, criterion in zip(places, selection.criterion, strict=True):
        place = dict(zip(selection.over, at, strict=True))
        line = lines.setdefault(tuple(place[path] for path in others), np.full(len(values), np.nan))
        line[place[along]] = criterion
    order = np.argsort(x, kind="stable")
    for i, (at, line) in enumerate(lines.items()):
        label = ", ".join(f"{path} {selection.word(path, j)}" for path, j in zip(others, at, strict=True))
        axes.plot(x[order], line[order], label=label or None, **LINES[i % len(LINES)])
    if np.nanmin(selection.criterion) > 0.0:
        axes.set_yscale("log")
        few_log_ticks(axes.yaxis)
    if _is_numeric(values) and x.min() > 0.0 and x.max() / x.min() >= _WIDE:
        axes.set_xscale("log")
        few_log_ticks(axes.xaxis)
    if len(values) <= _MOST_TICKS or not _is_numeric(values):
        axes.set_xticks(x, [selection.word(along, i) for i in range(len(values))])
        axes.set_xticks([], minor=True)
    best = dict(zip(selection.over, places[selection.chosen], strict=True))
    axes.plot(x[best[along]], selection.criterion[selection.chosen], label="chosen", **_RING)
    return "chosen: " + ", ".join(f"{path} {selection.word(path, i)}" for path, i in best.items())


def _is_numeric(values: Sequence[Any]) -> bool:
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def draw_partition(axes: Axes, search: PartitionSearch) -> str:
    """The criterion over the pairs of partition points, by contours or numbers, and a cross at the best.

    Returns the best pair in words.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.ma.masked_invalid(search.loss.T / np.nanmin(search.loss))
    if ratio.count() < _FEWEST:
        _draw_numbers(axes, search, ratio)
    else:
        _draw_contours(axes, search, ratio)
    rejected = np.argwhere(~np.isfinite(search.loss))
    if len(rejected):
        axes.plot(
            search.lower[rejected[:, 0]],
            search.upper[rejected[:, 1]],
            color="0.45",
            linestyle="none",
            marker="x",
            markersize=3,
            label="rejected",
        )
    lower, upper = search.best
    label = "best (numbers: criterion / least)"
    look: dict[str, Any] = {
        "color": "black",
        "marker": "+",
        "markersize": 11,
        "markeredgewidth": 1.8,
        "zorder": 6,
    }
    axes.plot(lower, upper, linestyle="none", label=label, **look)
    axes.grid(visible=False, which="major")
    return f"best: ({lower:.3g}, {upper:.3g})"


def _draw_contours(axes: Axes, search: PartitionSearch, ratio: np.ma.MaskedArray[Any, Any]) -> None:
    import matplotlib as mpl

    levels = contour_levels(ratio.compressed())
    if len(levels) > 1 and min(ratio.shape) > 1:
        # Light enough for the lines and numbers to be read, darker uphill.
        colours = mpl.colormaps["Blues"](np.linspace(0.0, 0.6, len(levels)))
        axes.contourf(search.lower, search.upper, ratio, levels, colors=colours, extend="max")
        lines = axes.contour(
            search.lower, search.upper, ratio, levels[1:], colors="black", linewidths=0.5, linestyles="-"
        )
        for text in axes.clabel(lines, fmt="%g", fontsize=6.5, inline_spacing=2):
            across, up = axes.transAxes.inverted().transform(axes.transData.transform(text.get_position()))
            # The edge of the panel would cut it.
            text.set_visible(min(across, up, 1.0 - across, 1.0 - up) > _EDGE)


def _draw_numbers(axes: Axes, search: PartitionSearch, ratio: np.ma.MaskedArray[Any, Any]) -> None:
    """The criterion at each pair that was not rejected, in a window around them and the best pair."""
    for j, i in np.argwhere(~np.ma.getmaskarray(ratio)):
        at = (search.lower[i], search.upper[j])
        axes.text(*at, f"{ratio[j, i]:.2f}", fontsize=8, ha="center", va="center", bbox=NOTE)
    # Which pair a number is of; ticks widen the axes.
    for axis, points in ((axes.xaxis, search.lower), (axes.yaxis, search.upper)):
        axis.remove_overlapping_locs = False
        axis.set_ticks(points, minor=True)
        axis.grid(visible=True, which="minor")
    axes.tick_params(which="minor", length=0)
    kept = np.isfinite(search.loss)
    axes.set_xlim(*_window(search.lower, np.any(kept, axis=1), search.best[0]))
    axes.set_ylim(*_window(search.upper, np.any(kept, axis=0), search.best[1]))


def _window(points: Array, kept: Flags, best: float) -> tuple[float, float]:
    """The range of the kept points (K,) of a grid and of the best one, to one point beyond on either side."""
    shown, points = np.append(points[kept], best), np.sort(points)
    first = max(int(np.searchsorted(points, shown.min())) - 1, 0)
    last = min(int(np.searchsorted(points, shown.max(), side="right")), len(points) - 1)
    margin = 0.08 * (points[last] - points[first])
    return float(points[first] - margin), float(points[last] + margin)


def contour_levels(ratio: Array) -> Array:
    """Increasing levels from 1 on for contours of values (K,) with minimum 1.

    They are quantiles of the values, rounded to two digits of their excess over 1.
    """
    excess = np.quantile(ratio, _SHARES) - 1.0
    rounded = [float(f"{value:.1e}") for value in excess if np.isfinite(value) and value > 0.0]
    return np.unique([1.0, *(1.0 + value for value in rounded)])
