"""Hammerstein systems with feedback in the linear block."""

import functools

import numpy as np
import pytest

from hident.errors import EstimationError
from hident.estimators.bilinear_models.bilinear import regressors
from hident.estimators.bilinear_models.separable import (
    SeparableLeastSquares,
    inner_solution,
    separable_least_squares,
    start,
)
from hident.linear_blocks import TransferFunction
from hident.records import Record

RNG = np.random.default_rng(0)
B, C = np.array([0.6, -0.8]), np.array([1.0, -0.5, 0.25])
ONE, TWO = (0.8,), (1.2, -0.52)


def simulated(seed, feedback, samples=300, noise=0.0, colour=0.0, past=50):
    """x and y on record, the system having started ``past`` samples earlier."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-2, 2, past + samples)
    w = sum(c * x**j for j, c in enumerate(C, start=1))
    y = TransferFunction(b=(0.0, *B), a=feedback).filter(w)
    v = TransferFunction(a=(colour,)).filter(rng.normal(size=past + samples))
    return x[past:], (y + noise * v)[past:]


def spec(feedback):
    return SeparableLeastSquares(lags=2, degree=3, feedback=len(feedback))


def parameters(found, feedback):
    names = [f"a_{i}" for i in range(1, len(feedback) + 1)] + ["b_1", "b_2", "c_1", "c_2", "c_3"]
    return np.array([found.values[name] for name in names])


@pytest.mark.parametrize("feedback", [ONE, TWO, (-0.95,)])
def test_recovery_without_noise(feedback):
    x, y = simulated(1, feedback)
    found = spec(feedback).fit(Record(x, y), RNG)
    np.testing.assert_allclose(parameters(found, feedback), [*feedback, *B, *C], rtol=0, atol=1e-8)
    assert found.linear is not None and found.nonlinearity is not None
    np.testing.assert_allclose(found.linear.a, feedback, atol=1e-8)
    np.testing.assert_allclose(found.linear.b, (0.0, *B), atol=1e-8)
    assert found.nonlinearity(np.array([2.0]))[0] == pytest.approx(2.0)


def test_derivative():
    x, y = simulated(2, TWO, noise=0.3)
    phi, y = regressors(np.array([x, x**2, x**3]), 2), y[2:]
    f = np.array([1.1, -0.4])
    at = inner_solution(f, phi, y, 2)
    # Variable projection: the derivative of r'r by f is -2 r' times that of the output.
    for k, e in enumerate(np.eye(2)):
        h = 1e-6
        above, below = (inner_solution(f + s * e, phi, y, 2).loss for s in (h, -h))
        slope = (above - below) / (2 * h)
        assert -2.0 * at.residuals @ at.jacobian[:, k] == pytest.approx(slope, rel=1e-5)


def test_solution_is_stationary():
    x, y = simulated(3, TWO, noise=0.3)
    phi, y = regressors(np.array([x, x**2, x**3]), 2), y[2:]
    found, iterations = separable_least_squares(phi, y, 2, 2)
    assert iterations > 1
    size = np.linalg.norm(found.jacobian, axis=0) * np.linalg.norm(y)
    np.testing.assert_allclose(found.jacobian.T @ found.residuals / size, 0.0, atol=1e-9)


@functools.cache
def trial(seed, samples, colour=0.0):
    """The errors of all parameters, and their standard errors, in one trial."""
    x, y = simulated(seed, ONE, samples, noise=0.3, colour=colour)
    found = spec(ONE).fit(Record(x, y), RNG)
    errors = [found.values[f"se_{name}"] for name in ("a_1", "b_1", "b_2", "c_1", "c_2", "c_3")]
    return parameters(found, ONE) - [*ONE, *B, *C], np.array(errors)


@pytest.mark.parametrize("colour", [0.0, 0.7])
def test_error_falls_like_n_to_the_minus_half(colour):
    # Over a factor of 32, so that 20 trials tell the exponent as well as 60 over a factor of 8.
    sizes, errors = np.array([150, 4800]), []
    for n in sizes.tolist():
        errors.append(np.sqrt(np.mean(np.square([trial(seed, n, colour)[0] for seed in range(20)]))))
    assert np.log(errors[1] / errors[0]) / np.log(32.0) == pytest.approx(-0.5, abs=0.15)


def test_first_estimate_is_nearly_unbiased():
    x, y = simulated(4, ONE, 20_000, noise=1.0)
    phi, y = regressors(np.array([x, x**2, x**3]), 2), y[2:]
    equation_error = np.linalg.lstsq(np.column_stack([y[:-1], phi[1:]]), y[1:], rcond=None)[0][0]
    assert abs(equation_error - 0.8) > 0.05
    assert start(phi, y, 1)[0] == pytest.approx(0.8, abs=0.01)


def test_intervals_cover():
    away, errors = np.array([trial(seed, 150) for seed in range(60)]).transpose(1, 0, 2)
    assert np.mean(np.abs(away) < 1.977 * errors) == pytest.approx(0.95, abs=0.03)
    # It is 0.8 where standard errors are 25 % too large, and 1.25 where they are 20 % too small.
    assert np.sqrt(np.mean(np.square(away / errors))) == pytest.approx(1.0, abs=0.12)


def test_estimate_holds_what_it_says():
    x, y = simulated(5, TWO, noise=0.3)
    x.flags.writeable = y.flags.writeable = False
    found = spec(TWO).fit(Record(x, y), RNG)
    assert spec(TWO).provides() == {"linear", "nonlinearity", "response"} | {
        f"value {name}" for name in found.values
    }


def test_shortest_record():
    estimator = spec(ONE)
    x, y = simulated(6, ONE, estimator.fewest_samples(), noise=0.01)
    found = estimator.fit(Record(x, y), RNG)
    assert np.isfinite(list(found.values.values())).all()


def test_failures():
    x, _ = simulated(7, ONE)
    with pytest.raises(EstimationError, match=r"^the regressors .* the input takes 1 different value"):
        spec(ONE).fit(Record(np.ones(100), x[:100]), RNG)
    message = r"^the output is 0 throughout: nothing can be learnt from a constant output$"
    with pytest.raises(EstimationError, match=message):
        spec(ONE).fit(Record(x, np.zeros(300)), RNG)
    message = (
        r"^past outputs and inputs are linearly dependent: the input varies too little, "
        r"or the feedback order 1 is too high$"
    )
    with pytest.raises(EstimationError, match=message):
        start(np.ones((300, 2)), np.ones(300), 1)
