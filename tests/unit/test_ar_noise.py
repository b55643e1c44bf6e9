"""Autoregressive models of residuals, their order, and whitening."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hident.errors import EstimationError
from hident.estimators.bilinear_models.ar_noise import METHODS, EstimatedAr, chi_squared, f_test, fpe
from hident.linear_blocks import TransferFunction
from hident.numerics.autoregression import ArModel

QUICK = settings(deadline=None, derandomize=True, max_examples=40)


def covariance_matrix(a, n, length=4000):
    gamma = TransferFunction(a=tuple(a)).impulse_response(length)
    covariance = np.array([gamma[: length - k] @ gamma[k:] for k in range(n)])
    return covariance[np.abs(np.subtract.outer(np.arange(n), np.arange(n)))]


def stable(reflections):
    """Coefficients of a stationary model, by Levinson's recursion."""
    a = np.empty(0)
    for k in reflections:
        a = np.append(a - k * a[::-1], k)
    return a


@QUICK
@given(st.lists(st.floats(-0.9, 0.9), max_size=4))
def test_whitening_is_a_root_of_the_inverse_covariance(reflections):
    a = stable(reflections)
    F = ArModel(a).whiten(np.eye(9)).T
    np.testing.assert_allclose(F @ covariance_matrix(a, 9) @ F.T, np.eye(9), atol=1e-6)


def test_whitening_keeps_its_input_and_works_on_vectors():
    signals = np.random.default_rng(1).normal(size=(3, 20))
    signals.flags.writeable = False
    model = ArModel(np.array([0.5, -0.2]))
    np.testing.assert_array_equal(model.whiten(signals[1]), model.whiten(signals)[1])
    np.testing.assert_array_equal(ArModel(np.empty(0)).whiten(signals), signals)
    expected = signals[:, 2] - 0.5 * signals[:, 1] + 0.2 * signals[:, 0]
    np.testing.assert_allclose(model.whiten(signals)[:, 2], expected)


@pytest.mark.parametrize("a", [[1.0], [1.25], [0.5, 0.6], [0.0, -1.1]])
def test_unstable_models_do_not_whiten(a):
    shown = ", ".join(f"{value:.4g}" for value in a)
    message = (
        f"the noise model is not stationary: its coefficients {shown} "
        "have a pole on or outside the unit circle"
    )
    with pytest.raises(EstimationError, match=f"^{re.escape(message)}$"):
        ArModel(np.array(a)).whiten(np.ones(10))


@pytest.mark.parametrize("method", METHODS)
def test_models_approach_the_truth(method):
    truth = stable([0.7, -0.4])
    e = np.random.default_rng(2).normal(size=200_500)
    v = TransferFunction(a=tuple(truth)).filter(3.0 * e)[500:]
    models = METHODS[method](v, 4)
    assert [len(model.a) for model in models] == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(models[2].a, truth, atol=0.01)
    np.testing.assert_allclose(models[4].a, [*truth, 0.0, 0.0], atol=0.01)
    assert models[2].variance == pytest.approx(9.0, rel=0.01)
    assert models[0].variance == pytest.approx(np.mean(v**2), rel=1e-3)
    assert np.all(np.diff([model.variance for model in models]) < 1e-3)


def test_yule_walker_solves_its_equations():
    v = np.random.default_rng(3).normal(size=50)
    covariance = np.array([v[: 50 - k] @ v[k:] for k in range(4)]) / 50
    for p, model in enumerate(METHODS["yule_walker"](v, 3)):
        toeplitz = covariance[np.abs(np.subtract.outer(np.arange(p), np.arange(p)))]
        np.testing.assert_allclose(toeplitz @ model.a, covariance[1 : p + 1], atol=1e-12)
        assert model.variance == pytest.approx(covariance[0] - model.a @ covariance[1 : p + 1])


