"""Tables on pages, no longer than a page bears: printed numbers as the paper has them, CSVs, table.md."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hident.ledger.judged import as_number
from hident.reports.site.numbers import Number
from hident.reports.table import Table, is_number
from hident.reports.tables.writing import LEGEND, SIGNS, written

MOST_CELLS = 1000
"""Cells of one table that a page shows; the file has them all."""
_ON_A_PAGE = 1600
"""Cells of all tables of table.md together."""
_FEWEST_ROWS = 5
MOST_NUMBERS = 90
"""Printed numbers of a run that a page shows; verdicts.csv has all."""
_VERDICTS = {sign: verdict for verdict, sign in SIGNS.items()}
_JUDGED = re.compile(r"([<>]?[-+.\deE]+) ([=~?!])((?: p\d+)?)")


_TIMING = {
    "fits": "fits",
    "median": "median (ms)",
    "q25": "lower quartile (ms)",
    "q75": "upper quartile (ms)",
    "relative": "of the fastest",
    "batched": "in batches",
}
"""The columns of timing.csv for readers; those before are the case and the estimator."""
Labelled = tuple[str, Number]
"""A number, and what tells it from the others of its cell; empty where it stands alone."""


@dataclass(frozen=True)
class Grid:
    """Printed numbers by row and quantity; each cell holds those of one row and quantity, mostly one."""

    table: str
    corner: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[tuple[Labelled, ...], ...]], ...]
    intervals: tuple[str, ...]
    """How the intervals of its numbers come about."""


def grids(numbers: Sequence[Number]) -> list[Grid]:
    """A grid for each table of the paper; where most cells would be empty, all of a row stand in one."""
    found: dict[str, list[Number]] = {}
    for one in numbers:
        found.setdefault(one.judged.printed.table, []).append(one)
    return [_grid(table, there) for table, there in found.items()]


def _grid(table: str, numbers: Sequence[Number]) -> Grid:
    cells: dict[tuple[str, str], list[Number]] = {}
    for one in numbers:
        cells.setdefault((one.row, one.judged.printed.quantity), []).append(one)
    rows = list(dict.fromkeys(row for row, _ in cells))
    columns = list(dict.fromkeys(quantity for _, quantity in cells))
    intervals = tuple(dict.fromkeys(one.judged.interval for one in numbers))
    if 2 * len(cells) < len(rows) * len(columns):
        lines = {row: [one for (of, _), there in cells.items() if of == row for one in there] for row in rows}
        body = (
            (row, (tuple((one.judged.printed.quantity, one) for one in line),)) for row, line in lines.items()
        )
        return Grid(table, "row", ("printed and ours",), tuple(body), intervals)

    def at(row: str, quantity: str) -> tuple[Labelled, ...]:
        there = cells.get((row, quantity), [])
        return tuple(("", one) for one in there)

    if len(columns) > max(8, len(rows)):
        turned = ((column, tuple(at(row, column) for row in rows)) for column in columns)
        return Grid(table, "quantity", tuple(rows), tuple(turned), intervals)
    straight = ((row, tuple(at(row, column) for column in columns)) for row in rows)
    return Grid(table, "row", tuple(columns), tuple(straight), intervals)


@dataclass(frozen=True)
class Cell:
    """A cell of a table: its text, and the verdict and the remark behind a printed number."""

    text: str
    verdict: str = ""
    remark: str = ""


@dataclass(frozen=True)
class Shown:
    """The rows of a table that a page shows."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    left_out: int
    """How many rows more the file has."""
    numeric: tuple[bool, ...]
    """Of each column, whether it holds numbers."""
    notes: tuple[str, ...] = ()


def shown(table: Table, most: int = MOST_CELLS) -> Shown:
    """What a page shows of a table."""
    width = len(table.header)
    # A file that was damaged may have rows of other lengths.
    rows = [(*row[:width], *[""] * (width - len(row))) for row in table.rows[: max(most // max(width, 1), 1)]]
    return Shown(
        table.title,
        table.header,
        tuple(tuple(map(_cell, row)) for row in rows),
        len(table.rows) - len(rows),
        tuple(all(is_number(row[i]) for row in rows) for i in range(width)),
        tuple(note for note in table.notes if not note.startswith(LEGEND)),
    )


def all_shown(tables: Sequence[Table]) -> list[Shown]:
    """What a page shows of all tables of a run."""
    found, left = [], _ON_A_PAGE
    for table in tables:
        found.append(shown(table, max(min(MOST_CELLS, left), _FEWEST_ROWS * len(table.header))))
        left -= len(found[-1].rows) * len(table.header)
    return found


def timing(file: Path) -> Shown | None:
    """The first rows of timing.csv in milliseconds; None if it cannot be read."""
    try:
        with file.open(newline="", encoding="utf-8") as lines:
            header, *rows = csv.reader(lines)
    except (OSError, ValueError, csv.Error):
        return None
    named = tuple(_TIMING.get(name, name) for name in header)
    body = (tuple(map(_timed, header, row)) for row in rows)
    return shown(Table("", named, tuple(body)), MOST_CELLS // 2)


def _timed(column: str, cell: str) -> str:
    """A cell of timing.csv for readers."""
    if column == "batched":
        return "yes" if cell == "True" else "no"
    if column not in _TIMING or column == "fits":
        return cell
    value = as_number(cell)
    return "" if math.isnan(value) else written(value if column == "relative" else 1000.0 * value)


def _cell(text: str) -> Cell:
    found = _JUDGED.fullmatch(text)
    return Cell(found[1], _VERDICTS[found[2]], found[3]) if found else Cell(text)


_FOLDERS = re.compile(r"(?<!\S)(?:\.\.?/|/)[^\s:,]*/")


def without_folders(text: str) -> str:
    """What is said of files, by their names alone: their folders are those of one machine."""
    return _FOLDERS.sub("", text)
