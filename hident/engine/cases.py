"""The axes under ``cases``: what each of their labels changes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, NamedTuple

from pydantic import BeforeValidator, ValidationError

from hident.config.load import Document, Problem, problems_of, split_assignment
from hident.config.spec import Spec
from hident.config.suggest import did_you_mean, one_of, there_is_no
from hident.config.variables import cannot_join, stands_alone, stuck, texts, unknown, variables_in
from hident.config.yaml12 import Complaint, Location, Place, error_of, shown
from hident.engine.written import Written
from hident.errors import ConfigError

Label = str | float | int
DATA = tuple(Written.model_fields)
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
    elif len({isinstance(value, Mapping) for value in written.values()}) > 1:
        raise ValueError(
            "must set values by their key path under each label, as 'label: {key.path: value}', or give a "
            "value under each, as 'label: value'"
        )
    twice = [label for label, count in Counter(map(str, _labels(written))).items() if count > 1]
    if twice:
        raise ValueError(f"holds {one_of(twice)} twice")
    return written


AxisAsWritten = Annotated[list[Any] | dict[str, Any], BeforeValidator(_as_axis)]


class Cases(Spec):
    """The axes, which must be sound before they can be applied."""

    cases: dict[str, AxisAsWritten] = {}
    """Axes: a name with a list of values, or with labels and the value or the values that each sets.

    A label sets values by their key path, as in 'label: {noise.std: 1}', and variables, as in
    'label: {$name: 1}'. '$axis' stands for the value of an axis, or for its label where that sets values;
    a list whose name is a key path sets that key as well. The value null for an estimator, as in
    'label: {estimators.NAME: null}', leaves it out there.
    """
    skip: tuple[dict[str, Any], ...] = ()
    """Cases that are left out, each by labels of axes; with 'estimator: NAME' that estimator alone."""


def _labels(written: list[Any] | Mapping[str, Any]) -> tuple[Label, ...]:
    """The label of each point of an axis: its name, or its value as YAML writes it."""
    if isinstance(written, Mapping):
        return tuple(written)
    return tuple(
        value if isinstance(value, str | int | float) and not isinstance(value, bool) else shown(value)
        for value in written
    )


class Patch(NamedTuple):
    """A value that a label sets: the key path, the value, and where it was written."""

    path: str
    value: Any
    place: Place

    @property
    def root(self) -> tuple[str, ...]:
        """What it touches: ("data",), ("estimators", name) or ("metrics", name)."""
        head, *rest = self.path.split(".")
        return ("data",) if head in DATA else (head, *rest[:1])

    @property
    def leaves_out(self) -> bool:
        """Whether it leaves an estimator out of its cases, as ``estimators.NAME: null`` does."""
        return self.value is None and self.path.count(".") == 1 and self.root[0] == "estimators"


@dataclass(frozen=True)
class Point:
    """A label of an axis: what it sets, and the values of the axis's variables there."""

    label: Label
    patches: tuple[Patch, ...]
    variables: dict[str, Any]

    @cached_property
    def left_out(self) -> frozenset[str]:
        """The names of the estimators that it sets to null."""
        return frozenset(patch.root[1] for patch in self.patches if patch.leaves_out)

    def apply(self, document: Document) -> Document:
        """The document with what it sets, an estimator that it leaves out as it is."""
        for patch in self.patches:
            if not patch.leaves_out:
                document = document.patched(*patch)
        return document


