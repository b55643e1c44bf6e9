"""An experiment as the user wrote it, and the units of work that it expands to.

A unit is one estimator with one setting on one case, scored by its metrics. The axes under ``cases`` expand
to their product; an axis that touches neither the data of a case nor a given estimator nor its metrics does
not multiply that estimator, so that no unit stands twice.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, field_validator

from hident.config.load import Document, Location, Problem, override, problems_of, read
from hident.config.spec import Component, Count, Of, Spec
from hident.config.suggest import did_you_mean, one_of
from hident.engine.trial import Data
from hident.errors import ConfigError
from hident.estimators.base import EstimatorSpec
from hident.metrics.base import MetricSpec

FORMAT = 1
Label = str | float | int
Statistic = Literal["mean", "median", "std"]
_DATA = tuple(Data.model_fields)


class PublishedCells(Spec):
    """Which of our cells stand beside which printed numbers."""

    table: str
    """The ``table`` column of published.csv."""
    row: str
    """The ``row`` column; {axis} stands for a case's label, e.g. 'N={samples}'."""
    quantity: str
    """The ``quantity`` column; {axis} likewise."""
    estimator: str
    """Name of the estimator in this file."""
    metric: str
    """Label of the metric."""
    statistic: Statistic = "mean"
    """The statistic over trials that stands beside the printed number."""
    at: dict[str, Any] = {}
    """Labels of axes that limit the correspondence; all by default."""


class Published(Spec):
    """The printed numbers that a run is held against."""

    paper_trials: Annotated[Count, Field(ge=1)] | Literal["unknown", "exact"]
    """Runs that the paper averages; 'unknown' if it does not say, 'exact' for a formula's value."""
    cells: tuple[PublishedCells, ...]
    """The correspondence of cells."""


class _Cases(Spec):
    """The axes, which must be sound before they can be applied."""

    cases: dict[str, list[Any] | dict[str, dict[str, Any]]] = {}
    """Axes: a key path with a list of values, or a name with labels and the values that each sets."""

    @field_validator("cases")
    @classmethod
    def _full_axes(cls, cases: dict[str, Any]) -> dict[str, Any]:
        for name, axis in cases.items():
            if not axis:
                raise ValueError(f"the axis '{name}' is empty")
            if isinstance(axis, list) and any(isinstance(value, dict) for value in axis):
                raise ValueError(
                    f"the axis '{name}' lists mappings: name each, as 'label: {{{name}: value}}'"
                )
        return cases


class Experiment(Data, _Cases):
    """One YAML file."""

    version: Literal[1]
    """Version of the file format: 1."""
    title: str
    """One line for listings and reports."""
    paper: str | None = None
    """Folder under experiments/ with the printed numbers and the reasons."""
    seed: Annotated[Count, Field(ge=0)] = 1
    """Seed of all random streams."""
    trials: Annotated[Count, Field(ge=1)]
    """Monte Carlo trials of every case."""
    estimators: dict[str, Annotated[EstimatorSpec, Of("estimator")]]
    """The estimators by the name that tables show."""
    metrics: dict[str, Annotated[MetricSpec, Of("metric")]]
    """The metrics by the name that tables show."""
    tables: dict[str, Annotated[Component, Of("table")]] = {}
    """Tables of table.md."""
    figures: dict[str, Annotated[Component, Of("figure")]] = {}
    """Figures, each written as NAME.png."""
    published: Published | None = None
    """The printed numbers that the results stand beside."""

    @field_validator("estimators", "metrics")
    @classmethod
    def _named(cls, value: dict[str, Any]) -> dict[str, Any]:
        if not value:
            raise ValueError("must hold at least one")
        for name in value:
            if "." in name or not name.strip():
                raise ValueError(f"the name {name!r} must not be empty or hold a dot")
        return value

    @field_validator("tables", "figures")
    @classmethod
    def _file_names(cls, value: dict[str, Any]) -> dict[str, Any]:
        for name in value:
            if not name.replace("_", "").replace("-", "").isalnum():
                raise ValueError(f"the name {name!r} must consist of letters, digits, - and _")
        return value


@dataclass(frozen=True)
class Axis:
    """One axis of the cases: its labels, and the patches (key path -> value) behind each label."""

    name: str
    labels: tuple[Label, ...]
    patches: tuple[dict[str, Any], ...]

    @classmethod
    def of(cls, name: str, written: list[Any] | dict[str, dict[str, Any]]) -> Axis:
        if isinstance(written, dict):
            return cls(name, tuple(written), tuple(written.values()))
        labels = tuple(v if isinstance(v, str | int | float) else str(v) for v in written)
        return cls(name, labels, tuple({name: value} for value in written))

    @cached_property
    def roots(self) -> frozenset[tuple[str, ...]]:
        """What the axis touches: ("data",), ("estimators", name) or ("metrics", name)."""
        touched = set()
        for path in itertools.chain.from_iterable(self.patches):
            head, *rest = path.split(".")
            touched.add(("data",) if head in _DATA else (head, *rest[:1]))
        return frozenset(touched)


