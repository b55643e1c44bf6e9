"""The four-segment inverse function of a Wiener system's nonlinearity.

Chen, Hwang and Chang 2009, eq. (13)-(16) and (32). The inverse is linear between the break points
y_-1 < 0 < y_1 of the output; the slope between 0 and y_1 is e_1 = 1, the others are e = (e_-2, e_-1, e_2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hident.arrays import Array


def left_segments(y: Array, lower: Array | float) -> Array:
    """g_-2 and g_-1 of (16), shape (..., 2), for outputs ``y`` and the break point ``lower`` (y_-1)."""
    # Eq. (14), (16); the second h_2 of (14) is a misprint for h_1.
    return np.stack((np.minimum(y - lower, 0.0), np.clip(y, lower, 0.0)), axis=-1)


def right_segment(y: Array, upper: Array | float) -> Array:
    """g_2 of (16) for outputs ``y`` and the break point ``upper`` (y_1)."""
    return np.maximum(y - upper, 0.0)


def segments(y: Array, lower: Array | float, upper: Array | float) -> Array:
    """g_-2, g_-1 and g_2 of (16), shape (..., 3); ``y`` and the break points are broadcast together."""
    return np.concatenate((left_segments(y, lower), right_segment(y, upper)[..., None]), axis=-1)


def inverse(y: Array, e: Array, lower: float, upper: float) -> Array:
    """The internal variable x (...) that belongs to the outputs ``y`` (...), for slopes ``e`` (3,)."""
    # Eq. (15)
    return np.asarray(y - segments(y, lower, upper) @ (1.0 - e))


def inverse_slope(y: Array, e: Array, lower: float, upper: float) -> Array:
    """The slope dx/dy of :func:`inverse` at ``y``; at a break point, that of the segment to the right."""
    return np.select([y < lower, y < 0.0, y < upper], [e[0], e[1], 1.0], e[2])


def forward(x: Array, e: Array, lower: Array | float, upper: Array | float) -> Array:
    """The output y that belongs to the internal variable ``x``: the inverse of :func:`inverse`.

    Parameters
    ----------
    x : array, shape (..., J) or any shape
        Internal variable.
    e : array, shape (3,) or (3, J)
        Slopes e_-2, e_-1, e_2, all positive.
    lower, upper : float or array, shape (J,)
        Break points y_-1 < 0 < y_1.
    """
    # Eq. (32)
    bend = e[1] * lower
    negative = np.clip(x, bend, 0.0) / e[1] + np.minimum(x - bend, 0.0) / e[0]
    return np.asarray(np.clip(x, 0.0, upper) + np.maximum(x - upper, 0.0) / e[2] + negative)


def forward_slope(x: Array, e: Array, lower: float, upper: float) -> Array:
    """The slope dy/dx of :func:`forward` at ``x``; at a bend, that of the segment to the right."""
    pieces = [x < e[1] * lower, x < 0.0, x < upper]
    return np.select(pieces, [1.0 / e[0], 1.0 / e[1], 1.0], 1.0 / e[2])


def forward_by_slopes(x: Array, e: Array, lower: float, upper: float) -> Array:
    """The derivatives of :func:`forward` by e_-2, e_-1 and e_2 at ``x`` (N,), shape (N, 3)."""
    bend = e[1] * lower
    # Beyond the bend, e_-1 moves the bend alone.
    near = np.where(x < bend, -lower / e[0], -np.minimum(x, 0.0) / e[1] ** 2)
    beyond = np.minimum(x - bend, 0.0)
    return np.column_stack([-beyond / e[0] ** 2, near, -np.maximum(x - upper, 0.0) / e[2] ** 2])


@dataclass(frozen=True)
class FourSegment:
    """The nonlinearity y(v) of four segments, (32) with x = ``gain`` v."""

    e: tuple[float, float, float]
    lower: float
    upper: float
    gain: float = 1.0

    def __call__(self, v: Array) -> Array:
        return forward(self.gain * v, np.array(self.e), self.lower, self.upper)
