"""The phases of the two linear blocks: what the data determine of them, and what must be declared.

A sine of frequency w through G_i, f, G_o determines the sums theta_k(w) = k phi_i(w) + phi_o(k w) only,
Brouri, eq. (32b). They stay the same under phi_i(w) -> phi_i(w) - tau w, phi_o(w) -> phi_o(w) + tau w: as f
has no memory, (G_i e^(-s tau), f, G_o e^(s tau)) has the same output for every input. A *gauge* is a declared
property of G_i that fixes tau. Differs from the paper, which takes the equations at w, 2w, 3w as solvable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hident.arrays import Array, Flags, Index
from hident.errors import EstimationError

AMBIGUITY = """\
the phases of the two blocks cannot be told apart, only the sums k arg Gi(jw) + arg Go(jkw):
the nonlinearity has no memory, so a delay moves freely from one block to the other at the same output.
Ask for the sums (phase_sum_m_k), or declare a gauge: delay_free, minimum_phase, rational or known_phase."""

# Frequencies this close, relative to their size, are one.
_SAME = 1e-9
_NULL = 1e-9


@dataclass(frozen=True, eq=False)
class FrequencyGrid:
    """Frequencies w_1 < ... < w_n of G_i, and those of G_o at which their harmonics lie.

    ``m``, ``k`` and ``o`` (E,) name the harmonics: of ``inputs[m]``, of order k, at ``outputs[o]``.
    """

    inputs: Array
    outputs: Array
    m: Index
    k: Index
    o: Index

    @classmethod
    def of(cls, frequencies: Array, orders: Sequence[int]) -> FrequencyGrid:
        """The grid of increasing ``frequencies`` (n,), each with its harmonics 1 to ``orders[m]``."""
        m = np.repeat(np.arange(len(frequencies)), orders)
        k = np.concatenate([np.arange(1, order + 1) for order in orders])
        at = k * frequencies[m]
        rank = np.argsort(at)
        new = np.diff(at[rank], prepend=0.0) > _SAME * at[rank]
        o = np.empty(len(at), dtype=np.intp)
        o[rank] = np.cumsum(new) - 1
        return cls(frequencies, at[rank][new], m, k, o)

    def where(self, seen: Flags) -> FrequencyGrid:
        """The same frequencies with the harmonics that are ``seen`` (E,) only."""
        return replace(self, m=self.m[seen], k=self.k[seen], o=self.o[seen])

    @cached_property
    def equations(self) -> Array:
        """The matrix (E, n + q) that takes phi_i (n,), phi_o (q,) to the phase sums theta (E,)."""
        n, count = len(self.inputs), len(self.m)
        matrix = np.zeros((count, n + len(self.outputs)))
        matrix[np.arange(count), self.m] = self.k
        matrix[np.arange(count), n + self.o] = 1.0
        return matrix

    @cached_property
    def freedom(self) -> Array:
        """An orthonormal basis (n + q, d) of the phases that leave all sums as they are; d is at least 1."""
        return null_space(self.equations)

    @cached_property
    def tops(self) -> Index:
        """The highest frequencies of G_i whose phases, once declared, determine all others."""
        basis, found = self.freedom, []
        for m in reversed(range(len(self.inputs))):
            row = basis[m]
            if np.linalg.norm(row) > _NULL:
                found.append(m)
                basis = basis @ null_space(row[None])
        return np.array(found[::-1], dtype=np.intp)


def null_space(matrix: Array) -> Array:
    """An orthonormal basis (columns, d) of the null space of ``matrix`` (rows, columns)."""
    _, singular, right = np.linalg.svd(matrix)
    rank = int(np.count_nonzero(singular > _NULL * np.max(singular, initial=0.0)))
    return np.asarray(right[rank:].T)


@dataclass(frozen=True, eq=False)
class Phases:
    """Phases of G_i (n,) and of G_o (q,) in radians, with standard errors; nan where undetermined."""

    input: Array
    output: Array
    input_errors: Array
    output_errors: Array


def solve_phases(
    grid: FrequencyGrid,
    sums: Array,
    errors: Array,
    known: Index,
    phases: Array,
    covariance: Array | None = None,
) -> Phases:
    """All phases from the sums and declared phases of G_i, by weighted least squares.

    Parameters
    ----------
    grid : FrequencyGrid
    sums, errors : array, shape (E,)
        Phase sums in radians and their standard errors; nan where there is none.
    known : array of int, shape (r,)
        The frequencies at which the phase of G_i is declared.
    phases, covariance : array, shapes (r,) and (r, r)
        The declared phases and their covariance; without it they are exact.

    Returns
    -------
    Phases
        nan where the declared phases and the sums leave a phase open.
    """
    covariance = np.zeros((len(phases), len(phases))) if covariance is None else covariance
    used = np.isfinite(sums) & np.isfinite(errors)
    n, total = len(grid.inputs), grid.equations.shape[1]
    free = np.setdiff1d(np.arange(total), known)
    weights = 1.0 / np.maximum(errors[used], np.finfo(float).tiny ** 0.25)
    equations = grid.equations[used]
    matrix = equations[:, free]
    open_ = np.any(np.abs(null_space(matrix)) > _NULL, axis=1)
    inverse = np.linalg.pinv(matrix * weights[:, None]) * weights
    through = -inverse @ equations[:, known]
    estimates, variances = np.empty(total), np.empty(total)
    estimates[known], variances[known] = phases, np.diag(covariance)
    estimates[free] = inverse @ sums[used] + through @ phases
    variances[free] = np.sum((inverse * errors[used]) ** 2, axis=1) + np.einsum(
        "ij,jk,ik->i", through, covariance, through
    )
    estimates[free[open_]] = variances[free[open_]] = np.nan
    deviations = np.sqrt(variances)
    return Phases(estimates[:n], estimates[n:], deviations[:n], deviations[n:])


def unwrap_along(grid: FrequencyGrid, sums: Array) -> Array:
    """Phase sums (E,) made continuous in w for each order, from zero at w = 0; nan stays."""
    unwrapped = sums.copy()
    for k in np.unique(grid.k):
        rows = np.flatnonzero((grid.k == k) & np.isfinite(sums))
        unwrapped[rows] = np.unwrap(np.concatenate(([0.0], sums[rows])))[1:]
    return unwrapped


def bode_weights(frequencies: Array) -> Array:
    """The matrix (n, n) that takes ln |G| at ``frequencies`` (n,) to the phases of a minimum-phase G.

    ln |G| is taken as piecewise linear in ln w, zero from a tenth of the lowest frequency down (unit static
    gain), and with the slope between the last two frequencies beyond the highest.

    Raises
    ------
    EstimationError
        If there are fewer than two frequencies.

    Notes
    -----
    Bode's relation, arg G(jw) = (1/pi) int (d ln|G| / dx) ln coth(|x - ln w| / 2) dx, integrated exactly.
    """
    if len(frequencies) < 2:
        raise EstimationError("the minimum-phase gauge needs gains at two frequencies or more")
    x = np.log(frequencies)
    nodes = np.concatenate(([x[0] - np.log(10.0)], x))
    kernel = _coth_integral(nodes - x[:, None])  # at w (row) up to the node (column)
    steps = np.diff(kernel, axis=1)
    steps[:, -1] = np.pi**2 / 4.0 - kernel[:, -2]  # the last slope goes on
    slopes = np.diff(np.eye(len(nodes))[:, 1:], axis=0) / np.diff(nodes)[:, None]
    return np.asarray(steps @ slopes / np.pi)


def _coth_integral(u: Array) -> Array:
    """int_0^u ln coth(|v| / 2) dv = sign(u) (pi^2/4 - Li_2(e) + Li_2(-e)), e = exp(-|u|)."""
    from scipy.special import spence

    e = np.exp(-np.abs(u))
    return np.asarray(np.sign(u) * (np.pi**2 / 4.0 - spence(1.0 - e) + spence(1.0 + e)))
