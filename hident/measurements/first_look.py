"""What a record can tell before anything is fitted to it, and what is wrong with it, in words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hident.arrays import Array
from hident.config.suggest import one_of
from hident.numerics.parts import Parts, in_each, longer_than
from hident.records import Record

FEW = 12
"""A signal with at most so many values has levels."""
DEGREES = (1, 2, 3, 5)
LAGS = (1, 2, 5, 10, 20)
CONDITION = 1e3
"""Regressors of a larger condition number tell their coefficients apart badly."""

# Products of columns that depend on each other have eigenvalues of this size by rounding.
_ROUNDING = 1e-13
_SHORT = 200
_LONGEST_AR = 30
_LAGS_OF_DELAY = 200
# The chance that a correlation of nothing is called one, over all lags together.
_CHANCE = 0.01
# A correlation below this share of the largest one does not count as the first.
_MATERIAL = 0.2
# Correlations with later inputs that are this share of those with earlier ones.
_AHEAD = 0.5
# Times the distance from the samples around that one in a hundred exceeds.
_OUTLYING = 4.0
_AROUND = 7
# Shares of the range and of the samples, for what stands at an end of the range.
_EDGE = 0.005
_MANY = 0.005
_COARSE = 0.1
_STILL = 20
_QUIET = 100
_MOVING = 0.1
_ROWS = 10_000


@dataclass(frozen=True, eq=False)
class Signal:
    """One signal of a record; samples are counted from 1."""

    low: float
    high: float
    mean: float
    std: float
    values: int
    """How many different values it has."""
    levels: tuple[float, ...]
    """These values, if they are few."""
    step: float | None
    """The step of its values, if they stand on a grid and are not few."""
    outliers: tuple[int, ...]
    """Samples that are far from those around them."""


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

    ``lags`` and ``values`` have the shape (K,); ``bound`` is what noise exceeds at no lag, at 99 %.
    ``innovations`` is how many samples of equal size would be as many as the whitened input has: few, if it
    jumps seldom.
    """

    lags: NDArray[np.int64]
    values: Array
    bound: float
    innovations: float
    method: str


@dataclass(frozen=True, eq=False)
class Excitation:
    """The condition numbers of the regressors P_i(u(t - k)), i = 1..degree, k = 0..lags - 1.

    P_i are Legendre's polynomials over the range of the input; the columns have the mean zero and the length
    one. ``condition[i, j]`` is that of the i-th degree and the j-th number of lags; infinite where the
    regressors depend on each other.
    """

    degrees: tuple[int, ...]
    lags: tuple[int, ...]
    condition: Array


@dataclass(frozen=True, eq=False)
class FirstLook:
    """What :func:`first_look` finds; ``wrong`` says in sentences what should be known before a fit."""

    samples: int
    experiments: int
    dt: float | None
    input: Signal
    output: Signal
    correlation: Correlation | None
    delay: Delay | None
    excitation: Excitation
    wrong: tuple[str, ...]


def first_look(record: Record) -> FirstLook:
    """What a record can tell before anything is fitted to it.

    Parameters
    ----------
    record : Record
        Measured or simulated; experiments are looked at each by itself.

    Returns
    -------
    FirstLook
        The signals' values, the delay with its interval, what nonlinearities the input can excite, and in
        words what is wrong.

    Examples
    --------
    >>> u = np.sign(np.random.default_rng(0).normal(size=500))
    >>> look = first_look(Record(u, np.convolve(u, [0, 0, 1, 0.5])[:500]))
    >>> (look.delay.low, look.delay.high), look.input.levels
    ((2, 2), (-1.0, 1.0))
    >>> print(look.wrong[0])
    The input has 2 levels: it cannot tell a nonlinearity of degree 2 or more from one of degree 1.
    """
    with np.errstate(all="ignore"):
        parts = record.experiments
        u, y = _scaled(record.u), _scaled(record.y)
        signals = _signal(record.u, u, parts), _signal(record.y, y, parts)
        found = _correlation(u, y, parts)
        delay = None if found is None else _delay(found)
        excitation = _excitation(u, parts)
        wrong = _wrong(record, u, y, signals, found, delay, excitation)
        return FirstLook(len(record), len(parts), record.dt, *signals, found, delay, excitation, tuple(wrong))


