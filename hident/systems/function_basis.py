"""Functions that a user gives, as the basis of a static function."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from hident.arrays import Array
from hident.systems.base import NonlinearitySpec

# Where a function is told from a homogeneous one: both signs, over six decades.
_PROBES = np.concatenate((-np.geomspace(1e-3, 1e3, 25), np.geomspace(1e-3, 1e3, 25)))
_FACTORS = (2.0, 0.3)
_HIGHEST = 60.0
_SAME = 1e-10


@dataclass(frozen=True)
class Functions:
    """Given functions phi_1, ..., phi_K, which hold everywhere; signals lay between ``low`` and ``high``.

    They are not made for the signal, as other bases are: a factor in their argument can be taken over by
    their coefficients only where each is homogeneous, phi(a x) = a^d phi(x) for a > 0, as powers, abs and
    sign are.

    Examples
    --------
    >>> from hident.systems.nonlinearity import Abs, Power
    >>> basis = Functions((Abs(), Power(exponent=2)), -1.0, 2.0)
    >>> basis.value(np.array([1.0, 2.0]), np.array([-1.0, 0.5]))
    array([3., 1.])
    >>> basis.slope(np.array([1.0, 2.0]), np.array([-1.0, 0.5]))
    array([-5.,  3.])
    """

    functions: tuple[NonlinearitySpec, ...]
    low: float
    high: float
    kind: ClassVar[str] = "expansion"

    @property
    def size(self) -> int:
        return len(self.functions)

    @property
    def shape(self) -> tuple[float, ...]:
        return ()

    def reshaped(self, shape: Sequence[float]) -> Self:
        return self

    def shape_rows(self, coefficients: Array, x: Array) -> Array:
        return np.zeros((0, len(x)))

    def rows(self, x: Array) -> Array:
        return np.array([phi(x) for phi in self.functions], dtype=float)

    def value(self, coefficients: Array, x: Array) -> Array:
        return np.asarray(coefficients @ self.rows(x))

    def slope(self, coefficients: Array, x: Array) -> Array:
        return np.asarray(coefficients @ np.array([phi.slope(x) for phi in self.functions], dtype=float))

    @property
    def range(self) -> tuple[float, float]:
        return self.low, self.high

    def constant(self) -> Array:
        """The coefficients of the function that is 1 everywhere; ValueError if that is none of them."""
        rows = self.rows(_PROBES)
        for k, row in enumerate(rows):
            if row[0] != 0.0 and np.all(row == row[0]):
                return np.asarray(np.eye(1, self.size, k)[0] / row[0])
        raise ValueError("none of the functions is constant")

    def moved(self, coefficients: Array, factor: float, offset: float) -> tuple[Functions, Array]:
        """As every basis; ValueError where the functions are not homogeneous, or an offset is asked for."""
        if offset or any(degree is None for degree in self._degrees):
            raise ValueError("functions that are given hold in the unit of their argument")
        ends = sorted((factor * self.low, factor * self.high))
        basis = replace(self, low=ends[0], high=ends[1])
        degrees = np.array([degree for degree in self._degrees if degree is not None])
        scaled = coefficients * abs(factor) ** -degrees
        return (basis, scaled) if factor > 0.0 else (basis, self._mirrored(scaled))

    def _mirrored(self, coefficients: Array) -> Array:
        """The coefficients of f(-x)."""
        rows = self.rows(_PROBES)
        signs = np.ones(self.size)
        for k, (row, mirrored) in enumerate(zip(rows, self.rows(-_PROBES), strict=True)):
            if _are_same(row, -mirrored):
                signs[k] = -1.0
            elif not _are_same(row, mirrored):
                raise ValueError(
                    "functions that are neither even nor odd hold for one sign of their argument"
                )
        return np.asarray(coefficients * signs)

    def is_free_of_scale(self) -> bool:
        """Whether coefficients take over any factor of the argument."""
        return all(degree is not None for degree in self._degrees)

    @cached_property
    def _degrees(self) -> tuple[float | None, ...]:
        """The degree of each function that is homogeneous; None for any other."""
        with np.errstate(all="ignore"):
            return tuple(_degree(phi) for phi in self.functions)


def _degree(phi: NonlinearitySpec) -> float | None:
    at_one = phi(_PROBES)
    found: float | None = None
    for factor in _FACTORS:
        scaled = phi(factor * _PROBES)
        known = (at_one != 0.0) & np.isfinite(at_one) & np.isfinite(scaled)
        if not np.all(np.isfinite(at_one)) or not np.any(known):
            return None
        ratio = scaled[known][0] / at_one[known][0]
        if not ratio > 0.0:
            return None
        degree = float(np.log(ratio) / np.log(factor))
        # A whole degree is meant exactly.
        degree = float(round(degree)) if abs(degree - round(degree)) < _SAME else degree
        if (found is not None and abs(degree - found) > _SAME) or abs(degree) > _HIGHEST:
            return None
        found = degree
        if not _are_same(scaled, factor**degree * at_one):
            return None
    return found


def _are_same(one: Array, other: Array) -> bool:
    """Whether values agree, each to its own size."""
    return bool(np.all(np.abs(one - other) <= _SAME * np.maximum(np.abs(one), np.abs(other))))
