"""table.md read again: the inverse of what :mod:`hident.reports.output` writes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from hident.reports.table import Table

_CELLS = re.compile(r"(?<!\\)\|")
# With these begins what is said of the whole run, below the last table.
_OF_ALL = re.compile(r"\d+ of \d+ means hang on a single trial each|Printed numbers: \d+, of which ")


@dataclass(frozen=True)
class Page:
    """What table.md says, as text: what stands above the tables, these with their notes, and what below."""

    title: str
    above: tuple[str, ...]
    tables: tuple[Table, ...]
    below: tuple[str, ...]

    @classmethod
    def read(cls, text: str) -> Page:
        """The page of a text; what is no table is a paragraph.

        Examples
        --------
        >>> table = Table("Gains", ("w", "|G|"), (("1", "0.7 ~"),), notes=("Mean.",))
        >>> page = Page.read("# Title\\n\\n3 trials.\\n\\n" + table.markdown() + "\\n")
        >>> page.title, page.above, page.tables == (table,)
        ('Title', ('3 trials.',), True)
        """
        head, *sections = re.split(r"(?m)^## ", text)
        title, *above = _paragraphs(head)
        found, below = [], []
        for section in sections:
            name, *rest = _paragraphs(section)
            if not rest or not rest[0].startswith("|"):
                rest = ["| |", *rest]
            lines, *notes = rest
            end = next((i for i, note in enumerate(notes) if _OF_ALL.match(note)), len(notes))
            below = notes[end:]
            header, _, *rows = [*map(_cells, lines.splitlines()), ()]
            found.append(Table(name, header, tuple(filter(None, rows)), tuple(notes[:end])))
        return cls(title.removeprefix("# "), tuple(above), tuple(found), tuple(below))


def _paragraphs(text: str) -> list[str]:
    return [part.strip("\n") for part in re.split(r"\n\s*\n", text) if part.strip()] or [""]


def _cells(line: str) -> tuple[str, ...]:
    return tuple(_unescaped(_CELLS.split(line)[1:-1]))


def _unescaped(cells: Sequence[str]) -> Iterator[str]:
    for cell in cells:
        yield cell.strip().replace("\\|", "|")
