"""Scores of a linear block and of a whole model against the truth."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete

from hident.errors import ConfigError
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction
from hident.metrics.models import LinearPercentError, ValidationPercentError, fit_error
from hident.metrics.values import TrueValue
from hident.records import Estimate, Record, Truth
from hident.signals.excitation import Multistep
from tests.unit.multisteps import BLOCK

QUICK = settings(deadline=None, derandomize=True, max_examples=20)
RECORD = Record(np.zeros(3), np.zeros(3), 0.1, Truth(continuous=BLOCK, values={"a_1": 4.0, "b_1": -1.0}))


def percent(estimate, step=1.0):
    (found,) = LinearPercentError(step=step).evaluate(estimate, RECORD)
    return found


def discrete(block, step):
    """a' and b' of a block without its delay at unit gain, by scipy."""
    b, a, _ = cont2discrete((block.b[::-1], block.denominator), step)
    return -a[1:], b.ravel()[1:] / block.b[0]


class TestLinearPercentError:
    @pytest.mark.parametrize("step", [0.1, 1.0, 2.0])
    def test_is_zero_for_the_truth(self, step):
        assert percent(Estimate(continuous=BLOCK), step) == pytest.approx(0.0, abs=1e-9)
        assert percent(Estimate(linear=BLOCK.sampled(step)), step) == pytest.approx(0.0, abs=1e-9)

    @QUICK
    @given(gain=st.floats(-50, 50).filter(lambda g: abs(g) > 0.01), delay=st.floats(0, 9))
    def test_gain_and_delay_do_not_count(self, gain, delay):
        other = ContinuousTransferFunction((1.0, -0.9), (4.0, 4.1, 3.0), 2.0)
        moved = ContinuousTransferFunction(other.scaled(gain).b, other.a, delay)
        wanted = percent(Estimate(continuous=other))
        assert percent(Estimate(continuous=moved)) == pytest.approx(wanted, rel=1e-9)

    def test_leading_zeros_of_a_discrete_estimate_are_its_delay(self):
        sampled = ContinuousTransferFunction((1.2, -1.0), (3.7, 4.1, 2.8)).sampled(1.0)
        late = TransferFunction(b=(0.0, 0.0, *sampled.b), a=sampled.a)
        assert percent(Estimate(linear=late)) == percent(Estimate(linear=sampled))

    @pytest.mark.parametrize("step", [0.5, 1.0])
    def test_is_the_sum_of_errors_over_that_of_the_truth(self, step):
        other = ContinuousTransferFunction((1.2, -1.0), (3.7, 4.1, 2.8), 2.0)
        true, found = np.concatenate(discrete(BLOCK, step)), np.concatenate(discrete(other, step))
        wanted = 100 * np.sum(np.abs(found - true)) / np.sum(np.abs(true))
        assert percent(Estimate(continuous=other), step) == pytest.approx(wanted, rel=1e-8)

    def test_a_discrete_estimate_is_taken_as_it_is(self):
        a, b = discrete(BLOCK, 1.0)
        wrong = np.array([0.01, 0.0, 0.0])
        moved = TransferFunction(b=(0.0, *b), a=tuple(a + wrong))
        # Its static gain changes with a', and b' is compared at unit gain.
        unit = b * (1 - a.sum() - 0.01) / b.sum()
        wanted = 100 * (0.01 + np.sum(np.abs(unit - b))) / np.sum(np.abs(np.concatenate((a, b))))
        assert percent(Estimate(linear=moved)) == pytest.approx(wanted, rel=1e-6)

    def test_blocks_of_other_orders_are_padded(self):
        other = ContinuousTransferFunction((1.0,), (3.7, 7.2), 2.0)
        true, found = discrete(BLOCK, 1.0), discrete(other, 1.0)
        errors = sum(np.sum(np.abs(t - np.append(f, 0.0))) for t, f in zip(true, found, strict=True))
        wanted = 100 * errors / np.sum(np.abs(np.concatenate(true)))
        assert percent(Estimate(continuous=other)) == pytest.approx(wanted, rel=1e-8)

    def test_takes_either_kind_of_block(self):
        metric = LinearPercentError()
        assert metric.step is None
        assert metric.needs_of_estimate() == {"linear or continuous"}
        assert metric.needs_of_truth() == {"continuous"}
        with pytest.raises(ConfigError, match="must be greater than 0"):
            LinearPercentError(step=0)


class TestValidationPercentError:
    METRIC = ValidationPercentError(excitation=Multistep(switching_time=1, std=1), samples=300)

    def score(self, response, metric=METRIC):
        truth = Truth(response=BLOCK.respond)
        (found,) = metric.evaluate(Estimate(response=response), Record(np.zeros(3), np.ones(3), 0.1, truth))
        return found

    def test_is_zero_for_the_truth(self):
        assert self.score(BLOCK.respond) == 0.0

    @QUICK
    @given(gain=st.floats(-2, 2))
    def test_is_the_share_that_is_missed(self, gain):
        seen = []

        def response(u, dt):
            seen.append((u, dt))
            return gain * BLOCK.respond(u, dt)

        found = self.score(response)
        ((u, dt),) = seen
        y = BLOCK.respond(u, dt)
        assert (len(u), dt) == (300, 0.1)
        wanted = 100 * abs(1 - gain) * np.sqrt(np.mean(y**2)) / np.std(y)
        assert found == pytest.approx(wanted, rel=1e-9, abs=1e-12)

    def test_every_trial_sees_the_same_input(self):
        assert self.score(lambda u, dt: u) == self.score(lambda u, dt: u)

    def test_needs_both_responses(self):
        assert self.METRIC.needs_of_truth() == self.METRIC.needs_of_estimate() == {"response"}

    def test_fit_error_by_hand(self):
        assert fit_error(np.array([1.0, 2.0]), np.array([1.0, 3.0])) == pytest.approx(100 / np.sqrt(2))


def test_true_value_is_that_of_the_truth_and_needs_no_estimate():
    metric = TrueValue(of=("b_1", "a_1"))
    assert metric.evaluate(Estimate(), RECORD) == [-1.0, 4.0]
    assert metric.labels("t") == ("t b_1", "t a_1")
    assert metric.needs_of_estimate() == frozenset()
    assert metric.needs_of_truth() == {"value a_1", "value b_1"}
