"""The words of docs/glossary.md that a page uses, with what they mean."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

from hident.reports.site.markdown import slug
from hident.reports.site.pages import Sources, handbook_page

DOCUMENT = "glossary"
"""The name of its document in the handbook."""
_ENTRY = re.compile(r"^## (?P<word>.+)\n\n(?P<meaning>(?:.+\n)+)", re.MULTILINE)
# Where a word stands in other forms than that of its heading, or means something else by itself.
_FORMS: Mapping[str, str] = {
    "told apart": r"t(old|ells?) (\w+ ){0,3}apart",
    "hang on a single trial": r"hangs? on (it|that trial|a single trial)",
    "beyond": r"beyond(?=:)|goes? beyond",
    "ranks": r"ranks?",
    "factor between the blocks": r"factor between the blocks|free factor",
    "vif": r"VIFs?|variance inflation factors?",
}


class Word(NamedTuple):
    """A word with its meaning and where the handbook has it."""

    word: str
    meaning: str
    page: str
    anchor: str


def words_of(sources: Sources) -> tuple[Word, ...]:
    """All words of the handbook; none where it has no glossary."""
    path = sources.documents.get(DOCUMENT)
    if path is None:
        return ()
    page = handbook_page(DOCUMENT)
    return tuple(
        Word(found["word"], " ".join(found["meaning"].split()).replace("`", ""), page, slug(found["word"]))
        for found in _ENTRY.finditer(path.read_text(encoding="utf-8"))
    )


def used(words: tuple[Word, ...], text: str) -> list[Word]:
    """Those that stand in a text, in any of their forms.

    Examples
    --------
    >>> words = (Word("Told apart", "", "", ""), Word("nsr", "", "", ""), Word("Beyond", "", "", ""))
    >>> [one.word for one in used(words, "No test tells the two apart, at nsr 0.1; it lies beyond the axes.")]
    ['Told apart', 'nsr']
    """
    return [one for one in words if _pattern(one.word).search(text)]


def _pattern(word: str) -> re.Pattern[str]:
    form = _FORMS.get(word.lower(), re.escape(word))
    return re.compile(rf"(?<!\w)({form})(?!\w)", re.IGNORECASE)
