"""The response of G_i(s) -> f -> G_o(s) in continuous time, to signals known between their samples.

Symbols as Brouri writes them, eq. (1)-(3): u_i = G_i(s) v, u_o = f(u_i), w = G_o(s) u_o.

To a periodic signal the response is periodic, and no transient is computed: G_i and G_o act on harmonics,
and f on one period sampled finely enough. Otherwise time is divided into panels, short after a jump of
the input and growing with the distance from it. On each panel all signals are polynomials through Chebyshev
points, and the differential equations of the blocks hold at those points (collocation). Both are of
spectral accuracy for a smooth f, and refine themselves until the spectrum of u_o says so.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from hident.arrays import Array, Characteristic, Complex
from hident.errors import SimulationError
from hident.linear_blocks import ContinuousTransferFunction
from hident.numerics.whole import nearest_whole
from hident.records import Held, Periodic, Waveform

ACCURACY = 1e-11
"""Accuracy of the responses: the spectrum of f's output must fall to this, relative to its largest line."""
_MOST_POINTS = 2**20
_NEGLIGIBLE = 1e-16
# A period this close to a whole number of samples, relative to it, is one.
_WHOLE = 1e-12
_DEGREE = 20
_MOST_HALVINGS = 40
# Time constants after which an exponential is below rounding.
_FORGOTTEN = 40.0
# Panels in a period of the fastest oscillation.
_PANELS_PER_PERIOD = 3
# Lengths of panels that differ by less, relatively, differ by rounding.
_SAME = 1e-9

# The Chebyshev points of a panel, 0 and 1 included; what makes a Chebyshev series of values there, and
# what makes derivatives.
_NODES = (1 - np.cos(np.pi * np.arange(_DEGREE + 1) / _DEGREE)) / 2
_TO_SERIES = np.linalg.inv(chebyshev.chebvander(2 * _NODES - 1, _DEGREE))
_DERIVATIVE = 2 * chebyshev.chebval(2 * _NODES - 1, chebyshev.chebder(np.eye(_DEGREE + 1))).T @ _TO_SERIES


