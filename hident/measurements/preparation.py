"""What is done to measured samples before they are used; each step only if it was asked for.

The order is: a range of the samples, parts between gaps, even times, offset or trend, decimation.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from hident.arrays import Array
from hident.numerics.parts import joined
from hident.records import Held, Part, Record

Trend = Literal["mean", "linear"]

_RANGE = re.compile(r"(\d*)\.\.(\d*)")
# An interval this many times the usual one is a hole in the times.
_HOLE = 1.5
_SAME = 1e-3
# So many samples made of one are a slip of units.
_FINEST = 1000
# Half the length of the filter before decimation, in samples that are kept, as scipy's decimate has it.
_HALF_LENGTH = 10


@dataclass(frozen=True, eq=False)
class Samples:
    """The samples of one experiment: u and y of shape (N,), every ``dt`` or at the times ``t`` (N,)."""

    name: str
    u: Array
    y: Array
    dt: float | None = None
    t: Array | None = None

    def __len__(self) -> int:
        return len(self.u)

    def at(self, where: slice, name: str = "") -> Samples:
        """Those of its samples that stand there."""
        t = None if self.t is None else self.t[where]
        return replace(self, name=name or self.name, u=self.u[where], y=self.y[where], t=t)


def range_of(text: str) -> tuple[int, int | None]:
    """The first and the last sample, from 1, of a range such as ``801..1000``; None: to the end.

    Raises
    ------
    ValueError
        If it is no range.

    Examples
    --------
    >>> range_of("801..1000"), range_of("801.."), range_of("..800")
    ((801, 1000), (801, None), (1, 800))
    """
    found = _RANGE.fullmatch(text.strip())
    if not found or found[0] == "..":
        raise ValueError("must be a range of samples, the first one being 1, such as 801..1000 or 801..")
    first, last = int(found[1] or 1), int(found[2]) if found[2] else None
    if first < 1 or (last is not None and last < first):
        raise ValueError("must be a range FIRST..LAST with 1 <= FIRST <= LAST")
    return first, last


def within(samples: Samples, text: str | None) -> Samples:
    """The samples of a range; all without one.

    Raises
    ------
    ValueError
        If the experiment has fewer.
    """
    if text is None:
        return samples
    first, last = range_of(text)
    if max(first, last or 1) > len(samples):
        raise ValueError(f"has {len(samples)} samples, fewer than {text} needs")
    return samples.at(slice(first - 1, last))


def between_gaps(samples: Samples) -> list[Samples]:
    """The parts of an experiment without missing samples, numbered from 1 in their names.

    A gap is a sample of u, y or t that is nan, or an interval of 1.5 times the median one. What has fewer
    than two samples is left out.
    """
    missing = np.isnan(samples.u) | np.isnan(samples.y)
    if samples.t is not None:
        missing |= np.isnan(samples.t)
    kept = np.flatnonzero(~missing)
    ends = np.diff(kept) > 1
    if samples.t is not None and len(kept) > 1:
        intervals = np.diff(samples.t[kept])
        ends |= intervals > _HOLE * np.median(intervals)
    runs = [run for run in np.split(kept, np.flatnonzero(ends) + 1) if len(run) > 1]
    if len(runs) == 1:
        return [samples.at(slice(runs[0][0], runs[0][-1] + 1))]
    return [
        samples.at(slice(run[0], run[-1] + 1), f"{samples.name} {number}".strip())
        for number, run in enumerate(runs, 1)
    ]


def at_even_times(samples: Samples, dt: float | None = None) -> Samples:
    """The samples at an even interval, which their times must have unless they are interpolated at ``dt``.

    Between two samples u and y go along a straight line: a signal that is faster than the samples is lost.

    Raises
    ------
    ValueError
        If the times do not increase, or are uneven and no ``dt`` is given.
    """
    t = samples.t
    if t is None:
        return samples
    if len(t) < 2:
        raise ValueError(f"needs at least 2 samples, not {len(t)}")
    _require_increasing(t)
    if dt is None:
        return replace(samples, t=None, dt=_even_interval(t))
    # The last sample counts, up to the rounding of its time.
    steps = (t[-1] - t[0]) / dt * (1.0 + 1e-12)
    if not 1.0 <= steps < _FINEST * len(t):
        raise ValueError(
            f"{len(t)} samples over a time of {t[-1] - t[0]:g} cannot be interpolated at intervals of {dt:g}"
        )
    count = int(steps) + 1
    even = t[0] + dt * np.arange(count)
    u, y = (np.interp(even, t, signal) for signal in (samples.u, samples.y))
    return replace(samples, u=u, y=y, t=None, dt=dt)


def _require_increasing(t: Array) -> None:
    back = np.flatnonzero(~(np.diff(t) > 0.0))
    if not len(back):
        return
    i = int(back[0])
    if t[i + 1] == t[i]:
        remedy = "one of two samples at one time must go"
    elif len(back) == len(t) - 1:
        remedy = "the record stands there from its end: turn the lines round"
    elif np.all(np.diff(np.sort(t)) > 0.0):
        remedy = "sort the lines by time, if they are of one record"
    else:
        remedy = "records that stand one below the other are read by ranges, or from files of their own"
    more = "" if len(back) == 1 else f", and so at {len(back) - 1} more samples"
    raise ValueError(
        f"the times do not increase: {t[i + 1]:.10g} follows {t[i]:.10g} (sample {i + 2}){more}; {remedy}"
    )


def _even_interval(t: Array) -> float:
    intervals = np.diff(t)
    usual = float(np.median(intervals))
    dt = float(t[-1] - t[0]) / len(intervals)
    worst = int(np.argmax(np.abs(intervals - dt)))
    if abs(intervals[worst] - dt) <= _SAME * dt:
        return dt
    where = f"{t[worst + 1]:.10g} follows {t[worst]:.10g} (sample {worst + 2})"
    is_hole = intervals > _HOLE * usual
    rest = intervals[~is_hole]
    if is_hole.any() and np.all(np.abs(rest - usual) <= _SAME * usual):
        count = int(np.count_nonzero(is_hole))
        holes = "a hole" if count == 1 else f"{count} holes"
        raise ValueError(
            f"the times are {usual:g} apart and have {holes}: {where}; "
            "'gaps: split' (--gaps split) ends a part there, "
            f"'resample' (--resample {usual:.3g}) interpolates"
        )
    raise ValueError(
        f"the times are uneven: {where}, an interval of {intervals[worst]:g}, and {dt:g} on average "
        f"(allowed: {_SAME:g} of it off); 'resample' (--resample {usual:.3g}) interpolates them"
    )


def means(experiments: Iterable[Samples]) -> tuple[float, float]:
    """The means of u and y over all experiments."""
    experiments = list(experiments)
    u, y = (float(np.mean(np.concatenate([getattr(one, name) for one in experiments]))) for name in "uy")
    return u, y


def less(samples: Samples, u: float, y: float) -> Samples:
    """The samples with ``u`` and ``y`` taken off."""
    return replace(samples, u=samples.u - u, y=samples.y - y)


def without_line(samples: Samples) -> Samples:
    """The samples without the straight line that fits each of u and y best."""
    from scipy.signal import detrend

    return replace(samples, u=detrend(samples.u), y=detrend(samples.y))


def decimated(samples: Samples, factor: int) -> Samples:
    """Every ``factor``-th sample, behind a filter that takes away what is too fast for the new interval.

    The filter is that of ``scipy.signal.decimate(ftype="fir")``, of 20 ``factor`` + 1 coefficients and
    without phase; beyond its ends a signal goes on along the line between its first and its last sample. It
    stands before the system's nonlinearity too, with which it does not commute: decimate what was sampled
    much faster than it moves.

    Raises
    ------
    ValueError
        If there are no more samples than the filter is long.

    Examples
    --------
    >>> ramp = np.arange(90.0)
    >>> slow = decimated(Samples("", ramp, ramp, dt=0.1), 3)
    >>> len(slow), round(slow.dt, 3), bool(np.allclose(slow.u, ramp[::3]))
    (30, 0.3, True)
    """
    if factor == 1:
        return samples
    if len(samples) <= (length := 2 * _HALF_LENGTH * factor + 1):
        raise ValueError(f"decimation by {factor} needs more than {length} samples, not {len(samples)}")
    from scipy.signal import firwin, resample_poly

    window = firwin(length, 1.0 / factor, window="hamming")
    u, y = (
        resample_poly(signal, 1, factor, window=window, padtype="line") for signal in (samples.u, samples.y)
    )
    return replace(samples, u=u, y=y, dt=None if samples.dt is None else factor * samples.dt)


def record_of(
    experiments: Sequence[Samples], units: Mapping[str, str], offsets: Mapping[str, float]
) -> Record:
    """One record of all experiments, which are its parts if there are several.

    Raises
    ------
    ValueError
        If their intervals differ, or a number is too large.
    """
    dt = experiments[0].dt
    u, y = (np.concatenate([getattr(one, name) for one in experiments]) for name in "uy")
    if not (np.isfinite(u).all() and np.isfinite(y).all()):
        raise ValueError("the numbers are too large to be prepared")
    parts: dict[str, Part] = {}
    if len(experiments) > 1:
        for one, place in zip(experiments, joined(map(len, experiments)), strict=True):
            if dt is not None and one.dt is not None and abs(one.dt - dt) > _SAME * dt:
                raise ValueError(
                    f"'{one.name}' has an interval of {one.dt:g}, and '{experiments[0].name}' of {dt:g}: "
                    "'resample' brings them to one"
                )
            step = 1.0 if dt is None else dt
            held = Held(np.arange(len(one), dtype=float) * step, one.u, float(one.u[0]))
            parts[one.name] = Part(place.start, place.stop, step, held)
    u.flags.writeable = y.flags.writeable = False
    return Record(u, y, dt, parts=parts, units=units, offsets=offsets)
