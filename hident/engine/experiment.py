"""An experiment as the user wrote it, and the units of work that it expands to.

A unit is one estimator with one setting on one case, scored by its metrics. The axes under ``cases`` expand
to their product; an axis that touches neither the data of a case nor a given estimator nor its metrics does
not multiply that estimator, so that no unit stands twice.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_core import CoreSchema

from hident import plugins
from hident.config.load import Document, Problem, content_of, override, problems_of, read_leniently
from hident.config.references import CaseLabels, EstimatorName, Metric, Template, referring
from hident.config.repeated import repeated
from hident.config.spec import Component, Count, Of, Spec
from hident.config.suggest import counted, did_you_mean, there_is_no
from hident.config.yaml12 import Complaint, Location, Place, error_of
from hident.engine.cases import (
    CHANGEABLE,
    Axis,
    Cases,
    Label,
    Skip,
    idle_assignments,
    skips,
    sound_axes,
    written_axes,
)
from hident.engine.every_value import with_every_value
from hident.engine.expansion import Expansion, Unit
from hident.engine.run_files import DEFAULT_FORMAT, FORMATS, POWER, Format, misnamed
from hident.engine.sequential import Sequential, Statistic, Trials, Until
from hident.engine.written import NEEDED, Written
from hident.errors import ConfigError, RecordAbsent
from hident.estimators.base import EstimatorSpec
from hident.metrics.base import MetricSpec

__all__ = ["Experiment", "Label", "Plan", "Published", "PublishedCells", "Statistic", "Unit", "load"]

FORMAT = 1
# Options of the command line by the keys that they override, where their names differ.
_OPTIONS = {"formats": "format"}


# Whether it scores the estimator at the labels is checked with the printed numbers.
_Metric = Annotated[str, Metric(scores=())]


class PublishedCells(Spec):
    """Which of our cells stand beside which printed numbers."""

    table: str
    """The ``table`` column of published.csv."""
    row: Annotated[str, Template()]
    """The ``row`` column; {axis} stands for a case's label, e.g. 'N={samples}'."""
    quantity: Annotated[str, Template()] | None = None
    """The ``quantity`` column; {axis} likewise."""
    estimator: EstimatorName
    """Name of the estimator in this file."""
    metric: _Metric | None = None
    """Label of the metric."""
    quantities: Annotated[dict[str, _Metric], Template()] = {}
    """Several quantities of the row at once, each with its metric: {a1: theta a_1, b0: theta b_0}."""
    statistic: Statistic = "mean"
    """The statistic over trials that stands beside the printed number."""
    at: CaseLabels = {}
    """Labels of axes that limit the correspondence; all by default."""
    circular: bool = False
    """Whether the printed number is the truth of this file, so that it is no wonder that it comes out."""

    @model_validator(mode="after")
    def _one_or_several(self) -> Self:
        alone = (self.quantity is not None, self.metric is not None)
        if alone != ((False, False) if self.quantities else (True, True)):
            raise ValueError("give 'quantity' and 'metric', or 'quantities' instead of both")
        return self

    def pairs(self) -> tuple[tuple[str, str], ...]:
        """The quantities with their metrics."""
        if self.quantity is not None and self.metric is not None:
            return ((self.quantity, self.metric),)
        return tuple(self.quantities.items())


def _as_runs(value: Any) -> Any:
    if value in ("unknown", "exact") or (type(value) is int and value >= 1):
        return value
    raise ValueError("must be a whole number of at least 1, 'unknown' or 'exact'")


def _given(estimator: Any) -> Any:
    if estimator is None:
        raise ValueError("must be an estimator; only a label of an axis can set it to null, to leave it out")
    return estimator


def _as_changes(value: Any) -> Any:
    if not isinstance(value, Mapping) or not value:
        raise ValueError("must set values by their key path, as 'noise.std: 2'")
    return value


def _as_list(value: Any) -> Any:
    """The formats that a text names, such as 'pdf,svg'."""
    return [name.strip() for name in value.split(",")] if isinstance(value, str) else value


def _in_order(value: tuple[Format, ...]) -> tuple[Format, ...]:
    """Each once, and in one order, as their order changes no file."""
    return tuple(name for name in FORMATS if name in value)


def _in_one_line(value: dict[str, Any]) -> dict[str, Any]:
    for name in value:
        if not name.strip() or not name.isprintable():
            raise ValueError(f"the name {name!r} must be one line of text")
    return value


