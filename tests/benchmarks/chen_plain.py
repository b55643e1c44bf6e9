"""Both algorithms of Chen, Hwang and Chang 2009 as a reader of the paper would first write them.

One pair of partition points, one iteration, one horizon at a time; each integral (18) is a sum over the
samples in the horizon. Searches and rules of the iterations are those of hident, so that estimates can be
held against its own; the responses and settling times of the final blocks are hident's.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial
from scipy.integrate import simpson
from scipy.signal import cont2discrete, lfilter

from hident.arrays import Array
from hident.linear_blocks import ContinuousTransferFunction

_PATIENCE = 10
_OFFSETS = (-0.5, -0.25, 0.0, 0.25, 0.5)

Values = dict[str, float]
Basis = Callable[[Array], Array]


@dataclass(frozen=True)
class Data:
    """A record; delay and start in samples."""

    u: Array
    y: Array
    dt: float
    delay: int
    start: int


@dataclass(frozen=True)
class Stage:
    """A structure, and horizons of ``eta`` that start ``overlap`` eta apart."""

    n: int
    m: int
    eta: float
    overlap: float


class Quadrature:
    """The integrals (18), with (-1)^l, as sums: L + 1 weights for samples, L for held levels."""

    def __init__(self, data: Data, stage: Stage) -> None:
        n, length = stage.n, round(stage.eta / data.dt)
        w = Polynomial([0.0, 4.0, -4.0]) ** n
        derivatives = [w.deriv(i) / (-stage.eta) ** i if i else w for i in range(n + 1)]
        s = np.arange(length + 1) / length
        at, between = (np.array([d(x) for d in derivatives]) for x in (s, (s[1:] + s[:-1]) / 2.0))
        self.sampled = at * simpson(np.eye(length + 1), dx=1.0 / length)
        self.held = (at[:, :-1] + 4.0 * between + at[:, 1:]) / (6.0 * length)
        stride = stage.overlap * length
        count = int((len(data.u) - 1 - data.start - length) / stride + 1e-6)
        self.starts = [round(data.start + stride * k) for k in range(count)]
        self.length, self.delay = length, data.delay

    def of_samples(self, signal: Array, start: int) -> Array:
        return np.asarray(self.sampled @ signal[start : start + self.length + 1])

    def of_held(self, signal: Array, start: int) -> Array:
        start -= self.delay
        return np.asarray(self.held @ signal[start : start + self.length])


def least_squares(rows: list[Array]) -> tuple[Array, Array]:
    """theta, and phi with z as last column, eq. (25), (26)."""
    both = np.array(rows)
    return np.asarray(np.linalg.lstsq(both[:, :-1], both[:, -1], rcond=None)[0]), both


def linear(data: Data, stage: Stage, x: Array, y: Array, gain: float) -> ContinuousTransferFunction:
    """The second stage, from the held input x to y."""
    over, n, m = Quadrature(data, stage), stage.n, stage.m
    rows = []
    for start in over.starts:
        ys, xs = over.of_samples(y, start), over.of_held(x, start)
        rows.append(np.concatenate((-ys[1:], xs[1 : m + 1], [ys[0] - gain * xs[0]])))
    return block(np.append(least_squares(rows)[0], gain), n, m, data)


def block(theta: Array, n: int, m: int, data: Data) -> ContinuousTransferFunction:
    """The block with a, then b_1, ..., b_m and b_0 in ``theta``."""
    b = [theta[-1], *theta[n : n + m]]
    return ContinuousTransferFunction(tuple(map(float, b)), tuple(theta[:n].tolist()), data.delay * data.dt)


# Hammerstein


def hammerstein(data: Data, first: Stage, second: Stage, degree: int | None) -> Values:
    """Both stages with a polynomial, or with a searched three-segment function where ``degree`` is None."""
    partition: Values = {}
    if degree is None:
        lower, upper = search_hammerstein(data, first)
        partition = {"u_-1": lower, "u_1": upper}
        basis = three_segments(lower, upper)
    else:
        basis = lambda u: np.array([u**i for i in range(1, degree + 1)])  # noqa: E731
    theta, _ = iterate_hammerstein(data, first, basis)
    n, m = first.n, first.m
    begun = block(np.append(theta[: n + m], 1.0), n, m, data)
    stage = Stage(second.n, second.m, 0.5 * begun.settling_time(), second.overlap)
    x = theta[n + m :] @ basis(data.u)
    return linear(data, stage, x, data.y, 1.0).values() | partition


def three_segments(lower: float, upper: float) -> Basis:
    """f_1, ..., f_5 of (7)."""

    def basis(u: Array) -> Array:
        middle = np.clip(u, lower, upper)
        beyond = np.maximum(u - upper, 0.0), np.minimum(u - lower, 0.0)
        return np.array([middle, middle**2, middle**3, *beyond])

    return basis


def iterate_hammerstein(data: Data, stage: Stage, basis: Basis) -> tuple[Array, float]:
    """theta and the criterion (30) after the iteration (25), (27)."""
    over, n, m = Quadrature(data, stage), stage.n, stage.m
    functions, x, theta = basis(data.u), data.u, np.zeros(1)
    for _ in range(100):
        rows = []
        for start in over.starts:
            ys, xs = over.of_samples(data.y, start), over.of_held(x, start)
            fs = [over.of_held(f, start)[0] for f in functions]
            rows.append(np.concatenate((-ys[1:], xs[1 : m + 1], fs, ys[:1])))
        old, (theta, both) = theta, least_squares(rows)
        if m == 0 or np.linalg.norm(theta - old) <= 1e-6 * np.linalg.norm(theta):
            break
        x = theta[n + m :] @ functions
    return theta, float(np.sum((both[:, -1] - both[:, :-1] @ theta) ** 2))


def search_hammerstein(data: Data, stage: Stage) -> tuple[float, float]:
    """The best of 12 x 12 pairs, and of 5 x 5 around it."""
    low, high = data.u.min() / 13.0, data.u.max() / 13.0

    def best(lowers: Array, uppers: Array) -> tuple[float, float]:
        pairs = list(itertools.product(lowers.tolist(), uppers.tolist()))
        losses = [iterate_hammerstein(data, stage, three_segments(*pair))[1] for pair in pairs]
        return pairs[int(np.argmin(losses))]

    steps = np.arange(1.0, 13.0)
    lower, upper = best(low * steps, high * steps)
    near = np.array(_OFFSETS)
    return best(lower - low * near, upper + high * near)


# Wiener


def wiener(data: Data, first: Stage, second: Stage) -> Values:
    """Both stages with a searched four-segment inverse function."""
    lower, upper = search_wiener(data, first)
    theta = iterate_wiener(data, first, lower, upper, None)[0]
    n, m = first.n, first.m
    begun = block(np.append(theta[: n + m], theta[n + m]), n, m, data)
    x = internal(data.y, lower, upper, theta[n + m + 1 :])
    stage = Stage(second.n, second.m, begun.settling_time(), second.overlap)
    found = linear(data, stage, data.u, x, float(theta[n + m]))
    return found.values() | {"y_-1": lower, "y_1": upper}


def segments(y: Array, lower: float, upper: float) -> Array:
    """g_-2, g_-1, g_2 of (16)."""
    return np.array([np.minimum(y - lower, 0.0), np.clip(y, lower, 0.0), np.maximum(y - upper, 0.0)])


def internal(y: Array, lower: float, upper: float, c: Array) -> Array:
    """x by (15), with c = 1 - e."""
    return np.asarray(y - c @ segments(y, lower, upper))


def respond(data: Data, a: Array, b: Array) -> Array:
    """The linear block's output (28a), unstable poles reflected."""
    poles = np.roots([*a[::-1], 1.0])
    reflected = np.poly(-np.abs(poles.real) + 1j * poles.imag).real
    numerator = b[::-1] * reflected[-1]
    sampled, denominator, _ = cont2discrete((numerator, reflected), data.dt)
    u = np.concatenate((np.zeros(data.delay), data.u[: len(data.u) - data.delay]))
    return np.asarray(lfilter(sampled[0], denominator, u))


