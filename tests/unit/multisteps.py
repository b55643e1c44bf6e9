"""Records of example 1 of Chen, Hwang and Chang 2009, and static functions that a model can meet exactly."""

from collections.abc import Callable

import numpy as np

from hident.arrays import Array
from hident.estimators.moving_horizon.hammerstein.static_functions import (
    PolynomialFunction,
    ThreeSegmentFunction,
)
from hident.linear_blocks import ContinuousTransferFunction
from hident.records import Record

BLOCK = ContinuousTransferFunction((1.0, -1.0), (4.0, 4.0, 3.0), 2.0)
THREE_SEGMENTS = ThreeSegmentFunction((1.5, -0.2, -0.3, 0.4, 0.7), -0.8, 0.6)
CUBIC = PolynomialFunction((1.0, 0.3, -0.2))


def levels(seed: int, count: int) -> Array:
    """Random levels (count,) as in the paper: gaussian, clipped to two standard deviations."""
    return np.clip(1.25 * np.random.default_rng(seed).normal(size=count), -2.5, 2.5)


def record(
    seed: int = 0,
    f: Callable[[Array], Array] = THREE_SEGMENTS,
    *,
    block: ContinuousTransferFunction = BLOCK,
    dt: float = 0.1,
    duration: float = 100.0,
    hold: float = 1.0,
    nsr: float = 0.0,
) -> Record:
    """Levels held for ``hold`` through ``f`` and the block, with white noise."""
    samples = round(duration / dt) + 1
    u = np.repeat(levels(seed, round(duration / hold) + 1), round(hold / dt))[:samples]
    y = block.respond(f(u), dt)
    noise = np.random.default_rng([seed, 1]).normal(size=samples)
    return Record(u, y + nsr / np.sqrt(1 - nsr**2) * np.std(y) * noise, dt)
