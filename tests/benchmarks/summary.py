"""All figures of a run of the benchmarks in one table, results/bench.md, beside those of the last run."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path

from hident import arithmetic
from hident.engine.cores import usable_cores
from hident.engine.run_files import BENCHMARKS
from tests.benchmarks.timing import Figure, show

_HEADER = ("figure", "median", "least", "greatest", "aim", "before", "moved")
_PAGE = """\
# Benchmarks

What `make bench` measured last: times relative to other times of the same run, seconds of commands, trials
per second, memory. A figure has moved where neither run's median lies within the other's least and greatest.

{machine}

{table}
"""


def finish(figures: Iterable[Figure], folder: Path) -> None:
    """Print all figures, and write them where the next run finds them; what was not measured now stays."""
    file = folder / BENCHMARKS
    before = read(file.read_text(encoding="utf-8")) if file.exists() else {}
    rows = [cells(one, before.get(one.what)) for one in figures]
    show("All figures", _HEADER, rows, ())
    measured = {row[0] for row in rows}
    rows += [cells(one, None) for what, one in before.items() if what not in measured]
    file.write_text(_PAGE.format(machine=machine(), table=table(rows)), encoding="utf-8", newline="\n")
    print(f"\nwrote {file}")


def cells(one: Figure, before: Figure | None) -> list[str]:
    """The row of a figure."""
    numbers = [f"{number:.3g}" for number in (one.value, one.low, one.high)]
    was = "" if before is None else f"{before.value:.3g}"
    return [one.what, *numbers, one.aim, was, "moved" if before is not None and moved(one, before) else ""]


def moved(one: Figure, other: Figure) -> bool:
    """Whether neither median lies within the spread of the other."""
    return not (one.low <= other.value <= one.high or other.low <= one.value <= other.high)


def table(rows: Iterable[list[str]]) -> str:
    """The table in Markdown."""
    lines = [_HEADER, ["---"] * len(_HEADER), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def read(page: str) -> Mapping[str, Figure]:
    """The figures of a page, by what they are."""
    rows = [
        [cell.strip() for cell in line[1:-1].split("|")] for line in page.splitlines() if line[:2] == "| "
    ]
    rows = [row for row in rows if len(row) == len(_HEADER) and row[0] not in (_HEADER[0], "---")]
    return {
        what: Figure(what, float(value), float(low), float(high), aim)
        for what, value, low, high, aim, *_ in rows
    }


def machine() -> str:
    """On what they were measured."""
    cpu = platform.processor() or platform.machine()
    load = " ".join(f"{one:.1f}" for one in os.getloadavg())
    return (
        f"{datetime.now(UTC):%Y-%m-%d}, {usable_cores()} usable cores ({cpu}, {platform.system()}), "
        f"Python {platform.python_version()}, load at the end {load}. Arithmetic: {arithmetic.identity()}."
    )
