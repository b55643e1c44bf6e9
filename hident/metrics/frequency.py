"""Gains and phases of the two linear blocks around a nonlinearity, at the frequencies of a record's sines.

The names are those of the estimates, for the frequency number m = 1, 2, ... and the harmonic k:

    gain_i_m = |Gi(j w_m)|, gain_o_m_k = |Go(j k w_m)|, phase_i_m and phase_o_m_k their phases,
    phase_sum_m_k = k phase_i_m + phase_o_m_k, series_gain_m = gain_i_m gain_o_m_1.

Gains are relative to the static ones, and phases are continuous from zero at w = 0.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, ClassVar

import numpy as np
from pydantic import AfterValidator, Field

from hident.arrays import Array, Complex
from hident.config.spec import Count, Flag, NonEmpty, component
from hident.config.suggest import did_you_mean, one_of
from hident.linear_blocks import ContinuousTransferFunction
from hident.metrics.base import Comparing, MetricSpec, Scored
from hident.numerics.freedoms import Freedom
from hident.records import Estimate, Periodic, Record, Truth, needed
from hident.signals.base import Stretch
from hident.signals.excitation import Multisine, Sine
from hident.systems.continuous_wiener_hammerstein import ACCURACY, respond

_NAME = re.compile(r"(gain_i|phase_i|series_gain)_(\d+)|(gain_o|phase_o|phase_sum)_(\d+)_(\d+)")
_SINGLE_PHASE = re.compile(r"phase_i_\d+|phase_o_\d+_\d+")
_RANGE = re.compile(r"(\d+)\.\.(\d+)")
# Frequencies this close, relative to their size, are one.
_SAME = 1e-9
# Delays that are tried for half a turn of the fastest phase, in all at most, and steps to the best one.
_PER_TURN = 8
_MOST_DELAYS = 20_000
_REFINEMENTS = 5


def sine_frequencies(record: Record) -> Array:
    """The angular frequencies w_1 < w_2 < ... of the record's experiments with sines, shape (n,)."""
    waves = [part.waveform for part in record.parts.values()]
    return _distinct([w.period for w in waves if isinstance(w, Periodic) and w.harmonics.tolist() == [1]])


def frequencies_of(stretches: Sequence[Stretch]) -> Array:
    """The angular frequencies w_1 < w_2 < ... of the sines among experiments to come, shape (n,)."""
    return _distinct([s.excitation.period_at(s.dt) for s in stretches if isinstance(s.excitation, Sine)])


def _distinct(periods: Sequence[float]) -> Array:
    omega = np.sort([2.0 * math.pi / period for period in periods])
    return omega[np.diff(omega, prepend=0.0) > _SAME * omega]


def _check_static_gains(scored: Scored) -> None:
    """Raise ValueError if a block has no static gain, to which gains and phases are relative."""
    for place, block in scored.truth.blocks.items():
        if block.static_gain() == 0.0:
            raise ValueError(
                f"is relative to the static gains, and the system's {place}_linear has none (b_0 = 0)"
            )


def gain(block: ContinuousTransferFunction, omega: Array) -> Array:
    """|G(jw) / G(0)|, of the shape of ``omega``."""
    return np.asarray(np.abs(block.frequency_response(omega) / block.b[0]))


def phase(block: ContinuousTransferFunction, omega: Array) -> Array:
    """The phase of G(jw) / G(0) in radians, continuous from zero at w = 0, of the shape of ``omega`` (n,)."""

    def of(roots: Complex) -> Array:
        return np.asarray(np.sum(np.angle(1.0 - 1j * omega[:, None] / roots), axis=1))

    return of(block.zeros()) - of(block.poles()) - block.delay * omega


def true_response(name: str, truth: Truth, omega: float) -> float:
    """The true gain or phase of a name, given the frequency w_m that it numbers."""
    quantity, _, k = _parsed(name)
    first, second = truth.blocks["input"], truth.blocks["output"]
    at = np.array([omega])
    harmonic = k * at
    match quantity:
        case "gain_i":
            found = gain(first, at)
        case "gain_o":
            found = gain(second, harmonic)
        case "series_gain":
            found = gain(first, at) * gain(second, at)
        case "phase_i":
            found = phase(first, at)
        case "phase_o":
            found = phase(second, harmonic)
        case _:
            found = k * phase(first, at) + phase(second, harmonic)
    return float(found[0])


