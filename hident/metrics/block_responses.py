"""Distances between the responses of an estimated and of the true linear block."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence, Set
from typing import Annotated, ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from hident.arrays import Array, Complex
from hident.config.spec import Count, Interval, Real, component
from hident.linear_blocks import SLOWEST, ContinuousTransferFunction, TransferFunction
from hident.metrics.base import Best, Comparing, MetricSpec, Scored
from hident.numerics.freedoms import Freedom, factor, nearest
from hident.records import Estimate, Record, Truth, needed

Block = TransferFunction | ContinuousTransferFunction

# Sampling intervals this close, relative to their size, are one.
_SAME = 1e-9
# What is left of an impulse response after so many samples does not count.
_LONGEST = 2**22
# The default band reaches so far below the Nyquist frequency.
_BELOW = 1000.0
# Delays that are tried for a turn of the highest frequency, and in all at most.
_PER_TURN = 8
_MOST_DELAYS = 8192


def impulse_response_percent_error(
    found: TransferFunction, true: TransferFunction, free: Collection[Freedom] = ()
) -> float:
    """Root of the summed squared error of the impulse response in percent of that of the true one.

    What is ``free`` is chosen for the least error: the factor, its sign, and a delay of whole samples either
    way. Infinite for an unstable estimate.

    Examples
    --------
    >>> found, true = TransferFunction(b=(0.0, 2.0, 1.0)), TransferFunction(b=(1.0, 0.5))
    >>> impulse_response_percent_error(found, true, ("gain", "delay"))
    0.0
    """
    if not found.is_stable():
        return math.inf
    length = max(_length(found), _length(true))
    one, other = found.impulse_response(length), true.impulse_response(length)
    if "delay" in free:
        one, other = _aligned(one, other, free)
    error = nearest(one, other, np.ones(len(one)), free) - other
    return 100.0 * float(np.linalg.norm(error) / np.linalg.norm(other))


def _length(block: TransferFunction) -> int:
    """Samples after which the impulse response is over."""
    return block.memory() if block.radius() <= SLOWEST else _LONGEST


def _aligned(found: Array, true: Array, free: Collection[Freedom]) -> tuple[Array, Array]:
    """Both (N,), one of them delayed so that they fit best, filled up with zeros."""
    from scipy.signal import correlate

    fits = correlate(true, found, method="fft")
    shift = int(np.argmax(np.abs(fits) if "sign" in free else fits)) - (len(found) - 1)
    pad = np.zeros(abs(shift))
    one, other = np.concatenate((found, pad)), np.concatenate((true, pad))
    return (np.roll(one, shift), other) if shift > 0 else (one, np.roll(other, -shift))


def frequency_response_percent_error(
    found: Complex, true: Complex, omega: Array, free: Collection[Freedom] = (), step: float | None = None
) -> float:
    """Root mean square error of the complex gain (M,) in percent of that of the true one, at ``omega`` (M,).

    What is ``free`` is chosen for the least error: the factor, its sign, and a delay either way, in multiples
    of ``step`` if that is given.

    Examples
    --------
    >>> omega = np.geomspace(0.01, 1.0, 50)
    >>> true = 1.0 / (1.0 + 1j * omega)
    >>> found = 2.0 * true * np.exp(-1j * omega)
    >>> round(frequency_response_percent_error(found, true, omega), 1)
    107.9
    >>> round(frequency_response_percent_error(found, true, omega, ("gain", "delay")), 4)
    0.0
    """
    if "delay" in free:
        found = found * np.exp(-1j * omega * _best_delay(found, true, omega, free, step))
    error = factor(found, true, 1.0, free) * found - true
    return 100.0 * float(np.linalg.norm(error) / np.linalg.norm(true))


def _best_delay(
    found: Complex, true: Complex, omega: Array, free: Collection[Freedom], step: float | None
) -> float:
    from scipy.optimize import minimize_scalar

    product = np.conj(found) * true

    def fit(tau: float) -> float:
        total = float(np.sum((product * np.exp(1j * omega * tau)).real))
        return abs(total) if "sign" in free else total

    spacing = step or 2.0 * math.pi / float(np.max(omega)) / _PER_TURN
    count = min(math.ceil(2.0 * math.pi / float(np.min(omega)) / spacing), _MOST_DELAYS // 2)
    tried = spacing * np.arange(-count, count + 1)
    best = float(tried[int(np.argmax([fit(tau) for tau in tried]))])
    if step is not None:
        return best
    refined = minimize_scalar(
        lambda tau: -fit(tau),
        bounds=(best - spacing, best + spacing),
        method="bounded",
        options={"xatol": 1e-12 * spacing},
    )
    return float(refined.x)


class _OfBlocks(Comparing):
    best: ClassVar[Best | None] = "lowest"
    choices: ClassVar[tuple[Freedom, ...]] = ("gain", "sign", "delay")

    step: Annotated[Real, Field(gt=0)] | None = None
    """Sampling interval, in the unit of dt, at which a continuous block is compared where it is sampled
    (default: that of the estimate's discrete block, or dt)."""

    def needs_of_truth(self) -> frozenset[str]:
        return frozenset({"linear or continuous"})

    def needs_of_estimate(self) -> frozenset[str]:
        return frozenset({"linear or continuous"})

    def completed(self, left: Set[Freedom], step: float) -> MetricSpec:
        one = super().completed(left, step)
        return one if self.step is not None else one.model_copy(update={"step": step})

    def check(self, scored: Scored) -> None:
        step, dt = self.step or scored.step, 1.0 if scored.dt is None else scored.dt
        if _is_discrete(scored.provides) and abs(step - scored.step) > _SAME * step:
            raise ValueError(
                f"compares blocks sampled every {step:g}, and the estimate's is sampled every "
                f"{scored.step:g}: leave out 'step'"
            )
        if scored.truth.linear is not None and abs(step - dt) > _SAME * step:
            raise ValueError(
                f"compares blocks sampled every {step:g}, and the system's is sampled every {dt:g}: neither "
                "tells the other"
            )

    def blocks(self, estimate: Estimate, record: Record) -> tuple[Block, Block]:
        """The estimated and the true block."""
        found = needed(estimate.linear) if estimate.continuous is None else estimate.continuous
        return found, _true(needed(record.truth))

    def interval(self, record: Record) -> float:
        """The sampling interval at which blocks are compared."""
        return self.step or record.dt or 1.0


def _is_discrete(provides: Set[str]) -> bool:
    return "linear" in provides and "continuous" not in provides


def _true(truth: Truth) -> Block:
    return needed(truth.linear) if truth.continuous is None else truth.continuous


def _sampled(block: Block, step: float) -> TransferFunction:
    return block if isinstance(block, TransferFunction) else block.sampled(step)


@component("metric", "impulse_response_error")
class ImpulseResponseError(_OfBlocks):
    """Percent error of the linear block's impulse response, as samples of a held input see it.

        100 (sum_k (g_est(k) - g(k))^2 / sum_k g(k)^2)^(1/2)

    The root of the summed squared error in percent of that of the true one. A continuous block is taken by
    its response to a pulse of the length ``step``; a delay that is chosen is a whole number of samples.
    Infinite for an unstable estimate.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Fir(b=[0, 3, 4]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> estimate = hi.Estimate(linear=hi.TransferFunction(b=(0.0, 3.0, 3.5)))
    >>> hi.score(estimate, record, error=hi.ImpulseResponseError())
    {'error': 10.0}
    >>> double = hi.Estimate(linear=hi.TransferFunction(b=(6.0, 8.0)))
    >>> hi.score(double, record, error=hi.ImpulseResponseError(up_to=["gain", "delay"]))
    {'error': 0.0}
    """

    def check(self, scored: Scored) -> None:
        super().check(scored)
        true = scored.truth
        if not _true(true).is_stable():
            raise ValueError(
                "sums over an impulse response, and that of the system's linear block never ends: take the "
                "kind frequency_response_error"
            )

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        found, true = (_sampled(block, self.interval(record)) for block in self.blocks(estimate, record))
        return (impulse_response_percent_error(found, true, self.up_to or ()),)


@component("metric", "frequency_response_error")
class FrequencyResponseError(_OfBlocks):
    """Percent error of the linear block's complex gain over a band of frequencies at equal ratios.

        100 (sum_w |G_est(jw) - G(jw)|^2 / sum_w |G(jw)|^2)^(1/2)

    The root mean square error in percent of that of the true one. Two continuous blocks are compared as they
    are; where one is discrete, the other is sampled with held inputs, and a delay that is chosen is a whole
    number of samples.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Continuous(a=[1]))
    >>> record = hi.simulate(system, hi.Multistep(switching_time=1, std=1), 50, dt=0.1)
    >>> estimate = hi.Estimate(continuous=hi.ContinuousTransferFunction(b=(1.2,), a=(1.0,)))
    >>> round(hi.score(estimate, record, error=hi.FrequencyResponseError())["error"], 6)
    20.0
    >>> error = hi.FrequencyResponseError(band=[0.01, 1], up_to=["gain"])
    >>> round(hi.score(estimate, record, error=error)["error"], 6)
    0.0
    """

    band: Interval | None = None
    """Lowest and highest angular frequency, radians in the unit of time (default: up to the Nyquist frequency
    of the step, from a thousandth of it)."""
    points: Annotated[Count, Field(ge=2)] = 256
    """Number of frequencies."""

    @model_validator(mode="after")
    def _positive(self) -> Self:
        if self.band is not None and self.band[0] <= 0.0:
            raise ValueError(f"'band' must begin above zero, not at {self.band[0]:g}")
        return self

    def check(self, scored: Scored) -> None:
        super().check(scored)
        nyquist = math.pi / (self.step or scored.step)
        discrete = _is_discrete(scored.provides) or scored.truth.linear is not None
        if discrete and self.band is not None and self.band[1] > nyquist * (1.0 + _SAME):
            raise ValueError(
                f"has a band up to {self.band[1]:g}, and a discrete block's frequencies end at {nyquist:g}, "
                "half its sampling rate"
            )

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        step = self.interval(record)
        low, high = self.band or (math.pi / step / _BELOW, math.pi / step)
        omega = np.geomspace(low, high, self.points)
        one, other = self.blocks(estimate, record)
        whole: float | None = None
        if isinstance(one, TransferFunction) or isinstance(other, TransferFunction):
            whole = step
            found, true = (_sampled(block, step).frequency_response(omega, step) for block in (one, other))
        else:
            found, true = one.frequency_response(omega), other.frequency_response(omega)
        error = frequency_response_percent_error(found, true, omega, self.up_to or (), whole)
        return (error,)
