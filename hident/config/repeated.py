"""Entries that stand for several: ``each`` names variables with their values, and the entry is repeated.

An entry is a mapping in a list, or one under a name that holds a variable. In a list of a table, a figure or
the printed numbers, a list where one text belongs is a variable too, by the name of its key: from
``{estimator: [x, y], metric: [a, b], header: "$estimator: $metric"}`` come four columns. The variables vary
in the order in which they stand, the first the slowest.
"""

from __future__ import annotations

import itertools
import math
import types
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Union, get_args, get_origin

from hident.config.describe import annotation_of
from hident.config.load import Document, Problem
from hident.config.spec import Component, Of, Spec, components
from hident.config.variables import (
    cannot_join,
    filled,
    labelled,
    stands_alone,
    stuck,
    texts,
    unknown,
    variables_in,
)
from hident.config.yaml12 import Complaint, Location, Place

EACH = "each"
_REPORTS = ("tables", "figures", "published")
_MOST = 10_000
_Varied = tuple[tuple[str, ...], list[tuple[Any, ...]]]
"""Variables that vary together, and the values that they take together."""
_FORM = "must be variables with their lists, as 'each: {name: [1, 2]}' or 'each: {a, b: [[1, x], [2, y]]}'"


def repeated(
    document: Document, model: type[Spec], complaints: list[Complaint], *, untouched: tuple[str, ...] = ()
) -> Document:
    """The document with every entry that stands for several repeated; what is wrong goes to ``complaints``.

    ``model`` says what each key holds; keys of the file in ``untouched`` stay as they are.
    """
    work = _Repetition(document, complaints)
    data, places = dict(document.data), dict(document.places)
    for name, section in document.data.items():
        if name in untouched or not isinstance(section, list | Mapping):
            continue
        field = model.model_fields.get(name)
        annotation = None if field is None else annotation_of(field)
        work.begin(listed=name in _REPORTS)
        found = work.whole(section, annotation, (name,), (name,))
        if found != section:
            data[name] = found
            places.update(work.places)
    changed = {name for name, section in document.data.items() if data[name] != section}
    patches = {at: place for at, place in document.patches.items() if not at or at[0] not in changed}
    return Document(document.name, data, places, patches, document.complaints)


@dataclass(frozen=True)
class _Slot:
    """The place of a list that is a variable."""

    name: str


class _Repetition:
    def __init__(self, document: Document, complaints: list[Complaint]) -> None:
        self._document, self._complaints = document, complaints
        self._count = 0

    def begin(self, *, listed: bool) -> None:
        """Turn to a section; ``listed``: lists where a text belongs are variables."""
        self._listed = listed
        self.places: dict[Location, Place] = {}

    def whole(
        self,
        value: Any,
        annotation: Any,
        old: Location,
        new: Location,
        values: Mapping[str, Any] = types.MappingProxyType({}),
    ) -> Any:
        """A value with its entries repeated; it stood at ``old`` and stands at ``new``."""
        self.places[new] = self._document.place(old)
        if isinstance(value, _Slot):
            return values[value.name]
        if isinstance(value, str):
            return self._text(value, old, values, listed=self._listed)
        if isinstance(value, Mapping):
            found: dict[str, Any] = {}
            inside, named = _fields(annotation, value), _is_mapping(annotation)
            for key, item in value.items():
                each = named and _is_spec(inside[key]) and isinstance(item, Mapping) and EACH in item
                if each:
                    entries = self._named(key, item, (*old, key), values)
                else:
                    entries = iter([(self._key(key, (*old, key), values) if named else key, item, values)])
                for name, entry, of_entry in entries:
                    if name in found:
                        self._complain(
                            (*old, key), f"the name '{name}' stands twice: it must hold each variable"
                        )
                    found[name] = self.whole(entry, inside.get(key), (*old, key), (*new, name), of_entry)
            return found
        if isinstance(value, list):
            items: list[Any] = []
            inner = _item(annotation)
            for i, item in enumerate(value):
                for entry, of_entry in self._entries(item, inner, (*old, i), values):
                    items.append(self.whole(entry, inner, (*old, i), (*new, len(items)), of_entry))
            return items
        return value

    def _text(self, text: str, old: Location, values: Mapping[str, Any], *, listed: bool) -> Any:
        """A text with its variables filled in; ``listed``: nothing else fills in what is left."""
        if not values:
            return text
        for name in variables_in(text):
            if listed and name not in values:
                self._complain(old, unknown(name, values, "variable"))
                return text
            if stuck(values.get(name, "")) and not stands_alone(text):
                self._complain(old, cannot_join(name, values[name]))
                return text
        return labelled(text, values) if listed else filled(text, values, partly=True)

    def _key(self, key: str, old: Location, values: Mapping[str, Any]) -> str:
        return str(self._text(key, old, values, listed=True))

    def _named(
        self, key: str, item: Mapping[str, Any], old: Location, values: Mapping[str, Any]
    ) -> Iterator[tuple[str, Any, Mapping[str, Any]]]:
        """An entry under a name, under each of the names that it stands for."""
        rest = {name: inner for name, inner in item.items() if name != EACH}
        for chosen in self._product(self._each(item[EACH], [key, rest], old), old):
            known = {**values, **chosen}
            yield self._key(key, old, known), rest, known

    def _entries(
        self, item: Any, annotation: Any, old: Location, values: Mapping[str, Any]
    ) -> Iterator[tuple[Any, Mapping[str, Any]]]:
        """An item of a list, once for each choice of its variables."""
        if not isinstance(item, Mapping) or not _is_spec(annotation):
            yield item, values
            return
        inside = _fields(annotation, item) if self._listed and _is_plain(annotation) else {}
        rest: dict[str, Any] = {}
        varied: list[_Varied] = []
        for key, value in item.items():
            if key == EACH:
                others = {name: inner for name, inner in item.items() if name != EACH}
                varied += self._each(value, others, old)
            else:
                rest[key] = _slotted(key, value, inside.get(key), varied)
        twice = [n for n, c in Counter(n for names, _ in varied for n in names).items() if c > 1]
        for name in twice:
            self._complain(old, f"the variable '{name}' has two lists: write '${name}' in the place of one")
        for chosen in () if twice else self._product(varied, old):
            yield rest, {**values, **chosen}

    def _each(self, written: Any, entry: Any, old: Location) -> list[_Varied]:
        """The variables of an entry that ``each`` names."""
        found: list[_Varied] = []
        for key, lists in written.items() if isinstance(written, Mapping) else [("", None)]:
            names = tuple(name.strip() for name in key.split(","))
            rows = lists if isinstance(lists, list) else []
            joint = [tuple(row) if names[1:] and isinstance(row, list) else (row,) for row in rows]
            if not all(names) or not joint or any(len(row) != len(names) for row in joint):
                self._complain((*old, EACH, key) if key else (*old, EACH), _FORM)
                continue
            found.append((names, joint))
            used = {name for _, text in texts(entry, keys=True) for name in variables_in(text)}
            for name in names:
                if name not in used:
                    self._complain((*old, EACH, key), f"nothing uses '${name}'")
        return found

    def _product(self, varied: list[_Varied], old: Location) -> Iterator[dict[str, Any]]:
        """The values of the variables, the first varying the slowest."""
        self._count += math.prod(len(rows) for _, rows in varied)
        if self._count > _MOST:
            self._complain(old, f"expands to more than {_MOST} entries")
            return
        for rows in itertools.product(*(rows for _, rows in varied)):
            pairs = zip((names for names, _ in varied), rows, strict=True)
            yield {n: value for names, row in pairs for n, value in zip(names, row, strict=True)}

    def _complain(self, location: Location, message: str) -> None:
        self._complaints += self._document.complaints_of([Problem(location, message)])


