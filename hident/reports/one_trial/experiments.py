"""Figures of the experiments of one record: the signals, and the means at the levels of a staircase."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hident.arrays import Array
from hident.config.spec import NonEmpty, component
from hident.engine.experiment import Plan
from hident.engine.replay import OneTrial
from hident.engine.results import Results
from hident.engine.trial import generate
from hident.errors import SimulationError
from hident.estimators.frequency.nonlinearity_identification import NonlinearityIdentification
from hident.ledger.verdicts import Verdict
from hident.records import Record, needed
from hident.reports.base import Misfit
from hident.reports.one_trial.base import OneTrialFigure, Shown, list_failures, say_failed
from hident.reports.style import DATA, LINES, TRUE_LEVEL, TRUTH, subplots
from hident.systems.continuous_wiener_hammerstein import respond

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DENSE = 400


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

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        yield from self.curve.misfits(plan, ("curve",), of_truth="blocks")
        data = self.curve.unit(plan).data
        names = [stretch.name for stretch in data.excitation.stretches(data.samples, data.dt or 1.0)]
        if self.experiment not in names:
            known = ", ".join(names)
            yield ("experiment",), f"there is no experiment '{self.experiment}' (there are: {known})"

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        figure, (above, below) = subplots(2, 1, sharex=True, figsize=(5.2, 3.6), height_ratios=(1, 2))
        data = self.curve.unit(results.plan).data
        try:
            with np.errstate(all="ignore"):
                record = generate(data, results.plan.seed, self.trial)
        except SimulationError as error:
            say_failed(above, "no record")
            say_failed(below, f"failed: {error}")
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
    truth, part = needed(record.truth), record.parts[experiment]
    blocks = truth.blocks["input"], needed(truth.nonlinearity), truth.blocks["output"]
    return respond(*blocks, part.waveform, len(part), part.dt)


@component("figure", "level_means", source="Brouri, Fig. 3")
class LevelMeans(OneTrialFigure):
    """The true nonlinearity with the mean outputs at the levels of a staircase, and below their errors."""

    curves: NonEmpty[Shown]
    """The estimators, of kind nonlinearity_identification; the first one's system gives the truth."""
    x_label: str
    """Label of the abscissa, with its unit."""
    y_label: str
    """Label of the output, with its unit."""

    def looks_needed(self, plan: Plan) -> int:
        return len(self.curves)

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
            true = needed(realised.truth.nonlinearity)
            staircase = realised.found.details["staircase"]
            x, found = staircase.x, staircase.levels
            look = {**line, "linestyle": "none", "markerfacecolor": "none"}
            above.plot(x, found.values, label=curve.text, zorder=5, **look)
            error = found.values - true(x)
            below.errorbar(x, error, 2.0 * found.errors, capsize=3, **look)
            if curve is self.curves[0]:
                dense = np.linspace(np.min(x), np.max(x), _DENSE)
                above.plot(dense, true(dense), label="true", **TRUTH)
        list_failures(above, failures)
        below.axhline(0.0, **TRUE_LEVEL)
        above.set_ylabel(self.y_label)
        below.set_ylabel("estimate - truth\n(bars: ± 2 std. errors)")
        below.set_xlabel(self.x_label)
        if above.get_legend_handles_labels()[1]:
            above.legend()
        return figure
