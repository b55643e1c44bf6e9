"""A table or a figure over the labels of one axis or two: in rows and columns of panels, or of blocks."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

from pydantic import model_validator

from hident.config.references import AxisName
from hident.config.spec import Spec
from hident.engine.experiment import Label, Plan
from hident.reports.table import Table

if TYPE_CHECKING:
    import pandas as pd


class Facets(Spec):
    """One of 'rows' and 'columns' at least, each an axis of its own."""

    rows: AxisName | None = None
    """The axis that goes down."""
    columns: AxisName | None = None
    """The axis that goes across."""
    names: dict[str, str] = {}
    """Symbols of the axes, e.g. {samples: N}."""

    @model_validator(mode="after")
    def _two_at_most(self) -> Self:
        if self.rows is None and self.columns is None:
            raise ValueError("give 'rows' or 'columns', names of axes, or both")
        if self.rows == self.columns:
            raise ValueError("'rows' and 'columns' must be two axes")
        if strange := [name for name in self.names if name not in (self.rows, self.columns)]:
            raise ValueError(f"'names' holds {', '.join(strange)}, which is neither 'rows' nor 'columns'")
        return self


@dataclass(frozen=True)
class Facet:
    """One panel or block: where it stands, and the labels of its axes."""

    row: int
    column: int
    labels: Mapping[str, Label]


class Grid:
    """The rows and columns of a report; one of each where it has no facets."""

    def __init__(self, facets: Facets | None, plan: Plan) -> None:
        self._names = {} if facets is None else facets.names
        axes = {axis.name: axis.labels for axis in plan.axes}
        self.down, self.across = (None, None) if facets is None else (facets.rows, facets.columns)
        self.rows, self.columns = (
            [()] if axis is None else [((axis, label),) for label in axes.get(axis, ())]
            for axis in (self.down, self.across)
        )

    def __iter__(self) -> Iterator[Facet]:
        every = itertools.product(enumerate(self.rows), enumerate(self.columns))
        return (Facet(i, j, dict((*row, *column))) for (i, row), (j, column) in every)

    def named(self, axis: str) -> str:
        """What the report calls an axis."""
        return self._names.get(axis, axis)

    def titles(self, labels: Sequence[Sequence[tuple[str, Label]]]) -> list[str]:
        """What stands above columns, or beside rows."""
        return [", ".join(f"{self.named(axis)} = {label}" for axis, label in each) for each in labels]


def joined(grid: Grid, tables: Mapping[tuple[int, int], Table]) -> Table:
    """The tables of all rows and columns as one.

    Columns of blocks stand side by side, and what each row is of once before them; rows of blocks stand below
    each other, with their label in a column of its own.
    """
    titles = grid.titles(grid.columns)
    columns: dict[_Numbered, None] = {}
    body: list[tuple[list[str], dict[_Numbered, str]]] = []
    for i, label in enumerate(grid.rows):
        beside: dict[tuple[object, ...], dict[_Numbered, str]] = {}
        for j, title in enumerate(titles):
            if (table := tables.get((i, j))) is not None:
                header = _headings(table, title)
                columns |= dict.fromkeys(header)
                for key, row in zip(
                    _numbered(row[: table.heads] for row in table.rows), table.rows, strict=True
                ):
                    beside.setdefault(key, {}).update(zip(header, row, strict=True))
        body += [([str(value) for _, value in label], row) for row in beside.values()]
    first = next(iter(tables.values()))
    down = [] if grid.down is None else [grid.named(grid.down)]
    heads = [column for column in _headings(first, "") if column in columns][: first.heads]
    order = [*heads, *(column for column in columns if column not in heads)]
    notes = dict.fromkeys(note for table in tables.values() for note in table.notes)
    return replace(
        first,
        header=(*down, *(str(name) for name, _ in order)),
        rows=tuple((*label, *(row.get(column, "") for column in order)) for label, row in body),
        notes=tuple(notes),
        data=_data(grid, tables),
        heads=first.heads + len(down),
    )


_Numbered = tuple[object, int]
"""Something, and how many equal ones stand before it."""


def _numbered(things: Iterable[object]) -> list[_Numbered]:
    seen: Counter[object] = Counter()
    found = []
    for thing in things:
        found.append((thing, seen[thing]))
        seen[thing] += 1
    return found


def _headings(table: Table, title: str) -> list[_Numbered]:
    """The headings of a block, each with the block's title but those of what a row is of."""
    named = (
        name if place < table.heads or not title else f"{name}, {title}"
        for place, name in enumerate(table.header)
    )
    return _numbered(named)


def _data(grid: Grid, tables: Mapping[tuple[int, int], Table]) -> pd.DataFrame | None:
    import pandas as pd

    parts = []
    for facet in grid:
        table = tables.get((facet.row, facet.column))
        if table is None or table.data is None:
            continue
        own = table.data.copy()
        for place, (axis, label) in enumerate(facet.labels.items()):
            own.insert(place, axis, str(label))
        parts.append(own)
    return pd.concat(parts, ignore_index=True) if parts else None
