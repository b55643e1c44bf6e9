"""What scores make of a model's linear block that does not settle."""

import math

import numpy as np
import pytest

from hident.linear_blocks import ContinuousTransferFunction, TransferFunction
from hident.metrics.models import SettlingTime, ValidationPercentError
from hident.model_output import has_stable_block
from hident.records import Estimate, Record, Truth
from hident.signals.excitation import Staircase

LAG = ContinuousTransferFunction((3.0,), (2.0,), delay=0.7)
UNSTABLE = ContinuousTransferFunction((3.0,), (-2.0,))
RECORD = Record(np.zeros(3), np.zeros(3), 0.1, Truth(response=LAG.respond))
STEPS = ValidationPercentError(excitation=Staircase(levels=(0, 1), hold=1), samples=40)


@pytest.mark.parametrize("band", [0.05, 0.02])
def test_a_lag_settles_after_its_time_constant_times_a_logarithm(band):
    metric = SettlingTime(band=band)
    assert metric.evaluate(Estimate(continuous=LAG), RECORD) == pytest.approx(
        (2.0 * math.log(1.0 / band),), rel=1e-4
    )
    assert metric.needs_of_estimate() == {"continuous"}


def test_the_band_is_five_percent_by_default():
    assert SettlingTime().band == 0.05


def test_an_unstable_block_never_settles():
    assert SettlingTime().evaluate(Estimate(continuous=UNSTABLE), RECORD) == (math.inf,)


def test_the_response_of_an_unstable_model_is_infinitely_wrong():
    # However short the record, over which the response itself is finite.
    estimate = Estimate(continuous=UNSTABLE, response=UNSTABLE.respond)
    assert STEPS.evaluate(estimate, RECORD) == (math.inf,)
    assert STEPS.evaluate(Estimate(continuous=LAG, response=LAG.respond), RECORD) == (0.0,)


def test_an_unstable_discrete_block_is_seen():
    assert not has_stable_block(Estimate(linear=TransferFunction(a=(1.5,))))
    assert has_stable_block(Estimate(linear=TransferFunction(a=(0.5,))))
