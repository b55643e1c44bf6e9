"""The front page: what was reproduced and how sure that is, comparisons, records; the list of runs."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from hident.engine.run_files import PAGE, unpacked
from hident.engine.trial import digest
from hident.ledger.judged import as_number, key_of
from hident.ledger.verdicts import COUNTED
from hident.ledger.verify import TableState
from hident.reports.page import Page as Content
from hident.reports.site import drawings, tables
from hident.reports.site.facts import WORDS
from hident.reports.site.methods import method
from hident.reports.site.numbers import DERIVED, MEANINGS, UNCOUNTED, chance
from hident.reports.site.pages import (
    DIFFERENCES,
    FRONT,
    Page,
    Part,
    Run,
    Sources,
    paper_page,
    run_file,
    run_page,
)
from hident.reports.site.rendering import NAVIGATION
from hident.reports.tables.writing import SIGNS

PICTURE = "ledger.svg"
"""The ledger as a picture by itself."""
_PICTURES = (".svg", ".png")
_MOST_CELLS = 80
"""Cells of a table of a measured record."""
_P_VALUE = re.compile(r"Metric ([^:.]+): p-value")
LEAST_P = 1e-3
"""Of a p-value below it the front page says no more."""
KINDS = {
    "printed": "with printed numbers",
    "comparison": "comparison of methods",
    "measured": "measured record",
    "study": "study",
}


@dataclass(frozen=True)
class Row:
    """A table of the ledger."""

    state: TableState
    run: Run
    methods: tuple[str, ...]
    """As papers call them."""
    misprints: int = 0
    """How many of the numbers that differ are misprinted."""

    @property
    def reading(self) -> str:
        """What the run makes of the table: its title without the name of the paper."""
        return self.run.facts.title.partition(": ")[2] or self.run.facts.title

    @property
    def words(self) -> str:
        """The verdicts that some of its numbers have, between bars."""
        return "|".join(word for word in WORDS if self.state.counts.get(word))


@dataclass(frozen=True)
class Paper:
    """What was reproduced of one paper."""

    name: str
    title: str
    page: str
    """Empty where the site has none."""
    rows: tuple[Row, ...]

    @property
    def counts(self) -> dict[str, int]:
        """How many printed numbers came out how."""
        return {word: sum(row.state.counts.get(word, 0) for row in self.rows) for word in WORDS}

    @property
    def wide(self) -> int:
        """How many agree by an interval wider than themselves."""
        return sum(row.state.wide for row in self.rows)


@dataclass(frozen=True)
class Printed:
    """How many printed numbers there are, and of those that do not count how many for which reason."""

    total: int
    idle: Mapping[str, int]

    @property
    def counting(self) -> int:
        """How many count."""
        return self.total - sum(self.idle.values())


def parts(sources: Sources) -> Iterator[Part]:
    """One part: the front page, the list of runs and what both are made of."""
    key = [[run.name, run.hashes, list(run.facts.faults)] for run in sources.runs]
    said = [[name, repr(remarks)] for name, remarks in sorted(sources.remarks.items())]
    yield Part(digest(["front", key, sources.titles, said]), lambda: _pages(sources))


def picture(sources: Sources) -> str:
    """The ledger as an SVG by itself."""
    return drawings.ledger(
        [
            (paper.title, [(f"{row.state.table} ({row.run.name})", row.state) for row in paper.rows])
            for paper in papers(sources)
        ]
    )


def papers(sources: Sources) -> list[Paper]:
    """The papers with their tables, by their titles; tables of which no number counts are left out."""
    titles = sources.titles
    found: dict[str, list[Row]] = {}
    for run in sources.runs:
        for state in run.facts.tables:
            if any(state.counts.values()):
                row = Row(
                    state,
                    run,
                    methods_of(run),
                    _misprints(run, state),
                )
                found.setdefault(run.facts.paper, []).append(row)
    return [
        Paper(name, titles.get(name, name), paper_page(name) if name in titles else "", tuple(rows))
        for name, rows in sorted(found.items(), key=lambda item: titles.get(item[0], item[0]).lower())
    ]


def methods_of(run: Run) -> tuple[str, ...]:
    """The methods of a run, as papers call them."""
    return tuple(map(method, run.facts.kinds("estimators")))


def _misprints(run: Run, state: TableState) -> int:
    return sum(one["mark"] == "misprint" and one["verdict"] == "differs" for one in _rows(run, state))


def _pages(sources: Sources) -> Iterator[Page]:
    every = papers(sources)
    counts = {word: sum(paper.counts[word] for paper in every) for word in WORDS}
    newest = sorted(sources.runs, key=lambda run: (run.facts.finished, run.name), reverse=True)
    common = {
        "drawings": drawings,
        "words": WORDS,
        "signs": SIGNS,
        "meanings": MEANINGS,
        "page_of": lambda run: run_page(run.name),
        "file_of": lambda run, name: run_file(run.name, name),
    }
    front = {
        "papers": every,
        "counts": counts,
        "printed": printed_in(sources.runs),
        "uncounted": UNCOUNTED,
        "wide": sum(paper.wide for paper in every),
        "once": sum(_excludes_one(row) for paper in every for row in paper.rows),
        "misprints": sum(row.misprints for paper in every for row in paper.rows),
        "derived": _derived(sources),
        "readings": _readings(every),
        "chance": chance,
        "without_folders": tables.without_folders,
        "source_of": {
            run.name: paper_page(run.facts.config) for run in newest if run.facts.config in sources.titles
        },
        "methods": sorted(
            {name for paper in every for row in paper.rows for name in row.methods}, key=str.lower
        ),
        "methods_of": methods_of,
        "differences": DIFFERENCES if counts["differs"] else "",
        "comparisons": [(run, _picture_of(run)) for run in newest if run.facts.is_comparison],
        "measured": [
            (run, _picture_of(run), _first_table(run)) for run in newest if _what(run) == "measured"
        ],
        "others": [run for run in sources.runs if _what(run) == "study"],
        "faulty": [run for run in sources.runs if run.facts.faults],
    }
    said = [row.state.table + " " + row.run.facts.title for paper in every for row in paper.rows]
    yield Page(FRONT, "What was reproduced", "Ledger", "front.html", common | front, " ".join(said))
    listed = [(run, KINDS[_what(run)]) for run in sources.runs]
    there = {kind for _, kind in listed}
    data = common | {"runs": listed, "kinds": [kind for kind in KINDS.values() if kind in there]}
    yield Page(
        NAVIGATION["Runs"], "Runs", "Runs", "runs.html", data, " ".join(r.facts.title for r in sources.runs)
    )


def printed_in(runs: Sequence[Run]) -> Printed:
    """The printed numbers that runs stand beside, each once in however many runs."""
    marks: dict[tuple[str, ...], set[str]] = {}
    for run in runs:
        for one in run.facts.rows:
            marks.setdefault((run.facts.paper, *key_of(one)), set()).add(one["mark"])
    idle = Counter(min(found) for found in marks.values() if not found & {*COUNTED})
    return Printed(len(marks), dict(sorted(idle.items())))


@dataclass(frozen=True)
class Readings:
    """How the printed numbers come out that stand beside several readings of a paper."""

    all: int
    """They come out in each."""
    some: int
    none: int


def _readings(every: Sequence[Paper]) -> Readings:
    """Each printed number once; one comes out if it is exact, agrees or cannot tell."""
    found: dict[tuple[str, ...], list[bool]] = {}
    for paper in every:
        for row in paper.rows:
            for one in _rows(row.run, row.state):
                found.setdefault((paper.name, *key_of(one)), []).append(one["verdict"] != "differs")
    several = [held for held in found.values() if len(held) > 1]
    whole, nothing = sum(map(all, several)), sum(not any(held) for held in several)
    return Readings(whole, len(several) - whole - nothing, nothing)


def _rows(run: Run, state: TableState) -> list[dict[str, str]]:
    """The rows of verdicts.csv behind a table of the ledger that count."""
    return [one for one in run.facts.counted if one["table"] == state.table]


def _excludes_one(row: Row) -> int:
    """How many agree that one alternative alone would have excluded."""
    return sum(one["verdict"] == "agrees" and one["excluded"] == "1" for one in _rows(row.run, row.state))


def _derived(sources: Sources) -> int:
    """How many of the numbers that count follow from printed ones, and are not printed."""
    every = {(run.facts.paper, key_of(row)) for run in sources.runs for row in run.facts.counted}
    return sum(sources.remarks[paper].notes.get(key, "").startswith(DERIVED) for paper, key in every)


def _what(run: Run) -> str:
    """What a run is about, of the keys of :data:`KINDS`."""
    facts = run.facts
    if facts.tables:
        return "printed"
    if facts.is_comparison:
        return "comparison"
    return "measured" if facts.is_measured else "study"


def _picture_of(run: Run) -> str:
    """A figure of a run that a card can show; empty if there is none."""
    there = map(unpacked, run.files)
    return next((name for name in there if name.endswith(_PICTURES)), "")


def _first_table(run: Run) -> tables.Shown | None:
    """The beginning of the first table of a run; none where it is of statistics over trials."""
    if PAGE not in run.files:
        return None
    text = (run.folder.path / PAGE).read_text(encoding="utf-8", errors="replace")
    content = Content.read(text)
    first = next(iter(content.tables), None)
    if first is None or "trials" in first.header:
        return None
    told = tuple(part for part in content.above if part.startswith("Metric "))
    tests = {name for part in told for name in _P_VALUE.findall(part)}
    rows = tuple(
        tuple(map(lambda name, cell: _rounded(cell) if name in tests else cell, first.header, row))
        for row in first.rows
    )
    return tables.shown(replace(first, rows=rows, notes=(first.title, *told)), _MOST_CELLS)


def _rounded(p: str) -> str:
    """A p-value as one reads it: of a small one only that it is small."""
    return "< 1e-3" if as_number(p) < LEAST_P else p
