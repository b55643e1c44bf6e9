"""The search over all pages, which works from a file too, and the list of all pages for who has no script."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence

from hident.reports.site.pages import Page, Part, Passage, Sources, Written
from hident.reports.site.rendering import NAVIGATION, rendered

INDEX = "search-index.js"
"""What is searched: a script, loaded when somebody searches, as a page from a file may load no data."""


def parts(sources: Sources) -> Iterator[Part]:
    """None: the index is made of all other pages."""
    yield from ()


def files(pages: Sequence[Written]) -> dict[str, bytes]:
    """The page that lists all pages, and the file that the search looks through."""
    listed = [
        (section, sorted(((page.title, page.path) for page in pages if page.section == section), key=_order))
        for section in dict.fromkeys(page.section for page in pages)
    ]
    page = Page(NAVIGATION["Index"], "Search and index", "Index", "search.html", {"sections": listed})
    return {page.path: rendered(page).html.encode(), INDEX: _script(pages).encode()}


def _order(entry: tuple[str, str]) -> tuple[str, str]:
    title, path = entry
    return title.casefold(), path


def _words(text: str) -> str:
    """A text in one line, without the lines of tables that are written in Markdown."""
    return " ".join(word for word in text.split() if word == "-" or {*word} - {*"|:-"})


def _script(pages: Sequence[Written]) -> str:
    """By page its path, title and section; by passage the number of its page, anchor, title and text."""
    passages = [
        (number, passage.anchor, passage.title, _words(passage.text))
        for number, page in enumerate(pages)
        for passage in map(Passage._make, page.passages or [Passage("", page.title, page.text)])
    ]
    found = {"pages": [(page.path, page.title, page.section) for page in pages], "passages": passages}
    return f"window.hidentIndex={json.dumps(found, ensure_ascii=False, separators=(',', ':'))};\n"
