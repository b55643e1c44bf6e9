"""The gauges as a configuration writes them: what is declared of the phases of the two blocks."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field

from hident.arrays import Array, Flags, Index
from hident.config.spec import Count, Real, Spec
from hident.estimators.frequency.frequency_gain import FrequencyGains
from hident.estimators.frequency.gauge import FrequencyGrid, Phases, bode_weights, solve_phases
from hident.estimators.frequency.rational_gauge import RationalFit, fit_rational

Positive = Annotated[Real, Field(gt=0)]


def _proper(degrees: tuple[int, int]) -> tuple[int, int]:
    m, n = degrees
    if m > n:
        raise ValueError(
            f"must be [m, n] with m <= n, not [{m}, {n}]: a block cannot differentiate its input"
        )
    return degrees


Gauged = tuple[Phases, RationalFit | None]
"""All phases, and the fit of a rational gauge."""
Degrees = Annotated[
    tuple[Annotated[Count, Field(ge=0)], Annotated[Count, Field(ge=1)]], AfterValidator(_proper)
]


class DelayFree(Spec):
    """G_i has no delay, and its phase is given at the top of each ladder of multiples."""

    kind: Literal["delay_free"]
    """The kind."""
    final_phase: Real = 0.0
    """Phase of G_i at the top of a ladder, radians; its error counts in proportion to w below."""

    def check(self, grid: FrequencyGrid) -> None:
        """Raise ValueError if a frequency stands on no ladder."""
        alone = np.setdiff1d(grid.tops, np.flatnonzero(_linked(grid)))
        if len(alone):
            raise ValueError(
                f"the gauge delay_free needs a ladder, and no harmonic of {grid.inputs[alone[0]]:g} meets "
                "one of another frequency: add frequencies such as 2 w, 4 w, 8 w"
            )

    def phases(self, found: FrequencyGains, level: float = 0.0) -> Gauged:
        """All phases; the ladder phi_i(w) = -sum_j D(2^j w)/2^(j+1), D(w) = theta_1(2 w) - theta_2(w).

        A ladder ends below its first lost rung; a phase that stands on none is nan.
        """
        seen = found.grid.where(np.isfinite(found.sums))
        tops = np.intersect1d(seen.tops, np.flatnonzero(_linked(seen)))
        return _solved(found, tops, np.full(len(tops), self.final_phase)), None


class MinimumPhase(Spec):
    """G_i has minimum phase: Bode's relation gives its phase from its gains over the band."""

    kind: Literal["minimum_phase"]
    """The kind."""

    def check(self, grid: FrequencyGrid) -> None:
        """Raise ValueError if there are fewer than two frequencies."""
        if len(grid.inputs) < 2:
            raise ValueError("the gauge minimum_phase needs two frequencies or more")

    def phases(self, found: FrequencyGains, level: float = 0.0) -> Gauged:
        """All phases."""
        n = len(found.grid.inputs)
        known = np.flatnonzero(np.isfinite(found.log_gains[:n]))
        weights = bode_weights(found.grid.inputs[known])
        covariance = weights @ found.covariance[np.ix_(known, known)] @ weights.T
        return _solved(found, known, weights @ found.log_gains[known], covariance), None


class Rational(Spec):
    """Both blocks are rational, without delay, of given orders."""

    kind: Literal["rational"]
    """The kind."""
    input: Degrees
    """Degrees [m, n] of numerator and denominator of G_i."""
    output: Degrees
    """Degrees [m, n] of numerator and denominator of G_o."""

    def check(self, grid: FrequencyGrid) -> None:
        """Raise ValueError if there are fewer gains and phase sums than coefficients."""
        data = len(grid.inputs) + len(grid.outputs) + len(grid.m)
        if data < (wanted := sum(self.input) + sum(self.output)):
            raise ValueError(f"{data} gains and phase sums do not determine {wanted} coefficients")

    def is_strictly_proper(self) -> bool:
        """Whether no block lets its input through at once, so that both can be simulated."""
        return all(m < n for m, n in (self.input, self.output))

    def names(self) -> list[str]:
        """The coefficients: input_b_1, ..., input_a_1, ..., output_b_1, ..., output_a_1, ..."""
        sides = (("input", self.input), ("output", self.output))
        return [
            f"{side}_{letter}_{j}"
            for side, degrees in sides
            for letter, degree in zip("ba", degrees, strict=True)
            for j in range(1, degree + 1)
        ]

    def phases(self, found: FrequencyGains, level: float = 0.0) -> Gauged:
        """All phases, and the fit, which is tested at the ``level``."""
        fit = fit_rational(
            found.grid,
            found.log_gains,
            found.covariance,
            found.sums,
            found.sum_errors,
            (self.input, self.output),
            level,
        )
        return fit.phases, fit


class KnownPhase(Spec):
    """The phase of G_i is known at some frequencies."""

    kind: Literal["known_phase"]
    """The kind."""
    at: Annotated[tuple[tuple[Positive, Real], ...], Field(min_length=1)]
    """Pairs [frequency, phase of G_i in radians]."""

    def check(self, grid: FrequencyGrid) -> None:
        """Raise ValueError if a phase is given at a strange frequency, or one is left open."""
        known = self._indices(grid)
        for (omega, _), m in zip(self.at, known, strict=True):
            if not math.isclose(omega, grid.inputs[m], rel_tol=1e-9):
                raise ValueError(f"a phase is given at {omega:g}, which is not among the frequencies")
        test = solve_phases(grid, np.zeros(len(grid.m)), np.ones(len(grid.m)), known, np.zeros(len(known)))
        if np.isnan(test.input).any():
            open_ = grid.inputs[np.isnan(test.input)][0]
            raise ValueError(f"the known phases leave the phase of G_i at {open_:g} open: give it there too")

    def phases(self, found: FrequencyGains, level: float = 0.0) -> Gauged:
        """All phases."""
        return _solved(found, self._indices(found.grid), np.array([phase for _, phase in self.at])), None

    def _indices(self, grid: FrequencyGrid) -> Index:
        omega = np.array([omega for omega, _ in self.at])
        return np.asarray(np.argmin(np.abs(omega[:, None] - grid.inputs), axis=1))


def _linked(grid: FrequencyGrid) -> Flags:
    """Whether a frequency (n,) shares a frequency of G_o with another one."""
    shared = np.bincount(grid.o)[grid.o] > 1
    return np.asarray(np.bincount(grid.m, weights=shared, minlength=len(grid.inputs)) > 0)


def _solved(found: FrequencyGains, known: Index, phases: Array, covariance: Array | None = None) -> Phases:
    return solve_phases(found.grid, found.sums, found.sum_errors, known, phases, covariance)


GAUGES: dict[str, type[DelayFree] | type[MinimumPhase] | type[Rational] | type[KnownPhase]] = {
    "delay_free": DelayFree,
    "minimum_phase": MinimumPhase,
    "rational": Rational,
    "known_phase": KnownPhase,
}
