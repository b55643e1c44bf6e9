"""What every table and figure spec answers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from hident.config.references import CaseLabels, Labels, Metric, NumericAxis, Referring, referring
from hident.config.spec import Component
from hident.config.yaml12 import Location
from hident.engine.measurement import Measurement
from hident.engine.results import Results
from hident.ledger.verdicts import Verdict
from hident.reports.canvas import Canvas, Size, drawn_on
from hident.reports.facets import Facets, Grid, joined
from hident.reports.style import LINES, draw_legend, write_below
from hident.reports.table import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hident.engine.experiment import Plan

__all__ = [
    "FigureSpec",
    "Misfit",
    "ReportSpec",
    "Table",
    "TableSpec",
    "first_case",
    "misfits",
    "not_numeric",
    "said_of_trial",
    "unscored",
]

Misfit = tuple[Location, str]
"""The path to an entry of a spec, such as ("columns", 0, "estimator"), and why it does not do."""


def misfits(plan: Plan, spec: ReportSpec) -> list[Misfit]:
    """What a report cannot show of this plan, though it knows every name."""
    values = list(referring(spec))
    if found := list(_held_twice(values, spec)):
        return found
    held = plan.at(spec.held())
    there = [(facet, held.at(facet.labels)) for facet in Grid(spec.facets, held)]
    if not any(part.units for _, part in there):
        return [(("at" if spec.held() else "facets",), "no case stands at these labels")]
    for facet, part in there:
        found = list(_misfits(part, spec, values)) if part.units else []
        if found:
            at = ", ".join(f"{axis} {label}" for axis, label in facet.labels.items())
            return [(place, f"{message} (at {at})" if at else message) for place, message in found]
    return []


def _misfits(plan: Plan, spec: ReportSpec, values: Sequence[Referring]) -> Iterator[Misfit]:
    if left_out := list(_left_out(plan, values)):
        yield from left_out
        return
    yield from _mismatched(plan, values)
    yield from _not_numeric(plan, values)
    yield from spec.misfits(plan)
    if isinstance(spec, FigureSpec) and (count := spec.looks_needed(plan)) > len(LINES):
        yield (
            (),
            f"{count} curves are to share {len(LINES)} line styles: repeat the figure over an axis with "
            "'facets', hold labels with 'at', or name fewer estimators",
        )


def _held_twice(values: Sequence[Referring], spec: ReportSpec) -> Iterator[Misfit]:
    """The axes that are held, or repeated over, and shown as well."""
    facets = {axis for axis in (spec.facets.rows, spec.facets.columns) if axis} if spec.facets else set()
    for axis in facets & ({*spec.at} if isinstance(spec.at, Mapping) else set()):
        yield ("facets",), f"the label of the axis '{axis}' is held by 'at'"
    for value in values:
        own = value.place[:1] == ("facets",) or not isinstance(value.value, str)
        if not own and value.reference.what == "axis" and value.value in facets | {*spec.held()}:
            how = "repeated over" if value.value in facets else "held at one label"
            yield value.place, f"the axis '{value.value}' is {how}, and cannot be shown as well"


def _left_out(plan: Plan, values: Sequence[Referring]) -> Iterator[Misfit]:
    """The estimators that no case holds at labels that stand beside them."""
    for labels in (value for value in values if isinstance(value.reference, Labels)):
        for estimator in _estimators(values):
            beside = estimator.spec is labels.spec
            if beside and not any(u.name == estimator.value and u.is_at(labels.value) for u in plan.units):
                at = ", ".join(f"{axis} {label}" for axis, label in labels.value.items())
                yield estimator.place, f"the estimator '{estimator.value}' is left out at {at}"


def _mismatched(plan: Plan, values: Sequence[Referring]) -> Iterator[Misfit]:
    """The metrics that are to be shown of an estimator that they do not score."""
    for metric in values:
        if not isinstance(metric.reference, Metric):
            continue
        depth = len(metric.within)
        for estimator in _estimators(values):
            field = estimator.place[depth] if estimator.place[:depth] == metric.within else None
            # Of one metric for several estimators, it is one of these that is wrong.
            several = len(metric.place) == depth + 1 < len(estimator.place)
            for _, _, label in metric.names() if field in metric.reference.scores else ():
                place = (estimator if several else metric).place
                yield from unscored(plan, place, estimator.value, label)


def _estimators(values: Sequence[Referring]) -> list[Referring]:
    return [value for value in values if value.reference.what == "estimator"]


def _not_numeric(plan: Plan, values: Sequence[Referring]) -> Iterator[Misfit]:
    for value in values:
        if isinstance(axis := value.reference, NumericAxis):
            positive = axis.positive
            positive = getattr(value.spec, positive) if isinstance(positive, str) else positive
            for message in not_numeric(plan, value.value, positive=positive, least=axis.least):
                yield value.place, message


def first_case(plan: Plan, estimators: Sequence[str]) -> str:
    """Which case is shown of those estimators that stand in several; empty if none does."""
    units = [unit for unit in plan.units if unit.name in estimators]
    several = [a.name for a in plan.axes if len({unit.labels.get(a.name) for unit in units} - {None}) > 1]
    shown = next((unit.labels for unit in units if not {*several} - unit.labels.keys()), {})
    at = ", ".join(f"{axis} {shown[axis]}" for axis in several if axis in shown)
    return f"of several cases the first: {at}" if at else ""


def said_of_trial(plan: Plan, spec: ReportSpec, trial: int) -> Iterator[str]:
    """Which trial of which cases a report shows, as far as that stands nowhere else.

    A measured record is no trial.
    """
    if trial != 0 or not all(isinstance(unit.data, Measurement) for unit in plan.units):
        yield f"trial {trial}"
    shown: dict[str, None] = {}
    for one in referring(spec):
        if one.reference.what == "estimator":
            at = getattr(one.spec, "at", {})
            for labels in [at] if isinstance(at, Mapping) else at:
                shown[first_case(plan.at(labels), (one.value,))] = None
    yield from filter(None, shown)


def unscored(plan: Plan, place: Location, estimator: str, metric: str) -> Iterator[Misfit]:
    """A misfit if no unit of the estimator is scored by the metric."""
    units = [unit for unit in plan.units if unit.name == estimator]
    if not units:
        yield place, f"the estimator '{estimator}' is left out"
    elif not any(metric in unit.metric_labels for unit in units):
        yield place, f"the metric '{metric}' does not score the estimator '{estimator}'"


def not_numeric(plan: Plan, axis: str, *, positive: bool, least: int = 1) -> Iterator[str]:
    """Why the labels of an axis do not do, if they are not numbers, or not positive, or too few."""
    labels = next((a.labels for a in plan.axes if a.name == axis), None)
    if labels is None:
        yield f"the axis '{axis}' is held at one label, and cannot be shown as well"
        return
    try:
        numbers = [float(label) for label in labels]
    except ValueError:
        yield f"the labels of the axis '{axis}' must be numbers, not {', '.join(map(str, labels))}"
        return
    if positive and min(numbers, default=1.0) <= 0.0:
        yield f"the labels of the axis '{axis}' must be positive for a logarithm"
    if len(numbers) < least:
        yield f"the axis '{axis}' needs at least {least} labels"


class ReportSpec(Component):
    """Base of all tables and figures."""

    at_is_own: ClassVar[bool] = False
    """Whether the class itself does what its field ``at`` says."""

    at: CaseLabels = {}
    """Labels of axes that are held: other cases are left out."""
    facets: Facets | None = None
    """Axes over whose labels it is repeated, in rows and columns: {rows: AXIS, columns: AXIS}."""

    def held(self) -> Mapping[str, Any]:
        """The labels at which the results are that it is made of."""
        return {} if self.at_is_own or not isinstance(self.at, Mapping) else self.at

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        """What cannot be shown of this plan beyond what the types of its fields say."""
        yield from ()


def _beside(results: Results, verdicts: Sequence[Verdict]) -> list[Verdict]:
    """The verdicts on some of all results."""
    there = {id(series) for series in results.series}
    return [verdict for verdict in verdicts if id(verdict.series) in there]


class TableSpec(ReportSpec):
    """Base of all tables."""

    title: str
    """Title of the table."""

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        """The table of the results, with the printed numbers beside them where there are any."""
        raise NotImplementedError

    def built(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        """The table at the labels that are held, and over the axes that it is repeated over."""
        results = results.at(self.held())
        if self.facets is None:
            return self.build(results, _beside(results, verdicts) if self.held() else verdicts)
        grid = Grid(self.facets, results.plan)
        parts = {(facet.row, facet.column): results.at(facet.labels) for facet in grid}
        return joined(
            grid,
            {at: self.build(part, _beside(part, verdicts)) for at, part in parts.items() if part.series},
        )


class FigureSpec(ReportSpec):
    """Base of all figures."""

    size: Size | None = None
    """Its width in print: that of a column (88 mm) or of a page (180 mm); as its panels ask by default."""

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        """The figure; :mod:`hident.reports.style` sets its look."""
        raise NotImplementedError

    def drawn(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        """The figure at the labels that are held, of its size, and over the axes that it is repeated over."""
        results = results.at(self.held())
        if self.facets is None and self.size is None:
            figure = self.draw(results, _beside(results, verdicts) if self.held() else verdicts)
        else:
            figure = self._composed(results, verdicts)
        panels = (results.at(facet.labels) for facet in Grid(self.facets, results.plan))
        if said := self.says(next(panel for panel in panels if panel.series)):
            write_below(figure, said)
        return figure

    def _composed(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        grid = Grid(self.facets, results.plan)
        with drawn_on(Canvas(self.size, len(grid.rows), len(grid.columns))) as canvas:
            for facet in grid:
                canvas.at = (facet.row, facet.column)
                part = results.at(facet.labels)
                if not part.series:
                    canvas.empty()
                    continue
                figure = self.draw(part, _beside(part, verdicts))
                if canvas.figure is None and canvas.shared:
                    raise ValueError(f"'{self.kind}' makes a figure of its own, which cannot be repeated")
            canvas.finish(grid.titles(grid.columns), grid.titles(grid.rows))
            if canvas.figure is None:
                width, height = figure.get_size_inches()
                scale = (canvas.width or width) / width
                figure.set_size_inches(scale * width, scale * height)
                return figure
            if canvas.shared:
                draw_legend(canvas.figure)
            return canvas.figure

    def says(self, results: Results) -> str:
        """What stands below the figure, of the results of a panel: what its axes do not say."""
        return ""

    def looks_needed(self, plan: Plan) -> int:
        """How many curves must be told apart by their looks."""
        return 0
