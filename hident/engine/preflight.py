"""What can be seen to be hopeless before a trial runs: an input that cannot tell the parameters apart."""

from __future__ import annotations

import numpy as np

from hident.config.load import Problem
from hident.engine.experiment import Plan
from hident.engine.trial import generate_input
from hident.errors import EstimationError
from hident.estimators.base import EstimatorSpec
from hident.records import Array


def check_inputs(plan: Plan) -> None:
    """Show the input of trial 0 of every case to the estimators that can judge an input.

    Raises
    ------
    ConfigError
        With one line for each estimator that cannot work with its case's input.
    """
    problems = []
    inputs: dict[int, Array] = {}
    for unit in plan.units:
        if type(unit.estimator).check_input is EstimatorSpec.check_input:
            continue
        key = unit.data.key
        if key not in inputs:
            inputs[key] = generate_input(unit.data, plan.experiment.seed, 0)
        try:
            with np.errstate(all="ignore"):
                unit.estimator.check_input(inputs[key])
        except EstimationError as error:
            case = ", ".join(f"{axis} {label}" for axis, label in unit.labels.items())
            at = f" (at {case})" if case else ""
            text = f"the input cannot tell the parameters apart{at}: {error}"
            problems.append(Problem(("estimators", unit.name), text))
    if problems:
        raise plan.document.error(problems)
