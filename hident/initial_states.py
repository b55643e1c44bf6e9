"""The states in which a chain of blocks begins, as the first samples of its output tell them."""

from __future__ import annotations

import math

import numpy as np

from hident.arrays import Array
from hident.block_chain import BlockChain, free_response, settled_state
from hident.linear_blocks import TransferFunction

# States show until this part of them is left.
_LEFT = 1e-3
# So many samples for each state, at least.
_SAMPLES = 10
_ENOUGH = 1e-12


def state_sizes(chain: BlockChain) -> tuple[int, ...]:
    """How many numbers the state of each linear block has, in their order."""
    return tuple(max(len(block.b), len(block.denominator)) - 1 for block in chain.linear)


def showing(chain: BlockChain, samples: int) -> int:
    """In how many of the first samples the states show: until a thousandth is left, ten for each at least.

    Examples
    --------
    >>> showing(BlockChain((TransferFunction(b=(1.0,), a=(0.5,)),)), 1000)
    11
    """
    total = 0.0
    for block, size in zip(chain.linear, state_sizes(chain), strict=True):
        radius = block.radius() if block.a else 0.0
        if radius >= 1.0:
            return samples
        total += size + (math.log(_LEFT) / math.log(radius) if radius > 0.0 else 0.0)
    return min(samples, max(math.ceil(total), _SAMPLES * sum(state_sizes(chain))))


def initial_states(chain: BlockChain, u: Array, y: Array) -> tuple[Array, ...]:
    """The states of the linear blocks at the first sample with which the first outputs are met best.

    Beyond the states that are settled to the first input, from which the search starts: those of
    :meth:`BlockChain.signals`. Least squares over the samples in which they show (:func:`showing`).

    Parameters
    ----------
    chain : BlockChain
        The blocks, none with a pole at z = 1.
    u, y : array, shape (N,)
        Input and measured output. Where y is not finite, the states are settled.

    Returns
    -------
    tuple of arrays
        One for each linear block.

    Examples
    --------
    >>> chain = BlockChain((TransferFunction(b=(0.0, 0.5), a=(0.5,)),))
    >>> [state] = initial_states(chain, np.ones(20), 1.0 + 2.0 * 0.5 ** np.arange(20))
    >>> state.round(9).tolist()
    [2.0]
    """
    from scipy.optimize import least_squares

    sizes = state_sizes(chain)
    count = showing(chain, len(u))
    u, y = u[:count], y[:count]
    ends = np.cumsum(sizes)[:-1]
    begun = np.zeros(sum(sizes))

    def errors(z: Array) -> Array:
        return chain.response(u, "settled", tuple(np.split(z, ends))) - y

    size = float(np.linalg.norm(errors(begun)))
    if not len(begun) or size == 0.0 or not np.isfinite(size):
        return tuple(np.split(begun, ends))
    # No unit matters: the first step is measured by what is to be explained.
    found = least_squares(
        lambda z: errors(z) / size,
        begun,
        jac=lambda z: _columns(chain, u, tuple(np.split(z, ends))) / size,
        x_scale="jac",
        ftol=_ENOUGH,
        xtol=_ENOUGH,
        gtol=None,
    )
    return tuple(np.split(np.asarray(found.x), ends))


def _columns(chain: BlockChain, u: Array, states: tuple[Array, ...]) -> Array:
    """The derivatives (N, S) of the output by the states."""
    from scipy.signal import lfilter

    signals, waiting = chain.signals(u, "settled", states), iter(states)
    rows = np.zeros((0, len(u)))
    for x, block in zip(signals, chain.blocks, strict=False):
        if not isinstance(block, TransferFunction):
            rows = rows * block.slope(x)
            continue
        b, denominator = np.asarray(block.b, dtype=float), block.denominator
        if len(rows):
            rows = lfilter(b, denominator, rows, zi=rows[:, :1] * settled_state(b, denominator))[0]
        response = free_response(block, np.ones(1), len(u))
        own = [np.r_[np.zeros(j), response][: len(u)] for j in range(len(next(waiting)))]
        rows = np.vstack((rows, *own))
    return rows.T
