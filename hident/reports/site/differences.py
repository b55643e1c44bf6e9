"""A page of all printed numbers that differ, with their reasons."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from hident.engine.trial import digest
from hident.reports.site import runs
from hident.reports.site.methods import method
from hident.reports.site.numbers import Number
from hident.reports.site.pages import DIFFERENCES, Page, Part, Run, Sources, paper_page, run_page
from hident.reports.site.tables import MOST_NUMBERS
from hident.reports.tables.writing import SIGNS

_MOST = 1000
"""Numbers that the page shows."""


@dataclass(frozen=True)
class Difference:
    """The numbers of a run that differ for one reason."""

    run: Run
    page: str
    reason: str
    numbers: tuple[Number, ...]
    methods: tuple[str, ...]


@dataclass(frozen=True)
class OfPaper:
    """What differs of one paper."""

    name: str
    title: str
    page: str
    """Empty where the site has none."""
    differences: tuple[Difference, ...]

    @property
    def count(self) -> int:
        """How many numbers they are."""
        return sum(len(one.numbers) for one in self.differences)


def parts(sources: Sources) -> Iterator[Part]:
    """One part, if a printed number differs."""
    concerned = [run for run in sources.runs if run.facts.counts["differs"]]
    if concerned:
        said = [[name, repr(remarks)] for name, remarks in sorted(sources.remarks.items())]
        key = [[run.name, run.hashes] for run in concerned]
        yield Part(digest(["differences", key, said, sources.titles]), lambda: _pages(concerned, sources))


def _pages(concerned: list[Run], sources: Sources) -> Iterator[Page]:
    found: dict[str, list[Difference]] = {}
    left = _MOST
    more = 0
    for run in concerned:
        for reason, numbers in runs.differing(run, sources.remarks[run.facts.paper]):
            shown = tuple(numbers[: max(left, 0)])
            left -= len(shown)
            more += len(numbers) - len(shown)
            if shown:
                kinds = tuple(map(method, run.facts.kinds("estimators")))
                one = Difference(run, run_page(run.name), reason, shown, kinds)
                found.setdefault(run.facts.paper, []).append(one)
    papers = [
        OfPaper(
            name,
            sources.titles.get(name, name),
            paper_page(name) if name in sources.titles else "",
            tuple(there),
        )
        for name, there in sorted(found.items(), key=lambda one: sources.titles.get(one[0], one[0]).lower())
    ]
    methods = {kind for paper in papers for one in paper.differences for kind in one.methods}
    data = {
        "papers": papers,
        "methods": sorted(methods),
        "more": more,
        "signs": SIGNS,
        "no_reason": runs.NO_REASON,
    }
    data["most_numbers"] = MOST_NUMBERS
    words = " ".join(one.reason for paper in papers for one in paper.differences)
    yield Page(DIFFERENCES, "What differs, and why", "Ledger", "differences.html", data, words)
