"""Excitations: what is applied to the input of a simulated system.

Random excitations draw the record first and what lies before it afterwards, so that the record of a
given generator does not depend on the burn-in.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from hident.arrays import Array
from hident.config.spec import Count, Flag, Interval, Limits, Of, Real, component
from hident.config.suggest import one_of
from hident.numerics.whole import nearest_whole, whole_part
from hident.records import Held, Periodic
from hident.signals.base import ExcitationSpec
from hident.systems.linear import DiscreteSpec, LinearSpec

# Feedback stages of maximal-length shift registers (Alfke 1996, Xilinx XAPP 052).
_TAPS: dict[int, tuple[int, ...]] = {
    2: (2, 1),
    3: (3, 2),
    4: (4, 3),
    5: (5, 3),
    6: (6, 5),
    7: (7, 6),
    8: (8, 6, 5, 4),
    9: (9, 5),
    10: (10, 7),
    11: (11, 9),
    12: (12, 6, 4, 1),
    13: (13, 4, 3, 1),
    14: (14, 5, 3, 1),
    15: (15, 14),
    16: (16, 15, 13, 4),
    17: (17, 14),
    18: (18, 11),
    19: (19, 6, 2, 1),
    20: (20, 17),
}
_WHOLE = 1e-9
# A period this close to a whole number of samples, relative to it, is computed once and repeated.
_REPEATS = 1e-12
_PERIODS_SEARCHED = 10_000


Positive = Annotated[Real, Field(gt=0)]


class _Random(ExcitationSpec):
    """Base of the excitations made of independent values of one distribution."""

    distribution: Literal["uniform", "gaussian"]
    """Distribution of the values: uniform or gaussian."""
    mean: Real = 0.0
    """Mean of the values (gaussian only)."""
    std: Positive | None = None
    """Standard deviation of the values (gaussian only)."""

    def _require(self, needed: tuple[str, ...], refused: tuple[str, ...]) -> None:
        """Raise ValueError unless all ``needed`` keys and none of the ``refused`` ones are given."""
        unfit = [key for key in refused if key in self.model_fields_set]
        missing = [key for key in needed if getattr(self, key) is None]
        if unfit:
            raise ValueError(f"a {self.distribution} distribution takes no {one_of(unfit)}")
        if missing:
            raise ValueError(f"a {self.distribution} distribution needs {one_of(missing)}")

    def _draw(self, count: int, rng: np.random.Generator, interval: tuple[float, float] | None) -> Array:
        """Independent values, shape (count,); the interval is that of a uniform distribution."""
        if self.std is not None:
            return self.mean + self.std * rng.standard_normal(count)
        assert interval is not None  # by validation
        low, high = interval
        drawn = rng.random(count)
        drawn *= high - low
        drawn += low
        return drawn


@component("excitation", "iid")
class Iid(_Random):
    """Independent, identically distributed values, a new one at every sample.

    Examples
    --------
    >>> u = Iid(distribution="uniform", low=-1, high=1).sample(1000, 1.0, np.random.default_rng(1))
    >>> u.shape, bool(np.all(np.abs(u) <= 1))
    ((1000,), True)
    """

    low: Real | None = None
    """Lower limit of the values (uniform only)."""
    high: Real | None = None
    """Upper limit of the values (uniform only)."""

    @model_validator(mode="after")
    def _keys_fit_the_distribution(self) -> Self:
        if self.distribution == "gaussian":
            self._require(("std",), ("low", "high"))
        else:
            self._require(("low", "high"), ("mean", "std"))
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise ValueError(f"low must be below high, not {self.low:g} and {self.high:g}")
        return self

    def sample(self, n: int, dt: float, rng: np.random.Generator, burn_in: int = 0) -> Array:
        interval = None if self.low is None or self.high is None else (self.low, self.high)
        drawn = self._draw(burn_in + n, rng, interval)
        return np.concatenate((drawn[n:], drawn[:n]))


@component("excitation", "multistep", source="Chen, Hwang, Chang 2009, simulated examples")
class Multistep(_Random):
    """Random steps: independent levels, each held for the switching time.

    Differs from the paper: the levels may also be uniform. As there, gaussian levels beyond the limits
    are moved to them, which makes their standard deviation smaller than ``std``.

    Examples
    --------
    >>> u = Multistep(switching_time=5, std=1).sample(20, 1.0, np.random.default_rng(1))
    >>> u.shape, np.unique(u).size
    ((20,), 4)
    """

    distribution: Literal["uniform", "gaussian"] = "gaussian"
    """Distribution of the levels: gaussian, or uniform between the limits."""
    switching_time: Positive
    """Time for which a level is held, in the unit of dt; need not be a multiple of dt."""
    limits: Limits | None = None
    """Lowest and highest level [low, high]: gaussian levels are clipped (default: not; .inf: not there)."""

    @model_validator(mode="after")
    def _keys_fit_the_distribution(self) -> Self:
        if self.distribution == "gaussian":
            self._require(("std",), ())
        else:
            self._require(("limits",), ("mean", "std"))
            if not np.all(np.isfinite(self.limits or ())):
                raise ValueError("a uniform distribution needs finite limits")
        return self

    def sample(self, n: int, dt: float, rng: np.random.Generator, burn_in: int = 0) -> Array:
        step = _hold_number(_times(n, burn_in), dt, self.switching_time)
        # Steps before time 0 have negative numbers: the levels at the end, drawn last.
        return self._levels(int(step[-1] - step[0]) + 1, rng)[step]

    def waveform(self, n: int, dt: float, rng: np.random.Generator) -> Held:
        count = int(_hold_number(np.array([n - 1]), dt, self.switching_time)[0]) + 1
        return Held(np.arange(float(count)) * self.switching_time, self._levels(count, rng))

    def _levels(self, count: int, rng: np.random.Generator) -> Array:
        levels = self._draw(count, rng, self.limits)
        return levels if self.limits is None else np.clip(levels, *self.limits)


@component("excitation", "prbs", source="Golomb 1967")
class Prbs(ExcitationSpec):
    """Pseudo-random binary sequence of maximal length from a shift register with feedback.

    A period has 2^order - 1 chips, one more at the high level than at the low one.

    Examples
    --------
    >>> Prbs(order=2, start="ones").sample(6, 1.0, np.random.default_rng(1))
    array([ 1.,  1., -1.,  1.,  1., -1.])
    """

    order: Annotated[Count, Field(ge=2, le=20)]
    """Stages of the shift register (2 to 20)."""
    levels: Interval = (-1.0, 1.0)
    """The two values [low, high]."""
    clock: Annotated[Count, Field(ge=1)] = 1
    """Samples for which a chip is held."""
    start: Literal["random", "ones"] = "random"
    """Initial register: random (any but all zeros) or ones."""

    def sample(self, n: int, dt: float, rng: np.random.Generator, burn_in: int = 0) -> Array:
        state = rng.integers(1, 2**self.order) if self.start == "random" else 2**self.order - 1
        register = (state >> np.arange(self.order)) & 1
        chips = maximal_sequence(register.astype(np.uint8))
        low, high = self.levels
        return np.where(chips[_times(n, burn_in) // self.clock % len(chips)], high, low)


@component("excitation", "sine", source="Brouri, Eq. (15)")
class Sine(ExcitationSpec):
    """Sine wave: offset + amplitude sin(frequency t + phase).

    Examples
    --------
    >>> Sine(period=4, offset=2).sample(4, 1.0, np.random.default_rng(1)).round(6)
    array([2., 3., 2., 1.])
    """

    amplitude: Real = 1.0
    """Amplitude of the sine."""
    offset: Real = 0.0
    """Constant added to the sine."""
    frequency: Positive | None = None
    """Angular frequency, radians per unit of time (or give the period)."""
    period: Positive | None = None
    """Period, in the unit of dt (or give the frequency)."""
    phase: Real = 0.0
    """Phase at time 0, radians."""
    whole_periods: Flag = False
    """Refuse a record that is not a whole number of periods long."""

    @model_validator(mode="after")
    def _frequency_or_period(self) -> Self:
        if (self.frequency is None) == (self.period is None):
            found = "neither" if self.period is None else "both"
            raise ValueError(f"give exactly one of frequency and period ({found} found)")
        return self

    def check(self, n: int, dt: float) -> None:
        if self.whole_periods:
            _check_whole_periods(n, 2 * math.pi / self._frequency() / dt)

    def sample(self, n: int, dt: float, rng: np.random.Generator, burn_in: int = 0) -> Array:
        period = self.period_at(dt) / dt
        samples = nearest_whole(period, _REPEATS)
        if samples is not None:
            once = (np.arange(min(samples, burn_in + n)) - burn_in) % samples
            return np.resize(self._at(once, dt), burn_in + n)
        return self._at(_times(n, burn_in), dt)

    def _at(self, times: NDArray[np.int64], dt: float) -> Array:
        t = times * dt
        return np.asarray(self.offset + self.amplitude * np.sin(self._frequency() * t + self.phase))

    def waveform(self, n: int, dt: float, rng: np.random.Generator) -> Periodic:
        # sin(x) = Re(-j exp(j x))
        amplitude = -1j * self.amplitude * np.exp(1j * self.phase)
        return Periodic(self.period_at(dt), self.offset, np.array([1]), np.array([amplitude]))

    def period_at(self, dt: float) -> float:
        return 2 * math.pi / self._frequency() if self.period is None else self.period

    def _frequency(self) -> float:
        if self.frequency is not None:
            return self.frequency
        assert self.period is not None  # by validation
        return 2 * math.pi / self.period


@component("excitation", "staircase", source="Brouri, Eq. (9)")
class Staircase(ExcitationSpec):
    """Given levels one after the other, each held for the same time; the last one goes on.

    Examples
    --------
    >>> Staircase(levels=[0, 1], hold=2).sample(5, 1.0, np.random.default_rng(1))
    array([0., 0., 1., 1., 1.])
    """

    levels: Annotated[tuple[Real, ...], Field(min_length=1)]
    """The levels in their order."""
    hold: Positive
    """Time for which a level is held, in the unit of dt; need not be a multiple of dt."""
    initial: Real | None = None
    """Level before the record, e.g. 0 (default: the first, or nothing if the system starts from rest)."""

    def check(self, n: int, dt: float) -> None:
        last = len(self.levels) - 1
        if _hold_number(np.array([n - 1]), dt, self.hold)[0] < last:
            needed = 1 - int(whole_part(-last * self.hold / dt))
            raise ValueError(
                f"a record of {n} samples ends before the last of {last + 1} levels "
                f"(at least {needed} samples reach it)"
            )

    def sample(self, n: int, dt: float, rng: np.random.Generator, burn_in: int = 0) -> Array:
        step = _hold_number(_times(n, burn_in), dt, self.hold)
        # Number -1 stands for all that was before the record.
        levels = np.array([*self.levels, self._before()])
        return levels[np.clip(step, -1, len(self.levels) - 1)]

    def waveform(self, n: int, dt: float, rng: np.random.Generator) -> Held:
        return Held(np.arange(float(len(self.levels))) * self.hold, np.array(self.levels), self._before())

    def before(self) -> float | None:
        return self.initial

    def _before(self) -> float:
        return self.levels[0] if self.initial is None else self.initial


@component("excitation", "multisine", source="Pintelon and Schoukens 2012")
class Multisine(ExcitationSpec):
    """Sum of harmonics of one period with equal amplitudes and independent uniform phases.

        u(t) = offset + rms (2/H)^(1/2) sum_K cos(2 pi K t/P + phase_K), over H harmonics K of the period P

    Examples
    --------
    >>> u = Multisine(period=64, rms=2).sample(64, 1.0, np.random.default_rng(1))
    >>> round(float(np.std(u)), 6)
    2.0
    """

    period: Annotated[Count, Field(ge=3)]
    """Period in samples."""
    rms: Positive
    """Root mean square over a period, without the offset."""
    grid: Literal["odd", "full"] = "full"
    """Harmonics excited: full (1, 2, 3, ...) or odd (1, 3, 5, ...)."""
    highest: Annotated[Count, Field(ge=1)] | None = None
    """Highest harmonic that may be excited (default: the largest below period/2)."""
    offset: Real = 0.0
    """Constant added to the harmonics."""
    whole_periods: Flag = False
    """Refuse a record that is not a whole number of periods long."""

    @model_validator(mode="after")
    def _below_half_the_sampling_frequency(self) -> Self:
        if self.highest is not None and 2 * self.highest >= self.period:
            raise ValueError(
                f"highest must be below period/2, not {self.highest} "
                f"(allowed: 1 to {(self.period - 1) // 2} for the period {self.period})"
            )
        return self

    def check(self, n: int, dt: float) -> None:
        if self.whole_periods:
            _check_whole_periods(n, self.period)

    def sample(self, n: int, dt: float, rng: np.random.Generator, burn_in: int = 0) -> Array:
        harmonics = self._harmonics()
        phases = 2 * np.pi * rng.random(len(harmonics))
        spectrum = np.zeros(self.period // 2 + 1, dtype=complex)
        # H harmonics of amplitude A = 2 |spectrum| / period have the mean square H A^2 / 2.
        spectrum[harmonics] = self.period * self.rms / np.sqrt(2 * len(harmonics)) * np.exp(1j * phases)
        wave = np.fft.irfft(spectrum, self.period)
        return self.offset + wave[_times(n, burn_in) % self.period]

    def waveform(self, n: int, dt: float, rng: np.random.Generator) -> Periodic:
        harmonics = self._harmonics()
        phases = 2 * np.pi * rng.random(len(harmonics))
        amplitudes = self.rms * np.sqrt(2 / len(harmonics)) * np.exp(1j * phases)
        return Periodic(self.period_at(dt), self.offset, harmonics, amplitudes)

    def period_at(self, dt: float) -> float:
        return self.period * dt

    def _harmonics(self) -> NDArray[np.int64]:
        highest = self.highest or (self.period - 1) // 2
        return np.arange(1, highest + 1, 2 if self.grid == "odd" else 1)


def _discrete(linear: LinearSpec) -> LinearSpec:
    if not isinstance(linear, DiscreteSpec):
        raise ValueError(f"must be a discrete block, not {linear.kind}")
    return linear


@component("excitation", "filtered", source="Wang, Zhang, Ljung 2009, example 1")
class Filtered(ExcitationSpec):
    """Another excitation after a linear block.

    A block that starts from ``zero`` or from past outputs does so at time 0, as if nothing had come before:
    the samples before the record are those past outputs, and zero before them. A ``stationary`` block is
    driven for its burn-in beforehand; a random excitation then begins that much earlier.

    Examples
    --------
    >>> import hident as hi
    >>> steps = hi.Staircase(levels=[0, 1], hold=2)
    >>> hi.Filtered(excitation=steps, linear=hi.Fir(b=[0.5, 0.5])).sample(5, 1.0, np.random.default_rng(1))
    array([0. , 0. , 0.5, 1. , 1. ])
    """

    excitation: Annotated[ExcitationSpec, Of("excitation")]
    """The excitation that drives the block."""
    linear: Annotated[DiscreteSpec, Of("linear"), AfterValidator(_discrete)]
    """The block: its output is applied to the system."""

    def check(self, n: int, dt: float) -> None:
        if len(self.excitation.stretches(n, dt)) > 1:
            raise ValueError("cannot filter several experiments: filter the excitation of each of them")
        self.excitation.check(n, dt)

    def before(self) -> float | None:
        if self.linear.initial == "zero":
            return None
        if self.linear.initial != "stationary":
            return next(iter(self.linear.initial), None)
        driving = self.excitation.before()
        return None if driving is None else driving * self.linear.transfer_function().static_gain()

    def sample(self, n: int, dt: float, rng: np.random.Generator, burn_in: int = 0) -> Array:
        if self.linear.initial != "stationary":
            past = () if self.linear.initial == "zero" else self.linear.initial[:burn_in]
            before = np.zeros(burn_in)
            before[burn_in - len(past) :] = past[::-1]
            return np.concatenate((before, self.linear.simulate(self.excitation.sample(n, dt, rng))))
        settling = self.linear.burn_in()
        # What a random excitation draws for the time before its record depends on the length of both.
        lead = settling if _is_random(self.excitation) else 0
        driving = self.excitation.sample(lead + n, dt, rng, burn_in + settling - lead)
        parts = driving[: burn_in + settling], driving[burn_in:]
        return np.concatenate([self.linear.simulate(part)[settling:] for part in parts])


def _is_random(excitation: ExcitationSpec) -> bool:
    """Whether the excitation, or the one that it filters, is made of independent values."""
    while isinstance(excitation, Filtered):
        excitation = excitation.excitation
    return isinstance(excitation, _Random)


def maximal_sequence(register: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """One period of the maximal-length binary sequence that starts with the given bits.

    Parameters
    ----------
    register : ndarray of uint8, shape (order,)
        The first bits of the sequence, of 2 to 20 stages and not all zero.

    Returns
    -------
    ndarray of uint8, shape (2**order - 1,)

    Notes
    -----
    The sequence c(t) is the sum modulo 2 of c(t - tap) over the taps. Modulo 2 the square of a polynomial
    in the delay has the same terms with doubled delays, so c(t) is also the sum of c(t - 2^k tap). With
    the largest k that the known bits allow, each round adds a block in proportion to their number.
    """
    order = len(register)
    chips = np.empty(2**order - 1, dtype=np.uint8)
    chips[:order] = register
    known = order
    while known < len(chips):
        stride = 1 << ((known // order).bit_length() - 1)
        lags = [stride * tap for tap in _TAPS[order]]
        stop = min(known + min(lags), len(chips))
        chips[known:stop] = np.bitwise_xor.reduce([chips[known - lag : stop - lag] for lag in lags])
        known = stop
    return chips


def _times(n: int, burn_in: int) -> NDArray[np.int64]:
    """The times of the samples in units of dt, shape (burn_in + n,); the record begins at 0."""
    return np.arange(-burn_in, n, dtype=np.int64)


def _hold_number(times: NDArray[np.int64], dt: float, hold: float) -> NDArray[np.int64]:
    """The number j with j*hold <= times*dt < (j + 1)*hold, elementwise."""
    return whole_part(times * dt / hold)


def _check_whole_periods(n: int, period: float) -> None:
    """Raise ValueError unless ``n`` samples are a whole number of periods (in samples) long."""
    near = int(n / period)
    exact = period * np.arange(max(near - _PERIODS_SEARCHED, 1), near + _PERIODS_SEARCHED)
    samples = np.rint(exact)
    fitting = samples[np.abs(samples - exact) <= _WHOLE * exact].astype(int)
    if n in fitting:
        return
    nearest = [*fitting[fitting < n][-1:], *fitting[fitting > n][:1]]
    found = one_of(nearest) or "none; make the period a multiple of dt"
    raise ValueError(
        f"a record of {n} samples holds {n / period:.10g} periods of {period:.10g} samples, "
        f"not a whole number (nearest sample counts that fit: {found})"
    )
