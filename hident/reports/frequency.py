"""Estimates beside truth and print, the signals of an experiment, and Bode diagrams of two linear blocks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.spec import Count, component
from hident.engine.experiment import Plan
from hident.engine.replay import OneTrial
from hident.engine.results import Results, Series
from hident.estimators.frequency.nonlinearity_identification import NonlinearityIdentification
from hident.ledger.verdicts import Verdict, beside_trials
from hident.linear_blocks import ContinuousTransferFunction
from hident.metrics import frequency
from hident.records import Record
from hident.reports.base import FigureSpec, Misfit, Reference, Table, TableSpec, label_references, unscored
from hident.reports.one_trial import OneTrialFigure, Shown, list_failures, say_failed
from hident.reports.style import DATA, LINES, TRUTH, legend_above, panel_grid, subplots
from hident.reports.tables import LEGEND, SIGNS, intervals
from hident.systems.continuous_wiener_hammerstein import respond

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_POINTS = 400


@component("table", "against_truth", source="Brouri, eq. (46)")
class AgainstTruth(TableSpec):
    """One row for each quantity: the truth, the printed number, and mean ± std of each estimator."""

    row_header: str = "quantity"
    """Heading of the first column."""
    rows: Annotated[dict[str, str], Field(min_length=1)]
    """Name of the value in each row by its heading, e.g. {"|Gi(jw)|": gain_i_1}."""
    metric: str
    """Name of the metric with the estimates; with a row's value it makes the label, e.g. 'found gain_i_1'."""
    truth: str
    """Name of the metric with the true values, such as one of kind true_response."""
    estimators: Annotated[dict[str, str], Field(min_length=1)]
    """Name of the estimator in each column by its heading."""
    at: dict[str, Any] = {}
    """Labels of axes that choose the case; the first case by default."""
    digits: Annotated[Count, Field(ge=1, le=15)] = 3
    """Significant digits of the truth, and decimals of the estimates."""

    def references(self) -> Iterator[Reference]:
        yield from label_references(("at",), self.at)
        for heading, estimator in self.estimators.items():
            yield ("estimators", heading), "estimator", estimator
        for heading, name in self.rows.items():
            yield ("rows", heading), "metric", f"{self.metric} {name}"
            yield ("rows", heading), "metric", f"{self.truth} {name}"

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        first = next(iter(self.estimators.values()))
        for name in self.rows.values():
            yield from unscored(plan, "truth", first, f"{self.truth} {name}")
            for estimator in self.estimators.values():
                yield from unscored(plan, "metric", estimator, f"{self.metric} {name}")

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        first = next(iter(self.estimators.values()))
        shown = {
            (heading, name): next(results.select(estimator, f"{self.metric} {name}", self.at))
            for heading, estimator in self.estimators.items()
            for name in self.rows.values()
        }
        trials = beside_trials(verdicts)
        # One column holds the printed numbers: the first estimator's that has one.
        printed = {
            name: verdict
            for (_, name), series in reversed(shown.items())
            if (verdict := trials.get(id(series))) is not None
        }
        rows = []
        for heading, name in self.rows.items():
            truth = next(results.select(first, f"{self.truth} {name}", self.at)).value("mean")
            row = [heading, f"{truth:.{self.digits + 1}f}"]
            if printed:
                verdict = printed.get(name)
                row.append(f"{verdict.printed.printed} {SIGNS[verdict.word]}" if verdict else "")
            rows.append((*row, *(self._ours(shown[column, name]) for column in self.estimators)))
        header = (self.row_header, "truth", *(["printed"] if printed else []), *self.estimators)
        notes = ("Ours: mean ± standard deviation over the trials.", *_missing(shown, results.plan.trials))
        legend = (LEGEND, *intervals([*printed.values()])) if printed else ()
        return Table(self.title, header, tuple(rows), (*notes, *legend))

    def _ours(self, series: Series) -> str:
        mean, std = series.value("mean"), series.value("std")
        if not np.isfinite(mean):
            return "-"
        decimals = self.digits + 1
        return f"{mean:.{decimals}f}" + (f" ± {std:.{decimals}f}" if np.isfinite(std) else "")


def _missing(shown: dict[tuple[str, str], Series], trials: int) -> Iterator[str]:
    """In how many trials an estimator did not determine a value, where it is any."""
    for (heading, name), series in shown.items():
        if failed := int(series.statistics["failed"]):
            yield f"{heading}: {name} is not determined in {failed} of {trials} trials."


