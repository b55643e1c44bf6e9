"""Formulas that are written as plain text, as HTML with raised and lowered indices."""

from __future__ import annotations

import re
from html import escape

_NAMES = (
    "alpha beta gamma delta epsilon zeta eta theta kappa lambda mu nu xi pi rho sigma tau phi chi psi omega "
    "Gamma Theta Phi Psi"
)
_GREEK = dict(
    zip(
        _NAMES.split(),
        "αβγδεζηθκλμνξπρστφχψωΓΘΦΨ",
        strict=True,
    )
)
_SIGNS = {
    "<=": "≤",
    ">=": "≥",
    "!=": "≠",
    "->": "→",
    "+-": "±",
    "-": "\N{MINUS SIGN}",
    "'": "\N{PRIME}",
    "...": "…",
}

_ACCENTS = {
    "hat": "\N{COMBINING CIRCUMFLEX ACCENT}",
    "check": "\N{COMBINING CARON}",
    "bar": "\N{COMBINING MACRON}",
    "tilde": "\N{COMBINING TILDE}",
}
"""What stands above a symbol, as in W_check."""
_WORD = "|".join(_GREEK)
# What an index says: in braces or brackets, a number, or a few letters. A longer one is part of a name.
_BRACKETS = r"\((?:[^()]|\([^()]*\))*\)"
_ACCENT = rf"(?:{'|'.join(_ACCENTS)})(?![A-Za-z0-9])"
_INDEX = rf"{_ACCENT}|\{{[^{{}}]*\}}|{_BRACKETS}|-?\d+(?![A-Za-z0-9_])|[A-Za-z0-9]{{1,3}}(?![A-Za-z0-9_])"
# A fraction is a power where it has a sign or is 1/n: x^2/2 is half of x^2.
_POWER = rf"\{{[^{{}}]*\}}|-?{_BRACKETS}|-\d+(?:\.\d+)?(?:/\d+)?|1/\d+|\d+(?:\.\d+)?|-?[A-Za-z]+"
_TAIL = rf"(?:_(?:{_INDEX})|\^(?:{_POWER}))+"
_SUFFIX = re.compile(rf"_(?P<sub>{_INDEX})|\^(?P<sup>{_POWER})")
_IN_WORDS = re.compile(
    rf"(?<![A-Za-z0-9_\\.])(?<![A-Za-z0-9]-)(?P<base>{_WORD}|sum|pK|cm|[A-Za-z]|\d+)"
    rf"(?P<tail>{_TAIL})(?![A-Za-z0-9_])"
    rf"|(?<=[)\]|])(?P<power>\^(?:{_POWER}))"
)
_IN_FORMULAS = re.compile(
    rf"(?P<base>[A-Za-z]+|\d+(?:\.\d+)?)?(?P<tail>{_TAIL})"
    r"|(?P<word>[A-Za-z]{2,}(?:-[A-Za-z]{2,})*|[A-Za-z])"
    r"|(?P<sign><=|>=|!=|->|\+-|\.\.\.|-|')"
)
# The order of a derivative keeps its brackets, as in y^(n).
_ORDER = re.compile(r"\((?:[a-z]|\d)\)")


def in_words(text: str) -> str:
    """A sentence, escaped, with the indices and powers of its symbols set as such.

    Symbols are single letters, Greek ones by their names, and numbers; an index of more than three letters
    is part of a name.

    Examples
    --------
    >>> in_words("W = W_check, sigma_z^2=1")
    'W = <var>W̌</var>, σ<sub>z</sub><sup>2</sup>=1'
    >>> in_words("h_N = h0 N^-1/5 for known_point & x_label")
    '<var>h</var><sub>N</sub> = h0 <var>N</var><sup>−1/5</sup> for known_point &amp; x_label'
    """
    found, last = [], 0
    for match in _IN_WORDS.finditer(text):
        found += [
            escape(text[last : match.start()]),
            _symbol(match["base"] or "", match["tail"] or match["power"]),
        ]
        last = match.end()
    return "".join([*found, escape(text[last:])])


def formula(text: str) -> str:
    """A formula of one or more lines, escaped: letters in italics, Greek ones as letters, signs as such.

    Examples
    --------
    >>> formula("sum_k psi_k y_k >= 0")
    '∑<sub>k</sub> ψ<sub>k</sub> <var>y</var><sub>k</sub> ≥ 0'
    """
    found, last = [], 0
    for match in _IN_FORMULAS.finditer(text):
        found.append(escape(text[last : match.start()]))
        if match["tail"]:
            found.append(_symbol(match["base"] or "", match["tail"]))
        else:
            found.append(_SIGNS[match["sign"]] if match["sign"] else _name(match["word"]))
        last = match.end()
    return "".join([*found, escape(text[last:])])


def _symbol(base: str, tail: str) -> str:
    above, suffixes = "", ""
    for match in _SUFFIX.finditer(tail):
        [(tag, said)] = [(tag, said) for tag, said in match.groupdict().items() if said]
        if tag == "sub" and said in _ACCENTS:
            above += _ACCENTS[said]
        else:
            suffixes += f"<{tag}>{_said(said, tag)}</{tag}>"
    return ("∑" if base == "sum" else _name(base, above)) + suffixes


def _name(word: str, above: str = "") -> str:
    if word in _GREEK:
        return _GREEK[word] + above
    return f"<var>{word}{above}</var>" if len(word) == 1 and word.isalpha() else escape(word) + above


def _said(said: str, tag: str) -> str:
    """What an index or a power says, without the brackets that only hold it together."""
    if said[0] == "{" or (said[0] == "(" and not (tag == "sup" and _ORDER.fullmatch(said))):
        said = said[1:-1]
    return said if said.isascii() and said.isalnum() and said not in _GREEK else formula(said)
