"""The values of one signal of a record."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hident.arrays import Array
from hident.numerics.parts import Parts, in_each

FEW = 12
"""A signal with at most so many values has levels."""

# Times the distance from the samples around that one in a hundred exceeds.
_OUTLYING = 4.0
_AROUND = 7


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


def scaled(x: Array) -> Array:
    """The signal between -1 and 1; zero if it is constant."""
    if not len(x):
        return x
    middle, half = float(np.max(x)) / 2 + float(np.min(x)) / 2, float(np.max(x)) / 2 - float(np.min(x)) / 2
    return (x - middle) / half if half > 0.0 else np.zeros(len(x))


def signal_of(raw: Array, x: Array, parts: Parts) -> Signal:
    """The values of ``raw``, which is ``x`` between -1 and 1."""
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