@component("figure", "signals", source="Brouri, Fig. 2")
class Signals(OneTrialFigure):
    """The input of one experiment, and below it the measured and the noise-free output."""

    curve: Shown
    """The estimator and the case whose record is shown."""
    experiment: str
    """Name of the experiment."""
    t_label: str = "time t"
    """Label of the abscissa, with its unit."""
    u_label: str = "input v"
    """Label of the input, with its unit."""
    y_label: str = "output y"
    """Label of the output, with its unit."""

    def references(self) -> Iterator[Reference]:
        yield from self.curve.references(("curve",))

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        yield from self.curve.misfits(plan, ("curve",), of_truth="blocks")
        data = self.curve.unit(plan).data
        names = [stretch.name for stretch in data.excitation.stretches(data.samples, data.dt or 1.0)]
        if self.experiment not in names:
            known = ", ".join(names)
            yield "experiment", f"there is no experiment '{self.experiment}' (there are: {known})"

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        figure, (above, below) = subplots(2, 1, sharex=True, figsize=(5.2, 3.6), height_ratios=(1, 2))
        data = self.curve.unit(results.plan).data
        record, failure = OneTrial(results.plan, self.trial).record(data)
        if record is None:
            say_failed(above, "no record")
            say_failed(below, f"failed: {failure}")
            return figure
        part = record.parts[self.experiment]
        t = np.arange(len(part)) * part.dt
        above.plot(t, record.u[part.samples], **{**LINES[0], "marker": ""})
        above.set_ylabel(self.u_label)
        below.plot(t, record.y[part.samples], label="measured", rasterized=True, **{**DATA, "markersize": 1})
        below.plot(t, _noise_free(record, self.experiment), label="noise-free", **TRUTH)
        below.set_ylabel(self.y_label)
        below.set_xlabel(self.t_label)
        below.legend(loc="upper left", markerscale=6)
        return figure


def _noise_free(record: Record, experiment: str) -> Array:
    truth, part = record.truth, record.parts[experiment]
    assert truth is not None
    assert truth.nonlinearity is not None
    blocks = truth.blocks["input"], truth.nonlinearity, truth.blocks["output"]
    return respond(*blocks, part.waveform, len(part), part.dt)


@component("figure", "level_means", source="Brouri, Fig. 3")
class LevelMeans(OneTrialFigure):
    """The true nonlinearity with the mean outputs at the levels of a staircase, and below their errors."""

    curves: Annotated[tuple[Shown, ...], Field(min_length=1)]
    """The estimators, of kind nonlinearity_identification; the first one's system gives the truth."""
    x_label: str
    """Label of the abscissa, with its unit."""
    y_label: str
    """Label of the output, with its unit."""

    def references(self) -> Iterator[Reference]:
        for i, curve in enumerate(self.curves):
            yield from curve.references(("curves", i))

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        for i, curve in enumerate(self.curves):
            yield from curve.misfits(plan, ("curves", i), of_truth="nonlinearity")
            if not isinstance(curve.unit(plan).estimator, NonlinearityIdentification):
                said = f"the estimator '{curve.estimator}' is not of kind nonlinearity_identification"
                yield ("curves", i, "estimator"), said

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        trial = OneTrial(results.plan, self.trial)
        figure, (above, below) = subplots(2, 1, sharex=True, figsize=(4.8, 4.4), height_ratios=(2, 1))
        failures = []
        for curve, line in zip(self.curves, LINES, strict=False):
            realised = trial.of(curve.estimator, curve.at)
            if realised.found is None:
                failures.append(f"{curve.text} failed: {realised.failure}")
                continue
            assert realised.truth.nonlinearity is not None
            staircase = realised.found.details["staircase"]
            x, found = staircase.x, staircase.levels
            look = {**line, "linestyle": "none", "markerfacecolor": "none"}
            above.plot(x, found.values, label=curve.text, zorder=5, **look)
            error = found.values - realised.truth.nonlinearity(x)
            below.errorbar(x, error, 2.0 * found.errors, capsize=3, **look)
            if curve is self.curves[0]:
                dense = np.linspace(np.min(x), np.max(x), _POINTS)
                above.plot(dense, realised.truth.nonlinearity(dense), label="true", **TRUTH)
        list_failures(above, failures)
        below.axhline(0.0, **{**TRUTH, "zorder": 0})
        above.set_ylabel(self.y_label)
        below.set_ylabel("estimate - truth\n(bars: ± 2 std. errors)")
        below.set_xlabel(self.x_label)
        if above.get_legend_handles_labels()[1]:
            above.legend()
        return figure


