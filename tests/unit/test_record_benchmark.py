"""The benchmark of records scores what a model of a detrended record simulates at that record's level."""

import numpy as np

import hident as hi
from tests.benchmarks import records


def test_a_record_without_its_means_is_met():
    u = np.random.default_rng(4).uniform(-1, 1, 801)
    v = u + 0.5 * u**3
    y = 98 + 0.5 * v[1:] + 0.3 * v[:-1]
    measured = 20 + u[1:], y
    means = {"input": float(np.mean(measured[0])), "output": float(np.mean(measured[1]))}
    level = [
        hi.Record(measured[0][part] - means["input"], measured[1][part] - means["output"], 1.0, offsets=means)
        for part in (slice(0, 400), slice(400, 800))
    ]
    record = hi.Record(level[0].u, level[0].y, 1.0, offsets=means, validation=level[1])
    given = records.hidents()[1]
    row = records.row(given, record, 10)
    assert float(row[2]) > 90, row