@dataclass(frozen=True)
class Unit:
    """One estimator on one case: ``labels`` by axis, in the order of the axes."""

    labels: dict[str, Label]
    name: str
    data: Data
    estimator: EstimatorSpec
    metrics: dict[str, MetricSpec]

    @cached_property
    def metric_labels(self) -> tuple[str, ...]:
        return tuple(label for name, metric in self.metrics.items() for label in metric.labels(name))

    def described(self) -> str:
        """The unit in words, for messages."""
        case = ", ".join(f"{axis} {label}" for axis, label in self.labels.items())
        return f"estimator '{self.name}'" + (f" at {case}" if case else "")


@dataclass(frozen=True)
class Plan:
    """An experiment with its file, its axes and its units."""

    path: Path
    document: Document
    experiment: Experiment
    axes: tuple[Axis, ...]
    units: tuple[Unit, ...]

    @property
    def name(self) -> str:
        """The name of the configuration: its file's stem."""
        return self.path.stem

    @property
    def root(self) -> Path:
        """The folder that holds experiments/: the nearest above the file, else the current one."""
        for folder in self.path.resolve().parents:
            if (folder / "experiments").is_dir():
                return folder
        return Path()

    @property
    def paper(self) -> Path | None:
        """The folder with the paper's printed numbers."""
        paper = self.experiment.paper
        return None if paper is None else self.root / "experiments" / paper


def load(
    path: Path, assignments: Iterable[str] = (), options: Mapping[str, int | None] = MappingProxyType({})
) -> Plan:
    """Read a configuration, apply ``--set`` assignments and options such as trials, expand its cases.

    Raises
    ------
    ConfigError
        With all that is wrong with the file, one line for each problem.
    """
    document = override(read(path), assignments)
    for key, value in options.items():
        if value is not None:
            document = document.patched(key, value, f"--{key} {value}")
    if document.data.get("version", FORMAT) != FORMAT:
        problem = Problem(
            ("version",), f"this hident reads version {FORMAT} of the format", document.data["version"]
        )
        raise document.error([problem])
    axes = _axes(document)
    # The first label of every axis completes the file: what a case sets need not stand twice.
    first = _choose(document, axes, {})
    try:
        experiment = Experiment.model_validate(first.data)
    except ValidationError as error:
        raise first.error(problems_of(error)) from None
    if problems := [*_unknown_names(experiment, axes)]:
        raise first.error(problems)
    expansion = _Expansion(document, axes)
    units = tuple(expansion.units(experiment))
    if expansion.complaints:
        raise ConfigError("\n".join(dict.fromkeys(expansion.complaints)))
    return Plan(path, document, experiment, axes, units)


def _axes(document: Document) -> tuple[Axis, ...]:
    try:
        cases = _Cases.model_validate({"cases": document.data.get("cases") or {}}).cases
    except ValidationError as error:
        raise document.error(problems_of(error)) from None
    axes = tuple(Axis.of(name, written) for name, written in cases.items())
    can = (*_DATA, "estimators", "metrics")
    problems = [
        Problem(
            ("cases", axis.name),
            f"a case cannot change '{root[0]}'{did_you_mean(root[0], can)} (it can: {one_of(can)})",
        )
        for axis in axes
        for root in axis.roots
        if root[0] not in ("data", *can)
    ]
    if problems:
        raise document.error(problems)
    return axes


def _choose(document: Document, axes: tuple[Axis, ...], choice: Mapping[int, int]) -> Document:
    """The document with every axis applied at its chosen label, the first where none is chosen."""
    for i, axis in enumerate(axes):
        index = choice.get(i, 0)
        labelled = isinstance(document.data["cases"][axis.name], dict)
        place = document.place(("cases", axis.name, str(axis.labels[index]) if labelled else index))
        for path, value in axis.patches[index].items():
            document = document.patched(path, value, place)
    return document


