"""Rational models by linear least squares: where the fits of chains of blocks start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hident.arrays import Array, Complex
from hident.estimators.prediction_error.criterion import Data, least_squares
from hident.linear_blocks import TransferFunction

_FARTHEST = 0.995
_ITERATIONS = 12


def steiglitz_mcbride(
    data: Data, nb: int, nf: int, nk: int, *, constant: bool = True
) -> list[TransferFunction]:
    """The models B/F of all iterations, the stable ones; each with a constant beside it, which is left out.

    Least squares of F y = B u + c after both have been filtered by 1/F of the iteration before (Steiglitz and
    McBride 1965); the first is the ARX model.
    """
    found = []
    f = np.zeros(0)
    for _ in range(_ITERATIONS):
        denominator = np.r_[1.0, f]
        u, y = (data.filtered(np.ones(1), denominator, signal) for signal in (data.u, data.y))
        rows = np.empty((nb + nf + 1, len(u)))
        for j in range(nb):
            data.delayed(u, nk + j, rows[j])
        for j in range(nf):
            data.delayed(y, j + 1, rows[nb + j], -1.0)
        rows[-1] = float(constant)
        numbers = least_squares(rows[:, data.counted], y[data.counted])
        f = -np.asarray(stabilised(TransferFunction(a=tuple((-numbers[nb : nb + nf]).tolist()))).a)
        b = (*(0.0,) * nk, *numbers[:nb].tolist())
        found.append(TransferFunction(b=b, a=tuple((-f).tolist())))
    return found


def stabilised(block: TransferFunction, farthest: float = _FARTHEST) -> TransferFunction:
    """The block with unstable poles reflected into the unit circle, and none beyond ``farthest`` from 0."""
    if not block.a:
        return block
    poles = block.poles()
    outside = np.abs(poles) > 1.0
    poles[outside] = 1.0 / poles[outside].conj()
    size = np.abs(poles)
    near = size > farthest
    if not np.any(outside | near):
        return block
    poles[near] *= farthest / size[near]
    return TransferFunction(block.b, tuple((-np.poly(poles).real[1:]).tolist()))


def demeaned(data: Data) -> Data:
    """The data less the means of what counts."""
    u = data.u - np.mean(data.u[data.counted])
    y = data.y - np.mean(data.y[data.counted])
    return replace(data, u=u, y=y)


def from_roots(roots: Complex) -> Array:
    """The real polynomial in q^-1, beginning with 1, that has these roots in z."""
    return np.asarray(np.poly(roots).real) if len(roots) else np.ones(1)
