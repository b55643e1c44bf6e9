"""Noise-free Wiener records and what the tests estimate from them."""

import numpy as np

from hident import plugins
from hident.config.spec import Of
from hident.estimators.moving_horizon.transform.time_weighted import Horizons
from hident.estimators.moving_horizon.wiener.four_segment import FourSegment
from hident.estimators.moving_horizon.wiener.iteration import Wiener
from hident.linear_blocks import ContinuousTransferFunction
from hident.records import Record

plugins.load()

TRUTH = ContinuousTransferFunction((1.2, -0.5), (3.0, 2.0), 0.4)
SEGMENTS = FourSegment((0.5, 2.0, 3.0), -0.6, 0.5)
FIXED = {"kind": "four_segment", "partition": [-0.6, 0.5]}
SETTINGS = {
    "kind": "iterative_wiener",
    "nonlinearity": FIXED,
    "delay": 0.4,
    "first": {"n": 2, "m": 1, "horizon": 12},
    "second": {"n": 2, "m": 1},
}


def spec(**changes):
    return Of("estimator").validate(SETTINGS | changes)


def cubic(x):
    return x + 0.2 * x**2 + 0.05 * x**3


def record(function=SEGMENTS, dt=0.05, duration=100.0, seed=0):
    """Steps of random height, one time unit long."""
    rng = np.random.default_rng(seed)
    samples, hold = round(duration / dt) + 1, round(1.0 / dt)
    levels = np.clip(1.5 * rng.standard_normal(samples // hold + 1), -3.0, 3.0)
    u = np.repeat(levels, hold)[:samples]
    return Record(u, function(TRUTH.respond(u, dt)), dt)


def fit(data=None, **changes):
    return spec(**changes).fit(record() if data is None else data, None)


def wiener(data, delay=0.4, m=1, horizon=12.0):
    horizons = Horizons.of(len(data), data.dt, eta=horizon, overlap=0.1, order=2)
    return Wiener.of(data.u, data.y, data.dt, m=m, delay=delay, horizons=horizons)
