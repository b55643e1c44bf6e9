"""Discrete models as responses to inputs of any sampling interval that fits."""

from __future__ import annotations

import numpy as np

from hident.arrays import Array, Characteristic, Index
from hident.numerics.whole import nearest_whole
from hident.records import Response


def at_step(simulate: Characteristic, step: float) -> Response:
    """A discrete model as a response for inputs sampled every ``dt``.

    Where ``dt`` is a multiple of ``step``, the input is held. Where ``step`` is a multiple of ``dt``, the
    input is decimated and the output interpolated by straight lines. The response raises ValueError for
    any other ``dt``.
    """

    def response(u: Array, dt: float) -> Array:
        if finer := nearest_whole(dt / step):
            return simulate(np.repeat(u, finer))[::finer]
        if coarser := nearest_whole(step / dt):
            at: Index = np.arange(0, len(u), coarser)
            return np.interp(np.arange(len(u)), at, simulate(u[at]))
        raise ValueError(
            f"the sampling interval {dt:g} and the model's step {step:g} do not divide each other"
        )

    return response
