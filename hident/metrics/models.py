"""Scores of a whole model or of its linear block against the truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.spec import Count, Of, Real, component
from hident.errors import EstimationError, SimulationError
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction
from hident.metrics.base import Comparing, MetricSpec, Scored
from hident.model_output import equilibrium_needed, from_equilibrium, has_stable_block, simulated
from hident.numerics.freedoms import Freedom
from hident.numerics.parts import in_each
from hident.numerics.rounding import is_constant
from hident.records import Estimate, Record, Response, Truth, needed
from hident.signals.base import MOST_SAMPLES, ExcitationSpec

# The share of its state that a block keeps in a step below which its sampled parameters say nothing of it.
_GONE = 1e-6
# Sampling intervals this close, relative to their size, are one.
_SAME = 1e-9


def discretised_percent_error(
    estimate: TransferFunction | ContinuousTransferFunction, truth: ContinuousTransferFunction, step: float
) -> float:
    """Percent error of the linear parameters in discrete time, gain and delay apart.

    Both blocks are brought to unit static gain and sampled every ``step`` with held inputs; a discrete
    estimate is taken as it is. The sums run over a'_1, ..., and b'_1, ..., of the true block without
    its delay; leading zeros of a discrete estimate count as its delay.

    Raises
    ------
    EstimationError
        If the estimate has no static gain to be divided by, or an infinite one.

    Notes
    -----
    Chen, Hwang, Chang 2009, section 6, example 1. The paper does not state the step, which moves the figure.
    """
    true = _parameters(_without_delay(truth).sampled(step))
    if isinstance(estimate, ContinuousTransferFunction):
        estimate = _without_delay(estimate).sampled(step)
    gain = estimate.static_gain()
    if gain == 0.0 or not math.isfinite(gain):
        raise EstimationError(f"the estimated block has the static gain {gain:g}, and cannot be brought to 1")
    found = _parameters(estimate)
    width = max(len(one) for one in (*true, *found))
    errors = sum(
        float(np.sum(np.abs(np.pad(a, (0, width - len(a))) - np.pad(b, (0, width - len(b))))))
        for a, b in zip(found, true, strict=True)
    )
    return 100.0 * errors / float(sum(np.sum(np.abs(part)) for part in true))


def _without_static_gain(block: ContinuousTransferFunction) -> str:
    """Why a block has no static gain; empty if it has one."""
    if block.integrators:
        return "an integrator"
    return "" if block.static_gain() else "b_0 = 0"


def _without_delay(block: ContinuousTransferFunction) -> ContinuousTransferFunction:
    return ContinuousTransferFunction(block.b, block.a)


def _parameters(block: TransferFunction) -> tuple[np.ndarray, np.ndarray]:
    """The feedback and the numerator without leading zeros, for unit static gain."""
    b = np.trim_zeros(np.asarray(block.b), "f")
    gain = np.sum(b) / np.sum(block.denominator)
    return np.asarray(block.a, dtype=float), b / gain


@component("metric", "linear_percent_error", source="Chen, Hwang, Chang 2009, section 6, example 1")
class LinearPercentError(MetricSpec):
    """Percent error of the linear block's parameters in discrete time, its gain and delay apart.

    Parameters that one block has and the other has not count as zero there, as in the paper. So it is for
    estimates of the system's own orders: of an impulse response it says nothing, however good that is, and
    impulse_response_error does.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="chen_type_1", linear=hi.Continuous(a=[4, 4], delay=1))
    >>> record = hi.simulate(system, hi.Multistep(switching_time=1, std=1), 50, dt=0.1)
    >>> estimate = hi.Estimate(continuous=hi.ContinuousTransferFunction(b=(1.0,), a=(4.0, 5.0)))
    >>> round(hi.score(estimate, record, error=hi.LinearPercentError(step=1))["error"], 1)
    11.6
    """

    best = "lowest"

    step: Annotated[Real, Field(gt=0)] | None = None
    """Sampling interval at which the blocks are compared, in the unit of dt (default: dt itself)."""

    def needs_of_truth(self) -> frozenset[str]:
        return frozenset({"continuous"})

    def needs_of_estimate(self) -> frozenset[str]:
        return frozenset({"linear or continuous"})

    def says(self, dt: float | None) -> str:
        return f"gain and delay apart, blocks sampled every {self._step(dt):g}"

    def check(self, scored: Scored) -> None:
        truth, step = scored.truth.continuous, self._step(scored.dt)
        if truth is not None and (why := _without_static_gain(truth)):
            raise ValueError(
                f"leaves the gain apart, and the system's linear block has no static gain ({why}) to be "
                "divided by: score the parameters by kind error, or the whole model by validation_error"
            )
        slowest = float(np.max(truth.poles().real)) if truth is not None and truth.a else 0.0
        if step * slowest < math.log(_GONE):
            raise ValueError(
                f"compares blocks sampled every {step:g}, in which the system's linear block (its longest "
                f"time constant is {-1.0 / slowest:.3g}) forgets all that its parameters say: set a smaller "
                "'step'"
            )
        discrete = "linear" in scored.provides and "continuous" not in scored.provides
        if discrete and abs(step - scored.step) > _SAME * step:
            raise ValueError(
                f"compares blocks sampled every {step:g}, and the estimate's is sampled every "
                f"{scored.step:g}: set 'step: {scored.step:g}'"
            )

    def _step(self, dt: float | None) -> float:
        return self.step or dt or 1.0

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        block = estimate.continuous or needed(estimate.linear)
        true = needed(needed(record.truth).continuous)
        return (discretised_percent_error(block, true, self._step(record.dt)),)


@component("metric", "settling_time", source="Chen, Hwang, Chang 2009, example 5")
class SettlingTime(MetricSpec):
    """Time after which the step response of the estimated linear block stays in a band; delay apart.

    Examples
    --------
    >>> import hident as hi
    >>> estimate = hi.Estimate(continuous=hi.ContinuousTransferFunction(b=(1.0,), a=(2.0,)))
    >>> round(hi.score(estimate, hi.Record([0], [0]), settling=hi.SettlingTime(band=0.05))["settling"], 2)
    5.99
    """

    band: Annotated[Real, Field(gt=0, lt=1)] = 0.05
    """Half the width of the band, relative to the final value."""

    def needs_of_estimate(self) -> frozenset[str]:
        return frozenset({"continuous"})

    def check(self, scored: Scored) -> None:
        truth = scored.truth.continuous
        if truth is not None and (why := _without_static_gain(truth)):
            raise ValueError(
                "measures from the final value of the step response, and the system's linear block has no "
                f"static gain ({why}): score the whole model by validation_error"
            )

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        return (needed(estimate.continuous).settling_time(self.band),)


class _OfResponse(Comparing):
    """Base of the errors of a whole response.

    The level of an output is determined by the data. On which side of a linear block a constant stands shows
    only where the block begins at rest: as the start of that constant.
    """

    best = "lowest"
    choices: ClassVar[tuple[Freedom, ...]] = ("constant",)
    how: ClassVar[str] = "by which both outputs begin in equilibrium at input zero"

    up_to: tuple[Freedom, ...] | None = None
    """[constant]: both outputs begin in equilibrium at input zero; []: at rest. Left out, in equilibrium
    where the method leaves open on which side of the linear block a constant stands, else at rest."""

    def needs_of_truth(self) -> frozenset[str]:
        return frozenset({"response"})

    @property
    def begins_in_equilibrium(self) -> bool:
        """Whether the outputs do so."""
        return "constant" in (self.up_to or ())

    def left_in_words(self) -> str:
        return (
            f"{_IN_EQUILIBRIUM}, not at rest, as the method leaves open on which side of the linear block a "
            "constant stands"
            if self.begins_in_equilibrium
            else ""
        )

    def says(self, dt: float | None) -> str:
        if self.up_to is None:
            return ""
        return _IN_EQUILIBRIUM if self.begins_in_equilibrium else "both outputs begin at rest"


_IN_EQUILIBRIUM = "both outputs begin in equilibrium at input zero"


@component("metric", "validation_error")
class ValidationPercentError(_OfResponse):
    """Percent error of the model's noise-free response to an input that it was not fitted to.

        100 (mean of (y_est - y)^2)^(1/2) / std(y)

    Model and system begin at rest. Where the method leaves open on which side of the linear block a constant
    stands, or ``up_to: [constant]`` asks for it, they begin in the equilibrium of input zero, so that the
    start of that constant is no error; the level of the output counts. ``up_to: []`` asks for rest. The
    standard deviation is that from equilibrium at all times, if the system has one.

    Infinite for a model with an unstable linear block, whose response says nothing.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="identity", linear=hi.Ar(a=[0.5]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> estimate = hi.Estimate(response=lambda u, dt: 0.9 * system.simulate(u))
    >>> validation = hi.ValidationPercentError(excitation=hi.Sine(period=20), samples=100)
    >>> round(hi.score(estimate, record, error=validation)["error"], 1)
    10.0
    """

    excitation: Annotated[ExcitationSpec, Of("excitation")]
    """The input; a random one is drawn from a stream of its own, the same in every trial."""
    samples: Annotated[Count, Field(ge=2, le=MOST_SAMPLES)]
    """Its length."""

    def needs_of_estimate(self) -> frozenset[str]:
        return frozenset({"response"})

    def check(self, scored: Scored) -> None:
        dt = 1.0 if scored.dt is None else scored.dt
        try:
            self.excitation.check(self.samples, dt)
            several = len(self.excitation.stretches(self.samples, dt)) > 1
        except ValueError as error:
            raise ValueError(f"has an excitation that does not fit: {error}") from None
        if several:
            raise ValueError("takes one experiment, not several one after the other")
        if self.excitation.before():
            raise ValueError(
                "starts both responses from rest, with nothing applied before time 0: "
                "leave out 'initial' of its excitation"
            )
        if self.begins_in_equilibrium and self._true(scored.truth, dt)[1] is None:
            raise ValueError(
                "begins both outputs in equilibrium at input zero, as the estimator leaves a constant open "
                "or 'up_to: [constant]' asks for it, and the system has no equilibrium there: write "
                "'up_to: []', by which they begin at rest"
            )

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        found = needed(estimate.response)
        if not has_stable_block(estimate):
            return (math.inf,)
        dt = 1.0 if record.dt is None else record.dt
        at_rest, settled = record.once(
            ("true response", self.excitation, self.samples), lambda: self._true(needed(record.truth), dt)
        )
        u = validation_input(self.excitation, self.samples, dt)
        of = at_rest if settled is None else settled
        if self.begins_in_equilibrium:
            made = equilibrium_needed(from_equilibrium(found, u, dt), "model")
            return (fit_error(made, equilibrium_needed(settled, "system"), of),)
        return (fit_error(found(u, dt), at_rest, of),)

    def _true(self, truth: Truth, dt: float) -> tuple[Array, Array | None]:
        """The true output (N,) from rest and from equilibrium."""
        response, u = needed(truth.response), validation_input(self.excitation, self.samples, dt)
        return response(u, dt), from_equilibrium(response, u, dt)


@component("metric", "output_mse")
class OutputMse(_OfResponse):
    """Mean squared difference between the model's output and the true one, to the input that was fitted.

    The true output is that without noise, so that what is scored is the estimate's error alone, in the
    squared unit of the output. Both begin at rest, or in equilibrium, as in :class:`ValidationPercentError`.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="identity", linear=hi.Ar(a=[0.5], initial="zero"))
    >>> input, noise = hi.Iid(distribution="uniform", low=-1, high=1), hi.White(std=1)
    >>> record = hi.simulate(system, input, 500, noise=noise)
    >>> estimate = hi.Estimate(response=lambda u, dt: 0.1 + system.simulate(u))
    >>> round(hi.score(estimate, record, error=hi.OutputMse())["error"], 9)
    0.01
    """

    def needs_of_estimate(self) -> frozenset[str]:
        return frozenset({"model or response"})

    def check(self, scored: Scored) -> None:
        if scored.system.burn_in() or scored.system.follows_waveforms():
            raise ValueError(
                "needs the true output from rest, and this system was in motion before the record: give its "
                "discrete blocks 'initial: zero', or score another input by validation_error"
            )

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        response, dt = needed(needed(record.truth).response), record.dt or 1.0

        def settled(whose: str, response: Response, u: Array) -> Array:
            return equilibrium_needed(from_equilibrium(response, u, dt), whose)

        if self.begins_in_equilibrium and estimate.response is not None:
            found = in_each(record.experiments, partial(settled, "model", estimate.response), record.u)
            true = in_each(record.experiments, partial(settled, "system", response), record.u)
        else:
            found = simulated(estimate, record)
            true = in_each(record.experiments, lambda u: response(u, dt), record.u)
        return (float(np.mean((found - true) ** 2)),)


def validation_input(excitation: ExcitationSpec, samples: int, dt: float) -> Array:
    """The input (samples,) of a validation; a random one is the same everywhere."""
    return excitation.sample(samples, dt, np.random.default_rng(0))


def fit_error(predicted: np.ndarray, actual: np.ndarray, of: np.ndarray | None = None) -> float:
    """Root mean square error in percent of the standard deviation of the actual output, all (N,).

    With ``of`` it is in percent of that one's.

    Raises
    ------
    SimulationError
        If the actual output is constant, so that nothing can be in percent of how it varies.
    """
    of = actual if of is None else of
    if is_constant(of):
        raise SimulationError("the true output does not vary under the validation's excitation")
    return 100.0 * float(np.sqrt(np.mean((predicted - actual) ** 2)) / np.std(of))
