"""What figures of one trial share; the trial itself is made by :mod:`hident.engine.replay`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.references import CaseLabels, EstimatorName
from hident.config.spec import Count, Real, Spec
from hident.config.suggest import one_of
from hident.config.yaml12 import Location
from hident.engine.experiment import Plan, Unit
from hident.records import Truth, needed
from hident.reports.base import FigureSpec, Misfit, said_of_trial

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from hident.engine.results import Results

NOTE = {"boxstyle": "square,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
"""The ground of words that stand on curves."""
Offset = Annotated[Real | str, Field(union_mode="left_to_right")]
"""A number, or the name of a true value of the system."""


class Shown(Spec):
    """The estimate of one estimator in one case."""

    estimator: EstimatorName
    """Name of the estimator."""
    at: CaseLabels = {}
    """Labels of axes that choose the case; the first case by default."""
    label: str | None = None
    """Its text in the figure; the estimator's name by default."""

    @property
    def text(self) -> str:
        """What the figure calls it."""
        return self.estimator if self.label is None else self.label

    def unit(self, plan: Plan) -> Unit:
        """The unit that is shown."""
        return next(unit for unit in plan.units if unit.name == self.estimator and unit.is_at(self.at))

    def misfits(
        self, plan: Plan, place: Location, *, of_estimate: str = "", of_truth: str = ""
    ) -> Iterator[Misfit]:
        """A misfit if the estimator does not give, or the system does not have, the named part."""
        unit = self.unit(plan)
        if of_estimate and of_estimate not in unit.estimator.provides():
            yield (
                (*place, "estimator"),
                f"the estimator '{self.estimator}' does not give a {of_estimate}",
            )
        if of_truth and of_truth not in unit.data.system.provides():
            yield (
                (*place, "estimator"),
                f"the system '{unit.data.system.kind}' has no true {of_truth} to show",
            )


def offset_misfits(
    plan: Plan, place: Location, curves: Sequence[Shown], offsets: Mapping[str, Offset]
) -> Iterator[Misfit]:
    """A misfit for each offset, by its field, that names no true value of a system that is shown."""
    systems = [curve.unit(plan).data.system.truth().values for curve in curves]
    for name, offset in offsets.items():
        known = next((values for values in systems if isinstance(offset, str) and offset not in values), None)
        if known is not None:
            yield (
                (*place, name),
                f"must be a number or a true value of the system, not '{offset}' "
                f"(it has: {one_of(sorted(known)) or 'none'})",
            )


def offset_of(truth: Truth, offset: Offset) -> float:
    """The number that an offset stands for."""
    return truth.values[offset] if isinstance(offset, str) else offset


class OneTrialFigure(FigureSpec):
    """Base of the figures that show the estimates of one trial."""

    trial: Annotated[Count, Field(ge=0)] = 0
    """Number of the trial."""

    def says(self, results: Results) -> str:
        """The number of the trial, and which case is shown where the labels leave several."""
        return "; ".join(said_of_trial(results.plan, self, self.trial))


def true_curve(truth: Truth, x: Array) -> Array:
    """The true characteristic at increasing points, with a gap at each of its break points."""
    y = np.array(needed(truth.nonlinearity)(x))
    y[np.searchsorted(x, [b for b in truth.breakpoints if x[0] < b < x[-1]])] = np.nan
    return y


def say_failed(axes: Axes, said: str) -> None:
    """Write into the middle of a panel why it lacks what failed."""
    axes.text(0.5, 0.5, said, transform=axes.transAxes, ha="center", wrap=True)


def list_failures(axes: Axes, failures: Sequence[str]) -> None:
    """Write into the corner of a panel of several curves which of them are missing, and why."""
    look: dict[str, Any] = {"fontsize": 7, "ha": "left", "va": "top", "wrap": True, "zorder": 7}
    # However long, the words do not push the panels apart.
    look["in_layout"] = False
    if failures:
        axes.text(0.02, 0.98, "\n".join(failures), transform=axes.transAxes, bbox=NOTE, **look)
