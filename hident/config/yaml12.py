"""Strict YAML by the 1.2 core schema, with the place of every key.

``1e-3`` is a number, ``no``, ``off`` and ``12:30`` are texts, and a key that stands twice in a mapping is an
error. PyYAML's own reading, that of YAML 1.1, serves for the syntax only. Of YAML 1.1 the merge key is kept:
``<<: *name`` adds the keys of another mapping, or of each of a list of them, that the mapping does not give
itself; of a list the first counts.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import yaml

from hident.errors import ConfigError

Location = tuple[str | int, ...]
_NULL = re.compile(r"(?:~|null|Null|NULL|)\Z")
_BOOL = re.compile(r"(?:true|True|TRUE|false|False|FALSE)\Z")
_INT = re.compile(r"[-+]?[0-9]+\Z")
_OCTAL = re.compile(r"0o[0-7]+\Z")
_HEX = re.compile(r"0x[0-9a-fA-F]+\Z")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?\Z")
_INFINITE = re.compile(r"([-+]?)\.(?:inf|Inf|INF)\Z")
_NAN = re.compile(r"\.(?:nan|NaN|NAN)\Z")
_MERGE = "<<"
UNREAD = -1
"""In the place of a key: a merge that cannot be read. No list has such an item, and no mapping such a key."""
_DEEPEST = 50
_MOST_VALUES = 200_000
_MOST_DIGITS = 250
LARGEST = 2**18
"""The most bytes of a file: PyYAML takes up to 35 microseconds for each, as in a list of single digits."""
_LONGEST = 2000


class Place(NamedTuple):
    """Where something was written: a line of a file, or line 0 for an option of the command line."""

    line: int
    text: str


class Complaint(NamedTuple):
    """A problem in words, and the line that it is shown in the order of."""

    line: int
    text: str


def error_of(complaints: Iterable[Complaint]) -> ConfigError:
    """One error that lists all complaints, each once, in the order of their lines."""
    ordered = sorted(complaints, key=lambda complaint: complaint.line)
    return ConfigError("\n".join(dict.fromkeys(_readable(complaint.text) for complaint in ordered)))


def _readable(text: str) -> str:
    """The text without its middle, where it quotes something very long."""
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST // 2]} ... {text[-_LONGEST // 2 :]}"


def spelled(location: Location) -> str:
    """A key path in the user's own words: ``cases.samples[2]``."""
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}"
    return text.removeprefix(".")


def shown(value: Any) -> str:
    """A plain value as YAML writes it, texts in quotation marks."""
    match value:
        case None:
            return "null"
        case bool():
            return str(value).lower()
        case float() if not math.isfinite(value):
            return ".nan" if math.isnan(value) else f"{'-' * (value < 0)}.inf"
        case list() | tuple():
            return f"[{', '.join(map(shown, value))}]"
        case Mapping():
            return "a mapping"
        case _:
            return repr(value)


class _Loader(yaml.BaseLoader):
    """PyYAML's loader, which leaves the tags of plain scalars open: its own reading is YAML 1.1."""

    def resolve(self, kind: type[yaml.Node], value: Any, implicit: Any) -> str:
        return ""


