"""Two rational delay-free blocks fitted to gains and phase sums: the gauge that needs only their orders."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hident.arrays import Array
from hident.errors import EstimationError
from hident.estimators.frequency import chi_squared
from hident.estimators.frequency.gauge import FrequencyGrid, Phases
from hident.numerics.choices import first_least

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

Complex = NDArray[np.complex128]
Orders = tuple[int, int]
"""Degrees (m, n) of a block's numerator and denominator."""

# Poles to start from, relative to the geometric mean of the frequencies. So many of the pairs are tried in
# any case, and the others as long as none fits: blocks with zeros have many local minima.
_STARTS = np.geomspace(0.03, 30.0, 13)
_TRIED = 4
# Relative to chi^2: next to nothing in standard errors, unless the blocks do not fit.
_TOLERANCE = 1e-8
_FINER = 1e-11


@dataclass(frozen=True, eq=False)
class RationalBlock:
    """(1 + b_1 s + ... + b_m s^m) / (1 + a_1 s + ... + a_n s^n), with standard errors."""

    b: Array
    a: Array
    b_errors: Array
    a_errors: Array

    def phase(self, omega: Array) -> Array:
        """The phase at ``omega`` (n,), continuous from zero at w = 0."""
        return _phase(self.b, omega) - _phase(self.a, omega)


def _phase(coefficients: Array, omega: Array) -> Array:
    roots = np.roots([*coefficients[::-1], 1.0])
    return np.asarray(np.sum(np.angle(1.0 - 1j * omega[:, None] / roots), axis=1))


@dataclass(frozen=True, eq=False)
class RationalFit:
    """Both blocks and their phases at the grid's frequencies.

    ``chi2`` is the sum of the squared residuals in standard errors, ``freedom`` their number less that of the
    coefficients. ``misfit`` is the largest residual: of ln |G|, or of a phase sum in radians.
    """

    input: RationalBlock
    output: RationalBlock
    phases: Phases
    chi2: float
    freedom: int
    misfit: float

    def why_misfit(self, level: float) -> str:
        """What to say if chi^2 is above what right blocks exceed with probability ``level``; else empty."""
        large = chi_squared.why_too_large(self.chi2, self.freedom, self.misfit, level)
        if not large:
            return ""
        return (
            f"the rational blocks do not fit the gains and phase sums: {large} of a gain or radians of a "
            "phase sum. The degrees [m, n] of a block are too low, or a block has a delay: raise the "
            "degrees, or declare another gauge; 'fit_level: 0' shows the estimate all the same"
        )


@dataclass(frozen=True, eq=False)
class _Problem:
    """Gains and phase sums to be met by parameters (b, a of G_i, then b, a of G_o), in scaled time.

    ``powers`` are those of s for G_i and G_o. ``gains`` are the rows of both blocks' gains that are used,
    with ``log_gains`` and the inverse root ``whiten`` of their covariance.
    """

    powers: tuple[Complex, Complex]
    orders: tuple[Orders, Orders]
    gains: NDArray[np.bool_]
    log_gains: Array
    whiten: Array
    equations: Array
    sums: Array
    errors: Array

    @property
    def size(self) -> int:
        return sum(map(sum, self.orders))

    @property
    def split(self) -> list[int]:
        """Where the four groups of parameters meet."""
        (m_i, n_i), (m_o, _) = self.orders
        return [m_i, m_i + n_i, m_i + n_i + m_o]

    def logarithms(self, parameters: Array) -> tuple[Complex, Complex]:
        """ln G of both blocks, one after the other (n + q,), and its derivative (n + q, parameters)."""
        values, slopes = [], []
        b_i, a_i, b_o, a_o = np.split(parameters, self.split)
        for s, b, a in zip(self.powers, (b_i, b_o), (a_i, a_o), strict=True):
            above, below = 1.0 + s[:, : len(b)] @ b, 1.0 + s[:, : len(a)] @ a
            values.append(np.log(above) - np.log(below))
            slopes.append(np.hstack((s[:, : len(b)] / above[:, None], -s[:, : len(a)] / below[:, None])))
        derivative = np.zeros((sum(map(len, values)), self.size), dtype=complex)
        rows, columns = slopes[0].shape
        derivative[:rows, :columns], derivative[rows:, columns:] = slopes
        return np.concatenate(values), derivative

    def away(self, parameters: Array) -> tuple[Array, Array]:
        """What the gains, as logarithms, and the phase sums, in radians, are off by."""
        value, _ = self.logarithms(parameters)
        sums = self.equations @ value.imag - self.sums
        # Phases are compared on the circle.
        return value.real[self.gains] - self.log_gains, np.angle(np.exp(1j * sums))

    def residuals(self, parameters: Array) -> Array:
        gains, sums = self.away(parameters)
        return np.concatenate((self.whiten @ gains, sums / self.errors))

    @property
    def freedom(self) -> int:
        """The number of data less that of parameters."""
        return len(self.log_gains) + len(self.sums) - self.size

    def jacobian(self, parameters: Array) -> Array:
        _, slope = self.logarithms(parameters)
        sums = self.equations @ slope.imag / self.errors[:, None]
        return np.vstack((self.whiten @ slope.real[self.gains], sums))

    def starts(self) -> list[Array]:
        """Blocks with one multiple pole each, the most promising pairs first."""
        pairs = [
            np.concatenate(
                [_multiple_pole(*orders, pole) for orders, pole in zip(self.orders, poles, strict=True)]
            )
            for poles in product(_STARTS, repeat=2)
        ]
        return sorted(pairs, key=lambda start: float(np.sum(self.residuals(start) ** 2)))

    def solve(self) -> tuple[Array, float]:
        """The parameters with the least chi^2, and it.

        Raises
        ------
        EstimationError
            If no fit converges.
        """
        fits: list[OptimizeResult] = []
        costs: list[float] = []
        for tried, start in enumerate(self.starts()):
            if tried >= _TRIED and self._is_met(min(costs)):
                break
            fits.append(fit := self._minimised(start, _TOLERANCE))
            costs.append(2.0 * float(fit.cost) if fit.success and np.isfinite(fit.cost) else np.inf)
        if not np.any(np.isfinite(costs)):
            raise EstimationError(f"the rational blocks do not converge from any start: {fits[0].message}")
        best = first_least(costs)
        found: Array = fits[best].x
        if self._is_met(costs[best]):
            return found, costs[best]
        finer = self._minimised(found, _FINER)
        return finer.x, 2.0 * float(finer.cost)

    def _is_met(self, chi2: float) -> bool:
        return chi_squared.fits(chi2, self.freedom, chi_squared.LIKELY)

    def _minimised(self, start: Array, tolerance: float) -> OptimizeResult:
        from scipy.optimize import least_squares

        return least_squares(
            self.residuals,
            start,
            self.jacobian,
            method="lm",
            x_scale="jac",
            xtol=tolerance,
            ftol=tolerance,
            gtol=tolerance,
        )


