"""Voros's methods for Hammerstein and Wiener systems."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from hident.errors import ConfigError, EstimationError
from hident.estimators.convergence import History
from hident.estimators.discrete_response import at_step
from hident.estimators.voros.voros_hammerstein import (
    Rule,
    Structure,
    TwoSegmentPolynomial,
    VorosHammerstein,
    iterate,
    voros_hammerstein,
)
from hident.estimators.voros.voros_wiener import VorosWiener, voros_wiener
from hident.linear_blocks import TransferFunction
from hident.records import Record

RNG = np.random.default_rng(0)
LINEAR = TransferFunction(b=(0.0, 1.0, 0.5), a=(0.9, -0.3))
TWO_SEGMENTS = TwoSegmentPolynomial((1.2, -0.5, 0.3), (0.6, 0.4, -0.2))
MILD = TwoSegmentPolynomial((1.0, -0.2, 0.1), (0.8, 0.1, -0.05))
STRUCTURE = Structure(n=2, m=2, delay=1, degree=3)
HAMMERSTEIN = VorosHammerstein(n=2, m=2, degree=3)
WIENER = VorosWiener(n=2, m=2, degree=3)


def excited(samples=400, seed=1):
    return np.random.default_rng(seed).uniform(-1, 1, samples)


def hammerstein(u):
    return LINEAR.filter(TWO_SEGMENTS(u))


def wiener(u):
    return MILD(LINEAR.filter(u))


def settled(spec, **changes):
    return spec.model_copy(update={"tolerance": 1e-13, "max_iterations": 2000, **changes})


class TestRecoveryWithoutNoise:
    @pytest.mark.parametrize("relaxation", [1.0, 0.5])
    def test_hammerstein(self, relaxation):
        u = excited()
        found = settled(HAMMERSTEIN, relaxation=relaxation).fit(Record(u, hammerstein(u)), RNG)
        assert found.values["converged"] == 1.0
        np.testing.assert_allclose(found.linear.a, LINEAR.a, rtol=0, atol=1e-8)
        np.testing.assert_allclose(found.linear.b, LINEAR.b, rtol=0, atol=1e-8)
        np.testing.assert_allclose(found.nonlinearity.f, TWO_SEGMENTS.f, rtol=0, atol=1e-8)
        np.testing.assert_allclose(found.nonlinearity.g, TWO_SEGMENTS.g, rtol=0, atol=1e-8)

    @pytest.mark.parametrize("key", [1, 2, 3])
    def test_hammerstein_with_the_key_term_on_any_lag(self, key):
        u, block = excited(), TransferFunction(b=(0.0, 0.8, 1.0, 0.8), a=(0.9, -0.3))
        spec = settled(HAMMERSTEIN, m=3, key=key, relaxation=0.5)
        found = spec.fit(Record(u, block.filter(TWO_SEGMENTS(u))), RNG)
        assert found.values["converged"] == 1.0
        assert found.values[f"b_{key}"] == 1.0
        np.testing.assert_allclose(found.linear.a, block.a, rtol=0, atol=1e-8)
        np.testing.assert_allclose(found.linear.b, np.array(block.b) / block.b[key], rtol=0, atol=1e-8)
        np.testing.assert_allclose(
            found.nonlinearity.f, block.b[key] * np.array(TWO_SEGMENTS.f), rtol=0, atol=1e-8
        )

    @pytest.mark.parametrize("relaxation", [0.5, 0.2])
    def test_wiener(self, relaxation):
        u = excited()
        found = settled(WIENER, relaxation=relaxation).fit(Record(u, wiener(u)), RNG)
        assert found.values["converged"] == 1.0
        np.testing.assert_allclose(found.linear.a, LINEAR.a, rtol=0, atol=1e-8)
        np.testing.assert_allclose(found.linear.b, LINEAR.b, rtol=0, atol=1e-8)
        np.testing.assert_allclose(found.nonlinearity.f, MILD.f, rtol=0, atol=1e-8)
        np.testing.assert_allclose(found.nonlinearity.g, MILD.g, rtol=0, atol=1e-8)

    def test_delay_and_a_single_lag_need_no_iteration(self):
        u = excited()
        y = TransferFunction(b=(0.0, 0.0, 0.0, 1.0), a=(0.5,)).filter(TWO_SEGMENTS(u))
        found = VorosHammerstein(n=1, m=1, delay=3, degree=3).fit(Record(u, y), RNG)
        assert found.values["iterations"] == 1.0
        assert found.values["a_1"] == pytest.approx(0.5, abs=1e-10)
        assert found.values["g_3"] == pytest.approx(-0.2, abs=1e-10)

    def test_decimated_record(self):
        u, step = excited(), 5
        y = hammerstein(u)
        dense = Record(np.repeat(u, step), np.repeat(y, step), dt=0.2)
        found = settled(HAMMERSTEIN, step=1.0).fit(dense, RNG)
        np.testing.assert_allclose(found.linear.a, LINEAR.a, rtol=0, atol=1e-8)


class TestParametersAreNamed:
    def test_by_their_lags_and_segments(self):
        u = excited()
        found = settled(VorosHammerstein(n=1, m=2, delay=0, degree=2), tolerance=1e-6)
        values = found.fit(Record(u, TransferFunction(b=(1.0, 0.4), a=(0.5,)).filter(u)), RNG).values
        assert list(values) == ["a_1", "b_0", "b_1", "f_1", "f_2", "g_1", "g_2", "iterations", "converged"]
        assert values["b_0"] == 1.0
        assert values["b_1"] == pytest.approx(0.4, abs=1e-4)

    def test_history_begins_with_the_start_and_ends_with_the_estimate(self):
        u = excited()
        found = HAMMERSTEIN.fit(Record(u, hammerstein(u)), RNG)
        history = found.details["history"]
        assert isinstance(history, History)
        assert history.converged
        assert found.linear is not None
        ended = {**found.linear.values(), **found.values}
        for name, course in history.values.items():
            assert len(course) == found.values["iterations"] + 1
            assert course[-1] == ended[name]
        assert history.values["b_2"][0] == 0.0
        assert np.all(history.values["b_1"] == 1.0)

    def test_history_of_wiener_begins_with_the_linear_model(self):
        u = excited()
        history = (
            WIENER.model_copy(update={"relaxation": 0.5}).fit(Record(u, wiener(u)), RNG).details["history"]
        )
        start = {name: course[0] for name, course in history.values.items()}
        assert (start["f_1"], start["f_2"], start["g_1"], start["g_3"]) == (1.0, 0.0, 1.0, 0.0)


class TestResponse:
    @pytest.mark.parametrize(("spec", "system"), [(HAMMERSTEIN, hammerstein), (WIENER, wiener)])
    def test_is_that_of_the_blocks(self, spec, system):
        u = excited()
        found = settled(spec, relaxation=0.5).fit(Record(u, system(u), dt=0.1), RNG)
        new = excited(seed=2)
        np.testing.assert_allclose(found.response(new, 0.1), system(new), rtol=0, atol=1e-7)

    def test_holds_the_input_for_long_intervals(self):
        response = at_step(np.cumsum, 0.5)
        np.testing.assert_allclose(response(np.array([1.0, 2.0, 3.0]), 1.0), [1.0, 4.0, 9.0])

    def test_interpolates_the_output_for_short_intervals(self):
        response = at_step(np.cumsum, 1.0)
        np.testing.assert_allclose(response(np.array([1.0, 9.0, 2.0, 9.0]), 0.5), [1.0, 2.0, 3.0, 3.0])

    def test_refuses_other_intervals(self):
        with pytest.raises(
            ValueError, match=r"^the sampling interval 0\.3 and the model's step 1 do not divide each other$"
        ):
            at_step(np.cumsum, 1.0)(np.ones(3), 0.3)


class TestIteration:
    def test_plain_iteration_of_wiener_wanders_where_the_damped_one_converges(self):
        u = excited()
        y = wiener(u)
        plain = voros_wiener(u, y, STRUCTURE, Rule(1.0, max_iterations=500))
        assert not plain.converged
        assert np.ptp(plain.theta[-50:, 0]) > 0.1
        damped = voros_wiener(u, y, STRUCTURE, Rule(0.5, max_iterations=500))
        assert damped.converged
        assert damped.theta[-1, 0] == pytest.approx(LINEAR.a[0], abs=1e-4)

    def test_relaxation_does_not_move_the_solution(self):
        u = excited()
        y = hammerstein(u) + 0.05 * np.random.default_rng(3).normal(size=len(u))
        plain, damped = (voros_hammerstein(u, y, STRUCTURE, Rule(r, 1e-12, 2000)) for r in (1.0, 0.3))
        assert plain.converged and damped.converged
        np.testing.assert_allclose(damped.theta[-1], plain.theta[-1], rtol=1e-8)

    def test_an_oscillation_is_reported(self):
        def update(x):
            return -x, -x

        found = iterate(update, np.ones(1), np.ones(1), Rule(max_iterations=7))
        assert not found.converged
        np.testing.assert_array_equal(found.theta[:, 0], [1, -1, 1, -1, 1, -1, 1, -1])
        assert iterate(update, np.ones(1), np.ones(1), Rule(0.5, max_iterations=7)).converged

    def test_nan_is_divergence(self):
        with pytest.raises(EstimationError, match=r"^the internal variable diverged in iteration 1$"):
            iterate(lambda x: (x, x * np.nan), np.ones(1), np.ones(1), Rule())

    def test_unfinished_iteration_is_reported_or_failed(self):
        u = excited()
        record = Record(u, hammerstein(u))
        short = HAMMERSTEIN.model_copy(update={"max_iterations": 2})
        found = short.model_copy(update={"unconverged": "keep"}).fit(record, RNG)
        assert (found.values["iterations"], found.values["converged"]) == (2.0, 0.0)
        assert not found.details["history"].converged
        with pytest.raises(EstimationError, match=r"^the iteration has not converged in 2 iterations: allow"):
            short.fit(record, RNG)


@given(gain=st.floats(1e-3, 1e3), seed=st.integers(0, 100))
@settings(deadline=None, derandomize=True, max_examples=15)
def test_gain_of_the_output_goes_into_the_nonlinearity_of_hammerstein(gain, seed):
    u = excited(200, seed)
    y = hammerstein(u) + 0.01 * np.random.default_rng(seed).normal(size=200)
    one, other = (voros_hammerstein(u, k * y, STRUCTURE, Rule(max_iterations=5)) for k in (1.0, gain))
    scale = np.array([1.0] * 4 + [gain] * 6)
    np.testing.assert_allclose(other.theta, scale * one.theta, rtol=1e-6, atol=1e-9 * gain)


@given(gain=st.floats(1e-2, 1e2), seed=st.integers(0, 100))
@settings(deadline=None, derandomize=True, max_examples=15)
def test_gain_of_the_input_goes_into_the_numerator_of_wiener(gain, seed):
    u = excited(200, seed)
    y = wiener(u)
    one, other = (voros_wiener(k * u, y, STRUCTURE, Rule(0.5, max_iterations=5)) for k in (1.0, gain))
    scale = np.array([1.0] * 2 + [1.0 / gain] * 2 + [1.0] * 6)
    np.testing.assert_allclose(other.theta, scale * one.theta, rtol=1e-6, atol=1e-9)


def test_the_two_segments_meet_at_zero():
    np.testing.assert_allclose(TWO_SEGMENTS(np.array([-1.0, 0.0, 1.0])), [0.0, 0.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(TWO_SEGMENTS(np.array([-2.0, 2.0])), [2.0, 2.8])


class TestErrors:
    def test_an_input_of_one_sign(self):
        u = np.abs(excited())
        with pytest.raises(
            EstimationError,
            match=r"^the 8 regressors are linearly dependent over 398 samples: the input needs several "
            r"levels of either sign, or the record is too short, or a degree or an order too high$",
        ):
            HAMMERSTEIN.fit(Record(u, hammerstein(u)), RNG)

    def test_a_decimated_record_that_is_too_short(self):
        u = excited(60)
        with pytest.raises(
            EstimationError, match=r"^6 samples at the method's step are too few: it needs 12$"
        ):
            HAMMERSTEIN.model_copy(update={"step": 10.0}).fit(Record(u, u), RNG)

    def test_an_output_that_is_not_finite(self):
        u = excited()
        with pytest.raises(EstimationError, match="1 of 400 samples that are not finite"):
            WIENER.fit(Record(u, np.where(np.arange(400) == 3, np.nan, u)), RNG)

    def test_a_step_that_is_no_multiple(self):
        with pytest.raises(
            ValueError,
            match=r"^'step' must be a multiple of the sampling interval 0\.2, not 0\.5: 0\.4 is the nearest$",
        ):
            VorosWiener(n=2, m=2, degree=3, step=0.5).check(1000, 0.2)

    def test_a_step_beyond_all_numbers_of_samples(self):
        with pytest.raises(
            ValueError, match=r"^'step' must be a multiple of the sampling interval 0\.2, not 1e\+308$"
        ):
            VorosWiener(n=2, m=2, degree=3, step=1e308).check(1000, 0.2)

    def test_a_step_that_leaves_too_little(self):
        spec = VorosWiener(n=2, m=2, degree=3, step=1)
        spec.check(111, 0.1)
        with pytest.raises(
            ValueError,
            match=r"^a 'step' of 1 leaves 11 of the 110 samples, and the method needs at least 12: "
            r"use a shorter step or a longer record$",
        ):
            spec.check(110, 0.1)

    @pytest.mark.parametrize("key", [0, 3])
    def test_a_key_term_on_no_lag(self, key):
        with pytest.raises(
            ConfigError,
            match=rf"'key' must be a lag of the numerator, 1 to 2, not {key}: set 'delay' and 'm' so that "
            r"they hold it",
        ):
            VorosHammerstein(n=2, m=2, degree=3, key=key)

    def test_without_a_step_any_interval_does(self):
        HAMMERSTEIN.check(12, 0.37)
        HAMMERSTEIN.check(12, None)

    @pytest.mark.parametrize(
        ("field", "wrong", "message"),
        [
            ("n", 0, "greater than or equal to 1"),
            ("delay", -1, "greater than or equal to 0"),
            ("relaxation", 0, "greater than 0"),
            ("relaxation", 1.1, "less than or equal to 1"),
            ("tolerance", 0, "greater than 0"),
            ("unconverged", True, "must be 'fail' or 'keep'"),
        ],
    )
    def test_fields(self, field, wrong, message):
        with pytest.raises(ValidationError, match=message):
            VorosWiener.model_validate({"n": 2, "m": 2, "degree": 3, field: wrong})


@pytest.mark.parametrize("n", [1, 2, 10])
def test_a_record_too_short_for_voros_is_left_to_the_general_message(n):
    VorosHammerstein(n=1, m=2, degree=3).check(n, None)
