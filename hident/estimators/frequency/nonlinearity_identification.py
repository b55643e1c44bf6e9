"""The first stage of Brouri's method: a polynomial through the settled outputs of a staircase."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from hident.arrays import Array, Flags
from hident.config.spec import Count, Flag, Interval, Real, component
from hident.errors import EstimationError
from hident.estimators.base import POWERS, EstimatorSpec, Experiments, require_finite, with_errors
from hident.estimators.frequency.staircase_levels import (
    Levels,
    PolynomialFit,
    fit_polynomial,
    level_bounds,
    rise_time,
    settled_levels,
)
from hident.estimators.normalisation import Normalisation, unit_static_gain
from hident.records import Estimate, Held, Part, Record
from hident.systems.nonlinearity import Polynomial


@dataclass(frozen=True, eq=False)
class Staircase:
    """What a staircase tells: the settled outputs at the abscissas ``x`` (n,), the polynomial through them,
    rise time and hold in rise times.
    """

    x: Array
    levels: Levels
    polynomial: PolynomialFit
    rise_time: float
    hold: float


@component("estimator", "nonlinearity_identification", source="Brouri, Table I, eq. (5)-(10)")
class NonlinearityIdentification(EstimatorSpec):
    """Polynomial through the outputs that settle under a staircase (unit static gains).

        y_l = c_0 + c_1 u_l + ... + c_p u_l^p,    y_l the mean output once the level u_l has settled

    Values: c_0, ..., c_degree with se_c_j; ``noise`` (standard deviation), ``rise_time`` (90 %, at the
    largest step), ``hold`` (the shortest level, in rise times) and ``drift`` (the largest drift between the
    last two quarters of a level, in standard errors).

    Examples
    --------
    >>> import hident as hi
    >>> block = hi.Continuous(a=[0.5])
    >>> quadratic = hi.Polynomial(coefficients=[2, 1, 0.5])
    >>> system = hi.WienerHammerstein(input_linear=block, nonlinearity=quadratic, output_linear=block)
    >>> stairs = hi.Staircase(levels=[-1, 0, 1], hold=20)
    >>> record = hi.simulate(system, stairs, 600, noise=hi.White(std=0.01), dt=0.1)
    >>> found = hi.fit(hi.NonlinearityIdentification(degree=2), record)
    >>> [round(found.values[name], 1) for name in ("c_0", "c_1", "c_2")]
    [2.0, 1.0, 0.5]
    """

    holds = ("nonlinearity",)

    degree: Annotated[Count, Field(ge=1)] = 3
    """Degree of the polynomial; as many distinct levels plus one are needed."""
    between: Interval | None = None
    """Only levels from low to high, ends included, count for the polynomial (default: all)."""
    discard: Annotated[Real, Field(ge=0, lt=1)] = 0.5
    """Part of each level left out as transient, 0 to below 1; 0 averages the whole level, as printed."""
    require_steady: Flag = True
    """Fail if the output still drifts in the second half of a level, or if that cannot be told."""
    least_hold: Annotated[Real, Field(ge=0)] = 3.0
    """Rise times that each level must be held, so that a drift hidden by noise cannot be large."""
    threshold: Annotated[Real, Field(gt=0)] = 5.0
    """Standard errors beyond which a drift, or a change of the output, is not noise."""
    tolerance: Annotated[Real, Field(ge=0)] = 1e-3
    """Drift that is tolerated in any case, relative to the range of the settled outputs."""
    experiment: str | None = None
    """Name of the experiment with the staircase (default: the only one with a held input)."""

    def takes_experiments(self) -> Experiments:
        return "any"

    def draws(self) -> bool:
        return False

    def names(self) -> list[str]:
        coefficients = [f"c_{j}" for j in range(self.degree + 1)]
        return [*with_errors(coefficients), "noise", "rise_time", "hold", "drift"]

    def fewest_samples(self) -> int:
        return 8 * (self.degree + 1)

    def letters(self) -> Mapping[str, str]:
        return {"c": POWERS}

    def normalisations(self) -> tuple[Normalisation, ...]:
        return (unit_static_gain("c"),)

    def check_record(self, record: Record) -> None:
        x = _levels_of(self._part(record))
        distinct = len(np.unique(x[self._counted(x)]))
        if distinct <= self.degree:
            raise EstimationError(
                f"{distinct} distinct levels do not determine the {self.degree + 1} coefficients of degree "
                f"{self.degree}"
            )

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        found = self.staircase(record)
        levels, c = found.levels, found.polynomial.coefficients
        drift = np.abs(levels.drift) / np.where(levels.drift_error > 0.0, levels.drift_error, np.inf)
        measured = levels.noise, found.rise_time, found.hold, np.max(drift)
        return Estimate(
            nonlinearity=Polynomial(coefficients=tuple(c.tolist())),
            values=self.named(c, found.polynomial.errors, *measured),
            details={"staircase": found},
        )

    def staircase(self, record: Record) -> Staircase:
        """What the record's staircase tells.

        Raises
        ------
        EstimationError
            If there is none, the output has not settled or does not depend on the level, or there are too few
            levels.
        """
        part = self._part(record)
        x, y = _levels_of(part), record.y[part.samples]
        require_finite(y)
        assert isinstance(part.waveform, Held)
        bounds = level_bounds(part.waveform.times, len(part), part.dt)
        levels = settled_levels(y, bounds, self.discard)
        if np.ptp(levels.values) <= self.threshold * np.max(levels.errors):
            raise EstimationError(
                "the output settles at the same value at all levels: the static gain of a block is zero"
            )
        unsettled = levels.unsettled(self.threshold, self.tolerance)
        if self.require_steady and len(unsettled):
            j = int(unsettled[np.argmax(np.abs(levels.drift[unsettled]))])
            raise EstimationError(
                f"the output has not settled at level {j + 1} of {len(x)}: it moves by {levels.drift[j]:.3g} "
                "from the third to the last quarter; hold the levels longer"
            )
        counted = self._counted(x)
        fit = fit_polynomial(x[counted], levels.values[counted], levels.errors[counted], self.degree)
        step = int(np.argmax(np.abs(np.diff(levels.values)))) + 1
        rise = rise_time(
            y[bounds[step] : bounds[step + 1]], part.dt, levels.values[step - 1], levels.values[step]
        )
        shortest = part.dt * float(np.min(np.diff(bounds)))
        hold = shortest / rise if rise else math.inf
        if self.require_steady and hold < self.least_hold:
            raise EstimationError(
                f"the shortest level is held {shortest:.3g}, {hold:.2g} rise times of {rise:.3g}: too short "
                f"to settle; hold each at least {self.least_hold * rise:.3g}"
            )
        return Staircase(x, levels, fit, rise, hold)

    def _counted(self, x: Array) -> Flags:
        """Which of the abscissas ``x`` (n,) count for the polynomial."""
        low, high = self.between or (-math.inf, math.inf)
        return (low <= x) & (x <= high)

    def _part(self, record: Record) -> Part:
        held = {name: part for name, part in record.parts.items() if isinstance(part.waveform, Held)}
        if self.experiment is not None and self.experiment not in held:
            raise EstimationError(f"the record has no experiment '{self.experiment}' with a held input")
        chosen = [held[self.experiment]] if self.experiment is not None else [*held.values()]
        if len(chosen) != 1:
            raise EstimationError(
                f"the record has {len(chosen)} experiments with a held input, and one is needed: a staircase "
                "applied to a continuous system; name it with 'experiment' if there are several"
            )
        return chosen[0]


def _levels_of(part: Part) -> Array:
    assert isinstance(part.waveform, Held)
    return part.waveform.levels
