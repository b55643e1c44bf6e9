"""Fourier coefficients of a periodic output, by averaging and by least squares, and the order."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hident.errors import EstimationError
from hident.estimators.frequency.harmonics import (
    Harmonics,
    harmonics,
    order_by_power,
    order_by_signal_to_noise,
    require_samples,
    samples_per_period,
)

QUICK = settings(deadline=None, derandomize=True, max_examples=30)
S = np.array([3.0, 0.5, 0.02])
PHI = np.array([-1.0, 2.5, 3.0])


def signal(t, omega, mean=50.0, s=S, phi=PHI):
    k = np.arange(1, len(s) + 1)
    return mean + np.sin(omega * np.outer(t, k) + phi) @ s


def of(mean, amplitudes, power, error=0.01):
    values = np.array(amplitudes, dtype=complex)
    return Harmonics(1.0, mean, values, error, error, power, 0.1)


@pytest.mark.parametrize(("n", "periods"), [(7, 1), (7, 2), (64, 1), (101, 13), (6283, 3)])
def test_whole_periods_are_exact(n, periods):
    omega = 0.01
    dt = 2 * np.pi / omega / n
    found = harmonics(signal(np.arange(n * periods) * dt, omega), dt, omega, 3)
    assert abs(found.mean - 50.0) < 1e-12
    np.testing.assert_allclose(found.values, S * np.exp(1j * PHI), rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.amplitudes, S, atol=1e-12)
    np.testing.assert_allclose(np.angle(found.values), PHI, atol=1e-10)


@QUICK
@given(st.floats(7.001, 300.0), st.integers(2, 30), st.integers(1, 3))
def test_any_period_is_exact_by_least_squares(period, periods, order):
    omega, dt = 0.3, 2 * np.pi / 0.3 / period
    y = signal(np.arange(int(np.ceil(periods * period)) + 2) * dt, omega, s=S[:order], phi=PHI[:order])
    found = harmonics(y, dt, omega, order)
    assert abs(found.mean - 50.0) < 1e-9
    np.testing.assert_allclose(found.values, (S * np.exp(1j * PHI))[:order], rtol=0, atol=1e-9)


def test_the_phase_of_the_paper_comes_out_where_its_arctangent_would_lose_pi():
    found = harmonics(signal(np.arange(64) * 2 * np.pi / 64, 1.0), 2 * np.pi / 64, 1.0, 3)
    a_k, b_k = found.values.imag, found.values.real
    assert np.any(np.abs(np.arctan(a_k / b_k) - PHI) > 3.0)
    np.testing.assert_allclose(np.arctan2(a_k, b_k), PHI, atol=1e-12)


@pytest.mark.parametrize("n", [64, 64.3])
def test_both_ways_agree_with_regression(n):
    rng = np.random.default_rng(0)
    omega, dt = 1.0, 2 * np.pi / n
    y = signal(np.arange(643) * dt, omega) + rng.normal(size=643)
    found = harmonics(y, dt, omega, 3)
    used = y[: int(643 // n * n) if n == 64 else 643]
    t = np.arange(len(used)) * dt
    columns = [np.ones(len(t))] + [f(k * t) for k in (1, 2, 3) for f in (np.sin, np.cos)]
    expected, *_ = np.linalg.lstsq(np.array(columns).T, used, rcond=None)
    np.testing.assert_allclose(found.mean, expected[0], rtol=1e-12)
    np.testing.assert_allclose(found.values, expected[1::2] + 1j * expected[2::2], atol=1e-11)


@pytest.mark.parametrize("n", [20, 20.37])
def test_standard_errors_are_those_of_many_trials(n):
    rng = np.random.default_rng(1)
    dt = 2 * np.pi / n
    clean = signal(np.arange(409) * dt, 1.0)
    trials = [harmonics(clean + 0.3 * rng.normal(size=409), dt, 1.0, 3) for _ in range(600)]
    values = np.array([trial.values for trial in trials])
    assert np.mean([trial.noise for trial in trials]) == pytest.approx(0.3, rel=0.01)
    assert np.std([trial.mean for trial in trials]) == pytest.approx(trials[0].mean_error, rel=0.1)
    spread = np.concatenate((values.real.std(axis=0), values.imag.std(axis=0)))
    np.testing.assert_allclose(spread, trials[0].error, rtol=0.15)


def test_the_error_falls_like_the_root_of_the_periods():
    rng = np.random.default_rng(2)
    counts = np.array([4, 16, 64, 256])
    dt = 2 * np.pi / 16
    spread = [
        np.std([harmonics(rng.normal(size=16 * m), dt, 1.0, 1).values.real for _ in range(200)])
        for m in counts
    ]
    slope = np.polyfit(np.log(counts), np.log(spread), 1)[0]
    assert slope == pytest.approx(-0.5, abs=0.05)


@pytest.mark.parametrize("n", [32, 32.4])
def test_phases_refer_to_time_zero(n):
    omega, dt, start = 2.0, np.pi / n, 0.7
    y = signal(start + np.arange(400) * dt, omega)
    found = harmonics(y, dt, omega, 3, start)
    np.testing.assert_allclose(found.values, S * np.exp(1j * PHI), atol=1e-10)


def test_the_input_is_not_modified():
    y = signal(np.arange(100) * 0.1, 1.0)
    y.flags.writeable = False
    harmonics(y, 0.1, 1.0, 3)


def test_samples_per_period():
    assert samples_per_period(1.0, 2 * np.pi / 100) == 100
    assert samples_per_period(0.01, 0.1) is None


def test_too_few_samples_in_a_period():
    message = (
        "a period at 1 rad per unit of time has 6.283 samples: 4 harmonics need at least 9; "
        "sample faster or lower the order"
    )
    for call in (lambda: harmonics(np.zeros(100), 1.0, 1.0, 4), lambda: require_samples(1.0, 1.0, 4)):
        with pytest.raises(EstimationError, match=f"^{re.escape(message)}$"):
            call()


def test_no_whole_period():
    message = "the record of 60 samples holds no whole period at 1 rad per unit of time (63 samples)"
    with pytest.raises(EstimationError, match=f"^{re.escape(message)}$"):
        harmonics(np.zeros(60), 0.1, 1.0, 1)


def test_order_by_power_with_and_without_the_mean():
    found = of(10.0, [2.0, 1.0, 0.1], 100.0 + 0.5 * (4.0 + 1.0 + 0.01))
    assert order_by_power(found, 1.0) == 1
    assert order_by_power(found, 1.0, mean=False) == 2
    assert order_by_power(found, 0.01, mean=False) == 3


def test_no_order_suffices_in_strong_noise():
    assert order_by_power(of(0.0, [1.0, 0.1], 5.0), 1.0) is None


def test_order_by_signal_to_noise_is_the_highest_significant_harmonic():
    assert order_by_signal_to_noise(of(0.0, [1.0, 0.01, 0.05, 0.02], 1.0), 3.0) == 3
    assert order_by_signal_to_noise(of(0.0, [0.01], 1.0), 3.0) == 0