def test_burg_minimises_forward_and_backward_errors():
    v = np.random.default_rng(4).normal(size=30)
    (_, model) = METHODS["burg"](v, 1)
    grid = np.linspace(-1, 1, 20001)
    errors = [np.sum((v[1:] - k * v[:-1]) ** 2) + np.sum((v[:-1] - k * v[1:]) ** 2) for k in grid]
    assert model.a[0] == pytest.approx(grid[np.argmin(errors)], abs=1e-4)


@QUICK
@given(st.integers(0, 10**6), st.sampled_from(["burg", "yule_walker"]))
def test_burg_and_yule_walker_are_stationary(seed, method):
    v = np.cumsum(np.random.default_rng(seed).normal(size=12))
    for model in METHODS[method](v, 5):
        assert TransferFunction(a=tuple(model.a)).is_stable()


@pytest.mark.parametrize("method", METHODS)
def test_unit_of_the_residuals_does_not_matter(method):
    v = np.random.default_rng(5).normal(size=80)
    for plain, scaled in zip(METHODS[method](v, 3), METHODS[method](1e-6 * v, 3), strict=True):
        np.testing.assert_allclose(scaled.a, plain.a, rtol=1e-10)
        assert scaled.variance == pytest.approx(1e-12 * plain.variance)


@pytest.mark.parametrize("method", METHODS)
def test_residuals_of_zero(method):
    for model in METHODS[method](np.zeros(20), 3):
        np.testing.assert_array_equal(model.a, 0.0)
        assert model.variance == 0.0
    spec = EstimatedAr(kind="estimated_ar", method=method)
    assert len(spec.model(np.zeros(20)).a) == 0


def test_f_test():
    # F(1, 10) is below 4.965 and F(1, 9) below 5.117, each with a probability of 95 %.
    assert f_test(np.array([1.0 + 4.96 / 10, 1.0]), 11) == 0
    assert f_test(np.array([1.0 + 4.97 / 10, 1.0]), 11) == 1
    first = 1.0 + 5.11 / 9
    assert f_test(np.array([2.0 * first, first, 1.0]), 11) == 1
    assert f_test(np.array([2.0 * first, 1.01 * first, 1.0]), 11) == 2


def test_chi_squared():
    # The step from 1 to 2 gains N (V1 - V2)/V2 = 100 * 0.04 = 4, above 3.84; that from 2 to 3 gains 3.
    variances = np.array([4.0, 1.04, 1.0, 1.0 / 1.03, 0.5])
    assert chi_squared(variances, 100) == 2
    assert chi_squared(variances, 100, confidence=0.99) == 1
    assert chi_squared(variances, 100, confidence=0.9) == 4
    assert chi_squared(variances, 1) == 0
    assert chi_squared(np.array([2.0, 1.0]), 100) == 1


def test_fpe():
    # With N = 10: 1.0, 0.9 * 11/9 = 1.1, 0.6 * 12/8 = 0.9
    assert fpe(np.array([1.0, 0.9, 0.6]), 10) == 2
    assert fpe(np.array([1.0, 0.9, 0.7]), 10) == 0


@pytest.mark.parametrize("method", METHODS)
def test_order_of_white_noise_is_overestimated_as_often_as_the_level_says(method):
    v = np.random.default_rng(6).normal(size=(1500, 400))
    for confidence, rate in ((0.95, 0.05), (0.8, 0.2)):
        spec = EstimatedAr(kind="estimated_ar", method=method, confidence=confidence, max_order=1)
        chosen = [len(spec.model(row).a) for row in v]
        assert np.mean(chosen) == pytest.approx(rate, abs=0.025)


@pytest.mark.parametrize("criterion", ["f_test", "chi_squared", "fpe"])
def test_order_of_coloured_noise(criterion):
    truth = stable([0.7, -0.4])
    spec = EstimatedAr(kind="estimated_ar", criterion=criterion)
    e = np.random.default_rng(7).normal(size=(100, 1000))
    orders = [len(spec.model(TransferFunction(a=tuple(truth)).filter(row)[200:]).a) for row in e]
    assert min(orders) == 2
    assert np.mean(np.equal(orders, 2)) > (0.6 if criterion == "fpe" else 0.85)
