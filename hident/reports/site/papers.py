"""A page for each folder under experiments/: what the paper claims, and what comes out."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from hident.engine.trial import digest
from hident.reports.site import drawings, front
from hident.reports.site.facts import WORDS
from hident.reports.site.markdown import document
from hident.reports.site.numbers import MEANINGS, chance
from hident.reports.site.pages import Page, Part, Sources, paper_page, run_page
from hident.reports.tables.writing import SIGNS


def parts(sources: Sources) -> Iterator[Part]:
    """A part for each page."""
    judged = {paper.name: paper for paper in front.papers(sources)}
    for file in sorted(sources.experiments.glob("*/README.md")):
        text, name = file.read_text(encoding="utf-8", errors="replace"), file.parent.name
        paper = judged.get(name)
        rows = (
            [[repr(row.state), row.run.name, row.misprints, row.run.facts.title] for row in paper.rows]
            if paper
            else []
        )
        yield Part(
            digest(["paper", name, text, sources.held, rows]),
            partial(_page, name, text, sources, paper),
        )


def _page(name: str, text: str, sources: Sources, paper: front.Paper | None) -> Iterator[Page]:
    path = paper_page(name)
    made = document(text, path, f"experiments/{name}", sources.holds)
    data = {
        # The tables stand between the title and the text.
        "body": made.body.partition("</h1>\n")[2] if made.title else made.body,
        "paper": paper,
        "drawings": drawings,
        "words": WORDS,
        "signs": SIGNS,
        "meanings": MEANINGS,
        "chance": chance,
        "page_of": lambda run: run_page(run.name),
    }
    yield Page(path, made.title or name, "Runs", "paper.html", data, passages=made.passages)