class Published(Spec):
    """The printed numbers that a run is held against."""

    paper_trials: Annotated[
        Annotated[int, Field(ge=1)] | Literal["unknown", "exact"], BeforeValidator(_as_runs)
    ]
    """Runs that the paper averages; 'unknown' if it does not say, 'exact' for a formula's value."""
    same_data: bool = False
    """Whether the trials are the paper's own data, as many as it ran: then digits are equal or differ."""
    cells: tuple[PublishedCells, ...]
    """The correspondence of cells."""

    @model_validator(mode="after")
    def _spread_of_several(self) -> Self:
        if self.paper_trials in (1, "unknown") and any(cell.statistic == "std" for cell in self.cells):
            raise ValueError("the std of one run does not exist: give 'paper_trials' as the number of runs")
        if self.same_data and not isinstance(self.paper_trials, int):
            raise ValueError("'same_data' needs the number of the paper's runs as 'paper_trials'")
        return self


class Experiment(Written, Cases):
    """One YAML file."""

    version: Literal[1]
    """Version of the file format: 1."""
    title: str
    """One line for listings and reports."""
    plugins: tuple[str, ...] = ()
    """Files of Python, beside this one, that add components."""
    paper: str | None = None
    """Folder under experiments/ with the printed numbers and the reasons."""
    seed: Annotated[Count, Field(ge=0)] = 1
    """Seed of all random streams."""
    trials: Trials
    """Monte Carlo trials of every case."""
    estimators: dict[str, Annotated[EstimatorSpec, Of("estimator"), BeforeValidator(_given)]]
    """The estimators by the name that tables show."""
    metrics: dict[str, Annotated[MetricSpec, Of("metric")]]
    """The metrics by the name that tables show."""
    tables: dict[str, Annotated[Component, Of("table")]] = {}
    """Tables of table.md."""
    figures: dict[str, Annotated[Component, Of("figure")]] = {}
    """Figures, each written as NAME.png, or in other 'formats'."""
    formats: Annotated[
        tuple[Format, ...], BeforeValidator(_as_list), AfterValidator(_in_order), Field(min_length=1)
    ] = (DEFAULT_FORMAT,)
    """Formats of the files: png, pdf and svg of figures (png if none of these is named), tex of tables."""
    published: Published | None = None
    """The printed numbers that the results stand beside."""
    alternatives: Annotated[
        dict[str, Annotated[dict[str, Any], BeforeValidator(_as_changes)]], AfterValidator(_in_one_line)
    ] = {}
    """Plausible mistakes and other readings, each with the values that it sets, by key path as in 'cases'.

    'hident power' runs them, and says which printed numbers tell them from this file. In a path,
    'estimators.*.KEY' is that key of every estimator that holds it, and likewise for metrics. 'at' names
    the labels of axes to which it is kept. 'statistic' sets that of all numbers.
    """

    @field_validator("version", mode="before")
    @classmethod
    def _known(cls, version: Any) -> Any:
        if type(version) is not int or version != FORMAT:
            raise ValueError(f"this hident reads version {FORMAT} of the format")
        return version

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

    @model_validator(mode="after")
    def _same_data_are_counted(self) -> Self:
        if self.published is not None and self.published.same_data and isinstance(self.trials, Sequential):
            raise ValueError("'same_data' under 'published' needs a number of trials, not a rule")
        return self

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        found = super().__get_pydantic_json_schema__(schema, handler)
        # The cases may set what the file leaves out, and a single noise needs no list.
        for name in NEEDED:
            written = found["properties"][name]
            del written["default"]
            written["anyOf"].remove({"type": "null"})
        noise = found["properties"]["noise"]
        noise["anyOf"] = [{"type": noise.pop("type"), "items": noise["items"]}, noise.pop("items")]
        return found


