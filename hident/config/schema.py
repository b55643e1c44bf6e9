"""The JSON Schema of configurations, for editors.

In the place of every value a variable may stand, an entry may have ``each``, and in tables and figures a list
may stand in the place of a text; what these give is only seen when the file is loaded.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from hident.config.spec import FAMILY_KEY, PLURALS, Spec, components

_VARIABLE = "variable"
_EACH = "each"
# Pydantic leaves the bounds of a field with a validator of its own under its own names.
_BOUNDS = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}


def json_schema(model: type[Spec], varied: Iterable[str] = ()) -> dict[str, Any]:
    """The JSON Schema of a model, with every registered component of each family it can hold.

    ``varied``: the keys of the model in the place of whose values a variable can stand.
    """
    definitions: dict[str, Any] = {
        _VARIABLE: {"type": "string", "pattern": "[$]", "description": "A variable, as in $name."},
        _EACH: {
            "type": "object",
            "additionalProperties": {"type": "array"},
            "description": "Variables with their lists: the entry stands for one of each choice.",
        },
    }

    def linked(node: Any) -> Any:
        if isinstance(node, list):
            return [linked(item) for item in node]
        if not isinstance(node, dict):
            return node
        if FAMILY_KEY in node:
            rest = {key: linked(item) for key, item in node.items() if key != FAMILY_KEY}
            return {**rest, "$ref": f"#/$defs/{node[FAMILY_KEY]}"}
        # A field may have the name of a bound; its schema is a mapping, the bound a number.
        return {
            key if isinstance(item, dict) else _BOUNDS.get(key, key): linked(item)
            for key, item in node.items()
        }

    def schema_of(cls: type[Spec], *, lists: bool) -> dict[str, Any]:
        schema = linked(cls.model_json_schema())
        for name, inner in schema.pop("$defs", {}).items():
            definitions[name] = _entry(inner, lists=lists)
        return dict(schema)

    top = schema_of(model, lists=True)
    top["properties"] |= {name: _or_variable(top["properties"][name]) for name in varied}
    for family in PLURALS.values():
        options: list[dict[str, Any]] = []
        for kind, cls in components(family).items():
            report = family in ("table", "figure")
            every = ("of", "estimators") if report else ("of",)
            schema = _entry(schema_of(cls, lists=report), lists=False, every=every)
            schema["properties"] = {"kind": {"const": kind}, **schema["properties"]}
            bare = not schema.get("required")
            schema["required"] = ["kind", *schema.get("required", [])]
            options += [schema, {"const": kind}] if bare else [schema]
        definitions[family] = {"anyOf": options}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **top,
        "$defs": dict(sorted(definitions.items())),
    }


def _or_variable(schema: dict[str, Any]) -> dict[str, Any]:
    """The schema of a value in whose place a variable can stand."""
    if "items" in schema:
        schema = {**schema, "items": _or_variable(schema["items"])}
    texts = (one for one in _options(schema) if one.get("type") == "string")
    if any("enum" not in text and "const" not in text for text in texts):
        return schema
    return _or(schema, {"$ref": f"#/$defs/{_VARIABLE}"})


def _entry(schema: dict[str, Any], *, lists: bool, every: Sequence[str] = ("of",)) -> dict[str, Any]:
    """The schema of a spec that may stand for several, ``lists``: by lists in the place of texts too.

    The fields ``every`` may be ``all``.
    """
    if "properties" not in schema:
        return schema
    properties = {name: _or_variable(inner) for name, inner in schema["properties"].items()}
    for name, inner in properties.items():
        kinds = {one.get("type") for one in _options(inner)}
        if name in every and "array" in kinds:
            properties[name] = _or(inner, {"const": "all"})
        elif lists and "string" in kinds and not kinds & {"array", "number"}:
            properties[name] = _or(inner, {"type": "array"})
    return {**schema, "properties": {**properties, _EACH: {"$ref": f"#/$defs/{_EACH}"}}}


def _options(schema: dict[str, Any]) -> list[dict[str, Any]]:
    return [*schema.get("anyOf", [schema])]


def _or(schema: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """Either of two schemas; what describes the value stays around both."""
    around = {key: item for key, item in schema.items() if key in ("title", "description", "default")}
    inner = {key: item for key, item in schema.items() if key not in around}
    return {**around, "anyOf": [*_options(inner), other]}
