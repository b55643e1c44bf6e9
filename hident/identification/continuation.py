"""A fit that goes on from another: with other static functions, more blocks, or on more of the record."""

from __future__ import annotations

import numpy as np

from hident.block_chain import BlockChain
from hident.errors import EstimationError
from hident.estimators.prediction_error.chain_fit import ChainFit
from hident.estimators.prediction_error.criterion import Data, Point, point_at
from hident.estimators.prediction_error.descent import descend
from hident.estimators.prediction_error.parameters import Parameters
from hident.estimators.prediction_error.structure import ChainStructure
from hident.static_functions import StaticFunction

# So few samples may lie where a static function is the line beyond its range.
_FEW_BEYOND = 1e-3
# Where the end is near, all directions are taken to it at once.
_LITTLE_DAMPING = 1e-11


def continued(
    structure: ChainStructure,
    chain: BlockChain,
    data: Data,
    max_iterations: int = 100,
    whole: Data | None = None,
) -> ChainFit:
    """The fit of a chain whose search starts from another chain with the same linear blocks.

    The ranges of its static functions are those of the signals of ``whole``, by default of ``data``.
    """
    begun = structure.after(dict(enumerate(chain.blocks)), whole or data)
    return _descended(point_at(data, begun), max_iterations)


def resumed(
    structure: ChainStructure, parameters: Parameters, data: Data, max_iterations: int = 100
) -> ChainFit:
    """The fit of the same chain to other data, which goes on from where that to some of them ended.

    With the very same basis functions few steps are left; they are made anew where many samples would lie
    beyond the ranges of the old ones.
    """
    begun = point_at(data, parameters)
    if begun is None or _leaves_ranges(begun):
        return continued(structure, parameters.chain, data, max_iterations)
    return _descended(begun, max_iterations, _LITTLE_DAMPING)


def _leaves_ranges(point: Point) -> bool:
    for block, x in zip(point.parameters.chain.blocks, point.signals, strict=False):
        # Corners are no range: beyond them is where the function acts.
        if isinstance(block, StaticFunction) and not block.basis.shape:
            low, high = block.range
            if np.mean((x < low) | (x > high)) > _FEW_BEYOND:
                return True
    return False


def _descended(begun: Point | None, max_iterations: int, *damping: float) -> ChainFit:
    if begun is None:
        raise EstimationError("the output of the chain it starts from is not finite on this record")
    found = descend(begun, max_iterations, *damping)
    return ChainFit(found.point, found.status, found.iterations, found.evaluations, 1, 1, 1)
