"""The time-weighted integral transform over moving horizons.

Chen, Hwang and Chang 2009, section 3 and eq. (24). On a horizon [t_a, t_b] of length eta with the weight
w = (t - t_a)^n (t - t_b)^n the derivatives of a signal need not be known (21): T_0{f^(l)} = (-1)^l T_l{f} for
l = 0, ..., n, where T_l{f} is the integral of w^(l) f (18).

Differs from the paper: w is scaled to (4 s (1 - s))^n with s = (t - t_a)/eta, which peaks at one (the literal
weight spans many powers of ten), and the sign (-1)^l is part of the transform: the transform of order l is
the weighted mean over the horizon of the l-th derivative with respect to time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hident.arrays import Array, Index
from hident.numerics.parts import Parts, whole
from hident.numerics.whole import split, whole_part

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_STENCIL = 6
# Sampling intervals of a horizon: no memory holds more samples.
_LONGEST = 1e12
_SAMPLES_PER_HALF_WAVE = 4
_LARGEST_KEPT = 400_000


def fewest_samples(order: int) -> int:
    """Sampling intervals that a horizon needs: four for each half wave of w^(n), n = ``order``."""
    return _SAMPLES_PER_HALF_WAVE * (order + 1)


@dataclass(frozen=True)
class Knots:
    """Samples of an experiment where a signal may have a kink: ``phase`` + k ``hold``; none for hold 0."""

    hold: int = 0
    phase: int = 0

    @classmethod
    def of(cls, held_input: Array, delay: float, dt: float, parts: Parts | None = None) -> Knots:
        """The knots of the response to a held input (N,) after a delay, counted from each experiment's start.

        They lie as far apart as all changes of the input allow. None are seen if that is less than the
        stencil of an interpolation, or if the delay takes them off the samples.
        """
        inputs = [held_input[part] for part in parts or whole(len(held_input))]
        changes = [np.flatnonzero(np.diff(one)) + 1 for one in inputs]
        hold = int(np.gcd.reduce(np.concatenate(changes), initial=0))
        shift, rest = split(delay / dt)
        return SMOOTH if hold < _STENCIL - 1 or rest else cls(hold, shift % hold)

    def stencils(self, cells: int) -> NDArray[np.int64]:
        """The first sample of the stencil of each cell [i, i + 1], shape (cells,)."""
        cell = np.arange(cells)
        centred = cell - (_STENCIL // 2 - 1)
        if self.hold:
            knot = cell - (cell - self.phase) % self.hold
            centred = np.clip(centred, knot, knot + self.hold + 1 - _STENCIL)
        return np.clip(centred, 0, cells + 1 - _STENCIL)


SMOOTH = Knots()


@dataclass(frozen=True)
class Horizons:
    """Moving horizons (24) over a record of ``samples`` samples; lengths and times are in samples.

    The k-th horizon starts at ``first`` + k ``stride``, rounded to a sample, and is ``length`` intervals
    long; ``order`` is n, the highest derivative. Of several ``experiments`` (start, stop, horizons) each has
    its own horizons, from its own start on, none of which reaches into another; ``count`` is that of all.
    """

    samples: int
    length: int
    first: float
    stride: float
    count: int
    order: int
    dt: float
    experiments: tuple[tuple[int, int, int], ...] = ()

    @classmethod
    def of(
        cls,
        samples: int,
        dt: float,
        *,
        eta: float,
        overlap: float,
        order: int,
        start: float = 0.0,
        parts: Parts | None = None,
    ) -> Horizons:
        """The horizons (24) for a length ``eta``, the fraction ``overlap`` (lambda) and the start t_0.

        Their number is that of the paper's tables: floor((t_f - t_0 - eta)/(lambda eta)), in each of the
        ``parts``, one by default, that is long enough.

        Raises
        ------
        ValueError
            If the sampling is too coarse for the horizon, or the record too short.
        """
        if not eta / dt < _LONGEST:
            raise ValueError(f"the horizon {eta:g} is longer than any record sampled every {dt:g}")
        length = round(eta / dt)
        if length < fewest_samples(order):
            raise ValueError(
                f"the horizon {eta:g} holds {length} sampling intervals of {dt:g}, and order {order} needs "
                f"{fewest_samples(order)}: take a horizon of at least {fewest_samples(order) * dt:g} "
                f"or a sampling interval of at most {eta / fewest_samples(order):g}"
            )
        parts = parts or whole(samples)
        end = (max(part.stop - part.start for part in parts) - 1) * dt
        if start >= end:
            raise ValueError(
                f"the start {start:g} lies after the record's end {end:g}: take an earlier start"
            )
        counts = [
            max(int(whole_part(((part.stop - part.start - 1) * dt - start - eta) / (overlap * eta))), 0)
            for part in parts
        ]
        if not any(counts):
            raise ValueError(
                f"the horizon {eta:g} is too long for the record: it spans {end - start:g} from the start "
                f"{start:g}, and {(1.0 + overlap) * eta:g} is the least that holds one horizon"
            )
        experiments = tuple((part.start, part.stop, n) for part, n in zip(parts, counts, strict=True))
        return cls(samples, length, start / dt, overlap * length, sum(counts), order, dt, experiments)

    @property
    def eta(self) -> float:
        """The length of a horizon, in the unit of dt."""
        return self.length * self.dt

    def require(self, parameters: int) -> None:
        """Raise ValueError if there are fewer horizons than parameters."""
        if self.count < parameters:
            raise ValueError(
                f"{self.count} horizons are fewer than the {parameters} parameters: take a shorter horizon, "
                "a smaller overlap step or a longer record"
            )

    @property
    def parts(self) -> Parts:
        """Where the experiments stand."""
        return tuple(slice(begin, end) for begin, end, _ in self.experiments)

    @cached_property
    def starts(self) -> NDArray[np.int64]:
        """The first sample of each horizon, shape (count,)."""
        found = []
        for begin, end, count in self.experiments:
            exact = np.rint(self.first + self.stride * np.arange(count)).astype(np.int64)
            found.append(begin + np.minimum(exact, end - begin - 1 - self.length))
        return np.concatenate(found)

    @cached_property
    def constant(self) -> Array:
        """The transform of order 0 of the signal 1, shape (count,); the others are zero."""
        antiderivative = _weight_derivative(self.order, 0).integ() / 2.0
        return np.full(self.count, antiderivative(1.0) - antiderivative(-1.0))

    @cached_property
    def bounds(self) -> NDArray[np.int64]:
        """Where each horizon's experiment begins and ends, shape (2, count)."""
        begins, ends, counts = np.array(self.experiments).T
        return np.repeat(np.array([begins, ends]), counts, axis=1)

    def sampled(self, knots: Knots = SMOOTH) -> csr_array:
        """The operator for signals given by samples of a function that is smooth between the ``knots``.

        Returns
        -------
        sparse array, shape ((n + 1) count, samples)
            Row l count + k is the l-th derivative with respect to time, weighted and integrated over
            horizon k. Local polynomials of degree 5 through the samples are integrated exactly; they do
            not reach across a knot.
        """
        return _kept(_sampled, self, knots)

    def held(self, delay: float = 0.0) -> csr_array:
        """The operator for signals held from sample to sample and delayed by ``delay``, as :meth:`sampled`.

        Exact. Before each experiment the signal is zero.
        """
        return _kept(_held, self, delay)

    def operator(self, weights: Array, kind: Index, shift: int) -> csr_array:
        """The operator with rows ``weights`` (n + 1, kinds, width) from every start + ``shift`` on.

        ``kind`` (count,) tells which weights a horizon has.
        """
        from scipy.sparse import csr_array

        orders, _, width = weights.shape
        rows = orders * self.count
        # A sparse array copies all indices that are not of one type.
        index = np.dtype(np.int32 if rows * width <= np.iinfo(np.int32).max else np.int64)
        columns = np.add.outer(self.starts + shift, np.arange(width), dtype=index, casting="same_kind")
        begins, ends = self.bounds[..., None]
        outside = (columns < begins) | (columns >= ends)
        np.clip(columns, 0, self.samples - 1, out=columns)
        data = np.take(weights / self.eta ** np.arange(orders)[:, None, None], kind, axis=1)
        data[:, outside] = 0.0
        ends = np.arange(0, (rows + 1) * width, width, dtype=index)
        return csr_array((data.ravel(), np.tile(columns.ravel(), orders), ends), shape=(rows, self.samples))

    def held_runs(self, held_input: Array, delay: float, orders: int) -> tuple[csr_array, Array]:
        """The operator for functions of a held input, and the levels (runs,) of that input.

        Applied to the values of a function at the levels, it gives the transforms of orders 0 to
        ``orders`` - 1 of that function of the delayed input.
        """
        from scipy.sparse import csr_array

        changes = np.flatnonzero(np.diff(held_input, prepend=np.nan))
        run = np.repeat(np.arange(len(changes)), np.diff(changes, append=len(held_input)))
        ends = np.arange(len(held_input) + 1)
        belongs = csr_array((np.ones(len(held_input)), run, ends), shape=(len(run), len(changes)))
        return self.held(delay)[: orders * self.count] @ belongs, held_input[changes]

    def transform(self, operator: csr_array, signals: Array) -> Array:
        """All transforms (n + 1, count) of a signal (columns,); with a last axis J for J signals."""
        return np.asarray(operator @ signals).reshape(-1, self.count, *signals.shape[1:])


