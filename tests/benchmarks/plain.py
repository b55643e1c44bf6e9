"""Table I of Mzyk 2009 as a reader of the paper would first write it: one evaluation point at a time."""

from __future__ import annotations

import math

import numpy as np

from hident.arrays import Array
from hident.engine.trial import Data, generate
from tests.benchmarks.table1 import ALPHA, FEEDBACK, H0, LENGTH, Q0


def trial(data: Data, seed: int, number: int) -> list[float]:
    """The scores of one trial, as :func:`tests.benchmarks.table1.scores` orders them."""
    record = generate(data, seed, number)
    u, y = record.u, record.y
    a = instrumental_variables(u, y)
    filtered = y[1:] - a * y[:-1]
    estimates = {
        "(4)": kernel(u, y, u),
        "(15)": kernel(u[1:], filtered, u),
        "(7)": orthogonal(u, y, u),
        "(16)": orthogonal(u[1:], filtered, u),
    }
    truth = (0.5 + np.sign(u)) * (np.abs(u) - np.pi) + 2.0 * np.sin(u)
    mise = {name: LENGTH * float(np.mean((found - truth) ** 2)) for name, found in estimates.items()}
    return [mise["(4)"], mise["(15)"], a - FEEDBACK, mise["(7)"], mise["(16)"], a - FEEDBACK]


def instrumental_variables(u: Array, y: Array) -> float:
    """Eq. (12) for p = 1 and m(u) = |u|."""
    phi = np.column_stack([y[:-1], np.ones(len(y) - 1)])
    psi = np.column_stack([np.abs(u[:-1]), np.ones(len(y) - 1)])
    return float(np.linalg.solve(psi.T @ phi, psi.T @ y[1:])[0])


def kernel(u: Array, y: Array, points: Array) -> Array:
    """Eq. (4) and (15), with the nearest sample where none is in the window."""
    h = H0 * len(u) ** -ALPHA
    values = np.empty(len(points))
    for i, point in enumerate(points):
        weights = np.abs((u - point) / h) < 1.0
        count = weights.sum()
        values[i] = (y * weights).sum() / count if count else y[np.argmin(np.abs(u - point))]
    return values


def orthogonal(u: Array, y: Array, points: Array) -> Array:
    """Eq. (7) and (16)."""
    n = len(u)
    size = 2 * math.floor(Q0 * n**ALPHA) + 1
    alpha = [float(np.sum(y * function(u, i))) / n for i in range(size)]
    beta = [float(np.sum(function(u, i))) / n for i in range(size)]
    values = np.empty(len(points))
    for k, point in enumerate(points):
        phi = [float(function(point, i)) for i in range(size)]
        values[k] = sum(a * p for a, p in zip(alpha, phi, strict=True)) / sum(
            b * p for b, p in zip(beta, phi, strict=True)
        )
    return values


def function(x: Array | float, i: int) -> Array | float:
    """The orthonormal trigonometric function number i on an interval of the length LENGTH."""
    if i == 0:
        return 1.0 / math.sqrt(LENGTH) + 0.0 * x
    angle = 2.0 * np.pi * ((i + 1) // 2) * x / LENGTH
    wave = np.cos(angle) if i % 2 else np.sin(angle)
    return math.sqrt(2.0 / LENGTH) * wave