@dataclass(frozen=True)
class Plan:
    """An experiment with its file, its axes and its units; nothing about it changes once it is known.

    With a ``perturbation`` k > 0, the records are those of :func:`hident.engine.trial.generate` a last bit
    away, and the scores are stored under keys of their own. A ``trial_timeout`` in seconds ends what takes
    longer in a trial, which then counts as failed and is not stored: no key depends on it.
    """

    path: Path
    document: Document
    experiment: Experiment
    axes: tuple[Axis, ...]
    units: tuple[Unit, ...]
    skips: tuple[Skip, ...] = ()
    perturbation: int = 0
    trial_timeout: float | None = None
    _upto: int | None = None
    _held: Mapping[str, Label] = field(default_factory=dict)
    _files: dict[Path, bytes | None] = field(default_factory=dict, repr=False, compare=False)

    @property
    def seed(self) -> int:
        """The seed of all random streams."""
        return self.experiment.seed

    @property
    def trials(self) -> int:
        """The number of trials of every unit; with a rule, up to the decision that is looked at."""
        match self.experiment.trials:
            case Sequential(until=rule):
                return rule.least if self._upto is None else self._upto
            case number:
                return number

    @property
    def rule(self) -> Until | None:
        """The rule that ends a run, if that is no number of trials."""
        match self.experiment.trials:
            case Sequential(until=rule):
                return rule
        return None

    @property
    def decisions(self) -> tuple[int, ...]:
        """The numbers of trials after which a run may end: with a rule, several."""
        return (self.trials,) if self.rule is None else self.rule.decisions

    @property
    def trials_said(self) -> str:
        """The number of trials in words."""
        if self.rule is not None:
            return f"{self.rule.least} to {counted(self.rule.most, 'trial')}"
        return counted(self.trials, "trial")

    def upto(self, decision: int) -> Plan:
        """The plan with the trials before a decision of its rule; the plan itself if it has none."""
        return self if self.rule is None else replace(self, _upto=decision)

    def at_most(self, trials: int) -> Plan:
        """The plan with no more trials than these."""
        if self.rule is None or trials < self.rule.least:
            return self.changed(trials=min(self.trials, trials))
        rule = self.rule.model_copy(update={"most": min(self.rule.most, trials)})
        experiment = self.experiment.model_copy(update={"trials": Sequential(until=rule)})
        return replace(self, experiment=experiment)

    @cached_property
    def keys(self) -> tuple[dict[str, str], ...]:
        """For each unit, the keys of its stored trials by the names of its metrics (:meth:`Unit.keys`)."""
        return tuple(unit.keys(self.seed, self.perturbation) for unit in self.units)

    def at(self, labels: Mapping[str, Label]) -> Plan:
        """The plan of the cases at these labels: their axes are no axes of it, and no unit stands elsewhere.

        Its units are the same objects, with all their labels. There is none where the labels are skipped, not
        even of an estimator that only some of them touch.
        """
        axes = tuple(axis for axis in self.axes if axis.name not in labels)
        held = {**self._held, **labels}
        skipped = any(skip.covers(None, held) for skip in self.skips)
        units = () if skipped else tuple(unit for unit in self.units if unit.is_at(labels))
        return replace(self, axes=axes, units=units, _held=held)

    @cached_property
    def timing_keys(self) -> tuple[str, ...]:
        """For each unit, the key of the seconds that its fits took (:meth:`Unit.timing_key`)."""
        return tuple(unit.timing_key(self.seed, self.perturbation) for unit in self.units)

    def changed(
        self,
        *,
        trials: int | None = None,
        seed: int | None = None,
        perturbation: int | None = None,
        trial_timeout: float | None = None,
    ) -> Plan:
        """The plan with another number of trials, seed, perturbation or trial timeout.

        ConfigError if there is no trial, the seed or the perturbation is negative, or the timeout is not a
        number above 0.
        """
        given = {"trials": trials, "seed": seed}
        experiment = self.experiment.model_copy(
            update={name: value for name, value in given.items() if value is not None}
        )
        perturbation = self.perturbation if perturbation is None else perturbation
        wanted = self.trials if trials is None else trials
        if wanted < 1 or min(experiment.seed, perturbation) < 0:
            raise ConfigError(
                "trials must be at least 1, seed and perturbation at least 0, not "
                f"{wanted}, {experiment.seed} and {perturbation}"
            )
        timeout = self.trial_timeout if trial_timeout is None else trial_timeout
        if timeout is not None and not 0.0 < timeout < math.inf:
            raise ConfigError(f"the trial timeout must be a number of seconds above 0, not {timeout:g}")
        plan = replace(self, experiment=experiment, perturbation=perturbation, trial_timeout=timeout)
        if problems := list(_unrepeatable(plan)):
            raise self.document.error(problems)
        return plan

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
    def plugin_files(self) -> tuple[Path, ...]:
        """The files under ``plugins``, which processes that compute its trials need."""
        return _beside(self.path, self.experiment.plugins)

    @property
    def paper(self) -> Path | None:
        """The folder with the paper's printed numbers."""
        paper = self.experiment.paper
        return None if paper is None else self.root / "experiments" / paper

    def paper_file(self, name: str) -> bytes | None:
        """A file of the paper's folder as it was when it was first asked for; None if there was none.

        ConfigError if the file cannot be read.
        """
        return None if self.paper is None else self._known_file(self.paper / name)

    def power_file(self, name: str) -> bytes | None:
        """An accepted file of its alternatives, likewise."""
        return self._known_file(self.root / "results" / POWER / self.name / name)

    def _known_file(self, path: Path) -> bytes | None:
        if path not in self._files:
            self._files[path] = content_of(path)
        return self._files[path]