def _sampled(horizons: Horizons, knots: Knots) -> csr_array:
    length, order, starts = horizons.length, horizons.order, horizons.starts
    begins, ends = horizons.bounds
    # Horizons that lie alike among the knots have the same weights, except next to an experiment's ends.
    inner = (starts - begins >= _STENCIL) & (starts + length + _STENCIL <= ends)
    alike = np.where(inner, (starts - begins - knots.phase) % max(knots.hold, 1), -1 - starts)
    _, some, kind = np.unique(alike, return_index=True, return_inverse=True)
    # A horizon's stencils reach at most this far out of it.
    reach, width = _STENCIL, length + 1 + 2 * _STENCIL
    cells = starts[some, None] + np.arange(length)
    stencils = np.zeros(horizons.samples, dtype=np.int64)
    for begin, end, _ in horizons.experiments:
        stencils[begin : end - 1] = begin + knots.stencils(end - begin - 1)
    first = stencils[cells]
    columns = first[..., None] + np.arange(_STENCIL) - (starts[some, None, None] - reach)
    flat = (columns + width * np.arange(len(some))[:, None, None]).ravel()
    weights = [
        np.bincount(flat, one[np.arange(length), cells - first].ravel(), len(some) * width)
        for one in _moments(length, order)
    ]
    return horizons.operator(np.reshape(weights, (order + 1, len(some), width)), kind, -reach)


