"""The first stage: settled levels, rise time, polynomial, and the estimator made of them."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from hident.errors import EstimationError
from hident.estimators.frequency.nonlinearity_identification import NonlinearityIdentification
from hident.estimators.frequency.staircase_levels import (
    Levels,
    fit_polynomial,
    level_bounds,
    rise_time,
    settled_levels,
)
from hident.records import Held, Part, Record
from tests.unit.steady_sines import CUBIC, record

QUICK = settings(deadline=None, derandomize=True, max_examples=30)
LEVELS = (-1.5, -0.5, 0.5, 1.5)
RNG = np.random.default_rng(0)


def levels_of(values, errors=0.0):
    values = np.asarray(values, dtype=float)
    errors = np.broadcast_to(np.asarray(errors, dtype=float), values.shape)
    return Levels(values, errors, 0.1, np.zeros_like(values), np.ones_like(values))


def settling(targets, hold, tau):
    """A first-order response from rest to the targets, each held for ``hold`` samples."""
    steps = np.diff(np.concatenate(([0.0], targets)))
    y = np.zeros(hold * len(targets))
    for j, step in enumerate(steps):
        y[j * hold :] += step * (1.0 - np.exp(-np.arange(len(y) - j * hold) / tau))
    return y


def estimator(**fields):
    return NonlinearityIdentification.model_validate(fields)


def staircase(y, levels, times=None, dt=1.0):
    times = np.arange(len(levels)) * float(len(y) // len(levels)) * dt if times is None else times
    part = Part(0, len(y), dt, Held(times, np.array(levels, dtype=float)))
    return Record(np.zeros_like(y), y, dt, parts={"staircase": part})


def test_bounds_need_not_be_multiples_of_the_sampling_interval():
    np.testing.assert_array_equal(level_bounds(np.array([0.0, 1.25, 2.5]), 40, 0.1), [0, 13, 25, 40])


def test_bounds_at_multiples_are_exact():
    times = np.arange(200.0) * 2.1
    np.testing.assert_array_equal(level_bounds(times, 4300, 0.1)[:-1], 21 * np.arange(200))


def test_the_mean_of_the_second_half():
    y = np.concatenate((np.full(10, 9.0), np.full(10, 1.0), np.full(10, -9.0), np.full(10, 2.0)))
    found = settled_levels(y, np.array([0, 20, 40]))
    np.testing.assert_array_equal(found.values, [1.0, 2.0])
    np.testing.assert_array_equal(found.errors, [0.0, 0.0])
    np.testing.assert_array_equal(settled_levels(y, np.array([0, 20, 40]), 0.0).values, [5.0, -3.5])


def test_standard_errors_are_those_of_many_trials():
    rng = np.random.default_rng(1)
    trials = [settled_levels(rng.normal(0, 0.4, 300), np.array([0, 200, 300])) for _ in range(1500)]
    np.testing.assert_allclose(np.std([t.values for t in trials], axis=0), trials[0].errors, rtol=0.12)
    np.testing.assert_allclose(np.std([t.drift for t in trials], axis=0), trials[0].drift_error, rtol=0.12)
    assert np.mean([t.noise for t in trials]) == pytest.approx(0.4, rel=0.01)


def test_the_printed_average_is_biased_like_one_over_n_and_ours_is_not():
    holds = np.array([400, 800, 1600, 3200])
    printed, ours = [], []
    for hold in holds:
        y = settling(np.array([1.0, 3.0]), hold, 20.0)
        bounds = np.array([0, hold, 2 * hold])
        printed.append(abs(settled_levels(y, bounds, 0.0).values[1] - 3.0))
        ours.append(abs(settled_levels(y, bounds).values[1] - 3.0))
    assert np.polyfit(np.log(holds), np.log(printed), 1)[0] == pytest.approx(-1.0, abs=0.01)
    np.testing.assert_array_less(ours, 1e-2 * np.array(printed))


def test_a_drift_is_told_from_noise():
    y = settling(np.array([1.0, 3.0]), 100, 40.0)
    assert list(settled_levels(y, np.array([0, 100, 200])).unsettled(5.0, 1e-3)) == [0, 1]
    noisy = y + np.random.default_rng(2).normal(size=200)
    assert len(settled_levels(noisy, np.array([0, 100, 200])).unsettled(5.0, 1e-3)) == 0
    slow = settling(np.array([1.0, 3.0]), 1000, 40.0)
    assert len(settled_levels(slow, np.array([0, 1000, 2000])).unsettled(5.0, 1e-3)) == 0


@pytest.mark.parametrize("fraction", [0.5, 0.9])
@pytest.mark.parametrize("n", [60, 5000])
def test_rise_time_of_a_first_order_block(n, fraction):
    tau = n / 10
    y = 2.0 - 5.0 * (1.0 - np.exp(-np.arange(n) / tau))
    expected = -np.log(1.0 - fraction) * tau * 0.1
    assert rise_time(y, 0.1, 2.0, -3.0, fraction) == pytest.approx(expected, rel=0.01)


def test_rise_time_in_noise():
    y = 1.0 - np.exp(-np.arange(20_000) / 2000) + np.random.default_rng(3).normal(0, 0.1, 20_000)
    assert rise_time(y, 1.0, 0.0, 1.0) == pytest.approx(2000 * np.log(10), rel=0.06)


def test_rise_time_errors():
    message = "a step between equal outputs has no rise time: the static gain is zero"
    with pytest.raises(EstimationError, match=f"^{message}$"):
        rise_time(np.ones(100), 1.0, 1.0, 1.0)
    with pytest.raises(EstimationError, match=r"^the step response does not reach 90% of its final value$"):
        rise_time(np.linspace(0, 0.5, 100), 1.0, 0.0, 1.0)


@QUICK
@given(st.integers(1, 7), st.integers(0, 5), st.floats(0.01, 100.0))
def test_the_polynomial_is_exact(degree, extra, reach):
    x = reach * np.cos(np.pi * (np.arange(degree + 1 + extra) + 0.5) / (degree + 1 + extra))
    c = np.random.default_rng(degree).normal(size=degree + 1) / reach ** np.arange(degree + 1)
    fit = fit_polynomial(x, np.polyval(c[::-1], x), np.zeros_like(x), degree)
    scale = reach ** np.arange(degree + 1)
    np.testing.assert_allclose(scale * fit.coefficients, scale * c, rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize("errors", [0.1, np.array([0.1, 0.5, 0.1, 0.2])])
def test_the_errors_of_the_coefficients(errors):
    x = np.array(LEVELS)
    fit = fit_polynomial(x, np.zeros(4), np.broadcast_to(errors, 4), 3)
    inverse = np.linalg.inv(np.vander(x, 4, increasing=True))
    variances = np.broadcast_to(errors, 4) ** 2
    np.testing.assert_allclose(
        fit.covariance, inverse @ np.diag(variances) @ inverse.T, rtol=1e-10, atol=1e-15
    )
    np.testing.assert_allclose(fit.errors, np.sqrt(inverse**2 @ variances), rtol=1e-10)


def test_too_few_levels_for_the_coefficients():
    message = "3 distinct levels do not determine the 4 coefficients of degree 3"
    with pytest.raises(EstimationError, match=f"^{message}$"):
        fit_polynomial(np.array([0.0, 1.0, 1.0, 2.0]), np.zeros(4), np.zeros(4), 3)
    with pytest.raises(EstimationError, match=f"^{message}$"):
        estimator().check_record(record({}, (0.0, 1.0, 1.0, 2.0)))


def test_only_the_levels_in_between_count_for_the_polynomial():
    levels = np.array([-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5])
    steps = staircase(np.repeat(levels**4, 40), levels)
    within = estimator(between=[0, 1.5], require_steady=False).fit(steps, RNG)
    everywhere = estimator(require_steady=False).fit(steps, RNG)
    # The cubic that meets x^4 at 0, 1/2, 1 and 3/2, and the even one that is nearest to it at all seven.
    assert [within.values[f"c_{j}"] for j in range(4)] == pytest.approx([0.0, 0.75, -2.75, 3.0], abs=1e-9)
    assert everywhere.values["c_3"] == pytest.approx(0.0, abs=1e-9)
    message = "2 distinct levels do not determine the 4 coefficients of degree 3"
    with pytest.raises(EstimationError, match=f"^{message}$"):
        estimator(between=[1, 1.5]).check_record(steps)


def test_too_few_samples_in_a_level():
    message = "level 2 of 3 has 5 samples: at least 8 are needed"
    with pytest.raises(EstimationError, match=f"^{message}$"):
        settled_levels(np.zeros(45), np.array([0, 20, 25, 45]))
    message = "level 3 of 3 has 0 samples: at least 8 are needed"
    with pytest.raises(EstimationError, match=f"^{message}$"):
        settled_levels(np.zeros(40), np.array([0, 20, 45, 40]))


def test_the_estimator_recovers_the_polynomial():
    found = estimator().fit(record({}, LEVELS), RNG)
    np.testing.assert_allclose([found.values[f"c_{j}"] for j in range(4)], CUBIC, rtol=1e-6)
    assert found.nonlinearity is not None
    assert found.nonlinearity(np.array([1.0])) == pytest.approx(CUBIC.sum(), rel=1e-6)
    assert found.values["rise_time"] == pytest.approx(12.0 * np.log(10), rel=0.05)
    assert found.values["hold"] == pytest.approx(400 / found.values["rise_time"])
    assert {f"value {name}" for name in found.values} | {"nonlinearity"} == estimator().provides()


def test_the_estimates_scatter_as_their_standard_errors_say():
    rng = np.random.default_rng(4)
    clean = record({}, LEVELS)
    z = []
    for _ in range(200):
        noisy = Record(clean.u, clean.y + 0.5 * rng.normal(size=len(clean.y)), 1.0, parts=clean.parts)
        values = estimator().fit(noisy, rng).values
        z.append([(values[f"c_{j}"] - CUBIC[j]) / values[f"se_c_{j}"] for j in range(4)])
    np.testing.assert_allclose(np.std(z, axis=0), 1.0, atol=0.15)


def test_an_output_that_has_not_settled():
    y = settling(np.array([1.0, 3.0, 4.0, 9.0]), 100, 40.0)
    message = (
        "the output has not settled at level 4 of 4: it moves by 0.511 from the third to the last quarter; "
        "hold the levels longer"
    )
    with pytest.raises(EstimationError, match=f"^{re.escape(message)}$"):
        estimator().fit(staircase(y, LEVELS), RNG)
    found = estimator(require_steady=False).fit(staircase(y, LEVELS), RNG)
    assert found.values["drift"] > 5.0


def test_levels_too_short_to_tell_a_drift_from_noise():
    clean = settling(np.array([1.0, 3.0, 4.0, 9.0]), 10, 8.0)
    y = clean + np.random.default_rng(6).normal(scale=0.8, size=len(clean))
    message = (
        r"^the shortest level is held 10, [12]\.\d rise times of \d\.\d+: too short to settle; hold each at"
    )
    with pytest.raises(EstimationError, match=message):
        estimator(degree=1).fit(staircase(y, LEVELS), RNG)
    assert estimator(degree=1, least_hold=0).fit(staircase(y, LEVELS), RNG).values["hold"] < 3.0


def test_no_static_gain():
    y = np.random.default_rng(5).normal(size=400)
    message = "the output settles at the same value at all levels: the static gain of a block is zero"
    with pytest.raises(EstimationError, match=f"^{message}$"):
        estimator().fit(staircase(y, LEVELS), RNG)


def test_the_experiment_is_the_one_with_a_held_input():
    message = (
        "the record has 0 experiments with a held input, and one is needed: a staircase applied to a "
        "continuous system; name it with 'experiment' if there are several"
    )
    with pytest.raises(EstimationError, match=f"^{re.escape(message)}$"):
        estimator().fit(record({0.01: 1.0}), RNG)
    assert estimator().fit(record({0.01: 1.0}, LEVELS), RNG).values["c_0"] == pytest.approx(50.0)


def test_the_experiment_by_name():
    named = estimator(experiment="staircase").fit(record({}, LEVELS), RNG)
    assert named.values == estimator().fit(record({}, LEVELS), RNG).values
    with pytest.raises(EstimationError, match=r"^the record has no experiment 'steps' with a held input$"):
        estimator(experiment="steps").fit(record({}, LEVELS), RNG)


def test_an_output_that_is_not_finite():
    y = settling(np.array([1.0, 3.0, 4.0, 9.0]), 400, 10.0)
    y[3] = np.nan
    with pytest.raises(EstimationError, match=r"^the output has 1 of 1600 samples that are not finite$"):
        estimator().fit(staircase(y, LEVELS), RNG)


@pytest.mark.parametrize(("field", "value"), [("degree", 0), ("discard", 1), ("threshold", 0)])
def test_fields_out_of_range(field, value):
    with pytest.raises(ValidationError, match=field):
        estimator(**{field: value})
