"""Two rational delay-free blocks fitted to gains and phase sums: the gauge that needs only their orders."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from hident.arrays import Array
from hident.errors import EstimationError
from hident.estimators.frequency.gauge import FrequencyGrid, Phases
from hident.numerics.choices import first_least

Complex = NDArray[np.complex128]
Orders = tuple[int, int]
"""Degrees (m, n) of a block's numerator and denominator."""

# Poles to start from, relative to the geometric mean of the frequencies, and how many of the pairs are tried.
_STARTS = np.geomspace(0.03, 30.0, 13)
_TRIED = 4


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

    def residuals(self, parameters: Array) -> Array:
        value, _ = self.logarithms(parameters)
        away = self.equations @ value.imag - self.sums
        around = np.angle(np.exp(1j * away))  # phases are compared on the circle
        gains = self.whiten @ (value.real[self.gains] - self.log_gains)
        return np.concatenate((gains, around / self.errors))

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
        return sorted(pairs, key=lambda start: float(np.sum(self.residuals(start) ** 2)))[:_TRIED]


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
) -> tuple[RationalBlock, RationalBlock, Phases]:
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

    Raises
    ------
    EstimationError
        If there are fewer data than coefficients, no fit converges, or the blocks are unstable.

    Notes
    -----
    Not in the paper. Levenberg and Marquardt from several starts, with unit static gains and no delay.
    """
    from scipy.optimize import least_squares

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
    data = int(np.count_nonzero(known) + np.count_nonzero(used))
    if data < problem.size:
        raise EstimationError(
            f"{data} gains and phase sums do not determine the {problem.size} coefficients of both blocks"
        )
    fits = [
        least_squares(problem.residuals, start, problem.jacobian, method="lm", x_scale="jac")
        for start in problem.starts()
    ]
    if not any(fit.success and np.isfinite(fit.cost) for fit in fits):
        raise EstimationError(f"the rational blocks do not converge from any start: {fits[0].message}")
    best = fits[first_least([fit.cost if fit.success else np.inf for fit in fits])].x
    root = np.linalg.pinv(problem.jacobian(best))
    spread = root @ root.T
    scale = unit ** -np.concatenate([np.arange(1, size + 1) for pair in orders for size in pair])
    b_i, a_i, b_o, a_o = np.split(best * scale, problem.split)
    s_b_i, s_a_i, s_b_o, s_a_o = np.split(np.sqrt(np.diag(spread)) * scale, problem.split)
    first, second = RationalBlock(b_i, a_i, s_b_i, s_a_i), RationalBlock(b_o, a_o, s_b_o, s_a_o)
    for side, block in (("input", first), ("output", second)):
        _require_stable(side, block)
    slope = problem.logarithms(best)[1].imag
    deviations = np.sqrt(np.einsum("ij,jk,ik->i", slope, spread, slope))
    n = len(grid.inputs)
    phases = Phases(first.phase(grid.inputs), second.phase(grid.outputs), deviations[:n], deviations[n:])
    return first, second, phases


def _require_stable(side: str, block: RationalBlock) -> None:
    poles = np.roots([*block.a[::-1], 1.0])
    if np.any(poles.real >= 0.0):
        raise EstimationError(f"the rational {side} block comes out unstable: lower its order")
