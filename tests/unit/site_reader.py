"""Pages of the site as a browser reads them, for tests: links, texts, and what is inside of which element."""

from __future__ import annotations

import posixpath
import re
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from hident.reports.site.notation import in_words

_VOID = {"meta", "link", "img", "br", "input", "hr", "path", "rect", "circle"}


class Reader(HTMLParser):
    """The elements of a page: tag, attributes and the text within each."""

    def __init__(self, text):
        super().__init__()
        self.elements: list[dict[str, Any]] = []
        self._open: list[dict[str, Any]] = []
        self.feed(text)
        self.close()
        assert not self._open, [element["tag"] for element in self._open]

    def handle_starttag(self, tag, attrs):
        names = [name for name, _ in attrs]
        assert len(names) == len(set(names)), (tag, attrs)
        element = {"tag": tag, "attributes": dict(attrs), "text": ""}
        self.elements.append(element)
        if tag not in _VOID:
            self._open.append(element)

    def handle_startendtag(self, tag, attrs):
        self.elements.append({"tag": tag, "attributes": dict(attrs), "text": ""})

    def handle_endtag(self, tag):
        assert self._open, tag
        assert self._open.pop()["tag"] == tag

    def handle_data(self, data):
        for element in self._open:
            element["text"] += data

    def of(self, tag, **attributes):
        """The elements of a tag whose attributes hold these words."""
        wanted = {name.rstrip("_"): word for name, word in attributes.items()}
        return [
            element
            for element in self.elements
            if element["tag"] == tag
            and all(word in (element["attributes"].get(name) or "").split() for name, word in wanted.items())
        ]

    @property
    def ids(self):
        return [element["attributes"]["id"] for element in self.elements if "id" in element["attributes"]]

    def text_of(self, tag):
        return [" ".join(element["text"].split()) for element in self.of(tag)]


def pages(site):
    """All pages of a site by their paths."""
    return {
        path.relative_to(site).as_posix(): Reader(path.read_text(encoding="utf-8"))
        for path in sorted(site.rglob("*.html"))
    }


def dead_links(site, read):
    """The links and images of the pages that lead to nothing, each with its page."""
    found = []
    for page, reader in read.items():
        for element in reader.elements:
            for name in ("href", "src"):
                link = element["attributes"].get(name)
                if link is None or link.startswith(("http:", "https:", "mailto:", "data:")):
                    continue
                path, _, anchor = link.partition("#")
                target = posixpath.normpath(posixpath.join(posixpath.dirname(page), unquote(path)))
                target = target if path else page
                missing = not (site / target).is_file() or target.startswith("..")
                if missing or (anchor and target in read and unquote(anchor) not in read[target].ids):
                    found.append((page, link))
    return found


def seen(text):
    """The letters of a text on a page: indices and powers stand there without their marks."""
    return unescape(re.sub(r"<[^>]*>", "", in_words(text)))


def written(folder, name, text):
    """A file with a text."""
    path = Path(folder) / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path
