"""A chain of blocks as a vector of numbers, and the chain that a vector stands for.

The vector theta goes from block to block: the numbers of each that is to be found, and behind those of a
linear block its states at the first sample of each experiment, where they are to be found too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from hident.arrays import Array
from hident.block_chain import Block, BlockChain
from hident.linear_blocks import TransferFunction
from hident.sampled_blocks import SampledTransferFunction
from hident.static_functions import Basis, StaticFunction


@dataclass(frozen=True)
class LinearStructure:
    """B/F with b_nk, ..., b_{nk + nb - 1} and f_1, ..., f_nf to be found."""

    nb: int
    nf: int
    nk: int = 0

    @property
    def size(self) -> int:
        return self.nb + self.nf

    @property
    def states(self) -> int:
        """How many numbers the state has."""
        return max(self.nk + self.nb - 1, self.nf)

    def made(self, numbers: Array) -> TransferFunction:
        """The block of the numbers b, f."""
        b, f = numbers[: self.nb].tolist(), numbers[self.nb :]
        return TransferFunction(b=(*(0.0,) * self.nk, *b), a=tuple((-f).tolist()))

    def numbers(self, block: TransferFunction) -> Array:
        """b, f of a block, filled up with zeros, or cut off, to this structure."""
        b, f = np.zeros(self.nb), np.zeros(self.nf)
        given = np.asarray(block.b[self.nk :], dtype=float)[: self.nb]
        b[: len(given)] = given
        feedback = -np.asarray(block.a, dtype=float)[: self.nf]
        f[: len(feedback)] = feedback
        return np.concatenate((b, f))

    def names(self) -> list[str]:
        """The names of the numbers."""
        return [*(f"b_{self.nk + j}" for j in range(self.nb)), *(f"a_{j + 1}" for j in range(self.nf))]

    def values(self, numbers: Array) -> Array:
        """The numbers with the signs of their names: a with that of :class:`TransferFunction`."""
        return np.concatenate((numbers[: self.nb], -numbers[self.nb :]))

    def scales(self, numbers: Array) -> Array:
        """By how much each number must change to matter."""
        b, f = np.abs(numbers[: self.nb]), np.abs(numbers[self.nb :])
        return np.concatenate((np.full(len(b), np.max(b)), np.maximum(f, 1.0)))

    def nearest(self, block: TransferFunction) -> TransferFunction:
        """The block of this structure that is nearest to a discrete block."""
        return block


@dataclass(frozen=True)
class StaticStructure:
    """A basis, whose shape and coefficients are to be found."""

    basis: Basis

    @property
    def size(self) -> int:
        return len(self.basis.shape) + self.basis.size

    def made(self, numbers: Array) -> StaticFunction:
        """The function of the numbers shape, coefficients; ValueError where there is none of this shape."""
        shape = len(self.basis.shape)
        basis = self.basis.reshaped(numbers[:shape].tolist())
        return StaticFunction(basis, tuple(numbers[shape:].tolist()))

    def numbers(self, block: StaticFunction) -> Array:
        """Shape and coefficients of a function of such a basis."""
        return np.array((*block.basis.shape, *block.coefficients), dtype=float)

    def names(self) -> list[str]:
        """The names of the numbers."""
        shape = ("low", "high")[: len(self.basis.shape)]
        return [*shape, *(f"c_{j + 1}" for j in range(self.basis.size))]

    def values(self, numbers: Array) -> Array:
        """The numbers with the signs of their names."""
        return numbers


Structure = LinearStructure | StaticStructure
States = tuple[Array, ...]
"""The states of a linear block at the first sample of each experiment; none if they are not to be found."""


@dataclass(frozen=True)
class Parameters:
    """Which numbers of a chain are to be found, and where each stands in their vector theta.

    A block among ``held`` keeps the numbers of ``chain``. The coefficients of the last static block that is
    not held are solved for (``projected``): all that follows it is linear. ``states`` are those of all linear
    blocks by their places, held ones among them, beyond what the start of the data says.
    """

    structures: tuple[Structure, ...]
    chain: BlockChain
    held: frozenset[int] = frozenset()
    states: Mapping[int, States] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        orders: Sequence[object],
        chain: BlockChain,
        held: Iterable[int] = (),
        states: Mapping[int, States] | None = None,
    ) -> Parameters:
        """The parameters of a chain, whose static blocks say their bases, and ``orders`` the linear ones."""
        structures: list[Structure] = []
        for order, block in zip(orders, chain.blocks, strict=True):
            if isinstance(block, StaticFunction):
                structures.append(StaticStructure(block.basis))
            else:
                assert isinstance(order, LinearStructure)
                structures.append(order)
        return cls(tuple(structures), chain, frozenset(held), states or {})

    @cached_property
    def free(self) -> tuple[int, ...]:
        """The places of the blocks to be found."""
        return tuple(i for i in range(len(self.structures)) if i not in self.held)

    @cached_property
    def projected(self) -> int | None:
        """The place of the block whose coefficients are solved for."""
        last = [i for i in self.free if isinstance(self.structures[i], StaticStructure)]
        behind = max((i for i, s in enumerate(self.structures) if isinstance(s, StaticStructure)), default=-1)
        return last[-1] if last and last[-1] == behind else None

    def stepped(self, i: int) -> int:
        """How many of block i's numbers are found by steps: all but those that are solved for, or held."""
        structure = self.structures[i]
        if i in self.held:
            return 0
        if i == self.projected:
            assert isinstance(structure, StaticStructure)
            return len(structure.basis.shape)
        return structure.size

    @cached_property
    def theta(self) -> Array:
        """The numbers found by steps, as they stand in the chain."""
        pieces = [np.zeros(0)]
        for i in range(len(self.structures)):
            if count := self.stepped(i):
                pieces.append(self.numbers(i)[:count])
            pieces += self.states.get(i, ())
        return np.concatenate(pieces)

    def place(self, i: int) -> int:
        """Where the numbers of block i begin in theta."""
        before = sum(self.stepped(j) for j in range(i))
        return before + sum(len(state) for j, states in self.states.items() if j < i for state in states)

    def numbers(self, i: int) -> Array:
        """All numbers of block i."""
        structure, block = self.structures[i], self.chain.blocks[i]
        if isinstance(structure, LinearStructure):
            assert isinstance(block, TransferFunction)
            return structure.numbers(block)
        assert isinstance(block, StaticFunction)
        return structure.numbers(block)

    def moved(self, theta: Array) -> Parameters:
        """These parameters with other numbers; ValueError where a shape does not exist."""
        blocks: list[Block] = list(self.chain.blocks)
        states: dict[int, States] = {}
        place = 0
        for i, structure in enumerate(self.structures):
            if count := self.stepped(i):
                numbers = self.numbers(i)
                numbers[:count] = theta[place : place + count]
                blocks[i] = structure.made(numbers)
                place += count
            if i in self.states:
                ends = np.cumsum([len(state) for state in self.states[i]])
                states[i] = tuple(np.split(theta[place : place + ends[-1]], ends[:-1]))
                place += int(ends[-1])
        return replace(self, chain=replace(self.chain, blocks=tuple(blocks)), states=states)

    def with_block(self, i: int, block: Block) -> Parameters:
        """These parameters with block i in place of its own."""
        blocks = list(self.chain.blocks)
        blocks[i] = block
        return replace(self, chain=replace(self.chain, blocks=tuple(blocks)))

    def count(self) -> int:
        """How many numbers are to be found."""
        states = sum(len(state) for states in self.states.values() for state in states)
        return states + sum(self.structures[i].size for i in self.free)

    def is_stable(self) -> bool:
        """Whether all linear blocks to be found are stable."""
        return all(
            block.is_stable() if isinstance(block, SampledTransferFunction) else is_stable(block.denominator)
            for i in self.free
            if isinstance(block := self.chain.blocks[i], TransferFunction) and block.a
        )


def is_stable(polynomial: Array) -> bool:
    """Whether all roots of 1 + f_1 q^-1 + ... lie inside the unit circle, by Schur and Cohn's recursion.

    A search asks this of each model that it tries, and eigenvalues take ten times as long.
    """
    f = polynomial.tolist()
    while len(f) > 1:
        last = f[-1]
        if not abs(last) < 1.0:
            return False
        scale = 1.0 - last * last
        f = [(one - last * other) / scale for one, other in zip(f[:-1], f[:0:-1], strict=True)]
    return True
