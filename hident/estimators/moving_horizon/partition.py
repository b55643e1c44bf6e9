"""Partition points: the two points, one of either sign, at which the segments of a static function meet."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator

from hident.arrays import Array
from hident.config.spec import Interval
from hident.errors import EstimationError


def _around_zero(partition: str | tuple[float, float]) -> str | tuple[float, float]:
    if not isinstance(partition, str) and not partition[0] < 0.0 < partition[1]:
        raise ValueError(
            "must be [lower, upper] with lower < 0 < upper, zero being the steady state, "
            f"not [{partition[0]:g}, {partition[1]:g}]"
        )
    return partition


Partition = Annotated[Literal["search"] | Interval, AfterValidator(_around_zero)]
"""Given points, or ``search``."""


def require_inside(partition: str | tuple[float, float], signal: Array, name: str) -> None:
    """Raise EstimationError unless there are data on both sides of zero and beyond given partition points.

    ``signal`` (N,) is the input or the output, as ``name`` says.
    """
    low, high = float(signal.min()), float(signal.max())
    if not low < 0.0 < high:
        raise EstimationError(
            f"the {name} ranges from {low:g} to {high:g}: "
            "partition points need values on both sides of zero; subtract the steady state"
        )
    if not isinstance(partition, str):
        lower, upper = partition
        if not (low < lower and upper < high):
            raise EstimationError(
                f"the partition points [{lower:g}, {upper:g}] must lie inside the {name}'s range "
                f"[{low:g}, {high:g}]: move them, or let 'partition: search' find them"
            )
