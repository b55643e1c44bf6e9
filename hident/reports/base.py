"""What every table and figure spec answers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hident.config.references import Labels, Metric, NumericAxis, Referring, referring
from hident.config.spec import Component
from hident.config.yaml12 import Location
from hident.engine.results import Results
from hident.ledger.verdicts import Verdict

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from hident.engine.experiment import Plan

Misfit = tuple[Location, str]
"""The path to an entry of a spec, such as ("columns", 0, "estimator"), and why it does not do."""


@dataclass(frozen=True)
class Table:
    """A table as text; ``data`` is written as a CSV of its own where table.csv does not hold it."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    data: pd.DataFrame | None = None

    def markdown(self) -> str:
        """The table in Markdown, its columns aligned."""
        rows = [tuple(cell.replace("|", "\\|") for cell in row) for row in (self.header, *self.rows)]
        widths = [max(len(row[i]) for row in rows) for i in range(len(self.header))]
        left = [all(not _is_number(row[i]) for row in self.rows) for i in range(len(widths))]

        def line(row: Sequence[str]) -> str:
            cells = [
                cell.ljust(width) if to_left else cell.rjust(width)
                for cell, width, to_left in zip(row, widths, left, strict=True)
            ]
            return f"| {' | '.join(cells)} |"

        rule = [
            "-" * width if to_left else "-" * (width - 1) + ":"
            for width, to_left in zip(widths, left, strict=True)
        ]
        body = [line(rows[0]), line(rule), *map(line, rows[1:])]
        return "\n".join([f"## {self.title}", "", *body, *(f"\n{note}" for note in self.notes)])


def _is_number(text: str) -> bool:
    try:
        float(text.split(" ", maxsplit=1)[0])
    except ValueError:
        return text in ("", "-")
    return True


def misfits(plan: Plan, spec: ReportSpec) -> list[Misfit]:
    """What a report cannot show of this plan, though it knows every name."""
    values = list(referring(spec))
    return list(_left_out(plan, values)) or [
        *_mismatched(plan, values),
        *_not_numeric(plan, values),
        *spec.misfits(plan),
    ]


def _left_out(plan: Plan, values: Sequence[Referring]) -> Iterator[Misfit]:
    """The estimators that no case holds at labels that stand beside them."""
    for labels in (value for value in values if isinstance(value.reference, Labels)):
        for estimator in _estimators(values):
            beside = estimator.spec is labels.spec
            if beside and not any(u.name == estimator.value and u.is_at(labels.value) for u in plan.units):
                at = ", ".join(f"{axis} {label}" for axis, label in labels.value.items())
                yield estimator.place, f"the estimator '{estimator.value}' is left out at {at}"


def _mismatched(plan: Plan, values: Sequence[Referring]) -> Iterator[Misfit]:
    """The metrics that are to be shown of an estimator that they do not score."""
    for metric in values:
        if not isinstance(metric.reference, Metric):
            continue
        depth = len(metric.within)
        for estimator in _estimators(values):
            field = estimator.place[depth] if estimator.place[:depth] == metric.within else None
            # Of one metric for several estimators, it is one of these that is wrong.
            several = len(metric.place) == depth + 1 < len(estimator.place)
            for _, _, label in metric.names() if field in metric.reference.scores else ():
                place = (estimator if several else metric).place
                yield from unscored(plan, place, estimator.value, label)


def _estimators(values: Sequence[Referring]) -> list[Referring]:
    return [value for value in values if value.reference.what == "estimator"]


def _not_numeric(plan: Plan, values: Sequence[Referring]) -> Iterator[Misfit]:
    for value in values:
        if isinstance(axis := value.reference, NumericAxis):
            positive = axis.positive
            positive = getattr(value.spec, positive) if isinstance(positive, str) else positive
            for message in not_numeric(plan, value.value, positive=positive, least=axis.least):
                yield value.place, message


def unscored(plan: Plan, place: Location, estimator: str, metric: str) -> Iterator[Misfit]:
    """A misfit if no unit of the estimator is scored by the metric."""
    if not any(unit.name == estimator and metric in unit.metric_labels for unit in plan.units):
        yield place, f"the metric '{metric}' does not score the estimator '{estimator}'"


def not_numeric(plan: Plan, axis: str, *, positive: bool, least: int = 1) -> Iterator[str]:
    """Why the labels of an axis do not do, if they are not numbers, or not positive, or too few."""
    labels = next((a.labels for a in plan.axes if a.name == axis), ())
    try:
        numbers = [float(label) for label in labels]
    except ValueError:
        yield f"the labels of the axis '{axis}' must be numbers, not {', '.join(map(str, labels))}"
        return
    if positive and min(numbers, default=1.0) <= 0.0:
        yield f"the labels of the axis '{axis}' must be positive for a logarithm"
    if len(numbers) < least:
        yield f"the axis '{axis}' needs at least {least} labels"


class ReportSpec(Component):
    """Base of all tables and figures."""

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        """What cannot be shown of this plan beyond what the types of its fields say."""
        yield from ()


class TableSpec(ReportSpec):
    """Base of all tables."""

    title: str
    """Title of the table."""

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        """The table of the results, with the printed numbers beside them where there are any."""
        raise NotImplementedError


class FigureSpec(ReportSpec):
    """Base of all figures."""

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        """The figure; :mod:`hident.reports.style` sets its look."""
        raise NotImplementedError
