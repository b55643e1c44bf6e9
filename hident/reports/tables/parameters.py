"""Tables of named parameters: estimates beside the printed numbers, and efficiencies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.references import EstimatorName, MetricLabel, ValueName, value_of
from hident.config.spec import Count, NonEmpty, component
from hident.config.suggest import counted
from hident.engine.experiment import Plan
from hident.engine.results import Results, Series
from hident.ledger.verdicts import Verdict, beside
from hident.reports.base import Misfit, Table, TableSpec, first_case, unscored
from hident.reports.tables.writing import judged, legend


@component("table", "parameters")
class Parameters(TableSpec):
    """One row for each parameter, one column for each estimator: mean ± std, printed numbers beside.

    Of several cases the first is shown, and said: 'at' chooses another, and 'facets' shows all.
    """

    metric: str
    """Name of the metric of kind value."""
    of: NonEmpty[ValueName]
    """Names of the values, one row each."""
    mean_only: tuple[ValueName, ...] = ()
    """Names of values whose standard deviation the paper does not print, such as a loss."""
    estimators: NonEmpty[EstimatorName]
    """Names of the estimators, one column each."""
    decimals: Annotated[Count, Field(ge=0, le=15)] = 4
    """Decimals."""

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
                series = next(results.select(estimator, f"{self.metric} {name}"))
                row.append(" ± ".join(f"{series.statistics[s]:.{self.decimals}f}" for s in statistics))
                if two:
                    found = [printed[id(series), s] for s in statistics if (id(series), s) in printed]
                    row.append(" ± ".join(map(judged, found)))
            rows.append(tuple(row))
        said = first_case(results.plan, self.estimators)
        notes = (*([f"{said[0].upper()}{said[1:]}."] if said else []), *(legend(verdicts) if printed else ()))
        return Table(self.title, tuple(header), tuple(rows), notes, statistic="mean ± standard deviation")

    def _has_printed(self, results: Results, estimator: str, verdicts: Sequence[Verdict]) -> bool:
        shown = [
            next(results.select(estimator, f"{self.metric} {name}")) for name in (*self.of, *self.mean_only)
        ]
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
    of: NonEmpty[Annotated[str, value_of(), value_of("bound_metric", "se_", scores=("bound",))]]
    """Names of the parameters, one column each."""
    estimators: NonEmpty[EstimatorName]
    """Names of the estimators."""
    bound: EstimatorName
    """Name of the estimator of kind cramer_rao."""
    bound_metric: str
    """Name of the metric of kind value that holds its se_ values."""
    output: MetricLabel | None = None
    """Label of a metric of kind output_mse: a column more, its mean under that of the bound."""

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        if self.output is not None:
            yield from unscored(plan, ("output",), self.bound, f"{self.bound_metric} output_mse")

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        import pandas as pd

        columns = (*self.of, "output") if self.output else self.of
        rows = [
            {**results.varied(first), "estimator": estimator, **dict(zip(columns, values, strict=True))}
            for estimator in self.estimators
            for first in results.select(estimator, f"{self.metric} {self.of[0]}")
            for values in [self.efficiencies(results, estimator, first)]
        ]
        data = pd.DataFrame(rows)
        shown = tuple(
            tuple(
                ("-" if np.isnan(value) else f"{value:.3f}")
                if isinstance(value, float) and name in columns
                else str(value)
                for name, value in zip(data.columns, row, strict=True)
            )
            for row in data.itertuples(index=False)
        )
        error = np.sqrt(2.0 / max(results.plan.trials - 1, 1))
        trials = counted(results.plan.trials, "trial")
        note = f"Relative standard error of each entry: {error:.3f} ({trials})."
        statistic, heads = "squared bound over variance", len(data.columns) - len(columns)
        return Table(self.title, tuple(map(str, data.columns)), shown, (note,), data, statistic, heads)

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
        if self.output is not None:
            error = next(results.select(estimator, self.output, labels))
            bound = next(results.select(self.bound, f"{self.bound_metric} output_mse", labels), None)
            least = np.empty(0) if bound is None else bound.valid
            both = len(least) and len(error.valid)
            found += (
                ratios([float(np.mean(least))], [float(np.mean(error.valid))]).tolist() if both else [np.nan]
            )
        return found
