"""BibTeX: of a paper, from its folder, and of the methods that a run uses, by the sources that they name."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Iterator
from pathlib import Path

PAPER = "paper.bib"
"""The entry of a paper, in its folder under experiments/."""
OURS = "hident"
"""The key of hident itself."""
_ENTRY = re.compile(r"@\w+\s*{\s*([^,\s]+)\s*,.*?\n}", re.DOTALL)
# A surname, others, and one year or several.
_CITED = re.compile(
    r"([A-Z][^\W\d_]+)(?:(?:,| and|, and| et al\.?) (?:[A-Z][^\W\d_]+)?)*,? \(?(\d{4})"
    r"((?: \([^()]*\))?(?:, \d{4}(?: \([^()]*\))?)*)"
)


def entries(text: str) -> dict[str, str]:
    """The entries of a bibliography by their keys; each ends with a brace in a line of its own.

    Examples
    --------
    >>> list(entries("@book{golomb1967,\\n  title = {Shift Register Sequences}\\n}"))
    ['golomb1967']
    """
    return {found[1]: found[0] for found in _ENTRY.finditer(text)}


def known(experiments: Path) -> dict[str, str]:
    """All entries that are known: those of the methods that come with hident, and those of the papers."""
    texts = [Path(__file__).with_name("references.bib"), *sorted(experiments.glob(f"*/{PAPER}"))]
    found: dict[str, str] = {}
    for file in texts:
        try:
            found |= entries(file.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError):
            continue
    return found


def cited(text: str, keys: Iterable[str]) -> Iterator[str]:
    """The keys of the works that a text names by first author and year, or begins with by first author alone.

    Examples
    --------
    >>> keys = ["akaike1970", "akaike1974", "brouri", "chen2009", "hwang2003"]
    >>> list(cited("Hwang and Lin 2003; Chen, Hwang, Chang 2009, examples 5, 6", keys))
    ['hwang2003', 'chen2009']
    >>> list(cited("Brouri, Table I; Akaike 1970 (fpe), 1974 (aic)", keys))
    ['brouri', 'akaike1970', 'akaike1974']
    """
    known, found = set(keys), list[str]()
    for part in " ".join(text.split()).split(";"):
        found += re.findall(r"\w+", part.lower())[:1]
        for name, year, more in _CITED.findall(part):
            found += [f"{_plain(name)}{one}" for one in (year, *re.findall(r"\d{4}", more))]
    yield from (key for key in dict.fromkeys(found) if key in known)


def _plain(name: str) -> str:
    """A name in small letters without accents."""
    return "".join(c for c in unicodedata.normalize("NFD", name.lower()) if c.isalpha())
