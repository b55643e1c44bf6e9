"""What figures of one trial share: records and estimates, made again from their seeds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.spec import Count, Real, Spec
from hident.config.suggest import one_of
from hident.engine.experiment import Label, Plan, Unit
from hident.engine.results import Results
from hident.engine.trial import FAILURES, Data, Job, estimate, generate, reason
from hident.records import Estimate, Record, Truth
from hident.reports.base import FigureSpec, Misfit, Place, Reference, label_references

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DETAILS = {
    "history": "history of an iteration",
    "partition": "partition search",
    "structure": "structure search",
    "internal_variable": "internal variable",
    "smoothed": "smoothed points",
}
NOTE = {"boxstyle": "square,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
"""The ground of words that stand on curves."""
Offset = Annotated[Real | str, Field(union_mode="left_to_right")]
"""A number, or the name of a true value of the system."""


class Shown(Spec):
    """The estimate of one estimator in one case."""

    estimator: str
    """Name of the estimator."""
    at: dict[str, Any] = {}
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

    def references(self, place: Place) -> Iterator[Reference]:
        """The names that it refers to; it stands at the place."""
        yield (*place, "estimator"), "estimator", self.estimator
        yield from label_references((*place, "at"), self.at)

    def misfits(
        self, plan: Plan, place: Place, *, of_estimate: str = "", of_truth: str = ""
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
    plan: Plan, place: Place, curves: Sequence[Shown], offsets: Mapping[str, Offset]
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


@dataclass(frozen=True, eq=False)
class Realised:
    """One trial of one unit.

    Where it failed, ``failure`` says why, ``found`` is None, and so is ``record`` if there is none.
    """

    unit: Unit
    truth: Truth
    record: Record | None
    found: Estimate | None
    failure: str = ""

    def detail(self, name: str) -> Any:
        """A detail of the estimate, such as its history.

        Raises
        ------
        ValueError
            If the estimate does not hold it.
        """
        assert self.found is not None
        if name not in self.found.details:
            raise ValueError(f"the estimate of '{self.unit.name}' holds no {_DETAILS[name]}")
        return self.found.details[name]


class OneTrial:
    """One trial of all units: each record and each estimate is made once, when it is asked for."""

    def __init__(self, results: Results, trial: int) -> None:
        self._results, self._trial = results, trial
        self._records: dict[int, Record] = {}
        self._realised: dict[int, Realised] = {}

    def of(self, estimator: str, labels: Mapping[str, Label]) -> Realised:
        """The trial of an estimator at the given labels of axes."""
        unit = next(self._results.select(estimator, labels=labels)).unit
        if id(unit) not in self._realised:
            self._realised[id(unit)] = self._realise(unit)
        return self._realised[id(unit)]

    def _realise(self, unit: Unit) -> Realised:
        truth, record = unit.data.system.truth(), None
        try:
            with np.errstate(all="ignore"):
                record = self._record(unit.data)
                job = Job(unit.estimator, ())
                found = estimate(unit.data, job, record, self._results.plan.seed, self._trial)
        except FAILURES as error:
            return Realised(unit, truth, record, None, reason(error))
        return Realised(unit, truth, record, found)

    def _record(self, data: Data) -> Record:
        if data.key not in self._records:
            self._records[data.key] = generate(data, self._results.plan.seed, self._trial)
        return self._records[data.key]


class OneTrialFigure(FigureSpec):
    """Base of the figures that show the estimates of one trial."""

    trial: Annotated[Count, Field(ge=0)] = 0
    """Number of the trial."""


def true_curve(truth: Truth, x: Array) -> Array:
    """The true characteristic at increasing points, with a gap at each of its break points."""
    assert truth.nonlinearity is not None
    y = np.array(truth.nonlinearity(x))
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
