"""Tables of the distribution of single trials, beside the one realisation that a paper prints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from hident.arrays import Array
from hident.config.references import CaseLabels, EstimatorName, Metric
from hident.config.spec import Count, NonEmpty, Spec, component
from hident.config.suggest import counted, did_you_mean, one_of
from hident.engine.experiment import Plan
from hident.engine.results import Results, Series
from hident.ledger.verdicts import Verdict, beside_trials
from hident.reports.base import Misfit, Table, TableSpec
from hident.reports.tables.writing import judged, legend, written

if TYPE_CHECKING:
    import pandas as pd

_OURS = "Ours: median [5 %, 95 %] of single trials."
_PERCENTILE = "pK: K % of our trials lie below the printed number."
_STATISTICS = ("trials", "failed", "median", "q05", "q95")


class Group(Spec):
    """One row of the paper: a case, or a stage of it."""

    label: str
    """Text of the row."""
    estimator: EstimatorName
    """Name of the estimator."""
    at: CaseLabels = {}
    """Labels of axes that choose the case; the first case by default."""
    metric: str
    """Name of the metric; with a column's value it makes the label, e.g. 'theta a_1'."""
    metrics: dict[str, str] = {}
    """Labels of metrics by heading, for columns that another metric fills."""
    without: tuple[str, ...] = ()
    """Headings whose cells stay empty, as for a parameter that the structure does not have."""


@dataclass(frozen=True, eq=False)
class _Cell:
    row: Group
    heading: str
    series: Series
    verdict: Verdict | None

    @property
    def percentile(self) -> float:
        """The share of trials below the printed number, in percent; nan if there is none."""
        return percentile(self.series.valid, self.verdict.printed.value) if self.verdict else float("nan")


def percentile(values: Array, printed: float) -> float:
    """Percent of the values (K,) below a number, those equal to it counting half."""
    if not len(values):
        return float("nan")
    return 100.0 * float(np.mean(values < printed) + 0.5 * np.mean(values == printed))


def _metrics(table: Distribution, row: Group) -> dict[str, str]:
    """The label of the metric in each column that the row fills."""
    return {
        heading: row.metrics.get(heading, f"{row.metric} {name}")
        for heading, name in table.columns.items()
        if heading not in row.without
    }


# Whether they score the row's estimator is for the table to say, with its remedy.
_LABELS = Metric(labels=lambda table, row: _metrics(table, row).values(), scores=())


@component("table", "distribution")
class Distribution(TableSpec):
    """One row for each printed row: median and 5 to 95 % of single trials, below them what is printed."""

    row_header: str = "case"
    """Heading of the first column."""
    rows: NonEmpty[Annotated[Group, _LABELS]]
    """The rows."""
    columns: Annotated[dict[str, str], Field(min_length=1)]
    """Name of the value in each column by its heading, e.g. {a3: a_3}."""
    digits: Annotated[Count, Field(ge=1, le=15)] = 3
    """Significant digits."""

    @model_validator(mode="after")
    def _known_headings(self) -> Self:
        for row in self.rows:
            for heading in (*row.metrics, *row.without):
                if heading not in self.columns:
                    near = did_you_mean(heading, self.columns)
                    known = one_of(self.columns)
                    raise ValueError(
                        f"the row '{row.label}' names the column '{heading}', which there is not{near} "
                        f"(there are: {known})"
                    )
        return self

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        for i, row in enumerate(self.rows):
            scored = {
                label
                for unit in plan.units
                if unit.name == row.estimator and unit.is_at(row.at)
                for label in unit.metric_labels
            }
            for heading, metric in _metrics(self, row).items():
                if metric not in scored:
                    yield (
                        ("rows", i),
                        f"the metric '{metric}' does not score the estimator '{row.estimator}'; "
                        f"'without: [{heading}]' leaves the cell empty",
                    )

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        printed = beside_trials(verdicts)
        cells = [cell for row in self.rows for cell in self._cells(results, row, printed)]
        rows: list[tuple[str, ...]] = []
        failed: list[str] = []
        for row in self.rows:
            own = {cell.heading: cell for cell in cells if cell.row is row}
            rows.append((row.label, *(self._ours(own.get(heading)) for heading in self.columns)))
            if any(cell.verdict for cell in own.values()):
                rows.append(("printed", *(_printed(own.get(heading)) for heading in self.columns)))
            failed += [f"{row.label}: {said}" for said in _failures([*own.values()])]
        ours = () if results.plan.trials == 1 else (_OURS,)
        explained = (*ours, _PERCENTILE, *legend(verdicts)) if verdicts else ours
        header = (self.row_header, *self.columns)
        statistic = "median [5 %, 95 %] of single trials" if ours else "one trial"
        notes = (*explained, *failed)
        return Table(self.title, header, tuple(rows), notes, _data(results, cells), statistic)

    def _cells(self, results: Results, row: Group, printed: Mapping[int, Verdict]) -> Iterator[_Cell]:
        for heading, metric in _metrics(self, row).items():
            series = next(results.select(row.estimator, metric, row.at))
            yield _Cell(row, heading, series, printed.get(id(series)))

    def _ours(self, cell: _Cell | None) -> str:
        if cell is None:
            return ""
        median, low, high = (
            written(cell.series.statistics[name], self.digits) for name in ("median", "q05", "q95")
        )
        # A single trial has no spread.
        return median if len(cell.series.values) == 1 else f"{median} [{low}, {high}]"


def _printed(cell: _Cell | None) -> str:
    if cell is None or cell.verdict is None:
        return ""
    return f"{judged(cell.verdict)} p{cell.percentile:.0f}"


def _failures(cells: Sequence[_Cell]) -> Iterator[str]:
    """How many trials failed in the cells of a row, and in which columns if not in all alike."""
    counts: dict[int, list[str]] = {}
    for cell in cells:
        counts.setdefault(int(cell.series.statistics["failed"]), []).append(cell.heading)
    for failed, headings in counts.items():
        where, there = (f" in {one_of(headings)}", " there") if len(counts) > 1 else ("", "")
        if failed:
            trials = counted(len(cells[0].series.values), "trial")
            yield f"{failed} of {trials} failed{where} and are left out{there}."


def _data(results: Results, cells: Sequence[_Cell]) -> pd.DataFrame:
    """One line for each cell that is filled."""
    import pandas as pd

    axes = [axis.name for axis in results.plan.axes]
    return pd.DataFrame(
        [
            {
                "row": cell.row.label,
                "column": cell.heading,
                **{axis: cell.series.unit.labels.get(axis, "") for axis in axes},
                "estimator": cell.row.estimator,
                "metric": cell.series.metric,
                **{name: cell.series.statistics[name] for name in _STATISTICS},
                "printed": cell.verdict.printed.printed if cell.verdict else "",
                "verdict": cell.verdict.word if cell.verdict else "",
                "percentile": cell.percentile,
            }
            for cell in cells
        ]
    )