def _scaled(x: Array) -> Array:
    """The signal between -1 and 1; zero if it is constant."""
    if not len(x):
        return x
    middle, half = float(np.max(x)) / 2 + float(np.min(x)) / 2, float(np.max(x)) / 2 - float(np.min(x)) / 2
    return (x - middle) / half if half > 0.0 else np.zeros(len(x))


def _signal(raw: Array, x: Array, parts: Parts) -> Signal:
    if not len(raw):
        return Signal(math.nan, math.nan, math.nan, math.nan, 0, (), None, ())
    low, high = float(np.min(raw)), float(np.max(raw))
    values = np.unique(raw)
    few = len(values) <= FEW and len(raw) > 2 * len(values)
    half = high / 2 - low / 2
    step = None if few else _grid(np.unique(x))
    return Signal(
        low,
        high,
        # Sums of large numbers overflow, and their mean does not.
        float(low / 2 + high / 2 + half * np.mean(x)),
        float(half * np.std(x)),
        len(values),
        tuple(values.tolist()) if few else (),
        None if step is None else step * half,
        () if few else _outliers(x, parts),
    )


def _grid(values: Array) -> float | None:
    """The step of sorted values that stand on a grid, up to the rounding of their digits."""
    gaps = np.diff(values)
    gaps = gaps[gaps > 1e-9]
    if len(gaps) < FEW:
        return None
    step = float(np.min(gaps))
    near = gaps[gaps < 20.0 * step]
    if len(near) < FEW:
        return None
    step = float(np.sum(near) / np.sum(np.round(near / step)))
    away = np.abs(near / step - np.round(near / step))
    # Of gaps in general positions a fifth would be as near to a multiple.
    return step if np.max(away) < 0.1 and len(near) > len(gaps) / 2 else None


def _outliers(x: Array, parts: Parts) -> tuple[int, ...]:
    from scipy.ndimage import median_filter

    away = np.abs(x - in_each(parts, lambda part: median_filter(part, _AROUND, mode="nearest"), x))
    moving = away[away > 0.0]
    if len(moving) < len(x) / 4:
        return ()
    return tuple((1 + np.flatnonzero(away > _OUTLYING * np.quantile(moving, 0.99))).tolist())


def _correlation(u: Array, y: Array, parts: Parts) -> Correlation | None:
    """The correlation of y with u; with the square of u if there is none."""
    parts = longer_than(parts, 20)
    if not parts or not np.std(y) > 0.0 or not np.std(u) > 0.0:
        return None
    linear = _prewhitened(u, y, parts, "input")
    if linear is None or _first(linear) is not None:
        return linear
    square = np.square(u - np.mean(u))
    even = _prewhitened(square, y, parts, "square of the input") if np.std(square) > 1e-6 else None
    return even if even is not None and _first(even) is not None else linear


