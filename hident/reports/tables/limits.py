"""How far a method goes: the largest label of an axis up to which a metric stays below a limit."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hident.config.references import CaseLabels, EstimatorName, MetricLabel, NumericAxis
from hident.config.spec import NonEmpty, Real, component
from hident.engine.experiment import Plan
from hident.engine.results import Results, Series
from hident.ledger.verdicts import Verdict
from hident.reports.base import Misfit, Table, TableSpec


@dataclass(frozen=True)
class Reach:
    """How far one estimator goes at one label: nan if nowhere, ``open`` if to the last label tried."""

    estimator: str
    x: float
    limit: float
    open: bool

    @property
    def text(self) -> str:
        """The limit in words."""
        if not np.isfinite(self.limit):
            return "none"
        return f">= {self.limit:g}" if self.open else f"{self.limit:g}"


@component("table", "limit", source="Chen, Hwang, Chang 2009, figure 9b")
class Limit(TableSpec):
    """For each label of one axis, the largest label of another up to which a metric stays below a limit.

    The median over the trials must stay below it there and at all smaller labels. Failed trials count as
    infinite, so that a method cannot gain by failing.
    """

    at_is_own = True

    x: Annotated[str, NumericAxis()]
    """The axis that goes down; its labels are numbers."""
    along: Annotated[str, NumericAxis()]
    """The axis whose largest label is sought; its labels are numbers."""
    metric: MetricLabel
    """Label of the metric."""
    below: Real
    """The limit of the metric's median."""
    estimators: NonEmpty[EstimatorName]
    """Names of the estimators, one column each."""
    at: CaseLabels = {}
    """Labels of the other axes; the first ones by default."""

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        labels = {axis.name: axis.labels for axis in plan.axes}
        for i, estimator in enumerate(self.estimators):
            # No limit reaches beyond a case in which the estimator is left out.
            for x, far in itertools.product(labels[self.x], labels[self.along]):
                at = {**self.at, self.x: x, self.along: far}
                if not any(unit.name == estimator and unit.is_at(at) for unit in plan.units):
                    message = f"the estimator '{estimator}' is left out at {self.x} {x}, {self.along} {far}"
                    yield ("estimators", i), message

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        import pandas as pd

        found = {name: self.reaches(results, name) for name in self.estimators}
        rows = tuple(
            (f"{x:g}", *(reaches[i].text for reaches in found.values()))
            for i, x in enumerate(sorted(map(float, results.labels(self.x))))
        )
        data = pd.DataFrame(
            [(r.estimator, r.x, r.limit, r.open) for reaches in found.values() for r in reaches],
            columns=["estimator", self.x, self.along, "open"],
        )
        notes = (
            f"Largest {self.along} up to which the median of {self.metric} stays below {self.below:g}; "
            "failed trials count as infinite; >= where it does so at every label tried.",
        )
        return Table(self.title, (self.x, *self.estimators), rows, notes, data, "by medians")

    def reaches(self, results: Results, estimator: str) -> list[Reach]:
        """How far an estimator goes at every label of ``x``, in increasing order."""
        along = sorted(results.labels(self.along), key=float)
        found = []
        for label in sorted(results.labels(self.x), key=float):
            medians = [
                _median(next(results.select(estimator, self.metric, {**at, self.along: far})))
                for at in [{**self.at, self.x: label}]
                for far in along
            ]
            fails = [i for i, median in enumerate(medians) if not median < self.below]
            last = (fails[0] if fails else len(along)) - 1
            limit = float(along[last]) if last >= 0 else float("nan")
            found.append(Reach(estimator, float(label), limit, not fails))
        return found


def _median(series: Series) -> float:
    """The median over all trials, a failed one being infinite."""
    return float(np.median(np.where(np.isfinite(series.values), series.values, np.inf)))
