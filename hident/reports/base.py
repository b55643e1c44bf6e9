"""What every table and figure spec answers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hident.config.spec import Component, Spec
from hident.engine.results import Results
from hident.ledger.verdicts import Verdict

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from hident.engine.experiment import Plan

Place = tuple[str | int, ...]
Field = str | Place
"""A field of a spec, or the path to an entry of it: ("columns", 0, "estimator")."""
Reference = tuple[Field, str, str]
"""The field that refers, what to (estimator, metric, axis, table or 'label of AXIS'), and the name."""
Misfit = tuple[Field, str]
"""A field, and why it does not do."""


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


def label_references(place: Place, at: Mapping[str, Any]) -> Iterator[Reference]:
    """The references of labels by their axes, which stand at the place."""
    for axis, label in at.items():
        yield (*place, axis), "axis", axis
        yield (*place, axis), f"label of {axis}", str(label)


def unscored(plan: Plan, field: Field, estimator: str, metric: str) -> Iterator[Misfit]:
    """A misfit if no unit of the estimator is scored by the metric."""
    if not any(unit.name == estimator and metric in unit.metric_labels for unit in plan.units):
        yield field, f"the metric '{metric}' does not score the estimator '{estimator}'"


def left_out(plan: Plan, spec: Spec, place: Place = ()) -> Iterator[Misfit]:
    """A misfit for each part of a report that names an estimator where no case holds it."""
    at = getattr(spec, "at", {})
    at = at if isinstance(at, Mapping) else {}
    named = {field: getattr(spec, field) for field in ("estimator", "estimators") if hasattr(spec, field)}
    for field, names in named.items():
        several = {"": names} if isinstance(names, str) else names
        for key, name in several.items() if isinstance(several, Mapping) else enumerate(several):
            if not any(unit.name == name and unit.is_at(at) for unit in plan.units):
                labels = ", ".join(f"{axis} {label}" for axis, label in at.items())
                inside = () if isinstance(names, str) else (key,)
                yield (
                    (*place, field, *inside),
                    f"the estimator '{name}' is left out at {labels or 'every label'}",
                )
    for field in type(spec).model_fields:
        value = getattr(spec, field)
        for i, inner in enumerate(value) if isinstance(value, tuple) else (("", value),):
            if isinstance(inner, Spec):
                inside = (i,) if isinstance(value, tuple) else ()
                yield from left_out(plan, inner, (*place, field, *inside))


def not_numeric(plan: Plan, field: Field, axis: str, *, positive: bool, least: int = 1) -> Iterator[Misfit]:
    """A misfit if the labels of the axis are not numbers, or not positive, or too few."""
    labels = next((a.labels for a in plan.axes if a.name == axis), ())
    try:
        numbers = [float(label) for label in labels]
    except ValueError:
        yield field, f"the labels of the axis '{axis}' must be numbers, not {', '.join(map(str, labels))}"
        return
    if positive and min(numbers, default=1.0) <= 0.0:
        yield field, f"the labels of the axis '{axis}' must be positive for a logarithm"
    if len(numbers) < least:
        yield field, f"the axis '{axis}' needs at least {least} labels"


class ReportSpec(Component):
    """Base of all tables and figures."""

    def references(self) -> Iterator[Reference]:
        """The names of the configuration that it refers to."""
        yield from ()

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        """What cannot be shown of this plan, though every name is known."""
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
