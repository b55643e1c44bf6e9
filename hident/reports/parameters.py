"""Tables and figures of named parameters: estimates beside the truth and the printed numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.spec import Count, Flag, component
from hident.engine.experiment import Plan
from hident.engine.results import Results, Series
from hident.ledger.verdicts import Verdict, beside
from hident.reports.base import (
    FigureSpec,
    Misfit,
    Reference,
    Table,
    TableSpec,
    not_numeric,
    unscored,
)
from hident.reports.style import LINES, TRUTH, subplots, symbol
from hident.reports.tables import LEGEND, SIGNS, intervals

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def _one(results: Results, estimator: str, metric: str) -> Series:
    """The one series of an estimator and a metric; the first if axes give several."""
    return next(results.select(estimator, metric))


@component("table", "parameters")
class Parameters(TableSpec):
    """One row for each parameter, one column for each estimator: mean ± std, printed numbers beside."""

    metric: str
    """Name of the metric of kind value."""
    of: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names of the values, one row each."""
    mean_only: tuple[str, ...] = ()
    """Names of values whose standard deviation the paper does not print, such as a loss."""
    estimators: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names of the estimators, one column each."""
    decimals: Annotated[Count, Field(ge=0, le=15)] = 4
    """Decimals."""

    def references(self) -> Iterator[Reference]:
        for i, estimator in enumerate(self.estimators):
            yield ("estimators", i), "estimator", estimator
        for name in (*self.of, *self.mean_only):
            yield "of", "metric", f"{self.metric} {name}"

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        for i, estimator in enumerate(self.estimators):
            for name in (*self.of, *self.mean_only):
                yield from unscored(plan, ("estimators", i), estimator, f"{self.metric} {name}")

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        printed = beside(verdicts)
        header, rows = ["parameter"], []
        columns = {
            estimator: self._has_printed(results, estimator, verdicts) for estimator in self.estimators
        }
        for estimator, two in columns.items():
            header += [estimator, "printed"] if two else [estimator]
        for name in (*self.of, *self.mean_only):
            row = [name]
            statistics = ("mean",) if name in self.mean_only else ("mean", "std")
            for estimator, two in columns.items():
                series = _one(results, estimator, f"{self.metric} {name}")
                row.append(" ± ".join(f"{series.statistics[s]:.{self.decimals}f}" for s in statistics))
                if two:
                    found = [printed[id(series), s] for s in statistics if (id(series), s) in printed]
                    row.append(" ± ".join(f"{v.printed.printed} {SIGNS[v.word]}" for v in found))
            rows.append(tuple(row))
        return Table(
            self.title, tuple(header), tuple(rows), (LEGEND, *intervals(verdicts)) if printed else ()
        )

    def _has_printed(self, results: Results, estimator: str, verdicts: Sequence[Verdict]) -> bool:
        shown = [_one(results, estimator, f"{self.metric} {name}") for name in (*self.of, *self.mean_only)]
        return any(verdict.series is series for verdict in verdicts for series in shown)


def ratios(above: Sequence[float], below: Sequence[float]) -> Array:
    """The ratios (K,), nan or infinite where the number below is zero."""
    with np.errstate(all="ignore"):
        return np.asarray(np.array(above) / np.array(below))


@component("table", "efficiency")
class Efficiency(TableSpec):
    """Squared Cramer-Rao bound over variance, for each parameter, estimator and case; 1 is efficient."""

    metric: str
    """Name of the metric of kind error."""
    of: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names of the parameters, one column each."""
    estimators: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names of the estimators."""
    bound: str
    """Name of the estimator of kind cramer_rao."""
    bound_metric: str
    """Name of the metric of kind value that holds its se_ values."""

    def references(self) -> Iterator[Reference]:
        for estimator in (*self.estimators, self.bound):
            yield "estimators", "estimator", estimator
        for name in self.of:
            yield "of", "metric", f"{self.metric} {name}"
            yield "of", "metric", f"{self.bound_metric} se_{name}"

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        for name in self.of:
            yield from unscored(plan, "bound", self.bound, f"{self.bound_metric} se_{name}")
            for i, estimator in enumerate(self.estimators):
                yield from unscored(plan, ("estimators", i), estimator, f"{self.metric} {name}")

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        import pandas as pd

        rows = [
            {**first.unit.labels, "estimator": estimator, **dict(zip(self.of, values, strict=True))}
            for estimator in self.estimators
            for first in results.select(estimator, f"{self.metric} {self.of[0]}")
            for values in [self.efficiencies(results, estimator, first)]
        ]
        data = pd.DataFrame(rows)
        shown = tuple(
            tuple(
                ("-" if np.isnan(value) else f"{value:.3f}")
                if isinstance(value, float) and name in self.of
                else str(value)
                for name, value in zip(data.columns, row, strict=True)
            )
            for row in data.itertuples(index=False)
        )
        error = np.sqrt(2.0 / max(results.plan.trials - 1, 1))
        note = f"Relative standard error of each entry: {error:.3f} ({results.plan.trials} trials)."
        return Table(self.title, tuple(map(str, data.columns)), shown, (note,), data)

    def efficiencies(self, results: Results, estimator: str, case: Series) -> list[float]:
        """The efficiency of every parameter in the case of a series; nan where that has no bound."""
        labels = case.unit.labels
        found = []
        for name in self.of:
            error = next(results.select(estimator, f"{self.metric} {name}", labels))
            bound = next(results.select(self.bound, f"{self.bound_metric} se_{name}", labels), None)
            bounds, errors = np.empty(0) if bound is None else bound.valid, error.valid
            if len(bounds) and len(errors) > 1:
                found += ratios([float(np.mean(bounds**2))], [float(np.var(errors, ddof=1))]).tolist()
            else:
                found.append(float("nan"))
        return found


@component("figure", "parameters")
class ParameterFigure(FigureSpec):
    """One panel for each parameter: mean and standard deviation of every estimator against the truth."""

    metric: str
    """Name of the metric of kind value."""
    of: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names of the values, one panel each."""
    estimators: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names of the estimators."""

    def references(self) -> Iterator[Reference]:
        for i, estimator in enumerate(self.estimators):
            yield ("estimators", i), "estimator", estimator
        for name in self.of:
            yield "of", "metric", f"{self.metric} {name}"

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        for name in self.of:
            for i, estimator in enumerate(self.estimators):
                yield from unscored(plan, ("estimators", i), estimator, f"{self.metric} {name}")

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        theirs = {at: verdict.printed.value for at, verdict in beside(verdicts).items()}
        columns = min(4, len(self.of))
        rows = -(-len(self.of) // columns)
        figure, grid = subplots(rows, columns, squeeze=False, figsize=(2.3 * columns, 2.2 * rows + 0.5))
        for axes in grid.flat[len(self.of) :]:
            axes.set_visible(False)
        for name, axes in zip(self.of, grid.flat, strict=False):
            for i, estimator in enumerate(self.estimators):
                series = _one(results, estimator, f"{self.metric} {name}")
                line = LINES[i % len(LINES)]
                look = {"color": line["color"], "marker": line["marker"], "capsize": 3, "linestyle": "none"}
                axes.errorbar(i, series.value("mean"), series.value("std"), label=estimator, **look)
                if (id(series), "mean") in theirs:
                    printed = (theirs[id(series), "mean"], theirs.get((id(series), "std"), 0.0))
                    look |= {"markerfacecolor": "none", "alpha": 0.75}
                    axes.errorbar(i + 0.3, *printed, label=f"{estimator}, printed", **look)
            unit = _one(results, self.estimators[0], f"{self.metric} {name}").unit
            truth = unit.data.system.truth()
            if name in truth.values:
                axes.axhline(truth.values[name], label="truth", **{**TRUTH, "linewidth": 1.0, "zorder": 0})
            axes.set_title(symbol(name))
            axes.set_xticks([])
            axes.set_xlim(-0.6, len(self.estimators) - 0.1)
            axes.ticklabel_format(axis="y", useOffset=False)
        for axes in grid[:, 0]:
            axes.set_ylabel("mean ± standard deviation")
        handles, labels = grid.flat[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=min(4, len(labels)))
        return figure


@component("figure", "gain")
class Gain(FigureSpec):
    """Ratio of two estimators' standard deviations for each parameter, and the ratio of the printed ones."""

    metric: str
    """Name of the metric of kind value."""
    of: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names of the values."""
    reference: str
    """Name of the estimator in the numerator."""
    estimator: str
    """Name of the estimator in the denominator."""
    y_label: str
    """Label of the ordinate."""

    def references(self) -> Iterator[Reference]:
        yield "reference", "estimator", self.reference
        yield "estimator", "estimator", self.estimator
        for name in self.of:
            yield "of", "metric", f"{self.metric} {name}"

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        for name in self.of:
            yield from unscored(plan, "reference", self.reference, f"{self.metric} {name}")
            yield from unscored(plan, "estimator", self.estimator, f"{self.metric} {name}")

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        figure, axes = subplots(figsize=(4.6, 3.0))
        printed = {at: verdict.printed.value for at, verdict in beside(verdicts).items()}
        pairs = [
            tuple(_one(results, name, f"{self.metric} {value}") for name in (self.reference, self.estimator))
            for value in self.of
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
            look = {**LINES[1], "linestyle": "none", "markerfacecolor": "none", "markersize": 8}
            axes.plot(x, theirs, label="printed", **look)
        axes.axhline(1.0, color="0.4", linewidth=1.0, linestyle=":", label="no gain")
        axes.set_xticks(x, [symbol(value) for value in self.of])
        axes.set_ylabel(self.y_label)
        axes.set_ylim(bottom=0.0)
        axes.legend(loc="lower left")
        return figure


@component("figure", "efficiency")
class EfficiencyFigure(FigureSpec):
    """Efficiency against a numeric axis: one panel for each parameter, one curve for each estimator."""

    x: str
    """The axis along the abscissa."""
    table: str
    """Name of the table of kind efficiency that it draws."""
    of: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names of the parameters, one panel each."""
    x_label: str
    """Label of the abscissa, with its unit."""
    log_y: Flag = True
    """Logarithmic ordinate."""

    def references(self) -> Iterator[Reference]:
        yield "x", "axis", self.x
        yield "table", "table", self.table

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        yield from not_numeric(plan, "x", self.x, positive=False)
        source = plan.experiment.tables[self.table]
        if not isinstance(source, Efficiency):
            yield "table", f"the table '{self.table}' must be of kind efficiency, not {source.kind}"
        elif unknown := [name for name in self.of if name not in source.of]:
            yield "of", f"the table '{self.table}' does not hold {', '.join(unknown)}"

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        source = results.plan.experiment.tables[self.table]
        assert isinstance(source, Efficiency)
        columns = min(4, len(self.of))
        rows = -(-len(self.of) // columns)
        figure, grid = subplots(
            rows, columns, squeeze=False, sharex=True, sharey=True, figsize=(2.3 * columns, 2.3 * rows + 0.5)
        )
        for axes in grid.flat[len(self.of) :]:
            axes.set_visible(False)
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
        for axes in grid[-1]:
            axes.set_xlabel(self.x_label)
        for axes in grid[:, 0]:
            axes.set_ylabel("bound / variance")
        handles, labels = grid.flat[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=min(3, len(labels)))
        return figure