def _slotted(key: str, value: Any, annotation: Any, varied: list[_Varied]) -> Any:
    """A value with a slot for each list where one text belongs; the lists join the variables."""
    if isinstance(value, list) and value and not _takes_lists(annotation):
        varied.append(((key,), [(one,) for one in value]))
        return _Slot(key)
    if isinstance(value, Mapping) and (_is_plain(annotation) or _is_mapping(annotation)):
        inside = _fields(annotation, value)
        return {name: _slotted(name, item, inside.get(name), varied) for name, item in value.items()}
    return value


def _alternatives(annotation: Any) -> tuple[Any, ...]:
    """What an annotation allows, without its marks."""
    origin = get_origin(annotation)
    if origin is Annotated:
        return _alternatives(get_args(annotation)[0])
    if origin in (Union, types.UnionType):
        return tuple(itertools.chain.from_iterable(map(_alternatives, get_args(annotation))))
    return (annotation,)


def _is_spec(annotation: Any) -> bool:
    return any(isinstance(one, type) and issubclass(one, Spec) for one in _alternatives(annotation))


def _is_plain(annotation: Any) -> bool:
    """Whether it is a spec that is no component."""
    return any(
        isinstance(one, type) and issubclass(one, Spec) and not issubclass(one, Component)
        for one in _alternatives(annotation)
    )


def _is_mapping(annotation: Any) -> bool:
    return any(get_origin(one) is dict for one in _alternatives(annotation))


def _takes_lists(annotation: Any) -> bool:
    if annotation is None:
        return True
    return any(one is Any or get_origin(one) in (list, tuple) for one in _alternatives(annotation))


def _item(annotation: Any) -> Any:
    """What the items of a list hold."""
    for one in _alternatives(annotation):
        if get_origin(one) in (list, tuple):
            return get_args(one)[0]
    return None


def _fields(annotation: Any, value: Mapping[str, Any]) -> Mapping[str, Any]:
    """What stands under each key of a mapping."""
    if get_origin(annotation) in (Union, types.UnionType):
        return next(filter(None, (_fields(one, value) for one in get_args(annotation))), {})
    if get_origin(annotation) is Annotated:
        for mark in get_args(annotation)[1:]:
            if isinstance(mark, Of):
                cls = components(mark.family).get(str(value.get("kind")))
                return {} if cls is None else _fields(cls, value)
    for one in _alternatives(annotation):
        if isinstance(one, type) and issubclass(one, Spec):
            return {name: annotation_of(field) for name, field in one.model_fields.items()}
        if get_origin(one) is dict:
            # Labels of axes are any value, but no list.
            return dict.fromkeys(value, str if get_args(one)[1] is Any else get_args(one)[1])
    return {}
