"""What an iteration leaves behind, and what becomes of one that ends without converging: one rule for all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from hident.arrays import Array
from hident.config.suggest import counted
from hident.errors import EstimationError

Unconverged = Literal["fail", "keep"]
"""Whether such an estimate counts as failed, or the last iterate is kept."""


@dataclass(frozen=True, eq=False)
class History:
    """The parameters of K iterates; ``details["history"]``.

    ``a`` (K, n) and ``b`` (K, m + 1) are the linear block's a_1, ..., a_n and b_0, ..., b_m, the ``others``
    are of shape (K,) each.
    """

    a: Array
    b: Array
    others: Mapping[str, Array]
    converged: bool

    @property
    def values(self) -> dict[str, Array]:
        """All parameters (K,) by name."""
        feedback = {f"a_{i}": one for i, one in enumerate(self.a.T, start=1)}
        return feedback | {f"b_{i}": one for i, one in enumerate(self.b.T)} | {**self.others}


def settle(converged: bool, iterations: int, unconverged: Unconverged) -> None:
    """Let an iteration that has ended pass if it has converged, or is kept all the same.

    An iteration that wanders without end multiplies a last bit until nothing of it is left, and a mean over
    such values is one of chaos.

    Raises
    ------
    EstimationError
        If it has not converged and counts as failed.
    """
    if not converged and unconverged == "fail":
        raise EstimationError(
            f"the iteration has not converged in {counted(iterations, 'iteration')}: allow more with "
            "'max_iterations', or keep the last iterate with 'unconverged: keep'"
        )
