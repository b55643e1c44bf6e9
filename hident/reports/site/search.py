"""The search over all pages, which works from a file too, and the list of all pages for who has no script."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from html import unescape
from pathlib import PurePosixPath

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
        (number, passage.anchor, passage.title, _without_title(_words(passage.text), page, passage))
        for number, page in enumerate(pages)
        for passage in _passages(page)
    ]
    found = {"pages": [(page.path, page.title, page.section) for page in pages], "passages": passages}
    return f"window.hidentIndex={json.dumps(found, ensure_ascii=False, separators=(',', ':'))};\n"


def _passages(page: Written) -> Iterator[Passage]:
    """The passages of a page, and what only its HTML holds: the background of components, printed numbers."""
    yield from map(Passage._make, page.passages or [Passage("", page.title, page.text)])
    for background in _BACKGROUND.findall(page.html):
        yield Passage("", f"{page.title}: symbols and background", _plain(background))
    for title, table in _NUMBERS.findall(page.html):
        yield Passage("numbers", f"{_plain(title)}: printed numbers", "; ".join(_rows(table)))


_BACKGROUND = re.compile(r'<details class="background">\s*<summary>.*?</summary>(.*?)</details>', re.DOTALL)
_NUMBERS = re.compile(
    r'<h3>([^<]*)</h3>(?:(?!<h3>).)*?<table class="numbers">(.*?)</table>',
    re.DOTALL,
)
_ROW = re.compile(r'<tr><th scope="row">(.*?)</th>(.*?)</tr>', re.DOTALL)
_PRINTED = re.compile(r'<span class="printed"><span class="hidden">printed </span>(.*?)</span>')


def _rows(table: str) -> Iterator[str]:
    """The printed numbers of a table by its rows, each number of a row once."""
    for row, cells in _ROW.findall(table):
        yield " ".join([_plain(row), *dict.fromkeys(map(_plain, _PRINTED.findall(cells)))])


def _plain(html: str) -> str:
    """A piece of HTML without its tags; what stands in cells or paragraphs of their own stays apart."""
    apart = re.sub(r"</(?:td|th|p|li|div|dt|dd|pre)>", " ", html)
    return " ".join(unescape(re.sub(r"<[^>]*>", "", apart)).split())


def _without_title(text: str, page: Written, passage: Passage) -> str:
    """A text without the titles and the name that it begins with: the search shows them above it."""
    titles = [_words(title) for title in (PurePosixPath(page.path).stem, page.title, passage.title)]
    while begun := next((title for title in titles if title and f"{text} ".startswith(f"{title} ")), ""):
        text = text[len(begun) :].lstrip()
    return text
