"""Functions that a user gives, one by one or as an orthonormal basis, as the basis of a static function."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Protocol, Self

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

    def seen(self, low: float, high: float) -> Self:
        """The same functions of signals between these ends."""
        return replace(self, low=low, high=high)

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


class Orthonormal(Protocol):
    """Orthonormal functions on their domain; see :mod:`hident.estimators.nonparametric.bases`."""

    kind: ClassVar[str]

    def domain(self) -> tuple[float, float]:
        """The ends of where they live."""

    def size(self, q: int) -> int:
        """How many there are up to the cutoff level q."""

    def series(self, x: Array, coefficients: Array) -> Array:
        """Sums over i of c_i phi_i(x): ``x`` (M,) and ``coefficients`` (K, size(q)) to (K, M)."""

    def slopes(self, x: Array, coefficients: Array) -> Array:
        """Sums over i of c_i phi_i'(x), of the same shapes."""

    def moved(self, coefficients: Array, factor: float, offset: float) -> tuple[Any, Array]:
        """The same function of z = factor x + offset; ValueError if there is none."""

    def formulas(self, q: int) -> tuple[str, ...] | None:
        """The functions as formulas in u, if they have any."""


@dataclass(frozen=True)
class Series:
    """The functions of an orthonormal basis up to the cutoff level q, with lines beyond its domain.

    Signals lay between ``low`` and ``high``.
    """

    basis: Orthonormal
    q: int
    low: float
    high: float
    kind: ClassVar[str] = "series"

    @property
    def size(self) -> int:
        return self.basis.size(self.q)

    @property
    def shape(self) -> tuple[float, ...]:
        return ()

    def seen(self, low: float, high: float) -> Self:
        """The same functions of signals between these ends."""
        return replace(self, low=low, high=high)

    def reshaped(self, shape: Sequence[float]) -> Self:
        return self

    def shape_rows(self, coefficients: Array, x: Array) -> Array:
        return np.zeros((0, len(x)))

    def rows(self, x: Array) -> Array:
        return self._sums(np.eye(self.size), x)

    def value(self, coefficients: Array, x: Array) -> Array:
        return np.asarray(self._sums(coefficients[None], x)[0])

    def slope(self, coefficients: Array, x: Array) -> Array:
        return np.asarray(self.basis.slopes(np.clip(x, *self.basis.domain()), coefficients[None])[0])

    def _sums(self, coefficients: Array, x: Array) -> Array:
        inside = np.clip(x, *self.basis.domain())
        sums = self.basis.series(inside, coefficients)
        if np.any(beyond := x != inside):
            slopes = self.basis.slopes(inside[beyond], coefficients)
            sums[:, beyond] += slopes * (x[beyond] - inside[beyond])
        return sums

    @property
    def range(self) -> tuple[float, float]:
        low, high = self.basis.domain()
        return max(low, self.low), min(high, self.high)

    def constant(self) -> Array:
        """The coefficients of the function that is 1 everywhere; ValueError if that is none of them."""
        low, high = (float(end) for end in np.clip((-1.0, 1.0), *self.basis.domain()))
        first = self.basis.series(np.linspace(low, high, 9), np.eye(1, self.size))[0]
        if first[0] == 0.0 or np.any(first != first[0]):
            raise ValueError("none of the functions is constant")
        return np.asarray(np.eye(1, self.size)[0] / first[0])

    def moved(self, coefficients: Array, factor: float, offset: float) -> tuple[Series, Array]:
        """As every basis; ValueError where the functions hold in a unit of their own."""
        basis, found = self.basis.moved(coefficients, factor, offset)
        low, high = sorted((factor * self.low + offset, factor * self.high + offset))
        return Series(basis, self.q, low, high), found

    def is_free_of_scale(self) -> bool:
        """Whether other coefficients and another domain take over any factor of the argument."""
        try:
            self.basis.moved(np.ones(self.size), 2.0, 0.0)
        except ValueError:
            return False
        return True

    def formulas(self, coefficients: Array) -> tuple[tuple[str, ...], Array] | None:
        """Formulas in u and their coefficients, with the lines beyond the domain; None if there are none."""
        if (texts := self.basis.formulas(self.q)) is None:
            return None
        low, high = self.basis.domain()
        left, right = (
            self.slope(coefficients, np.array([end]))[0] if np.isfinite(end) else 0.0 for end in (low, high)
        )
        inside = "u"
        lines: list[tuple[str, float]] = []
        if np.isfinite(low):
            inside = f"maximum({inside}, {low!r})"
            lines.append((f"minimum(u - {low!r}, 0)", left))
        if np.isfinite(high):
            inside = f"minimum({inside}, {high!r})"
            lines.append((f"maximum(u - {high!r}, 0)", right))
        found = [*(re.sub(r"\bu\b", inside, text) for text in texts), *(text for text, _ in lines)]
        return tuple(found), np.array([*coefficients, *(slope for _, slope in lines)])


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
