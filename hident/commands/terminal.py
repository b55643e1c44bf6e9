"""Texts for a terminal: verdicts in colour, where there is one and colours are wanted."""

from __future__ import annotations

import shutil
import sys
from typing import TYPE_CHECKING, get_args

from hident.ledger.verdicts import Word
from hident.reports.tables.writing import SIGNS

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

COLOURS: dict[Word, str] = {
    "exact": "bold green",
    "agrees": "cyan",
    "untestable": "yellow",
    "differs": "bold red",
}
WORDS: tuple[Word, ...] = get_args(Word)
_WIDTH = 120
"""Letters of a line where there is no terminal."""


def signed(text: str) -> Text:
    """A text in which the signs and words of verdicts have their colours."""
    from rich.text import Text

    found = Text(_plain(text))
    for word in WORDS:
        found.highlight_regex(rf"(?<= )\{SIGNS[word]}(?= |$|,)|\b{word}\b", COLOURS[word])
    return found


def text_of(text: str, look: str = "") -> Text:
    """A text as it is: nothing in it is markup."""
    from rich.text import Text

    return Text(_plain(text), style=look)


def _plain(text: str) -> str:
    """A text without what would steer the terminal."""
    return "".join(char if char.isprintable() or char == "\n" else "?" for char in text)


def terminal() -> Console:
    """The terminal; without one, lines of as many letters as COLUMNS says."""
    from rich.console import Console

    width = None if sys.stdout.isatty() else shutil.get_terminal_size((_WIDTH, 24)).columns
    return Console(width=width, highlight=False, markup=False, emoji=False)


def has_unicode(console: Console) -> bool:
    """Whether the terminal has letters beyond ASCII."""
    return not console.options.ascii_only
