"""Reading configurations: files, patches to them, and errors that name file, line and key."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hident.config.suggest import did_you_mean, one_of, there_is_no
from hident.config.yaml12 import LARGEST, UNREAD, Complaint, Location, Place, Reader, error_of, shown, spelled
from hident.errors import ConfigError

_ABSENT = object()
# The sections whose entries have names of their own, and what one of them is.
_NAMED = {
    "cases": "axis",
    "estimators": "estimator",
    "metrics": "metric",
    "tables": "table",
    "figures": "figure",
    "alternatives": "alternative",
}


@dataclass(frozen=True)
class Problem:
    """One thing wrong with a configuration: where, at which key, what, and the value that is there."""

    location: Location
    message: str
    value: Any = _ABSENT


@dataclass(frozen=True)
class Document:
    """The plain data of a configuration, and for each key path the place that it was written at.

    ``patches`` holds the places of what was replaced since; ``complaints`` what was wrong with the YAML.
    """

    name: str
    data: dict[str, Any]
    places: Mapping[Location, Place] = field(default_factory=dict)
    patches: Mapping[Location, Place] = field(default_factory=dict)
    complaints: tuple[Complaint, ...] = ()

    def place(self, location: Location) -> Place:
        """The place of the nearest enclosing key, e.g. ``configs/a.yaml:12``."""
        for places in (self.patches, self.places):
            for length in range(len(location), -1, -1):
                if location[:length] in places:
                    return places[location[:length]]
        return Place(0, self.name)

    def patched(self, path: str, value: Any, place: Place) -> Document:
        """A copy with the value at the dotted path replaced.

        ConfigError if a key on the way to the last one does not exist; the nearest valid name is given.
        """
        data = dict(self.data)
        try:
            location = put(data, path, value)
        except ConfigError as error:
            raise ConfigError(f"{place.text}: {error}") from None
        patches = {at: where for at, where in self.patches.items() if at[: len(location)] != location}
        return Document(self.name, data, self.places, {**patches, location: place}, self.complaints)

    def assigned(self, path: str, value: Any, place: Place) -> Document:
        """As :meth:`patched`; null takes an entry that has a name of its own out, or a section of such.

        ConfigError if there is no entry of that name; the nearest one is given.
        """
        try:
            less = self._without(path) if value is None else None
        except ConfigError as error:
            raise ConfigError(f"{place.text}: {path}: {error}") from None
        return less or self.patched(path, value, place)

    def _without(self, path: str) -> Document | None:
        """A copy without a section of named entries, or one of these; None if the path is of neither."""
        section, _, name = path.partition(".")
        if section not in _NAMED:
            return None
        written, data = self.data.get(section, {}), dict(self.data)
        if not name:
            data.pop(section, None)
        elif not isinstance(written, Mapping):
            return None
        elif name in written:
            data[section] = {key: value for key, value in written.items() if key != name}
        elif "." in name:
            return None
        else:
            raise ConfigError(there_is_no(_NAMED[section], name, written))
        return Document(self.name, data, self.places, self.patches, self.complaints)

    def complaints_of(self, problems: Iterable[Problem]) -> list[Complaint]:
        """The problems in words, each with its place and key path.

        What is missing beside a merge that cannot be read is no problem of its own.
        """
        found = []
        for problem in problems:
            if problem.message.startswith("is required") and (*problem.location[:-1], UNREAD) in self.places:
                continue
            place = self.place(problem.location)
            # What was written in Python is no file.
            at = spelled(problem.location) or ("file" if self.places else "")
            said = f"{problem.message}{_got(problem)}"
            found.append(Complaint(place.line, ": ".join(filter(None, (place.text, at, said)))))
        return found

    def error(self, problems: Iterable[Problem]) -> ConfigError:
        """One error that lists all problems; see :func:`error_of`."""
        return error_of(self.complaints_of(problems))


def problems_of(error: ValidationError, prefix: Location = ()) -> list[Problem]:
    """Pydantic's errors as problems."""
    return [
        Problem((*prefix, *detail["loc"]), detail["msg"].removeprefix("Value error, "), detail["input"])
        for detail in error.errors()
    ]


def _got(problem: Problem) -> str:
    value, message = problem.value, problem.message
    if value is _ABSENT or message.startswith(("is required", "unknown key")):
        return ""
    if isinstance(value, Mapping) and not message.startswith("must be"):
        # What is wrong lies inside, and the message says it.
        return ""
    text = shown(value)
    if isinstance(value, str) and text in message:
        return ""
    return f" (got {text if len(text) <= 80 else text[:77] + '...'})"


