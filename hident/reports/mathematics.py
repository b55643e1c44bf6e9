"""Which dollars in a text are mathematics, the same for figures and for LaTeX; the texts of figures."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# As pandoc has it: no blank inside of the dollars, no digit behind them, and \$ is a dollar.
_BETWEEN_DOLLARS = re.compile(r"(?<!\\)\$(?!\s)((?:\\\$|[^$\n])+?)(?<![\s\\])\$(?!\d)")
_POWER = re.compile(r"\b([A-Za-z])\^(-?\d+)")
_COMMAND = re.compile(r"\\[A-Za-z]")

_WHOLE: ContextVar[Callable[[str], str]] = ContextVar("whole", default=str)


@contextmanager
def whole(texts: Iterable[str]) -> Iterator[None]:
    r"""Inside of the block, no dollar of one of these texts pairs with one outside of it.

    Names, labels and headings are joined in many places, and each may hold a dollar of its own.

    Examples
    --------
    >>> with whole(["US$", "CA$"]):
    ...     print(typeset_by(r"US$, CA$ at $\sigma$ = 1", "<{}>".format, str))
    US$, CA$ at <\sigma> = 1
    """
    escaped = {text: _with_dollars(text) for text in texts if "$" in text}
    # Longer ones first, which may hold others.
    lone = sorted((text for text, own in escaped.items() if own != text), key=len, reverse=True)
    alone = re.compile(rf"(?<![\w\\$])(?:{'|'.join(map(re.escape, lone))})(?![\w$])")

    def kept(text: str) -> str:
        return alone.sub(lambda found: escaped[found[0]], text) if "$" in text else text

    token = _WHOLE.set(kept if lone else str)
    try:
        yield
    finally:
        _WHOLE.reset(token)


def typeset_by(text: str, mathematics: Callable[[str], str], words: Callable[[str], str]) -> str:
    r"""A text with what stands between dollars written by ``mathematics``, and all else by ``words``.

    Dollars are mathematics where they pair, no blank stands inside of them, and what they hold is
    mathematics: it parses, or it holds a command, which is meant. All others are dollars, as is ``\$``.

    Examples
    --------
    >>> typeset_by(r"$5 & 7 % of $10, $\sigma$", "<{}>".format, str)
    '$5 & 7 % of $10, <\\sigma>'
    """
    text, found, last = _WHOLE.get()(text), [], 0
    while token := _BETWEEN_DOLLARS.search(text, last):
        if _is_mathematics(token[1]):
            found += [words(_plain(text[last : token.start()])), mathematics(token[1])]
            last = token.end()
        else:
            # Its second dollar may be the first of others.
            found.append(words(_plain(text[last : token.end() - 1])))
            last = token.end() - 1
    return "".join([*found, words(_plain(text[last:]))])


def _plain(text: str) -> str:
    return text.replace("\\$", "$")


@lru_cache
def _is_mathematics(text: str) -> bool:
    if not _balanced(text):
        return False
    if _COMMAND.search(text):
        return True
    from matplotlib.mathtext import MathTextParser

    try:
        MathTextParser("agg").parse(f"${text}$")
    except ValueError:
        return False
    return True


def _balanced(text: str) -> bool:
    depth = 0
    for brace in re.findall(r"(?<!\\)[{}]", text):
        depth += 1 if brace == "{" else -1
        if depth < 0:
            return False
    return depth == 0


def typeset(figure: Figure) -> None:
    """Set powers as in R^-1 as mathematics, in every text that holds none already, and dollars as such."""
    from matplotlib.text import Text
    from matplotlib.ticker import FuncFormatter

    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        said = text.get_text()
        shown = _with_dollars(said)
        if shown.count("$") == shown.count("\\$") and _POWER.search(shown):
            shown = _POWER.sub(r"$\1^{\2}$", shown)
        if shown != said:
            text.set_text(shown)
    # The text of a tick is written anew with each drawing.
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        if isinstance(formatter := axis.get_major_formatter(), FuncFormatter):
            formatter.func = _TickText(formatter.func)


class _TickText:
    """The text of a tick that ``text`` gives, its dollars as matplotlib wants them."""

    def __init__(self, text: Callable[..., str]) -> None:
        self._text = text

    def __call__(self, *at: Any) -> str:
        return _with_dollars(self._text(*at))


def _with_dollars(text: str) -> str:
    """A text for matplotlib, to which all pairs of dollars without a backslash are mathematics."""
    if "$" not in text:
        return text
    return typeset_by(text, "${}$".format, _escaped_dollars)


def _escaped_dollars(words: str) -> str:
    return words.replace("$", "\\$")


def wrapped(text: str, letters: int) -> list[str]:
    """The lines of a text, of so many letters at most; mathematics is not broken.

    Examples
    --------
    >>> wrapped("instrumental variables, order 2", 15)
    ['instrumental', 'variables,', 'order 2']
    >>> wrapped("slope $N^{-1} + 1$", 7)
    ['slope', '$N^{-1} + 1$']
    """
    # No line breaks at a blank of this kind.
    kept = typeset_by(text, lambda inside: f"${inside.replace(' ', chr(0xA0))}$", _escaped_dollars)
    broken = textwrap.wrap(kept, max(letters, 1), break_long_words="$" not in text, break_on_hyphens=False)
    return [line.replace("\xa0", " ") for line in broken] or [""]
