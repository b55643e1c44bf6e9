"""Tables for LaTeX: booktabs, and numbers that siunitx sets.

What needs no package of Python is written here: pandas' own writer takes cells as they are, which hold
intervals, spreads and the signs of verdicts.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Iterable, Sequence

from hident.config.suggest import counted
from hident.reports.mathematics import typeset_by
from hident.reports.table import Table, is_number

PREAMBLE = (
    "% In the preamble: \\usepackage{booktabs}, \\usepackage{siunitx}; for tables wider than the page "
    "\\usepackage{graphicx}\n"
)
# No wider than the line; the width is that of what stands inside.
_SHRUNK = r"  \setlength{\tabcolsep}{3pt}\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%"
# Letters and columns' edges that fit the line of an article in 10 pt.
_WIDEST = 66
_EDGES = 2
_NUMBER = r"[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?"
_PLAIN = re.compile(_NUMBER)
_EMPTY = ("", "-", "nan", "inf", "none")
# What may stand in a cell of numbers, between spaces.
_PIECE = re.compile(rf"(?P<open>\[?)(?P<number>{_NUMBER})(?P<close>[\],]?)")
_SIGNS = {
    "±": r"$\pm$",
    ">=": r"$\geq$",
    "<=": r"$\leq$",
    "=": "$=$",
    "~": r"$\sim$",
    "?": "?",
    "!": "!",
    "†": r"$\dagger$",
}
_PERCENTILE = re.compile(r"p\d+")
# Mathematics without dollars; the last is code.
_NAMES = "alpha beta gamma delta epsilon zeta eta theta lambda mu nu xi rho sigma tau phi psi omega"
_TOKEN = re.compile(
    rf"(?<![\w\\])([^\W\d_]|{_NAMES.replace(' ', '|')})_(-?\w+)(?!\w)"
    r"|\b([A-Za-z])\^(-?\w+)|`([^`]+)`"
)
# Letters that mean themselves to no mathematics of LaTeX, but to that of figures.
_SPECIAL, _BACKSLASHED = re.compile(r"(?<!\\)[%&#]"), r"\\\g<0>"
_ESCAPED = {
    "\\": r"\textbackslash{}",
    "~": r"$\sim$",
    "^": r"\textasciicircum{}",
    "<": "$<$",
    ">": "$>$",
    "|": "$|$",
    '"': "''",
    "\n": " ",
    "±": r"$\pm$",
    "\N{MULTIPLICATION SIGN}": r"$\times$",
    "·": r"$\cdot$",
    "\N{MINUS SIGN}": "$-$",
    "≤": r"$\leq$",
    "≥": r"$\geq$",
    "≈": r"$\approx$",
    "≠": r"$\neq$",
    "∞": r"$\infty$",
    "√": r"$\surd$",
    "→": r"$\to$",
    "°": r"$^\circ$",
    "\N{EN DASH}": "--",
    "—": "---",
    "…": r"\ldots{}",
    "†": r"$\dagger$",
    "µ": r"$\mu$",
    **{char: f"\\{char}" for char in "&%$#_{}"},
}
# Letters that look like Latin ones have no command.
_SMALL = "αβγδεζηθικλμνξπρστυφχψω"
_CAPITAL = "ΓΔΘΛΞΠΣΥΦΨΩ"


def escaped(text: str) -> str:
    """A text in which every letter means itself to LaTeX; ``$...$``, a_1 and R^-1 are mathematics.

    Examples
    --------
    >>> escaped("σ of a_1, 95 % & my_file, R^-1")
    '$\\\\sigma$ of $a_{1}$, 95 \\\\% \\\\& my\\\\_file, $R^{-1}$'
    """
    return typeset_by(text, _mathematics, _words)


def _mathematics(text: str) -> str:
    return f"${_SPECIAL.sub(_BACKSLASHED, text)}$"


def _words(text: str) -> str:
    found, last = [], 0
    for token in _TOKEN.finditer(text):
        found += [_letters(text[last : token.start()]), _of_token(token)]
        last = token.end()
    return "".join([*found, _letters(text[last:])])


def _of_token(token: re.Match[str]) -> str:
    letter, index, base, power, code = token.groups()
    if letter:
        index = index.replace("_", r"\_")
        # A word is no product of its letters.
        index = index if len(index) == 1 or index.lstrip("-").isdecimal() else f"\\mathrm{{{index}}}"
        return f"${_in_mathematics(letter)}_{{{index}}}$"
    if base:
        return f"${base}^{{{power}}}$"
    return _SIGNS.get(code, f"\\texttt{{{_letters(code)}}}")


def _in_mathematics(symbol: str) -> str:
    return _letter(symbol).strip("$") if len(symbol) == 1 else f"\\{symbol}"


def _letters(text: str) -> str:
    words = text.replace(">=", "≥").replace("<=", "≤")
    return "".join(map(_letter, words))


def _letter(char: str) -> str:
    if char in _ESCAPED:
        return _ESCAPED[char]
    if char.isascii():
        return char
    if char in _SMALL + _CAPITAL:
        name = unicodedata.name(char).rpartition(" ")[2].replace("LAMDA", "LAMBDA")
        return f"$\\{name.capitalize() if char in _CAPITAL else name.lower()}$"
    script, _, code = unicodedata.decomposition(char).partition(" ")
    if script in ("<super>", "<sub>") and " " not in code:
        return f"${'^' if script == '<super>' else '_'}{{{chr(int(code, 16))}}}$"
    return char


def table(name: str, shown: Table, caption: str, notes: Iterable[str] = ()) -> str:
    """A table as a float with a caption, whose label is ``tab:NAME``; its notes stand below it."""
    columns = [[row[i] for row in shown.rows] for i in range(len(shown.header))]
    kinds = [_column(cells) for cells in columns]
    head = [_heading(text, kind) for text, (kind, _) in zip(shown.header, kinds, strict=True)]
    body = [[write(cell) for cell, (_, write) in zip(row, kinds, strict=True)] for row in shown.rows]
    shrunk = _is_wide(shown)
    lines = [
        r"\begin{table}",
        r"  \centering",
        f"  \\caption{{{escaped(caption)}}}",
        f"  \\label{{tab:{name}}}",
        *[_SHRUNK] * shrunk,
        f"  \\begin{{tabular}}{{{' '.join(kind for kind, _ in kinds)}}}",
        r"    \toprule",
        _row(head),
        r"    \midrule",
        *map(_row, body),
        r"    \bottomrule",
        r"  \end{tabular}",
        *["  }"] * shrunk,
    ]
    if said := [*map(escaped, (*shown.notes, *notes))]:
        lines += ["", r"  \medskip", r"  \begin{minipage}{\linewidth}\footnotesize"]
        lines += [f"    {note}\\par" for note in said] + [r"  \end{minipage}"]
    return "\n".join([*lines, r"\end{table}", ""])


def caption(shown: Table, trials: int, seed: int) -> str:
    """What stands above a table: its title, how many trials, their seed, and the statistic over them."""
    title = shown.title if shown.title.endswith((".", "?", "!")) else f"{shown.title}."
    statistic = f"; {shown.statistic}" if shown.statistic else ""
    return f"{title} {counted(trials, 'trial')}, seed {seed}{statistic}."


def _is_wide(shown: Table) -> bool:
    """Whether a table would reach beyond the line: by its letters, as LaTeX alone knows their widths."""
    columns = zip(shown.header, *shown.rows, strict=True)
    return sum(max(map(len, column)) + _EDGES for column in columns) > _WIDEST


def _row(cells: Sequence[str]) -> str:
    return f"    {' & '.join(cells)} \\\\"


def _column(cells: Sequence[str]) -> tuple[str, Callable[[str], str]]:
    """What kind of column it is, and what writes its cells: numbers at their decimal points if all are."""
    numbers = [cell for cell in cells if _PLAIN.fullmatch(cell)]
    # Where only some have an exponent, its room would part those from their neighbours.
    alike = len({"e" in number for number in numbers}) == 1
    if alike and all(cell in _EMPTY or _PLAIN.fullmatch(cell) for cell in cells):
        return f"S[table-format={_format(numbers)}]", _plain
    to_left = all(not is_number(cell) for cell in cells)
    return "l" if to_left else "r", _cell


def _plain(cell: str) -> str:
    """A cell among numbers: what is none stands in braces."""
    if not cell or _PLAIN.fullmatch(cell):
        return cell
    return "{--}" if cell == "-" else f"{{{escaped(cell)}}}"


def _heading(text: str, kind: str) -> str:
    return f"{{{escaped(text)}}}" if kind.startswith("S") else escaped(text)


def _format(numbers: Sequence[str]) -> str:
    """The digits before and behind the points of numbers, as siunitx wants to know them."""
    mantissas, exponents = zip(*(number.partition("e")[::2] for number in numbers), strict=True)
    sign = "-" if any(one.startswith("-") for one in mantissas) else ""
    whole = max(len(one.lstrip("+-").partition(".")[0]) for one in mantissas)
    decimals = max(len(one.partition(".")[2]) for one in mantissas)
    digits = f"{sign}{whole}" + (f".{decimals}" if decimals else "")
    if not any(exponents):
        return digits
    minus = "-" if any(one.startswith("-") for one in exponents) else ""
    return f"{digits}e{minus}{max(len(str(abs(int(one or 0)))) for one in exponents)}"


def _cell(cell: str) -> str:
    """A cell of text; one of several numbers has each set by siunitx."""
    pieces = [_piece(piece) for piece in cell.split(" ")]
    if None in pieces or not any(map(_PIECE.fullmatch, cell.split(" "))):
        return "--" if cell == "-" else escaped(cell)
    return " ".join(filter(None, pieces))


def _piece(piece: str) -> str | None:
    """A piece of a cell of numbers; None if it is something else."""
    if piece in _SIGNS:
        return _SIGNS[piece]
    if piece == "-":
        return "--"
    if _PERCENTILE.fullmatch(piece):
        return piece
    found = _PIECE.fullmatch(piece)
    return f"{found['open']}\\num{{{found['number']}}}{found['close']}" if found else None
