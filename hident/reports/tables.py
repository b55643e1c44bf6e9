"""Tables of table.md."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.spec import Count, Flag, Real, Spec, component
from hident.engine.experiment import Label, Plan, Statistic
from hident.engine.results import Results, Series
from hident.ledger.verdicts import Verdict, beside
from hident.reports.base import Misfit, Reference, Table, TableSpec, not_numeric, unscored

SIGNS = {"exact": "=", "agrees": "~", "differs": "!"}
LEGEND = (
    "Beside ours, the printed number: `=` ours rounds to it, `~` it lies in the interval that the trials "
    "give and so is not excluded, `!` it differs."
)
Shown = Literal["mean", "std", "se", "median", "spread", "mean_std"]


def written(value: float, digits: int = 3) -> str:
    """A number with ``digits`` significant digits, and at least its integer part in full."""
    if not math.isfinite(value):
        return "-"
    if value and not 1e-4 <= abs(value) < 10.0 ** max(5, digits):
        return f"{value:.{digits - 1}e}"
    return f"{value:.{_decimals(value, digits)}f}"


def _decimals(value: float, digits: int) -> int:
    """The decimals that show ``digits`` significant digits of a value."""
    rounded = float(f"{value:.{digits - 1}e}")
    return max(0, digits - 1 - math.floor(math.log10(abs(rounded)))) if value else 0


class Column(Spec):
    """One column of a grid."""

    estimator: str
    """Name of the estimator."""
    metric: str
    """Label of the metric."""
    header: str | None = None
    """Heading; the estimator's name by default."""
    statistic: Shown = "mean"
    """What is shown: mean, std, se, median, spread (median and quartiles) or mean_std."""


@component("table", "grid")
class Grid(TableSpec):
    """One row for each label of an axis, one column for each estimator, printed numbers beside ours."""

    rows: str
    """The axis that goes down."""
    row_header: str | None = None
    """Heading of the first column; the axis by default."""
    columns: Annotated[tuple[Column, ...], Field(min_length=1)]
    """What goes across."""
    printed: Flag = True
    """Show the printed numbers beside ours."""
    digits: Annotated[Count, Field(ge=1, le=15)] = 3
    """Significant digits."""

    def references(self) -> Iterator[Reference]:
        yield "rows", "axis", self.rows
        for i, column in enumerate(self.columns):
            yield ("columns", i, "estimator"), "estimator", column.estimator
            yield ("columns", i, "metric"), "metric", column.metric

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        for i, column in enumerate(self.columns):
            yield from unscored(plan, ("columns", i, "metric"), column.estimator, column.metric)

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
                        verdict = printed_at.get((id(found), column.statistic))
                        row.append(f"{verdict.printed.printed} {SIGNS[verdict.word]}" if verdict else "")
                rows.append(tuple(row))
        notes = [LEGEND, *intervals(verdicts)] if any(shown) else []
        shown_ones = (one for c in self.columns for one in results.select(c.estimator, c.metric))
        failed = failures(shown_ones)
        return Table(self.title, tuple(header), tuple(rows), (*notes, *failed))

    def _cell(self, series: Series, statistic: Shown) -> str:
        s = series.statistics
        match statistic:
            case "spread":
                quartiles = f"{written(s['q25'], self.digits)}, {written(s['q75'], self.digits)}"
                return f"{written(s['median'], self.digits)} [{quartiles}]"
            case "mean_std":
                if not math.isfinite(s["std"]):
                    return f"{written(s['mean'], self.digits)} ± -"
                decimals = _decimals(s["std"], self.digits)
                return f"{s['mean']:.{decimals}f} ± {s['std']:.{decimals}f}"
            case _:
                return written(s[statistic], self.digits)


def intervals(verdicts: Sequence[Verdict]) -> list[str]:
    """What the intervals of the verdicts are, for the notes of a table."""
    return [f"Interval: {text}." for text in dict.fromkeys(v.interval for v in verdicts)]


def failures(series: Iterable[Series]) -> Iterator[str]:
    """What failed and why, for the notes of a table; once for all metrics of a unit that failed alike."""
    seen = set()
    for one in series:
        failed, total = one.statistics["failed"], one.statistics["trials"]
        alike = (id(one.unit), failed, one.reasons)
        if failed and alike not in seen:
            seen.add(alike)
            yield (
                f"{failed:.0f} of {total:.0f} trials of {one.unit.described()} failed{_why(one.reasons)} "
                "and are left out of the statistics."
            )


def _why(reasons: Sequence[tuple[str, int]]) -> str:
    if not reasons:
        return ""
    if len(reasons) == 1:
        return f" ({reasons[0][0]})"
    return f" ({'; '.join(f'{count} times: {text}' for text, count in reasons)})"


@component("table", "rate")
class Rate(TableSpec):
    """Slopes of log statistic against log axis, by weighted least squares, with standard errors."""

    axis: str
    """The axis whose labels are numbers, e.g. samples."""
    metric: str
    """Label of the metric."""
    estimators: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names of the estimators."""
    statistic: Statistic = "mean"
    """The statistic whose rate is sought."""
    root: Flag = False
    """Take the square root first, as for the mean of a squared error."""
    expected: Real | None = None
    """The slope that theory gives."""

    def references(self) -> Iterator[Reference]:
        yield "axis", "axis", self.axis
        yield "metric", "metric", self.metric
        for i, estimator in enumerate(self.estimators):
            yield ("estimators", i), "estimator", estimator

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        yield from not_numeric(plan, "axis", self.axis, positive=True, least=2)
        for i, estimator in enumerate(self.estimators):
            yield from unscored(plan, ("estimators", i), estimator, self.metric)

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        import pandas as pd

        groups: dict[tuple[str, tuple[tuple[str, Label], ...]], list[Series]] = {}
        for estimator in self.estimators:
            for series in results.select(estimator, self.metric):
                rest = tuple((a, v) for a, v in series.unit.labels.items() if a != self.axis)
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
        return Table(
            self.title,
            tuple(titles.get(str(name), str(name)) for name in data.columns),
            tuple(
                tuple(v if isinstance(v, str) else written(float(v)) for v in row)
                for row in data.itertuples(index=False)
            ),
            data=data,
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