def iterate_wiener(
    data: Data, stage: Stage, lower: float, upper: float, patience: int | None
) -> tuple[Array, bool]:
    """theta = a, b_1, ..., b_m, b_0, c after the iteration (26), (28), (29), and whether it is admissible."""
    over, n, m, y = Quadrature(data, stage), stage.n, stage.m, data.y
    g, x, theta, bad = segments(y, lower, upper), y, np.zeros(0), 0
    for iteration in range(61):
        rows = []
        for start in over.starts:
            xs, us = over.of_samples(x, start), over.of_held(data.u, start)
            gs = [over.of_samples(one, start)[0] for one in g]
            z = over.of_samples(y, start)[0]
            rows.append(np.concatenate((-xs[1:], us[1 : m + 1], us[:1], gs, [z])))
        old, (theta, both) = theta, least_squares(rows)
        a, b, c = theta[:n], np.append(theta[n + m], theta[n : n + m]), theta[n + m + 1 :]
        admissible = bool(np.all(np.roots([*a[::-1], 1.0]).real < 0.0) and np.all(c < 1.0))
        if iteration:
            size = np.linalg.norm(both[:, :-1], axis=0)
            bad = 0 if admissible else bad + 1
            converged = np.linalg.norm((theta - old) * size) <= 1e-3 * np.linalg.norm(theta * size)
            if converged or bad == patience:
                break
        x = 0.5 * respond(data, a, b) + 0.5 * (y - c @ g)
    return theta, admissible


