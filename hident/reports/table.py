"""A table as text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Table:
    """A table as text; ``data`` is written as a CSV of its own where table.csv does not hold it.

    ``statistic`` says in words which statistic over the trials its numbers are, for the caption in a paper.
    The first ``heads`` columns say what each row is of.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    data: pd.DataFrame | None = None
    statistic: str = ""
    heads: int = 1

    def markdown(self) -> str:
        """The table in Markdown, its columns aligned."""
        rows = [tuple(cell.replace("|", "\\|") for cell in row) for row in (self.header, *self.rows)]
        left = [all(not is_number(row[i]) for row in self.rows) for i in range(len(self.header))]
        # The rule of a column of numbers is a dash and a colon at least.
        widths = [max(1 if left[i] else 2, *(len(row[i]) for row in rows)) for i in range(len(left))]

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


def is_number(text: str) -> bool:
    """Whether a cell begins with a number, or is empty."""
    try:
        float(text.split(" ", maxsplit=1)[0])
    except ValueError:
        return text in ("", "-")
    return True
