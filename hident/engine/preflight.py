"""What can be seen to be hopeless before a trial runs, from the record of trial 0."""

from __future__ import annotations

import numpy as np

from hident.config.load import Problem
from hident.engine.expansion import Unit
from hident.engine.experiment import Plan
from hident.engine.replay import OneTrial
from hident.engine.trial import Data
from hident.errors import EstimationError
from hident.estimators.base import EstimatorSpec


def check_records(plan: Plan) -> None:
    """Ask each estimator about its case's experiments, and about the record of trial 0 if it can judge one.

    ConfigError with one line for each estimator that cannot work with its case's records.
    """
    problems, trial = [], OneTrial(plan, 0)
    for unit in plan.units:
        try:
            unit.estimator.check_experiments(_intervals(unit.data), unit.data.dt)
        except EstimationError as error:
            problems.append(_problem(unit, error))
            continue
        if type(unit.estimator).check_record is EstimatorSpec.check_record:
            continue
        # A simulation that fails is a failed trial of the run to come.
        record, _ = trial.record(unit.data)
        try:
            if record is not None:
                with np.errstate(all="ignore"):
                    unit.estimator.check_record(record)
        except EstimationError as error:
            problems.append(_problem(unit, error))
    if problems:
        raise plan.document.error(problems)


def _intervals(data: Data) -> dict[str, float]:
    """The sampling intervals of the experiments by name."""
    dt = 1.0 if data.dt is None else data.dt
    return {stretch.name: stretch.dt for stretch in data.excitation.stretches(data.samples, dt)}


def _problem(unit: Unit, error: EstimationError) -> Problem:
    case = ", ".join(f"{axis} {label}" for axis, label in unit.labels.items())
    at = f" (at {case})" if case else ""
    return Problem(("estimators", unit.name), f"{error}{at}")
