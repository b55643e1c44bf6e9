"""What can be seen to be hopeless before a trial runs, from the record of trial 0."""

from __future__ import annotations

import numpy as np

from hident.config.load import Problem
from hident.engine.experiment import Plan
from hident.engine.trial import generate
from hident.errors import EstimationError, SimulationError
from hident.estimators.base import EstimatorSpec
from hident.records import Record


def check_records(plan: Plan) -> None:
    """Show the record of trial 0 of every case to the estimators that can judge one.

    Raises
    ------
    ConfigError
        With one line for each estimator that cannot work with its case's records.
    """
    problems = []
    records: dict[int, Record | None] = {}
    for unit in plan.units:
        if type(unit.estimator).check_record is EstimatorSpec.check_record:
            continue
        key = unit.data.key
        try:
            with np.errstate(all="ignore"):
                if key not in records:
                    # A simulation that fails is a failed trial of the run to come.
                    records[key] = None
                    records[key] = generate(unit.data, plan.experiment.seed, 0)
                if (record := records[key]) is not None:
                    unit.estimator.check_record(record)
        except SimulationError:
            continue
        except EstimationError as error:
            case = ", ".join(f"{axis} {label}" for axis, label in unit.labels.items())
            at = f" (at {case})" if case else ""
            problems.append(Problem(("estimators", unit.name), f"{error}{at}"))
    if problems:
        raise plan.document.error(problems)
