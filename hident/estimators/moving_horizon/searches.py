"""What searches and iterations leave behind for figures: the ``details`` of an estimate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hident.records import Array


@dataclass(frozen=True, eq=False)
class History:
    """Parameters by name, each of shape (K,) with a value for each iterate; ``details["history"]``."""

    values: Mapping[str, Array]
    converged: bool
    reason: str


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

    n: NDArray[np.intp]
    m: NDArray[np.intp]
    delay: Array
    error: Array
    chosen: int


def found_searches(partition: PartitionSearch | None, structure: StructureSearch | None) -> dict[str, Any]:
    """The searches that were made, by their names in ``details``."""
    searches = {"partition": partition, "structure": structure}
    return {name: search for name, search in searches.items() if search is not None}
