"""Standard errors of the two-stage Wiener estimate, against the spread of simulated estimates."""

import numpy as np
import pytest

from hident.estimators.moving_horizon.wiener.iterative_wiener import IterativeWiener
from hident.linear_blocks import ContinuousTransferFunction
from hident.records import Record
from hident.systems.nonlinearity import PiecewiseLinear

DT, SAMPLES, TRIALS = 0.1, 1201, 60
BLOCK = ContinuousTransferFunction((1.0, -2.0), (4.0, 5.0, 2.0), 1.0)
TRUTH = {"a_1": 4.0, "a_2": 5.0, "a_3": 2.0, "b_0": 1.0, "b_1": -2.0}
BENT = PiecewiseLinear(points=((-1, -0.7), (-0.4, -0.2), (0, 0), (0.5, 0.5), (1.5, 0.9)))
SECOND = {"n": 3, "m": 1}


def estimates(second):
    spec = IterativeWiener.model_validate(
        {
            "nonlinearity": {"kind": "four_segment", "partition": [-0.2, 0.5]},
            "delay": 1,
            "start": 2.5,
            "first": {"n": 3, "m": 1, "horizon": 15},
            "second": second,
        }
    )
    rng = np.random.default_rng(11)
    for _ in range(TRIALS):
        u = np.repeat(np.clip(1.25 * rng.standard_normal(SAMPLES // 10 + 1), -2.5, 2.5), 10)[:SAMPLES]
        y = BENT(BLOCK.respond(u, DT))
        y += 0.02 * np.std(y) * rng.standard_normal(SAMPLES)
        yield spec.fit(Record(u, y, DT), rng).values


@pytest.mark.parametrize("second", [None, SECOND], ids=["first stage", "both stages"])
def test_intervals_hold_the_truth_as_often_as_they_say(second):
    found = list(estimates(second))
    errors = {
        name: np.array([(values[name] - true) / values[f"se_{name}"] for values in found])
        for name, true in TRUTH.items()
    }
    for name, of_one in errors.items():
        assert 0.88 <= np.mean(np.abs(of_one) < 1.96) <= 1.0, name
        assert 0.75 < np.std(of_one) < 1.25, name
    # Its standard deviation is 0.05, and it is 0.8 where standard errors are 25 % too large.
    assert 0.87 < np.sqrt(np.mean(np.square([*errors.values()]))) < 1.15


def test_a_polynomial_has_no_standard_errors():
    spec = IterativeWiener.model_validate(
        {"nonlinearity": {"kind": "polynomial", "degree": 3}, "first": {"n": 1, "horizon": 5}}
    )
    assert not any("se_" in name for name in spec.provides())
