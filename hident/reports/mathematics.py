"""Which dollars in a text are mathematics: the same for figures and for LaTeX."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache

# As pandoc has it: no blank inside of the dollars, no digit behind them, and \$ is a dollar.
_BETWEEN_DOLLARS = re.compile(r"(?<!\\)\$(?!\s)((?:\\\$|[^$\n])+?)(?<![\s\\])\$(?!\d)")
_COMMAND = re.compile(r"\\[A-Za-z]")


def typeset_by(text: str, mathematics: Callable[[str], str], words: Callable[[str], str]) -> str:
    r"""A text with what stands between dollars written by ``mathematics``, and all else by ``words``.

    Dollars are mathematics where they pair, no blank stands inside of them, and what they hold is
    mathematics: it parses, or it holds a command, which is meant. All others are dollars, as is ``\$``.

    Examples
    --------
    >>> typeset_by(r"$5 & 7 % of $10, $\sigma$", "<{}>".format, str)
    '$5 & 7 % of $10, <\\sigma>'
    """
    found, last = [], 0
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
