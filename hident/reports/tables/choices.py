"""How often each outcome of a choice comes out, such as a structure (n, m) that a search chooses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from hident.config.references import EstimatorName, MetricLabel
from hident.config.spec import NonEmpty, component
from hident.config.suggest import counted
from hident.engine.results import Results, Series
from hident.ledger.verdicts import Verdict
from hident.reports.base import Table, TableSpec

Outcome = tuple[float, ...] | None
"""The values that come out together; None for a failed trial."""


@component("table", "choices")
class Choices(TableSpec):
    """One row for each estimator and case, one column for each outcome: its percentage of the trials."""

    of: NonEmpty[MetricLabel]
    """Labels of the metrics whose values make an outcome, e.g. [structure n, structure m]."""
    estimators: NonEmpty[EstimatorName]
    """Names of the estimators."""

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        import pandas as pd

        cases = [case for name in self.estimators for case in results.select(name, self.of[0])]
        counts = [self.counts(results, case) for case in cases]
        total = sum(counts, Counter[Outcome]())
        # The most frequent first, failures last.
        columns = sorted(total, key=lambda one: (one is None, -total[one], one or ()))
        shares = [[100.0 * count[one] / results.plan.trials for one in columns] for count in counts]
        axes = [axis.name for axis in results.plan.axes if any(axis.name in c.unit.labels for c in cases)]
        heads = [[str(case.unit.labels.get(axis, "")) for axis in axes] + [case.unit.name] for case in cases]
        header = (*axes, "estimator", *map(_heading, columns))
        rows = [(*head, *(f"{share:.3g}" for share in row)) for head, row in zip(heads, shares, strict=True)]
        data = pd.DataFrame(
            [(*head, *row) for head, row in zip(heads, shares, strict=True)], columns=list(header)
        )
        notes = (f"Percent of {counted(results.plan.trials, 'trial')}.",)
        return Table(self.title, header, tuple(rows), notes, data, "percent of the trials", len(axes) + 1)

    def counts(self, results: Results, case: Series) -> Counter[Outcome]:
        """How many trials of the estimator and the case of a series have each outcome."""
        series = [next(results.select(case.unit.name, metric, case.unit.labels)) for metric in self.of]
        outcomes = np.stack([one.values for one in series], axis=-1)
        return Counter(tuple(row) if np.all(np.isfinite(row)) else None for row in outcomes.tolist())


def _heading(outcome: Outcome) -> str:
    if outcome is None:
        return "failed"
    values = ", ".join(f"{value:g}" for value in outcome)
    return f"({values})" if len(outcome) > 1 else values
