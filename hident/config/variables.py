"""Variables in texts: ``$name`` stands for a value, ``${any name}`` too, and ``$$`` for a dollar sign.

What stands between two dollar signs, as mathematics does in labels (``$a_1$``), stays as it is: no blank
follows the first or precedes the second, and no letter, digit or brace follows the second.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from hident.config.expression import FormulaError, number
from hident.config.suggest import there_is_no
from hident.config.yaml12 import Location, shown

_TOKEN = re.compile(
    r"(?P<dollar>\$\$)"
    r"|\$\{(?P<braced>[^{}$]+)\}"
    r"|(?P<mathematics>\$(?=\S)[^$]*(?<=\S)\$(?![\w{]))"
    r"|\$(?P<bare>[A-Za-z_]\w*)"
)
_LARGEST_WHOLE = 2**53


def texts(value: Any, location: Location = (), *, keys: bool = False) -> Iterator[tuple[Location, str]]:
    """All texts in plain data, those of keys if they are asked for, each with its location."""
    if isinstance(value, str):
        yield location, value
    elif isinstance(value, Mapping):
        for key, item in value.items():
            if keys:
                yield (*location, key), key
            yield from texts(item, (*location, key), keys=keys)
    elif isinstance(value, list):
        for i, item in enumerate(value):
            yield from texts(item, (*location, i), keys=keys)


def variables_in(text: str) -> tuple[str, ...]:
    """The names of the variables of a text."""
    found = (token["braced"] or token["bare"] for token in _TOKEN.finditer(text))
    return tuple(name for name in found if name)


def stands_alone(text: str) -> bool:
    """Whether a text is one variable and nothing else, so that a value of any type can take its place."""
    token = _TOKEN.fullmatch(text)
    return token is not None and bool(token["braced"] or token["bare"])


def filled(value: Any, values: Mapping[str, Any], *, partly: bool = False) -> Any:
    """Plain data with the values of variables in the place of their names.

    A text around a variable that makes a formula of numbers, such as ``749*$periods``, is that number.
    Variables without a value stay; ``partly``: so does ``$$``, as others are to be filled in later.
    """
    if isinstance(value, str):
        return _filled(value, values, partly)
    if isinstance(value, Mapping):
        return {key: filled(item, values, partly=partly) for key, item in value.items()}
    if isinstance(value, list):
        return [filled(item, values, partly=partly) for item in value]
    return value


def labelled(text: str, values: Mapping[str, Any]) -> Any:
    """A text of a table or a figure with the values of its variables, which all have one."""
    if stands_alone(text):
        return values[variables_in(text)[0]]
    return _replaced(text, lambda name: _plain(values[name]))


def unknown(name: str, known: Iterable[str], what: str) -> str:
    """The message about a variable that has no value; ``what`` could have given it one."""
    return f"{there_is_no(what, name, known)}; for the text '${name}' write '$${name}'"


def cannot_join(name: str, value: Any) -> str:
    """The message about a value that can only stand alone, see :func:`stuck`."""
    return f"'${name}' is {shown(value)}, which cannot stand inside a text"


def stuck(value: Any) -> bool:
    """Whether a value can only stand alone, and not inside a text."""
    return isinstance(value, list | Mapping) or value is None


def _filled(text: str, values: Mapping[str, Any], partly: bool) -> Any:
    names = variables_in(text)
    known = [name for name in names if name in values]
    if not known and (partly or "$$" not in text):
        return text
    if known and stands_alone(text):
        return values[known[0]]
    done = _replaced(
        text, lambda name: _in_formula(values[name]) if name in values else None, keep_dollars=partly
    )
    if not known or len(known) < len(names):
        return done
    try:
        result = number(done)
    except FormulaError:
        return done
    return int(result) if result.is_integer() and abs(result) < _LARGEST_WHOLE else result


def _replaced(text: str, value_of: Any, *, keep_dollars: bool = False) -> str:
    def replacement(token: re.Match[str]) -> str:
        if token["dollar"]:
            return token[0] if keep_dollars else "$"
        name = token["braced"] or token["bare"]
        value = value_of(name) if name else None
        return token[0] if value is None else value

    return _TOKEN.sub(replacement, text)


def _plain(value: Any) -> str:
    return value if isinstance(value, str) else shown(value)


def _in_formula(value: Any) -> str:
    """A value inside a text; what is more than digits keeps together, as -1 in ``$x**2`` must."""
    text = _plain(value)
    try:
        number(text)
    except FormulaError:
        return text
    return text if re.fullmatch(r"[\w.]+", text) else f"({text})"
