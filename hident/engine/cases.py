"""The axes under ``cases``: what each of their labels changes."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any

from pydantic import BeforeValidator, ValidationError

from hident.config.load import Document, Problem, problems_of, split_assignment
from hident.config.spec import Spec
from hident.config.suggest import did_you_mean, one_of, there_is_no
from hident.config.variables import cannot_join, stands_alone, stuck, texts, unknown, variables_in
from hident.config.yaml12 import Complaint, Location, Place, error_of, shown
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


@dataclass(frozen=True)
class Axis:
    """One axis of the cases: its labels, and what each of them changes.

    Behind each label, ``patches`` holds key path -> value, ``places`` where each was written, and
    ``variables`` name -> value; ``uses`` are the parts of the file that name one of these.
    """

    name: str
    labels: tuple[Label, ...]
    patches: tuple[dict[str, Any], ...]
    places: tuple[dict[str, Place], ...]
    variables: tuple[dict[str, Any], ...]
    uses: frozenset[tuple[str, ...]] = frozenset()

    @classmethod
    def of(cls, name: str, written: list[Any] | dict[str, Any], document: Document) -> Axis:
        """The axis that a document holds under ``cases``."""
        labels, values = _labels(written), list(written.values() if isinstance(written, dict) else written)
        keys: Iterable[str | int] = written if isinstance(written, dict) else range(len(written))
        patches: list[dict[str, Any]] = []
        variables: list[dict[str, Any]] = []
        for label, value in zip(labels, values, strict=True):
            if isinstance(value, Mapping):
                patches.append({path: item for path, item in value.items() if not path.startswith("$")})
                named = {path[1:]: item for path, item in value.items() if path.startswith("$")}
                variables.append({name: label, **named})
            else:
                sets = isinstance(written, list) and name.partition(".")[0] in CHANGEABLE
                patches.append({name: value} if sets else {})
                variables.append({name: value})
        places = tuple(
            {path: document.place(("cases", name, key, path)) for path in patch}
            for key, patch in zip(keys, patches, strict=True)
        )
        return cls(name, labels, tuple(patches), places, tuple(variables))

    @cached_property
    def roots(self) -> frozenset[tuple[str, ...]]:
        """What the axis touches: ("data",), ("estimators", name) or ("metrics", name)."""
        return self.uses | frozenset(map(_root, itertools.chain.from_iterable(self.patches)))

    def leaves_out(self, index: int) -> frozenset[str]:
        """The names of the estimators that a label of the axis sets to null."""
        patches = self.patches[index].items()
        return frozenset(_root(path)[1] for path, value in patches if _leaves_out(path, value))

    def apply(self, document: Document, index: int) -> Document:
        """The document with what a label of the axis sets; an estimator that it leaves out stays as it is.

        Raises
        ------
        ConfigError
            If a key path leads nowhere.
        """
        for path, value in self.patches[index].items():
            if not _leaves_out(path, value):
                document = document.patched(path, value, self.places[index][path])
        return document


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


def _root(path: str) -> tuple[str, ...]:
    head, *rest = path.split(".")
    return ("data",) if head in DATA else (head, *rest[:1])


def _leaves_out(path: str, value: Any) -> bool:
    """Whether a patch leaves an estimator out of its cases, as ``estimators.NAME: null`` does."""
    head, *rest = path.split(".")
    return value is None and head == "estimators" and len(rest) == 1


def sound_axes(document: Document, complaints: list[Complaint]) -> tuple[Axis, ...]:
    """The axes that can be applied; what is wrong with the others goes to the complaints.

    Raises
    ------
    ConfigError
        If it is not clear which value a variable has: the rest cannot be judged.
    """
    sound: list[Axis] = []
    cases = document.data.get("cases", {})
    at_first, every = document, True
    try:
        written = Cases.model_validate({"cases": cases}).cases
    except ValidationError as error:
        problems = problems_of(error)
        complaints += document.complaints_of(problems)
        unsound = {problem.location[1:2] for problem in problems}
        every = False
        written = {} if () in unsound else {n: axis for n, axis in cases.items() if (n,) not in unsound}
    axes = [Axis.of(name, axis, document) for name, axis in written.items()]
    variables = _Variables(document, axes)
    for axis in axes:
        problems = [Problem(("cases", axis.name), message) for message in _unsound(axis, document.data)]
        if not problems:
            problems = list(variables.idle(axis))
        found = document.complaints_of(problems) or _misplaced(axis, at_first)
        if found:
            complaints += found
        else:
            sound.append(replace(axis, uses=variables.uses(axis)))
            at_first = axis.apply(at_first, 0)
    unclear = document.complaints_of(variables.unclear(unknown_too=every))
    known = {axis.name for axis in sound}
    if unclear or any(variables.uses(axis) for axis in axes if axis.name not in known):
        raise error_of([*document.complaints, *complaints, *unclear])
    return tuple(sound)


def written_axes(document: Document) -> tuple[str, ...]:
    """The names of the axes under ``cases``, also of those that cannot be applied."""
    cases = document.data.get("cases")
    return tuple(cases) if isinstance(cases, Mapping) else ()


class _Variables:
    """Where a file and what its axes set name variables."""

    def __init__(self, document: Document, axes: Sequence[Axis]) -> None:
        self._document, self._axes = document, axes
        self._texts: list[tuple[Location, tuple[str, ...], str]] = []
        for section in CHANGEABLE:
            for at, text in texts(document.data.get(section), (section,)):
                if section in DATA:
                    self._texts.append((at, ("data",), text))
                elif at[1:]:
                    self._texts.append((at, (section, str(at[1])), text))
        for axis in axes:
            for label, patch in zip(axis.labels, axis.patches, strict=True):
                for path, value in patch.items():
                    self._texts += [
                        (at, _root(path), text)
                        for at, text in texts(value, ("cases", axis.name, str(label), path))
                    ]

    def uses(self, axis: Axis) -> frozenset[tuple[str, ...]]:
        """What names a variable of the axis."""
        own = {*self._names(axis)}
        return frozenset(root for _, root, text in self._texts if own.intersection(variables_in(text)))

    def idle(self, axis: Axis) -> Iterator[Problem]:
        """The variables of an axis that nothing uses, though the axis does nothing else."""
        used = {name for _, _, text in self._texts for name in variables_in(text)}
        for name in self._names(axis):
            if name not in used and (name != axis.name or self._only_names(axis)):
                yield Problem(("cases", axis.name), self._idle(name, axis))

    def _only_names(self, axis: Axis) -> bool:
        """Whether an axis does nothing but give its variable values."""
        written = self._document.data["cases"][axis.name]
        values = written.values() if isinstance(written, Mapping) else written
        return not any(axis.patches) and not any(isinstance(value, Mapping) for value in values)

    def _idle(self, name: str, axis: Axis) -> str:
        if name != axis.name:
            return f"nothing uses '${name}'"
        head = name.partition(".")[0]
        near = did_you_mean(head, CHANGEABLE)
        cannot = f"a case cannot change '{head}'{near} (it can: {one_of(CHANGEABLE)})"
        return f"{cannot}, and nothing uses '${name}'"

    def unclear(self, *, unknown_too: bool) -> Iterator[Problem]:
        """Variables whose value is not clear, and values that cannot stand where their variable does."""
        known: dict[str, Axis] = {}
        for axis in self._axes:
            for name in self._names(axis):
                other = known.setdefault(name, axis)
                if other is not axis:
                    yield Problem(
                        ("cases", axis.name), f"the axis '{other.name}' has a variable '{name}' too"
                    )
                for label, own in zip(axis.labels, axis.variables, strict=True):
                    if name not in own:
                        yield Problem(
                            ("cases", axis.name, str(label)), f"must set '${name}', as other labels do"
                        )
        for at, root, text in self._texts:
            for name in variables_in(text):
                if name not in known:
                    if unknown_too:
                        yield Problem(at, unknown(name, known, "axis"))
                elif root[0] == "metrics" and at[2:3] == ("estimators",):
                    yield Problem(at, "a case cannot change the estimators of a metric")
                elif not stands_alone(text):
                    for own in known[name].variables:
                        if stuck(own.get(name, "")):
                            yield Problem(at, cannot_join(name, own[name]))

    @staticmethod
    def _names(axis: Axis) -> tuple[str, ...]:
        return tuple(dict.fromkeys(itertools.chain.from_iterable(axis.variables)))


def skips(document: Document, axes: Sequence[Axis], complaints: list[Complaint]) -> tuple[Skip, ...]:
    """The cases that a document leaves out under ``skip``; what is wrong goes to the complaints."""
    written = document.data.get("skip", ())
    found: list[Skip] = []
    # Of an axis that cannot be applied, that is said, and it has no labels to be wrong.
    unsound = set(written_axes(document)) - {axis.name for axis in axes}
    known = {axis.name: list(map(str, axis.labels)) for axis in axes}
    estimators = document.data.get("estimators")
    known["estimator"] = list(estimators) if isinstance(estimators, Mapping) else []
    for i, entry in enumerate(written if isinstance(written, list) else ()):
        problems: list[Problem] = []
        chosen: dict[str, frozenset[str]] = {}
        for name, labels in entry.items() if isinstance(entry, Mapping) else ():
            names = [str(label) for label in (labels if isinstance(labels, list) else [labels])]
            chosen[name] = frozenset(names)
            if name not in known and name not in unsound:
                problems.append(Problem(("skip", i, name), there_is_no("axis", name, known)))
            what = "estimator" if name == "estimator" else "label"
            problems += [
                Problem(("skip", i, name), there_is_no(what, one, known[name]))
                for one in names
                if name in known and one not in known[name]
            ]
        if not chosen and isinstance(entry, Mapping):
            problems.append(Problem(("skip", i), "must name labels of axes, an estimator, or both"))
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
