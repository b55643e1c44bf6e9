"""Records that consist of several experiments, one after the other on the same system."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from hident.arrays import Array
from hident.config.spec import Count, Of, Real, Spec, component
from hident.config.suggest import one_of
from hident.numerics.whole import nearest_whole
from hident.signals.base import MOST_SAMPLES, ExcitationSpec, Stretch
from hident.signals.excitation import Positive, Sine

AtLeastOne = Annotated[Count, Field(ge=1)]
Start = Literal["periodic", "equilibrium"]


class _Several(ExcitationSpec):
    """Base of the excitations that are several experiments."""

    def check(self, n: int, dt: float) -> None:
        stretches = self.stretches(n, dt)
        total = sum(stretch.samples for stretch in stretches)
        if n != total:
            raise ValueError(
                f"its experiments have {total} samples together: set 'samples' to {total}, not {n}"
            )
        for stretch in stretches:
            try:
                stretch.excitation.check(stretch.samples, stretch.dt)
            except ValueError as error:
                raise ValueError(f"{stretch.name}: {error}") from None

    def sample(self, n: int, dt: float, rng: np.random.Generator, burn_in: int = 0) -> Array:
        first, *others = self.stretches(n, dt)
        begun = first.excitation.sample(first.samples, first.dt, rng, burn_in)
        return np.concatenate((begun, *(s.excitation.sample(s.samples, s.dt, rng) for s in others)))


class LogSpaced(Spec):
    """All from the lowest to the highest."""

    low: Positive
    """Lowest angular frequency, radians per unit of time."""
    high: Positive
    """Highest angular frequency, radians per unit of time."""
    count: Annotated[Count, Field(ge=2, le=10_000)]
    """Number of frequencies."""

    @model_validator(mode="after")
    def _rising(self) -> Self:
        if self.low >= self.high:
            raise ValueError(f"'low' must be below 'high', not {self.low:.10g} and {self.high:.10g}")
        return self

    def values(self) -> tuple[float, ...]:
        """The frequencies in increasing order."""
        return tuple(map(float, np.geomspace(self.low, self.high, self.count)))


@component("excitation", "stepped_sine", source="Brouri, Table II")
class SteppedSine(_Several):
    """One experiment with a sine at each of several frequencies, over whole periods.

    Each has its own sampling interval, a whole fraction of its period; the experiments are named 1, 2, ...

    Examples
    --------
    >>> import hident as hi
    >>> excitation = hi.SteppedSine(frequencies=[0.5, 1], periods=2, samples_per_period=16)
    >>> [(part.name, part.samples, round(part.dt, 3)) for part in excitation.stretches(64, 1.0)]
    [('1', 32, 0.785), ('2', 32, 0.393)]
    """

    frequencies: tuple[Positive, ...] | None = None
    """Angular frequencies, radians per unit of time (or give the band)."""
    band: LogSpaced | None = None
    """Frequencies at equal ratios (or list them)."""
    amplitude: Real = 1.0
    """Amplitude of the sines."""
    offset: Real = 0.0
    """Constant added to the sines."""
    phase: Real = 0.0
    """Phase at the start of each experiment, radians."""
    periods: AtLeastOne
    """Periods of each experiment."""
    samples_per_period: Annotated[Count, Field(ge=3)]
    """Samples of each period: the sampling interval is period/samples_per_period."""
    start: Start = "periodic"
    """Start of each experiment: in the periodic steady state, or in equilibrium at the offset."""

    @model_validator(mode="after")
    def _frequencies_or_band(self) -> Self:
        if (self.frequencies is None) == (self.band is None):
            found = "neither" if self.band is None else "both"
            raise ValueError(f"give exactly one of frequencies and band ({found} found)")
        if self.frequencies == ():
            raise ValueError("'frequencies' must hold at least one")
        return self

    def chooses_start(self) -> bool:
        return self.start == "equilibrium"

    def stretches(self, n: int, dt: float) -> tuple[Stretch, ...]:
        found = []
        for i, frequency in enumerate(self._frequencies(), start=1):
            sine = Sine(amplitude=self.amplitude, offset=self.offset, frequency=frequency, phase=self.phase)
            step = sine.period_at(dt) / self.samples_per_period
            samples = self.periods * self.samples_per_period
            found.append(Stretch(str(i), sine, samples, step, self.start == "periodic"))
        return tuple(found)

    def _frequencies(self) -> tuple[float, ...]:
        if self.frequencies is not None:
            return self.frequencies
        assert self.band is not None  # by validation
        return self.band.values()


class ExperimentPart(Spec):
    """One experiment: its length is given in samples, or in periods of a periodic excitation."""

    name: Annotated[str, Field(min_length=1)]
    """Name of the experiment, by which estimators ask for it."""
    excitation: Annotated[ExcitationSpec, Of("excitation")]
    """The input signal; time 0 is the start of this experiment."""
    samples: Annotated[Count, Field(ge=1, le=MOST_SAMPLES)] | None = None
    """Length in samples (or give periods)."""
    dt: Positive | None = None
    """Its own sampling interval (default: that of the record)."""
    periods: AtLeastOne | None = None
    """Length in whole periods (or give samples)."""
    samples_per_period: Annotated[Count, Field(ge=3)] | None = None
    """Samples of each period: the sampling interval is then period/samples_per_period."""
    start: Start | None = None
    """Start: periodic (steady state; default of sine and multisine) or equilibrium (before the signal)."""
    repetitions: AtLeastOne = 1
    """Times that it is made, with new random numbers each time; several are named NAME 1, NAME 2, ..."""

    @model_validator(mode="after")
    def _keys_fit(self) -> Self:
        excitation = self.excitation
        periodic = excitation.period_at(1.0) is not None
        if isinstance(excitation, Experiments):
            raise ValueError("an experiment cannot consist of experiments: write its parts here")
        if isinstance(excitation, _Several):
            keys = ("samples", "dt", "periods", "samples_per_period", "start", "repetitions")
            self._refuse(keys, excitation.kind)
            return self
        if (self.samples is None) == (self.periods is None):
            found = "neither" if self.samples is None else "both"
            raise ValueError(f"give exactly one of samples and periods ({found} found)")
        if not periodic:
            self._refuse(("periods", "samples_per_period"), excitation.kind)
            if self.start == "periodic":
                raise ValueError(
                    f"start: periodic needs a periodic excitation (sine, multisine), not {excitation.kind}"
                )
        if self.samples_per_period is not None:
            if self.periods is None or self.dt is not None:
                raise ValueError("samples_per_period needs periods, and takes the place of dt")
            if excitation.period_at(1.0) != excitation.period_at(2.0):
                raise ValueError(
                    f"the period of {excitation.kind} is given in samples: leave out samples_per_period"
                )
        return self

    def _refuse(self, keys: tuple[str, ...], kind: str) -> None:
        if unfit := [key for key in keys if key in self.model_fields_set]:
            raise ValueError(f"the excitation {kind} takes no {one_of(unfit)} here")

    def stretches(self, dt: float) -> tuple[Stretch, ...]:
        """The experiments that the part stands for, given the record's sampling interval."""
        if isinstance(self.excitation, _Several):
            return tuple(
                replace(stretch, name=f"{self.name} {stretch.name}")
                for stretch in self.excitation.stretches(0, dt)
            )
        samples, step = self._grid(dt)
        several = self.repetitions > 1
        names = [f"{self.name} {i}" for i in range(1, self.repetitions + 1)] if several else [self.name]
        settled = self.start != "equilibrium"
        return tuple(Stretch(name, self.excitation, samples, step, settled) for name in names)

    def _grid(self, dt: float) -> tuple[int, float]:
        """Number of samples and sampling interval."""
        step = self.dt or dt
        if self.samples is not None:
            return self.samples, step
        period = self.excitation.period_at(step)
        assert period is not None and self.periods is not None  # by validation
        if self.samples_per_period is not None:
            return self.periods * self.samples_per_period, period / self.samples_per_period
        samples = nearest_whole(period / step)
        if samples is None:
            raise ValueError(
                f"{self.name}: the period {period:.10g} holds {period / step:.10g} samples at dt = {step:g}, "
                "not a whole number: give samples_per_period"
            )
        return self.periods * samples, step