def _parsed(name: str) -> tuple[str, int, int]:
    """Quantity, frequency number m and harmonic k of a name."""
    found = _NAME.fullmatch(name)
    if found is None:
        raise ValueError(
            f"'{name}' is no gain or phase: write gain_i_M, gain_o_M_K, phase_i_M, phase_o_M_K, "
            "phase_sum_M_K or series_gain_M, with M..N for several frequencies"
        )
    alone, m, both, n, k = found.groups()
    return (alone, int(m), 1) if alone else (both, int(n), int(k))


def _expanded(of: tuple[str, ...]) -> tuple[str, ...]:
    """The names, each range M..N written out."""
    names: list[str] = []
    for name in of:
        span = _RANGE.search(name)
        numbers = range(int(span[1]), int(span[2]) + 1) if span else ()
        several = [_RANGE.sub(str(number), name, count=1) for number in numbers] if span else [name]
        if not several:
            raise ValueError(f"the range in '{name}' must rise")
        names += several
    for name in names:
        _parsed(name)
    return tuple(names)


class _OfResponses(MetricSpec):
    of: Annotated[tuple[str, ...], Field(min_length=1), AfterValidator(_expanded)]
    """Names such as gain_i_1, phase_o_1_2 or series_gain_1; M..N stands for several frequencies."""

    def labels(self, name: str) -> tuple[str, ...]:
        return tuple(f"{name} {value}" for value in self.of)


class _Estimated(_OfResponses):
    def needs_of_estimate(self) -> frozenset[str]:
        return frozenset(f"value {part}" for name in self.of for part in _factors(name))

    def estimates(self, estimate: Estimate) -> list[float]:
        return [_product(name, estimate.values) for name in self.of]


class _True(_OfResponses):
    def needs_of_truth(self) -> frozenset[str]:
        return frozenset({"blocks"})

    def check(self, scored: Scored) -> None:
        _check_static_gains(scored)

    def truths(self, record: Record, omega: Array) -> list[float]:
        """The true values, given the frequencies w_1, w_2, ..."""
        numbers = [_parsed(name)[1] for name in self.of]
        pairs = zip(self.of, numbers, strict=True)
        return [true_response(name, needed(record.truth), omega[m - 1]) for name, m in pairs]


def _factors(name: str) -> tuple[str, ...]:
    """The values of an estimate whose product a name is."""
    quantity, m, _ = _parsed(name)
    return (f"gain_i_{m}", f"gain_o_{m}_1") if quantity == "series_gain" else (name,)


def _product(name: str, values: Mapping[str, float]) -> float:
    return math.prod(values[factor] for factor in _factors(name))


@component("metric", "response")
class Response(_Estimated):
    """Estimated gains and phases of the two linear blocks at the frequencies of the sines.

    Examples
    --------
    >>> import hident as hi
    >>> estimate = hi.Estimate(values={"gain_i_1": 0.7, "gain_i_2": 0.5})
    >>> hi.score(estimate, hi.Record([0], [0]), found=hi.Response(of=["gain_i_1..2"]))
    {'found gain_i_1': 0.7, 'found gain_i_2': 0.5}
    """

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        return self.estimates(estimate)


@component("metric", "true_response")
class TrueResponse(_True):
    """True gains and phases of the two linear blocks at the frequencies of all the record's sines.

    Examples
    --------
    >>> import hident as hi
    >>> block = hi.Continuous(a=[1])
    >>> system = hi.WienerHammerstein(input_linear=block, nonlinearity="identity", output_linear=block)
    >>> record = hi.simulate(system, hi.Sine(frequency=1), 8, dt=0.1)
    >>> scores = hi.score(hi.Estimate(), record, true=hi.TrueResponse(of=["gain_i_1"]))
    >>> round(scores["true gain_i_1"], 3)
    0.707
    """

    def check(self, scored: Scored) -> None:
        super().check(scored)
        known = len(frequencies_of(scored.stretches()))
        for name in self.of:
            if _parsed(name)[1] > known:
                raise ValueError(f"asks for {name}, and the record has sines at {known} frequencies")

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        return self.truths(record, sine_frequencies(record))


