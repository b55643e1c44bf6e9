"""Responses of many continuous linear blocks to one held input."""

from __future__ import annotations

import numpy as np

from hident.arrays import Array, Complex
from hident.numerics.whole import split

# Modes faster than this fraction of the sampling interval act at once.
_FASTEST = 1e-3
# Coefficients of the Pade approximant, by rising power.
_PADE = (17297280.0, 8648640.0, 1995840.0, 277200.0, 25200.0, 1512.0, 56.0, 1.0)


def time_constants(a: Array) -> Complex:
    """The negative inverse poles (J, n) of the blocks with denominators ``a`` (J, n).

    All real parts are positive if and only if the block is stable; none is infinite.
    """
    companion = np.zeros((*a.shape, a.shape[-1]))
    companion[:, 0, :] = a * (-1.0) ** np.arange(a.shape[-1])
    companion[:, 1:, :-1] = np.eye(a.shape[-1] - 1)
    return np.asarray(np.linalg.eigvals(companion), dtype=np.complex128)


def _products(values: Complex) -> Array:
    """The coefficients 1, ... (J, n + 1) of prod (1 + values_i z), by rising power of z."""
    coefficients = np.zeros((len(values), values.shape[1] + 1), dtype=complex)
    coefficients[:, 0] = 1.0
    for i, value in enumerate(values.T):
        coefficients[:, 1 : i + 2] += value[:, None] * coefficients[:, : i + 1]
    return coefficients.real


def responses(
    a: Array,
    b: Array,
    delay: float,
    u: Array,
    dt: float,
    tau: Complex | None = None,
) -> Array:
    """The responses (N, J) of J continuous blocks to one held input ``u`` (N,), exact at the samples.

    ``a`` (J, n) and ``b`` (J, m + 1) are the blocks' coefficients. Poles in the right half plane are
    reflected into the left one. ``tau`` (J, n) are the time constants, if they are known.
    """
    from scipy.signal import lfilter

    tau = time_constants(a) if tau is None else tau
    tau = np.maximum(np.abs(tau.real), _FASTEST * dt) + 1j * tau.imag
    denominators = _products(-np.exp(-dt / tau))
    whole, rest = split(delay / dt)
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
    step = _exponentials(M * scale)
    state = (step if rest == 0.0 else _exponentials(M * (scale * (1.0 - rest))))[..., -1:]
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


def _exponentials(matrices: Array) -> Array:
    """The exponentials of J small matrices (J, k, k), by the Pade approximant of degree 7 and squaring.

    Higham 2005, algorithm 2.3; SciPy's takes one matrix after the other.
    """
    halvings = np.maximum(np.frexp(np.max(np.sum(np.abs(matrices), axis=-2), axis=-1))[1], 0)
    A = matrices * 0.5 ** halvings[:, None, None]
    A2 = A @ A
    A4 = A2 @ A2
    A6 = A2 @ A4
    unit = np.eye(A.shape[-1])
    odd = A @ (_PADE[7] * A6 + _PADE[5] * A4 + _PADE[3] * A2 + _PADE[1] * unit)
    even = _PADE[6] * A6 + _PADE[4] * A4 + _PADE[2] * A2 + _PADE[0] * unit
    exponentials = np.linalg.solve(even - odd, even + odd)
    for halving in range(int(np.max(halvings, initial=0))):
        squared = halvings > halving
        exponentials[squared] = exponentials[squared] @ exponentials[squared]
    return np.asarray(exponentials)
