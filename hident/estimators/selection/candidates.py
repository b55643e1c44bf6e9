"""The candidates of a selection: an estimator with each combination of the values of some of its settings."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from pydantic import ValidationError
from pydantic_core import InitErrorDetails, PydanticCustomError

from hident.config.load import put
from hident.config.spec import Component, Of, Spec, components
from hident.config.yaml12 import shown
from hident.errors import ConfigError
from hident.estimators.base import EstimatorSpec

_MOST = 1000
_RANGE = re.compile(r"(-?\d+)\.\.(-?\d+)")
_Location = tuple[str | int, ...]


class Value(NamedTuple):
    """A value of a setting, and its place in the list as it is written."""

    value: Any
    place: int


def as_written(value: Any) -> dict[str, Any] | None:
    """An estimator as a file would hold it, with all that was given; None if it is none."""
    if isinstance(value, str):
        return {"kind": value}
    found = _as_given(value) if isinstance(value, EstimatorSpec) else value
    return dict(found) if isinstance(found, Mapping) else None


def _as_given(value: Any) -> Any:
    if isinstance(value, Spec):
        given = {
            name: _as_given(getattr(value, name))
            for name in type(value).model_fields
            if name in value.model_fields_set
        }
        return {"kind": value.kind, **given} if isinstance(value, Component) else given
    if isinstance(value, Mapping):
        return {key: _as_given(item) for key, item in value.items()}
    return [_as_given(item) for item in value] if isinstance(value, list | tuple) else value


def axes_of(over: Mapping[str, Any]) -> dict[str, list[Value]]:
    """The values of each setting, ranges written out, the settings in alphabetical order.

    ValidationError with all that is wrong.
    """
    problems: list[InitErrorDetails] = []
    if not over:
        message = "must name at least one key path in the estimator, such as bandwidth.h0"
        problems.append(_problem(message, ("over",), over))
    written: dict[str, list[Sequence[Any]]] = {}
    for path in sorted(over, key=str):
        values = over[path]
        if wrong := _wrong(path, values, over):
            problems.append(_problem(wrong, ("over", path), values))
        else:
            written[path] = [_spread(value) for value in values]
    total = math.prod(sum(map(_count, spreads)) for spreads in written.values())
    if total > _MOST:
        problems.append(_problem(f"makes {total} candidates, and at most {_MOST} are tried", ("over",), over))
    if problems:
        raise ValidationError.from_exception_data("over", problems)
    return {
        path: [Value(one, place) for place, spread in enumerate(spreads) for one in spread]
        for path, spreads in written.items()
    }


def _wrong(path: Any, values: Any, over: Mapping[str, Any]) -> str:
    """What is wrong with a setting by itself; empty if nothing."""
    if not isinstance(path, str) or not path:
        return "must be a key path in the estimator, such as bandwidth.h0"
    if path.split(".")[-1] == "kind":
        return "cannot choose a kind by itself: list whole mappings with 'kind:' under the key above it"
    if any(str(other).startswith(f"{path}.") for other in over):
        return "cannot be chosen as a whole and in part"
    if not isinstance(values, list | tuple):
        return "must be a list of values"
    return "" if values else "must hold at least one value"


def _spread(value: Any) -> Sequence[Any]:
    found = _RANGE.fullmatch(value.strip()) if isinstance(value, str) else None
    if not found:
        return [value]
    first, last = int(found[1]), int(found[2])
    # A range that is none is left for the estimator to refuse.
    return range(first, last + 1) if first <= last else [value]


def _count(spread: Sequence[Any]) -> int:
    """How many values there are; len() is of no range beyond the integers of the machine."""
    return spread.stop - spread.start if isinstance(spread, range) else len(spread)


def candidates_of(
    written: Mapping[str, Any], axes: Mapping[str, Sequence[Value]], over: Mapping[str, Any]
) -> dict[tuple[int, ...], EstimatorSpec]:
    """The candidates by the places of their values, the last setting varying the fastest.

    ValidationError with all that is wrong, where it is written.
    """
    found: dict[tuple[int, ...], EstimatorSpec] = {}
    wrong: dict[tuple[_Location, str], Any] = {}
    # What is wrong with a candidate and no key of it, by the words; where it is so.
    together: dict[str, list[dict[str, Value]]] = {}
    for path, values in axes.items():
        try:
            written = _opened(written, components("estimator")[written["kind"]], path.split("."))
            put({"estimator": {**written}}, f"estimator.{path}", values[0].value)
        except ConfigError as error:
            wrong[("over", path), str(error).partition(": ")[2]] = over[path]
    tried = [] if wrong else [*itertools.product(*(range(len(values)) for values in axes.values()))]
    for places in tried:
        chosen = {path: values[i] for (path, values), i in zip(axes.items(), places, strict=True)}
        data = {"estimator": {**written}}
        for path, one in chosen.items():
            put(data, f"estimator.{path}", one.value)
        try:
            spec = Of("estimator").validate(data["estimator"])
        except ValidationError as error:
            for detail in error.errors():
                message = detail["msg"].removeprefix("Value error, ")
                if detail["loc"]:
                    wrong.setdefault((_place_of(detail["loc"], message, chosen), message), detail["input"])
                else:
                    together.setdefault(message, []).append(chosen)
        else:
            assert isinstance(spec, EstimatorSpec)
            found[places] = spec
    problems = [_problem(message, at, value) for (at, message), value in wrong.items()]
    for message, where in together.items():
        if len(where) == len(tried):
            problems.append(_problem(message, ("estimator",), {}))
        else:
            words = ", ".join(f"{path} {word(one.value)}" for path, one in where[0].items())
            problems.append(_problem(f"with {words}: {message}", ("over",), {}))
    if problems:
        raise ValidationError.from_exception_data("over", problems)
    return found


def _opened(written: Mapping[str, Any], spec: type[Spec], keys: Sequence[str]) -> dict[str, Any]:
    """A part of an estimator with the mappings that a key path leads through and that were left out.

    ConfigError if it leads through something else that is left out.
    """
    key, *rest = keys
    opened, field = dict(written), spec.model_fields.get(key)
    if not rest or field is None:
        return opened
    of = next((one.family for one in field.metadata if isinstance(one, Of)), None)
    inner = field.annotation if of is None else None
    is_mapping = isinstance(inner, type) and issubclass(inner, Spec)
    if key not in written and not is_mapping:
        raise ConfigError(f"{'.'.join(keys)}: the estimator leaves '{key}' out: write it there")
    value = written.get(key, {})
    if of is not None and isinstance(value, Mapping):
        inner = components(of).get(str(value.get("kind")))
    if isinstance(value, Mapping) and isinstance(inner, type) and issubclass(inner, Spec):
        opened[key] = _opened(value, inner, rest)
    return opened


def _place_of(loc: _Location, message: str, chosen: Mapping[str, Value]) -> _Location:
    """Where a file holds what is wrong at a place of a candidate."""
    for path, one in chosen.items():
        keys = tuple(int(key) if key.isdecimal() else key for key in path.split("."))
        if loc[: len(keys)] == keys:
            rest = () if message.startswith("unknown key") else (one.place, *loc[len(keys) :])
            return ("over", path, *rest)
    return ("estimator", *loc)


def _problem(message: str, loc: _Location, value: Any) -> InitErrorDetails:
    return InitErrorDetails(type=PydanticCustomError("config", message), loc=loc, input=value)


def value_at(spec: Any, path: str) -> Any:
    """The value that a candidate holds at a key path."""
    for key in path.split("."):
        if isinstance(spec, Mapping):
            spec = spec[key]
        else:
            spec = spec[int(key)] if isinstance(spec, list | tuple) else getattr(spec, key)
    return spec


def along(axes: Mapping[str, Sequence[Value]], path: str) -> Iterator[tuple[int, ...]]:
    """The places of the candidates that hold each value of one setting and the first of all others."""
    for i in range(len(axes[path])):
        yield tuple(i if other == path else 0 for other in axes)


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def as_numbers(values: Sequence[Any]) -> list[float]:
    """The values, or their places from 1 where not all are numbers."""
    if all(map(is_number, values)):
        return [float(value) for value in values]
    return [float(place) for place in range(1, len(values) + 1)]


def word(value: Any) -> str:
    """A value in words: of a component its kind and what else was given, of another mapping what it holds."""
    if isinstance(value, Component):
        given = _as_given(value)
        return " ".join([given.pop("kind"), *(f"{key} {word(item)}" for key, item in given.items())])
    if isinstance(value, Spec):
        value = _as_given(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {word(item)}" for key, item in value.items()) + "}"
    return value if isinstance(value, str) else shown(value)
