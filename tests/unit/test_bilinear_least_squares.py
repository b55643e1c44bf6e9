"""The weighted nonlinear least squares problem, its theorems, and its separable extension."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hident.errors import EstimationError
from hident.estimators.base import is_batched
from hident.estimators.bilinear_models import bilinear_least_squares as module
from hident.estimators.bilinear_models.bilinear import (
    Regression,
    inverse_gram,
    loss,
    normalised,
    regressors,
)
from hident.estimators.bilinear_models.bilinear_least_squares import (
    BilinearLeastSquares,
    bilinear_least_squares,
    bilinear_trust_region,
    complement,
    excess,
    jacobian,
)
from hident.estimators.bilinear_models.bounds import CramerRao
from hident.estimators.bilinear_models.two_stage import TwoStage, two_stage
from hident.linear_blocks import TransferFunction
from hident.records import Record, Truth
from hident.systems.nonlinearity import Polynomial

RNG = np.random.default_rng(0)
B = np.array([1.0, -2.0]) / np.sqrt(5.0)
A = np.array([1.0, 2.0, 5.0, 7.0, 1.0])


def noisy(seed, samples=100, trials=None, noise=1.0):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-3, 3, samples)
    phi = regressors(np.array([x**j for j in range(1, 6)]), 2)
    y = phi @ np.outer(A, B).ravel()
    size = len(y) if trials is None else (len(y), trials)
    return x, phi, y + noise * rng.normal(size=size).T


def record_of(x, y):
    linear = TransferFunction(b=(0.0, *B))
    return Record(x, np.append([0.0, 0.0], y), None, Truth(Polynomial(coefficients=(0.0, *A)), linear))


def spec(**fields):
    return BilinearLeastSquares.model_validate({"lags": 2, "degree": 5, **fields})


def test_jacobian_is_the_derivative():
    rng = np.random.default_rng(1)
    r, b, a = rng.normal(size=(7, 6)), rng.normal(size=2), rng.normal(size=3)

    def output(p):
        return r @ np.outer(p[2:], p[:2]).ravel()

    p, h = np.concatenate([b, a]), 1e-6
    numeric = [(output(p + h * e) - output(p - h * e)) / (2 * h) for e in np.eye(5)]
    np.testing.assert_allclose(jacobian(r, b, a), np.transpose(numeric), rtol=1e-8, atol=1e-9)


@settings(deadline=None, derandomize=True, max_examples=20)
@given(st.lists(st.floats(-5, 5), min_size=1, max_size=6).filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_complement(vector):
    basis = complement(np.array(vector))
    np.testing.assert_allclose(basis.T @ vector, 0.0, atol=1e-12)
    np.testing.assert_allclose(basis.T @ basis, np.eye(len(vector) - 1), atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_theorem_1_the_two_stage_estimate_is_the_optimum_for_the_inverse_gram_matrix(seed):
    x, phi, y = noisy(seed)
    plain = Regression.of(phi, 2)
    weighted = Regression.of(phi, 2, inverse_gram(plain))
    expected = two_stage(weighted, y)
    for normalise in (True, False):
        found = bilinear_least_squares(weighted, y, B, A, normalise=normalise)
        assert found.converged
        b, a = normalised(found.b, found.a)
        np.testing.assert_allclose(b, expected.b, rtol=1e-8)
        np.testing.assert_allclose(a, expected.a, rtol=1e-8)
    by_spec = spec(weight="inverse_gram", start="truth").fit(record_of(x, y), RNG)
    two_stages = TwoStage(lags=2, degree=5).fit(record_of(x, y), RNG)
    for name in two_stages.values:
        if name != "loss":
            assert by_spec.values[name] == pytest.approx(two_stages.values[name], rel=1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_theorem_3_any_weighting(seed):
    _, phi, y = noisy(seed + 10)
    root = np.random.default_rng(seed).normal(size=(len(y), len(y))) + np.sqrt(len(y)) * np.eye(len(y))
    first_stage = Regression.of(phi, 2, lambda signals: signals @ root.T)
    expected = two_stage(first_stage, y)
    # W-tilde of theorem 3
    optimum = bilinear_least_squares(Regression.of(phi, 2, inverse_gram(first_stage)), y, B, A)
    np.testing.assert_allclose(optimum.b, expected.b, rtol=1e-8)
    np.testing.assert_allclose(optimum.a, expected.a, rtol=1e-8)


def test_theorem_3_by_the_spec():
    x, _, y = noisy(15)
    noise = {"kind": "ar", "a": [0.8]}
    expected = TwoStage.model_validate({"lags": 2, "degree": 5, "weight": noise}).fit(record_of(x, y), RNG)
    found = spec(weight={"kind": "inverse_gram", "of": noise}, start="truth").fit(record_of(x, y), RNG)
    unweighted = TwoStage(lags=2, degree=5).fit(record_of(x, y), RNG)
    for name in ("b_1", "a_1", "a_5", "se_b_1", "se_a_1"):
        assert found.values[name] == pytest.approx(expected.values[name], rel=1e-8)
        assert found.values[name] != pytest.approx(unweighted.values[name], rel=1e-5)


def test_recovery_without_noise():
    x, phi, y = noisy(2, noise=0.0)
    found = bilinear_least_squares(Regression.of(phi, 2), y, np.array([0.6, -0.8]), 1.2 * A)
    np.testing.assert_allclose(found.b, B, rtol=1e-10)
    np.testing.assert_allclose(found.a, A, rtol=1e-9)
    fitted = spec().fit(record_of(x, y), RNG)
    assert fitted.values["a_4"] == pytest.approx(7.0, rel=1e-11)


@pytest.mark.parametrize(("n", "m"), [(1, 1), (1, 3), (3, 1)])
def test_smallest_problems(n, m):
    rng = np.random.default_rng(3)
    phi = regressors(np.array([rng.normal(size=40) for _ in range(m)]), n)
    y = rng.normal(size=len(phi))
    regression = Regression.of(phi, n)
    first = two_stage(regression, y)
    found = bilinear_least_squares(regression, y, first.b, first.a)
    # With one lag or one function, Theta has rank one anyway.
    np.testing.assert_allclose(np.outer(found.b, found.a), regression.theta(y), atol=1e-12)


def test_optimum_is_stationary_and_better_than_where_it_started():
    _, phi, y = noisy(4, noise=50.0)
    regression = Regression.of(phi, 2)
    first = two_stage(regression, y)
    found = bilinear_least_squares(regression, y, first.b, first.a)
    assert found.converged
    gradient = jacobian(phi, found.b, found.a).T @ (y - phi @ np.outer(found.a, found.b).ravel())
    size = np.linalg.norm(jacobian(phi, found.b, found.a), axis=0) * np.linalg.norm(y)
    np.testing.assert_allclose(gradient / size, 0.0, atol=1e-11)
    losses = [loss(regression, y, s.b, s.a, regression.root) for s in (found, first)]
    assert losses[0] < losses[1]


def test_estimate_is_efficient_where_the_two_stage_one_is_not():
    x, phi, Y = noisy(5, trials=1500)
    regression = Regression.of(phi, 2)
    first = two_stage(regression, Y)
    solved = [
        bilinear_least_squares(regression, y, b, a) for y, b, a in zip(Y, first.b, first.a, strict=True)
    ]
    limits = CramerRao(lags=2, degree=5, variance=1.0).fit(record_of(x, Y[0]), RNG).values
    spread = np.std([[*s.b, *s.a] for s in solved], axis=0)
    np.testing.assert_allclose(spread / list(limits.values()), 1.0, atol=0.08)
    assert np.std(first.b[:, 0]) > 3.0 * limits["se_b_1"]


def test_intervals_cover():
    x, _, Y = noisy(6, trials=300)
    trials = [spec().fit(record_of(x, y), RNG).values for y in Y]
    for name, truth in (("b_1", B[0]), ("a_1", 1.0), ("a_4", 7.0)):
        inside = [abs(t[name] - truth) < 1.986 * t[f"se_{name}"] for t in trials]
        assert np.mean(inside) == pytest.approx(0.95, abs=0.04)


def test_free_scale_is_the_same_model():
    x, _, y = noisy(7)
    fields = {"weight": "inverse_gram", "start": "truth", "stop": {}}
    held, free = (spec(normalise=n, **fields).fit(record_of(x, y), RNG).values for n in (True, False))
    assert free["loss"] == pytest.approx(held["loss"], rel=1e-6)
    length = np.hypot(free["b_1"], free["b_2"])
    assert abs(length - 1.0) > 1e-6
    assert free["b_1"] / length == pytest.approx(held["b_1"], rel=1e-6)
    assert free["se_b_1"] == pytest.approx(held["se_b_1"], rel=1e-5)


def test_early_stop():
    x, _, y = noisy(8)
    stopped = spec(weight="inverse_gram", start="truth", stop={"max_iterations": 1}, unconverged="keep")
    first = stopped.fit(record_of(x, y), RNG)
    last = spec(weight="inverse_gram", start="truth").fit(record_of(x, y), RNG)
    assert first.values["iterations"] == 1 < last.values["iterations"]
    assert (first.values["converged"], last.values["converged"]) == (0.0, 1.0)
    assert first.values["loss"] > last.values["loss"]


def test_without_convergence(monkeypatch):
    x, _, y = noisy(9)
    monkeypatch.setattr(
        module, "gauss_newton_solutions", lambda *_, **__: [module.Solution(B, A, 200, "exhausted")]
    )
    message = r"^the iteration has not converged in 200 iterations: allow"
    with pytest.raises(EstimationError, match=message):
        spec().fit(record_of(x, y), RNG)


def test_a_stop_before_its_tolerance_fails():
    x, _, y = noisy(8)
    stopped = spec(weight="inverse_gram", start="truth", stop={"max_iterations": 1})
    with pytest.raises(EstimationError, match=r"^the iteration has not converged in 1 iteration: allow"):
        stopped.fit(record_of(x, y), RNG)


def test_estimate_holds_what_it_says():
    x, _, y = noisy(10)
    for weight in ("identity", "inverse_gram", "estimated_ar"):
        estimator = spec(weight=weight)
        found = estimator.fit(record_of(x, y), RNG)
        values = {f"value {name}" for name in found.values}
        assert estimator.provides() == {"linear", "nonlinearity", "response"} | values


@pytest.mark.parametrize("normalise", [True, False])
@pytest.mark.parametrize("weight", ["identity", "inverse_gram"])
def test_the_trust_region_finds_the_same_minimum(weight, normalise):
    _, phi, y = noisy(11)
    plain = Regression.of(phi, 2)
    regression = plain if weight == "identity" else Regression.of(phi, 2, inverse_gram(plain))
    least = bilinear_least_squares(regression, y, B, A)
    found = bilinear_trust_region(
        regression, y, B, A, tolerance=1e-12, max_iterations=5000, normalise=normalise
    )
    assert found.status == "converged"
    # Both losses are flat there: a loss that is 1e-12 (1 + loss) above the least one is 1e-6 away.
    np.testing.assert_allclose(np.outer(found.b, found.a), np.outer(least.b, least.a), rtol=1e-4)
    assert (abs(np.linalg.norm(found.b) - 1.0) < 1e-12) == normalise


def test_the_trust_region_stops_short_of_the_minimum_where_a_step_changes_little():
    _, phi, y = noisy(11)
    plain = Regression.of(phi, 2)
    regression = Regression.of(phi, 2, inverse_gram(plain))
    first = two_stage(regression, y)
    found = bilinear_trust_region(regression, y, B, A, normalise=False)
    assert found.status == "converged"
    assert 0.0 < excess(regression, y, found, bilinear_least_squares(regression, y, first.b, first.a)) < 1e-3
    # Brought back to length one it is the minimum; on the way b has lost its length.
    assert abs(np.linalg.norm(found.b) - 1.0) > 1e-6
    few = bilinear_trust_region(regression, y, B, A, normalise=False, max_iterations=2)
    assert (few.status, few.iterations) == ("exhausted", 2)


@pytest.mark.parametrize("solver", ["gauss_newton", "subspace_trust_region"])
def test_an_estimate_says_how_its_iterations_ended(solver):
    x, _, y = noisy(12)
    fields = {"weight": "inverse_gram", "start": "truth", "solver": solver}
    assert spec(**fields).fit(record_of(x, y), RNG).details["status"] == "converged"
    one = spec(**fields, stop={"max_iterations": 1}, unconverged="keep").fit(record_of(x, y), RNG)
    assert one.details["status"] == "exhausted"
    with pytest.raises(EstimationError, match=r"^the iteration has not converged in 1 iteration: allow"):
        spec(**fields, stop={"max_iterations": 1}).fit(record_of(x, y), RNG)


def test_a_random_start_is_of_the_estimators_own_stream():
    x, _, y = noisy(13)
    estimator = spec(start="random", stop={"max_iterations": 1}, unconverged="keep")
    assert estimator.draws()
    assert all(map(is_batched, (estimator, spec(start="truth"))))
    one, same, other = (
        estimator.fit(record_of(x, y), np.random.default_rng(seed)).values["loss"] for seed in (1, 1, 2)
    )
    assert one == same != other
    settled = spec(start="random").fit(record_of(x, y), np.random.default_rng(1))
    from_truth = spec(start="truth").fit(record_of(x, y), RNG)
    for name in ("b_1", "a_1", "loss"):
        assert settled.values[name] == pytest.approx(from_truth.values[name], rel=1e-9)


def test_excess_is_the_loss_over_the_least_one():
    x, _, y = noisy(14)
    assert "excess" not in spec().names()
    fields = {"start": "truth", "excess": True, "unconverged": "keep"}
    short = spec(**fields, stop={"max_iterations": 1}, solver="subspace_trust_region").fit(
        record_of(x, y), RNG
    )
    least = spec().fit(record_of(x, y), RNG)
    ratio = short.values["loss"] / least.values["loss"]
    assert ratio > 1.0 + 1e-6
    assert short.values["excess"] == pytest.approx(ratio - 1.0, rel=1e-6)
    assert spec(**fields).fit(record_of(x, y), RNG).values["excess"] == 0.0