@component("metric", "response_error")
class ResponseError(_Estimated, _True, Comparing):
    """Estimated minus true gains and phases of the two linear blocks.

    ``up_to: [delay]`` moves the delay from one block to the other that brings all phases of the estimate
    nearest to the true ones, whichever are named: no data tell the blocks' delays apart, only their sum, and
    no phase sum changes.

    Examples
    --------
    >>> import hident as hi
    >>> block = hi.Continuous(a=[1])
    >>> system = hi.WienerHammerstein(input_linear=block, nonlinearity="identity", output_linear=block)
    >>> record = hi.simulate(system, hi.Sine(frequency=1), 8, dt=0.1)
    >>> estimate = hi.Estimate(frequencies=np.array([1.0]), values={"gain_i_1": 0.8})
    >>> round(hi.score(estimate, record, error=hi.ResponseError(of=["gain_i_1"]))["error gain_i_1"], 3)
    0.093
    """

    best = "zero"
    choices: ClassVar[tuple[Freedom, ...]] = ("delay",)

    relative: Flag = False
    """In percent of the true gain or phase."""

    def compares(self) -> frozenset[str]:
        # Gains are relative to the static ones, so that no factor counts.
        return frozenset()

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        omega = needed(estimate.frequencies)
        true, errors = self.truths(record, omega), []
        tau = _moved(estimate.values, needed(record.truth), omega) if "delay" in (self.up_to or ()) else 0.0
        for name, found, at in zip(self.of, self.estimates(estimate), true, strict=True):
            error = found - at + tau * _turns(name, omega) if tau else found - at
            if _parsed(name)[0].startswith("phase"):
                error = math.remainder(error, 2.0 * math.pi)
            if self.relative:
                error = 100.0 * error / at if at else math.nan
            errors.append(error)
        return errors

    def needs_of_estimate(self) -> frozenset[str]:
        return super().needs_of_estimate() | {"frequencies"}


def _turns(name: str, omega: Array) -> float:
    """The phase that a named value gains for each unit of delay that goes from Gi to Go; zero for a gain."""
    quantity, m, k = _parsed(name)
    if quantity == "phase_i":
        return float(omega[m - 1])
    return -k * float(omega[m - 1]) if quantity == "phase_o" else 0.0


def _moved(values: Mapping[str, float], truth: Truth, omega: Array) -> float:
    """The delay that moves from Gi to Go and brings all phases among the values nearest to the true ones."""
    phases = [name for name in values if _SINGLE_PHASE.fullmatch(name)]
    true = [true_response(name, truth, omega[_parsed(name)[1] - 1]) for name in phases]
    errors = np.array([values[name] for name in phases]) - np.array(true)
    return best_delay(errors, np.array([_turns(name, omega) for name in phases]))


def best_delay(errors: Array, turns: Array) -> float:
    """The delay tau that brings errors + tau turns, both (n,), nearest to whole turns of 2 pi.

    It is sought up to half a turn of the least of the ``turns`` that are not zero, where the sum of cosines
    is greatest, and refined by least squares.

    Examples
    --------
    >>> turns = np.array([1.0, 2.0, -4.0, 0.0])
    >>> round(best_delay(np.array([-0.3, -0.6, 1.2, 0.5]), turns), 6)
    0.3
    """
    used = (turns != 0.0) & np.isfinite(errors)
    errors, turns = errors[used], turns[used]
    if not len(turns):
        return 0.0
    slowest, fastest = float(np.min(np.abs(turns))), float(np.max(np.abs(turns)))
    count = min(_PER_TURN * math.ceil(fastest / slowest), _MOST_DELAYS)
    tried = math.pi / slowest * np.arange(-count, count + 1) / count
    fits = [float(np.sum(np.cos(errors + tau * turns))) for tau in tried]
    tau = float(tried[int(np.argmax(fits))])
    for _ in range(_REFINEMENTS):
        left = np.angle(np.exp(1j * (errors + tau * turns)))
        tau -= float(left @ turns) / float(turns @ turns)
    return tau


