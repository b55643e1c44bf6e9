"""Scores of a whole model or of its linear block against the truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from hident.config.spec import Count, Of, Real, component
from hident.errors import SimulationError
from hident.metrics.base import MetricSpec
from hident.records import Array, Estimate, Record
from hident.signals.base import ExcitationSpec
from hident.systems.continuous import ContinuousTransferFunction
from hident.systems.linear import TransferFunction


def discretised_percent_error(
    estimate: TransferFunction | ContinuousTransferFunction, truth: ContinuousTransferFunction, step: float
) -> float:
    """Percent error of the linear parameters in discrete time, gain and delay apart.

    Both blocks are brought to unit static gain and sampled every ``step`` with held inputs; a discrete
    estimate is taken as it is. The sums run over a'_1, ..., and b'_1, ..., of the true block without
    its delay; leading zeros of a discrete estimate count as its delay.

    Notes
    -----
    Chen, Hwang, Chang 2009, section 6, example 1. The paper does not state the step, which moves the figure.
    """
    true = _parameters(_without_delay(truth).sampled(step))
    if isinstance(estimate, ContinuousTransferFunction):
        estimate = _without_delay(estimate).sampled(step)
    found = _parameters(estimate)
    width = max(len(one) for one in (*true, *found))
    errors = sum(
        float(np.sum(np.abs(np.pad(a, (0, width - len(a))) - np.pad(b, (0, width - len(b))))))
        for a, b in zip(found, true, strict=True)
    )
    return 100.0 * errors / float(sum(np.sum(np.abs(part)) for part in true))


def _without_delay(block: ContinuousTransferFunction) -> ContinuousTransferFunction:
    return ContinuousTransferFunction(block.b, block.a)


def _parameters(block: TransferFunction) -> tuple[np.ndarray, np.ndarray]:
    """The feedback and the numerator without leading zeros, for unit static gain."""
    b = np.trim_zeros(np.asarray(block.b), "f")
    gain = np.sum(b) / np.sum(block.denominator)
    return np.asarray(block.a, dtype=float), b / gain


@component("metric", "linear_percent_error", source="Chen, Hwang, Chang 2009, section 6, example 1")
class LinearPercentError(MetricSpec):
    """Percent error of the linear block's parameters in discrete time, its gain and delay apart."""

    step: Annotated[Real, Field(gt=0)] = 1.0
    """Sampling interval at which the blocks are compared, in the unit of dt."""

    def needs_of_truth(self) -> frozenset[str]:
        return frozenset({"continuous"})

    def needs_of_estimate(self) -> frozenset[str]:
        return frozenset({"linear or continuous"})

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        assert record.truth is not None
        assert record.truth.continuous is not None
        block = estimate.continuous or estimate.linear
        assert block is not None
        return (discretised_percent_error(block, record.truth.continuous, self.step),)


@component("metric", "settling_time", source="Chen, Hwang, Chang 2009, example 5")
class SettlingTime(MetricSpec):
    """Time after which the step response of the estimated linear block stays in a band; delay apart."""

    band: Annotated[Real, Field(gt=0, lt=1)] = 0.05
    """Half the width of the band, relative to the final value."""

    def needs_of_estimate(self) -> frozenset[str]:
        return frozenset({"continuous"})

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        assert estimate.continuous is not None
        return (estimate.continuous.settling_time(self.band),)


@component("metric", "validation_error")
class ValidationError(MetricSpec):
    """Percent error of the model's noise-free response to an input that it was not fitted to.

    Infinite for a model with an unstable linear block, whose response says nothing.
    """

    excitation: Annotated[ExcitationSpec, Of("excitation")]
    """The input; a random one is drawn from a stream of its own, the same in every trial."""
    samples: Annotated[Count, Field(ge=2)]
    """Its length."""

    def needs_of_truth(self) -> frozenset[str]:
        return frozenset({"response"})

    def needs_of_estimate(self) -> frozenset[str]:
        return frozenset({"response"})

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        assert record.truth is not None
        assert record.truth.response is not None
        assert estimate.response is not None
        if not has_stable_block(estimate):
            return (math.inf,)
        dt = 1.0 if record.dt is None else record.dt
        u = validation_input(self.excitation, self.samples, dt)
        return (fit_error(estimate.response(u, dt), record.truth.response(u, dt)),)


def validation_input(excitation: ExcitationSpec, samples: int, dt: float) -> Array:
    """The input (samples,) of a validation; a random one is the same everywhere.

    Raises
    ------
    SimulationError
        If the samples cannot hold the excitation.
    """
    try:
        excitation.check(samples, dt)
    except ValueError as error:
        raise SimulationError(f"the validation's excitation does not fit: {error}") from None
    return excitation.sample(samples, dt, np.random.default_rng(0))


def has_stable_block(estimate: Estimate) -> bool:
    """Whether the linear block is stable, if there is one."""
    return all(block is None or block.is_stable() for block in (estimate.continuous, estimate.linear))


def fit_error(predicted: np.ndarray, actual: np.ndarray) -> float:
    """Root mean square error in percent of the standard deviation of the actual output, both (N,)."""
    return 100.0 * float(np.sqrt(np.mean((predicted - actual) ** 2)) / np.std(actual))