def respond(
    first: ContinuousTransferFunction,
    f: Characteristic,
    second: ContinuousTransferFunction,
    waveform: Waveform,
    n: int,
    dt: float,
) -> Array:
    """The response w (n,) at the times 0, dt, 2 dt, ... to a signal v.

    Parameters
    ----------
    first, second : ContinuousTransferFunction
        The stable blocks G_i and G_o.
    f : callable
        The static nonlinearity, elementwise.
    waveform : Held or Periodic
        The signal. What was constant before time 0 finds the system in equilibrium.

    Raises
    ------
    SimulationError
        If f is not smooth enough, or not finite where it is used.
    """
    if isinstance(waveform, Periodic) and waveform.settled:
        return _steady_state(first, f, second, waveform, n, dt)
    # Delays shift the output, wherever in the chain they stand.
    times = np.maximum(np.arange(n) * dt - (first.delay + second.delay), 0.0)
    first, second = replace(first, delay=0.0), replace(second, delay=0.0)
    edges = _panels(first, second, waveform, float(times[-1]))
    for _ in range(_MOST_HALVINGS):
        lengths = np.diff(edges)
        nodes = edges[:-1, np.newaxis] + lengths[:, np.newaxis] * _NODES
        before = waveform.before if isinstance(waveform, Held) else waveform.offset
        v = _at_nodes(waveform, edges, nodes)
        u_o = f(_driven(first, lengths, v, before))
        tails = _relative_tails(u_o @ _TO_SERIES.T)
        rough = tails > ACCURACY
        if not rough.any():
            rest = float(f(np.array([first.b[0] * before]))[0])
            return _sampled(edges, _driven(second, lengths, u_o, rest), times)
        edges = np.sort(np.concatenate((edges, nodes[rough, _DEGREE // 2])))
    raise _not_smooth(float(np.max(tails)))


def _not_smooth(tail: float) -> SimulationError:
    return SimulationError(
        "the nonlinearity is not smooth enough to be simulated: "
        f"relative accuracy {tail:.1g}, not {ACCURACY:g}"
    )


def _relative_tails(spectra: Array | Complex) -> Array:
    """The largest of the last quarter of the lines of each spectrum (P, K), relative to all, shape (P,).

    Raises
    ------
    SimulationError
        If a line is not finite.
    """
    size = np.abs(spectra)
    largest = float(np.max(size))
    if not np.isfinite(largest):
        raise SimulationError("the nonlinearity is not finite in the range of its input")
    tails = np.max(size[:, 3 * size.shape[1] // 4 :], axis=1)
    return np.asarray(tails / largest if largest else tails)


def _steady_state(
    first: ContinuousTransferFunction,
    f: Characteristic,
    second: ContinuousTransferFunction,
    signal: Periodic,
    n: int,
    dt: float,
) -> Array:
    """The periodic response (n,) at the times 0, dt, 2 dt, ..."""
    omega = 2 * math.pi / signal.period
    u_i = signal.amplitudes * first.frequency_response(signal.harmonics.astype(float) * omega)
    points = 1 << int(8 * np.max(signal.harmonics)).bit_length()
    tail = np.inf
    while tail > ACCURACY:
        if points > _MOST_POINTS:
            raise _not_smooth(tail)
        spectrum = np.zeros(points // 2 + 1, dtype=complex)
        spectrum[0] = signal.offset * first.b[0]
        spectrum[signal.harmonics] = u_i / 2
        u_o = np.fft.rfft(f(np.fft.irfft(spectrum, points, norm="forward")), norm="forward")
        tail = float(_relative_tails(u_o[np.newaxis])[0])
        points *= 2
    w = u_o * second.frequency_response(np.arange(float(len(u_o))) * omega)
    w[1:] *= 2
    size = np.abs(w)
    last = np.flatnonzero(size > _NEGLIGIBLE * np.max(size, initial=0.0))
    return _harmonic_sum(w[: last[-1] + 1] if len(last) else w[:1], signal.period, n, dt)


def _harmonic_sum(amplitudes: Complex, period: float, n: int, dt: float) -> Array:
    """Re sum_k amplitudes[k] exp(j k omega t), k = 0, 1, ..., at the times 0, dt, ..., shape (n,)."""
    samples = nearest_whole(period / dt, _WHOLE)
    if samples is not None:
        # At whole fractions of the period, harmonics that differ by a multiple of their number are one.
        rows = np.append(amplitudes, np.zeros(-len(amplitudes) % samples)).reshape(-1, samples)
        return np.resize(np.fft.ifft(rows.sum(axis=0), norm="forward").real, n)
    phasor = np.exp(2j * np.pi * np.fmod(np.arange(n) * (dt / period), 1.0))
    total = np.full(n, amplitudes[-1])
    for amplitude in amplitudes[-2::-1]:
        total *= phasor
        total += amplitude
    return np.ascontiguousarray(total.real)


def _panels(
    first: ContinuousTransferFunction, second: ContinuousTransferFunction, waveform: Waveform, end: float
) -> Array:
    """The edges of the panels from 0 to beyond ``end``, every jump of the input among them."""
    poles = np.concatenate((first.poles(), second.poles()))
    shortest = 1.0 / float(np.max(np.abs(poles)))
    end = end + shortest
    fastest, horizon = float(np.max(np.abs(poles.imag))), _FORGOTTEN / float(np.min(-poles.real))
    jumps = np.zeros(1)
    if isinstance(waveform, Held):
        jumps = waveform.times[waveform.times < end]
    else:
        fastest = max(fastest, 2 * np.pi / waveform.period * float(np.max(waveform.harmonics)))
        horizon = end
    longest = 2 * np.pi / (_PANELS_PER_PERIOD * fastest) if fastest else np.inf
    lengths = np.diff(jumps, append=end)
    after = _graded(shortest, longest, min(horizon, float(np.max(lengths))))
    within = after < lengths[:, np.newaxis] * (1 - _SAME)
    return np.append((jumps[:, np.newaxis] + after)[within], end)


def _graded(shortest: float, longest: float, horizon: float) -> Array:
    """Times from 0 to the horizon, each interval as long as all before it together, within limits."""
    times = [0.0]
    while times[-1] < horizon:
        times.append(times[-1] + min(max(times[-1], shortest), longest))
    return np.array(times)


def _at_nodes(waveform: Waveform, edges: Array, nodes: Array) -> Array:
    """The signal at the nodes (P, K) of the panels."""
    if isinstance(waveform, Held):
        middle = (edges[:-1] + edges[1:]) / 2
        level = waveform.levels[np.searchsorted(waveform.times, middle) - 1]
        return np.broadcast_to(level[:, np.newaxis], nodes.shape)
    total = np.full(nodes.shape, waveform.offset)
    for harmonic, amplitude in zip(waveform.harmonics, waveform.amplitudes, strict=True):
        phase = 2 * np.pi * harmonic / waveform.period * nodes
        total += amplitude.real * np.cos(phase) - amplitude.imag * np.sin(phase)
    return total


def _driven(block: ContinuousTransferFunction, lengths: Array, x: Array, before: float) -> Array:
    """The block's output at the nodes (P, K) of panels of the given lengths (P,), input ``x`` there.

    The block starts from the equilibrium with the input ``before``.
    """
    inputs = x[:, 1:]
    lengths, kind = _distinct(lengths)
    matrix, into, out = _state_space(block)
    order = len(into)
    states = np.empty((len(x) + 1, order))
    states[0] = before * np.eye(order)[0]
    panels = [_collocated(matrix, into, length) for length in lengths]
    members = [np.flatnonzero(kind == k) for k in range(len(lengths))]
    driven = np.empty((len(x), order))
    for panel, own in zip(panels, members, strict=True):
        driven[own] = inputs[own] @ panel[-1, :, order:].T
    for p, k in enumerate(kind):
        states[p + 1] = panels[k][-1, :, :order] @ states[p] + driven[p]
    y = np.empty(x.shape)
    for panel, own in zip(panels, members, strict=True):
        both = out @ panel
        y[own] = states[own] @ both[:, :order].T + inputs[own] @ both[:, order:].T
    return y


def _state_space(block: ContinuousTransferFunction) -> tuple[Array, Array, Array]:
    """(A, B, C) with dx/dt = A x + B u and y = C x; a constant u gives x = (u, 0, ..., 0) in the end.

    The states are the derivatives of one signal in a unit of time in which they are of one size.
    """
    n = len(block.a)
    unit = abs(block.a[-1]) ** (1.0 / n)
    a = np.array([1.0, *block.a]) * unit ** -np.arange(n + 1.0)
    matrix, into, out = np.eye(n, k=1), np.zeros(n), np.zeros(n)
    matrix[-1], into[-1] = -a[:n] / a[n], 1.0 / a[n]
    out[: len(block.b)] = block.b * unit ** -np.arange(float(len(block.b)))
    return matrix / unit, into / unit, out


def _distinct(lengths: Array) -> tuple[Array, NDArray[np.intp]]:
    """The lengths (L,) that differ by more than rounding, and for each panel which of them is its own."""
    order = np.argsort(lengths)
    ordered = lengths[order]
    kind = np.empty(len(lengths), dtype=np.intp)
    kind[order] = np.cumsum(np.append(False, ordered[1:] > ordered[:-1] * (1 + _SAME)))
    return np.bincount(kind, lengths) / np.bincount(kind), kind


def _collocated(matrix: Array, into: Array, length: float) -> Array:
    """The states at the K nodes of a panel, linear in the state at its start and the input at the others.

    Shape (K, n, n + K - 1).
    """
    n, inner = len(into), _DEGREE
    system = np.kron(_DERIVATIVE[1:, 1:], np.eye(n)) - length * np.kron(np.eye(inner), matrix)
    from_start = -np.kron(_DERIVATIVE[1:, :1], np.eye(n))
    from_input = length * np.kron(np.eye(inner), into[:, np.newaxis])
    states = np.linalg.solve(system, np.hstack((from_start, from_input)))
    return np.vstack((np.eye(n, n + inner), states)).reshape(inner + 1, n, n + inner)


def _sampled(edges: Array, values: Array, times: Array) -> Array:
    """The piecewise polynomial with the given values (P, K) at the nodes, at the times (n,)."""
    panel = np.minimum(np.searchsorted(edges, times, side="right"), len(values)) - 1
    place = (times - edges[panel]) / np.diff(edges)[panel]
    return np.asarray(chebyshev.chebval(2 * place - 1, (_TO_SERIES @ values.T)[:, panel], tensor=False))
