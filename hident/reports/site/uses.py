"""Which components a configuration names, by what run.json holds of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal, get_args, get_origin

from hident.config.describe import annotation_of
from hident.config.spec import PLURALS, Component, Of, Spec, components
from hident.engine.experiment import Experiment

Named = tuple[str, str, Mapping[str, Any]]
"""A family, a kind, and the fields that are written."""


def named(resolved: Mapping[str, Any]) -> Iterator[Named]:
    """Every component of a configuration, with those inside of others, and those that only some cases have.

    A configuration of another version, or of plugins that are not loaded, gives what is known of it.
    """
    yield from _in_spec(Experiment, resolved)
    for part in ("cases", "alternatives"):
        yield from _wherever(resolved.get(part), part)


def _in_spec(spec: type[Spec], written: Mapping[str, Any]) -> Iterator[Named]:
    for name, field in spec.model_fields.items():
        if written.get(name) is not None:
            yield from _held(annotation_of(field), written[name])


def _held(annotation: Any, value: Any) -> Iterator[Named]:
    """The components that a value holds in the place of such an annotation."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        family = next((extra.family for extra in parts[1:] if isinstance(extra, Of)), None)
        if family is None:
            yield from _held(parts[0], value)
        else:
            yield from _component(family, value)
    elif origin in (list, tuple) and isinstance(value, list | tuple):
        for item in value:
            yield from _held(parts[0], item)
    elif origin is dict and isinstance(value, Mapping):
        for item in value.values():
            yield from _held(parts[1], item)
    elif isinstance(annotation, type) and issubclass(annotation, Spec):
        if isinstance(value, Mapping) and _fits(annotation, value):
            yield from _in_spec(annotation, value)
    elif origin not in (list, tuple, dict, Literal, None):
        for part in parts:
            yield from _held(part, value)


def _component(family: str, value: Any) -> Iterator[Named]:
    value = {"kind": value} if isinstance(value, str) else value
    if isinstance(value, Mapping) and (spec := _spec(family, value.get("kind"))):
        written = {key: item for key, item in value.items() if key != "kind"}
        yield family, spec.kind, written
        yield from _in_spec(spec, written)


def _spec(family: str, kind: Any) -> type[Component] | None:
    return components(family).get(kind) if isinstance(kind, str) else None  # type: ignore[arg-type]


def _fits(spec: type[Spec], written: Mapping[str, Any]) -> bool:
    """Whether a mapping can be this one of several specs: by its keys, and by what tells them apart."""
    return all(
        key in spec.model_fields and _is_allowed(spec.model_fields[key].annotation, value)
        for key, value in written.items()
    )


def _is_allowed(annotation: Any, value: Any) -> bool:
    return get_origin(annotation) is not Literal or value in get_args(annotation)


def _wherever(value: Any, place: str) -> Iterator[Named]:
    """The components in what the labels of axes set: that stands for itself, without the field it is for."""
    if isinstance(value, str):
        families = [family for family in PLURALS.values() if _is_of(family, {"kind": value})]
        if len(families) == 1:
            yield from _component(families[0], value)
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _wherever(item, place)
    elif isinstance(value, Mapping):
        families = [family for family in PLURALS.values() if _is_of(family, value)]
        meant = [family for family in families if family == place.lstrip("$").rpartition(".")[2]]
        if found := meant or families:
            yield from _component(found[0], value)
        else:
            for key, item in value.items():
                yield from _wherever(item, str(key))


def _is_of(family: str, value: Mapping[str, Any]) -> bool:
    """Whether a mapping can be a component of a family: it has the keys that it must and no others."""
    spec = _spec(family, value.get("kind"))
    if spec is None:
        return False
    written = {key: item for key, item in value.items() if key != "kind"}
    required = {name for name, field in spec.model_fields.items() if field.is_required()}
    return required <= written.keys() and _fits(spec, written)
