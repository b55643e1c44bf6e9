"""The best linear approximation and its two variances."""

import re

import numpy as np
import pytest

from hident.errors import EstimationError
from hident.estimators.frequency.best_linear_approximation import BestLinear, best_linear_approximation
from hident.records import Part, Periodic, Record

N = 64
ODD = np.arange(1, 16, 2)


def multisines(realisations, periods, rng, harmonics=ODD):
    spectrum = np.zeros((realisations, N // 2 + 1), dtype=complex)
    spectrum[:, harmonics] = N * np.exp(2j * np.pi * rng.random((realisations, len(harmonics))))
    return np.repeat(np.fft.irfft(spectrum, N)[:, None], periods, axis=1)


def filtered(u, gain):
    return np.fft.irfft(np.fft.rfft(u) * gain, N)


def low_pass(k=None):
    k = np.arange(N // 2 + 1) if k is None else k
    return 1.0 / (1.0 + 0.2j * k)


def test_a_linear_system_is_exact():
    u = multisines(3, 2, np.random.default_rng(0))
    found = best_linear_approximation(u, filtered(u, low_pass()), ODD)
    np.testing.assert_allclose(found.gain, low_pass(ODD), atol=1e-13)
    for variance in (found.noise_variance, found.total_variance, found.distortion_variance):
        np.testing.assert_allclose(variance, 0.0, atol=1e-26)


def test_even_terms_leave_odd_multisines_alone_and_cubic_ones_do_not():
    u = multisines(200, 2, np.random.default_rng(1))
    square = best_linear_approximation(u, u + 0.1 * u**2, ODD)
    np.testing.assert_allclose(square.gain, 1.0, atol=1e-13)
    cubic = best_linear_approximation(u, u + 0.01 * u**3, ODD)
    # Of a multisine with H harmonics of mean square 2 |U|^2, E[u^3 U*] is near 3 E[u^2] |U|^2.
    power = np.mean(u**2)
    np.testing.assert_allclose(cubic.gain, 1.0 + 0.03 * power, rtol=0.04)
    assert np.all(cubic.distortion_variance > 1e3 * cubic.noise_variance)


def test_the_variances_are_those_of_many_trials():
    rng = np.random.default_rng(2)
    found = []
    for _ in range(300):
        u = multisines(4, 3, rng)
        y = u + 0.05 * u**3
        found.append(best_linear_approximation(u, y + 0.5 * rng.normal(size=y.shape), ODD))
    scatter = np.var([one.gain for one in found], axis=0)
    total = np.mean([one.total_variance for one in found], axis=0)
    noise = np.mean([one.noise_variance for one in found], axis=0)
    np.testing.assert_allclose(total, scatter, rtol=0.25)
    # Var of the noise's spectrum over |U|^2 = 1, averaged over 12 periods.
    np.testing.assert_allclose(noise, 0.25 / N / 12, rtol=0.12)


def test_the_noise_variance_falls_with_the_periods_and_the_distortion_does_not():
    rng = np.random.default_rng(3)
    noise, distortion = [], []
    for periods in (2, 8, 32):
        u = multisines(100, periods, rng)
        y = u + 0.05 * u**3 + 0.2 * rng.normal(size=u.shape)
        found = best_linear_approximation(u, y, ODD)
        noise.append(np.mean(found.noise_variance))
        distortion.append(np.mean(found.distortion_variance))
    assert np.polyfit(np.log([2, 8, 32]), np.log(noise), 1)[0] == pytest.approx(-1.0, abs=0.1)
    np.testing.assert_allclose(distortion, distortion[0], rtol=0.3)


def test_chosen_harmonics_and_silent_ones():
    u = multisines(2, 2, np.random.default_rng(4))
    found = best_linear_approximation(u, u, np.array([3, 7]))
    np.testing.assert_allclose(found.gain, 1.0)
    for silent in (4, 99):
        message = f"the harmonic {silent} is not excited in every realisation"
        with pytest.raises(EstimationError, match=f"^{message}$"):
            best_linear_approximation(u, u, np.array([3, silent]))


@pytest.mark.parametrize(("realisations", "periods"), [(1, 4), (4, 1)])
def test_both_variances_need_two_of_each(realisations, periods):
    u = multisines(realisations, periods, np.random.default_rng(5))
    message = (
        f"the two variances need at least two realisations and two periods, not {realisations} and {periods}"
    )
    with pytest.raises(EstimationError, match=f"^{message}$"):
        best_linear_approximation(u, u, ODD)


def recorded(periods, samples=N):
    rng = np.random.default_rng(6)
    parts, inputs, start = {}, [], 0
    for i, count in enumerate(periods):
        u = multisines(1, count, rng).ravel()
        wave = Periodic(float(samples), 0.0, ODD, np.ones(len(ODD), dtype=complex))
        parts[f"realisation {i + 1}"] = Part(start, start + len(u), 1.0, wave)
        inputs.append(u)
        start += len(u)
    u = np.concatenate(inputs)
    return Record(u, np.fft.irfft(np.fft.rfft(u.reshape(-1, N)) * low_pass(), N).ravel(), 1.0, parts=parts)


def test_the_estimator_reads_the_experiments():
    spec = BestLinear(harmonics=(1, 5), transient=1)
    found = spec.fit(recorded([4, 4, 4]), np.random.default_rng(0))
    assert found.values["gain_5"] == pytest.approx(abs(low_pass(5)))
    assert found.values["phase_5"] == pytest.approx(np.angle(low_pass(5)))
    assert found.values["total_1"] == pytest.approx(0.0, abs=1e-12)
    assert {f"value {name}" for name in found.values} == spec.provides()
    assert not spec.draws()


def test_experiments_that_do_not_suit():
    spec = BestLinear(harmonics=(1,))
    message = "the experiments with multisines have 2 different shapes (periods, samples): " + (
        "give all realisations the same"
    )
    with pytest.raises(EstimationError, match=f"^{re.escape(message)}$"):
        spec.check_record(recorded([4, 3]))
    message = "the experiment 'realisation 1' is not made of whole periods of whole samples"
    with pytest.raises(EstimationError, match=f"^{message}$"):
        spec.fit(recorded([4, 4], samples=60), np.random.default_rng(0))
