"""A chain of linear and static blocks: Hammerstein, Wiener and longer ones are spellings of one thing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from hident.arrays import Array
from hident.linear_blocks import TransferFunction
from hident.sampled_blocks import SampledTransferFunction
from hident.static_functions import StaticFunction

Block = TransferFunction | StaticFunction
Start = Literal["rest", "settled"]
"""What was before the first sample: nothing, or the first input for ever."""
Beginning = Literal["settled", "rest", "estimated"]
"""As :data:`Start`, or states that the first samples of the output tell."""


@dataclass(frozen=True)
class BlockChain:
    """Blocks one after the other, the first at the input, in discrete time.

    ``dt`` is the sampling interval (None: times count samples). A delay stands as leading zeros of ``b``.

    Examples
    --------
    >>> from hident.static_functions import PiecewiseLinear
    >>> valve = StaticFunction(PiecewiseLinear((0.0, 1.0, 2.0)), (0.0, 1.0, 1.0))
    >>> chain = BlockChain((valve, TransferFunction(b=(0.0, 0.5), a=(0.5,))))
    >>> chain.structure, chain.response(np.array([1.0, 2.0, 0.0]))
    ('N-L', array([0.  , 0.5 , 0.75]))
    """

    blocks: tuple[Block, ...]
    dt: float | None = None

    @property
    def structure(self) -> str:
        """The kinds of the blocks: ``N-L`` is a Hammerstein system, ``L-N`` a Wiener system."""
        return "-".join("L" if isinstance(block, TransferFunction) else "N" for block in self.blocks)

    @property
    def names(self) -> tuple[str, ...]:
        """What the blocks are called: N and L, numbered where there are several of a kind (N1, L, N2)."""
        kinds = self.structure.split("-")
        return tuple(
            f"{kind}{kinds[: i + 1].count(kind)}" if kinds.count(kind) > 1 else kind
            for i, kind in enumerate(kinds)
        )

    @property
    def linear(self) -> tuple[TransferFunction, ...]:
        """The linear blocks, in their order."""
        return tuple(block for block in self.blocks if isinstance(block, TransferFunction))

    @property
    def static(self) -> tuple[StaticFunction, ...]:
        """The static functions, in their order."""
        return tuple(block for block in self.blocks if isinstance(block, StaticFunction))

    @property
    def is_continuous(self) -> bool:
        """Whether there are linear blocks, all of them continuous: they have samples at any interval."""
        return bool(self.linear) and all(isinstance(block, SampledTransferFunction) for block in self.linear)

    def every(self, dt: float) -> BlockChain:
        """The chain of the same continuous blocks for samples every ``dt``.

        Raises
        ------
        ValueError
            If a linear block is discrete, and works at its own interval.
        """
        if dt == self.dt:
            return self
        if not self.is_continuous:
            raise ValueError("a discrete block has samples at its own interval only")
        blocks = (
            block.every(dt) if isinstance(block, SampledTransferFunction) else block for block in self.blocks
        )
        return BlockChain(tuple(blocks), dt)

    def signals(
        self, u: Array, start: Start = "rest", states: tuple[Array, ...] | None = None
    ) -> tuple[Array, ...]:
        """The input (N,) and what stands behind each block.

        Parameters
        ----------
        u : array, shape (N,)
            The input.
        start : {"rest", "settled"}
            Zero before the first sample, or the first input for ever, to which all blocks have settled.
        states : tuple of arrays, optional
            What to add to the state of each linear block at the first sample, as ``scipy.signal.lfilter``
            takes it (``zi``), of shape (max(len(b), len(a) + 1) - 1,).

        Raises
        ------
        ValueError
            If a settled start is asked of a block without static gain (a pole at z = 1).
        """
        from scipy.signal import lfilter

        signals = [np.asarray(u, dtype=float)]
        rest = iter(states or ())
        for block in self.blocks:
            x = signals[-1]
            if isinstance(block, StaticFunction):
                signals.append(block(x))
                continue
            if not len(x):
                # lfilter takes no empty signal through a block without feedback.
                signals.append(x)
                continue
            b, denominator = np.asarray(block.b, dtype=float), block.denominator
            state = settled_state(b, denominator) * x[0] if start == "settled" else 0.0
            zi = np.zeros(max(len(b), len(denominator)) - 1) + state + next(rest, 0.0)
            signals.append(np.asarray(lfilter(b, denominator, x, zi=zi)[0]))
        return tuple(signals)

    def response(self, u: Array, start: Start = "rest", states: tuple[Array, ...] | None = None) -> Array:
        """The output (N,) to an input (N,); as :meth:`signals`."""
        return self.signals(u, start, states)[-1]


def free_response(block: TransferFunction, state: Array, samples: int) -> Array:
    """What a state (n,) at the first sample, as ``zi`` of lfilter, adds to the output of a block: (samples,).

    With Z = z_0 + z_1 q^-1 + ... it is the impulse response of Z/F.

    Examples
    --------
    >>> free_response(TransferFunction(b=(1.0,), a=(0.5,)), np.array([2.0]), 3)
    array([2. , 1. , 0.5])
    """
    from scipy.signal import lfilter

    impulse = np.zeros(samples)
    if not len(state):
        return impulse
    impulse[:1] = 1.0
    return np.asarray(lfilter(state, block.denominator, impulse))


def settled_state(b: Array, denominator: Array) -> Array:
    """The state (of a direct form II transposed) to which the block settles under a constant input of 1.

    Raises
    ------
    ValueError
        If the block has a pole at z = 1, and settles nowhere.
    """
    total = float(denominator.sum())
    if abs(total) <= 1e-12 * float(np.abs(denominator).sum()):
        raise ValueError("a block with a pole at z = 1 settles nowhere: start it from rest")
    # z_i = sum_{j > i} (b_j - a_j y) with the constant output y.
    terms = np.zeros(max(len(b), len(denominator)))
    terms[: len(b)] = b
    terms[: len(denominator)] -= denominator * (float(b.sum()) / total)
    return np.asarray(terms[:0:-1].cumsum()[::-1])