def _multiple_pole(zeros: int, poles: int, at: float) -> Array:
    """b = 0 and the a of 1 / (1 + s / at)^poles."""
    return np.concatenate((np.zeros(zeros), np.poly(np.full(poles, -1.0 / at))[1:]))


def fit_rational(
    grid: FrequencyGrid,
    log_gains: Array,
    covariance: Array,
    sums: Array,
    errors: Array,
    orders: tuple[Orders, Orders],
    level: float = 0.0,
) -> RationalFit:
    """G_i and G_o of given orders, and their phases at the grid's frequencies.

    Parameters
    ----------
    grid : FrequencyGrid
    log_gains, covariance : array, shapes (n + q,) and (n + q, n + q)
        ln |G_i| and then ln |G_o| with their covariance; nan where a gain is not known.
    sums, errors : array, shape (E,)
        Phase sums in radians and their standard errors; nan where there is none.
    orders : pair of (m, n)
        Degrees of numerator and denominator of G_i and of G_o.
    level : float
        Probability that right blocks fail the test of chi^2; 0 for no test.

    Raises
    ------
    EstimationError
        If there are fewer data than coefficients, no fit converges, the best one fails the test, or the
        blocks are unstable.

    Notes
    -----
    Not in the paper. Levenberg and Marquardt from several starts, with unit static gains and no delay.
    """
    unit = float(np.exp(np.mean(np.log(grid.outputs))))
    highest = np.arange(1, max(map(max, orders)) + 1)
    known, used = np.isfinite(log_gains), np.isfinite(sums) & np.isfinite(errors)
    s_i, s_o = (np.asarray((1j * omega[:, None] / unit) ** highest) for omega in (grid.inputs, grid.outputs))
    problem = _Problem(
        (s_i, s_o),
        orders,
        known,
        log_gains[known],
        np.linalg.inv(np.linalg.cholesky(covariance[np.ix_(known, known)])),
        grid.equations[used],
        sums[used],
        errors[used],
    )
    if problem.freedom < 0:
        raise EstimationError(
            f"{problem.freedom + problem.size} gains and phase sums do not determine the {problem.size} "
            "coefficients of both blocks"
        )
    best, chi2 = problem.solve()
    root = np.linalg.pinv(problem.jacobian(best))
    spread = root @ root.T
    scale = unit ** -np.concatenate([np.arange(1, size + 1) for pair in orders for size in pair])
    b_i, a_i, b_o, a_o = np.split(best * scale, problem.split)
    s_b_i, s_a_i, s_b_o, s_a_o = np.split(np.sqrt(np.diag(spread)) * scale, problem.split)
    first, second = RationalBlock(b_i, a_i, s_b_i, s_a_i), RationalBlock(b_o, a_o, s_b_o, s_a_o)
    slope = problem.logarithms(best)[1].imag
    deviations = np.sqrt(np.einsum("ij,jk,ik->i", slope, spread, slope))
    n = len(grid.inputs)
    phases = Phases(first.phase(grid.inputs), second.phase(grid.outputs), deviations[:n], deviations[n:])
    misfit = float(np.max(np.abs(np.concatenate(problem.away(best)))))
    fit = RationalFit(first, second, phases, chi2, problem.freedom, misfit)
    if why := fit.why_misfit(level):
        raise EstimationError(why)
    for side, block in (("input", first), ("output", second)):
        _require_stable(side, block)
    return fit


def _require_stable(side: str, block: RationalBlock) -> None:
    poles = np.roots([*block.a[::-1], 1.0])
    if np.any(poles.real >= 0.0):
        raise EstimationError(f"the rational {side} block comes out unstable: lower its order")