@component("metric", "gain_shape_error")
class GainShapeError(MetricSpec):
    """Percent error of |Gi Go| over the frequencies (root mean square), a common factor apart.

    A best linear approximation knows the blocks up to a factor only. Its gains gain_K are taken at the
    harmonics of the multisines, those of sines at their own frequencies, lowest first.

    Examples
    --------
    >>> import hident as hi
    >>> block = hi.Continuous(a=[1])
    >>> system = hi.WienerHammerstein(input_linear=block, nonlinearity="identity", output_linear=block)
    >>> record = hi.simulate(system, hi.Multisine(period=64, rms=1), 64, dt=0.1)
    >>> estimate = hi.Estimate(values={"gain_1": 0.6, "gain_3": 0.1})
    >>> round(hi.score(estimate, record, shape=hi.GainShapeError(harmonics=[1, 3]))["shape"], 1)
    13.9
    """

    best = "lowest"

    harmonics: Annotated[tuple[Annotated[Count, Field(ge=1)], ...], Field(min_length=2)]
    """Harmonics K of the multisines' period; as many sines have their frequencies."""

    def needs_of_truth(self) -> frozenset[str]:
        return frozenset({"blocks"})

    def needs_of_estimate(self) -> frozenset[str]:
        return frozenset(
            f"value gain_{k} or {part}"
            for m, k in enumerate(self.harmonics, start=1)
            for part in ("frequencies", *(f"value {factor}" for factor in _factors(f"series_gain_{m}")))
        )

    def check(self, scored: Scored) -> None:
        _check_static_gains(scored)
        single = "frequencies" not in scored.provides
        if single and not any(isinstance(s.excitation, Multisine) for s in scored.stretches()):
            raise ValueError("counts the harmonics of multisines, and the record has none")

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        if estimate.frequencies is None:
            omega = np.array(self.harmonics) * _lowest_frequency(record)
            found = [estimate.values[f"gain_{k}"] for k in self.harmonics]
        else:
            omega = estimate.frequencies[: len(self.harmonics)]
            found = [_product(f"series_gain_{m}", estimate.values) for m in range(1, len(omega) + 1)]
        blocks = needed(record.truth).blocks
        away = np.log(found / (gain(blocks["input"], omega) * gain(blocks["output"], omega)))
        return (100.0 * float(np.std(away, ddof=1)),)


def _lowest_frequency(record: Record) -> float:
    """The fundamental frequency of the record's multisines."""
    waves = [part.waveform for part in record.parts.values()]
    return next(2.0 * math.pi / w.period for w in waves if isinstance(w, Periodic) and len(w.harmonics) > 1)


@component("metric", "moved_delay")
class MovedDelay(MetricSpec):
    """Largest change of the noise-free output, relative to its range, when Go's delay moves to Gi.

    A change below the accuracy of the simulation, 1e-11, is the rounding of two ways to compute one output,
    and counts as zero.

    Examples
    --------
    >>> import hident as hi
    >>> late = hi.Continuous(a=[1], delay=0.5)
    >>> system = hi.WienerHammerstein(input_linear=late, nonlinearity="identity", output_linear=late)
    >>> sine = {"name": "sine", "excitation": hi.Sine(frequency=1), "periods": 1, "samples_per_period": 16}
    >>> record = hi.simulate(system, hi.Experiments(parts=[sine]), 16, dt=0.1)
    >>> hi.score(hi.Estimate(), record, change=hi.MovedDelay(experiments=["sine"]))
    {'change sine': 0.0}
    """

    experiments: NonEmpty[str]
    """Names of experiments, one number each; a name stands for its series NAME 1, NAME 2, ... too."""

    def labels(self, name: str) -> tuple[str, ...]:
        return tuple(f"{name} {experiment}" for experiment in self.experiments)

    def needs_of_truth(self) -> frozenset[str]:
        return frozenset({"blocks", "nonlinearity"})

    def check(self, scored: Scored) -> None:
        names = [stretch.name for stretch in scored.stretches()]
        for experiment in self.experiments:
            if not any(_belongs(name, experiment) for name in names):
                near = did_you_mean(experiment, names)
                raise ValueError(
                    f"names the experiment '{experiment}', which there is not{near} "
                    f"(there are: {one_of(names)})"
                )

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        return [_change(record, needed(record.truth), name) for name in self.experiments]


def _belongs(name: str, experiment: str) -> bool:
    """Whether an experiment is the one named, or of its series."""
    return name == experiment or name.startswith(f"{experiment} ")


def _relative_change(one: Array, other: Array) -> float:
    """The largest difference relative to the range; nan where there is none."""
    moved, span = float(np.max(np.abs(one - other))), float(np.ptp(one))
    # The simulation is accurate relative to the largest line of a spectrum.
    if moved <= ACCURACY * max(span, float(np.max(np.abs(one)))):
        return 0.0
    return moved / span if span else math.nan


def _change(record: Record, truth: Truth, experiment: str) -> float:
    """The largest relative change over the experiments of a name; nan if there is none."""
    first, middle, second = truth.blocks["input"], needed(truth.nonlinearity), truth.blocks["output"]
    delayed = replace(first, delay=first.delay + second.delay), replace(second, delay=0.0)
    changes = [math.nan]
    for name, part in record.parts.items():
        if _belongs(name, experiment):
            signal = part.waveform, len(part), part.dt
            one = respond(first, middle, second, *signal)
            other = respond(delayed[0], middle, delayed[1], *signal)
            changes.append(_relative_change(one, other))
    return float(np.fmax.reduce(changes))