@component("excitation", "experiments", source="Brouri, Tables I and II")
class Experiments(_Several):
    """Several experiments on the same system, one after the other in one record.

    Each starts anew, from its own steady state. Noise is added to the record as a whole, so that coloured
    noise runs on from one experiment into the next. Estimators that look back in time keep the experiments
    apart, and leave the first samples of each out as they do those of a record.

    Examples
    --------
    >>> import hident as hi
    >>> stairs = {"name": "stairs", "excitation": hi.Staircase(levels=[0, 1], hold=2), "samples": 4}
    >>> sine = {"name": "sine", "excitation": hi.Sine(period=8), "periods": 2, "samples_per_period": 16}
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Fir(b=[1]))
    >>> record = hi.simulate(system, hi.Experiments(parts=[stairs, sine]), 36, dt=1)
    >>> {name: (len(part), part.dt) for name, part in record.parts.items()}
    {'stairs': (4, 1.0), 'sine': (32, 0.5)}
    """

    parts: tuple[ExperimentPart, ...]
    """The experiments in their order."""

    @field_validator("parts")
    @classmethod
    def _names_differ(cls, parts: tuple[ExperimentPart, ...]) -> tuple[ExperimentPart, ...]:
        if not parts:
            raise ValueError("must hold at least one experiment")
        counts = Counter(part.name for part in parts)
        if twice := [name for name, count in counts.items() if count > 1]:
            raise ValueError(f"the names of the parts must differ: {one_of(twice)} stands twice")
        return parts

    def chooses_start(self) -> bool:
        return any(part.start is not None or part.excitation.chooses_start() for part in self.parts)

    def stretches(self, n: int, dt: float) -> tuple[Stretch, ...]:
        return tuple(stretch for part in self.parts for stretch in part.stretches(dt))