@dataclass(frozen=True)
class Axis:
    """One axis of the cases; ``uses`` are the parts of the file that name one of its variables."""

    name: str
    points: tuple[Point, ...]
    uses: frozenset[tuple[str, ...]] = frozenset()

    @classmethod
    def of(cls, name: str, written: list[Any] | dict[str, Any], document: Document) -> Axis:
        """The axis that a document holds under ``cases``."""
        sets = isinstance(written, list) and name.partition(".")[0] in CHANGEABLE
        keys: Iterable[str | int] = written if isinstance(written, dict) else range(len(written))
        values = written.values() if isinstance(written, dict) else written
        points = []
        for key, label, value in zip(keys, _labels(written), values, strict=True):
            variables, patched = {name: value}, {name: value} if sets else {}
            if isinstance(value, Mapping):
                variables = {name: label, **{k[1:]: item for k, item in value.items() if k.startswith("$")}}
                patched = {k: item for k, item in value.items() if not k.startswith("$")}
            at = ("cases", name, key)
            patches = (Patch(path, item, document.place((*at, path))) for path, item in patched.items())
            points.append(Point(label, tuple(patches), variables))
        return cls(name, tuple(points))

    @cached_property
    def labels(self) -> tuple[Label, ...]:
        return tuple(point.label for point in self.points)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The names of its variables."""
        return tuple(dict.fromkeys(name for point in self.points for name in point.variables))

    @cached_property
    def roots(self) -> frozenset[tuple[str, ...]]:
        """What the axis touches, as :attr:`Patch.root` says."""
        return self.uses.union(patch.root for point in self.points for patch in point.patches)


@dataclass(frozen=True)
class Skip:
    """Cases that are left out: labels by axis, of some estimators or of all (None)."""

    labels: Mapping[str, frozenset[str]]
    estimators: frozenset[str] | None

    def covers(self, estimator: str | None, labels: Mapping[str, Label]) -> bool:
        """Whether an estimator, or all of them (None), is left out at these labels."""
        return (self.estimators is None or estimator in self.estimators) and all(
            axis in labels and str(labels[axis]) in chosen for axis, chosen in self.labels.items()
        )


def sound_axes(document: Document, complaints: list[Complaint]) -> tuple[Axis, ...]:
    """The axes that can be applied; what is wrong with the others goes to the complaints.

    That it is not clear which value a variable has is an error: the rest cannot be judged.
    """
    cases = document.data.get("cases", {})
    every = True
    try:
        written = Cases.model_validate({"cases": cases}).cases
    except ValidationError as error:
        problems = problems_of(error)
        complaints += document.complaints_of(problems)
        unsound = {problem.location[1:2] for problem in problems}
        every = False
        written = {} if () in unsound else {n: axis for n, axis in cases.items() if (n,) not in unsound}
    axes = [Axis.of(name, axis, document) for name, axis in written.items()]
    uses = list(_uses(document, axes))
    axes = [replace(a, uses=frozenset(use.root for use in uses if use.variable in a.names)) for a in axes]
    used = {use.variable for use in uses}
    sound: list[Axis] = []
    at_first = document
    for axis in axes:
        messages = list(_unsound(axis, document.data)) or list(_idle(axis, cases[axis.name], used))
        found = document.complaints_of(Problem(("cases", axis.name), message) for message in messages)
        if found := found or _misplaced(axis, at_first):
            complaints += found
        else:
            sound.append(axis)
            at_first = axis.points[0].apply(at_first)
    unclear = document.complaints_of(_unclear(axes, uses, unknown_too=every))
    if unclear or any(axis.uses for axis in axes if axis not in sound):
        raise error_of([*document.complaints, *complaints, *unclear])
    return tuple(sound)


def written_axes(document: Document) -> tuple[str, ...]:
    """The names of the axes under ``cases``, also of those that cannot be applied."""
    cases = document.data.get("cases")
    return tuple(cases) if isinstance(cases, Mapping) else ()


class _Use(NamedTuple):
    """A variable in a text: where the text stands, and which part of the file it belongs to."""

    variable: str
    text: str
    place: Location
    root: tuple[str, ...]


def _uses(document: Document, axes: Iterable[Axis]) -> Iterator[_Use]:
    """The variables in a file and in what its axes set."""

    every = [
        (at, text, ("data",) if section in DATA else (section, str(at[1])))
        for section in CHANGEABLE
        for at, text in texts(document.data.get(section), (section,))
        if section in DATA or at[1:]
    ] + [
        (at, text, patch.root)
        for axis in axes
        for point in axis.points
        for patch in point.patches
        for at, text in texts(patch.value, ("cases", axis.name, str(point.label), patch.path))
    ]
    for at, text, root in every:
        yield from (_Use(name, text, at, root) for name in variables_in(text))


def _idle(axis: Axis, written: Any, used: Set[str]) -> Iterator[str]:
    """The variables of an axis that nothing uses, though the axis does nothing else."""
    values = written.values() if isinstance(written, Mapping) else written
    sets = any(point.patches for point in axis.points) or any(isinstance(one, Mapping) for one in values)
    for name in axis.names:
        if name in used or (name == axis.name and sets):
            continue
        cannot = "" if name != axis.name else f"{_cannot_change(name.partition('.')[0])}, and "
        yield f"{cannot}nothing uses '${name}'"


def _cannot_change(head: str) -> str:
    return f"a case cannot change '{head}'{did_you_mean(head, CHANGEABLE)} (it can: {one_of(CHANGEABLE)})"


def _unclear(axes: Iterable[Axis], uses: Iterable[_Use], *, unknown_too: bool) -> Iterator[Problem]:
    """Variables whose value is not clear, and values that cannot stand where their variable does."""
    known: dict[str, Axis] = {}
    for axis in axes:
        for name in axis.names:
            other = known.setdefault(name, axis)
            if other is not axis:
                yield Problem(("cases", axis.name), f"the axis '{other.name}' has a variable '{name}' too")
            for point in axis.points:
                if name not in point.variables:
                    label = str(point.label)
                    yield Problem(("cases", axis.name, label), f"must set '${name}', as other labels do")
    for name, text, at, root in uses:
        if name not in known:
            if unknown_too:
                yield Problem(at, unknown(name, known, "axis"))
        elif root[0] == "metrics" and at[2:3] == ("estimators",):
            yield Problem(at, "a case cannot change the estimators of a metric")
        elif not stands_alone(text):
            for point in known[name].points:
                if stuck(point.variables.get(name, "")):
                    yield Problem(at, cannot_join(name, point.variables[name]))


def skips(document: Document, axes: Sequence[Axis], complaints: list[Complaint]) -> tuple[Skip, ...]:
    """The cases that a document leaves out under ``skip``; what is wrong goes to the complaints."""
    written, estimators = document.data.get("skip"), document.data.get("estimators")
    # Of an axis that cannot be applied, that is said, and it has no labels to be wrong.
    unsound = set(written_axes(document)) - {axis.name for axis in axes}
    known = {axis.name: list(map(str, axis.labels)) for axis in axes}
    known["estimator"] = list(estimators) if isinstance(estimators, Mapping) else []
    found: list[Skip] = []
    for i, entry in enumerate(written if isinstance(written, list) else ()):
        if not isinstance(entry, Mapping):
            continue
        problems = [] if entry else [Problem(("skip", i), "must name labels of axes, an estimator, or both")]
        chosen: dict[str, frozenset[str]] = {}
        for name, labels in entry.items():
            names = [str(label) for label in (labels if isinstance(labels, list) else [labels])]
            chosen[name] = frozenset(names)
            if name in unsound:
                continue
            what = "estimator" if name == "estimator" else "label"
            messages = (
                [there_is_no(what, one, known[name]) for one in names if one not in known[name]]
                if name in known
                else [there_is_no("axis", name, known)]
            )
            problems += [Problem(("skip", i, name), message) for message in messages]
        complaints += document.complaints_of(problems)
        if chosen and not problems and unsound.isdisjoint(chosen):
            found.append(Skip(chosen, chosen.pop("estimator", None)))
    return tuple(found)


def idle_assignments(
    document: Document, axes: Iterable[Axis], assignments: Iterable[str]
) -> Iterator[Complaint]:
    """The ``--set`` assignments without effect, as every label of an axis sets their key."""
    for assignment in assignments:
        path, value = (part.strip() for part in split_assignment(document, assignment))
        for axis in axes:
            if all(any(f"{path}.".startswith(f"{p.path}.") for p in point.patches) for point in axis.points):
                remedy = f"; use --set cases.{path}=[{value}]" if axis.name == path else " under every label"
                yield Complaint(0, f"--set {assignment}: cases.{axis.name} sets this key{remedy}")


def _unsound(axis: Axis, data: Mapping[str, Any]) -> Iterator[str]:
    """What an axis may not do."""
    if axis.name in (*_COLUMNS, *_QUANTILES, *_EXPORTED):
        yield f"an axis cannot be named '{axis.name}', which is a column of the results"
    paths = dict.fromkeys(patch.path for point in axis.points for patch in point.patches)
    if meant := next((one for one in axis.points if _is_value(one)), None):
        kind = next(patch.value for patch in meant.patches if patch.path == "kind")
        yield (
            f"under the label '{meant.label}' stands a mapping, which says by key paths what the label sets, "
            f"and 'kind' is no such path: if it is the value of ${axis.name}, write "
            f"{meant.label}: {{${axis.name}: {{kind: {kind}, ...}}}}"
        )
        return
    for path in paths:
        head, *rest = path.split(".")
        if head not in CHANGEABLE:
            yield _cannot_change(head)
        elif head not in DATA:
            section = data.get(head)
            known = section if isinstance(section, Mapping) else {}
            if not rest or rest[0] not in known:
                near = did_you_mean(rest[0], known) if rest else ""
                named = f"'{rest[0]}' is none of the {head}" if rest else f"name one of the {head}"
                yield f"{named}{near} (there are: {one_of(known) or 'none'})"
            elif head == "metrics" and rest[1:] in ([], ["estimators"]):
                yield f"a case cannot change '{path}', only settings of the metric"


def _is_value(point: Point) -> bool:
    """Whether the mapping under a label is a component, and names nothing that a case can change."""
    heads = {patch.path.partition(".")[0] for patch in point.patches}
    return "kind" in heads and heads.isdisjoint(CHANGEABLE)


def _misplaced(axis: Axis, document: Document) -> list[Complaint]:
    """Key paths of an axis that lead nowhere."""
    found = []
    for point in axis.points:
        at_label = document
        for patch in point.patches:
            try:
                at_label = replace(point, patches=(patch,)).apply(at_label)
            except ConfigError as error:
                found.append(Complaint(patch.place.line, str(error)))
    return found
