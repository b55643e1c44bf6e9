"""The axes under ``cases``: what each of their labels changes."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

from pydantic import BeforeValidator, ValidationError

from hident.config.load import Document, Problem, problems_of, split_assignment
from hident.config.spec import Spec
from hident.config.suggest import did_you_mean, one_of
from hident.config.yaml12 import Complaint, Place, shown
from hident.engine.trial import Data
from hident.errors import ConfigError

Label = str | float | int
DATA = tuple(Data.model_fields)
CHANGEABLE = (*DATA, "estimators", "metrics")
# The other columns of the tables of results and of exported trials.
_COLUMNS = ("estimator", "metric", "trials", "failed", "mean", "std", "se", "median")
_QUANTILES = ("q05", "q25", "q75", "q95")
_EXPORTED = ("trial", "value", "failure")


def _as_axis(written: Any) -> Any:
    if not isinstance(written, list | Mapping):
        raise ValueError("must be a list of values, or labels with the values that each sets")
    if not written:
        raise ValueError("must hold at least one value")
    if isinstance(written, list):
        if any(isinstance(value, Mapping) for value in written):
            raise ValueError("a list cannot hold mappings: give each a label, as 'label: {key.path: value}'")
    elif any(not isinstance(patches, Mapping) for patches in written.values()):
        raise ValueError("must set values by their key path under each label, as 'label: {key.path: value}'")
    twice = [label for label, count in Counter(map(str, _labels(written))).items() if count > 1]
    if twice:
        raise ValueError(f"holds {one_of(twice)} twice")
    return written


AxisAsWritten = Annotated[list[Any] | dict[str, dict[str, Any]], BeforeValidator(_as_axis)]


class Cases(Spec):
    """The axes, which must be sound before they can be applied."""

    cases: dict[str, AxisAsWritten] = {}
    """Axes: a key path with a list of values, or a name with labels and the values that each sets.

    The value null for an estimator, as in 'label: {estimators.NAME: null}', leaves it out there.
    """


def _labels(written: list[Any] | Mapping[str, Any]) -> tuple[Label, ...]:
    """The label of each point of an axis: its name, or its value as YAML writes it."""
    if isinstance(written, Mapping):
        return tuple(written)
    return tuple(
        value if isinstance(value, str | int | float) and not isinstance(value, bool) else shown(value)
        for value in written
    )


@dataclass(frozen=True)
class Axis:
    """One axis of the cases: its labels, and the patches (key path -> value) behind each label.

    ``places`` says where each patch was written.
    """

    name: str
    labels: tuple[Label, ...]
    patches: tuple[dict[str, Any], ...]
    places: tuple[dict[str, Place], ...]

    @classmethod
    def of(cls, name: str, written: list[Any] | dict[str, dict[str, Any]], document: Document) -> Axis:
        """The axis that a document holds under ``cases``."""
        labels, at = _labels(written), ("cases", name)
        if isinstance(written, dict):
            patches = tuple(written.values())
            places = tuple(
                {path: document.place((*at, label, path)) for path in patch}
                for label, patch in written.items()
            )
        else:
            patches = tuple({name: value} for value in written)
            places = tuple({name: document.place((*at, i))} for i in range(len(written)))
        return cls(name, labels, patches, places)

    @cached_property
    def roots(self) -> frozenset[tuple[str, ...]]:
        """What the axis touches: ("data",), ("estimators", name) or ("metrics", name)."""
        return frozenset(map(_root, itertools.chain.from_iterable(self.patches)))

    def leaves_out(self, index: int) -> frozenset[str]:
        """The names of the estimators that a label of the axis sets to null."""
        patches = self.patches[index].items()
        return frozenset(_root(path)[1] for path, value in patches if _leaves_out(path, value))

    def apply(self, document: Document, index: int) -> Document:
        """The document at a label of the axis; an estimator that it leaves out stays as it is.

        Raises
        ------
        ConfigError
            If a key path leads nowhere.
        """
        for path, value in self.patches[index].items():
            if not _leaves_out(path, value):
                document = document.patched(path, value, self.places[index][path])
        return document


def _root(path: str) -> tuple[str, ...]:
    head, *rest = path.split(".")
    return ("data",) if head in DATA else (head, *rest[:1])


def _leaves_out(path: str, value: Any) -> bool:
    """Whether a patch leaves an estimator out of its cases, as ``estimators.NAME: null`` does."""
    head, *rest = path.split(".")
    return value is None and head == "estimators" and len(rest) == 1


def sound_axes(document: Document, complaints: list[Complaint]) -> tuple[Axis, ...]:
    """The axes that can be applied; what is wrong with the others goes to the complaints."""
    sound: list[Axis] = []
    cases = document.data.get("cases", {})
    try:
        written = Cases.model_validate({"cases": cases}).cases
    except ValidationError as error:
        problems = problems_of(error)
        complaints += document.complaints_of(problems)
        unsound = {problem.location[1:2] for problem in problems}
        written = {} if () in unsound else {n: axis for n, axis in cases.items() if (n,) not in unsound}
    for name, axis_as_written in written.items():
        axis = Axis.of(name, axis_as_written, document)
        found = document.complaints_of(
            Problem(("cases", name), message) for message in _unsound(axis, document.data)
        )
        if not found:
            found = _misplaced(axis, document)
        if found:
            complaints += found
        else:
            sound.append(axis)
            document = axis.apply(document, 0)
    return tuple(sound)


def idle_assignments(
    document: Document, axes: Iterable[Axis], assignments: Iterable[str]
) -> Iterator[Complaint]:
    """The ``--set`` assignments without effect, as every label of an axis sets their key."""
    for assignment in assignments:
        path, value = (part.strip() for part in split_assignment(document, assignment))
        for axis in axes:
            if all(any(f"{path}.".startswith(f"{key}.") for key in patch) for patch in axis.patches):
                remedy = f"; use --set cases.{path}=[{value}]" if axis.name == path else " under every label"
                yield Complaint(0, f"--set {assignment}: cases.{axis.name} sets this key{remedy}")


def _unsound(axis: Axis, data: Mapping[str, Any]) -> Iterator[str]:
    """What an axis may not do."""
    if axis.name in (*_COLUMNS, *_QUANTILES, *_EXPORTED):
        yield f"an axis cannot be named '{axis.name}', which is a column of the results"
    for path in dict.fromkeys(itertools.chain.from_iterable(axis.patches)):
        head, *rest = path.split(".")
        if head not in CHANGEABLE:
            near = did_you_mean(head, CHANGEABLE)
            yield f"a case cannot change '{head}'{near} (it can: {one_of(CHANGEABLE)})"
        elif head not in DATA:
            section = data.get(head)
            known = section if isinstance(section, Mapping) else {}
            if not rest or rest[0] not in known:
                near = did_you_mean(rest[0], known) if rest else ""
                named = f"'{rest[0]}' is none of the {head}" if rest else f"name one of the {head}"
                yield f"{named}{near} (there are: {one_of(known) or 'none'})"
            elif head == "metrics" and rest[1:] in ([], ["estimators"]):
                yield f"a case cannot change '{path}', only settings of the metric"


def _misplaced(axis: Axis, document: Document) -> list[Complaint]:
    """Key paths of an axis that lead nowhere."""
    found = []
    for patches, places in zip(axis.patches, axis.places, strict=True):
        at_label = document
        for path, value in patches.items():
            if _leaves_out(path, value):
                continue
            try:
                at_label = at_label.patched(path, value, places[path])
            except ConfigError as error:
                found.append(Complaint(places[path].line, str(error)))
    return found
