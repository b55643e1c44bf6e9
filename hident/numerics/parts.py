"""Signals of several experiments, one after the other: what looks back in time stays inside one of them.

Where two experiments meet, the sample before is another experiment's: a lagged regressor, a filter's state, a
correlation or a horizon that reached across would mix the two without a word. So such a function is written
for one experiment, and :func:`in_each` applies it to all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Parts = Sequence[slice]
"""Where the experiments stand in a signal, in their order."""


def whole(n: int) -> Parts:
    """The parts of ``n`` samples of one experiment."""
    return (slice(0, n),)


def longer_than(parts: Parts, samples: int) -> Parts:
    """The parts that hold more than so many samples: a shorter one has no row with that many before it."""
    return tuple(part for part in parts if part.stop - part.start > samples)


def following(parts: Parts, samples: int) -> Parts:
    """Where the rows of each part stand once its first ``samples`` are dropped and the rest joined."""
    return joined(part.stop - part.start - samples for part in longer_than(parts, samples))


def joined(lengths: Iterable[int]) -> Parts:
    """Parts of the given lengths, one after the other."""
    ends = np.cumsum([0, *lengths]).tolist()
    return tuple(slice(start, stop) for start, stop in pairwise(ends))


def in_each(parts: Parts, build: Callable[..., Array], *signals: Array, axis: int = 0) -> Array:
    """What ``build`` gives for the signals of each part by itself, joined along ``axis``.

    Parameters
    ----------
    parts : sequence of slices
        At least one.
    build : callable
        Takes each signal's samples in one part.
    signals : arrays
        Their samples run along ``axis`` (signals of fewer axes: along their last).

    Examples
    --------
    >>> in_each(joined([2, 3]), np.diff, np.array([1.0, 2.0, 10.0, 20.0, 40.0]))
    array([ 1., 10., 20.])
    """
    found = [build(*(_of(signal, part, axis) for signal in signals)) for part in parts]
    return found[0] if len(found) == 1 else np.concatenate(found, axis=axis)


def _of(signal: Array, part: slice, axis: int) -> Array:
    return signal[(slice(None),) * min(axis, signal.ndim - 1) + (part,)]
