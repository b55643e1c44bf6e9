"""What is wrong with a record, in sentences."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hident.arrays import Array
from hident.config.suggest import one_of
from hident.measurements.delay import Correlation, Delay
from hident.measurements.excitation import CONDITION, Excitation
from hident.measurements.signal_values import FEW, Signal
from hident.records import Record

_SHORT = 200
# Numbers that programs write where there is no sample: nines, and the ends of the whole numbers.
_KNOWN_CODE = re.compile(r"9{2,}(\.9+)?|32767|32768|65535|2147483647|2147483648|4294967295")
_HUGE = 1e20
# How far outside of the others a code lies, in their range: a known one, and another one.
_OUTSIDE, _FAR = 1.0, 10.0
_SEVERAL = 3
# Correlations with later inputs that are this share of those with earlier ones.
_AHEAD = 0.5
# Shares of the range and of the samples, for what stands at an end of the range.
_EDGE = 0.005
_MANY = 0.005
_COARSE = 0.1
_STILL = 20
_QUIET = 100
# The standard deviation beside the level, of which a computation in 16 digits keeps too few.
_ROUNDED = 1e-7
_MOVING = 0.1


def suspicions(
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
    codes = [*_of_codes("input", record.u), *_of_codes("output", record.y)]
    if codes:
        # All else would be said of the codes.
        yield from codes
        return
    for what, signal in zip(("input", "output"), signals, strict=True):
        if signal.std < _ROUNDED * abs(signal.mean):
            yield (
                f"The {what} varies by {signal.std / abs(signal.mean):.1g} of its level ({signal.mean:.4g}): "
                "few digits are left of what it tells: take the level off (--detrend mean)."
            )
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


def _of_codes(what: str, x: Array) -> Iterator[str]:
    """Values that stand for missing samples: exactly repeated, far outside of the others."""
    found: dict[float, int] = {}
    while (code := _code(x)) is not None:
        found[code] = int(np.count_nonzero(x == code))
        x = x[x != code]
    if not found:
        return
    values = " and ".join(f"{code:.10g} in {count} samples" for code, count in found.items())
    named = [f"{code:.10g}" for code in found]
    written = named[0] if len(named) == 1 else f"[{', '.join(named)}]"
    several = "these look like codes" if len(named) > 1 else "this looks like a code"
    yield (
        f"The {what} is {values}, far outside of its other values ({np.min(x):.4g} to {np.max(x):.4g}): "
        f"{several} for missing samples. 'missing: {written}' with 'gaps: split' (--missing "
        f"{','.join(named)} --gaps split) leaves them out; what else can be told of the record is told then."
    )


def _code(x: Array) -> float | None:
    """The value at an end of the range that looks like a code; None if there is none."""
    for code in (float(np.min(x)), float(np.max(x))):
        rest = x[x != code]
        count = len(x) - len(rest)
        if len(rest) < len(x) / 2 or not (spread := float(np.ptp(rest))) > 0.0:
            continue
        away = float(np.min(np.abs(rest - code))) / spread
        is_known = _KNOWN_CODE.fullmatch(f"{abs(code):.15g}") or abs(code) >= _HUGE
        # Of a few levels one may lie apart; a code among them must be one that is known.
        is_told = away > _OUTSIDE if is_known else away > _FAR and len(np.unique(rest)) > FEW
        if is_told and count >= (1 if is_known and away > _FAR else _SEVERAL):
            return code
    return None


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
    size = np.abs(found.values)
    after = float(np.max(size[found.lags >= 0]))
    # Where the input jumps seldom, its jumps go together by chance.
    by_chance = 4.0 / math.sqrt(found.innovations)
    if np.any((size > np.maximum(found.bound, max(by_chance, _AHEAD) * after))[found.lags < 0]):
        yield (
            "The output is correlated with later inputs: is there feedback, or are the input and the output "
            "exchanged? Or is the input late, by its clock or its logger?"
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
