"""Errors of impulse and frequency responses: known values, mixtures of discrete and continuous blocks."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hident as hi
from hident.metrics.block_responses import (
    frequency_response_percent_error,
    impulse_response_percent_error,
)
from hident.numerics.freedoms import Freedom
from tests.unit import plans

QUICK = settings(deadline=None, derandomize=True, max_examples=30)
LAG = hi.ContinuousTransferFunction(b=(2.0,), a=(4.0, 3.0), delay=0.25)
DISCRETE = hi.TransferFunction(b=(0.0, 1.0, 0.4), a=(0.6,))
SIZES = st.floats(0.1, 10.0)
TEXT = """\
version: 1
title: A block's responses
trials: 2
dt: 0.1
samples: 400
system: {kind: hammerstein, nonlinearity: {kind: polynomial, coefficients: [0, 1, 0.5]}, linear: LINEAR}
excitation: {kind: multistep, switching_time: 1, std: 1, limits: [-3, 3]}
estimators: {e: ESTIMATOR}
metrics: {m: METRIC}
"""
CONTINUOUS = "{kind: continuous, a: [2.5, 1.5], b: [3]}"
HORIZONS = (
    "{kind: iterative_hammerstein, nonlinearity: {kind: polynomial, degree: 2}, first: {n: 2, horizon: 8}}"
)
VOROS = "{kind: voros_hammerstein, n: 2, m: 2, degree: 2, step: STEP}"


@pytest.fixture
def planned(tmp_path):
    def planned(linear=CONTINUOUS, estimator=HORIZONS, metric="{kind: impulse_response_error}"):
        words = {"LINEAR": linear, "ESTIMATOR": estimator, "METRIC": metric}
        return plans.planned(tmp_path, plans.replaced(TEXT, words))

    return planned


@pytest.fixture
def refused(tmp_path):
    def refused(linear=CONTINUOUS, estimator=HORIZONS, metric="{kind: impulse_response_error}"):
        words = {"LINEAR": linear, "ESTIMATOR": estimator, "METRIC": metric}
        return plans.refusals(tmp_path, plans.replaced(TEXT, words))

    return refused


def record_of(linear, dt=None):
    system = hi.Hammerstein(nonlinearity="abs", linear=linear)
    return hi.simulate(system, hi.Multistep(switching_time=5, std=1), 20, dt=dt)


def percent(estimate, record, metric):
    return hi.score(estimate, record, e=metric)["e"]


class TestImpulseResponse:
    def test_an_autoregression_by_hand(self):
        # sum (a^k - c^k)^2 = 1/(1-a^2) + 1/(1-c^2) - 2/(1-ac)
        a, c = 0.8, 0.6
        squared = 1 / (1 - a**2) + 1 / (1 - c**2) - 2 / (1 - a * c)
        found, true = hi.TransferFunction(a=(a,)), hi.TransferFunction(a=(c,))
        expected = 100.0 * math.sqrt(squared * (1 - c**2))
        assert impulse_response_percent_error(found, true) == pytest.approx(expected, rel=1e-12)

    def test_the_best_factor_by_hand(self):
        # The angle between two geometric series.
        a, c = 0.8, 0.6
        cosine = math.sqrt((1 - a**2) * (1 - c**2)) / (1 - a * c)
        found, true = hi.TransferFunction(a=(a,)), hi.TransferFunction(b=(7.0,), a=(c,))
        expected = 100.0 * math.sqrt(1 - cosine**2)
        free: list[Freedom] = ["gain"]
        error = impulse_response_percent_error(found, true, free)
        assert error == pytest.approx(expected, rel=1e-9)

    @QUICK
    @given(SIZES, st.booleans(), st.integers(0, 5), st.integers(0, 5))
    def test_what_is_free_does_not_count(self, size, turned, late, true_late):
        gain = -size if turned else size
        found = hi.TransferFunction((0.0,) * late + tuple(gain * b for b in DISCRETE.b), DISCRETE.a)
        true = hi.TransferFunction((0.0,) * true_late + DISCRETE.b, DISCRETE.a)
        assert impulse_response_percent_error(found, true, ("gain", "sign", "delay")) < 1e-10
        if turned:
            assert impulse_response_percent_error(found, true, ("gain", "delay")) > 30.0
        if late != true_late:
            assert impulse_response_percent_error(found, true, ("gain", "sign")) > 10.0

    def test_the_sign_alone(self):
        found = hi.TransferFunction(b=(-1.0, -0.5))
        true = hi.TransferFunction(b=(2.0, 1.0))
        free: list[Freedom] = ["sign"]
        error = impulse_response_percent_error(found, true, free)
        assert error == pytest.approx(50.0, rel=1e-12)

    def test_an_unstable_estimate_is_infinitely_wrong(self):
        assert impulse_response_percent_error(hi.TransferFunction(a=(1.01,)), DISCRETE) == math.inf

    def test_a_discrete_estimate_of_a_continuous_block_at_its_own_interval(self):
        record = record_of(hi.Continuous(a=[4, 3], b=[2], delay=0.25), dt=0.1)
        for step in (0.1, 0.5):
            estimate = hi.Estimate(linear=LAG.sampled(step))
            metric = hi.ImpulseResponseError(step=step)
            assert percent(estimate, record, metric) < 1e-10
            scaled = hi.Estimate(linear=LAG.scaled(1.5).sampled(step))
            assert percent(scaled, record, metric) == pytest.approx(50.0, rel=1e-9)
        assert percent(hi.Estimate(linear=LAG.sampled(0.5)), record, hi.ImpulseResponseError()) > 10.0

    def test_a_continuous_estimate_of_either_block(self):
        estimate = hi.Estimate(continuous=LAG)
        record = record_of(hi.Continuous(a=[4, 3], b=[1], delay=0.25), dt=0.1)
        assert percent(estimate, record, hi.ImpulseResponseError()) == pytest.approx(100.0, rel=1e-9)
        sampled = LAG.sampled(0.1)
        record = record_of(hi.Arma(a=list(sampled.a), b=list(sampled.b)), dt=0.1)
        assert percent(estimate, record, hi.ImpulseResponseError()) < 1e-8

    def test_the_interval_of_a_method_follows_by_itself(self, planned):
        (unit,) = planned(estimator=VOROS.replace("STEP", "0.5")).units
        found, record = fitted(unit)
        error = hi.score(found, record, unit.estimator, e=unit.metrics["m"])["e"]
        assert error < 1.0

    def test_a_gain_of_the_block_is_no_error_of_a_method_that_holds_it_at_one(self, planned):
        (unit,) = planned().units
        found, record = fitted(unit)
        assert hi.score(found, record, unit.estimator, e=unit.metrics["m"])["e"] < 1.0
        assert hi.score(found, record, e=unit.metrics["m"])["e"] == pytest.approx(200 / 3, abs=1.0)

    def test_what_cannot_be_compared_is_refused(self, refused):
        (message,) = refused(
            estimator=VOROS.replace("STEP", "0.5"), metric="{kind: impulse_response_error, step: 0.2}"
        )
        assert (
            "compares blocks sampled every 0.2, and the estimate's is sampled every 0.5: leave out" in message
        )
        (message,) = refused("{kind: arma, a: [0.5], b: [0, 1]}", VOROS.replace("STEP", "0.2"))
        assert "compares blocks sampled every 0.2, and the system's is sampled every 0.1" in message
        (message,) = refused(metric="{kind: impulse_response_error, up_to: [constant]}")
        assert "this metric can choose no constant (allowed: gain, sign, delay)" in message


def fitted(unit):
    record = hi.simulate(unit.data.system, unit.data.excitation, unit.data.samples, dt=unit.data.dt)
    return hi.fit(unit.estimator, record), record


class TestFrequencyResponse:
    def test_a_pole_by_hand(self):
        omega = np.array([1.0, 3.0])
        found, true = (hi.ContinuousTransferFunction(b=(1.0,), a=(a,)) for a in (1.0, 2.0))
        at = [1 / (1 + 1j * w) for w in omega], [1 / (1 + 2j * w) for w in omega]
        expected = 100.0 * np.linalg.norm(np.subtract(*at)) / np.linalg.norm(at[1])
        record = record_of(hi.Continuous(a=[2]), dt=0.1)
        metric = hi.FrequencyResponseError(band=[1, 3], points=2)
        assert percent(hi.Estimate(continuous=found), record, metric) == pytest.approx(expected, rel=1e-12)
        assert true.frequency_response(omega) == pytest.approx(at[1], rel=1e-12)

    def test_a_discrete_gain_is_that_of_a_sine(self):
        omega, dt, k = 0.7, 0.5, np.arange(400)
        gain = complex(DISCRETE.frequency_response(np.array(omega), dt))
        y = DISCRETE.filter(np.sin(omega * dt * k))
        settled = abs(gain) * np.sin(omega * dt * k + np.angle(gain))
        np.testing.assert_allclose(y[100:], settled[100:], atol=1e-12)

    @QUICK
    @given(SIZES, st.booleans(), st.floats(-3.0, 3.0))
    def test_what_is_free_does_not_count(self, size, turned, delay):
        gain = -size if turned else size
        omega = np.geomspace(0.01, 10.0, 60)
        true = LAG.frequency_response(omega)
        found = gain * true * np.exp(-1j * omega * delay)
        assert frequency_response_percent_error(found, true, omega, ("gain", "sign", "delay")) < 1e-5
        only = frequency_response_percent_error(found, true, omega, ("gain", "sign"))
        assert only > 10.0 or abs(delay) < 0.5

    def test_discrete_blocks_are_late_by_whole_samples(self):
        record = record_of(hi.Continuous(a=[4, 3], b=[2], delay=0.25), dt=0.1)
        late = hi.ContinuousTransferFunction(b=(4.0,), a=(4.0, 3.0), delay=0.65)
        metric = hi.FrequencyResponseError(up_to=["gain", "delay"])
        assert percent(hi.Estimate(linear=late.sampled(0.1)), record, metric) < 1e-10
        between = hi.ContinuousTransferFunction(b=(4.0,), a=(4.0, 3.0), delay=0.6)
        assert percent(hi.Estimate(linear=between.sampled(0.1)), record, metric) > 0.1
        assert percent(hi.Estimate(continuous=between), record, metric) < 1e-5

    def test_an_unstable_estimate_has_a_frequency_response_too(self):
        record = record_of(hi.Ar(a=[0.5]))
        estimate = hi.Estimate(linear=hi.TransferFunction(a=(2.0,)))
        assert math.isfinite(percent(estimate, record, hi.FrequencyResponseError()))

    def test_a_band_beyond_the_nyquist_frequency_is_refused(self, refused):
        metric = "{kind: frequency_response_error, band: [1, 40]}"
        assert refused(metric=metric) == []
        (message,) = refused(estimator=VOROS.replace("STEP", "0.1"), metric=metric)
        assert "has a band up to 40, and a discrete block's frequencies end at 31.4159" in message
        (message,) = refused(metric="{kind: frequency_response_error, band: [0, 4]}")
        assert "'band' must begin above zero, not at 0" in message
