"""How often an estimator comes as low as another one, such as a search from the truth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from hident.config.references import EstimatorName, MetricLabel
from hident.config.spec import NonEmpty, Real, component
from hident.config.suggest import counted
from hident.engine.results import Results, Series
from hident.ledger.verdicts import Verdict
from hident.reports.base import Table, TableSpec


@component("table", "attained")
class Attained(TableSpec):
    """Percentage of the trials in which a metric is at most another estimator's, up to a small part.

    One row for each case, one column for each estimator. A failed trial has not attained it; one in which
    the reference fails is left out.
    """

    metric: MetricLabel
    """Label of the metric, of which less is better."""
    reference: EstimatorName
    """Name of the estimator that sets the mark."""
    estimators: NonEmpty[EstimatorName]
    """Names of the estimators, one column each."""
    within: Annotated[Real, Field(ge=0)] = 0.01
    """The part of the mark by which it may be missed."""

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        import pandas as pd

        rows = []
        for mark in results.select(self.reference, self.metric):
            row: dict[str, object] = {**results.varied(mark)}
            for name in self.estimators:
                found = next(results.select(name, self.metric, mark.unit.labels), None)
                row[name] = np.nan if found is None else self.share(found, mark)
            rows.append(row)
        data = pd.DataFrame(rows)
        heads = len(data.columns) - len(self.estimators)
        shown = tuple(
            (
                *map(str, row[:heads]),
                *("-" if np.isnan(value) else f"{value:.4g}" for value in row[heads:]),
            )
            for row in data.itertuples(index=False)
        )
        note = (
            f"Percentage of {counted(results.plan.trials, 'trial')} in which {self.metric} is at most "
            f"{1.0 + self.within:g} times that of {self.reference}."
        )
        header = tuple(map(str, data.columns))
        return Table(self.title, header, shown, (note,), data, "percentage of the trials", heads)

    def share(self, found: Series, mark: Series) -> float:
        """The percentage of one series; nan where the mark fails in all trials."""
        marked = np.isfinite(mark.values)
        if not np.any(marked):
            return float("nan")
        # A comparison with nan, a failed trial, is false.
        attained = found.values[marked] <= (1.0 + self.within) * mark.values[marked]
        return 100.0 * float(np.mean(attained))
