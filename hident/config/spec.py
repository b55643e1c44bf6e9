"""The frozen specs that a configuration is made of, and the register of their kinds.

A component (an estimator, a nonlinearity, ...) is a spec class with a family and a kind; its fields
are its YAML fields. The decorator :func:`component` is all that it takes to add one: the schema, the
listing, the contract tests and the documentation follow from it.
"""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Mapping, Sized
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeVar, get_args

from pydantic import (
    AfterValidator,
    AllowInfNan,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    Strict,
    ValidationError,
    WithJsonSchema,
    model_validator,
)
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from hident import loaded_code
from hident.config.expression import number
from hident.config.load import Document, problems_of
from hident.config.meanings import meanings
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
    "block",
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
    "blocks": "block",
    "tables": "table",
    "figures": "figure",
}


_A_NUMBER = "must be a number, or a formula such as '2*pi' or '1/5'"
_A_WHOLE_NUMBER = "must be a whole number"
_WORDS = re.compile(r"[^\W\d]\w*(?: [^\W\d]\w*|-[^\W\d]\w+)*")


def _as_real(value: Any) -> Any:
    if isinstance(value, str):
        try:
            return number(value)
        except ValueError:
            # Of a mere word, what is wrong is not a name in a formula.
            if _WORDS.fullmatch(value):
                raise ValueError(_A_NUMBER) from None
            raise
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(_A_NUMBER)
    return float(value)


def _no_nan(value: float) -> float:
    if math.isnan(value):
        raise ValueError(f"{_A_NUMBER}, not .nan")
    return value


