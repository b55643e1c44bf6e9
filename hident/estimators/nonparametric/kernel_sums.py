"""Kernel-weighted sums over sorted samples, exact and in O((N + M) log N).

All classes take samples sorted by u and, at sorted points x, return the sums over k of y_k K((u_k - x)/h)
and of K((u_k - x)/h), shape (M,) each; the second is 0 where x has no sample. ``weights`` are single terms
K((u - x)/h) at points x (M,), and ``reach`` is how far from x a sample counts as one.

For kernels other than windows, samples are collected in boxes [i w, (i + 1) w) whose width w is a power of
two near h. Then a sample's box and its place in the box, t = u/w - i - 1/2, come without rounding, however
large the range of u is against h.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from hident.arrays import Array, Index

_BLOCK = 2**15

# The Gaussian's expansions: (X - d)^j and exp(d X) in powers of X, both without the powers of d.
_TERMS = 30
_ORDERS = range(_TERMS)
_LAG = np.abs(np.subtract.outer(_ORDERS, _ORDERS))
_SHIFT = np.array([[(-1.0) ** (j - r) * math.comb(j, r) for r in _ORDERS] for j in _ORDERS])
_EXPONENTIAL = np.array([[1 / math.factorial(i - r) if i >= r else 0.0 for i in _ORDERS] for r in _ORDERS])


class PrefixSums:
    """Sums of x over index ranges, from one pass over ``x`` (N,).

    In 64-bit fixed point, so that sums don't depend on what lies before the range: each x is rounded to
    N max|x| 2^-63, and nothing else is.
    """

    def __init__(self, x: Array) -> None:
        largest = float(max(x.max(), -x.min()))
        bits = 62 - math.frexp(largest * len(x))[1]
        self._unit = 2.0 ** -min(bits, 1000)
        self._sums = np.zeros(len(x) + 1, dtype=np.int64)
        for first in range(0, len(x), _BLOCK):
            fixed = np.rint(x[first : first + _BLOCK] / self._unit)
            sums = self._sums[first + 1 : first + 1 + len(fixed)]
            np.cumsum(fixed, out=sums, dtype=np.int64)
            sums += self._sums[first]

    def between(self, start: Index | int, stop: Index | int) -> Array:
        """The sums of x[start:stop] for arrays of indices."""
        return np.asarray((self._sums[stop] - self._sums[start]) * self._unit)


@dataclass(frozen=True)
class Window:
    """The kernel that is 1 for abs(x) < reach, and at the ends too if ``closed``, and 0 elsewhere."""

    reach: float
    closed: bool


class WindowSums:
    """Sums for a window, from prefix sums of y."""

    def __init__(self, u: Array, y_sums: PrefixSums, window: Window, bandwidth: float) -> None:
        self._u, self._y_sums = u, y_sums
        self.reach = window.reach * bandwidth
        self._closed = window.closed
        self._sides: tuple[Any, Any] = ("left", "right") if window.closed else ("right", "left")

    def __call__(self, points: Array) -> tuple[Array, Array]:
        start = _search(self._u, points - self.reach, self._sides[0])
        stop = _search(self._u, points + self.reach, self._sides[1])
        return self._y_sums.between(start, stop), (stop - start).astype(float)

    def weights(self, u: Array, points: Array) -> Array:
        low, high = points - self.reach, points + self.reach
        inside = (low <= u) & (u <= high) if self._closed else (low < u) & (u < high)
        return inside.astype(float)


@dataclass(frozen=True)
class PiecewiseKernel:
    """A kernel that is a polynomial between consecutive edges, ends included, and zero elsewhere.

    ``pieces`` holds each polynomial's coefficients, constant first. All edges lie within [-1, 1].
    """

    edges: tuple[float, ...]
    pieces: tuple[tuple[float, ...], ...]

    @property
    def degree(self) -> int:
        return len(self.pieces[0]) - 1

    def __call__(self, x: Array) -> Array:
        """K(x) for x inside the window."""
        piece = np.searchsorted(self.edges[1:-1], x, side="right")
        coefficients = np.array(self.pieces)[piece].T
        return np.asarray(np.maximum(np.polynomial.polynomial.polyval(x, coefficients, tensor=False), 0.0))


class PiecewiseSums:
    """Sums for a piecewise polynomial kernel, from prefix sums of the local moments t^r y and t^r.

    Where only samples close to the window's edges count (weights of less than 0.01 on average), the moments
    would lose digits, and the few samples are summed directly.
    """

    def __init__(
        self, u: Array, y: Array, y_sums: PrefixSums, kernel: PiecewiseKernel, bandwidth: float
    ) -> None:
        self._u, self._y, self._kernel, self._bandwidth = u, y, kernel, bandwidth
        self.reach = kernel.edges[-1] * bandwidth
        # A window of half-width h touches no more than its own box and two neighbours.
        self._width = 2.0 ** math.ceil(math.log2(bandwidth))
        self._moments: list[tuple[PrefixSums, PrefixSums | None]] = [(y_sums, None)]
        t = _place(u, self._width)
        power = np.ones_like(t)
        for _ in range(kernel.degree):
            power *= t
            self._moments.append((PrefixSums(power * y), PrefixSums(power)))

    def __call__(self, points: Array) -> tuple[Array, Array]:
        weighted, weight = np.zeros(len(points)), np.zeros(len(points))
        last = self._kernel.edges[-1]
        bounds = [
            _search(self._u, points + edge * self._bandwidth, "right" if edge == last else "left")
            for edge in self._kernel.edges
        ]
        for first, after, offset in self._boxes(points):
            for piece, (start, stop) in zip(self._kernel.pieces, pairwise(bounds), strict=True):
                low, high = np.clip(start, first, after), np.clip(stop, first, after)
                for (y_sums, sums), factor in zip(self._moments, self._factors(piece, offset), strict=True):
                    weighted += factor * y_sums.between(low, high)
                    weight += factor * ((high - low) if sums is None else sums.between(low, high))
        self._sum_directly(points, bounds[0], bounds[-1], weighted, weight)
        return weighted, weight

    def weights(self, u: Array, points: Array) -> Array:
        low, high = (
            points + edge * self._bandwidth for edge in (self._kernel.edges[0], self._kernel.edges[-1])
        )
        return np.where((low <= u) & (u <= high), self._kernel((u - points) / self._bandwidth), 0.0)

    def _boxes(self, points: Array) -> Iterator[tuple[Index, Index, Array]]:
        """The boxes about each point: first sample, first sample after, and d in (u - x)/w = t + d."""
        box = np.floor(points / self._width)
        place = _place(points, self._width)
        first = _search(self._u, (box - 1.0) * self._width)
        for neighbour in (-1.0, 0.0, 1.0):
            after = _search(self._u, (box + neighbour + 1.0) * self._width)
            yield first, after, neighbour - place
            first = after

    def _factors(self, piece: tuple[float, ...], offset: Array) -> Iterator[Array]:
        """The coefficients of t^0, t^1, ... in the polynomial at (u - x)/h = (t + offset) w/h."""
        scaled = [c * (self._width / self._bandwidth) ** m for m, c in enumerate(piece)]
        for r in range(len(scaled)):
            terms = (scaled[m] * math.comb(m, r) * offset ** (m - r) for m in range(r, len(scaled)))
            yield sum(terms, start=np.zeros_like(offset))

    def _sum_directly(self, points: Array, start: Index, stop: Index, weighted: Array, weight: Array) -> None:
        """Replace the sums, in place, where the weights are small."""
        weight[start == stop] = 0.0
        for i in np.flatnonzero((stop > start) & (weight < 0.01 * (stop - start))):
            near = slice(start[i], stop[i])
            weights = self._kernel((self._u[near] - points[i]) / self._bandwidth)
            weighted[i], weight[i] = weights @ self._y[near], weights.sum()


class GaussianSums:
    """Sums for the Gaussian kernel by a fast Gauss transform with local expansions.

    With X = (x - c)/h about the centre c of x's box, and a sample at T about the centre of a box d bandwidths
    away,

        exp(-(X - d - T)^2/2) = exp(-X^2/2) exp(d X - d^2/2) [exp(-T^2/2) exp((X - d) T)],

    the bracket expands in powers of X - d with the moments exp(-T^2/2) T^j/j!, and the whole in powers of X.
    Truncated where terms fall below 1e-13 of the sum. A point without a sample within 8.5 bandwidths (a
    weight of 2e-16) counts as having none.
    """

    _REACH = 8.5
    _FARTHEST = 12.0

    def __init__(self, u: Array, y: Array, bandwidth: float) -> None:
        self._u, self._bandwidth = u, bandwidth
        self.reach = self._REACH * bandwidth
        # Small boxes keep |T| and |X| below 3/8, so that few terms do and little cancels.
        self._width = 2.0 ** math.floor(math.log2(0.75 * bandwidth))
        self._spacing = self._width / bandwidth
        boxes = np.floor(u / self._width)
        starts = _run_starts(boxes)
        self._boxes = boxes[starts]
        t = _place(u, self._width) * self._spacing
        term = np.exp(-0.5 * t**2) / math.sqrt(2.0 * math.pi)
        self._moments = np.empty((2, len(starts), _TERMS))
        for j in range(_TERMS):
            self._moments[0, :, j] = np.add.reduceat(term * y, starts)
            self._moments[1, :, j] = np.add.reduceat(term, starts)
            term *= t
            term /= j + 1

    def __call__(self, points: Array) -> tuple[Array, Array]:
        boxes = np.floor(points / self._width)
        starts = _run_starts(boxes)
        expansions = self._local_expansions(boxes[starts])
        counts = np.diff(starts, append=len(points))
        x = _place(points, self._width) * self._spacing
        sums = np.zeros((2, len(points)))
        for coefficients in expansions[::-1]:
            sums *= x
            sums += np.repeat(coefficients, counts, axis=1)
        sums *= np.exp(-0.5 * x**2)
        near = points - self.reach, points + self.reach
        alone = _search(self._u, near[0]) == _search(self._u, near[1], "right")
        sums[1, alone] = 0.0
        return sums[0], sums[1]

    def weights(self, u: Array, points: Array) -> Array:
        return np.exp(-0.5 * ((u - points) / self._bandwidth) ** 2) / math.sqrt(2.0 * math.pi)

    def _local_expansions(self, boxes: Array) -> Array:
        """The coefficients of X^l of both sums about the centres of the boxes: shape (terms, 2, boxes)."""
        local = np.zeros((2, len(boxes), _TERMS))
        neighbours = math.ceil(self._FARTHEST / self._spacing) + 1
        for neighbour in range(-neighbours, neighbours + 1):
            at = np.searchsorted(self._boxes, boxes + neighbour)
            at[at == len(self._boxes)] = 0
            found = self._boxes[at] == boxes + neighbour
            if found.any():
                local[:, found] += self._moments[:, at[found]] @ _translation(neighbour * self._spacing)
        return np.ascontiguousarray(np.moveaxis(local, 2, 0))


def _translation(d: float) -> Array:
    """Row j holds the coefficients of X^0, X^1, ... in (X - d)^j exp(d X - d^2/2)."""
    powers = (d ** np.arange(_TERMS))[_LAG]
    return np.asarray(math.exp(-0.5 * d**2) * ((_SHIFT * powers) @ (_EXPONENTIAL * powers)))


def _search(u: Array, points: Array, side: Any = "left") -> Index:
    """``np.searchsorted`` for increasing points: a search between the first and the last of them."""
    first, last = np.searchsorted(u, points[[0, -1]], side)
    return np.asarray(first + np.searchsorted(u[first:last], points, side))


def _place(u: Array, width: float) -> Array:
    """The place in the box, in box widths from its centre: in [-1/2, 1/2)."""
    scaled = u / width
    return np.asarray(scaled - np.floor(scaled) - 0.5)


def _run_starts(x: Array) -> Index:
    """The indices at which the runs of equal values of a sorted array begin."""
    return np.flatnonzero(np.concatenate(([True], x[1:] != x[:-1])))
