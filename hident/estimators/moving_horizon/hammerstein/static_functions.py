"""Static functions that are linear in their coefficients, as a Hammerstein model uses them.

Chen, Hwang and Chang 2009, eq. (2) and (4)-(7). Both vanish at zero, the chosen steady state.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hident.arrays import Array


def powers(u: Array, degree: int) -> Array:
    """u, u^2, ..., u^degree along a new last axis (2)."""
    return np.stack([u**i for i in range(1, degree + 1)], axis=-1)


def three_segments(u: Array, lower: Array | float, upper: Array | float) -> Array:
    """The functions f_1, ..., f_5 of (7) along a new last axis; the partition points broadcast with ``u``."""
    middle = np.clip(u, lower, upper)
    parts = [middle, middle**2, middle**3, np.maximum(u - upper, 0.0), np.minimum(u - lower, 0.0)]
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


@dataclass(frozen=True)
class PolynomialFunction:
    """c_1 u + ... + c_p u^p (2)."""

    c: tuple[float, ...]

    def basis(self, u: Array) -> Array:
        """What the coefficients multiply, along a new last axis."""
        return powers(u, len(self.c))

    def __call__(self, u: Array) -> Array:
        return np.asarray(self.basis(u) @ np.array(self.c))


@dataclass(frozen=True)
class ThreeSegmentFunction:
    """A cubic between the partition points u_-1 and u_1, straight lines of slopes c_5 and c_4 beyond (4)."""

    c: tuple[float, ...]
    lower: float
    upper: float

    def basis(self, u: Array) -> Array:
        """What the coefficients multiply, along a new last axis."""
        return three_segments(u, self.lower, self.upper)

    def __call__(self, u: Array) -> Array:
        return np.asarray(self.basis(u) @ np.array(self.c))