class Reader:
    """Plain data from the text of ``name``, with the places of the keys and what is unclear in it."""

    def __init__(self, name: str, *, numbered: bool) -> None:
        self._name, self._numbered = name, numbered
        self._values = 0
        self.places: dict[Location, Place] = {}
        self.complaints: list[Complaint] = []

    def read(self, text: str) -> Any:
        """The data; ConfigError if the text is no YAML, or far too large."""
        too_deep = ConfigError(f"{self._name}: is not valid: it is nested more than {_DEEPEST} deep")
        try:
            node = yaml.compose(text, Loader=_Loader)
        except yaml.reader.ReaderError as error:
            place = self._place(text.count("\n", 0, error.position)).text
            raise ConfigError(
                f"{place}: is not valid YAML: the character U+{error.character:04X} is not allowed"
            ) from None
        except yaml.MarkedYAMLError as error:
            mark = error.problem_mark
            place = self._name if mark is None else self._place(mark.line).text
            # Of an anchor that stands twice, its name is in the context.
            twice = str(error.context).startswith("found duplicate anchor")
            problem = str(error.context).partition(";")[0] if twice else error.problem
            raise ConfigError(f"{place}: is not valid YAML: {problem}") from None
        except RecursionError:
            raise too_deep from None
        return None if node is None else self._plain(node, (), ())

    def _place(self, line: int) -> Place:
        """The place of a line, counted from 0 as PyYAML does."""
        return Place(line + 1, f"{self._name}:{line + 1}") if self._numbered else Place(0, self._name)

    def _complain(self, node: yaml.Node, location: Location, message: str) -> None:
        place = self._place(node.start_mark.line)
        whole = "file" if self._numbered else "value"
        self.complaints.append(
            Complaint(place.line, f"{place.text}: {spelled(location) or whole}: {message}")
        )

    def _plain(self, node: yaml.Node, location: Location, inside: tuple[yaml.Node, ...]) -> Any:
        self.places.setdefault(location, self._place(node.start_mark.line))
        if not self._enters(node, location, inside):
            return None
        inside = (*inside, node)
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, location, inside)
        if isinstance(node, yaml.SequenceNode):
            return [self._plain(item, (*location, i), inside) for i, item in enumerate(node.value)]
        assert isinstance(node, yaml.ScalarNode)
        # A quoted or block scalar is a text.
        return _resolved(node.value) if node.style is None else node.value

    def _count(self, node: yaml.Node) -> None:
        """Count a value, so that anchors cannot make many of few."""
        self._values += 1
        if self._values > _MOST_VALUES:
            place = self._place(node.start_mark.line).text
            raise ConfigError(f"{place}: the file holds more than {_MOST_VALUES} values")

    def _enters(self, node: yaml.Node, location: Location, inside: tuple[yaml.Node, ...]) -> bool:
        """Count a node, and say whether it can be read: it must not stand inside itself."""
        self._count(node)
        if node in inside:
            self._complain(node, location, "an anchor cannot contain itself")
            return False
        if len(inside) == _DEEPEST:
            raise ConfigError(
                f"{self._place(node.start_mark.line).text}: is nested more than {_DEEPEST} deep"
            )
        if node.tag:
            self._complain(node, location, f"the tag {node.tag} is not allowed; quotation marks make a text")
        return True

    def _mapping(
        self, node: yaml.MappingNode, location: Location, inside: tuple[yaml.Node, ...]
    ) -> dict[str, Any]:
        mapping: dict[str, Any] = {}
        for key, (key_node, value_node) in self._pairs(node, location, inside).items():
            at = (*location, key)
            self.places[at] = self._place(key_node.start_mark.line)
            mapping[key] = self._plain(value_node, at, inside)
        return mapping

    def _pairs(
        self, node: yaml.MappingNode, location: Location, inside: tuple[yaml.Node, ...]
    ) -> dict[str, tuple[yaml.Node, yaml.Node]]:
        """The nodes of the keys and values of a mapping, those that it merges included."""
        lines: dict[str, int] = {}
        pairs: dict[str, tuple[yaml.Node, yaml.Node]] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                self._complain(key_node, location, "a key must be plain text")
                continue
            key = key_node.value
            if key in lines:
                first = f" in line {lines[key]}" if self._numbered else ""
                self._complain(key_node, (*location, key), f"this key stands already{first}")
                continue
            lines[key] = key_node.start_mark.line + 1
            # In quotation marks it is a key like any other.
            if key == _MERGE and key_node.style is None:
                sound = len(self.complaints)
                for merged in self._merged(value_node, (*location, key), inside):
                    for name, pair in merged.items():
                        self._count(value_node)
                        pairs.setdefault(name, pair)
                if len(self.complaints) > sound:
                    # It has a place where it cannot be read: what is missing beside it may be in it.
                    self.places[(*location, UNREAD)] = self._place(key_node.start_mark.line)
            else:
                pairs[key] = (key_node, value_node)
        return pairs

    def _merged(
        self, node: yaml.Node, location: Location, inside: tuple[yaml.Node, ...]
    ) -> Iterator[dict[str, tuple[yaml.Node, yaml.Node]]]:
        """The pairs of each mapping that a merge key names."""
        if not self._enters(node, location, inside):
            return
        inside = (*inside, node)
        if isinstance(node, yaml.MappingNode):
            yield self._pairs(node, location[:-1], inside)
        elif isinstance(node, yaml.SequenceNode) and all(isinstance(n, yaml.MappingNode) for n in node.value):
            for i, one in enumerate(node.value):
                if self._enters(one, (*location, i), inside):
                    yield self._pairs(one, location[:-1], (*inside, one))
        else:
            self._complain(node, location, "must be a mapping whose keys are merged, or a list of such")


def _resolved(text: str) -> Any:
    if _NULL.match(text):
        return None
    if _BOOL.match(text):
        return text.lower() == "true"
    if _INT.match(text):
        return _whole(text, 10)
    if _OCTAL.match(text):
        return _whole(text[2:], 8)
    if _HEX.match(text):
        return _whole(text[2:], 16)
    if _FLOAT.match(text):
        return float(text)
    if infinite := _INFINITE.match(text):
        return float(infinite[1] + "inf")
    return float("nan") if _NAN.match(text) else text


def _whole(digits: str, base: int) -> int | float:
    """The number; infinity beyond what a float can hold, as 1e999 is."""
    if len(digits) <= _MOST_DIGITS:
        return int(digits, base)
    return -math.inf if digits.startswith("-") else math.inf
