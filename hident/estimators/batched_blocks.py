"""Responses of many continuous linear blocks to one held input."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hident.records import Array

# A delay this close to a whole number of samples is that.
_WHOLE = 1e-9
# Modes faster than this fraction of the sampling interval act at once.
_FASTEST = 1e-3


def time_constants(a: Array) -> NDArray[np.complex128]:
    """The negative inverse poles (J, n) of the blocks with denominators ``a`` (J, n).

    All real parts are positive if and only if the block is stable; none is infinite.
    """
    companion = np.zeros((*a.shape, a.shape[-1]))
    companion[:, 0, :] = a * (-1.0) ** np.arange(a.shape[-1])
    companion[:, 1:, :-1] = np.eye(a.shape[-1] - 1)
    return np.asarray(np.linalg.eigvals(companion), dtype=np.complex128)


def _products(values: NDArray[np.complex128]) -> Array:
    """The coefficients 1, ... (J, n + 1) of prod (1 + values_i z), by rising power of z."""
    coefficients = np.zeros((len(values), values.shape[1] + 1), dtype=complex)
    coefficients[:, 0] = 1.0
    for i, value in enumerate(values.T):
        coefficients[:, 1 : i + 2] += value[:, None] * coefficients[:, : i + 1]
    return coefficients.real


def responses(a: Array, b: Array, delay: float, u: Array, dt: float) -> Array:
    """The responses (N, J) of J continuous blocks to one held input ``u`` (N,), exact at the samples.

    ``a`` (J, n) and ``b`` (J, m + 1) are the blocks' coefficients. Poles in the right half plane are
    reflected into the left one.
    """
    from scipy.signal import lfilter

    tau = time_constants(a)
    tau = np.maximum(np.abs(tau.real), _FASTEST * dt) + 1j * tau.imag
    denominators = _products(-np.exp(-dt / tau))
    whole = math.floor(delay / dt + _WHOLE)
    rest = delay / dt - whole
    rest = 0.0 if rest < _WHOLE else rest
    numerators = _numerators(_products(tau)[:, 1:], b, denominators, rest, dt)
    delayed = np.concatenate((np.zeros(min(whole, len(u))), u[: max(len(u) - whole, 0)]))
    x = np.empty((len(u), len(a)))
    for j, (numerator, denominator) in enumerate(zip(numerators, denominators, strict=True)):
        x[:, j] = lfilter(numerator, denominator, delayed)
    return x


def _numerators(a: Array, b: Array, denominators: Array, rest: float, dt: float) -> Array:
    """The numerators in q^-1 of the blocks sampled under held inputs, delayed by ``rest`` < 1 of ``dt``.

    Their shape is (J, n + 1), or (J, n + 2) with a delay.
    """
    from scipy.linalg import expm

    count, n = a.shape
    unit = a[:, -1:] ** (1.0 / n)
    powers = unit ** np.arange(n + 1)
    # dz/dt = M z with the held input as last state, time in ``unit``.
    M = np.zeros((count, n + 1, n + 1))
    M[:, : n - 1, 1:n] = np.eye(n - 1)
    M[:, n - 1, 0] = -1.0
    M[:, n - 1, 1:n] = -a[:, :-1] / powers[:, 1:n]
    M[:, n - 1, n] = 1.0
    scale = (dt / unit)[..., None]
    step = expm(M * scale)
    state = (step if rest == 0.0 else expm(M * (scale * (1.0 - rest))))[..., -1:]
    size = n + 1 if rest == 0.0 else n + 2
    rises = np.zeros((count, size))
    for k in range(1, size):
        rises[:, k] = np.einsum("ji,ji->j", b / powers[:, : b.shape[1]], state[:, : b.shape[1], 0])
        state = step @ state
    impulses = np.diff(rises, axis=1, prepend=0.0)
    numerators = np.zeros((count, size))
    for i in range(n + 1):
        numerators[:, i:] += denominators[:, i : i + 1] * impulses[:, : size - i]
    return numerators
