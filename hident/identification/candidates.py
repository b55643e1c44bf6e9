"""The chains that are tried on a record, and in what order they grow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hident.arrays import Array
from hident.config.spec import Of
from hident.estimators.prediction_error.prediction_error import PredictionError
from hident.measurements.signal_values import FEW

STRUCTURES: Mapping[str, str] = {
    "linear": "L",
    "hammerstein": "N-L",
    "wiener": "L-N",
    "wiener_hammerstein": "L-N-L",
    "hammerstein_wiener": "N-L-N",
}
"""The structures by name, with their blocks."""

_AFFINE = {"kind": "polynomial", "degree": 1}
STATIC: Sequence[Mapping[str, Any]] = (
    {"kind": "saturation"},
    {"kind": "dead_zone"},
    {"kind": "polynomial", "degree": 2},
    {"kind": "polynomial", "degree": 3},
    {"kind": "polynomial", "degree": 5},
    {"kind": "polynomial", "degree": 7},
    {"kind": "piecewise_linear", "knots": 4},
    {"kind": "piecewise_linear", "knots": 6},
    {"kind": "piecewise_linear", "knots": 10},
    {"kind": "cubic_spline", "knots": 4},
    {"kind": "cubic_spline", "knots": 8},
    {"kind": "cubic_spline", "knots": 16},
    {"kind": "cubic_spline", "knots": 24},
)
"""The static functions that are tried once the orders are known."""
FIRST_STATIC: Mapping[str, Any] = {"kind": "cubic_spline", "knots": 8}
"""The static function with which orders are compared."""

_UNSURE = 3
# A static function of so few levels of its input is not told from a line.
_NO_FUNCTION = 2
# Corners are told by so many levels: two on each of three lines, but for one that is shared.
_CORNERS = 5


@dataclass(frozen=True)
class Orders:
    """Numerator coefficients, poles and delay of a linear block."""

    nb: int
    nf: int
    nk: int

    def block(self) -> dict[str, Any]:
        """As a configuration writes it."""
        return {"kind": "linear", "nb": self.nb, "nf": self.nf, "nk": self.nk}


@dataclass(frozen=True)
class Functions:
    """The static functions that are tried, given how many ``levels`` the input has (None: many)."""

    levels: int | None = None

    @classmethod
    def of_input(cls, u: Array) -> Functions:
        """Those for an input u (N,)."""
        levels = len(np.unique(u))
        return cls(levels if levels <= FEW and len(u) > 2 * levels else None)

    def of(self, structure: str) -> list[tuple[Mapping[str, Any], ...]]:
        """The functions of a structure's static blocks, first those with which orders are compared.

        Of k levels a function at the input has k values: straight lines between them are all that there is
        to find, and polynomials of degree k - 1 or more are no other functions. None are tried of two levels.
        """
        count = STRUCTURES[structure].count("N")
        if self.levels is None or not STRUCTURES[structure].startswith("N"):
            return [(static,) * count for static in (FIRST_STATIC, *STATIC)]
        if self.levels <= _NO_FUNCTION:
            return []
        through = {"kind": "piecewise_linear", "knots": self.levels}
        if count > 1:
            return [(through, static) for static in (FIRST_STATIC, *STATIC)]
        return [(through,), *((static,) for static in STATIC if self._is_told(static))]

    def _is_told(self, static: Mapping[str, Any]) -> bool:
        assert self.levels is not None
        if static["kind"] == "polynomial":
            return int(static["degree"]) < self.levels - 1
        return static["kind"] in ("saturation", "dead_zone") and self.levels >= _CORNERS

    def notes(self, structures: Sequence[str]) -> tuple[str, ...]:
        """What is not tried of these structures, and why."""
        first = [name for name in structures if STRUCTURES[name].startswith("N")]
        if self.levels is None or not first:
            return ()
        if self.levels <= _NO_FUNCTION:
            return (
                f"not tried: {' and '.join(first)}, as the input has {self.levels} levels, and a static "
                "function of two levels is a line",
            )
        return (
            f"the input has {self.levels} levels: of a static function at the input it tells {self.levels} "
            f"values and nothing between them, so no polynomial of degree {self.levels} or more and no "
            "spline is tried there",
        )


def chain(
    structure: str, orders: Sequence[Orders], static: Sequence[Mapping[str, Any]], **settings: Any
) -> PredictionError:
    """The estimator of a structure by name: orders of its linear blocks, functions of its static ones."""
    remaining, functions = iter(orders), iter(static)
    blocks = [
        next(remaining).block() if kind == "L" else dict(next(functions))
        for kind in STRUCTURES[structure].split("-")
    ]
    if structure == "linear":
        # A linear model has an operating point: a constant beside it.
        blocks.append(dict(_AFFINE))
    spec = Of("estimator").validate({"kind": "prediction_error", "blocks": blocks, **settings})
    assert isinstance(spec, PredictionError)
    return spec


def orders_of(structure: str, n: int, lag: int, *, is_sure: bool = False) -> list[Orders]:
    """The orders of the linear blocks for a linear approximation of order n that surely answers at a lag.

    A sampled block of n poles has n coefficients from the lag on, and one more where it acts at once. A delay
    of more than one sample is not sure unless it is given: three lags before it are left to the fit. Two
    blocks share the poles, with one more each, as complex ones come in pairs; the last holds the delay.
    """
    nk = lag if lag <= 1 or is_sure else max(lag - _UNSURE, 0)
    if STRUCTURES[structure].count("L") == 1:
        return [Orders(n + (lag - nk if lag else 1), n, nk)]
    half = (n + 1) // 2 + 1
    return [Orders(half + 1, half, 0), Orders(half + 1, half, nk)]