def search_wiener(data: Data, stage: Stage) -> tuple[float, float]:
    """The best of 8 x 8 pairs by (31), and twice of its neighbours at half the distance."""
    ends = data.y.min(), data.y.max()

    def points(angles: tuple[float, float]) -> tuple[float, float]:
        return float(ends[0] * np.sin(angles[0]) ** 2), float(ends[1] * np.sin(angles[1]) ** 2)

    step = np.pi / 18.0
    tried = {angles: loss(data, stage, *points(angles)) for angles in grid(step * np.arange(1.0, 9.0))}
    for _ in range(2):
        step /= 2.0
        centre = min(tried, key=lambda angles: tried[angles])
        for offsets in grid(step * np.arange(-1.0, 2.0)):
            angles = centre[0] + offsets[0], centre[1] + offsets[1]
            if all(0.0 < angle < np.pi / 2.0 for angle in angles):
                tried[angles] = loss(data, stage, *points(angles))
    return points(min(tried, key=lambda angles: tried[angles]))


def grid(values: Array) -> list[tuple[float, float]]:
    """All pairs."""
    return list(itertools.product(values.tolist(), values.tolist()))


def loss(data: Data, stage: Stage, lower: float, upper: float) -> float:
    """The criterion (31); infinite for a pair that is rejected."""
    theta, admissible = iterate_wiener(data, stage, lower, upper, _PATIENCE)
    if not admissible:
        return np.inf
    n, m = stage.n, stage.m
    x = respond(data, theta[:n], np.append(theta[n + m], theta[n : n + m]))
    e = 1.0 - theta[n + m + 1 :]
    # Eq. (32)
    bend = e[1] * lower
    output = np.clip(x, 0.0, upper) + np.maximum(x - upper, 0.0) / e[2]
    output += np.clip(x, bend, 0.0) / e[1] + np.minimum(x - bend, 0.0) / e[0]
    return float(np.sum((data.y - output)[data.start :] ** 2))
