"""Components in words, for ``hident list``."""

from __future__ import annotations

import types
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic.fields import FieldInfo

from hident.config.meanings import meanings
from hident.config.spec import Component, Of, Spec, own_docstring

_BOUNDS: dict[type, tuple[str, str]] = {
    Gt: (">", "gt"),
    Ge: (">=", "ge"),
    Lt: ("<", "lt"),
    Le: ("<=", "le"),
}
_SCALARS = {float: "number", int: "whole number", bool: "true or false", str: "text", Any: "anything"}


def fields(spec: type[Spec], prefix: str = "") -> Iterator[tuple[str, str, str, str]]:
    """Key path, what it holds, default and meaning of every field, nested specs included.

    A nested spec's docstring follows the meaning of its field; where a field holds one of several specs, it
    stands in a line of its own above the fields of each.
    """
    for name, field in spec.model_fields.items():
        path = f"{prefix}{name}"
        annotation = annotation_of(field)
        default = (
            "required" if field.is_required() else _default(field.get_default(call_default_factory=True))
        )
        alternatives = list(_specs_within(annotation))
        texts = [meanings(spec).get(name, "")]
        if len(alternatives) == 1:
            texts.append(own_docstring(alternatives[0][0]))
        yield path, _holds(annotation), default, " ".join(filter(None, texts))
        for i, (inner, marks) in enumerate(alternatives):
            if len(alternatives) > 1:
                yield f"{path}, {'or' if i else 'either'}", "", "", own_docstring(inner)
            yield from fields(inner, f"{path}{marks}.")


def bounds(field: FieldInfo) -> str:
    """The bounds of a number that a field holds, e.g. `` > 0, < 1``; empty if there are none."""
    holds = _holds(annotation_of(field)).removesuffix(" or mapping")
    return "" if " or " in holds else holds.removeprefix("whole ").removeprefix("number")


def annotation_of(field: FieldInfo) -> Any:
    """The annotation of a field with its marks, as it is written."""
    annotation: Any = field.annotation
    return Annotated[annotation, *field.metadata] if field.metadata else annotation


def _default(value: Any) -> str:
    match value:
        case Component():
            return value.kind
        case Spec():
            return "mapping"
        case None:
            return "none"
        case bool():
            return str(value).lower()
        case tuple():
            return f"[{', '.join(map(_default, value))}]"
        case _:
            return str(value)


def _specs_within(annotation: Any, marks: str = "") -> Iterator[tuple[type[Spec], str]]:
    """The plain specs that a field can hold, with ``[]`` for each list around them."""
    if isinstance(annotation, type) and issubclass(annotation, Spec):
        if not issubclass(annotation, Component):
            yield annotation, marks
        return
    inside = f"{marks}[]" if get_origin(annotation) in (list, tuple) else marks
    for part in get_args(annotation):
        yield from _specs_within(part, inside)


def _holds(annotation: Any) -> str:
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        family = next((extra.family for extra in parts[1:] if isinstance(extra, Of)), None)
        return family or f"{_holds(parts[0])}{_bounds(parts[1:])}"
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(_holds(part) for part in parts if part is not type(None)))
    if origin is Literal:
        return " | ".join(str(part) for part in parts)
    if origin in (tuple, list):
        if origin is list or parts[-1] is Ellipsis:
            return f"list of {_holds(parts[0])}"
        return f"[{', '.join(map(_holds, parts))}]"
    if origin is dict:
        return f"mapping to {_holds(parts[1])}"
    return _SCALARS.get(annotation, "mapping")


def _bounds(extras: Sequence[Any]) -> str:
    """The bounds among the extras of an annotation, e.g. `` > 0, < 1``."""
    metadata = [
        one for extra in extras for one in (extra.metadata if isinstance(extra, FieldInfo) else [extra])
    ]
    found = [
        f"{sign} {getattr(extra, attribute)}"
        for extra in metadata
        for kind, (sign, attribute) in _BOUNDS.items()
        if isinstance(extra, kind)
    ]
    return f" {', '.join(found)}" if found else ""