@component("figure", "bode")
class Bode(FigureSpec):
    """Gains and phases of both linear blocks at the frequencies of the sines, and below their errors.

    Marks are medians over the trials and bands, which the errors need to be seen, their central 90 %. What
    fewer than half of the trials determine is left out.
    """

    metric: str
    """Name of the metric of kind response that holds gain_i_M, gain_o_M_1, phase_i_M and phase_o_M_1."""
    frequencies: Annotated[Count, Field(ge=2)]
    """Number of frequencies M."""
    estimators: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names of the estimators."""
    x_label: str
    """Label of the abscissa, with its unit."""

    def references(self) -> Iterator[Reference]:
        for i, estimator in enumerate(self.estimators):
            yield ("estimators", i), "estimator", estimator
        for quantity in ("gain", "phase"):
            for side in ("i", "o"):
                for name in self._names(quantity, side):
                    yield "metric", "metric", f"{self.metric} {name}"

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        for i, estimator in enumerate(self.estimators):
            yield from unscored(plan, ("estimators", i), estimator, f"{self.metric} phase_o_1_1")
        if "blocks" not in plan.units[0].data.system.provides():
            yield "kind", "the system has no true linear blocks in continuous time"

    def _names(self, quantity: str, side: str) -> list[str]:
        harmonic = "_1" if side == "o" else ""
        return [f"{quantity}_{side}_{m}{harmonic}" for m in range(1, self.frequencies + 1)]

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        figure, grid = panel_grid(8, 2, 3.4, 1.9)
        data = next(results.select(self.estimators[0])).unit.data
        blocks = data.system.truth().blocks
        stretches = data.excitation.stretches(data.samples, data.dt or 1.0)
        omega = frequency.frequencies_of(stretches)[: self.frequencies]
        for column, side in enumerate(("i", "o")):
            block = blocks["input" if side == "i" else "output"]
            gains, gain_errors, phases, phase_errors = grid[column::2]
            self._draw_pair(results, (gains, gain_errors), self._names("gain", side), block, omega)
            self._draw_pair(results, (phases, phase_errors), self._names("phase", side), block, omega)
            gains.set_yscale("log")
            gains.set_title("input block $G_i$" if side == "i" else "output block $G_o$")
            phase_errors.set_xlabel(self.x_label)
        for axes in grid:
            axes.set_xscale("log")
            axes.set_xlim(0.9 * omega[0], 1.1 * omega[-1])
        for axes, text in zip(
            grid[::2], ("gain", "error of gain (%)", "phase (rad)", "error of phase (rad)"), strict=True
        ):
            axes.set_ylabel(text)
        legend_above(figure)
        return figure

    def _draw_pair(
        self,
        results: Results,
        panels: tuple[Axes, Axes],
        names: Sequence[str],
        block: ContinuousTransferFunction,
        omega: Array,
    ) -> None:
        """Gains or phases of a block in one panel, their errors in the other; of gains in percent."""
        above, below = panels
        of_gains = names[0].startswith("gain")
        function = frequency.gain if of_gains else frequency.phase
        true = function(block, omega)
        dense = np.geomspace(omega[0], omega[-1], _POINTS)
        above.plot(dense, function(block, dense), label="true", **TRUTH)
        below.axhline(0.0, **TRUTH)
        for estimator, line in zip(self.estimators, LINES, strict=False):
            series = [next(results.select(estimator, f"{self.metric} {name}")) for name in names]
            seen = np.array([2 * one.statistics["failed"] <= one.statistics["trials"] for one in series])
            low, middle, high = (
                np.array([one.statistics[name] for one in series]) for name in ("q05", "median", "q95")
            )
            mark = {**line, "linestyle": "none", "markersize": 3, "zorder": 5}
            above.plot(omega[seen], middle[seen], label=estimator, **mark)
            scale = 100.0 / true if of_gains else np.ones_like(true)
            low, middle, high = (((one - true) * scale)[seen] for one in (low, middle, high))
            below.fill_between(omega[seen], low, high, color=line["color"], alpha=0.25, linewidth=0)
            below.plot(omega[seen], middle, **mark)
