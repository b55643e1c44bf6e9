"""Reading configurations: strict YAML 1.2, patches, and errors that name file, line and key.

The YAML is read by the 1.2 core schema: ``1e-3`` is a number, ``no``, ``off`` and ``12:30`` are strings,
and a key that stands twice in a mapping is an error.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from hident.config.suggest import did_you_mean, one_of
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


@dataclass(frozen=True)
class Problem:
    """One thing wrong with a configuration: where, at which key, and what."""

    location: Location
    message: str
    value: Any = None


@dataclass(frozen=True)
class Document:
    """The plain data of a configuration, and for each key path the place that it was written at."""

    name: str
    data: dict[str, Any]
    places: Mapping[Location, str] = field(default_factory=dict)

    def place(self, location: Location) -> str:
        """The place of the nearest enclosing key, e.g. ``configs/a.yaml:12``."""
        for length in range(len(location), -1, -1):
            if location[:length] in self.places:
                return self.places[location[:length]]
        return self.name

    def patched(self, path: str, value: Any, place: str) -> Document:
        """A copy with the value at the dotted path replaced.

        Raises
        ------
        ConfigError
            If a key on the way to the last one does not exist; the nearest valid name is given.
        """
        data = dict(self.data)
        location = _put(data, path, value, place)
        places = {at: where for at, where in self.places.items() if at[: len(location)] != location}
        return Document(self.name, data, {**places, location: place})

    def error(self, problems: Iterable[Problem]) -> ConfigError:
        """One error that lists all problems, each once, in the order of their places."""
        lines = [
            f"{self.place(p.location)}: {spelled(p.location) or 'file'}: {p.message}{_got(p.value)}"
            for p in problems
        ]
        return ConfigError("\n".join(dict.fromkeys(lines)))


def spelled(location: Location) -> str:
    """A key path in the user's own words: ``cases.samples[2]``."""
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}"
    return text.removeprefix(".")


def problems_of(error: ValidationError, prefix: Location = ()) -> list[Problem]:
    """Pydantic's errors as problems."""
    quiet = ("is required", "unknown key")
    return [
        Problem(
            (*prefix, *detail["loc"]),
            detail["msg"],
            None if detail["msg"].startswith(quiet) else detail["input"],
        )
        for detail in error.errors()
    ]


def _got(value: Any) -> str:
    if value is None or isinstance(value, Mapping) or (isinstance(value, list) and len(value) > 8):
        return ""
    text = repr(value)
    return f" (got {text if len(text) <= 80 else text[:77] + '...'})"


def read(path: Path) -> Document:
    """Read a configuration file.

    Raises
    ------
    ConfigError
        If the file cannot be read or is no strict YAML mapping; the message names the line.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        near = [str(other) for other in sorted(path.parent.glob("*.yaml"))]
        raise ConfigError(f"{path}: no such file{did_you_mean(str(path), near)}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {_reason(error)}") from None
    places: dict[Location, str] = {}
    data = _parse(text, str(path), places)
    if not isinstance(data, dict):
        raise ConfigError(f"{path}:1: file: must be a mapping of keys to values")
    return Document(str(path), data, places)


def override(document: Document, assignments: Iterable[str]) -> Document:
    """Apply ``--set`` assignments such as ``excitation.high=2*pi``; values are read as YAML."""
    for assignment in assignments:
        path, equals, text = assignment.partition("=")
        if not equals or not path.strip():
            raise ConfigError(f"--set {assignment}: must be of the form key.path=value")
        place = f"--set {assignment}"
        document = document.patched(path.strip(), _parse(text, place, {}), place)
    return document


def _reason(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror.lower()
    return "it is not UTF-8 text" if isinstance(error, UnicodeDecodeError) else str(error)


def _put(data: dict[str, Any], path: str, value: Any, place: str) -> Location:
    """Set the value at the path, copying only the containers on the way; return its location."""
    at: Any = data
    location: Location = ()
    parts = path.split(".")
    for depth, part in enumerate(parts):
        last = depth == len(parts) - 1
        where = spelled(location) or "the file"
        if isinstance(at, list):
            if not part.isdigit() or int(part) >= len(at):
                raise ConfigError(
                    f"{place}: {path}: {where} is a list of {len(at)}, so '{part}' must be one of "
                    f"{one_of(map(str, range(len(at))))}"
                )
            key: str | int = int(part)
        elif isinstance(at, dict):
            key = part
            if not last and part not in at:
                raise ConfigError(
                    f"{place}: {path}: {where} has no key '{part}'{did_you_mean(part, at)} "
                    f"(it has: {one_of(at)})"
                )
        else:
            raise ConfigError(f"{place}: {path}: {where} is {at!r}, which has no key '{part}'")
        location = (*location, key)
        if last:
            at[key] = value
        else:
            inner = at[key]
            # A bare name stands for a component without further keys.
            at[key] = {"kind": inner} if isinstance(inner, str) else copy.copy(inner)
            at = at[key]
    return location


def _parse(text: str, name: str, places: dict[Location, str]) -> Any:
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        line = f":{mark.line + 1}" if mark is not None else ""
        raise ConfigError(f"{name}{line}: is not valid YAML: {error.problem}") from None
    except yaml.YAMLError as error:
        raise ConfigError(f"{name}: is not valid YAML: {' '.join(str(error).split())}") from None
    return None if node is None else _plain(node, name, places, (), ())


def _plain(
    node: yaml.Node,
    name: str,
    places: dict[Location, str],
    location: Location,
    inside: tuple[yaml.Node, ...],
) -> Any:
    here = f"{name}:{node.start_mark.line + 1}"
    places.setdefault(location, here)
    if node in inside:
        raise ConfigError(f"{here}: {spelled(location)}: an anchor cannot contain itself")
    inside = (*inside, node)
    if isinstance(node, yaml.MappingNode):
        mapping: dict[str, Any] = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            if not isinstance(key_node, yaml.ScalarNode):
                raise ConfigError(f"{name}:{line}: {spelled(location)}: a key must be plain text")
            key = key_node.value
            if key in mapping:
                first = places[(*location, key)].rpartition(":")[2]
                raise ConfigError(
                    f"{name}:{line}: {spelled((*location, key))}: this key stands already in line {first}"
                )
            places[(*location, key)] = f"{name}:{line}"
            mapping[key] = _plain(value_node, name, places, (*location, key), inside)
        return mapping
    if isinstance(node, yaml.SequenceNode):
        return [
            _plain(item, name, places, (*location, index), inside) for index, item in enumerate(node.value)
        ]
    assert isinstance(node, yaml.ScalarNode)
    return _scalar(node, here, location)


def _scalar(node: yaml.ScalarNode, here: str, location: Location) -> Any:
    if not node.tag.startswith("tag:yaml.org,2002:"):
        raise ConfigError(f"{here}: {spelled(location)}: the tag {node.tag} is not allowed")
    # A quoted or block scalar is a string; the loader's own YAML 1.1 reading of plain ones is not used.
    return _resolved(node.value) if node.style is None else node.value


def _resolved(text: str) -> Any:
    if _NULL.match(text):
        return None
    if _BOOL.match(text):
        return text.lower() == "true"
    if _INT.match(text):
        return int(text)
    if _OCTAL.match(text):
        return int(text[2:], 8)
    if _HEX.match(text):
        return int(text[2:], 16)
    if _FLOAT.match(text):
        return float(text)
    if infinite := _INFINITE.match(text):
        return float(infinite[1] + "inf")
    return float("nan") if _NAN.match(text) else text
