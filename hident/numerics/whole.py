"""Whole numbers up to rounding: samples in a period, in a delay, in a hold.

A quotient of two times that is a whole number in decimals is not one in binary, and its last bit would decide
by a sample.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

_CLOSE = 1e-9
_ROUNDING = 1e-12
"""The rounding of a quotient of exact numbers, relative to it, with room for a few operations more."""


def whole_part(values: ArrayLike) -> NDArray[np.int64]:
    """The whole numbers that ``values`` (any shape) reach up to rounding: 1e-9, or 1e-12 of a large value.

    Examples
    --------
    >>> int(whole_part(0.3 / 0.1))
    3
    >>> int(whole_part(2.999))
    2
    """
    values = np.asarray(values, dtype=float)
    return np.asarray(np.floor(values + np.maximum(_CLOSE, _ROUNDING * np.abs(values))), dtype=np.int64)


def split(value: float) -> tuple[int, float]:
    """A number of samples as a whole number and the fraction from 0 to 1 that is left.

    A fraction within 1e-9 of zero or one is none.

    Examples
    --------
    >>> split(2.5)
    (2, 0.5)
    >>> split(0.3 / 0.1)
    (3, 0.0)
    """
    whole = int(whole_part(value))
    rest = value - whole
    return whole, 0.0 if rest < _CLOSE else rest


def nearest_whole(value: float, tolerance: float = _CLOSE) -> int | None:
    """The whole number from one on that ``value`` is within ``tolerance``, relative to it; None if none is.

    Examples
    --------
    >>> nearest_whole(0.3 / 0.1)
    3
    >>> nearest_whole(2.5)
    """
    if not math.isfinite(value):
        return None
    whole = round(value)
    return whole if whole >= 1 and abs(value - whole) <= tolerance * whole else None
