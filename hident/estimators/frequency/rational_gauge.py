"""Two rational delay-free blocks fitted to gains and phase sums: the gauge that needs only their orders."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product

import numpy as np

from hident.arrays import Array, Complex, Flags
from hident.errors import EstimationError
from hident.estimators.frequency import chi_squared
from hident.estimators.frequency.gauge import FrequencyGrid, Phases
from hident.linear_blocks import ContinuousTransferFunction
from hident.numerics.choices import first_least

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

    def blocks(self) -> tuple[ContinuousTransferFunction, ContinuousTransferFunction] | None:
        """Both blocks, of static gain 1; None if one lets its input through at once (m = n)."""
        if any(len(block.b) >= len(block.a) for block in (self.input, self.output)):
            return None
        first, second = (
            ContinuousTransferFunction((1.0, *block.b.tolist()), tuple(block.a.tolist()))
            for block in (self.input, self.output)
        )
        return first, second

    @property
    def coefficients(self) -> Array:
        """b and a of the input block, then of the output block."""
        return np.concatenate([self.input.b, self.input.a, self.output.b, self.output.a])

    @property
    def errors(self) -> Array:
        """The standard errors of the coefficients."""
        first, second = self.input, self.output
        return np.concatenate([first.b_errors, first.a_errors, second.b_errors, second.a_errors])

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
class _Fit:
    """Where a fit ended, and why it did not converge."""

    parameters: Array
    chi2: float
    why_not: str


@dataclass(frozen=True, eq=False)
class _Problem:
    """Gains and phase sums to be met by parameters (b, a of G_i, then b, a of G_o), in scaled time.

    ``powers`` are those of s for G_i and G_o. ``gains`` are the rows of both blocks' gains that are used,
    with ``log_gains`` and the inverse root ``whiten`` of their covariance.
    """

    powers: tuple[Complex, Complex]
    orders: tuple[Orders, Orders]
    gains: Flags
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

    @cached_property
    def _groups(self) -> list[slice]:
        """Where the parameters b and a of G_i, then b and a of G_o, stand."""
        ends = [0, *self.split, self.size]
        return [slice(begin, end) for begin, end in pairwise(ends)]

    @cached_property
    def _rows(self) -> list[slice]:
        """Where the frequencies of G_i and G_o stand."""
        n = len(self.powers[0])
        return [slice(0, n), slice(n, n + len(self.powers[1]))]

    @cached_property
    def _columns(self) -> list[Complex]:
        """The powers of s that each of the four groups multiplies."""
        return [s[:, :size] for s, pair in zip(self.powers, self.orders, strict=True) for size in pair]

    def _polynomials(self, parameters: Array) -> list[Complex]:
        """Numerator and denominator of G_i, then of G_o, at their frequencies."""
        values = parameters.astype(complex)
        return [1.0 + s @ values[group] for s, group in zip(self._columns, self._groups, strict=True)]

    def logarithms(self, parameters: Array) -> Complex:
        """ln G of both blocks, one after the other (n + q,)."""
        b_i, a_i, b_o, a_o = self._polynomials(parameters)
        return np.concatenate((np.log(b_i) - np.log(a_i), np.log(b_o) - np.log(a_o)))

    def slopes(self, parameters: Array) -> Complex:
        """The derivative (n + q, parameters) of :meth:`logarithms`."""
        (rows_i, rows_o), groups, columns = self._rows, self._groups, self._columns
        derivative = np.zeros((rows_o.stop, self.size), dtype=complex)
        polynomials = self._polynomials(parameters)
        for rows, k in ((rows_i, 0), (rows_o, 2)):
            derivative[rows, groups[k]] = columns[k] / polynomials[k][:, None]
            derivative[rows, groups[k + 1]] = -columns[k + 1] / polynomials[k + 1][:, None]
        return derivative

    def away(self, parameters: Array) -> tuple[Array, Array]:
        """What the gains, as logarithms, and the phase sums, in radians, are off by."""
        value = self.logarithms(parameters)
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
        slope = self.slopes(parameters)
        sums = self.equations @ slope.imag / self.errors[:, None]
        return np.vstack((self.whiten @ slope.real[self.gains], sums))

    def starts(self) -> list[Array]:
        """Blocks with one multiple pole each, the most promising pairs first."""
        blocks = [[_multiple_pole(*orders, pole) for pole in _STARTS] for orders in self.orders]
        pairs = [np.concatenate(pair) for pair in product(*blocks)]
        return sorted(pairs, key=lambda start: float(np.sum(self.residuals(start) ** 2)))

    def solve(self) -> tuple[Array, float]:
        """The parameters with the least chi^2, and it.

        Raises
        ------
        EstimationError
            If no fit converges.
        """
        fits: list[_Fit] = []
        costs: list[float] = []
        for tried, start in enumerate(self.starts()):
            if tried >= _TRIED and self._is_met(min(costs)):
                break
            fits.append(fit := self._minimised(start, _TOLERANCE))
            costs.append(np.inf if fit.why_not or not np.isfinite(fit.chi2) else fit.chi2)
        if not np.any(np.isfinite(costs)):
            raise EstimationError(f"the rational blocks do not converge from any start: {fits[0].why_not}")
        best = first_least(costs)
        found = fits[best].parameters
        if self._is_met(costs[best]):
            return found, costs[best]
        finer = self._minimised(found, _FINER)
        return finer.parameters, finer.chi2

    def _is_met(self, chi2: float) -> bool:
        return chi_squared.fits(chi2, self.freedom, chi_squared.LIKELY)

    def _minimised(self, start: Array, tolerance: float) -> _Fit:
        # Half the time of least_squares with the method "lm", which calls the same code of MINPACK.
        from scipy.optimize import leastsq

        found, _, told, message, code = leastsq(
            self.residuals,
            start,
            Dfun=self.jacobian,
            full_output=True,
            xtol=tolerance,
            ftol=tolerance,
            gtol=tolerance,
            maxfev=100 * self.size,
        )
        chi2 = float(np.dot(told["fvec"], told["fvec"]))
        return _Fit(found, chi2, "" if code in (1, 2, 3, 4) else message)


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
    slope = problem.slopes(best).imag
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
