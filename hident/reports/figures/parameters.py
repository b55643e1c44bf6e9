"""Figures of named parameters: values, gains and efficiencies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np

from hident.arrays import Array
from hident.config.references import EstimatorName, NumericAxis, TableName, ValueName, value_of
from hident.config.spec import Flag, NonEmpty, component
from hident.config.suggest import one_of
from hident.engine.experiment import Plan, Unit
from hident.engine.results import Results
from hident.ledger.verdicts import Verdict, beside
from hident.metrics.values import Value
from hident.reports.base import FigureSpec, Misfit, first_case
from hident.reports.style import (
    LINES,
    PRINTED,
    TRUE_LEVEL,
    label_edges,
    legend_above,
    panel_rows,
    shared_legend,
    subplots,
    symbol,
)
from hident.reports.tables.parameters import Efficiency, ratios

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@component("figure", "parameters")
class ParameterFigure(FigureSpec):
    """One panel for each parameter: mean and standard deviation of every estimator against the truth.

    The line is the truth of values, and zero of signed errors; other numbers have none. Of several cases the
    first is shown, and said: 'at' chooses another, and 'facets' shows all.
    """

    metric: str
    """Name of the metric, of kind value or error."""
    of: NonEmpty[ValueName]
    """Names of the values, one panel each."""
    estimators: NonEmpty[EstimatorName]
    """Names of the estimators."""

    def looks_needed(self, plan: Plan) -> int:
        return len(self.estimators)

    def says(self, results: Results) -> str:
        return first_case(results.plan, self.estimators)

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        theirs = {at: verdict.printed.value for at, verdict in beside(verdicts).items()}
        figure, grid = panel_rows(len(self.of), 4, (2.3, 2.2), (0.0, 0.5))
        for name, axes in zip(self.of, grid.flat, strict=False):
            for i, estimator in enumerate(self.estimators):
                series = next(results.select(estimator, f"{self.metric} {name}"))
                line = LINES[i % len(LINES)]
                look = {"color": line["color"], "marker": line["marker"], "capsize": 3, "linestyle": "none"}
                axes.errorbar(i, series.value("mean"), series.value("std"), label=estimator, **look)
                if (id(series), "mean") in theirs:
                    printed = (theirs[id(series), "mean"], theirs.get((id(series), "std"), 0.0))
                    look |= {"markerfacecolor": "none", "alpha": 0.75}
                    axes.errorbar(i + 0.3, *printed, label=f"{estimator}, printed", **look)
            units = (next(results.select(one, f"{self.metric} {name}")).unit for one in self.estimators)
            if (level := self._level(name, list(units))) is not None:
                axes.axhline(level[1], label=level[0], **TRUE_LEVEL)
            axes.set_title(symbol(name))
            axes.set_xticks([])
            axes.set_xlim(-0.6, len(self.estimators) - 0.1)
            axes.ticklabel_format(axis="y", useOffset=False)
        for axes in grid[:, 0]:
            axes.set_ylabel("mean ± standard deviation")
        shared_legend(figure, grid.flat[0].get_legend_handles_labels(), 4)
        return figure

    def _level(self, name: str, units: Sequence[Unit]) -> tuple[str, float] | None:
        """What the numbers of a panel should be, in words and as a number; None if nothing says it."""
        metrics = [unit.metrics[self.metric] for unit in units]
        if all(metric.best == "zero" for metric in metrics):
            return "no error", 0.0
        # In the form of each: where one of them has another there is no one line.
        true = {unit.truth().values.get(name) for unit in units}
        level = true.pop() if len(true) == 1 else None
        is_value = all(isinstance(metric, Value) for metric in metrics)
        return ("truth", level) if is_value and level is not None else None


@component("figure", "gain")
class Gain(FigureSpec):
    """Ratio of two estimators' standard deviations for each parameter, and the ratio of the printed ones.

    Of several cases the first is shown, and said.
    """

    metric: str
    """Name of the metric of kind value."""
    of: NonEmpty[Annotated[str, value_of(scores=("reference", "estimator"))]]
    """Names of the values."""
    reference: EstimatorName
    """Name of the estimator in the numerator."""
    estimator: EstimatorName
    """Name of the estimator in the denominator."""
    y_label: str
    """Label of the ordinate."""

    def says(self, results: Results) -> str:
        return first_case(results.plan, (self.reference, self.estimator))

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        figure, axes = subplots(figsize=(4.6, 3.0))
        printed = {at: verdict.printed.value for at, verdict in beside(verdicts).items()}
        pairs = [
            tuple(next(results.select(name, label)) for name in (self.reference, self.estimator))
            for label in (f"{self.metric} {value}" for value in self.of)
        ]
        x = np.arange(len(pairs))
        ours = ratios([a.value("std") for a, _ in pairs], [b.value("std") for _, b in pairs])
        # Independent or not, the ratio's error is at most that of independent spreads.
        error = ours / np.sqrt(max(results.plan.trials - 1, 1))
        axes.errorbar(
            x,
            ours,
            2.0 * error,
            label="ours, ± 2 standard errors",
            capsize=3,
            **LINES[0] | {"linestyle": "none"},
        )
        if all((id(series), "std") in printed for pair in pairs for series in pair):
            theirs = ratios(*([printed[id(one), "std"] for one in side] for side in zip(*pairs, strict=True)))
            axes.plot(x, theirs, label="printed", **LINES[1] | PRINTED)
        axes.axhline(1.0, color="0.4", linewidth=1.0, linestyle=":", label="no gain")
        axes.set_xticks(x, [symbol(value) for value in self.of])
        axes.set_ylabel(self.y_label)
        axes.set_ylim(bottom=0.0)
        legend_above(figure)
        return figure


@component("figure", "efficiency")
class EfficiencyFigure(FigureSpec):
    """Efficiency against a numeric axis: one panel for each parameter, one curve for each estimator."""

    x: Annotated[str, NumericAxis()]
    """The axis along the abscissa."""
    table: TableName
    """Name of the table of kind efficiency that it draws."""
    of: NonEmpty[str]
    """Names of the parameters, one panel each."""
    x_label: str
    """Label of the abscissa, with its unit."""
    log_y: Flag = True
    """Logarithmic ordinate."""

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        source = plan.experiment.tables[self.table]
        if not isinstance(source, Efficiency):
            yield ("table",), f"the table '{self.table}' must be of kind efficiency, not {source.kind}"
        elif unknown := [name for name in self.of if name not in source.of]:
            yield ("of",), f"the table '{self.table}' does not hold {', '.join(unknown)}"
        elif others := self._others(plan, source):
            yield (
                ("x",),
                f"a curve over '{self.x}' cannot hold the axes {one_of(others)} too: give 'facets' or 'at'",
            )

    def _others(self, plan: Plan, source: Efficiency) -> list[str]:
        """The axes beside x that its cases vary along."""
        units = [unit for unit in plan.units if unit.name in source.estimators]
        names = (axis.name for axis in plan.axes if axis.name != self.x)
        return [name for name in names if len({unit.labels.get(name) for unit in units}) > 1]

    def looks_needed(self, plan: Plan) -> int:
        source = plan.experiment.tables[self.table]
        return len(source.estimators) if isinstance(source, Efficiency) else 0

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        source = results.plan.experiment.tables[self.table]
        assert isinstance(source, Efficiency)
        figure, grid = panel_rows(len(self.of), 4, (2.3, 2.3), (0.0, 0.5), sharex=True, sharey=True)
        for i, estimator in enumerate(source.estimators):
            cases = list(results.select(estimator, f"{source.metric} {source.of[0]}"))
            x: Array = np.array([float(case.unit.labels[self.x]) for case in cases])
            heights = np.array([source.efficiencies(results, estimator, case) for case in cases])
            for name, axes in zip(self.of, grid.flat, strict=False):
                axes.plot(x, heights[:, source.of.index(name)], label=estimator, **LINES[i % len(LINES)])
        for name, axes in zip(self.of, grid.flat, strict=False):
            axes.axhline(1.0, color="0.4", linewidth=1.0, linestyle=":", label="Cramér-Rao bound")
            axes.set_title(symbol(name))
            if self.log_y:
                axes.set_yscale("log")
        label_edges(grid, self.x_label, "bound / variance")
        shared_legend(figure, grid.flat[0].get_legend_handles_labels(), 3)
        return figure
