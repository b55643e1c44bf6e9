"""Starts of a chain L-N-L that split no roots: what L-N and N-L with its blocks come to.

The poles and zeros that a search splits between two linear blocks are those of a linear approximation, which
knows little of them where the static function is far from a line. A chain can be no worse than the shorter
ones in it, whose searches need not split: with a delay or nothing as the other linear block, it starts there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from hident.block_chain import BlockChain
from hident.errors import EstimationError
from hident.estimators.prediction_error.continuous_structure import ContinuousStructure
from hident.estimators.prediction_error.criterion import Data, Point, point_at
from hident.estimators.prediction_error.parameters import LinearStructure
from hident.estimators.prediction_error.structure import ChainStructure
from hident.linear_blocks import TransferFunction


def of_fewer_blocks(
    structure: ChainStructure, data: Data, fit: Callable[[ChainStructure, Data], BlockChain]
) -> Iterator[Point]:
    """The starts of a chain L-N-L, of which no linear block is given; ``fit`` fits the shorter ones."""
    places = structure.linear
    if len(structure.blocks) != 3 or [*places] != [0, 2]:
        return
    first, last = places.values()
    if isinstance(first, ContinuousStructure) or isinstance(last, ContinuousStructure):
        return
    for left_out in (2, 0):
        try:
            chain = fit(_shorter(structure, left_out, first.nk + last.nk), data)
            begun = structure.after(dict(enumerate(_lengthened(chain, first.nk, last.nk).blocks)), data)
        except (EstimationError, np.linalg.LinAlgError, ValueError):
            continue
        if (point := point_at(data, begun)) is not None:
            yield point


def _shorter(structure: ChainStructure, left_out: int, delay: int) -> ChainStructure:
    """The chain without a linear block, the other one of which holds the delay of both."""
    shorter = structure.without(left_out)
    blocks = (replace(one, nk=delay) if isinstance(one, LinearStructure) else one for one in shorter.blocks)
    return replace(shorter, blocks=tuple(blocks))


def _lengthened(chain: BlockChain, first: int, last: int) -> BlockChain:
    """L-N or N-L with a delay of ``first`` or ``last`` samples, which L had, as a third block."""
    one, other = chain.blocks
    if isinstance(one, TransferFunction):
        return BlockChain((replace(one, b=one.b[last:]), other, _delay(last)))
    assert isinstance(other, TransferFunction)
    return BlockChain((_delay(first), one, replace(other, b=other.b[first:])))


def _delay(samples: int) -> TransferFunction:
    return TransferFunction((*(0.0,) * samples, 1.0))
