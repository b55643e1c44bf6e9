"""The frozen specs that a configuration is made of, and the register of their kinds.

A component (an estimator, a nonlinearity, ...) is a spec class with a family and a kind; its fields
are its YAML fields. The decorator :func:`component` is all that it takes to add one: the schema, the
listing, the contract tests and the documentation follow from it.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Literal, TypeVar

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    Strict,
    ValidationError,
    WithJsonSchema,
    model_validator,
)
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from hident.config.expression import number
from hident.config.suggest import did_you_mean, one_of

Family = Literal[
    "estimator",
    "system",
    "linear",
    "nonlinearity",
    "excitation",
    "noise",
    "streams",
    "metric",
    "basis",
    "table",
    "figure",
]
PLURALS: dict[str, Family] = {
    "estimators": "estimator",
    "systems": "system",
    "linears": "linear",
    "nonlinearities": "nonlinearity",
    "excitations": "excitation",
    "noises": "noise",
    "streams": "streams",
    "metrics": "metric",
    "bases": "basis",
    "tables": "table",
    "figures": "figure",
}


def _as_real(value: Any) -> Any:
    if isinstance(value, str):
        return number(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("must be a number, or a formula such as '2*pi' or '1/5'")
    return float(value)


def _as_count(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError("must be a whole number")
    return value


Real = Annotated[
    float,
    BeforeValidator(_as_real),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string"}]}),
]
Count = Annotated[int, BeforeValidator(_as_count)]
Flag = Annotated[bool, Strict()]


class Spec(BaseModel):
    """A frozen part of a configuration; unknown keys are refused with the nearest valid name."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)

    @model_validator(mode="wrap")
    @classmethod
    def _explain_unknown_keys(cls, data: Any, handler: Callable[[Any], Any]) -> Any:
        if not isinstance(data, Mapping | Spec):
            raise PydanticCustomError("not_a_mapping", "must be a mapping of keys to values")
        try:
            return handler(data)
        except ValidationError as error:
            raise ValidationError.from_exception_data(
                error.title, [cls._explained(detail) for detail in error.errors()]
            ) from None

    @classmethod
    def _explained(cls, detail: Any) -> InitErrorDetails:
        message, key = detail["msg"], detail["loc"][-1] if detail["loc"] else ""
        if detail["type"] == "extra_forbidden" and len(detail["loc"]) == 1:
            allowed = list(cls.model_fields)
            message = f"unknown key{did_you_mean(str(key), allowed)} (allowed: {one_of(allowed)})"
        elif detail["type"] == "missing" and len(detail["loc"]) == 1:
            described = cls.model_fields[str(key)].description
            message = "is required" + (f": {described.rstrip('.')}" if described else "")
        elif detail["type"] == "literal_error":
            expected = detail["ctx"]["expected"]
            near = did_you_mean(str(detail["input"]), re.findall("'([^']*)'", expected))
            message = f"must be {expected}{near}"
        elif detail["type"] in ("tuple_type", "list_type"):
            message = "must be a list"
        elif detail["type"] == "dict_type":
            message = "must be a mapping of keys to values"
        message = message.removeprefix("Value error, ").replace("Input should be", "must be")
        return InitErrorDetails(
            type=PydanticCustomError("config", message),
            loc=detail["loc"],
            input=detail["input"],
        )


class Component(Spec):
    """A spec with a family and a kind, chosen in YAML by its ``kind:``."""

    family: ClassVar[Family]
    kind: ClassVar[str]
    source: ClassVar[str] = ""

    @classmethod
    def summary(cls) -> str:
        """The first line of the docstring."""
        return (inspect.getdoc(cls) or "").partition("\n")[0]


_REGISTER: dict[str, dict[str, type[Component]]] = {}
C = TypeVar("C", bound=type[Component])


def component(family: Family, kind: str, *, source: str = "") -> Callable[[C], C]:
    """Register a component class under ``kind`` in its family; ``source`` cites its origin.

    Raises
    ------
    ValueError
        If another class already has that name.
    """

    def register(cls: C) -> C:
        known = _REGISTER.setdefault(family, {})
        other = known.get(kind)
        if other is not None and (other.__module__, other.__qualname__) != (
            cls.__module__,
            cls.__qualname__,
        ):
            raise ValueError(f"{family} '{kind}' is already defined in {other.__module__}")
        cls.family, cls.kind, cls.source = family, kind, source
        known[kind] = cls
        return cls

    return register


def components(family: Family) -> dict[str, type[Component]]:
    """The known components of a family by kind, in alphabetical order."""
    return dict(sorted(_REGISTER.get(family, {}).items()))


_FAMILY = "x-family"


class Of:
    """Pydantic annotation: a component of the family, written as a mapping with ``kind:``.

    A bare string stands for a component without further keys.
    """

    def __init__(self, family: Family) -> None:
        self.family = family

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.validate)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        # Families refer to each other, so they become definitions: see json_schema.
        return {_FAMILY: self.family}

    def validate(self, value: Any) -> Component:
        known = components(self.family)
        if isinstance(value, Component) and value.family == self.family:
            return value
        if isinstance(value, str):
            value = {"kind": value}
        if not isinstance(value, Mapping):
            raise PydanticCustomError("config", f"must be a mapping with 'kind:' (allowed: {one_of(known)})")
        if "kind" not in value:
            raise _at_kind(f"is required: the {self.family} (allowed: {one_of(known)})", value)
        kind = value["kind"]
        if not isinstance(kind, str) or kind not in known:
            raise _at_kind(
                f"unknown {self.family}{did_you_mean(kind, known)} (allowed: {one_of(known)})", kind
            )
        return known[kind].model_validate({k: v for k, v in value.items() if k != "kind"})


def _at_kind(message: str, value: Any) -> ValidationError:
    detail = InitErrorDetails(type=PydanticCustomError("config", message), loc=("kind",), input=value)
    return ValidationError.from_exception_data("component", [detail])


def canonical(value: Any) -> Any:
    """A spec as plain data for hashing and printing: kinds named, fields at their default left out.

    Leaving defaults out keeps a hash when a later version adds a field.
    """
    if isinstance(value, Spec):
        plain = {
            name: canonical(getattr(value, name))
            for name, field in type(value).model_fields.items()
            if getattr(value, name) != field.get_default(call_default_factory=True)
        }
        return {"kind": value.kind, **plain} if isinstance(value, Component) else plain
    if isinstance(value, Mapping):
        return {str(key): canonical(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [canonical(item) for item in value]
    return value


def json_schema(model: type[Spec]) -> dict[str, Any]:
    """The JSON Schema of a model, with every registered component of each family it can hold."""
    definitions: dict[str, Any] = {}

    def linked(node: Any) -> Any:
        if isinstance(node, list):
            return [linked(item) for item in node]
        if not isinstance(node, dict):
            return node
        if _FAMILY in node:
            rest = {key: linked(item) for key, item in node.items() if key != _FAMILY}
            return {**rest, "$ref": f"#/$defs/{node[_FAMILY]}"}
        return {key: linked(item) for key, item in node.items()}

    def schema_of(cls: type[Spec]) -> dict[str, Any]:
        schema = linked(cls.model_json_schema())
        definitions.update(schema.pop("$defs", {}))
        return dict(schema)

    top = schema_of(model)
    for family in PLURALS.values():
        options: list[dict[str, Any]] = []
        for kind, cls in components(family).items():
            schema = schema_of(cls)
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
