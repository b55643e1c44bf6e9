"""The table of estimates beside the truth and the printed numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from hident.config.references import CaseLabels, EstimatorName, value_of
from hident.config.spec import Count, component
from hident.config.suggest import counted
from hident.engine.experiment import Plan
from hident.engine.results import Results, Series
from hident.ledger.verdicts import Verdict, beside_trials
from hident.reports.base import Misfit, Table, TableSpec, unscored
from hident.reports.tables.writing import judged, legend


@component("table", "against_truth", source="Brouri, eq. (46)")
class AgainstTruth(TableSpec):
    """One row for each quantity: the truth, the printed number, and mean ± std of each estimator."""

    at_is_own = True

    row_header: str = "quantity"
    """Heading of the first column."""
    rows: Annotated[dict[str, Annotated[str, value_of(), value_of("truth", scores=())]], Field(min_length=1)]
    """Name of the value in each row by its heading, e.g. {"|Gi(jw)|": gain_i_1}."""
    metric: str
    """Name of the metric with the estimates; with a row's value it makes the label, e.g. 'found gain_i_1'."""
    truth: str
    """Name of the metric with the true values, such as one of kind true_response."""
    estimators: Annotated[dict[str, EstimatorName], Field(min_length=1)]
    """Name of the estimator in each column by its heading."""
    at: CaseLabels = {}
    """Labels of axes that choose the case; the first case by default."""
    digits: Annotated[Count, Field(ge=1, le=15)] = 3
    """Significant digits of the truth, and decimals of the estimates."""

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        first = next(iter(self.estimators.values()))
        metrics = plan.experiment.metrics
        if metrics[self.truth].needs_of_estimate():
            kinds = "one of kind true_value or true_response"
            yield ("truth",), f"the metric '{self.truth}' depends on the estimates: the truth is {kinds}"
        if metrics[self.metric].needs_of_truth():
            kinds = "the estimates are one of kind value or response"
            yield ("metric",), f"the metric '{self.metric}' is of the truth, or compares with it: {kinds}"
        for name in self.rows.values():
            yield from unscored(plan, ("truth",), first, f"{self.truth} {name}")

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        first = next(iter(self.estimators.values()))
        shown = {
            (heading, name): next(results.select(estimator, f"{self.metric} {name}", self.at))
            for heading, estimator in self.estimators.items()
            for name in self.rows.values()
        }
        trials = beside_trials(verdicts)
        # One column holds the printed numbers: the first estimator's that has one.
        printed = {
            name: verdict
            for (_, name), series in reversed(shown.items())
            if (verdict := trials.get(id(series))) is not None
        }
        rows = []
        for heading, name in self.rows.items():
            truth = next(results.select(first, f"{self.truth} {name}", self.at)).value("mean")
            row = [heading, f"{truth:.{self.digits + 1}f}"]
            if printed:
                row.append(judged(printed.get(name)))
            rows.append((*row, *(self._ours(shown[column, name]) for column in self.estimators)))
        header = (self.row_header, "truth", *(["printed"] if printed else []), *self.estimators)
        notes = ("Ours: mean ± standard deviation over the trials.", *_missing(shown, results.plan.trials))
        explained = legend(printed.values()) if printed else ()
        statistic = "mean ± standard deviation"
        return Table(self.title, header, tuple(rows), (*notes, *explained), statistic=statistic)

    def _ours(self, series: Series) -> str:
        mean, std = series.value("mean"), series.value("std")
        if not np.isfinite(mean):
            return "-"
        decimals = self.digits + 1
        return f"{mean:.{decimals}f}" + (f" ± {std:.{decimals}f}" if np.isfinite(std) else "")


def _missing(shown: dict[tuple[str, str], Series], trials: int) -> Iterator[str]:
    """In how many trials an estimator did not determine a value, where it is any."""
    for (heading, name), series in shown.items():
        if failed := int(series.statistics["failed"]):
            yield f"{heading}: {name} is not determined in {failed} of {counted(trials, 'trial')}."
