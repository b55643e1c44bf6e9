"""One trial again: its record and the estimates from it, made from their seeds.

Nothing of a record or an estimate is stored. Whoever wants to see one, a figure or a user, makes it again:

    trial = OneTrial(load(Path("configs/chen_fig4.yaml")), 3)
    trial.of("two stages", {"type": "II"}).found
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np

from hident.arrays import Array
from hident.config.suggest import did_you_mean
from hident.engine.clock import Clock, Limit
from hident.engine.experiment import Label, Plan, Unit
from hident.engine.measurement import Measurement
from hident.engine.trial import FAILURES, Data, Job, estimate, generate, numbers, reason, scoring_of
from hident.errors import ConfigError, HidentError, TrialsCrashed
from hident.metrics.base import MetricSpec
from hident.records import Estimate, Record, Truth

T = TypeVar("T")
_DETAILS = {
    "history": "history of an iteration",
    "partition": "partition search",
    "structure": "structure search",
    "internal_variable": "internal variable",
    "smoothed": "smoothed points",
}


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
        """A detail of the estimate, such as its history; ValueError if the estimate does not hold it."""
        assert self.found is not None
        if name not in self.found.details:
            raise ValueError(f"the estimate of '{self.unit.name}' holds no {_DETAILS[name]}")
        return self.found.details[name]


class OneTrial:
    """One trial of a plan: each record and each estimate is made once, when it is asked for.

    What a run counts as a failed trial fails here with the same reason; any other error is raised.
    """

    def __init__(self, plan: Plan, trial: int) -> None:
        self._plan, self.number = plan, trial
        self._records: dict[int, tuple[Record | None, str]] = {}
        self._realised: dict[int, Realised] = {}

    def of(self, estimator: str, labels: Mapping[str, Label]) -> Realised:
        """The trial of an estimator at the given labels of axes; that of the first case which they leave.

        ConfigError if there is no such estimate.
        """
        named = (unit for unit in self._plan.units if unit.name == estimator and unit.is_at(labels))
        if (unit := next(named, None)) is None:
            near = did_you_mean(estimator, {unit.name for unit in self._plan.units} - {estimator})
            at = ", ".join(f"{axis} {label}" for axis, label in labels.items())
            raise ConfigError(f"there is no estimate of '{estimator}' at {at or 'any case'}{near}")
        return self.of_unit(unit)

    def of_unit(self, unit: Unit) -> Realised:
        """The trial of a unit of the plan."""
        if id(unit) not in self._realised:
            self._realised[id(unit)] = self._realise(unit)
        return self._realised[id(unit)]

    def scores(self, unit: Unit) -> dict[str, tuple[float, str]]:
        """By the labels of a unit's metrics: the value as a run has it, and why there is none (then nan)."""
        realised, scores = self.of_unit(unit), {}
        for name, metric in unit.metrics.items():
            labels = metric.labels(name)
            found, record, failure = realised.found, realised.record, realised.failure
            values = None
            if found is not None and record is not None:
                values, failure = self._tried(partial(self._scored, unit, metric, found, record))
            for i, label in enumerate(labels):
                value = np.nan if values is None else float(values[i])
                said = failure or ("" if np.isfinite(value) else f"the value is {value}")
                scores[label] = (value, said)
        return scores

    def _scored(self, unit: Unit, metric: MetricSpec, found: Estimate, record: Record) -> Array:
        scoring, seen = scoring_of(metric, unit.estimator, unit.data.system.truth(), unit.data.dt)
        return numbers(scoring, found, seen(record, found), len(metric.labels("")))

    def record(self, data: Data) -> tuple[Record | None, str]:
        """The record of a case, or None and why its simulation failed."""
        if data.key not in self._records:
            self._records[data.key] = self._tried(
                lambda: generate(data, self._plan.seed, self.number, self._plan.perturbation)
            )
        return self._records[data.key]

    def noise_free(self, data: Data) -> Array | None:
        """The output of a case before its noise; None of a measured record, or if it cannot be simulated."""
        if isinstance(data, Measurement):
            return None
        record, _ = self._tried(lambda: data.before_noise(self._plan.seed, self.number))
        return None if record is None else record.y

    def _realise(self, unit: Unit) -> Realised:
        truth, (record, failure) = unit.truth(), self.record(unit.data)
        if record is None:
            return Realised(unit, truth, None, None, failure)
        job = Job(unit.estimator, ())
        seed = self._plan.seed
        own, failure = self._tried(lambda: unit.data.record_for(job, record, seed, self.number))
        if own is None:
            return Realised(unit, truth, record, None, failure)
        found, failure = self._tried(lambda: estimate(unit.data, job, own, seed, self.number))
        return Realised(unit, unit.truth(found), own, found, failure)

    def _tried(self, make: Callable[[], T]) -> tuple[T | None, str]:
        """What is made, or None and why it failed."""
        limit = Limit.of(self._plan.trial_timeout)
        try:
            with np.errstate(all="ignore"), Clock(limit) as clock:
                return clock.limited(make), ""
        except FAILURES as error:
            return None, reason(error)


def replayed(trial: OneTrial, unit: Unit) -> Realised:
    """The trial of a unit; TrialsCrashed if it ends in an error that is no result, as a run would."""
    try:
        return trial.of_unit(unit)
    except HidentError:
        raise
    except Exception as error:
        raise TrialsCrashed(
            f"trial {trial.number} of {unit.described()} crashed: {type(error).__name__}: {error}"
        ) from error
