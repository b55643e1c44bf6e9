"""The second stage of Brouri's method: gains, phase sums and, with a declared gauge, single phases."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, field_validator, model_validator

from hident.arrays import Array, Characteristic
from hident.config.spec import Count, Of, Real, component
from hident.config.suggest import did_you_mean, one_of
from hident.errors import EstimationError
from hident.estimators.base import CONTINUOUS, POWERS, EstimatorSpec, Experiments, require_finite, with_errors
from hident.estimators.frequency.frequency_gain import FrequencyGains, frequency_gains
from hident.estimators.frequency.gauge import AMBIGUITY, FrequencyGrid
from hident.estimators.frequency.gauges import (
    GAUGES,
    DelayFree,
    Gauged,
    KnownPhase,
    MinimumPhase,
    Rational,
)
from hident.estimators.frequency.harmonics import (
    Harmonics,
    harmonics,
    order_by_power,
    order_by_signal_to_noise,
    require_samples,
)
from hident.estimators.frequency.nonlinearity_identification import NonlinearityIdentification
from hident.estimators.frequency.sine_responses import SineResponses, match_frequencies
from hident.estimators.frequency.staircase_levels import PolynomialFit
from hident.estimators.normalisation import Normalisation, unit_static_gain
from hident.linear_blocks import ContinuousTransferFunction
from hident.records import Estimate, Held, Part, Periodic, Record
from hident.signals.experiments import LogSpaced
from hident.systems.base import Coefficients
from hident.systems.continuous_wiener_hammerstein import respond
from hident.systems.nonlinearity import Polynomial

Positive = Annotated[Real, Field(gt=0)]

# A first period that differs from the others by more than this, in standard errors and relative to the
# fluctuation of the output, is still a transient.
_STRANGE = 6.0
_TOLERATED = 1e-3


def _by_staircase(estimator: EstimatorSpec) -> EstimatorSpec:
    if not isinstance(estimator, NonlinearityIdentification):
        raise ValueError(f"must be nonlinearity_identification, not {estimator.kind}")
    return estimator


@dataclass(frozen=True)
class ContinuousResponse:
    """The response of a nonlinearity between two continuous blocks to a held input, from rest at zero."""

    first: ContinuousTransferFunction
    nonlinearity: Characteristic
    second: ContinuousTransferFunction

    def __call__(self, u: Array, dt: float) -> Array:
        held = Held(np.arange(float(len(u))) * dt, u)
        return respond(self.first, self.nonlinearity, self.second, held, len(u), dt)


@component("estimator", "frequency_gain_identification", source="Brouri, Table II, eq. (33)-(41)")
class FrequencyGainIdentification(EstimatorSpec):
    """Gains of both blocks of a Wiener-Hammerstein system, and phase sums, from sines.

        s_0 = C_0(V |Gi(jw)|)
        Y_k = C_k(V |Gi(jw)|) e^(-j (k-1) pi/2) |Go(jkw)| e^(j theta_k)
        theta_k = k arg Gi(jw) + arg Go(jkw)

    Y_k is the harmonic k of the response to x_0 + V sin(wt), C_k that of the identified polynomial.

    Values, for the frequency number m = 1, 2, ... and the harmonic k = 1, ..., order: gain_i_m = |Gi(j w_m)|,
    gain_o_m_k = |Go(j k w_m)|, phase_sum_m_k = k arg Gi(j w_m) + arg Go(j k w_m); with a gauge also
    phase_i_m and phase_o_m_k, and the coefficients of a rational one; each with its se_. Whether they fit:
    chi2 with chi2_freedom degrees of freedom, misfit (the largest residual relative to the output's
    fluctuation) and solutions (how many the data do not tell apart; of these the least gains). Of a rational
    gauge gauge_chi2, gauge_chi2_freedom and gauge_misfit (of a gain, or radians of a phase sum), and the
    response of both blocks if m < n in each. Where the
    nonlinearity is estimated, c_0, ... as they are after the sines. Orders: order_power_m by eq. (39),
    order_ac_m the same without the mean, order_snr_m by signal-to-noise; examined + 1 where none suffices.
    Of the phases: how many there are (phase_unknowns), how many sums were seen (phase_equations), their rank
    (phase_rank).

    Examples
    --------
    >>> import hident as hi
    >>> block = hi.Continuous(a=[0.5])
    >>> quadratic = hi.Polynomial(coefficients=[2, 1, 0.5])
    >>> system = hi.WienerHammerstein(input_linear=block, nonlinearity=quadratic, output_linear=block)
    >>> sines = hi.SteppedSine(frequencies=[0.5, 1], periods=4, samples_per_period=32)
    >>> record = hi.simulate(system, sines, 256, noise=hi.White(std=0.001), dt=0.1)
    >>> estimator = hi.FrequencyGainIdentification(frequencies=[0.5, 1], order=2, coefficients=[2, 1, 0.5])
    >>> round(hi.fit(estimator, record).values["gain_i_2"], 2)
    0.89
    """

    holds = ("nonlinearity", "frequencies")

    frequencies: Annotated[tuple[Positive, ...], Field(min_length=1)] | None = None
    """Angular frequencies w_1 < w_2 < ... of the sines, radians per unit of time (or give the band)."""
    band: LogSpaced | None = None
    """Frequencies at equal ratios (or list them)."""
    experiments: Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    """Names of the experiments with sines that are used (default: all of the record)."""
    order: Annotated[Count, Field(ge=1)] = 3
    """Number p of harmonics used."""
    nonlinearity: Annotated[EstimatorSpec, Of("estimator"), AfterValidator(_by_staircase)] | None = None
    """How the nonlinearity is estimated from a staircase (or give its coefficients)."""
    coefficients: Coefficients | None = None
    """Known coefficients c_0, c_1, ... of the nonlinearity for unit static gains."""
    transient: Annotated[Count, Field(ge=0)] = 0
    """Periods left out at the start of each sine."""
    threshold: Annotated[Real, Field(gt=0)] = 3.0
    """Standard errors below which a harmonic counts as lost in the noise."""
    fit_level: Annotated[Real, Field(ge=0, lt=1)] = 0.001
    """Probability that right gains, or right rational blocks, fail the test of chi^2; also needs a misfit
    above 0.001. 0: no test."""
    lost: Literal["error", "omit"] = "error"
    """What to do if gains are not determined: error, or omit (they are nan)."""
    phases: Literal["sums", "single"] = "sums"
    """Phases wanted: sums, or single, which needs a gauge."""
    gauge: DelayFree | MinimumPhase | Rational | KnownPhase | None = None
    """What is known of the phases: {kind: delay_free | minimum_phase | rational | known_phase, ...}."""
    examined: Annotated[Count, Field(ge=1)] = 8
    """Harmonics examined for the orders that are reported; fewer where a period holds too few samples."""
    epsilon: Annotated[Real, Field(gt=0, lt=100)] = 1.0
    """Percentage of the power that the order by eq. (39) may leave out."""

    @field_validator("frequencies")
    @classmethod
    def _increasing(cls, frequencies: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if frequencies is not None and any(a >= b for a, b in pairwise(frequencies)):
            raise ValueError("must increase from one to the next")
        return frequencies

    @field_validator("gauge", mode="before")
    @classmethod
    def _choose_gauge(cls, value: Any) -> Any:
        if value is None or isinstance(value, tuple(GAUGES.values())):
            return value
        kind = value.get("kind") if isinstance(value, Mapping) else value
        if not isinstance(kind, str) or kind not in GAUGES:
            near = did_you_mean(str(kind), GAUGES)
            raise ValueError(f"must be a mapping with 'kind:' (allowed: {one_of(GAUGES)}){near}")
        return GAUGES[kind].model_validate(value if isinstance(value, Mapping) else {"kind": kind})

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if (self.frequencies is None) == (self.band is None):
            found = "neither" if self.frequencies is None else "both"
            raise ValueError(f"give exactly one of frequencies and band ({found} found)")
        if (self.nonlinearity is None) == (self.coefficients is None):
            found = "neither" if self.nonlinearity is None else "both"
            raise ValueError(f"give exactly one of nonlinearity and coefficients ({found} found)")
        if self.order > self.degree:
            raise ValueError(
                f"a polynomial of degree {self.degree} has no harmonic {self.order}: lower the order or "
                "raise the degree"
            )
        if self.phases == "single" and self.gauge is None:
            raise ValueError(AMBIGUITY)
        if self.gauge is not None:
            self.gauge.check(self.grid())
        return self

    @property
    def degree(self) -> int:
        """The degree of the nonlinearity."""
        if isinstance(self.nonlinearity, NonlinearityIdentification):
            return self.nonlinearity.degree
        assert self.coefficients is not None  # by validation
        return len(self.coefficients) - 1

    def omega(self) -> Array:
        """The frequencies w_1, w_2, ..."""
        return np.array(self.band.values() if self.band is not None else self.frequencies)

    def grid(self) -> FrequencyGrid:
        """The frequencies of both blocks."""
        omega = self.omega()
        return FrequencyGrid.of(omega, [self.order] * len(omega))

    def takes_experiments(self) -> Experiments:
        return "any"

    def draws(self) -> bool:
        return False

    def names(self) -> list[str]:
        numbers = range(1, len(self.omega()) + 1)
        harmonics = [f"{m}_{k}" for m in numbers for k in range(1, self.order + 1)]
        measured = [f"gain_i_{m}" for m in numbers]
        measured += [f"{quantity}_{at}" for quantity in ("gain_o", "phase_sum") for at in harmonics]
        tests = ["chi2", "chi2_freedom", "misfit", "solutions"]
        if self.gauge is not None:
            measured += [*(f"phase_i_{m}" for m in numbers), *(f"phase_o_{at}" for at in harmonics)]
        if isinstance(self.gauge, Rational):
            measured += self.gauge.names()
            tests += ["gauge_chi2", "gauge_chi2_freedom", "gauge_misfit"]
        if self.nonlinearity is not None:
            measured += [f"c_{j}" for j in range(self.degree + 1)]
        orders = [f"order_{rule}_{m}" for rule in ("power", "ac", "snr") for m in numbers]
        ranks = ("phase_unknowns", "phase_equations", "phase_rank")
        return [*with_errors(measured), *orders, *ranks, *tests]

    def letters(self) -> Mapping[str, str]:
        return {**CONTINUOUS, "c": POWERS}

    def normalisations(self) -> tuple[Normalisation, ...]:
        rule = unit_static_gain("c input_b output_b")
        # A gauge fixes the delay that the data let move from one block to the other.
        return (replace(rule, free=rule.free | {"delay"}) if self.gauge else rule.leaving("delay"),)

    def provides(self) -> frozenset[str]:
        has_blocks = isinstance(self.gauge, Rational) and self.gauge.is_strictly_proper()
        return super().provides() | ({"response"} if has_blocks else frozenset())

    def check(self, n: int, dt: float | None) -> None:
        if dt is None:
            raise ValueError("sines in continuous time need the sampling interval 'dt' of the data")

    def check_record(self, record: Record) -> None:
        if isinstance(self.nonlinearity, NonlinearityIdentification):
            self.nonlinearity.check_record(record)
        sines = self._sines(record)
        omega = np.array([2.0 * math.pi / _wave(part).period for part in sines])
        match_frequencies(omega, _amplitudes(sines), self.omega())
        for part, frequency in zip(sines, omega, strict=True):
            require_samples(frequency, part.dt, self.order)

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        static = self._polynomial(record)
        parts = self._sines(record)
        found = [self._harmonics(part, record) for part in parts]
        offset = np.array([_wave(part).offset for part in parts])
        data = SineResponses.of(self.omega(), found, _amplitudes(parts), offset, self.order)
        gains = frequency_gains(data, static, self.threshold)
        if self.lost == "error" and gains.lost():
            raise EstimationError(gains.why_lost())
        if misfit := gains.why_misfit(self.fit_level):
            raise EstimationError(misfit)
        polynomial = Polynomial(coefficients=tuple(gains.polynomial.coefficients.tolist()))
        gauged = self.gauge.phases(gains, self.fit_level) if self.gauge is not None else None
        blocks = gauged[1].blocks() if gauged is not None and gauged[1] is not None else None
        return Estimate(
            nonlinearity=polynomial,
            frequencies=self.omega(),
            response=None if blocks is None else ContinuousResponse(blocks[0], polynomial, blocks[1]),
            values=self._values(gains, gauged, [*self._orders(found, data.m), *_ranks(gains)]),
        )

    def _values(self, gains: FrequencyGains, gauged: Gauged | None, others: list[Any]) -> dict[str, float]:
        """What was measured, with its standard errors, then the ``others``, then what tests the fits."""
        (g_i, g_o), (e_i, e_o), o = gains.gains, gains.errors, gains.grid.o
        measured = [(g_i, e_i), (g_o[o], e_o[o]), (gains.sums, gains.sum_errors)]
        others += [gains.chi2, gains.freedom, gains.misfit, gains.solutions]
        if gauged is not None:
            phases, fit = gauged
            measured += [(phases.input, phases.input_errors), (phases.output[o], phases.output_errors[o])]
            if fit is not None:
                measured.append((fit.coefficients, fit.errors))
                others += [fit.chi2, fit.freedom, fit.misfit]
        if self.nonlinearity is not None:
            measured.append((gains.polynomial.coefficients, gains.polynomial.errors))
        values, errors = zip(*measured, strict=True)
        return self.named(*values, *errors, *others)

    def _sines(self, record: Record) -> list[Part]:
        """The experiments with a sine that are used.

        Raises
        ------
        EstimationError
            If there is none, or one of those named.
        """
        sines = {name: part for name, part in record.parts.items() if _is_sine(part)}
        if not sines:
            raise EstimationError("the record has no experiment with a sine applied to a continuous system")
        for name in self.experiments or ():
            if name not in sines:
                raise EstimationError(f"the record has no experiment '{name}' with a sine")
        return [sines[name] for name in self.experiments or sines]

    def _polynomial(self, record: Record) -> PolynomialFit:
        if isinstance(self.nonlinearity, NonlinearityIdentification):
            return self.nonlinearity.staircase(record).polynomial
        c = np.array(self.coefficients)
        return PolynomialFit(c, np.zeros((len(c), len(c))))

    def _harmonics(self, part: Part, record: Record) -> Harmonics:
        """The harmonics of one sine experiment, phases relative to the sine's own."""
        wave, dt = _wave(part), part.dt
        omega = 2.0 * math.pi / wave.period
        skipped = math.ceil(self.transient * wave.period / dt * (1.0 - 1e-9))
        y = record.y[part.samples][skipped:]
        require_finite(y)
        require_samples(omega, dt, self.order)
        n = math.floor(wave.period / dt * (1.0 + 1e-9))
        # One period alone must leave an equation for the noise.
        single = len(y) < 2 * n
        most = max(min(self.examined, (n - 1 - single) // 2), self.order)
        if single and n <= 2 * most + 1:
            raise EstimationError(
                f"one period of {n} samples leaves no equation for the noise at order {self.order}: "
                "measure two periods, or more samples in each"
            )
        phase = float(np.angle(1j * wave.amplitudes[0]))
        found = harmonics(y, dt, omega, most, skipped * dt + phase / omega)
        self._require_steady(y, dt, found)
        return found

    def _require_steady(self, y: Array, dt: float, found: Harmonics) -> None:
        """Raise EstimationError if the mean of the first period is not that of all."""
        period = 2.0 * math.pi / (found.omega * dt)
        first = harmonics(y[: math.ceil(period * (1.0 - 1e-9))], dt, found.omega, len(found.values))
        away = abs(first.mean - found.mean)
        fluctuation = math.sqrt(max(found.power - found.mean**2, 0.0))
        if away > _STRANGE * found.noise / math.sqrt(period) and away > _TOLERATED * fluctuation:
            raise EstimationError(
                f"the output has not settled under the sine at {found.omega:g}: the mean of the first period "
                f"is off by {away:.3g}; leave out more periods with 'transient'"
            )

    def _orders(self, found: list[Harmonics], m: Any) -> list[int]:
        """The largest order of the experiments at each frequency, by one rule after the other."""

        def by_power(one: Harmonics, *, mean: bool) -> int:
            order = order_by_power(one, self.epsilon, mean=mean)
            return self.examined + 1 if order is None else order

        rules: list[Callable[[Harmonics], int]] = [
            lambda one: by_power(one, mean=True),
            lambda one: by_power(one, mean=False),
            lambda one: order_by_signal_to_noise(one, self.threshold),
        ]
        return [
            max(rule(one) for one, at in zip(found, m, strict=True) if at == number)
            for rule in rules
            for number in range(len(self.omega()))
        ]


def _ranks(gains: FrequencyGains) -> tuple[int, int, int]:
    """How many phases there are, how many sums of them were seen, and how many of these are independent."""
    seen = gains.grid.where(np.isfinite(gains.sums))
    equations, unknowns = seen.equations.shape
    return unknowns, equations, unknowns - seen.freedom.shape[1]


def _is_sine(part: Part) -> bool:
    return isinstance(part.waveform, Periodic) and part.waveform.harmonics.tolist() == [1]


def _wave(part: Part) -> Periodic:
    assert isinstance(part.waveform, Periodic)
    return part.waveform


def _amplitudes(sines: list[Part]) -> Array:
    return np.array([abs(_wave(part).amplitudes[0]) for part in sines])
