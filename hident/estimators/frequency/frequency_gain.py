"""The gains of both linear blocks of a Wiener-Hammerstein system from its responses to sines.

A sine x_0 + V sin(w t) gives the harmonics (see :mod:`hident.estimators.frequency.harmonic_map`)

    s_0 = C_0(V g_i(w)),    Y_k = C_k(V g_i(w)) e^(-j (k - 1) pi/2) g_o(k w) e^(j theta_k(w)),

with g = |G|, theta_k(w) = k phi_i(w) + phi_o(k w) and the C_k of the identified polynomial. At one frequency
s_1, ..., s_p are p equations for p + 1 gains: s_0 closes the set.

Where the nonlinearity is not monotone s_0 may have several roots in g_i. So the fit starts from all local
minima of a search at each frequency, the solution with the least chi^2 is taken (of equal ones that with the
least gains), and its chi^2 is tested against its degrees of freedom.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from hident.arrays import Array, Complex, Flags
from hident.errors import EstimationError
from hident.estimators.frequency import chi_squared
from hident.estimators.frequency.gauge import FrequencyGrid, null_space, unwrap_along
from hident.estimators.frequency.harmonic_map import harmonic_matrix, harmonic_matrix_slope
from hident.estimators.frequency.sine_responses import SineResponses
from hident.estimators.frequency.staircase_levels import PolynomialFit
from hident.numerics.choices import ROUNDING, TIE, first_least

# Gains among which the start is searched.
_GAINS = np.geomspace(1e-4, 30.0, 600)
# Up to so many combinations of the minima at the frequencies are all tried.
_COMBINATIONS = 8
# A start from which more evaluations do not lead to a minimum runs along the valley of vanishing |G_i|.
_EVALUATIONS = 200
# Solutions this close in ln |G_i| are one.
_SAME = 1e-6
# The data tell two solutions apart if their chi^2 differ by four standard errors squared.
_SEPARATE = 16.0
_NULL = 1e-7
_TOLERANCE = 1e-11


@dataclass(frozen=True, eq=False)
class FrequencyGains:
    """Gains and phase sums; nan where the data do not determine them.

    ``log_gains`` (n + q,) holds ln |G_i| and then ln |G_o|, ``covariance`` (n + q, n + q) belongs to it.
    ``sums`` and ``sum_errors`` (n p,) are the phase sums theta_k(w_m) in radians, k running fastest.
    ``weak`` (n, p + 1) marks the harmonics 0, ..., p that are lost in the noise at each frequency.

    ``chi2`` is the sum of the squared residuals in standard errors (means, harmonics along their phases,
    prior knowledge of c), ``freedom`` their number less that of the parameters. ``misfit`` is the largest
    residual relative to the fluctuation of the output. ``solutions`` counts the solutions met that the data
    do not tell from this one (1: this one alone): their chi^2 is larger by less than 16.
    """

    grid: FrequencyGrid
    log_gains: Array
    covariance: Array
    sums: Array
    sum_errors: Array
    polynomial: PolynomialFit
    weak: Flags
    chi2: float
    freedom: int
    misfit: float
    solutions: int

    def why_misfit(self, level: float) -> str:
        """What to say if chi^2 is above what a right model exceeds with probability ``level``; else empty."""
        large = chi_squared.why_too_large(self.chi2, self.freedom, self.misfit, level)
        if not large:
            return ""
        return (
            f"the gains do not fit the sines: {large} of the output's "
            "fluctuation. The degree is too low for the range of the sines, the output has not settled, or "
            "its noise is not white: raise the degree, lower the amplitudes V or leave out more periods; "
            "'fit_level: 0' shows the estimate all the same"
        )

    @property
    def gains(self) -> tuple[Array, Array]:
        """|G_i| (n,) and |G_o| (q,)."""
        return self._split(np.exp(self.log_gains))

    @property
    def errors(self) -> tuple[Array, Array]:
        """The standard errors of :attr:`gains`."""
        return self._split(np.exp(self.log_gains) * np.sqrt(np.diag(self.covariance)))

    def _split(self, both: Array) -> tuple[Array, Array]:
        n = len(self.grid.inputs)
        return both[:n], both[n:]

    def lost(self) -> list[str]:
        """The gains that the data do not determine, in words."""
        inputs, outputs = map(np.isnan, self._split(self.log_gains))
        return [f"|Gi(j {w:g})|" for w in self.grid.inputs[inputs]] + [
            f"|Go(j {w:g})|" for w in self.grid.outputs[outputs]
        ]

    def why_lost(self) -> str:
        """Which gains are lost, why, and what to do; empty if none is."""
        lost = self.lost()
        if not lost:
            return ""
        m = int(np.argmax(self._touched()))
        weak = self.weak[m]
        orders = ", ".join(map(str, np.flatnonzero(weak))) or "none"
        shape = ""
        if np.array_equal(weak, np.arange(len(weak)) % 2 == 0):
            shape = "; the nonlinearity looks odd about the offset"
        elif np.array_equal(weak, np.arange(len(weak)) % 2 == 1):
            shape = "; the nonlinearity looks even about the offset"
        return (
            f"the data do not determine {', '.join(lost)} (harmonics lost in the noise at the frequency "
            f"{self.grid.inputs[m]:g}: {orders}{shape}): choose an offset x0 other than 0, several "
            "amplitudes V, or a lower order"
        )

    def _touched(self) -> Flags:
        """The frequencies (n,) at which a gain is lost."""
        inputs, outputs = map(np.isnan, self._split(self.log_gains))
        touched = inputs.copy()
        touched[self.grid.m[outputs[self.grid.o]]] = True
        return touched


def frequency_gains(data: SineResponses, polynomial: PolynomialFit, threshold: float = 3.0) -> FrequencyGains:
    """Gains of both blocks and phase sums by joint least squares over all experiments.

    Parameters
    ----------
    data : SineResponses
        Any number of amplitudes and offsets at each frequency.
    polynomial : PolynomialFit
        The nonlinearity for unit static gains. Where its covariance is not zero, its coefficients are
        estimated anew with it as prior knowledge, so that all standard errors include theirs.
    threshold : float
        A harmonic below this many standard errors counts as lost; of the mean, s_0 - f(x_0) is judged.

    Raises
    ------
    EstimationError
        If no least-squares fit converges.

    Notes
    -----
    Brouri, Table II, eq. (41), (44a). Differs from the paper: s_0 is used, and all equations together; the
    s_k are signed by the C_k, where (44a) has minus signs against s_k >= 0; all roots of s_0 are tried.
    """
    visible = _visible(data, polynomial, threshold)
    problem = _Problem(data, polynomial, visible)
    minima = _search(data, polynomial)
    lost = problem.lost(problem.start(np.array([deepest[0] for deepest in minima])))
    # A lost gain stays at its start, so one start is enough.
    found = _solutions(
        problem, [one[:1] if gone else one for one, gone in zip(minima, lost, strict=False)], lost
    )
    chi2 = np.array([solution.chi2 for solution in found])
    solution = found[first_least(chi2, scale=chi_squared.EQUAL / ROUNDING)]
    x, covariance = solution.x, solution.covariance
    sums, errors = problem.phase_sums(x)
    c = len(x) - len(polynomial.coefficients)
    return FrequencyGains(
        data.grid,
        np.where(lost, np.nan, x[:c]),
        np.where(lost | lost[:, None], np.nan, covariance[:c, :c]),
        unwrap_along(data.grid, sums),
        errors,
        PolynomialFit(x[c:], covariance[c:, c:]),
        data.summed(visible.astype(float)) == 0.0,
        solution.chi2,
        solution.freedom,
        problem.misfit(x, lost),
        int(np.count_nonzero(chi2 < solution.chi2 + _SEPARATE)),
    )


def _visible(data: SineResponses, polynomial: PolynomialFit, threshold: float) -> Flags:
    """The harmonics 0, ..., p that stand out of the noise, shape (E, p + 1)."""
    powers = data.offset[:, None] ** np.arange(len(polynomial.coefficients))
    moved = np.abs(data.mean - powers @ polynomial.coefficients)
    spread = np.hypot(
        data.mean_error, np.sqrt(np.einsum("ei,ij,ej->e", powers, polynomial.covariance, powers))
    )
    signal = np.column_stack((moved, np.abs(data.values)))
    return np.asarray(signal > threshold * np.column_stack((spread, data.error)))


@dataclass(frozen=True, eq=False)
class _Solution:
    """The parameters with their covariance, chi^2 and its degrees of freedom."""

    x: Array
    covariance: Array
    chi2: float
    freedom: int

    def fits(self, level: float) -> bool:
        """Whether chi^2 is below what a right model exceeds with the probability ``level``, or next to 0."""
        return chi_squared.fits(self.chi2, self.freedom, level)


def _solutions(problem: _Problem, minima: Sequence[Array], lost: Flags) -> list[_Solution]:
    """The different solutions from the ``minima`` at the frequencies, those with the least gains first.

    Where they have too many combinations, one frequency after the other takes its best minimum, until chi^2
    is as small as that of a right model or no other minimum is better.

    Raises
    ------
    EstimationError
        If no fit converges.
    """
    found: list[_Solution] = []
    refused: list[EstimationError] = []

    def tried(log_inputs: Sequence[float]) -> _Solution | None:
        try:
            solution = problem.solve(problem.start(np.array(log_inputs)), lost)
        except EstimationError as error:
            refused.append(error)
            return None
        if not any(np.max(np.abs(solution.x - one.x)[: len(minima)]) < _SAME for one in found):
            found.append(solution)
        return solution

    if math.prod(map(len, minima)) <= _COMBINATIONS:
        for log_inputs in product(*minima):
            tried(log_inputs)
    else:
        _exchange(tried, minima)
    if not found:
        raise refused[0]
    # With |G_i| towards zero the model becomes linear, and any |G_i| |G_o| suits: no solution of its own.
    ends, kept = np.log(_GAINS[[0, -1]]), ~lost[: len(minima)]
    inside = [one for one in found if _within(one.x[: len(minima)][kept], *ends)]
    found = inside or found
    return sorted(found, key=lambda solution: float(np.sum(solution.x[: len(minima)])))


def _within(x: Array, low: float, high: float) -> bool:
    return bool(np.all((low <= x) & (x <= high)))


def _exchange(tried: Callable[[Sequence[float]], _Solution | None], minima: Sequence[Array]) -> None:
    """Try the minima at one frequency after the other, and keep the best, until it fits or none is better."""
    at, better = [float(one[0]) for one in minima], True
    best = tried(at)
    while better:
        better = False
        for m, others in enumerate(minima):
            for other in others:
                if best is not None and best.fits(chi_squared.LIKELY):
                    return
                solution = tried([*at[:m], float(other), *at[m + 1 :]]) if other != at[m] else None
                if solution is not None and (best is None or solution.chi2 < best.chi2 - chi_squared.EQUAL):
                    at[m], best, better = float(other), solution, True


def _search(data: SineResponses, polynomial: PolynomialFit) -> list[Array]:
    """The local minima ln |G_i|, the deepest first, of a search at each frequency, the best G_o put in."""
    c = polynomial.coefficients
    matrix = harmonic_matrix(data.amplitude[:, None] * _GAINS, data.offset[:, None], len(c) - 1)
    level = matrix[..., 0, :]
    spread = data.mean_error[:, None] ** 2 + np.einsum("egi,ij,egj->eg", level, polynomial.covariance, level)
    model = level @ c
    # What lies between two gains of the search is no misfit.
    miss = np.maximum(np.abs(data.mean[:, None] - model) - 0.5 * np.abs(np.gradient(model, axis=1)), 0.0)
    # Far outside the staircase the polynomial explains any mean: a likelihood counts that against it.
    cost = miss**2 / spread + np.log(spread)
    amplitudes = (matrix @ c)[..., 1 : data.order + 1] / data.error[:, None]
    values = (data.values / data.error)[:, None]
    explained = np.abs(data.summed(amplitudes * values)) ** 2
    total, size = data.summed(np.abs(values) ** 2), data.summed(amplitudes**2)
    left = total - np.divide(explained, size, out=np.zeros_like(explained), where=size > 0.0)
    return [_minima(row, len(c) - 1) for row in data.summed(cost) + left.sum(axis=-1)]


def _minima(cost: Array, most: int) -> Array:
    """ln of the gains at up to ``most`` local minima of ``cost`` over _GAINS, the deepest first.

    The ends are none, and neither are the ripples of rounding where |G_i| is too small to matter.
    """
    deepest, within = first_least(cost), cost[1:-1]
    local = (within < cost[:-2] - TIE * np.abs(within)) & (within <= cost[2:])
    others = sorted(set((1 + np.flatnonzero(local)).tolist()) - {deepest}, key=lambda i: float(cost[i]))
    return np.asarray(np.log(_GAINS[[deepest, *others[: most - 1]]]))


@dataclass(frozen=True, eq=False)
class _Problem:
    """The least-squares problem for x = (ln g_i, ln g_o, c).

    Rows: the means (E,), the harmonics (E p,) turned to the real axis, the prior knowledge of c.
    """

    data: SineResponses
    polynomial: PolynomialFit
    visible: Flags

    @cached_property
    def degree(self) -> int:
        return len(self.polynomial.coefficients) - 1

    @cached_property
    def root(self) -> Array | None:
        """The inverse root of the covariance of c; None if c is known exactly."""
        covariance = self.polynomial.covariance
        return np.linalg.inv(np.linalg.cholesky(covariance)) if np.any(covariance) else None

    @cached_property
    def sizes(self) -> tuple[int, int]:
        return len(self.data.grid.inputs), len(self.data.grid.outputs)

    def parts(self, x: Array) -> tuple[Array, Array, Array]:
        n, q = self.sizes
        return np.exp(x[:n]), np.exp(x[n : n + q]), x[n + q :]

    def harmonics(self, x: Array) -> tuple[Array, Array, Array]:
        """C_0, ..., C_p (E, p + 1), their derivatives by ln g_i, and by c (E, p + 1, d + 1)."""
        data = self.data
        g_i, _, c = self.parts(x)
        reach = data.amplitude * g_i[data.m]
        matrix = harmonic_matrix(reach, data.offset, self.degree)[:, : data.order + 1]
        slope = harmonic_matrix_slope(reach, data.offset, self.degree)[:, : data.order + 1]
        return matrix @ c, reach[:, None] * (slope @ c), matrix

    def turns(self, x: Array) -> Complex:
        """sum C_k g_o Y_k / sigma_k^2 over the experiments at each frequency (n, p): its phase is theta."""
        data = self.data
        _, g_o, _ = self.parts(x)
        model = self.harmonics(x)[0][:, 1:] * g_o[data.output]
        return np.asarray(data.summed(self.visible[:, 1:] * model * data.values / data.error**2))

    def residuals(self, x: Array) -> Array:
        data = self.data
        _, g_o, c = self.parts(x)
        levels = self.harmonics(x)[0]
        # The part across the estimated phase tells of phases only, to first order.
        along = (data.values * np.exp(-1j * np.angle(self.turns(x)))[data.m]).real
        harmonics = self.visible[:, 1:] * (levels[:, 1:] * g_o[data.output] - along) / data.error
        rows = [(levels[:, 0] - data.mean) / data.mean_error, harmonics.ravel()]
        if self.root is not None:
            rows.append(self.root @ (c - self.polynomial.coefficients))
        return np.concatenate(rows)

    def jacobian(self, x: Array) -> Array:
        data = self.data
        n, q = self.sizes
        _, g_o, _ = self.parts(x)
        levels, slopes, matrix = self.harmonics(x)
        # The mean takes the part of k = 0, whose "g_o" is one.
        size = np.column_stack((1.0 / data.mean_error, self.visible[:, 1:] * g_o[data.output] / data.error))
        experiments, count = size.shape
        row, column = np.ogrid[:experiments, :count]
        found = np.zeros((experiments, count, n + q + self.degree + 1))
        found[row, column, data.m[:, None]] = slopes * size
        found[row, column[:, 1:], n + data.output] = (levels * size)[:, 1:]
        found[..., n + q :] = matrix * size[..., None]
        rows = [found[:, 0], found[:, 1:].reshape(experiments * data.order, -1)]
        if self.root is not None:
            rows.append(np.hstack((np.zeros((self.degree + 1, n + q)), self.root)))
        return np.vstack(rows)

    def lost(self, x: Array) -> Flags:
        """The gains (n + q,) that the visible harmonics leave open."""
        n, q = self.sizes
        jacobian = self.jacobian(x)[: self.visible.size, : n + q]
        jacobian[: len(self.visible)] *= self.visible[:, :1]
        size = np.linalg.norm(jacobian, axis=1, keepdims=True)
        scaled = np.divide(jacobian, size, out=np.zeros_like(jacobian), where=size > 0.0)
        return np.asarray(np.any(np.abs(null_space(scaled)) > _NULL, axis=1))

    def determined(self, lost: Flags) -> Flags:
        """The rows of means and harmonics without lost gains, and those of the prior knowledge."""
        n, _ = self.sizes
        mean = ~lost[:n][self.data.m]
        harmonics = self.visible[:, 1:] & mean[:, None] & ~lost[n:][self.data.output]
        prior = np.full(0 if self.root is None else self.degree + 1, True)
        return np.concatenate((mean, harmonics.ravel(), prior))

    def best_outputs(self, x: Array) -> Array:
        """g_o (q,) that suits the other parameters; 1 where no harmonic tells."""
        data = self.data
        level = self.visible[:, 1:] * self.harmonics(x)[0][:, 1:] / data.error
        size, both = data.summed(level**2), np.abs(data.summed(level * data.values / data.error))
        total, weight = np.zeros(self.sizes[1]), np.zeros(self.sizes[1])
        np.add.at(total, data.grid.o, both.ravel())
        np.add.at(weight, data.grid.o, size.ravel())
        return np.divide(total, weight, out=np.ones_like(total), where=(weight > 0.0) & (total > 0.0))

    def start(self, log_inputs: Array) -> Array:
        """x from ln |G_i| (n,)."""
        n, q = self.sizes
        x = np.concatenate((log_inputs, np.zeros(q), self.polynomial.coefficients))
        x[n : n + q] = np.log(self.best_outputs(x))
        return x

    def misfit(self, x: Array, lost: Flags) -> float:
        """The largest residual of the data, or of c as known before, relative to the output's fluctuation."""
        data = self.data
        _, g_o, c = self.parts(x)
        levels, _, matrix = self.harmonics(x)
        gain = np.column_stack((np.ones(len(levels)), g_o[data.output]))
        along = (data.values * np.exp(-1j * np.angle(self.turns(x)))[data.m]).real
        measured = np.column_stack((data.mean, along))
        rows = self.determined(lost)[: measured.size]
        # The rows of the means stand before those of the harmonics.
        used = np.column_stack((rows[: len(levels)], rows[len(levels) :].reshape(along.shape)))
        away = np.abs(levels * gain - measured)
        moved = np.abs(matrix @ (c - self.polynomial.coefficients) * gain)
        fluctuation = math.sqrt(0.5 * float(np.max(np.sum(np.abs(data.values) ** 2, axis=1))))
        largest = float(np.max(np.maximum(away, moved), initial=0.0, where=used))
        return largest / fluctuation if fluctuation else 0.0

    def solve(self, start: Array, lost: Flags) -> _Solution:
        """The solution from ``start``; lost gains, and a c known exactly, stay as they are with no variance.

        Raises
        ------
        EstimationError
            If the fit does not converge.
        """
        from scipy.optimize import least_squares

        free = np.concatenate((~lost, np.full(self.degree + 1, self.root is not None)))
        rows = self.determined(lost)

        def whole(part: Array) -> Array:
            x = start.copy()
            x[free] = part
            return x

        def jacobian(part: Array) -> Array:
            return np.asarray(self.jacobian(whole(part))[np.ix_(rows, free)])

        covariance, freedom = np.zeros((len(start), len(start))), int(rows.sum() - free.sum())
        if not free.any():
            return _Solution(start, covariance, float(np.sum(self.residuals(start)[rows] ** 2)), freedom)
        # A start far from any solution may run off.
        with np.errstate(over="ignore", invalid="ignore"):
            fit = least_squares(
                lambda part: self.residuals(whole(part))[rows],
                start[free],
                jacobian,
                method="lm",
                x_scale="jac",
                xtol=_TOLERANCE,
                ftol=_TOLERANCE,
                gtol=_TOLERANCE,
                max_nfev=_EVALUATIONS,
            )
        if not (fit.success and np.all(np.isfinite(fit.x)) and np.isfinite(fit.cost)):
            raise EstimationError(f"the gains do not converge: {fit.message}")
        slopes = jacobian(fit.x)
        size = np.linalg.norm(slopes, axis=0)
        root = np.linalg.pinv(slopes / size) / size[:, None]
        covariance[np.ix_(free, free)] = root @ root.T
        return _Solution(whole(fit.x), covariance, 2.0 * float(fit.cost), freedom)

    def phase_sums(self, x: Array) -> tuple[Array, Array]:
        """theta (n p,) in (-pi, pi] and its standard errors; nan where no harmonic is seen."""
        data = self.data
        _, g_o, _ = self.parts(x)
        model = self.harmonics(x)[0][:, 1:] * g_o[data.output]
        precision = data.summed(self.visible[:, 1:] * (model / data.error) ** 2).ravel()
        seen = precision > 0.0
        sums, errors = np.full(seen.shape, np.nan), np.full(seen.shape, np.nan)
        sums[seen], errors[seen] = np.angle(self.turns(x)).ravel()[seen], precision[seen] ** -0.5
        return sums, errors
