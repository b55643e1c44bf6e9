"""The output that an estimate gives for the input of a record."""

from __future__ import annotations

import numpy as np

from hident.arrays import Array
from hident.errors import EstimationError
from hident.records import Estimate, Record, Response

# An output at input zero that moves by less than this part of how it moves with the input is at rest.
_AT_REST = 1e-9
# What is left of how it moved, where it counts as settled, and the samples in which it must have done so.
_LEFT = 1e-12
_LONGEST = 2**20


def from_equilibrium(response: Response, u: Array, dt: float) -> Array | None:
    """The output (N,) to the input ``u`` (N,) before which it was zero for ever; None if that has no end.

    A response from rest, to the last bit, where it rests at input zero from the first sample.

    Examples
    --------
    >>> def lag(u, dt):  # y_k = y_(k-1) / 2 + 1 + u_k
    ...     return np.convolve(1.0 + u, 0.5 ** np.arange(len(u)))[: len(u)]
    >>> u = np.array([0.0, 1.0, 0.0])
    >>> lag(u, 1.0), from_equilibrium(lag, u, 1.0).round(6)
    (array([1.  , 2.5 , 2.25]), array([2. , 3. , 2.5]))
    """
    made, samples = response(u, dt), len(u)
    with np.errstate(all="ignore"):
        still = response(np.zeros(samples), dt)
        if np.ptp(still) <= _AT_REST * np.std(made):
            return made
        while samples <= _LONGEST and np.all(np.isfinite(still)):
            moving = np.flatnonzero(np.abs(still - still[-1]) > _LEFT * np.ptp(still))
            settled = int(moving[-1]) + 1 if len(moving) else 0
            if 2 * settled <= samples:
                return response(np.concatenate((np.zeros(settled), u)), dt)[settled:]
            samples *= 2
            still = response(np.zeros(samples), dt)
    return None


def equilibrium_needed(y: Array | None, whose: str) -> Array:
    """An output from equilibrium, if there is one; else EstimationError that says ``whose`` is missing."""
    if y is None:
        raise EstimationError(
            f"the {whose} has no equilibrium at input zero in which its output could begin: a linear block "
            "integrates a constant, or settles too slowly"
        )
    return y


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
