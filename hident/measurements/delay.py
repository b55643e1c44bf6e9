"""The delay of a record, by the correlation of its output with its input."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
from numpy.typing import NDArray

from hident.arrays import Array
from hident.measurements.signal_values import scaled
from hident.numerics.autoregression import yule_walker
from hident.numerics.parts import Parts, longer_than
from hident.records import Record

_LONGEST_AR = 30
_LAGS_OF_DELAY = 200
# The chance that a correlation of nothing is called one, over all lags together.
_CHANCE = 0.01
# A correlation below this share of the largest one does not count as the first.
_MATERIAL = 0.2
_BY_CHANCE = 4.0


@dataclass(frozen=True)
class Delay:
    """The delay in samples by the cross-correlation of input and output, both prewhitened.

    At a lag below ``low`` the correlation is less than a fifth of the largest one, at ``high`` there is one,
    each at 99 % over the lags in question. The filters are causal: what is the first lag stays the first.
    """

    low: int
    high: int
    method: str


@dataclass(frozen=True, eq=False)
class Correlation:
    """Cross-correlations r(k) of the output at t with the input at t - k, each whitened by its own filter.

    ``lags``, ``values`` and ``bound`` have the shape (K,); noise exceeds the bound at no lag, at 99 %.
    ``innovations`` is how many samples of equal size would be as many as the whitened input has: few, if it
    jumps seldom.
    """

    lags: NDArray[np.int64]
    values: Array
    bound: Array
    innovations: float
    method: str


def delay_of(record: Record) -> tuple[Correlation | None, Delay | None]:
    """The correlation of a record's output with its input, and the delay; None if there is none.

    Examples
    --------
    >>> u = np.random.default_rng(0).normal(size=500)
    >>> _, found = delay_of(Record(u, np.convolve(u, [0, 0, 1, 0.5])[:500]))
    >>> found.low, found.high
    (2, 2)
    """

    def made() -> tuple[Correlation | None, Delay | None]:
        with np.errstate(all="ignore"):
            found = correlation(scaled(record.u), scaled(record.y), record.experiments)
            return found, None if found is None else delay(found)

    return record.once("delay", made)


def correlation(u: Array, y: Array, parts: Parts) -> Correlation | None:
    """The correlation of y with u; with the square of u if there is none."""
    # The shortest part bounds the lags of all.
    longest = max((part.stop - part.start for part in parts), default=0)
    parts = longer_than(parts, max(20, longest // 4))
    if not parts or not np.std(y) > 0.0 or not np.std(u) > 0.0:
        return None
    linear = _prewhitened(u, y, parts, "input")
    if linear is None or first(linear) is not None:
        return linear
    square = np.square(u - np.mean(u))
    even = (
        _prewhitened(square, y, parts, "square of the input") if np.std(square) > 1e-6 * np.var(u) else None
    )
    return even if even is not None and first(even) is not None else linear


def _prewhitened(x: Array, y: Array, parts: Parts, what: str) -> Correlation | None:
    """Haugh's: what its own autoregression leaves of y, against what another one leaves of x."""
    from scipy.signal import correlate

    shortest = min(part.stop - part.start for part in parts)
    most = min(_LONGEST_AR, shortest // 10)
    driving, p = _whitened(x - np.mean(x), parts, most)
    driven, q = _whitened(y - np.mean(y), parts, most)
    last = min(_LAGS_OF_DELAY, (shortest - most) // 4)

    def summed(power: int) -> Array:
        """Sums of products of the signals to a power, at all lags."""
        sums = np.zeros(2 * last + 1)
        for a, b in zip(driving, driven, strict=True):
            full = correlate(b**power, a**power, "full", "fft" if len(a) > 500 else "direct")
            sums += full[len(a) - 1 - last : len(a) + last]
        return sums

    inputs, outputs = np.concatenate(driving), np.concatenate(driven)
    energy = float(inputs @ inputs) * float(outputs @ outputs)
    if not energy > 0.0:
        return None
    size = math.sqrt(energy)
    innovations = float(inputs @ inputs) ** 2 / float(np.sum(inputs**4))
    # Where both signals jump, by a held input, a correlation is a sum of few products at some lags. How few
    # is seen at negative lags, at which nothing is caused; the largest of few large squares is so by chance.
    together = len(inputs) * summed(2) / energy
    most = np.max(together[:last], initial=1.0) / (1.0 + _BY_CHANCE * math.sqrt(2.0 / innovations))
    bound = _normal(2 * last + 1) * np.sqrt(np.clip(together, 1.0, max(most, 1.0)) / len(inputs))
    method = f"cross-correlation with the {what}, prewhitened by autoregressions of orders {p} and {q}"
    return Correlation(np.arange(-last, last + 1), summed(1) / size, bound, innovations, method)


def _whitened(x: Array, parts: Parts, most: int) -> tuple[list[Array], int]:
    """The prediction errors in each part, of one autoregression, and its order."""
    from scipy.signal import lfilter

    a = _autoregression(x, parts, most)
    return [lfilter(a, 1.0, x[part])[most:] for part in parts], len(a) - 1


def _autoregression(x: Array, parts: Parts, most: int) -> Array:
    """Coefficients (1, a_1, ..., a_p) of the order that Schwarz's criterion chooses, by Yule and Walker."""
    models = yule_walker(x, most, parts)
    n = sum(part.stop - part.start for part in parts)
    # What is left of a signal that is exact is rounding.
    known = list(takewhile(lambda model: model.variance > 1e-12 * models[0].variance, models))
    if not known:
        return np.ones(1)
    chosen = min(known, key=lambda model: n * math.log(model.variance) + len(model.a) * math.log(n))
    return np.asarray(np.r_[1.0, -chosen.a])


def _normal(tests: int) -> float:
    """What none of so many standard normal numbers exceeds in size, but by the chance of 1 %."""
    from scipy.special import ndtri

    return float(-ndtri(_CHANCE / 2 / tests))


def first(found: Correlation) -> int | None:
    """The first lag from 0 with a correlation."""
    there = np.flatnonzero((found.lags >= 0) & (np.abs(found.values) > found.bound))
    return int(found.lags[there[0]]) if len(there) else None


def delay(found: Correlation) -> Delay | None:
    """The delay with its interval; None if nothing is correlated."""
    high = first(found)
    if high is None:
        return None
    later = found.lags >= 0
    size, bound = np.abs(found.values[later]), found.bound[later]
    # Only the lags up to that one are in question.
    narrower = bound * _normal(high + 1) / _normal(len(found.lags))
    low = int(np.flatnonzero(size + narrower >= _MATERIAL * np.max(size))[0])
    if len(counting := np.flatnonzero(size - bound >= _MATERIAL * np.max(size))):
        # Where the bound is small, what is surely there may still be too small to count.
        high = max(high, int(counting[0]))
    return Delay(low, max(low, high), found.method)
