"""A fit that goes on from another: with other static functions, or on more of the record."""

from __future__ import annotations

from hident.block_chain import BlockChain
from hident.errors import EstimationError
from hident.estimators.prediction_error.chain_fit import ChainFit
from hident.estimators.prediction_error.criterion import Data, point_at
from hident.estimators.prediction_error.descent import descend
from hident.estimators.prediction_error.structure import ChainStructure


def continued(
    structure: ChainStructure, chain: BlockChain, data: Data, max_iterations: int = 100
) -> ChainFit:
    """The fit of a chain whose search starts from another chain with the same linear blocks."""
    begun = point_at(data, structure.after(dict(enumerate(chain.blocks)), data))
    if begun is None:
        raise EstimationError("the output of the chain it starts from is not finite on this record")
    found = descend(begun, max_iterations)
    return ChainFit(found.point, found.status, found.iterations, found.evaluations, 1, 1, 1)
