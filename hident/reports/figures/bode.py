"""Bode diagrams of two linear blocks."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.references import EstimatorName, Metric
from hident.config.spec import Count, NonEmpty, component
from hident.engine.experiment import Plan
from hident.engine.results import Results
from hident.ledger.verdicts import Verdict
from hident.linear_blocks import ContinuousTransferFunction
from hident.metrics import frequency
from hident.reports.base import FigureSpec, Misfit, first_case
from hident.reports.style import LINES, TRUTH, Look, band_edge, legend_above, subplots

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_POINTS = 400


@component("figure", "bode")
class Bode(FigureSpec):
    """Gains and phases of both linear blocks at the frequencies of the sines, and below their errors.

    Marks are medians over the trials and bands, which the errors need to be seen, their central 90 %. The
    marks are hollow, those of an earlier estimator wider, so that equal ones are all seen. What fewer than
    half of the trials determine is left out.
    """

    metric: Annotated[str, Metric(labels=lambda bode, metric: bode.labels())]
    """Name of the metric of kind response that holds gain_i_M, gain_o_M_1, phase_i_M and phase_o_M_1."""
    frequencies: Annotated[Count, Field(ge=2)]
    """Number of frequencies M."""
    estimators: NonEmpty[EstimatorName]
    """Names of the estimators."""
    x_label: str
    """Label of the abscissa, with its unit."""

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        if "blocks" not in plan.units[0].data.system.provides():
            yield ("kind",), "the system has no true linear blocks in continuous time"
        if not isinstance(metric := plan.experiment.metrics[self.metric], frequency.Response):
            said = "and is of kind response: the errors below are drawn from it"
            yield ("metric",), f"holds gains and phases, {said}; '{self.metric}' is of kind {metric.kind}"

    def looks_needed(self, plan: Plan) -> int:
        return len(self.estimators)

    def says(self, results: Results) -> str:
        return first_case(results.plan, self.estimators)

    def labels(self) -> Iterator[str]:
        """The labels of the metric's numbers that it shows."""
        for quantity, side in itertools.product(("gain", "phase"), ("i", "o")):
            yield from (f"{self.metric} {name}" for name in self._names(quantity, side))

    def _names(self, quantity: str, side: str) -> list[str]:
        harmonic = "_1" if side == "o" else ""
        return [f"{quantity}_{side}_{m}{harmonic}" for m in range(1, self.frequencies + 1)]

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        # The blocks stand side by side in print too.
        figure, panels = subplots(4, 2, figsize=(2 * 3.4 + 0.4, 4 * 1.9 + 0.5))
        grid = [*panels.flat]
        data = next(results.select(self.estimators[0])).unit.data
        blocks = data.system.truth().blocks
        stretches = data.excitation.stretches(data.samples, data.dt or 1.0)
        omega = frequency.frequencies_of(stretches)[: self.frequencies]
        for column, side in enumerate(("i", "o")):
            block = blocks["input" if side == "i" else "output"]
            gains, gain_errors, phases, phase_errors = grid[column::2]
            self._draw_pair(results, (gains, gain_errors), "gain", side, block, omega)
            self._draw_pair(results, (phases, phase_errors), "phase", side, block, omega)
            gains.set_yscale("log")
            gains.set_title("input block $G_i$" if side == "i" else "output block $G_o$")
            phase_errors.set_xlabel(self.x_label)
        for axes in grid:
            axes.set_xscale("log")
            axes.set_xlim(0.9 * omega[0], 1.1 * omega[-1])
        for axes, text in zip(
            grid[::2], ("gain", "error of gain (%)", "phase (rad)", "error of phase (rad)"), strict=True
        ):
            axes.set_ylabel(text)
        legend_above(figure)
        return figure

    def _draw_pair(
        self,
        results: Results,
        panels: tuple[Axes, Axes],
        quantity: str,
        side: str,
        block: ContinuousTransferFunction,
        omega: Array,
    ) -> None:
        """Gains or phases of a block in one panel, their errors in the other; of gains in percent."""
        above, below = panels
        of_gains, names = quantity == "gain", self._names(quantity, side)
        function = frequency.gain if of_gains else frequency.phase
        true = function(block, omega)
        dense = np.geomspace(omega[0], omega[-1], _POINTS)
        above.plot(dense, function(block, dense), label="true", **TRUTH)
        below.axhline(0.0, **TRUTH)
        for place, (estimator, line) in enumerate(zip(self.estimators, LINES, strict=False)):
            series = [next(results.select(estimator, f"{self.metric} {name}")) for name in names]
            seen = np.array([2 * one.statistics["failed"] <= one.statistics["trials"] for one in series])
            low, middle, high = (
                np.array([one.statistics[name] for one in series]) for name in ("q05", "median", "q95")
            )
            mark: Look = {**line, "linestyle": "none", "markerfacecolor": "none", "zorder": 5}
            mark["markersize"] = 3 + 2.5 * (len(self.estimators) - 1 - place)
            above.plot(omega[seen], middle[seen], label=estimator, **mark)
            scale = 100.0 / true if of_gains else np.ones_like(true)
            low, middle, high = (((one - true) * scale)[seen] for one in (low, middle, high))
            band = f"{estimator}, central 90 %"
            below.fill_between(
                omega[seen], low, high, color=line["color"], alpha=0.2, label=band, linewidth=0
            )
            for edge in (low, high):
                below.plot(omega[seen], edge, **band_edge(line))
            below.plot(omega[seen], middle, **mark)
