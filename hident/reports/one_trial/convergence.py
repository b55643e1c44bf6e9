"""The figure of the iterations of one trial."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from hident.arrays import Array
from hident.config.references import Metric
from hident.config.spec import Count, Flag, NonEmpty, component
from hident.engine.experiment import Plan
from hident.engine.replay import OneTrial, Realised
from hident.engine.results import Results
from hident.estimators.convergence import History
from hident.ledger.verdicts import Verdict
from hident.metrics.base import MetricSpec
from hident.records import Estimate, needed
from hident.reports.base import Misfit
from hident.reports.one_trial.base import OneTrialFigure, Shown, list_failures, offset_misfits
from hident.reports.style import TRUE_LEVEL, legend_above, looks, panel_grid, symbol

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@component("figure", "convergence", source="Chen, Hwang, Chang 2009, figures 5, 8 and 10b")
class Convergence(OneTrialFigure):
    """Parameters, or scores of the estimate, against the iteration of several estimators in one trial.

    A metric is evaluated at every iteration, with the parameters that the history holds in place of the
    final ones.
    """

    curves: NonEmpty[Shown]
    """The estimates whose iterations are shown."""
    of: tuple[str, ...] = ()
    """Names of parameters in the history, one panel each."""
    metrics: tuple[Annotated[str, Metric(scores=("curves",))], ...] = ()
    """Labels of metrics that score every iterate, one panel each."""
    y_labels: dict[str, str] = {}
    """Labels of ordinates by parameter or metric, with their units; the name by default."""
    truths: dict[str, str] = {}
    """True values of the system by parameter, where their names differ: {a_1: time_constant}."""
    log_y: Flag = False
    """Logarithmic ordinate."""
    last: Annotated[Count, Field(ge=1)] | None = None
    """The last iteration that is shown; all by default."""
    columns: Annotated[Count, Field(ge=1)] = 2
    """Panels in a row."""

    @model_validator(mode="after")
    def _shows_something(self) -> Self:
        if not self.of and not self.metrics:
            raise ValueError("give 'of', names of parameters, or 'metrics', labels of metrics")
        if strange := [name for name in self.y_labels if name not in (*self.of, *self.metrics)]:
            raise ValueError(f"y_labels names {', '.join(strange)}, which is not shown")
        if strange := [name for name in self.truths if name not in self.of]:
            raise ValueError(f"truths names {', '.join(strange)}, which is not shown")
        return self

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        yield from offset_misfits(plan, ("truths",), self.curves[:1], self.truths)

    def looks_needed(self, plan: Plan) -> int:
        return len({curve.text for curve in self.curves})

    def draw(self, results: Results, verdicts: Sequence[Verdict]) -> Figure:
        from matplotlib.ticker import MaxNLocator

        trial = OneTrial(results.plan, self.trial)
        names = (*self.of, *self.metrics)
        figure, grid = panel_grid(len(names), self.columns, 3.5 if len(names) > 1 else 4.6, 2.6)
        lines = looks(curve.text for curve in self.curves)
        failures = []
        for curve in self.curves:
            realised = trial.of(curve.estimator, curve.at)
            if realised.found is None:
                failures.append(f"{curve.text} failed: {realised.failure}")
                continue
            history: History = realised.detail("history")
            label = curve.text + ("" if history.converged else ", not converged")
            for name, axes in zip(names, grid, strict=True):
                heights = along(realised, name) if name in self.of else scores(realised, name)
                heights = heights if self.last is None else heights[: self.last + 1]
                step = max(1, len(heights) // 12)
                axes.plot(heights, label=label, markevery=step, **lines[curve.text])
        truth = trial.of(self.curves[0].estimator, self.curves[0].at).truth
        for name, axes in zip(names, grid, strict=True):
            true = truth.values.get(self.truths.get(name, name))
            if name in self.of and true is not None:
                axes.axhline(true, label="true", **TRUE_LEVEL)
            if self.log_y:
                axes.set_yscale("log")
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
            axes.set_xlabel("iteration")
            axes.set_ylabel(self.y_labels.get(name, symbol(name)))
            list_failures(axes, failures)
        legend_above(figure)
        return figure


def along(realised: Realised, name: str) -> Array:
    """A parameter at every iteration, shape (iterations + 1,).

    Raises
    ------
    ValueError
        If the history does not hold it.
    """
    values = realised.detail("history").values
    if name not in values:
        held = ", ".join(values)
        raise ValueError(f"the history of '{realised.unit.name}' holds no {name} (it holds: {held})")
    return np.asarray(values[name])


def scores(realised: Realised, label: str) -> Array:
    """A metric's number at every iteration, shape (iterations + 1,); nan where there is no estimate."""
    estimate, record = needed(realised.found), needed(realised.record)
    metric, place = _metric(realised, label)
    found = []
    with np.errstate(all="ignore"):
        for iterate in iterates(estimate, realised.detail("history")):
            scored = np.nan if iterate is None else metric.evaluate(iterate, record)[place]
            found.append(scored)
    return np.array(found, dtype=float)


def _metric(realised: Realised, label: str) -> tuple[MetricSpec, int]:
    """The metric with a label, and the label's place among its numbers."""
    return next(
        (metric, metric.labels(name).index(label))
        for name, metric in realised.unit.metrics.items()
        if label in metric.labels(name)
    )


def iterates(found: Estimate, history: History) -> Iterator[Estimate | None]:
    """The estimate with its values and its linear block as they stood at each iteration.

    None where a parameter is not finite or the block is none, as at a start from zero.
    """
    blocks: dict[str, Any] = {"linear": found.linear, "continuous": found.continuous}
    courses = history.values
    for a, b, *row in zip(history.a.tolist(), history.b.tolist(), *courses.values(), strict=True):
        values = dict(zip(courses, map(float, row), strict=True))
        try:
            # Of the history's orders: a first stage's may be lower.
            changed = {
                name: block and replace(block, a=tuple(a), b=tuple(b)) for name, block in blocks.items()
            }
        except ValueError:
            yield None
            continue
        finite = np.all(np.isfinite(list(values.values())))
        yield replace(found, values={**found.values, **values}, **changed) if finite else None
