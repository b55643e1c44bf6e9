"""What can be seen to be hopeless before a trial runs, from the record of trial 0."""

from __future__ import annotations

import numpy as np

from hident.config.load import Problem
from hident.engine.expansion import Unit
from hident.engine.experiment import Plan
from hident.engine.trial import Data, generate
from hident.errors import EstimationError, SimulationError
from hident.estimators.base import EstimatorSpec
from hident.records import Record


def check_records(plan: Plan) -> None:
    """Ask each estimator about its case's experiments, and about the record of trial 0 if it can judge one.

    Raises
    ------
    ConfigError
        With one line for each estimator that cannot work with its case's records.
    """
    problems = []
    records: dict[int, Record | None] = {}
    for unit in plan.units:
        try:
            unit.estimator.check_experiments(_intervals(unit.data), unit.data.dt)
        except EstimationError as error:
            problems.append(_problem(unit, error))
            continue
        if type(unit.estimator).check_record is EstimatorSpec.check_record:
            continue
        key = unit.data.key
        try:
            with np.errstate(all="ignore"):
                if key not in records:
                    # A simulation that fails is a failed trial of the run to come.
                    records[key] = None
                    records[key] = generate(unit.data, plan.seed, 0)
                if (record := records[key]) is not None:
                    unit.estimator.check_record(record)
        except SimulationError:
            continue
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
