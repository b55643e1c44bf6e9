"""Types of fields that hold names of what stands elsewhere in the file; all are checked in one place."""

from __future__ import annotations

import re
import types
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, Union, get_args, get_origin

from hident.config.describe import annotation_of
from hident.config.spec import Spec
from hident.config.yaml12 import Location


@dataclass(frozen=True)
class Reference:
    """Pydantic annotation: the value names an ``estimator``, a ``metric``, an ``axis`` or a ``table``."""

    what: str

    def names(self, spec: Spec, value: Any) -> Iterator[tuple[Location, str, str]]:
        """Where a name stands inside the value, what it is of, and the name itself."""
        yield (), self.what, value


@dataclass(frozen=True)
class NumericAxis(Reference):
    """The name of an axis whose labels are numbers."""

    what: str = "axis"
    positive: bool | str = False
    """Whether they must be positive, or the field that says so, such as ``log_x``."""
    least: int = 1
    """Their least number."""


@dataclass(frozen=True)
class Metric(Reference):
    """Labels of metrics that the value stands for: by default itself."""

    what: str = "metric"
    labels: Callable[[Any, Any], Iterable[str]] = lambda spec, value: (value,)
    """The labels, given the spec and the value."""
    scores: tuple[str, ...] = ("estimator", "estimators")
    """The fields of the spec with the estimators that they must score."""

    def names(self, spec: Spec, value: Any) -> Iterator[tuple[Location, str, str]]:
        for label in self.labels(spec, value):
            yield (), self.what, label


def value_of(metric: str = "metric", prefix: str = "", *, scores: tuple[str, ...] = Metric.scores) -> Metric:
    """Of the name of a value: with the name of a metric, in the field ``metric``, it makes a label."""
    return Metric(labels=lambda spec, value: (f"{getattr(spec, metric)} {prefix}{value}",), scores=scores)


@dataclass(frozen=True)
class Labels(Reference):
    """A mapping from axes to their labels, which choose cases."""

    what: str = "label"

    def names(self, spec: Spec, value: Any) -> Iterator[tuple[Location, str, str]]:
        for axis, label in value.items():
            yield (axis,), "axis", axis
            yield (axis,), f"label of {axis}", str(label)


@dataclass(frozen=True)
class Template(Reference):
    """A text, or a mapping with texts as keys, in which {axis} stands for a label."""

    what: str = "axis"

    def names(self, spec: Spec, value: Any) -> Iterator[tuple[Location, str, str]]:
        for axis in re.findall(r"{([^{}]*)}", " ".join([value] if isinstance(value, str) else value)):
            yield (), "axis", axis


EstimatorName = Annotated[str, Reference("estimator")]
TableName = Annotated[str, Reference("table")]
AxisName = Annotated[str, Reference("axis")]
MetricLabel = Annotated[str, Metric()]
ValueName = Annotated[str, value_of()]
CaseLabels = Annotated[dict[str, Any], Labels()]


class Referring(NamedTuple):
    """A value that refers to something: where it stands, and in which spec, which stands at ``within``."""

    place: Location
    reference: Reference
    value: Any
    spec: Spec
    within: Location

    def names(self) -> Iterator[tuple[Location, str, str]]:
        """The place of each name, what it is of, and the name itself."""
        for inside, what, name in self.reference.names(self.spec, self.value):
            yield (*self.place, *inside), what, name


def referring(spec: Spec, place: Location = ()) -> Iterator[Referring]:
    """Every value of a spec, and of the specs in it, that refers to something; it stands at the place."""

    def found(annotation: Any, value: Any, at: Location) -> Iterator[Referring]:
        origin, parts = get_origin(annotation), get_args(annotation)
        if value is None:
            return
        if origin is Annotated:
            for extra in parts[1:]:
                if isinstance(extra, Reference):
                    yield Referring(at, extra, value, spec, place)
            yield from found(parts[0], value, at)
        elif isinstance(value, Spec):
            yield from referring(value, at)
        elif origin in (Union, types.UnionType):
            for part in parts:
                yield from found(part, value, at)
        elif origin is tuple and isinstance(value, tuple):
            of_each = parts[:1] * len(value) if parts[-1] is Ellipsis else parts
            for i, (part, item) in enumerate(zip(of_each, value, strict=True)):
                yield from found(part, item, (*at, i))
        elif origin is dict and isinstance(value, Mapping):
            for key, item in value.items():
                yield from found(parts[1], item, (*at, key))

    for name, field in type(spec).model_fields.items():
        yield from found(annotation_of(field), getattr(spec, name), (*place, name))