def _as_count(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(_A_WHOLE_NUMBER)
    if abs(value) >= 2**63:
        raise ValueError("must be below 2^63")
    return value


Real = Annotated[
    float,
    BeforeValidator(_as_real),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string"}]}),
]
Limit = Annotated[
    float,
    AllowInfNan(True),
    BeforeValidator(_as_real),
    AfterValidator(_no_nan),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string"}]}),
]
"""A number, or .inf or -.inf where there is no limit."""
Count = Annotated[int, BeforeValidator(_as_count)]
Flag = Annotated[bool, Strict()]


def _increasing(interval: tuple[float, float]) -> tuple[float, float]:
    if not interval[0] < interval[1]:
        raise ValueError("must be [low, high] with low < high")
    return interval


Interval = Annotated[tuple[Real, Real], AfterValidator(_increasing)]
Limits = Annotated[tuple[Limit, Limit], AfterValidator(_increasing)]
"""An interval that may be open to one side: [low, .inf]."""
T = TypeVar("T")
NonEmpty = Annotated[tuple[T, ...], Field(min_length=1)]


def plain(value: Any) -> Any:
    """What Python or numpy hands over, as a file would hold it: arrays are lists, numpy's numbers numbers."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value.tolist() if hasattr(value, "tolist") else value


if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass as _Meta
else:

    class _Meta(type(BaseModel)):
        """Lets a spec that is made in Python complain in the words that a file would get."""

        def __call__(cls, **fields):
            try:
                return super().__call__(**plain(fields))
            except ValidationError as error:
                raise Document(cls.__name__, fields).error(problems_of(error)) from None


class Spec(BaseModel, metaclass=_Meta):
    """A frozen part of a configuration; unknown keys are refused with the nearest valid name.

    ConfigError if it is made in Python with fields that a configuration could not hold.
    """

    # Schemas are built at first use: a command needs few of them.
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)

    instead: ClassVar[Mapping[str, str]] = {}
    """By field that takes a number, what does what a word there asks for, as in ``delay: search``."""

    @model_validator(mode="wrap")
    @classmethod
    def _explain(cls, data: Any, handler: Callable[[Any], Any]) -> Any:
        if not isinstance(data, Mapping | Spec):
            raise PydanticCustomError("not_a_mapping", "must be a mapping of keys to values")
        try:
            return handler(data)
        except ValidationError as error:
            raise ValidationError.from_exception_data(
                error.title, [cls._explained(detail, data) for detail in error.errors() if _is_so(detail)]
            ) from None

    @classmethod
    def _explained(cls, detail: Any, data: Any) -> InitErrorDetails:
        message, loc, context = detail["msg"], detail["loc"], detail.get("ctx", {})
        match detail["type"]:
            case "extra_forbidden":
                allowed = list(cls.model_fields)
                near = did_you_mean(str(loc[-1]), allowed)
                message = f"unknown key{near} (allowed: {one_of(allowed) or 'none'})"
            case "missing" if isinstance(loc[-1], int):
                message, loc = f"must be a list of at least {loc[-1] + 1}", loc[:-1]
            case "missing":
                meaning = meanings(cls).get(str(loc[-1]), "")
                message = "is required" + (f": {meaning.rstrip('.')}" if meaning else "")
            case "literal_error":
                near = did_you_mean(str(detail["input"]), re.findall("'([^']*)'", context["expected"]))
                message = f"must be {context['expected']}{near}"
            case "tuple_type" | "list_type":
                message = "must be a list"
            case "too_long":
                message = f"must be a list of at most {context['max_length']}"
            case "too_short":
                message = f"must be a list of at least {context['min_length']}"
            case "dict_type":
                message = "must be a mapping of keys to values"
            case "bool_type":
                message = "must be true or false"
            case "string_type":
                several = isinstance(detail["input"], list)
                message = "must be one text, not a list" if several else "must be text"
        message = message.removeprefix("Value error, ").replace("Input should be", "must be")
        written = _as_written(loc, data, message)
        if message in (_A_NUMBER, _A_WHOLE_NUMBER) and len(written) == 1 and written[0] in cls.model_fields:
            message = cls._allowed(str(written[0]), detail["input"], message)
        return InitErrorDetails(
            type=PydanticCustomError("config", message), loc=written, input=detail["input"]
        )

    @classmethod
    def _allowed(cls, name: str, value: Any, message: str) -> str:
        """The message about what is no number with the field's bounds, and where a word belongs."""
        from hident.config.describe import bounds

        kind, comma, formula = message.partition(",")
        remedy = cls.instead.get(name) if isinstance(value, str) else None
        return f"{kind}{bounds(cls.model_fields[name])}{comma}{formula}" + (f"; {remedy}" if remedy else "")

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        found = handler.resolve_ref_schema(handler(schema))
        if text := own_docstring(cls):
            found["description"] = text
        for name, meaning in meanings(cls).items():
            found["properties"][name]["description"] = meaning
        return found


def _is_so(detail: Any) -> bool:
    """Whether a list is too short: pydantic does not count the items in which something else is wrong."""
    if detail["type"] != "too_short":
        return True
    value = detail["input"]
    return not isinstance(value, Sized) or len(value) < detail["ctx"]["min_length"]


def _as_written(loc: tuple[str | int, ...], data: Any, message: str) -> tuple[str | int, ...]:
    """The location without what stands only in the schema, such as the names of a union's branches."""
    kept: list[str | int] = []
    for i, part in enumerate(loc):
        if (isinstance(data, Mapping) and part in data) or (
            isinstance(data, list | tuple) and isinstance(part, int) and part < len(data)
        ):
            data = data[part]  # type: ignore[index]
        elif not (message.startswith("is required") and i == len(loc) - 1):
            continue
        kept.append(part)
    return tuple(kept)


def own_docstring(cls: type) -> str:
    """The docstring of the class itself, up to its examples: that of a base may not be true of it."""
    return inspect.cleandoc(cls.__doc__ or "").partition("\n\nExamples\n")[0]


class Component(Spec):
    """A spec with a family and a kind, chosen in YAML by its ``kind:``."""

    family: ClassVar[Family]
    kind: ClassVar[str]
    source: ClassVar[str] = ""

    @classmethod
    def summary(cls) -> str:
        """The first line of the docstring."""
        return own_docstring(cls).partition("\n")[0]


_REGISTER: dict[str, dict[str, type[Component]]] = {}
C = TypeVar("C", bound=type[Component])


def component(family: Family, kind: str, *, source: str = "") -> Callable[[C], C]:
    """Register a component class under ``kind`` in its family; ``source`` cites its origin.

    ValueError if the family is unknown, or another class already has that name.
    """
    if family not in get_args(Family):
        near = did_you_mean(family, get_args(Family))
        raise ValueError(f"unknown family '{family}'{near} (allowed: {one_of(get_args(Family))})")

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
        if (package := cls.__module__.partition(".")[0]) != "hident":
            loaded_code.note_loaded(package)
        return cls

    return register


def components(family: Family) -> dict[str, type[Component]]:
    """The known components of a family by kind, in alphabetical order."""
    return dict(sorted(_REGISTER.get(family, {}).items()))


FAMILY_KEY = "x-family"
"""What a schema says in the place of a component, see :mod:`hident.config.schema`."""


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
        # Families refer to each other, so they become definitions: see hident.config.schema.
        return {FAMILY_KEY: self.family}

    def validate(self, value: Any) -> Component:
        known = components(self.family)
        if isinstance(value, Component) and value.family == self.family:
            return value
        if isinstance(value, Component):
            raise self._error(
                f"must be a {self.family}, not the {value.family} '{value.kind}'", (), value.kind
            )
        bare = isinstance(value, str)
        if bare:
            value = {"kind": value}
        if not isinstance(value, Mapping):
            raise self._error("must be a mapping with 'kind:'", (), value)
        kind = value.get("kind")
        if isinstance(kind, str) and kind in known:
            return known[kind].model_validate({k: v for k, v in value.items() if k != "kind"})
        message = (
            f"unknown {self.family}{did_you_mean(str(kind), known)}"
            if "kind" in value
            else f"is required: the {self.family}"
        )
        raise self._error(message, () if bare else ("kind",), kind)

    def _error(self, message: str, loc: tuple[str, ...], value: Any) -> ValidationError:
        problem = PydanticCustomError("config", f"{message} (allowed: {one_of(components(self.family))})")
        return ValidationError.from_exception_data(
            self.family, [InitErrorDetails(type=problem, loc=loc, input=value)]
        )


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
