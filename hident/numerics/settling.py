"""The settling time of a continuous linear block: the last time that its step response crosses a band.

The error of the step response is a sum of exponentials. An envelope, the sum of their moduli, falls into the
band at a time after which nothing can cross it. From there a grid goes backwards, fine for every mode that is
still alive, until the error leaves the band; in that cell its Taylor polynomial, exact to rounding, gives the
crossing. A mode counts as dead where it is below the rounding of the band, so that a fast mode does not
make the grid of a slow one fine.

======  =====================================================================================
p       poles, the fastest first
x       the chain x_1' = p_1 x_1, x_k' = p_k x_k + x_(k-1), which multiple poles do not disturb
d       weights: the error is Re d'x
r       residues: the error is sum r_k exp(p_k t)
======  =====================================================================================
"""

from __future__ import annotations

import math
from itertools import accumulate

import numpy as np
from numpy.polynomial import polynomial

from hident.arrays import Array, Complex

# Cells in time constants, or radians, of the fastest mode that is alive.
_CELL = 0.25
_FIRST_CELLS, _MOST_CELLS = 64, 2**16
# Terms of a Taylor series over a cell, the last of which is below rounding.
_TERMS = 16
# Share of the band below which a mode is rounding.
_DEAD = 1e-13
# Poles that are closer, relative to their size, are moved apart to bound their residues.
_APART = 1e-6
_BISECTIONS = 60
_REAL = 1e-9


def settling_time(b: tuple[float, ...], a: tuple[float, ...], band: float) -> float:
    """The time after which the step response stays within ``band``, relative to its final value.

    Parameters
    ----------
    b, a : tuples
        The stable block (b_0 + ... + b_m s^m) / (1 + a_1 s + ... + a_n s^n), m < n, b_0 other than zero.
    band : float
        Half the width of the band, between 0 and 1.

    Returns
    -------
    float
        In the unit of time of the coefficients; 0 if the response is never outside.
    """
    # In a unit of time in which the poles have a geometric mean of one.
    unit = abs(a[-1]) ** (1.0 / len(a))
    powers = unit ** np.arange(len(a) + 1.0)
    poles, error = _error_of_step(np.array(b) / powers[: len(b)], np.array([1.0, *a]) / powers)
    weights, chain = _chain(poles, error)
    end, deaths = _bounds(poles, error, band)
    if end == 0.0:
        return 0.0
    while abs(_at(end, weights, chain)) > band:  # Residues of poles that were moved apart are a guess.
        end *= 1.5
    cells = _FIRST_CELLS
    while end > 0.0:
        dead = min(sum(death < end for death in deaths), len(poles) - 1)
        begin = max(
            end - cells * _CELL / float(np.max(np.abs(poles[dead:]))), deaths[dead - 1] if dead else 0.0
        )
        crossing = _last_crossing(weights, chain, dead, begin, end, band)
        if crossing is not None:
            return float(unit * crossing)
        end, cells = begin, min(2 * cells, _MOST_CELLS)
    return 0.0


def _error_of_step(b: Array, a: Array) -> tuple[Complex, Array]:
    """The poles (n,), fastest decay first, and the numerator (n,) by rising power of the error's transform.

    The denominator of the transform is the product of all s - p_k.
    """
    poles = np.roots(a[::-1]).astype(np.complex128)
    relative = np.zeros(len(a))
    relative[: len(b)] = b / b[0]
    # (B/b_0 - A) / (s A): both constants are 1, so that s cancels.
    return poles[np.argsort(poles.real, kind="stable")], (relative - a)[1:] / a[-1]


def _chain(poles: Complex, error: Array) -> tuple[Complex, Complex]:
    """The weights d (n,) and the matrix (n, n) of the chain, by Newton's form of the numerator."""
    weights, rest = np.zeros(len(poles), dtype=complex), error.astype(complex)
    for k in range(len(poles) - 1, -1, -1):
        quotient, remainder = polynomial.polydiv(rest, np.array([-poles[k], 1.0]))
        weights[k] = remainder[0] if k else rest[0]
        rest = quotient
    return weights, np.diag(poles) + np.eye(len(poles), k=-1)


def _bounds(poles: Complex, error: Array, band: float) -> tuple[float, list[float]]:
    """When the envelope enters the band, and when each mode and all that are faster are dead, rising."""
    size = np.abs(poles)
    gaps = np.abs(poles[:, None] - poles) + np.diag(size)
    if np.any(gaps < _APART * size):
        poles = poles * (1.0 + _APART * np.arange(1.0, len(poles) + 1.0))
    others = poles[:, None] - poles + np.eye(len(poles))
    residues = np.abs(polynomial.polyval(poles, error) / np.prod(others, axis=1)).tolist()
    rates = (-poles.real).tolist()
    modes = [(r, rate) for r, rate in zip(residues, rates, strict=True) if r > 0.0]
    deaths = [
        max(math.log(max(r, 1e-300) / (_DEAD * band)) / rate, 0.0)
        for r, rate in zip(residues, rates, strict=True)
    ]

    def envelope(t: float) -> float:
        return float(sum(r * math.exp(-rate * t) for r, rate in modes))

    if envelope(0.0) <= band:
        return 0.0, deaths
    low, high = 0.0, max(math.log(len(modes) * r / band) / rate for r, rate in modes)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if envelope(middle) > band else (low, middle)
    return high, list(accumulate(deaths, max))


def _at(t: float, weights: Complex, chain: Complex) -> float:
    """The error of the step response at a time."""
    from scipy.linalg import expm

    return float((weights @ expm(chain * t)[:, 0]).real)


def _last_crossing(
    weights: Complex, chain: Complex, dead: int, begin: float, end: float, band: float
) -> float | None:
    """The last time from ``begin`` to ``end`` at which the error enters the band; None if it stays within."""
    from scipy.linalg import expm

    x, weights = expm(chain * begin)[dead:, 0], weights[dead:]
    chain = chain[dead:, dead:]
    fastest = float(np.max(np.abs(np.diag(chain))))
    cells = max(math.ceil((end - begin) * fastest / _CELL), 1)
    h = (end - begin) / cells
    step, states = expm(chain * h), x[:, None]
    while states.shape[1] <= cells:
        states, step = np.hstack((states, step @ states)), step @ step
    error = (weights @ states[:, : cells + 1]).real
    slope = (weights @ chain @ states[:, : cells + 1]).real
    size, reach = np.abs(error), h * np.abs(slope)
    turns = slope[:-1] * slope[1:] <= 0.0
    peak = np.maximum(size[:-1], size[1:]) + turns * np.maximum(reach[:-1], reach[1:])
    for cell in np.flatnonzero(peak > band)[::-1].tolist():
        within = _last_root(weights, chain * h, states[:, cell], band)
        if within is not None:
            return float(begin + h * (cell + within))
        if size[cell] > band:  # At the node itself, up to rounding.
            return float(begin + h * cell)
    return None


def _last_root(weights: Complex, generator: Complex, x: Complex, band: float) -> float | None:
    """The last s from 0 to 1 at which weights' exp(generator s) x is plus or minus the band."""
    terms = []
    for j in range(_TERMS):
        terms.append(float((weights @ x).real))
        x = generator @ x / (j + 1.0)
    found: list[float] = []
    for level in (band, -band):
        roots = polynomial.polyroots(np.array([terms[0] - level, *terms[1:]]))
        real = roots.real[np.abs(roots.imag) <= _REAL]
        found += real[(real >= 0.0) & (real <= 1.0 + _REAL)].tolist()
    return max(found, default=None)