def content_of(path: Path) -> bytes | None:
    """The bytes of a file, None if there is none; ConfigError if it cannot be read."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from None


def read(path: Path, content: bytes | None = None) -> Document:
    """Read a YAML file, or its content if that is known.

    ConfigError if the file cannot be read or is no strict YAML mapping; the message names the line.
    """
    document = read_leniently(path, content)
    if document.complaints:
        raise error_of(document.complaints)
    return document


def read_leniently(path: Path, content: bytes | None = None) -> Document:
    """Read a YAML file, or its content; what is no more than unclear goes to the document's complaints.

    ConfigError if the file cannot be read or is no YAML mapping at all.
    """
    try:
        if content is None:
            with path.open("rb") as file:
                content = file.read(LARGEST + 1)
        if len(content) > LARGEST:
            raise ConfigError(
                f"{path}: cannot be read: it is larger than {LARGEST // 1024} kB, "
                "the most that a file of YAML may have"
            )
        text = content.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
    except FileNotFoundError:
        near = [str(other) for other in sorted(path.parent.glob("*.yaml"))]
        if path.parent == Path() and not path.suffix:
            # A bare name is that of a file under configs/.
            near += [other.stem for other in sorted(Path("configs").glob("*.yaml"))]
            if not near and not Path("configs").is_dir():
                raise ConfigError(
                    f"{path}: no such file, and no folder configs is here, in which such a name is looked "
                    "for: run hident in the folder that holds it, or give the path of a file"
                ) from None
        raise ConfigError(f"{path}: no such file{did_you_mean(str(path), near)}") from None
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise ConfigError(f"{path}:{line}: cannot be read: it is not UTF-8 text") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    reader = Reader(str(path), numbered=True)
    data = reader.read(text)
    if not isinstance(data, dict):
        found = "empty" if data is None else "a list" if isinstance(data, list) else shown(data)
        raise ConfigError(f"{path}:1: file: must be a mapping of keys to values, but it is {found}")
    return Document(str(path), data, reader.places, complaints=tuple(reader.complaints))


def override(document: Document, assignments: Iterable[str]) -> Document:
    """Apply ``--set`` assignments such as ``excitation.high=2*pi``; values are read as YAML.

    Null takes an entry that has a name of its own out of the file, as in ``figures.wide=null``, or all of a
    section.

    ConfigError with all assignments that cannot be read or whose path leads nowhere.
    """
    errors: list[str] = []
    for assignment in assignments:
        try:
            document = _assigned(document, assignment)
        except ConfigError as error:
            errors.append(str(error))
    if errors:
        raise ConfigError("\n".join(errors))
    return document


def _assigned(document: Document, assignment: str) -> Document:
    path, text = split_assignment(document, assignment)
    place = Place(0, f"--set {assignment}")
    if not path:
        raise ConfigError(f"{place.text}: must be of the form key.path=value")
    reader = Reader(place.text, numbered=False)
    value = reader.read(text)
    if reader.complaints:
        raise error_of(reader.complaints)
    return document.assigned(path, value, place)


def split_assignment(document: Document, assignment: str) -> tuple[str, str]:
    """The key path and the text of the value of a ``--set`` assignment; no path if it is none.

    Names in a path may hold equals signs, as texts may: of all ways to split, the one whose path leads
    furthest along keys of the document is meant, and the first of several.
    """
    parts = assignment.split("=")
    ways = [("=".join(parts[:i]).strip(), "=".join(parts[i:])) for i in range(1, len(parts))]
    ways = [way for way in ways if way[0]]
    return max(ways, key=lambda way: _known(document.data, way[0].split(".")), default=("", ""))


def _known(document: dict[str, Any], path: list[str]) -> int:
    """The length of the part of a path that leads along keys; the name of a new axis is a path itself."""
    at: Any = document
    rest = path
    while rest:
        key, left = _first_key(at, rest)
        if key is None:
            break
        at, rest = at[key], left
    found = path[: len(path) - len(rest)]
    return len(".".join(found)) + (_known(document, rest) if rest and found == ["cases"] else 0)


def _first_key(at: Any, path: list[str]) -> tuple[str | int | None, list[str]]:
    """The key of a container that a path begins with, if there is one, and what is left of the path."""
    if isinstance(at, list):
        at = {str(i): i for i in range(len(at))}
        return at.get(path[0]), path[1:]
    # A key may hold dots itself, such as an axis: the longest that fits is meant.
    names = (".".join(path[:length]) for length in range(len(path), 0, -1))
    key = next((name for name in names if isinstance(at, Mapping) and name in at), None)
    return key, path[1 + (key or "").count(".") :]


def put(data: dict[str, Any], path: str, value: Any) -> Location:
    """Set the value at the path, copying only the containers on the way; return its location.

    ConfigError if a key on the way to the last one does not exist.
    """
    at: Any = data
    location: Location = ()
    rest = path.split(".")
    if rest[0] == "cases" and rest[1:]:
        data.setdefault("cases", {})
    while True:
        key, left = _first_key(at, rest)
        if key is None:
            # A new key; the name of a new axis holds all that is left.
            key, left = (path.partition(".")[2], []) if location == ("cases",) else (rest[0], rest[1:])
            if left or not isinstance(at, dict):
                raise ConfigError(f"{path}: {spelled(location) or 'the file'} {_lacks(at, key)}")
        location = (*location, key)
        if not left:
            at[key] = value
            return location
        # A bare name stands for a component without further keys.
        at[key] = {"kind": at[key]} if isinstance(at[key], str) else copy.copy(at[key])
        at, rest = at[key], left


def _lacks(at: Any, key: str) -> str:
    """What to say of a value without the key that a path leads along."""
    if isinstance(at, list):
        allowed = f"one of {one_of(map(str, range(len(at))))}" if at else "left out"
        return f"is a list of {len(at)}, so '{key}' must be {allowed}"
    if isinstance(at, dict):
        return f"has no key '{key}'{did_you_mean(key, at)} (it has: {one_of(at)})"
    return f"is {shown(at)}, which has no key '{key}'"