class _Expansion:
    """The units of an experiment; each part is validated once for each choice of the axes that touch it."""

    def __init__(self, document: Document, axes: tuple[Axis, ...]) -> None:
        self._document, self._axes = document, axes
        self._parts: dict[tuple[Any, ...], Any] = {}
        self.complaints: list[str] = []

    def units(self, experiment: Experiment) -> list[Unit]:
        found = []
        for name in experiment.estimators:
            scored = [
                metric
                for metric, spec in experiment.metrics.items()
                if spec.estimators is None or name in spec.estimators
            ]
            roots = {("data",), ("estimators", name), *(("metrics", metric) for metric in scored)}
            relevant = [i for i, axis in enumerate(self._axes) if axis.roots & roots]
            for indices in itertools.product(*(range(len(self._axes[i].labels)) for i in relevant)):
                choice = dict(zip(relevant, indices, strict=True))
                unit = self._unit(name, scored, choice)
                if unit is not None:
                    found.append((self._relevant(("data",), choice), unit))
        return [unit for _, unit in sorted(found, key=lambda pair: pair[0])]

    def _unit(self, name: str, scored: list[str], choice: dict[int, int]) -> Unit | None:
        data = self._part(("data",), Data.model_validate, choice)
        estimator = self._part(("estimators", name), Of("estimator").validate, choice)
        metrics = {
            metric: self._part(("metrics", metric), Of("metric").validate, choice) for metric in scored
        }
        if data is None or estimator is None or None in metrics.values():
            return None
        labels = {self._axes[i].name: self._axes[i].labels[j] for i, j in choice.items()}
        unit = Unit(labels, name, data, estimator, metrics)
        if problems := list(_mismatches(unit)):
            document = _choose(self._document, self._axes, choice)
            self.complaints += str(document.error(problems)).splitlines()
        return unit

    def _relevant(self, root: tuple[str, ...], choice: Mapping[int, int]) -> tuple[tuple[int, int], ...]:
        return tuple((i, j) for i, j in sorted(choice.items()) if root in self._axes[i].roots)

    def _part(self, root: tuple[str, ...], validate: Callable[[Any], Any], choice: Mapping[int, int]) -> Any:
        relevant = self._relevant(root, choice)
        if (root, relevant) not in self._parts:
            document = _choose(self._document, self._axes, dict(relevant))
            if root == ("data",):
                location: Location = ()
                raw: Any = {name: document.data[name] for name in _DATA if name in document.data}
            else:
                location, raw = root, document.data[root[0]][root[1]]
            try:
                self._parts[root, relevant] = validate(raw)
            except ValidationError as error:
                self._parts[root, relevant] = None
                self.complaints += str(document.error(problems_of(error, location))).splitlines()
        return self._parts[root, relevant]


def _mismatches(unit: Unit) -> Iterator[Problem]:
    """What does not fit together in a unit, though each part is sound."""
    data = unit.data
    try:
        data.excitation.check(data.samples, data.dt or 1.0)
    except ValueError as error:
        yield Problem(("excitation",), str(error))
    fewest = unit.estimator.fewest_samples()
    if data.samples < fewest:
        yield Problem(
            ("estimators", unit.name), f"needs at least {fewest} samples, but samples is {data.samples}"
        )
    if not unit.metrics:
        yield Problem(("estimators", unit.name), "no metric scores this estimator")
    true, estimated = data.system.provides(), unit.estimator.provides()
    for name, metric in unit.metrics.items():
        for missing in sorted(metric.needs_of_truth() - true):
            yield Problem(
                ("metrics", name),
                f"the metric '{metric.kind}' needs the {missing} of the system, which "
                f"'{data.system.kind}' does not have (it has: {one_of(sorted(true))})",
            )
        for missing in sorted(metric.needs_of_estimate() - estimated):
            yield Problem(
                ("metrics", name),
                f"the metric '{metric.kind}' needs the {missing} of the estimate, which estimator "
                f"'{unit.name}' ({unit.estimator.kind}) does not give (it gives: "
                f"{one_of(sorted(estimated))}); 'estimators:' under the metric limits it to some",
            )


def _unknown_names(experiment: Experiment, axes: Sequence[Axis]) -> Iterator[Problem]:
    """Names that refer to nothing in the file."""

    def unknown(location: Location, what: str, name: str, known: Iterable[str]) -> Iterator[Problem]:
        known = list(known)
        if name not in known:
            yield Problem(
                location,
                f"no {what} has this name{did_you_mean(name, known)} (it has: {one_of(known)})",
                name,
            )

    labels: list[str] = []
    for name, metric in experiment.metrics.items():
        labels += metric.labels(name)
        for i, estimator in enumerate(metric.estimators or ()):
            yield from unknown(
                ("metrics", name, "estimators", i), "estimator", estimator, experiment.estimators
            )
    known = {
        "estimator": list(experiment.estimators),
        "metric": labels,
        "axis": [axis.name for axis in axes],
        **{f"label of {axis.name}": list(map(str, axis.labels)) for axis in axes},
    }
    for family in ("tables", "figures"):
        for name, spec in getattr(experiment, family).items():
            for field, what, referred in spec.references():
                yield from unknown((family, name, field), what, referred, known.get(what, [referred]))
    for i, cell in enumerate(experiment.published.cells if experiment.published else ()):
        at = ("published", "cells", i)
        yield from unknown((*at, "estimator"), "estimator", cell.estimator, known["estimator"])
        yield from unknown((*at, "metric"), "metric", cell.metric, known["metric"])
        for axis, label in cell.at.items():
            yield from unknown((*at, "at"), "axis", axis, known["axis"])
            yield from unknown((*at, "at", axis), "label", str(label), known.get(f"label of {axis}", ()))
        for field in ("row", "quantity"):
            for axis in re.findall(r"{([^}]*)}", getattr(cell, field)):
                yield from unknown((*at, field), "axis", axis, known["axis"])
