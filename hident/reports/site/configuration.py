"""A configuration as YAML, with a link from each key to the place that explains it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

from pydantic import ValidationError

from hident.config.spec import Component, Spec
from hident.engine.experiment import Experiment
from hident.errors import HidentError
from hident.reports.site.pages import FILE_PAGE, component_page, key_anchor

_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(?: [A-Za-z0-9_]+)*")
# YAML's words for what is no text, which other readers may take so too.
_WORDS = {"true", "false", "null", "yes", "no", "on", "off", "y", "n", "nan", "inf"}
_WIDTH = 88
MOST_LINES = 900
"""Lines of a configuration that a page shows; run.json has all."""
_LONGEST = 4000
"""Letters of one value."""


@dataclass(frozen=True)
class Line:
    """One line: what stands before the key, the key, where it is explained, and what stands behind it."""

    before: str
    key: str
    target: str
    """The page and the anchor; empty where there is none."""
    after: str


def lines(resolved: Mapping[str, Any]) -> list[Line]:
    """The lines of a configuration, at most :data:`MOST_LINES`.

    They have no links where its components are not known here.
    """
    try:
        spec: Spec | None = Experiment.model_validate(resolved)
    except (ValidationError, HidentError, ValueError):
        spec = None
    return list(islice(_mapping(resolved, spec, FILE_PAGE, "", "", ""), MOST_LINES))


def _mapping(
    value: Mapping[str, Any], spec: Any, page: str, path: str, indent: str, first: str
) -> Iterator[Line]:
    """The lines of a mapping; ``first`` stands before the first of them in the place of the indent."""
    for i, (key, inner) in enumerate(value.items()):
        before = first if i == 0 and first else indent
        if isinstance(spec, Spec):
            own = getattr(spec, key, None)
            # The kind is explained by the page as a whole.
            target = page if key == "kind" else f"{page}#{key_anchor(path + key)}"
        else:
            own = spec.get(key) if isinstance(spec, Mapping) else None
            target = ""
        below = path + key + "." if isinstance(spec, Spec) else path
        yield from _entry(before, key, target, inner, own, page, below, indent)


def _entry(
    before: str, key: str, target: str, value: Any, spec: Any, page: str, path: str, indent: str
) -> Iterator[Line]:
    name = _text(key)
    if isinstance(spec, Component):
        page, path = component_page(spec.family, spec.kind), ""
    inline = _inline(value)
    if inline is not None and (len(indent) + len(name) + len(inline) < _WIDTH) and not _holds_keys(value):
        yield Line(before, name, target, f": {inline}")
    elif isinstance(value, Mapping):
        yield Line(before, name, target, ":")
        yield from _mapping(value, spec, page, path, indent + "  ", "")
    elif isinstance(value, Sequence) and not isinstance(value, str):
        yield Line(before, name, target, ":")
        specs = spec if isinstance(spec, list | tuple) and len(spec) == len(value) else [None] * len(value)
        for item, own in zip(value, specs, strict=True):
            yield from _item(item, own, page, path, indent + "  ")
    else:
        yield Line(before, name, target, f": {_short(inline or '')}")


def _item(value: Any, spec: Any, page: str, path: str, indent: str) -> Iterator[Line]:
    if isinstance(spec, Component):
        page, path = component_page(spec.family, spec.kind), ""
    if isinstance(value, Mapping) and value:
        yield from _mapping(value, spec, page, path, indent + "  ", f"{indent}- ")
    else:
        yield Line(f"{indent}- {_short(json.dumps(value, ensure_ascii=False))}", "", "", "")


def _holds_keys(value: Any) -> bool:
    """Whether there is a mapping inside."""
    if isinstance(value, Mapping):
        return bool(value)
    return isinstance(value, list | tuple) and any(map(_holds_keys, value))


def _inline(value: Any) -> str | None:
    """A value in one line; None for what is too long for that."""
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, Mapping | list | tuple):
        return json.dumps(value, ensure_ascii=False)
    return json.dumps(value)


def _short(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"


def _text(text: str) -> str:
    plain = _PLAIN.fullmatch(text) and text.lower() not in _WORDS
    return text if plain else json.dumps(text, ensure_ascii=False)
