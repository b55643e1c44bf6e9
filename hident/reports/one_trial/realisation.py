"""The figure of the data and the estimated characteristics of one trial."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hident.config.references import CaseLabels, EstimatorName
from hident.config.spec import Interval, NonEmpty, component
from hident.engine.experiment import Plan
from hident.engine.replay import OneTrial, Realised
from hident.engine.results import Results
from hident.ledger.verdicts import Verdict
from hident.records import needed
from hident.reports.base import Misfit
from hident.reports.one_trial.base import OneTrialFigure, say_failed, true_curve
from hident.reports.style import DATA, ESTIMATE, TRUTH, Look, label_edges, legend_above, subplots

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Dashes with a light rim on a wide truth: both are seen where they agree, and over the data, in grey too.
_TRUTH: Look = {**TRUTH, "linewidth": 3.2}
_ESTIMATE: Look = {**ESTIMATE, "linestyle": (0, (3, 2)), "linewidth": 1.2}
_RIM = 2.2


@component("figure", "realisation")
class Realisation(OneTrialFigure):
    """The estimates of one trial against the true characteristic, with the data."""

    at_is_own = True

    at: NonEmpty[CaseLabels] = ({},)  # type: ignore[assignment]
    """Labels of the cases, one panel for each, e.g. [{samples: 50}, {samples: 500}]."""
    estimators: NonEmpty[EstimatorName]
    """Names of the estimators."""
    names: dict[str, str] = {}
    """Symbols of axes for the titles, e.g. {samples: N}."""
    interval: Interval
    """Range of the abscissa."""
    y_limits: Interval | None = None
    """Range of the ordinate; by the truth and the estimates by default."""
    x_label: str = "u"
    """Label of the abscissa."""
    y_label: str = "y, μ(u)"
    """Label of the ordinate."""

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        for i, estimator in enumerate(self.estimators):
            unit = next(unit for unit in plan.units if unit.name == estimator)
            if "nonlinearity" not in unit.estimator.provides():
                yield ("estimators", i), f"the estimator '{estimator}' does not give a nonlinearity"
        systems = [unit.data.system for unit in plan.units if unit.name in self.estimators]
        if any("nonlinearity" not in system.provides() for system in systems):
            yield ("kind",), "the system has no true nonlinearity to show"

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        rows, columns = len(self.at), len(self.estimators)
        figure, grid = subplots(
            rows,
            columns,
            squeeze=False,
            sharex=True,
            sharey=True,
            figsize=(min(2.5 * columns + 0.4, 10.5), 2.2 * rows + 0.5),
        )
        trial = OneTrial(results.plan, self.trial)
        for labels, row in zip(self.at, grid, strict=True):
            for name, axes in zip(self.estimators, row, strict=True):
                self._panel(axes, trial.of(name, labels))
                case = ", ".join(f"{self.names.get(axis, axis)} = {label}" for axis, label in labels.items())
                axes.set_title(f"{name}{', ' if case else ''}{case}")
        label_edges(grid, self.x_label, self.y_label)
        legend_above(figure)
        return figure

    def _panel(self, axes: Axes, realised: Realised) -> None:
        from matplotlib.patheffects import withStroke

        u = np.linspace(*self.interval, 2001)
        if realised.record is not None:
            axes.plot(realised.record.u, realised.record.y, label="data", **DATA)
        axes.plot(u, true_curve(realised.truth, u), label="true μ", **_TRUTH)
        if realised.found is None:
            say_failed(axes, f"failed: {realised.failure}")
        else:
            with np.errstate(all="ignore"):
                estimate = needed(realised.found.nonlinearity)(u)
                rim = [withStroke(linewidth=_RIM, foreground="white")]
                axes.plot(u, estimate, label="estimate", path_effects=rim, **_ESTIMATE)
        if self.y_limits is not None:
            axes.set_ylim(*self.y_limits)