def _held(horizons: Horizons, delay: float) -> csr_array:
    whole, rest = split(delay / horizons.dt)
    edges = np.clip((np.arange(-1, horizons.length + 1) + rest) / horizons.length, 0.0, 1.0)
    alike = np.zeros(horizons.count, dtype=np.intp)
    return horizons.operator(_held_weights(edges, horizons.order)[:, None], alike, -whole - 1)


@lru_cache(maxsize=32)
def _remembered(build: Callable[..., csr_array], *arguments: Any) -> csr_array:
    return build(*arguments)


def _kept(build: Callable[..., csr_array], horizons: Horizons, *arguments: Any) -> csr_array:
    """The operator, kept for the next trial unless it is large: trials of one case share it."""
    entries = (horizons.order + 1) * horizons.count * horizons.length
    if entries > _LARGEST_KEPT:
        return build(horizons, *arguments)
    return _remembered(build, horizons, *arguments)


def _weight_derivative(order: int, derivative: int) -> np.polynomial.Polynomial:
    """The derivative of w with respect to s, as a polynomial in z = 2 s - 1, where w = (1 - z^2)^n."""
    w = np.polynomial.Polynomial([1.0, 0.0, -1.0]) ** order
    return w.deriv(derivative) * 2.0**derivative


@lru_cache(maxsize=32)
def _moments(length: int, order: int) -> Array:
    """The integrals of w^(l) times Lagrange polynomials, shape (n + 1, length, places, stencil).

    The second axis is the cell of the horizon, the third the place of the cell in its stencil.
    """
    nodes, gauss = np.polynomial.legendre.leggauss(order + _STENCIL // 2)
    nodes, gauss = (nodes + 1.0) / 2.0, gauss / 2.0
    points = np.arange(_STENCIL)
    at = np.arange(_STENCIL - 1)[:, None] + nodes
    lagrange = np.stack(
        [np.prod([(at - q) / (p - q) for q in points if q != p], axis=0) for p in points], axis=-1
    )
    z = 2.0 * (np.arange(length)[:, None] + nodes) / length - 1.0
    signs = (-1.0) ** np.arange(order + 1)
    w = np.array([_weight_derivative(order, derivative)(z) for derivative in range(order + 1)])
    moments = np.einsum("l,lcg,g,ogp->lcop", signs / length, w, gauss, lagrange)
    moments.flags.writeable = False
    return np.asarray(moments)


def _held_weights(edges: Array, order: int) -> Array:
    """The integrals between the ``edges`` (width + 1,), in horizons, shape (n + 1, width)."""
    z = 2.0 * edges - 1.0
    rows = []
    for derivative in range(order + 1):
        antiderivative = (
            _weight_derivative(order, derivative - 1)
            if derivative
            else _weight_derivative(order, 0).integ() / 2.0
        )
        rows.append((-1.0) ** derivative * np.diff(antiderivative(z)))
    return np.asarray(rows)
