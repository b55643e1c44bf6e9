"""Fourier coefficients of a periodic output in white noise, and the order at which to stop.

The output is y(t) = s_0 + sum_k s_k sin(k w t + phi_k) + xi(t), Brouri, eq. (27). One complex number holds
amplitude and phase of a harmonic: Y_k = s_k e^(j phi_k) = b_k + j a_k with a_k, b_k of eq. (36), so that the
phase is always in the right quadrant, which the printed arctan(a_k / b_k) is not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hident.arrays import Array, Complex, Index
from hident.errors import EstimationError

# A period this close to a whole number of samples, relative to its length, is one.
_WHOLE = 1e-9


@dataclass(frozen=True, eq=False)
class Harmonics:
    """The harmonics of a periodic output at the angular frequency ``omega``.

    ``mean`` is s_0; ``values`` (p,) are Y_1, ..., Y_p. ``mean_error`` is the standard error of s_0 and
    ``error`` that of the real and of the imaginary part of each Y_k. ``power`` is the mean square of y, and
    ``noise`` the standard deviation of xi.
    """

    omega: float
    mean: float
    values: Complex
    mean_error: float
    error: float
    power: float
    noise: float

    @property
    def amplitudes(self) -> Array:
        """s_1, ..., s_p, eq. (35a)."""
        return np.abs(self.values)


def samples_per_period(omega: float, dt: float) -> int | None:
    """The samples in a period; None if the period is no multiple of the sampling interval."""
    period = 2.0 * math.pi / (omega * dt)
    whole = round(period)
    return whole if whole > 0 and abs(period - whole) <= _WHOLE * period else None


def harmonics(y: Array, dt: float, omega: float, order: int, start: float = 0.0) -> Harmonics:
    """The first ``order`` harmonics of an output in steady state.

    Parameters
    ----------
    y : array, shape (N,)
        The output in steady state; what follows its last whole period is not used.
    dt, omega : float
        Sampling interval and angular frequency, radians per unit of time.
    order : int
        Number p of harmonics.
    start : float
        The time of the first sample; phases refer to time 0.

    Returns
    -------
    Harmonics
        By averaging over whole periods where a period has a whole number of samples, else by least squares.

    Raises
    ------
    EstimationError
        If a period holds fewer than 2 p + 1 samples, or the record no whole period.

    Notes
    -----
    Brouri, eq. (33), (35), (36).
    """
    require_samples(omega, dt, order)
    period = 2.0 * math.pi / (omega * dt)
    periods = math.floor(len(y) / period * (1.0 + _WHOLE))
    if periods == 0:
        raise EstimationError(
            f"the record of {len(y)} samples holds no whole period at {omega:g} rad per unit of time "
            f"({math.ceil(period * (1.0 - _WHOLE))} samples)"
        )
    n = samples_per_period(omega, dt)
    if n is None:
        found = _by_least_squares(y[: math.floor(periods * period)], dt, omega, order)
    else:
        found = _by_averaging(y[: periods * n].reshape(periods, n), omega, order)
    return replace(found, values=found.values * np.exp(-1j * omega * start * np.arange(1, order + 1)))


def require_samples(omega: float, dt: float, order: int) -> None:
    """Raise EstimationError if a period holds fewer than 2 p + 1 samples."""
    period = 2.0 * math.pi / (omega * dt)
    if period * (1.0 + _WHOLE) < 2 * order + 1:
        raise EstimationError(
            f"a period at {omega:g} rad per unit of time has {period:.4g} samples: {order} harmonics need at "
            f"least {2 * order + 1}; sample faster or lower the order"
        )


def _by_averaging(y: Array, omega: float, order: int) -> Harmonics:
    """The harmonics of M periods (M, n) of n samples each."""
    periods, n = y.shape
    average = y.mean(axis=0)  # Eq. (33)
    at = np.outer(np.arange(1, order + 1), np.arange(n)) % n
    turn = 2.0 * np.pi / n * np.arange(n)
    sines, cosines = np.sin(turn)[at], np.cos(turn)[at]
    values = 2.0 / n * (sines @ average + 1j * (cosines @ average))  # Eq. (36)
    mean = float(average.mean())
    if periods > 1:
        # What differs between periods is noise, however many harmonics there are.
        around = y - average
        freedom = (periods - 1) * n
    else:
        around = average - mean - (values.imag @ cosines + values.real @ sines)
        freedom = n - 2 * order - 1
    variance = float(np.vdot(around, around)) / freedom if freedom else math.nan
    mean_error = math.sqrt(variance / y.size)
    return Harmonics(
        omega,
        mean,
        values,
        mean_error,
        math.sqrt(2.0) * mean_error,
        float(np.vdot(y, y)) / y.size,
        math.sqrt(variance),
    )


def _by_least_squares(y: Array, dt: float, omega: float, order: int) -> Harmonics:
    """The harmonics of N samples (N,), whatever the period."""
    n = len(y)
    turn = omega * dt
    projections = _projections(y, turn, order)
    # The regressors 1, cos(k w t), sin(k w t) have inner products that are geometric sums.
    sums = _sums(turn, np.arange(-order, 2 * order + 1), n)
    k = np.arange(order + 1)
    minus, plus = sums[k[:, None] - k + order], sums[k[:, None] + k + order]
    cosines, sines = 0.5 * (plus + minus).real, 0.5 * (minus - plus).real
    crossed = 0.5 * (plus - minus).imag[:, 1:]
    gram = np.block([[cosines, crossed], [crossed.T, sines[1:, 1:]]])
    onto = np.concatenate((projections.real, projections.imag[1:]))
    inverse = np.linalg.inv(gram)
    found = inverse @ onto
    power = float(np.vdot(y, y))
    freedom = n - 2 * order - 1
    variance = max(power - float(found @ onto), 0.0) / freedom if freedom else math.nan
    spread = np.diag(inverse)
    return Harmonics(
        omega,
        float(found[0]),
        found[order + 1 :] + 1j * found[1 : order + 1],
        math.sqrt(variance * spread[0]),
        math.sqrt(variance * float(np.max(spread[1:], initial=0.0))),
        power / n,
        math.sqrt(variance),
    )


def _projections(y: Array, turn: float, order: int) -> Complex:
    """sum_t y_t e^(j k turn t) for k = 0, ..., order, with exponentials for one block of samples only."""
    k = np.arange(order + 1)
    size = max(math.isqrt(len(y)), 1)
    blocks = len(y) // size
    within = np.exp(1j * turn * np.outer(np.arange(size), k))
    parts = y[: blocks * size].reshape(blocks, size) @ np.hstack((within.real, within.imag))
    first = np.exp(1j * turn * size * np.outer(np.arange(blocks + 1), k))
    rest = y[blocks * size :]
    total = np.sum(first[:blocks] * (parts[:, : order + 1] + 1j * parts[:, order + 1 :]), axis=0)
    return np.asarray(total + first[blocks] * (rest @ within[: len(rest)]))


def _sums(turn: float, k: Index, n: int) -> Complex:
    """sum_{t=0}^{n-1} e^(j k turn t)."""
    half = 0.5 * turn * k
    ratio = np.divide(np.sin(n * half), np.sin(half), out=np.full(len(k), float(n)), where=k != 0)
    return np.asarray(ratio * np.exp(1j * (n - 1) * half))


def order_by_power(found: Harmonics, epsilon: float, *, mean: bool = True) -> int | None:
    """The lowest order whose harmonics hold all but ``epsilon`` percent of the power; None if none does.

    Notes
    -----
    Brouri, eq. (29), (39), which count the mean; a mean that is large against the harmonics then hides them
    all. Without ``mean`` the power is that around it.
    """
    held = 0.5 * np.cumsum(found.amplitudes**2) + (found.mean**2 if mean else 0.0)
    total = found.power - (0.0 if mean else found.mean**2)
    enough = np.flatnonzero(held >= (1.0 - epsilon / 100.0) * total)
    return int(enough[0]) + 1 if len(enough) else None


def order_by_signal_to_noise(found: Harmonics, threshold: float) -> int:
    """The highest harmonic above ``threshold`` standard errors, 0 if none is.

    Noise alone exceeds it at one harmonic with the probability exp(-threshold^2 / 2).
    """
    significant = np.flatnonzero(found.amplitudes > threshold * found.error)
    return int(significant[-1]) + 1 if len(significant) else 0
