"""The rule that fixes what no data determine in a chain of blocks.

- Each linear block has the static gain 1; one that has none to speak of, an impulse response of length 1 that
  starts positive. The factor goes to the next static block, or to the one before where none follows.
- Of two static blocks with linear ones between, the first gives at the ends of its range what it takes there,
  as far as a factor and a constant can do it: what stands behind it has the unit of the input. A function
  with nearly equal values at both ends goes from 0 to 1 instead.
- A chain of linear blocks only keeps the factor in the last.
- Functions that hold in a unit of their own take no factor in their argument: it stays in the block before.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from hident.block_chain import Block, BlockChain, Start
from hident.linear_blocks import TransferFunction
from hident.static_functions import StaticFunction

# A static gain below this part of the largest gain is none.
_NO_GAIN = 1e-3
# Ends that differ by less than this part of the range of the values are equal.
_EQUAL_ENDS = 0.1
_FREQUENCIES = np.linspace(0.0, np.pi, 257)
_GRID = 257


def normalised(chain: BlockChain, held: frozenset[int] = frozenset(), start: Start = "settled") -> BlockChain:
    """The chain of the same response in which the rule holds, but for the blocks that are held."""
    return normalised_with_factors(chain, held, start)[0]


def normalised_with_factors(
    chain: BlockChain, held: frozenset[int] = frozenset(), start: Start = "settled"
) -> tuple[BlockChain, tuple[float, ...]]:
    """As :func:`normalised`, and by what the output of each block is multiplied; its states are with it."""
    blocks, factors = list(chain.blocks), [1.0] * len(chain.blocks)
    for i, block in enumerate(blocks):
        if not isinstance(block, TransferFunction) or i in held:
            continue
        gain: float | None = None
        for target in _receivers(blocks, i, held):
            gain = gain_of(block) if gain is None else gain
            try:
                taken = _taken(blocks[target], gain, is_behind=target > i)
            except ValueError:
                # Its functions have a unit of their own.
                continue
            blocks[i], blocks[target] = block.divided(gain), taken
            for j in range(*sorted((i, target))):
                factors[j] *= 1.0 / gain if target > i else gain
            break
    static = [i for i, block in enumerate(blocks) if isinstance(block, StaticFunction)]
    for i, j in pairwise(static):
        if i in held or j in held:
            continue
        first, second = blocks[i], blocks[j]
        assert isinstance(first, StaticFunction)
        assert isinstance(second, StaticFunction)
        between = [block for block in blocks[i:j] if isinstance(block, TransferFunction)]
        gain = math.prod(block.static_gain() for block in between)
        factor, offset = _line(first)
        if start == "rest" or not all(np.isclose(block.static_gain(), 1.0) for block in between):
            offset, gain = 0.0, 1.0
        for added in (offset, 0.0):
            try:
                pair = first.scaled(factor, added), second.moved(factor, added * gain)
            except ValueError:
                continue
            blocks[i], blocks[j] = pair
            for k in range(i, j):
                factors[k] *= factor
            break
    return replace(chain, blocks=tuple(blocks)), tuple(factors)


def gain_of(block: TransferFunction) -> float:
    """What the block is divided by: its static gain, or the length of its impulse response."""
    response = np.abs(np.polyval(block.b[::-1], np.exp(-1j * _FREQUENCIES)))
    response = response / np.abs(np.polyval(block.denominator[::-1], np.exp(-1j * _FREQUENCIES)))
    static = block.static_gain()
    if math.isfinite(static) and abs(static) > _NO_GAIN * float(np.max(response)):
        return static
    impulse = block.impulse_response(4096)
    first = impulse[np.argmax(np.abs(impulse) > 1e-6 * np.max(np.abs(impulse)))]
    return float(np.copysign(np.linalg.norm(impulse), first)) or 1.0


def _receivers(blocks: list[Block], i: int, held: frozenset[int]) -> Iterator[int]:
    """Which blocks can take the factor of the linear block i, the first of all before the others."""
    behind = next((j for j in range(i + 1, len(blocks)) if isinstance(blocks[j], StaticFunction)), None)
    before = next((j for j in range(i - 1, -1, -1) if isinstance(blocks[j], StaticFunction)), None)
    for place in (behind, before):
        if place is not None and place not in held:
            yield place
    if behind is None and before is None and i + 1 < len(blocks) and i + 1 not in held:
        yield i + 1


def _taken(block: Block, gain: float, *, is_behind: bool) -> Block:
    if isinstance(block, TransferFunction):
        return block.scaled(gain)
    # Behind the block, what comes in is smaller by the factor; before it, what goes out is larger.
    return block.moved(1.0 / gain, 0.0) if is_behind else block.scaled(gain, 0.0)


def _line(function: StaticFunction) -> tuple[float, float]:
    """The factor and the constant that bring the values of a function to the rule."""
    low, high = function.range
    grid = np.linspace(low, high, _GRID)
    values = function(grid)
    left, right, least, most = values[0], values[-1], float(np.min(values)), float(np.max(values))
    if abs(right - left) > _EQUAL_ENDS * (most - least):
        factor = (high - low) / float(right - left)
        return factor, low - factor * float(left)
    if most == least:
        return 1.0, 0.0
    return 1.0 / (most - least), -least / (most - least)
