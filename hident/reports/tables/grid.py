"""The table of an axis against estimators."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from hident.config.references import AxisName, EstimatorName, MetricLabel
from hident.config.spec import Count, Flag, NonEmpty, Spec, component
from hident.engine.results import Results, Series
from hident.ledger.verdicts import Verdict, beside
from hident.reports.base import Table, TableSpec
from hident.reports.tables.writing import decimals_of, failures, judged, legend, written

Quantity = Literal["mean", "std", "se", "median", "spread", "mean_std"]


_WORDS: dict[Quantity, str] = {
    "mean": "mean",
    "std": "standard deviation",
    "se": "standard error of the mean",
    "median": "median",
    "spread": "median [quartiles]",
    "mean_std": "mean ± standard deviation",
}


def _one_axis(rows: Any) -> Any:
    if isinstance(rows, list):
        raise ValueError(
            "must be one axis: the labels of others that vary join its cells, and 'facets: {rows: AXIS}' "
            "gives one a column of its own"
        )
    return rows


class Column(Spec):
    """One column of a grid."""

    estimator: EstimatorName
    """Name of the estimator."""
    metric: MetricLabel
    """Label of the metric."""
    header: str | None = None
    """Heading; the estimator's name by default."""
    statistic: Quantity = "mean"
    """What is shown: mean, std, se, median, spread (median and quartiles) or mean_std."""


@component("table", "grid")
class Grid(TableSpec):
    """One row for each label of an axis, one column for each estimator, printed numbers beside ours."""

    rows: Annotated[AxisName, BeforeValidator(_one_axis)]
    """The axis that goes down."""
    row_header: str | None = None
    """Heading of the first column; the axis by default."""
    columns: NonEmpty[Column]
    """What goes across."""
    printed: Flag = True
    """Show the printed numbers beside ours."""
    digits: Annotated[Count, Field(ge=1, le=15)] = 3
    """Significant digits."""

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        printed_at = beside(verdicts)
        pairs = {(column.estimator, column.metric) for column in self.columns}
        touching = {axis for pair in pairs for one in results.select(*pair) for axis in one.unit.labels}
        others = [a for a in results.plan.axes if a.name in touching and a.name != self.rows]
        header = [", ".join([self.row_header or self.rows, *(axis.name for axis in others)])]
        shown: list[bool] = []
        for column in self.columns:
            header.append(column.header or column.estimator)
            series = results.select(column.estimator, column.metric)
            shown.append(self.printed and any((id(one), column.statistic) in printed_at for one in series))
            header += ["printed"] * shown[-1]
        rows = []
        for label in results.labels(self.rows):
            for rest in itertools.product(*(axis.labels for axis in others)):
                labels = {
                    self.rows: label,
                    **{a.name: v for a, v in zip(others, rest, strict=True)},
                }
                row = [", ".join(map(str, (label, *rest)))]
                for column, printed in zip(self.columns, shown, strict=True):
                    found = next(results.select(column.estimator, column.metric, labels), None)
                    row.append("-" if found is None else self._cell(found, column.statistic))
                    if printed:
                        row.append(judged(printed_at.get((id(found), column.statistic))))
                rows.append(tuple(row))
        notes = legend(verdicts) if any(shown) else []
        shown_ones = (one for c in self.columns for one in results.select(c.estimator, c.metric))
        failed = failures(shown_ones)
        return Table(self.title, tuple(header), tuple(rows), (*notes, *failed), statistic=self._statistic())

    def _statistic(self) -> str:
        """The statistics of the columns in words, by their headings where they are not all the same."""
        words = {column.header or column.estimator: _WORDS[column.statistic] for column in self.columns}
        if len(set(words.values())) == 1:
            return next(iter(words.values()))
        return "; ".join(f"{heading}: {word}" for heading, word in words.items())

    def _cell(self, series: Series, statistic: Quantity) -> str:
        s = series.statistics
        match statistic:
            case "spread":
                quartiles = f"{written(s['q25'], self.digits)}, {written(s['q75'], self.digits)}"
                return f"{written(s['median'], self.digits)} [{quartiles}]"
            case "mean_std":
                if not math.isfinite(s["std"]):
                    return f"{written(s['mean'], self.digits)} ± -"
                decimals = decimals_of(s["std"], self.digits)
                return f"{s['mean']:.{decimals}f} ± {s['std']:.{decimals}f}"
            case _:
                return written(s[statistic], self.digits)
