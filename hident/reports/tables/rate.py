"""The table of rates of convergence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from hident.arrays import Array
from hident.config.references import EstimatorName, MetricLabel, NumericAxis
from hident.config.spec import Flag, NonEmpty, Real, component
from hident.engine.experiment import Label, Statistic
from hident.engine.results import Results, Series
from hident.ledger.verdicts import Verdict
from hident.reports.base import Table, TableSpec
from hident.reports.tables.writing import written

_SHARED = "The cases share random numbers, and the standard errors take them as independent."


@component("table", "rate")
class Rate(TableSpec):
    """Slopes of log statistic against log axis, by weighted least squares, with standard errors."""

    axis: Annotated[str, NumericAxis(positive=True, least=2)]
    """The axis whose labels are numbers, e.g. samples."""
    metric: MetricLabel
    """Label of the metric."""
    estimators: NonEmpty[EstimatorName]
    """Names of the estimators."""
    statistic: Statistic = "mean"
    """The statistic whose rate is sought."""
    root: Flag = False
    """Take the square root first, as for the mean of a squared error."""
    expected: Real | None = None
    """The slope that theory gives."""

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        import pandas as pd

        groups: dict[tuple[str, tuple[tuple[str, Label], ...]], list[Series]] = {}
        for estimator in self.estimators:
            for series in results.select(estimator, self.metric):
                rest = tuple((a, v) for a, v in results.varied(series).items() if a != self.axis)
                groups.setdefault((estimator, rest), []).append(series)
        rows = []
        for (estimator, rest), group in groups.items():
            slope, error = self.slope(group)
            rows.append({"estimator": estimator, **dict(rest), "slope": slope, "standard_error": error})
        data = pd.DataFrame(rows)
        if self.expected is not None:
            data["expected"] = self.expected
            data["deviation"] = (data["slope"] - self.expected) / data["standard_error"]
        titles = {"standard_error": "standard error", "deviation": "deviation / standard error"}
        shared = any(one.unit.data.streams.share for group in groups.values() for one in group)
        return Table(
            self.title,
            tuple(titles.get(str(name), str(name)) for name in data.columns),
            tuple(
                tuple(v if isinstance(v, str) else written(float(v)) for v in row)
                for row in data.itertuples(index=False)
            ),
            notes=(_SHARED,) if shared else (),
            data=data,
            statistic=f"slope of the logarithm of the {self.statistic} ± its standard error",
            heads=list(data.columns).index("slope"),
        )

    def slope(self, group: Sequence[Series]) -> tuple[float, float]:
        """Weighted least-squares slope and its standard error, scaled up if the fit is worse than noise.

        Points without a logarithm or a standard error do not count; nan if fewer than two are left.
        """
        x = np.array([float(series.unit.labels[self.axis]) for series in group])
        value = np.array([series.value(self.statistic) for series in group])
        error = np.array([series.standard_error(self.statistic) for series in group])
        usable = np.isfinite(value) & (value > 0.0) & np.isfinite(error) & (error > 0.0)
        if len(np.unique(x[usable])) < 2:
            return float("nan"), float("nan")
        return self._slope(np.log(x[usable]), value[usable], error[usable])

    def _slope(self, x: Array, value: Array, error: Array) -> tuple[float, float]:
        """The slope of log ``value`` (K,) by ``x`` (K,) and its standard error, all values positive."""
        power = 0.5 if self.root else 1.0
        relative = power * error / value
        z = power * np.log(value)
        weight = relative**-2.0
        centred = x - np.average(x, weights=weight)
        information = float(weight @ centred**2)
        slope = float(weight @ (centred * z)) / information
        residual = z - np.average(z, weights=weight) - slope * centred
        freedom = len(x) - 2
        scatter = float(weight @ residual**2) / freedom if freedom > 0 else 1.0
        return slope, float(np.sqrt(max(1.0, scatter) / information))
