"""The handbook: the pages of docs/."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

import hident
from hident.engine.trial import digest
from hident.reports.site.markdown import Document, document
from hident.reports.site.pages import COMPONENTS, Page, Part, Sources, handbook_page
from hident.reports.site.rendering import NAVIGATION

_GROUPS: Mapping[str, Mapping[str, str]] = {
    "Begin": {
        "README": "What it is, the two commands that reproduce everything, and what comes out.",
        "tutorial": "A system of your own, and which of two methods finds it better.",
        "concepts": "What no data can tell, seeds, failures, and where the trials are kept.",
        "questions": "What a message means, and what to do.",
        "glossary": "What the words mean that stand in tables, notes and figures.",
    },
    "Describe an experiment": {
        "configuration": "How a file is written: axes, variables, choices, printed numbers.",
        "measurements": "From a file of samples to a model that can be trusted.",
        "python": "All of it in a notebook or a script.",
    },
    "Reproduce and compare": {
        "reproducing": "From the printed numbers of a paper to a verdict on each.",
        "verdicts": "What exact, agrees, untestable and differs mean, and how often they are wrong.",
        "comparisons": "Methods on the same records: differences, intervals, tests and ranks.",
        "site": "Everything of it as pages for a browser.",
        "publication": "PDF, SVG and LaTeX, sizes, and panels over axes.",
    },
    "Run and trust": {
        "scale": "Millions of trials, many machines, any executor.",
        "reproducibility": "The same numbers to the last bit, and what may move them.",
        "robustness": "What a crash, a full disk or a damaged file may cost.",
        "bench": "Speed and memory, as they were measured last.",
    },
    "Extend": {
        "extending": "A complete file for every kind of component, and their tests.",
        "architecture": "The rooms of the house, and the contracts between them.",
    },
}
"""The documents in their order, and what is said of each; those that are not named stand behind them."""
_REFERENCE = "Every component and every key"


def docs_folder() -> Path:
    """The folder of hident's own documents: that of the installed package, or of the checkout."""
    package = Path(hident.__file__).parent
    return package / "docs" if (package / "docs").is_dir() else package.parent / "docs"


def parts(sources: Sources) -> Iterator[Part]:
    """A part for each page, and one for the list of them."""
    texts = {stem: path.read_text(encoding="utf-8") for stem, path in sources.documents.items()}
    titles = {stem: _title(text) for stem, text in texts.items()}
    groups = _grouped(titles)
    leads = {stem: lead for stems in _GROUPS.values() for stem, lead in stems.items()}
    order = [stem for _, stems in groups for stem in stems]

    def contents() -> Iterator[Page]:
        listed = [
            (name, [(handbook_page(stem), titles[stem], leads.get(stem, "")) for stem in stems])
            for name, stems in groups
        ]
        data = {"groups": listed, "reference": (COMPONENTS, _REFERENCE)}
        yield Page(NAVIGATION["Handbook"], "Handbook", "Handbook", "handbook.html", data)

    def page(stem: str) -> Iterator[Page]:
        path = handbook_page(stem)
        made = read(stem, sources)
        at = order.index(stem)
        beside = [
            (handbook_page(order[i]), titles[order[i]]) if 0 <= i < len(order) else None
            for i in (at - 1, at + 1)
        ]
        data = {
            "body": made.body,
            "headings": made.headings,
            "groups": [(name, [(handbook_page(s), titles[s]) for s in stems]) for name, stems in groups],
            "before": beside[0],
            "after": beside[1],
        }
        yield Page(path, titles[stem], "Handbook", "chapter.html", data, passages=made.passages)

    yield Part(digest(["handbook", texts]), contents, sources.attached)
    for stem, text in texts.items():
        yield Part(digest([stem, text, titles, sources.held]), partial(page, stem))


def read(stem: str, sources: Sources) -> Document:
    """A document of the handbook as HTML for its page."""
    text = sources.documents[stem].read_text(encoding="utf-8")
    folder = {"README": "", "bench": "results"}.get(stem, "docs")
    return document(text, handbook_page(stem), folder, sources.holds)


def _grouped(known: Mapping[str, str]) -> list[tuple[str, list[str]]]:
    grouped = {stem for stems in _GROUPS.values() for stem in stems}
    groups = {**_GROUPS, "More": dict.fromkeys(stem for stem in known if stem not in grouped)}
    found = [(name, [stem for stem in stems if stem in known]) for name, stems in groups.items()]
    return [(name, stems) for name, stems in found if stems]


def _title(text: str) -> str:
    return text.partition("\n")[0].lstrip("# ")
