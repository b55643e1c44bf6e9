"""The chains that are tried on a record, and in what order they grow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hident.config.spec import Of
from hident.estimators.prediction_error.prediction_error import PredictionError

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


@dataclass(frozen=True)
class Orders:
    """Numerator coefficients, poles and delay of a linear block."""

    nb: int
    nf: int
    nk: int

    def block(self) -> dict[str, Any]:
        """As a configuration writes it."""
        return {"kind": "linear", "nb": self.nb, "nf": self.nf, "nk": self.nk}


def chain(
    structure: str, orders: Sequence[Orders], static: Mapping[str, Any], **settings: Any
) -> PredictionError:
    """The estimator of a structure by name, with orders for its linear blocks in their order."""
    # A linear model has an operating point: a constant beside it.
    kinds = STRUCTURES[structure].split("-") if structure != "linear" else ["L", "A"]
    remaining = iter(orders)
    blocks = [
        next(remaining).block() if kind == "L" else dict(_AFFINE if kind == "A" else static) for kind in kinds
    ]
    spec = Of("estimator").validate({"kind": "prediction_error", "blocks": blocks, **settings})
    assert isinstance(spec, PredictionError)
    return spec


def orders_of(structure: str, n: int, lag: int) -> list[Orders]:
    """The orders of the linear blocks for a linear approximation of order n that surely answers at a lag.

    A sampled block of n poles has n coefficients from the lag on, and one more where it acts at once. A delay
    of more than one sample is never sure: three lags before it are left to the fit. Two blocks share the
    poles, with one more each, as complex ones come in pairs; the last holds the delay.
    """
    nk = lag if lag <= 1 else max(lag - _UNSURE, 0)
    if STRUCTURES[structure].count("L") == 1:
        return [Orders(n + (lag - nk if lag else 1), n, nk)]
    half = (n + 1) // 2 + 1
    return [Orders(half + 1, half, 0), Orders(half + 1, half, nk)]
