"""The library calls that any fast implementation of Table I of Mzyk 2009 makes, and little else.

A trial's four estimates share the sort and the truth; their sums and evaluations are their own.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.signal import lfilter

from hident.arrays import Array, Complex
from hident.engine.trial import Data
from tests.benchmarks.table1 import ALPHA, FEEDBACK, H0, HALF_WIDTH, LENGTH, Q0

_BLOCK = 1024


def trial(data: Data, seed: int, number: int, burn_in: int) -> list[float]:
    """The scores of one trial, as :func:`tests.benchmarks.table1.scores` orders them."""
    n = data.samples
    drawn = data.streams.generator("input", seed, data.key, number).random(burn_in + n)
    u = np.concatenate((drawn[n:], drawn[:n])) * LENGTH - LENGTH / 2.0
    w = (0.5 + np.sign(u)) * (np.abs(u) - np.pi) + 2.0 * np.sin(u)
    noise = data.streams.generator("noise", seed, data.key, number).random(n)
    y = lfilter([1.0], [1.0, -FEEDBACK], w)[burn_in:] + HALF_WIDTH * (2.0 * noise - 1.0)
    u, w = u[burn_in:], w[burn_in:]

    m, past, now = np.abs(u[:-1]), y[:-1], y[1:]
    m = m - m.mean()
    a = float((m @ now) / (m @ past))
    filtered = now - a * past

    order = np.argsort(u)
    increasing, truth = u[order], w[order]
    kept = order > 0
    scores = [
        LENGTH * float(np.mean((found - truth) ** 2))
        for found in (
            kernel(increasing, y[order], increasing),
            kernel(increasing[kept], filtered[order[kept] - 1], increasing),
        )
    ]
    scores += [
        LENGTH * float(np.mean((found - w) ** 2)) for found in (series(u, y, u), series(u[1:], filtered, u))
    ]
    return [scores[0], scores[1], a - FEEDBACK, scores[2], scores[3], a - FEEDBACK]


def kernel(u: Array, y: Array, points: Array) -> Array:
    """Eq. (4) and (15) at increasing points, all but one of them samples."""
    h = H0 * len(u) ** -ALPHA
    sums = np.concatenate(([0.0], np.cumsum(y)))
    start, stop = np.searchsorted(u, points - h, "right"), np.searchsorted(u, points + h)
    counts = stop - start
    values = (sums[stop] - sums[start]) / np.maximum(counts, 1)
    if not counts.all():
        alone = int(np.argmin(counts))
        values[alone] = y[np.argmin(np.abs(u - points[alone]))]
    return np.asarray(values)


def series(u: Array, y: Array, points: Array) -> Array:
    """Eq. (7) and (16)."""
    count = math.floor(Q0 * len(u) ** ALPHA) + 1
    inner = math.isqrt(count)
    outer = math.ceil(count / inner)
    weights = np.stack([y, np.ones(len(u))])
    sums = np.zeros((2 * outer, inner), dtype=complex)
    for first in range(0, len(u), _BLOCK):
        block = slice(first, first + _BLOCK)
        fine, coarse = functions(u[block], inner, outer)
        sums += (weights[:, None, block] * coarse).reshape(2 * outer, -1) @ fine.T
    # The real part of conj(c_k) exp(i k theta), twice for k > 0.
    coefficients = sums.reshape(2, -1).conj()
    coefficients[:, 0] /= 2.0
    coefficients[:, count:] = 0.0
    values = np.empty((2, len(points)))
    for first in range(0, len(points), _BLOCK):
        block = slice(first, first + _BLOCK)
        fine, coarse = functions(points[block], inner, outer)
        terms = (coefficients.reshape(2 * outer, inner) @ fine).reshape(2, outer, -1)
        terms *= coarse
        np.sum(terms.real, axis=1, out=values[:, block])
    return np.asarray(values[0] / values[1])


def functions(u: Array, inner: int, outer: int) -> tuple[Complex, Complex]:
    """exp(i b theta) for b < inner and exp(i a inner theta) for a < outer, whose products are the basis."""
    step = np.exp(2j * np.pi / LENGTH * u)
    fine = powers(step, inner)
    return fine, powers(fine[-1] * step, outer)


def powers(step: Complex, count: int) -> Complex:
    """The powers 0, ..., count - 1 of ``step``, a row each."""
    rows = np.empty((count, len(step)), dtype=complex)
    rows[0] = 1.0
    for k in range(1, count):
        np.multiply(rows[k - 1], step, out=rows[k])
    return rows
