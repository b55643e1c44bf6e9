"""What searches and iterations leave behind for figures: the ``details`` of an estimate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hident.arrays import Array, Flags, Index
from hident.numerics.choices import first_least


@dataclass(frozen=True, eq=False)
class PartitionSearch:
    """The criterion over partition points; ``details["partition"]``.

    ``loss`` (L, U) belongs to the first grid of ``lower`` (L,) and ``upper`` (U,) points, nan where a
    pair was rejected; ``best`` is the pair (lower, upper) after the refinements, ``best_loss`` its loss.
    """

    lower: Array
    upper: Array
    loss: Array
    best: tuple[float, float]
    best_loss: float


@dataclass(frozen=True, eq=False)
class StructureSearch:
    """The error of every candidate structure (n, m, delay), shape (S,); ``details["structure"]``.

    ``error`` is relative: the root mean square output error over the standard deviation of the output.
    """

    n: Index
    m: Index
    delay: Array
    error: Array
    chosen: int


def best_pair(loss: Array, converged: Flags, scale: float) -> int:
    """The first pair of partition points with the least loss, as an index into the flattened ``loss``.

    A pair whose iteration has not ``converged`` counts only where none has: its loss is one of a wandering
    model. ``scale`` is the loss of the model zero.

    Raises
    ------
    ValueError
        If no loss is finite.
    """
    settled = np.where(converged, loss, np.nan)
    return first_least(settled if np.any(np.isfinite(settled)) else loss, scale=scale)


def found_searches(partition: PartitionSearch | None, structure: StructureSearch | None) -> dict[str, Any]:
    """The searches that were made, by their names in ``details``."""
    searches = {"partition": partition, "structure": structure}
    return {name: search for name, search in searches.items() if search is not None}
