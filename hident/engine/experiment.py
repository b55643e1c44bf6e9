"""An experiment as the user wrote it, and the units of work that it expands to.

A unit is one estimator with one setting on one case, scored by its metrics. The axes under ``cases`` expand
to their product; an axis that touches neither the data of a case nor a given estimator nor its metrics does
not multiply that estimator, so that no unit stands twice.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self

from pydantic import (
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_core import CoreSchema

from hident.config.load import Document, Problem, override, problems_of, read_leniently
from hident.config.spec import Component, Count, Of, Spec
from hident.config.suggest import did_you_mean, one_of
from hident.config.yaml12 import Complaint, Location, Place, error_of
from hident.engine.cases import CHANGEABLE, DATA, Axis, Cases, Label, idle_assignments, sound_axes
from hident.engine.expansion import Expansion, Unit
from hident.engine.run_files import misnamed
from hident.engine.trial import Data
from hident.estimators.base import EstimatorSpec
from hident.metrics.base import MetricSpec

__all__ = ["Experiment", "Label", "Plan", "Published", "PublishedCells", "Statistic", "Unit", "load"]

FORMAT = 1
Statistic = Literal["mean", "median", "std"]


class PublishedCells(Spec):
    """Which of our cells stand beside which printed numbers."""

    table: str
    """The ``table`` column of published.csv."""
    row: str
    """The ``row`` column; {axis} stands for a case's label, e.g. 'N={samples}'."""
    quantity: str | None = None
    """The ``quantity`` column; {axis} likewise."""
    estimator: str
    """Name of the estimator in this file."""
    metric: str | None = None
    """Label of the metric."""
    quantities: dict[str, str] = {}
    """Several quantities of the row at once, each with its metric: {a1: theta a_1, b0: theta b_0}."""
    statistic: Statistic = "mean"
    """The statistic over trials that stands beside the printed number."""
    at: dict[str, Any] = {}
    """Labels of axes that limit the correspondence; all by default."""

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


class Published(Spec):
    """The printed numbers that a run is held against."""

    paper_trials: Annotated[
        Annotated[int, Field(ge=1)] | Literal["unknown", "exact"], BeforeValidator(_as_runs)
    ]
    """Runs that the paper averages; 'unknown' if it does not say, 'exact' for a formula's value."""
    cells: tuple[PublishedCells, ...]
    """The correspondence of cells."""


class Experiment(Data, Cases):
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
    estimators: dict[str, Annotated[EstimatorSpec, Of("estimator"), BeforeValidator(_given)]]
    """The estimators by the name that tables show."""
    metrics: dict[str, Annotated[MetricSpec, Of("metric")]]
    """The metrics by the name that tables show."""
    tables: dict[str, Annotated[Component, Of("table")]] = {}
    """Tables of table.md."""
    figures: dict[str, Annotated[Component, Of("figure")]] = {}
    """Figures, each written as NAME.png."""
    published: Published | None = None
    """The printed numbers that the results stand beside."""

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

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        found = super().__get_pydantic_json_schema__(schema, handler)
        # The cases may set what the file leaves out, and a single noise needs no list.
        found["required"] = [name for name in found["required"] if name not in DATA]
        noise = found["properties"]["noise"]
        noise["anyOf"] = [{"type": noise.pop("type"), "items": noise["items"]}, noise.pop("items")]
        return found


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
    source: Path | Document,
    assignments: Sequence[str] = (),
    options: Mapping[str, int | None] = MappingProxyType({}),
) -> Plan:
    """Read a configuration, apply ``--set`` assignments and options such as trials, expand its cases.

    Raises
    ------
    ConfigError
        With all that is wrong with the file, one line for each problem.
    """
    document = override(source if isinstance(source, Document) else read_leniently(source), assignments)
    for key, value in options.items():
        if value is not None:
            document = document.patched(key, value, Place(0, f"--{key} {value}"))
    if (version := document.data.get("version", FORMAT)) != FORMAT:
        # The rest may mean something else there.
        raise document.error(
            [Problem(("version",), f"this hident reads version {FORMAT} of the format", version)]
        )
    complaints: list[Complaint] = []
    axes = sound_axes(document, complaints)
    all_axes_sound = not complaints
    complaints += [*document.complaints, *idle_assignments(document, axes, assignments)]
    expansion = Expansion(document, axes)
    # The first label of every axis completes the file: what a case sets need not stand twice.
    first = expansion.document(dict.fromkeys(range(len(axes)), 0))
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
    complaints += first.complaints_of(_unknown_names(experiment, axes))
    complaints += first.complaints_of(
        Problem((section, name), message)
        for section, name, message in misnamed(experiment.tables, experiment.figures)
    )
    units = expansion.units(experiment.estimators, experiment.metrics, complaints)
    plan = Plan(Path(document.name), document, experiment, axes, tuple(units))
    complaints += document.complaints_of(_missing_paper(plan))
    if complaints:
        raise error_of(complaints)
    return plan


def _missing_paper(plan: Plan) -> Iterator[Problem]:
    if plan.paper is None:
        if plan.experiment.published is not None:
            yield Problem(("published",), "needs 'paper', the folder under experiments/ with the numbers")
    elif not plan.paper.is_dir():
        papers = sorted(folder.name for folder in plan.paper.parent.glob("*/"))
        near = did_you_mean(plan.paper.name, papers)
        yield Problem(("paper",), f"there is no folder {plan.paper}{near}")


def _unknown_names(experiment: Experiment, axes: Sequence[Axis]) -> Iterator[Problem]:
    """Names that refer to nothing in the file."""

    def unknown(location: Location, what: str, name: str, known: Iterable[str]) -> Iterator[Problem]:
        known = list(known)
        if name not in known:
            yield Problem(
                location,
                f"there is no {what} '{name}'{did_you_mean(name, known)} "
                f"({f'there are: {one_of(known)}' if known else 'there is none'})",
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
        "table": list(experiment.tables),
        **{f"label of {axis.name}": list(map(str, axis.labels)) for axis in axes},
    }
    for family in ("tables", "figures"):
        for name, spec in getattr(experiment, family).items():
            for field, what, referred in spec.references():
                # A field is named, or is the path of a key inside it, such as ("columns", 0, "estimator").
                at = field if isinstance(field, tuple) else (field,)
                yield from unknown((family, name, *at), what, referred, known.get(what, [referred]))
    for i, cell in enumerate(experiment.published.cells if experiment.published else ()):
        at = ("published", "cells", i)
        yield from unknown((*at, "estimator"), "estimator", cell.estimator, known["estimator"])
        for quantity, label in cell.pairs():
            where = ("quantities", quantity) if cell.quantities else ("metric",)
            yield from unknown((*at, *where), "metric", label, known["metric"])
        for axis, chosen in cell.at.items():
            yield from unknown((*at, "at"), "axis", axis, known["axis"])
            yield from unknown(
                (*at, "at", axis), "label", str(chosen), known.get(f"label of {axis}", [str(chosen)])
            )
        quantity_field = "quantities" if cell.quantities else "quantity"
        texts = [("row", cell.row), *((quantity_field, quantity) for quantity, _ in cell.pairs())]
        for field, text in texts:
            for axis in re.findall(r"{([^{}]*)}", text):
                yield from unknown((*at, field), "axis", axis, known["axis"])