@np.errstate(all="ignore")
def load(
    source: Path | Document,
    assignments: Sequence[str] = (),
    options: Mapping[str, int | str | None] = MappingProxyType({}),
) -> Plan:
    """Read a configuration, apply ``--set`` assignments and options such as trials, expand its cases.

    ConfigError with all that is wrong with the file, one line for each problem; RecordAbsent if nothing is,
    and a record that is optional is not here.
    """
    document = source if isinstance(source, Document) else read_leniently(source)
    path, document = Path(document.name), override(document, assignments)
    for key, value in options.items():
        if value is not None:
            document = document.patched(key, value, Place(0, f"--{_OPTIONS.get(key, key)} {value}"))
    if (version := document.data.get("version", FORMAT)) != FORMAT:
        # The rest may mean something else there.
        raise document.error(
            [Problem(("version",), f"this hident reads version {FORMAT} of the format", version)]
        )
    complaints: list[Complaint] = []
    _load_plugins(document, path)
    document = repeated(document, Experiment, complaints, untouched=("cases", "skip", "alternatives"))
    if complaints:
        raise error_of([*complaints, *document.complaints])
    axes = sound_axes(document, complaints)
    all_axes_sound = not complaints
    at_first = dict.fromkeys(range(len(axes)), 0)
    document = with_every_value(document, Expansion(document, axes).document(at_first), complaints)
    complaints += [*document.complaints, *idle_assignments(document, axes, assignments)]
    left_out = skips(document, axes, complaints)
    expansion = Expansion(document, axes, left_out)
    # The first label of every axis completes the file: what a case sets need not stand twice.
    first = expansion.document(at_first)
    try:
        experiment = Experiment.model_validate(first.data)
    except ValidationError as error:
        complaints += first.complaints_of(
            problem
            for problem in problems_of(error)
            # A case that cannot be applied may have set what is missing.
            if all_axes_sound
            or not problem.message.startswith("is required")
            or problem.location[0] not in CHANGEABLE
        )
        raise error_of([*complaints, *expansion.complaints()]) from None
    complaints += first.complaints_of(_unknown_names(experiment, axes, written_axes(document)))
    complaints += first.complaints_of(
        Problem((section, name), message)
        for section, name, message in misnamed(experiment.tables, experiment.figures)
    )
    units = expansion.units(experiment.estimators, experiment.metrics, complaints)
    plan = Plan(path, document, experiment, axes, tuple(units), left_out)
    complaints += document.complaints_of([*_missing_paper(plan), *_unrepeatable(plan)])
    if complaints:
        raise error_of(complaints)
    if expansion.absent:
        raise RecordAbsent(f"{path}: {expansion.absent}")
    return plan


def _beside(path: Path, names: Iterable[str]) -> tuple[Path, ...]:
    return tuple(path.parent / name for name in names)


def _load_plugins(document: Document, path: Path) -> None:
    """Load the files under ``plugins``; ConfigError with one line for each that cannot be loaded."""
    written = document.data.get("plugins")
    names = [name for name in written if isinstance(name, str)] if isinstance(written, list) else []
    problems = []
    for i, (name, file) in enumerate(zip(names, _beside(path, names), strict=True)):
        if not file.is_file():
            near = did_you_mean(name, [other.name for other in sorted(path.parent.glob("*.py"))])
            problems.append(Problem(("plugins", i), f"there is no file {file}{near}"))
            continue
        try:
            plugins.load([file])
        except ConfigError as error:
            problems.append(Problem(("plugins", i), str(error)))
    if problems:
        raise document.error(problems)


def _unrepeatable(plan: Plan) -> Iterator[Problem]:
    """Why there cannot be as many trials as the plan wants: once, or once for each estimator."""
    if plan.trials == 1:
        return
    found: dict[Location, str] = {}
    for unit in plan.units:
        if message := unit.data.unrepeatable(unit.estimator):
            found.setdefault(("estimators", unit.name) if unit.data.resampled else ("trials",), message)
    for place, message in found.items():
        yield Problem(place, f"{counted(plan.trials, 'trial', 'are')} wanted, and {message}")


def _missing_paper(plan: Plan) -> Iterator[Problem]:
    if plan.paper is None:
        if plan.experiment.published is not None:
            yield Problem(("published",), "needs 'paper', the folder under experiments/ with the numbers")
    elif not plan.paper.is_dir():
        papers = sorted(folder.name for folder in plan.paper.parent.glob("*/"))
        near = did_you_mean(plan.paper.name, papers)
        yield Problem(("paper",), f"there is no folder {plan.paper}{near}")


def _unknown_names(experiment: Experiment, axes: Sequence[Axis], written: Sequence[str]) -> Iterator[Problem]:
    """Names that refer to nothing in the file; axes are all that are written, sound or not."""
    known: dict[str, list[str]] = {
        "estimator": list(experiment.estimators),
        "metric": [label for name, spec in experiment.metrics.items() for label in spec.labels(name)],
        "axis": list(written),
        "table": list(experiment.tables),
        **{f"label of {axis.name}": list(map(str, axis.labels)) for axis in axes},
    }
    for place, what, name in (one for value in referring(experiment) for one in value.names()):
        # Of an axis that there is not, or that cannot be applied, no label is missing.
        there = known.get(what, [name])
        if name not in there:
            yield Problem(place, there_is_no(what, name, there))
