"""What a chain of blocks is made of before any number is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from hident.arrays import Array
from hident.block_chain import Block, BlockChain
from hident.estimators.prediction_error.criterion import Data, solved
from hident.estimators.prediction_error.parameters import (
    LinearStructure,
    Parameters,
)
from hident.linear_blocks import TransferFunction
from hident.static_functions import Basis, Chebyshev, StaticFunction

# How far beyond the signal that was met a basis reaches, relative to its range.
_MARGIN = 0.02
# A signal that moves by less than this part of its size does not move.
_ROUNDING = 1e-13
# The degree of the polynomials in place of functions of more coefficients, while a start is sought.
_SMOOTH = 3


class StaticKind(Protocol):
    """A kind of static function, which makes its basis for the signal that it meets."""

    def basis_for(self, x: Array, low: float, high: float) -> Basis:
        """The basis for a signal x (N,), which spans [low, high]."""

    def is_fixed(self) -> bool:
        """Whether its range was given, and does not follow the signal."""

    def spreads(self) -> tuple[float, ...]:
        """Standard deviations that its input is tried with at a start, where a block before can give any."""


@dataclass(frozen=True)
class _Smooth:
    """A polynomial of low degree."""

    def basis_for(self, x: Array, low: float, high: float) -> Basis:
        return Chebyshev(_SMOOTH, low, high)

    def is_fixed(self) -> bool:
        return False

    def spreads(self) -> tuple[float, ...]:
        return (1.0,)


@dataclass(frozen=True)
class ChainStructure:
    """Blocks in their order: orders of linear ones, kinds of static ones, some of them given or held.

    ``given`` blocks are where the search starts, ``held`` ones (among them) stay.
    """

    blocks: tuple[LinearStructure | StaticKind, ...]
    given: Mapping[int, Block] = field(default_factory=dict)
    held: frozenset[int] = frozenset()

    @property
    def linear(self) -> dict[int, LinearStructure]:
        """The linear blocks to be found that are not given, by their places."""
        return {
            i: block
            for i, block in enumerate(self.blocks)
            if isinstance(block, LinearStructure) and i not in self.given
        }

    @property
    def static(self) -> tuple[int, ...]:
        """The places of the static blocks."""
        return tuple(i for i, block in enumerate(self.blocks) if not isinstance(block, LinearStructure))

    @property
    def free_static(self) -> tuple[int, ...]:
        """The places of the static blocks that are not given."""
        return tuple(i for i in self.static if i not in self.given)

    def without(self, i: int) -> ChainStructure:
        """The chain with one block less."""

        def moved(j: int) -> int:
            return j - (j > i)

        return ChainStructure(
            (*self.blocks[:i], *self.blocks[i + 1 :]),
            {moved(j): block for j, block in self.given.items() if j != i},
            frozenset(moved(j) for j in self.held if j != i),
        )

    def smooth(self, u: Array) -> ChainStructure:
        """The chain with cubic polynomials for functions of more coefficients; itself if there are none.

        With fewer coefficients fewer fits are the best ones nearby. Given functions stay, and those whose
        range was given; u (N,) is some signal.
        """

        def is_rich(i: int, block: LinearStructure | StaticKind) -> bool:
            if isinstance(block, LinearStructure) or i in self.given or block.is_fixed():
                return False
            return block.basis_for(u, float(np.min(u)), float(np.max(u))).size > _SMOOTH + 1

        rich = [is_rich(i, block) for i, block in enumerate(self.blocks)]
        if not any(rich):
            return self
        blocks = (_Smooth() if one else block for one, block in zip(rich, self.blocks, strict=True))
        return replace(self, blocks=tuple(blocks))

    def spreads(self) -> tuple[float, ...]:
        """Standard deviations that the signals before free static blocks are tried with at a start."""
        tried = {
            spread: None
            for i, block in enumerate(self.blocks)
            if i and i in self.free_static and not isinstance(block, LinearStructure)
            for spread in block.spreads()
        }
        return tuple(tried) or (1.0,)

    def made(
        self,
        data: Data,
        linear: Mapping[int, TransferFunction],
        functions: Functions,
        spread: float = 1.0,
    ) -> Parameters:
        """The parameters with these linear blocks, ranges after the signals, and functions for static blocks.

        A static block of which no function is said is the identity; the last one will be solved for. What
        stands before a static block of which nothing is said is scaled to a standard deviation of one, or to
        ``spread`` (and turned round if that is negative) before a block that tries several.
        """
        blocks: list[Block] = []
        x = data.u
        for i, block in enumerate(self.blocks):
            if isinstance(block, LinearStructure):
                made = self.given.get(i) or block.nearest(linear[i])
                assert isinstance(made, TransferFunction)
                y = data.through(made, x)
                is_before_static = i + 1 < len(self.blocks) and i + 1 in self.static
                scale = float(np.std(y[data.counted]))
                if is_before_static and self._tries_several(i + 1):
                    scale /= spread
                is_met = i + 1 in self.given or functions.get(i + 1) is not None
                if i not in self.given and is_before_static and not is_met and scale != 0.0:
                    made = made.divided(scale)
                    y = y / scale
                x = y
            else:
                function = self.given.get(i) or fitted(block, x, functions.get(i), data)
                assert isinstance(function, StaticFunction)
                made = function
                x = function(x)
            blocks.append(made)
        return Parameters.of(self.blocks, BlockChain(tuple(blocks)), self.held)

    def _tries_several(self, i: int) -> bool:
        block = self.blocks[i]
        return not isinstance(block, LinearStructure) and len(block.spreads()) > 1

    def after(self, blocks: Mapping[int, Block], data: Data) -> Parameters:
        """As :meth:`made`, from the blocks of another chain by their places in this one."""
        linear = {i: one for i, one in blocks.items() if isinstance(one, TransferFunction)}
        functions = {i: one for i, one in blocks.items() if isinstance(one, StaticFunction)}
        return self.made(data, linear, functions)

    def ranged(self, data: Data, parameters: Parameters) -> Parameters:
        """The parameters, with ranges of static blocks that follow the signals as these now are."""
        blocks: list[Block] = []
        x = data.u
        for i, (kind, block) in enumerate(zip(self.blocks, parameters.chain.blocks, strict=True)):
            if isinstance(block, StaticFunction) and not isinstance(kind, LinearStructure):
                follows = i not in self.held and not block.basis.shape and not kind.is_fixed()
                blocks.append(fitted(kind, x, block, data) if follows else block)
            else:
                blocks.append(block)
            x = data.begun(blocks[-1], x, parameters.states.get(i, ()))
        return Parameters.of(self.blocks, BlockChain(tuple(blocks)), self.held, parameters.states)


Functions = Mapping[int, "StaticFunction | None"]


def fitted(kind: StaticKind, x: Array, function: object, data: Data) -> StaticFunction:
    """The function of this kind that is nearest to another on a signal x (N,); to the identity if None."""
    low, high = float(np.min(x[data.counted])), float(np.max(x[data.counted]))
    margin, size = _MARGIN * (high - low), max(abs(low), abs(high))
    if high - low <= _ROUNDING * size:
        # Knots between ends that rounding alone tells apart would coincide.
        margin = max(1.0, _MARGIN * size)
    basis = kind.basis_for(x[data.counted], low - margin, high + margin)
    rows = basis.rows(x)
    if wrong := len(x) - int(np.count_nonzero(np.all(np.isfinite(rows), axis=0))):
        raise ValueError(f"a static function is not finite at {wrong} of {len(x)} samples of its input")
    target = function(x) if isinstance(function, StaticFunction) else x
    return StaticFunction(basis, tuple(solved(rows, target, data).tolist()))
