"""The output that an estimate gives for the input of a record."""

from __future__ import annotations

import numpy as np

from hident.arrays import Array
from hident.errors import EstimationError
from hident.records import Estimate, Record


def simulated(estimate: Estimate, record: Record) -> Array:
    """The output (N,) that an estimate gives for a record's input alone, each experiment by itself.

    By the estimate's ``model``, or else by its ``response`` from rest, at the sampling interval of each
    experiment.

    Raises
    ------
    EstimationError
        If the estimate has neither, or its output grows beyond all numbers.

    Examples
    --------
    >>> record = Record([1.0, 2.0, 4.0], [0.0, 0.0, 0.0])
    >>> simulated(Estimate(response=lambda u, dt: 0.5 * u), record)
    array([0.5, 1. , 2. ])
    """
    if estimate.model is not None:
        return finite_output(estimate.model.simulate(record), "simulated")
    if (response := estimate.response) is None:
        raise EstimationError("the estimate has no model and no response to simulate an output with")
    if not has_stable_block(estimate):
        raise EstimationError("the linear block is unstable: its simulated output says nothing")
    dt = 1.0 if record.dt is None else record.dt
    if not record.parts:
        return finite_output(response(record.u, dt), "simulated")
    found = [response(record.u[part.samples], part.dt) for part in record.parts.values()]
    return finite_output(np.concatenate(found), "simulated")


def has_stable_block(estimate: Estimate) -> bool:
    """Whether the linear block is stable, apart from integrators, if there is one."""
    return all(
        block is None or block.is_stable(integrators=True) for block in (estimate.continuous, estimate.linear)
    )


def finite_output(y: Array, how: str) -> Array:
    """The output (N,), ``how`` it was made; EstimationError if it is not finite."""
    if not np.isfinite(y).all():
        first = int(np.flatnonzero(~np.isfinite(y))[0])
        raise EstimationError(f"the {how} output is {y[first]} at sample {first} of {len(y)}")
    return y