def _prewhitened(x: Array, y: Array, parts: Parts, what: str) -> Correlation | None:
    """Haugh's: what its own autoregression leaves of y, against what another one leaves of x."""
    from scipy.signal import correlate

    shortest = min(part.stop - part.start for part in parts)
    most = min(_LONGEST_AR, shortest // 10)
    driving, p = _whitened(x - np.mean(x), parts, most)
    driven, q = _whitened(y - np.mean(y), parts, most)
    last = min(_LAGS_OF_DELAY, (shortest - most) // 4)
    sums = np.zeros(2 * last + 1)
    for a, b in zip(driving, driven, strict=True):
        full = correlate(b, a, "full", "fft" if len(a) > 500 else "direct")
        sums += full[len(a) - 1 - last : len(a) + last]
    inputs, outputs = np.concatenate(driving), np.concatenate(driven)
    size = math.sqrt(float(inputs @ inputs)) * math.sqrt(float(outputs @ outputs))
    if not size > 0.0:
        return None
    bound = _normal(2 * last + 1) / math.sqrt(len(inputs))
    innovations = float(inputs @ inputs) ** 2 / float(np.sum(inputs**4))
    method = f"cross-correlation with the {what}, prewhitened by autoregressions of orders {p} and {q}"
    return Correlation(np.arange(-last, last + 1), sums / size, bound, innovations, method)


def _whitened(x: Array, parts: Parts, most: int) -> tuple[list[Array], int]:
    """The prediction errors in each part, of one autoregression, and its order."""
    from scipy.signal import lfilter

    a = _autoregression(x, parts, most)
    return [lfilter(a, 1.0, x[part])[most:] for part in parts], len(a) - 1


def _autoregression(x: Array, parts: Parts, most: int) -> Array:
    """Coefficients (1, a_1, ..., a_p) of the order that Schwarz's criterion chooses, by Yule and Walker."""
    n = sum(part.stop - part.start for part in parts)
    r = np.array([sum(x[p][k:] @ x[p][: len(x[p]) - k] for p in parts) for k in range(most + 1)]) / n
    a, variance = np.ones(1), float(r[0])
    best, chosen = math.inf, a
    for p in range(most + 1):
        if p:
            # Levinson's recursion.
            reflection = -float(a @ r[p:0:-1]) / variance
            a = np.append(a, 0.0) + reflection * np.append(a, 0.0)[::-1]
            variance *= 1.0 - reflection**2
        if not variance > 1e-12 * r[0]:
            break
        score = n * math.log(variance) + p * math.log(n)
        if score < best:
            best, chosen = score, a
    return chosen


def _normal(tests: int) -> float:
    """What none of so many standard normal numbers exceeds in size, but by the chance of 1 %."""
    from scipy.special import ndtri

    return float(-ndtri(_CHANCE / 2 / tests))


def _first(found: Correlation) -> int | None:
    """The first lag from 0 with a correlation."""
    there = np.flatnonzero((found.lags >= 0) & (np.abs(found.values) > found.bound))
    return int(found.lags[there[0]]) if len(there) else None


def _delay(found: Correlation) -> Delay | None:
    high = _first(found)
    if high is None:
        return None
    size = np.abs(found.values[found.lags >= 0])
    # Only the lags up to that one are in question.
    narrower = found.bound * _normal(high + 1) / _normal(len(found.lags))
    low = int(np.flatnonzero(size + narrower >= _MATERIAL * np.max(size))[0])
    if found.bound < _MATERIAL * np.max(size):
        # Where the bound is small, what is surely there may still be too small to count.
        high = max(high, int(np.flatnonzero(size - found.bound >= _MATERIAL * np.max(size))[0]))
    return Delay(low, max(low, high), found.method)


def _excitation(u: Array, parts: Parts) -> Excitation:
    from numpy.polynomial.legendre import legvander

    condition = np.full((len(DEGREES), len(LAGS)), math.inf)
    basis = np.asarray(legvander(u, max(DEGREES))[:, 1:], dtype=float)
    for j, lags in enumerate(LAGS):
        rows = _lagged(basis, longer_than(parts, lags), lags)
        if not len(rows):
            continue
        columns = rows.reshape(len(rows), -1) - rows.mean(axis=0).reshape(-1)
        products = (columns.T @ columns / len(rows)).reshape((lags, max(DEGREES)) * 2)
        for i, degree in enumerate(DEGREES):
            if len(rows) > degree * lags:
                chosen = products[:, :degree, :, :degree].reshape(degree * lags, degree * lags)
                condition[i, j] = _condition(chosen)
    return Excitation(DEGREES, LAGS, condition)


def _lagged(basis: Array, parts: Parts, lags: int) -> Array:
    """The basis at t - k, shape (rows, lags, functions); of long records an even share of the rows."""
    t = np.concatenate([np.zeros(0, int), *(np.arange(part.start + lags - 1, part.stop) for part in parts)])
    t = t[:: max(1, -(-len(t) // _ROWS))]
    return basis[t[:, None] - np.arange(lags)]


def _condition(products: Array) -> float:
    """The condition number of columns of length one, from their mean products (K, K)."""
    lengths = np.sqrt(np.diag(products))
    # A function that is the same at all levels has no column.
    if not (lengths > 1e-9).all():
        return math.inf
    squares = np.linalg.eigvalsh(products / np.outer(lengths, lengths))
    return math.sqrt(squares[-1] / squares[0]) if squares[0] > _ROUNDING * squares[-1] else math.inf


def _wrong(
    record: Record,
    u: Array,
    y: Array,
    signals: Sequence[Signal],
    found: Correlation | None,
    delay: Delay | None,
    excitation: Excitation,
) -> Iterator[str]:
    if len(record) < _SHORT:
        yield f"The record has {len(record)} samples only: expect wide errors, and keep the model small."
    for what, signal in zip(("input", "output"), signals, strict=True):
        if signal.values == 1:
            yield f"The {what} is constant ({signal.low:g}): nothing can be identified."
    if 1 in (signals[0].values, signals[1].values):
        return
    yield from _of_excitation(signals[0], excitation)
    yield from _of_delay(found, delay)
    whose = [f" of '{name}'" for name in record.parts] or [""]
    for of, part in zip(whose, record.experiments, strict=True):
        rest = _at_rest(u[part], y[part])
        for first, last in rest:
            yield (
                f"Samples {first + 1} to {last}{of} repeat one value in both signals: a rest, or "
                "padding; it tells nothing of the dynamics."
            )
        quiet = _quiet(u[part])
        if quiet and not rest and not signals[0].levels:
            yield (
                f"The input{of} hardly moves until sample {quiet} (by less than {_MOVING:g} of its standard "
                "deviation): leave these samples out."
            )
        yield from _of_stillness(u[part], y[part], of)
        yield from _of_repetition(u[part], y[part], of)
        yield from _of_saturation(u[part], y[part], rest, signals[1], of)
    for what, signal in zip(("input", "output"), signals, strict=True):
        if signal.step is not None and signal.step > _COARSE * signal.std:
            yield (
                f"The {what} moves in steps of {signal.step:g}, {signal.step / signal.std:.2g} of its "
                "standard deviation: quantisation is a good part of its noise."
            )
        if signal.outliers:
            shown = one_of(map(str, signal.outliers[:5]))
            more = f" and {len(signal.outliers) - 5} more" if len(signal.outliers) > 5 else ""
            yield f"The {what} is far from the samples around it at sample {shown}{more}: look for outliers."


def _of_excitation(signal: Signal, excitation: Excitation) -> Iterator[str]:
    if signal.levels:
        most = len(signal.levels) - 1
        yield (
            f"The input has {len(signal.levels)} levels: it cannot tell a nonlinearity of degree "
            f"{most + 1} or more from one of degree {most}."
        )
    linear = excitation.condition[0]
    if (singular := np.isinf(linear)).any():
        yield (
            f"The input cannot excite {excitation.lags[int(np.argmax(singular))]} lags, not even of a linear "
            "model."
        )
        return
    levels = len(signal.levels) or math.inf
    for degree, row in zip(excitation.degrees, excitation.condition, strict=True):
        if degree >= levels:
            return
        if (bad := row > CONDITION).any():
            lags = excitation.lags[int(np.argmax(bad))]
            what = f"a nonlinearity of degree {degree}" if degree > 1 else "a linear model"
            yield (
                f"The input excites {what} over {lags} lags badly (condition number "
                f"{row[int(np.argmax(bad))]:.1g}): it moves too slowly, or too seldom, for its samples."
            )
            return


def _of_delay(found: Correlation | None, delay: Delay | None) -> Iterator[str]:
    if found is None:
        return
    if delay is None:
        yield "The output is not correlated with the input or its square: are these the right columns?"
    before = float(np.max(np.abs(found.values[found.lags < 0]), initial=0.0))
    after = float(np.max(np.abs(found.values[found.lags >= 0])))
    # Where the input jumps seldom, its jumps go together by chance.
    by_chance = 4.0 / math.sqrt(found.innovations)
    if before > max(found.bound, by_chance * after, _AHEAD * after):
        yield (
            "The output is correlated with later inputs: is there feedback, or are the input and the output "
            "exchanged?"
        )


def _runs(x: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where the runs of equal values begin and end (exclusive)."""
    ends = np.append(np.flatnonzero(np.diff(x) != 0.0) + 1, len(x))
    return np.concatenate([[0], ends[:-1]]), ends


def _at_rest(u: Array, y: Array) -> list[tuple[int, int]]:
    """The stretches at the beginning and the end of an experiment in which neither signal moves."""
    moving = np.flatnonzero((np.diff(u) != 0.0) | (np.diff(y) != 0.0))
    if not len(moving):
        return [(0, len(u))]
    ends = [(0, int(moving[0]) + 1), (int(moving[-1]) + 1, len(u))]
    return [(first, last) for first, last in ends if last - first >= _STILL]


def _quiet(u: Array) -> int:
    """How many samples at the beginning, if they are many, the input stays where it starts."""
    away = np.abs(u - np.median(u[:_STILL])) > _MOVING * np.std(u)
    away[0] = False
    until = int(np.argmax(away)) if away.any() else 0
    return until if until >= max(_QUIET, len(u) / 100) else 0


def _of_stillness(u: Array, y: Array, of: str) -> Iterator[str]:
    """A sensor or a logger that stood still: a run of equal outputs while the input moves."""
    starts, ends = _runs(y)
    lengths = ends - starts
    long = np.flatnonzero(lengths >= max(_STILL, 20.0 * float(np.median(lengths))))
    for first, last in zip(starts[long].tolist(), ends[long].tolist(), strict=True):
        # At an end of its range, the output is saturated.
        inside = first > 0 and last < len(y) and abs(y[first]) < 1.0
        if inside and np.ptp(u[first:last]) > np.std(u):
            yield (
                f"The output stands still from sample {first + 1} to {last}{of} while the input moves: "
                "did the sensor or the logger stop?"
            )


def _of_repetition(u: Array, y: Array, of: str) -> Iterator[str]:
    starts, ends = _runs(y)
    lengths = ends - starts
    each = int(np.median(lengths))
    distinct = len(np.unique(y))
    if each >= 2 and np.mean(lengths == each) > 0.8 and distinct > 0.5 * len(lengths) and len(lengths) > FEW:
        inputs = np.diff(u)
        said = "" if np.count_nonzero(inputs) < len(lengths) * 1.2 else ", and the input does not"
        yield (
            f"The output{of} repeats each value {each} times{said}: the logger is faster than the sensor "
            f"(keep every {each}th sample)."
        )


def _of_saturation(
    u: Array, y: Array, rest: Sequence[tuple[int, int]], output: Signal, of: str
) -> Iterator[str]:
    """Many samples at an end of the output's range, in runs through which the input moves."""
    moving = np.ones(len(y), dtype=bool)
    for first, last in rest:
        moving[first:last] = False
    half = output.high / 2 - output.low / 2
    width = max(2 * _EDGE, 0.0 if output.step is None else 1.01 * output.step / half)
    for sign, word in ((1.0, "highest"), (-1.0, "lowest")):
        depth = 1.0 - sign * y
        there = moving & (depth <= width)
        count = int(np.count_nonzero(there))
        next_to_it = int(np.count_nonzero(moving & (depth > width) & (depth <= 2 * width)))
        if count < max(10, _MANY * len(y)) or count < 3 * next_to_it:
            continue
        edges = np.flatnonzero(np.diff(np.concatenate([[0], there.astype(int), [0]])))
        longest = max(pairwise(edges), key=lambda run: there[run[0]] * (run[1] - run[0]))
        run = slice(*(int(edge) for edge in longest))
        if run.stop - run.start >= 5 and np.count_nonzero(np.diff(u[run])) >= 2:
            share = count / len(y)
            yield (
                f"The output{of} stands at its {word} value ({output.high if sign > 0 else output.low:g}) in "
                f"{100 * share:.2g} % of the samples while the input moves: the sensor or the process is "
                "saturated there."
            )
