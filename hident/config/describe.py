"""Components in words, for ``hident list``."""

from __future__ import annotations

import types
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from hident.config.spec import Component, Of, Spec


def fields(spec: type[Spec], prefix: str = "") -> Iterator[tuple[str, str, str, str]]:
    """Key path, what it holds, default and meaning of every field, nested specs included."""
    for name, field in spec.model_fields.items():
        path = f"{prefix}{name}"
        annotation: Any = field.annotation
        for extra in field.metadata:
            annotation = Annotated[annotation, extra]
        default = (
            "required" if field.is_required() else _default(field.get_default(call_default_factory=True))
        )
        yield path, _holds(annotation), default, (field.description or "").strip()
        inner = _spec_within(annotation)
        if inner is not None:
            yield from fields(inner, f"{path}.")


def _default(value: Any) -> str:
    if isinstance(value, Component):
        return value.kind
    return "none" if value is None else "[]" if value == () else str(value)


def _spec_within(annotation: Any) -> type[Spec] | None:
    """The plain spec that a field holds, alone or in a list."""
    if isinstance(annotation, type) and issubclass(annotation, Spec):
        return None if issubclass(annotation, Component) else annotation
    return next((s for part in get_args(annotation) if (s := _spec_within(part))), None)


def _holds(annotation: Any) -> str:
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        family = next((extra.family for extra in parts[1:] if isinstance(extra, Of)), None)
        return family or _holds(parts[0])
    if origin in (Union, types.UnionType):
        return " or ".join(_holds(part) for part in parts if part is not type(None))
    if origin is Literal:
        return " | ".join(str(part) for part in parts)
    if origin in (tuple, list):
        return (
            f"list of {_holds(parts[0])}" if parts[-1] is Ellipsis else f"[{', '.join(map(_holds, parts))}]"
        )
    if origin is dict:
        return f"mapping to {_holds(parts[1])}"
    names = {float: "number", int: "whole number", bool: "true | false", str: "text"}
    return names.get(annotation, "mapping")
