"""The two-stage algorithm and the regression that it shares with the other bilinear estimators."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from hident.errors import EstimationError
from hident.estimators.bilinear_models.bilinear import (
    Regression,
    inverse_gram,
    loss,
    normalised,
    regressors,
)
from hident.estimators.bilinear_models.bounds import CramerRao, KnownNonlinearity
from hident.estimators.bilinear_models.two_stage import TwoStage, leading, two_stage
from hident.linear_blocks import TransferFunction
from hident.records import Record, Truth
from hident.systems.nonlinearity import Polynomial

RNG = np.random.default_rng(0)
B = np.array([1.0, -2.0]) / np.sqrt(5.0)
A = np.array([1.0, 2.0, 5.0, 7.0, 1.0])
QUICK = settings(deadline=None, derandomize=True, max_examples=30)


def powers(x, m):
    return np.array([x**j for j in range(1, m + 1)])


def problem(seed, b=B, a=A, samples=100, delay=1):
    """Regressors of x and the output without noise."""
    x = np.random.default_rng(seed).uniform(-3, 3, samples)
    phi = regressors(powers(x, len(a)), len(b), delay)
    return x, phi, phi @ np.outer(a, b).ravel()


def simulated(seed, noise=0.0, samples=100, a=A, b=B):
    """A record of Wang, Zhang, Ljung 2009's example 1 with another input."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-3, 3, samples)
    linear = TransferFunction(b=(0.0, *b))
    f = Polynomial(coefficients=(0.0, *a))
    y = linear.filter(f(x)) + noise * rng.normal(size=samples)
    return Record(x, y, None, Truth(f, linear, values=linear.values()))


def spec(**fields):
    return TwoStage.model_validate({"lags": 2, "degree": 5, **fields})


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_regressors_are_those_of_equation_6(delay):
    basis = np.arange(14.0).reshape(2, 7)
    phi = regressors(basis, 3, delay)
    assert phi.shape == (7 - delay - 2, 6)
    for row, t in zip(phi, range(delay + 2, 7), strict=True):
        np.testing.assert_array_equal(row, [basis[j, t - delay - i] for j in range(2) for i in range(3)])


@pytest.mark.parametrize(
    ("b", "a"),
    [
        (B, A),
        (np.array([0.0, 0.6, -0.8]), np.array([-3.0, 0.5])),
        (np.ones(1), A),
        (np.array([0.6, 0.0, -0.8]), np.array([-2.0])),
        (np.ones(1), np.array([-4.0])),
    ],
)
def test_recovery_without_noise(b, a):
    _, phi, y = problem(1, b, a)
    found = two_stage(Regression.of(phi, len(b)), y)
    np.testing.assert_allclose(found.b, b, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.a, a, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(found.theta, np.outer(b, a), atol=1e-10)
    assert np.linalg.svd(found.theta, compute_uv=False) == pytest.approx(
        [np.linalg.norm(a), *[0.0] * (min(len(b), len(a)) - 1)], abs=1e-9
    )


def test_spec_recovers_the_system():
    record = simulated(2)
    estimate = spec().fit(record, RNG)
    assert estimate.linear is not None and estimate.nonlinearity is not None
    np.testing.assert_allclose(estimate.linear.b, (0.0, *B), rtol=0, atol=1e-12)
    points = np.linspace(-3, 3, 11)
    np.testing.assert_allclose(
        estimate.nonlinearity(points), Polynomial(coefficients=(0, *A))(points), atol=1e-9
    )
    assert estimate.values["loss"] < 1e-18 * float(record.y @ record.y)


def test_any_basis_and_delay():
    rng = np.random.default_rng(3)
    x = rng.normal(size=60)
    y = np.zeros(60)
    y[3:] = 0.8 * (2.0 * np.abs(x[:-3]) - np.tanh(x[:-3]))
    y[4:] += 0.6 * (2.0 * np.abs(x[:-4]) - np.tanh(x[:-4]))
    basis = ["abs", {"kind": "expression", "expression": "tanh(u)"}]
    found = TwoStage.model_validate({"lags": 2, "basis": basis, "delay": 3}).fit(Record(x, y), RNG)
    assert found.values["b_3"] == pytest.approx(0.8, abs=1e-12)
    assert found.values["b_4"] == pytest.approx(0.6, abs=1e-12)
    assert found.values["a_1"] == pytest.approx(2.0, abs=1e-12)
    assert found.values["a_2"] == pytest.approx(-1.0, abs=1e-12)
    assert found.linear == TransferFunction(b=(0.0, 0.0, 0.0, found.values["b_3"], found.values["b_4"]))


def test_many_trials_at_once_are_the_trials_one_by_one():
    _, phi, y = problem(4)
    Y = y + np.random.default_rng(5).normal(size=(7, len(y)))
    regression = Regression.of(phi, 2)
    together = two_stage(regression, Y)
    variance = regression.variance(Y, together.theta)
    errors = regression.standard_errors(together.b, together.a, variance)
    losses = loss(regression, Y, together.b, together.a, regression.root)
    assert together.b.shape == (7, 2) and together.a.shape == (7, 5) and together.theta.shape == (7, 2, 5)
    for k in range(7):
        alone = two_stage(regression, Y[k])
        np.testing.assert_array_equal(together.b[k], alone.b)
        np.testing.assert_array_equal(together.a[k], alone.a)
        assert variance[k] == regression.variance(Y[k], alone.theta)
        assert losses[k] == loss(regression, Y[k], alone.b, alone.a, regression.root)
        for many, one in zip(errors, regression.standard_errors(alone.b, alone.a, variance[k]), strict=True):
            np.testing.assert_array_equal(many[k], one)


@QUICK
@given(st.floats(-50, 50).filter(lambda c: abs(c) > 1e-2), st.integers(0, 10**6))
def test_scale_of_the_output_goes_to_a(scale, seed):
    _, phi, y = problem(seed)
    y = y + np.random.default_rng(seed).normal(size=len(y))
    regression = Regression.of(phi, 2)
    plain, scaled = two_stage(regression, y), two_stage(regression, scale * y)
    np.testing.assert_allclose(scaled.b, plain.b, atol=1e-10)
    np.testing.assert_allclose(scaled.a, scale * plain.a, rtol=1e-8, atol=1e-9)


@QUICK
@given(
    st.lists(st.integers(-3, 3), min_size=1, max_size=4).filter(any),
    st.lists(st.integers(-3, 3), min_size=1, max_size=3).filter(any),
)
def test_normalisation_is_assumption_1(b, a):
    before = np.array(b, dtype=float), np.array(a, dtype=float)
    b, a = normalised(*before)
    assert np.linalg.norm(b) == pytest.approx(1.0)
    assert b[np.flatnonzero(b)[0]] > 0
    np.testing.assert_allclose(np.outer(b, a), np.outer(*before), atol=1e-14)


@pytest.mark.parametrize("shape", [(2, 5), (5, 2), (2, 2), (3, 4), (1, 4), (4, 1)])
def test_leading_vector_is_that_of_the_singular_value_decomposition(shape):
    theta = np.random.default_rng(28).normal(size=(50, *shape))
    # Nearly of rank one, far from it, and with orthogonal rows
    theta[:20] *= 1e-9
    theta[:20] += np.ones(shape)
    theta[49] = np.eye(*shape) * np.arange(3.0, 3.0 - shape[1], -1.0)
    expected = np.linalg.svd(theta).U[..., 0]
    found = leading(theta)
    np.testing.assert_allclose(np.abs(np.sum(found * expected, axis=-1)), 1.0, rtol=1e-14)
    signs = np.sign(np.sum(found * expected, axis=-1))[:, None]
    np.testing.assert_allclose(signs * found, expected, rtol=0, atol=1e-13)


def test_rounding_does_not_decide_the_sign():
    b, a = normalised(np.array([-1e-17, 2.0]), np.array([1.0]))
    assert b[1] == 1.0 and a[0] == 2.0


def test_any_weighting_is_the_formula_with_the_matrix():
    _, phi, y = problem(6)
    y = y + np.random.default_rng(7).normal(size=len(y))
    root = np.random.default_rng(8).normal(size=(len(y), len(y))) + len(y) * np.eye(len(y))
    W = root.T @ root
    regression = Regression.of(phi, 2, lambda signals: signals @ root.T)
    # Eq. (12) as printed
    vector = np.linalg.solve(phi.T @ W @ phi, phi.T @ W @ y)
    theta = regression.theta(y)
    np.testing.assert_allclose(theta.T.ravel(), vector, rtol=1e-7)
    np.testing.assert_allclose(regression.g @ regression.g.T, np.linalg.inv(phi.T @ W @ phi), rtol=1e-6)
    b, a = two_stage(regression, y).b, two_stage(regression, y).a
    rest = y - phi @ np.outer(a, b).ravel()
    assert loss(regression, y, b, a, regression.root) == pytest.approx(rest @ W @ rest, rel=1e-9)


def test_root_of_the_inverse_gram_matrix():
    _, phi, _ = problem(9, a=A[:2], samples=30)
    root = inverse_gram(Regression.of(phi, 2))(np.eye(len(phi))).T
    expected = np.linalg.pinv(phi @ phi.T, rcond=1e-10)
    np.testing.assert_allclose(root.T @ root, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_theorem_2_the_unweighted_algorithm_is_that_of_the_inverse_gram_matrix():
    record = simulated(10, noise=1.0)
    plain, weighted = (spec(weight=w).fit(record, RNG) for w in ("identity", "inverse_gram"))
    for name, value in plain.values.items():
        if name != "loss":
            assert weighted.values[name] == pytest.approx(value, rel=1e-10)
    assert weighted.values["loss"] < 0.01 * plain.values["loss"]


def test_known_noise_model_is_the_inverse_covariance():
    record = simulated(11, noise=1.0, samples=60)
    found = spec(weight={"kind": "ar", "a": [0.5, 0.3]}).fit(record, RNG)
    gamma = TransferFunction(a=(0.5, 0.3)).impulse_response(400)
    n = 58
    covariance = np.array([gamma[: 400 - k] @ gamma[k:] for k in range(n)])
    R = covariance[np.abs(np.subtract.outer(np.arange(n), np.arange(n)))]
    phi = regressors(powers(record.u, 5), 2)
    root = np.linalg.inv(np.linalg.cholesky(R))
    expected = two_stage(Regression.of(phi, 2, lambda signals: signals @ root.T), record.y[2:])
    np.testing.assert_allclose([found.values[f"b_{i}"] for i in (1, 2)], expected.b, rtol=1e-9)
    np.testing.assert_allclose([found.values[f"a_{j}"] for j in range(1, 6)], expected.a, rtol=1e-8)


def coloured(seed, samples, trials, a=0.9):
    innovation = np.random.default_rng(seed).normal(size=(300 + samples, trials))
    return np.array([TransferFunction(a=(a,)).filter(e)[300:] for e in innovation.T]).T


def _in_coloured_noise(weight):
    x, _, y = problem(12)
    Y = y[:, None] + coloured(13, len(y), 60)
    return [spec(weight=weight).fit(Record(x, np.append([0.0, 0.0], column)), RNG) for column in Y.T]


def _spread(trials):
    return np.std([[t.values["a_1"], t.values["a_4"]] for t in trials], axis=0)


@pytest.fixture(scope="module")
def plain_and_known():
    """The spread without weights and with those of the true noise."""
    return [_spread(_in_coloured_noise(weight)) for weight in ("identity", {"kind": "ar", "a": [0.9]})]


@pytest.mark.parametrize("method", ["burg", "yule_walker", "least_squares"])
def test_estimated_noise_model_is_nearly_as_good_as_the_known_one(method, plain_and_known):
    trials = _in_coloured_noise({"kind": "estimated_ar", "method": method})
    plain, known = plain_and_known
    spread = _spread(trials)
    assert np.all(spread < 0.75 * plain)
    np.testing.assert_allclose(spread, known, rtol=0.12)
    orders = [t.values["ar_order"] for t in trials]
    assert np.mean(np.equal(orders, 1.0)) > 0.8


def test_error_falls_like_n_to_the_minus_half():
    sizes, errors = np.array([100, 800, 6400]), []
    for n in sizes:
        _, phi, y = problem(14, samples=n)
        Y = y + np.random.default_rng(15).normal(size=(200, len(y)))
        found = two_stage(Regression.of(phi, 2), Y)
        errors.append([np.std(found.b[:, 0]), np.std(found.a[:, 0]), np.std(found.a[:, 3])])
    slopes = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    np.testing.assert_allclose(slopes, -0.5, atol=0.08)


def test_intervals_cover():
    _, phi, y = problem(16, samples=500)
    regression = Regression.of(phi, 2)
    Y = y + np.random.default_rng(17).normal(size=(4000, len(y)))
    found = two_stage(regression, Y)
    errors = regression.standard_errors(found.b, found.a, regression.variance(Y, found.theta))
    for estimate, error, truth in zip((found.b, found.a), errors, (B, A), strict=True):
        covered = np.mean(np.abs(estimate - truth) < 1.965 * error, axis=0)
        np.testing.assert_allclose(covered, 0.95, atol=0.012)


def test_standard_errors_are_the_spread_when_the_noise_is_known():
    _, phi, y = problem(18)
    Y = y + coloured(19, len(y), 400).T
    white = spec(weight={"kind": "ar", "a": [0.9]}).weighted(phi, Y[0]).white
    found = two_stage(white, Y)
    errors = white.standard_errors(found.b, found.a, white.variance(Y, found.theta))
    for estimate, error in zip((found.b, found.a), errors, strict=True):
        np.testing.assert_allclose(np.std(estimate, axis=0), error.mean(axis=0), rtol=0.15)


def test_estimate_holds_what_it_says():
    record = simulated(20, noise=1.0)
    record.u.flags.writeable = record.y.flags.writeable = False
    ar = {"kind": "ar", "a": [0.5]}
    for weight in ("identity", "inverse_gram", "estimated_ar", ar, {"kind": "inverse_gram", "of": ar}):
        estimator = spec(weight=weight)
        found = estimator.fit(record, RNG)
        values = {f"value {name}" for name in found.values}
        assert estimator.provides() == {"linear", "nonlinearity", "response"} | values
        assert all(type(value) is float for value in found.values.values())


@pytest.mark.parametrize(
    "fields",
    [{}, {"delay": 0}, {"lags": 1, "degree": 1}, {"delay": 4}, {"weight": "estimated_ar", "degree": 1}],
)
def test_shortest_record(fields):
    estimator = spec(**fields)
    n = estimator.fewest_samples()
    rng = np.random.default_rng(21)
    estimate = estimator.fit(Record(rng.normal(size=n), rng.normal(size=n)), RNG)
    assert np.isfinite(list(estimate.values.values())).all()


def failure(estimator, u, y=None):
    y = RNG.normal(size=len(u)) if y is None else y
    with pytest.raises(EstimationError) as error:
        estimator.fit(Record(u, y), RNG)
    return str(error.value)


def test_dependent_regressors():
    rng = np.random.default_rng(22)
    irregular = rng.normal(size=60)
    assert failure(spec(degree=1), np.full(60, 2.0)) == (
        "the regressors phi_1(x(t-1)), phi_1(x(t-2)) are linearly dependent (rank 1 of 2): "
        "the input takes 1 different value, and 1 basis function over 2 lags needs at least 2"
    )
    assert failure(spec(degree=2, lags=1), np.full(60, 2.0)) == (
        "the regressors phi_1(x(t-1)), phi_2(x(t-1)) are linearly dependent (rank 1 of 2): "
        "the input takes 1 different value, and 2 basis functions over 1 lag need at least 2"
    )
    assert failure(spec(), np.sign(irregular)) == (
        "the regressors phi_1(x(t-1)), phi_1(x(t-2)), phi_2(x(t-1)), phi_2(x(t-2)), phi_3(x(t-1)), "
        "phi_3(x(t-2)) and 4 more are linearly dependent (rank 3 of 10): "
        "the input takes 2 different values, and 5 basis functions over 2 lags need at least 6"
    )
    assert failure(spec(degree=None, basis=["identity", "abs"]), np.abs(irregular)) == (
        "the regressors phi_1(x(t-1)), phi_1(x(t-2)), phi_2(x(t-1)), phi_2(x(t-2)) are linearly dependent "
        "(rank 2 of 4): the basis functions coincide where the input is: use a wider input or other functions"
    )
    constant = ["identity", {"kind": "power", "exponent": 0}]
    assert failure(spec(degree=None, basis=constant), irregular) == (
        "the regressors phi_2(x(t-1)), phi_2(x(t-2)) are linearly dependent (rank 3 of 4): "
        "a combination of the basis functions is constant and equals its own lags: leave one function out "
        "and set 'constant: true' instead"
    )
    assert failure(spec(degree=1, lags=4, delay=2), np.tile(irregular[:3], 20)) == (
        "the regressors phi_1(x(t-2)), phi_1(x(t-5)) are linearly dependent (rank 3 of 4): past inputs "
        "repeat one another: use an input that varies irregularly from sample to sample, "
        "such as white noise, or fewer lags"
    )


def test_other_failures():
    x = np.random.default_rng(23).normal(size=60)
    assert failure(spec(), x, np.where(x > 2, np.nan, x)).startswith("the output has ")
    assert failure(spec(), np.append(x[1:], np.nan)) == "phi_1 is not finite at 1 of 60 samples of the input"
    assert failure(spec(), x, np.zeros(60)) == (
        "the output is 0 throughout: nothing can be learnt from a constant output"
    )
    with pytest.raises(
        EstimationError, match=r"^the output does not depend on the input: the estimate of b a'"
    ):
        two_stage(Regression.of(np.eye(8)[:, :4], 2), np.zeros(8))
    assert failure(spec(), x[:2]) == "2 samples are too few for the lags 1 to 2"
    assert failure(spec(), x[:9]) == (
        "7 equations cannot determine 10 coefficients: "
        "use a longer record, fewer lags or fewer basis functions"
    )


@pytest.mark.parametrize(
    ("fields", "where", "message"),
    [
        ({"lags": 0}, ("lags",), "must be greater than or equal to 1"),
        ({"delay": -1}, ("delay",), "must be greater than or equal to 0"),
        ({"degree": None}, (), "give either 'degree' or 'basis'"),
        ({"basis": ["abs"]}, (), "give either 'degree' or 'basis'"),
        ({"degree": None, "basis": []}, (), "'basis' must be a list of at least one function"),
        (
            {"weight": "identiy"},
            ("weight",),
            "must be identity, inverse_gram or a mapping with 'kind: ar', 'kind: estimated_ar' or "
            "'kind: inverse_gram'",
        ),
        ({"weight": "ar"}, ("weight", "a"), "is required: Feedback coefficients"),
        ({"weight": {"kind": "inverse_gram"}}, ("weight", "of"), "is required: The weighting W"),
        ({"weight": {"kind": "ar", "a": []}}, ("weight", "a"), "must be a list of at least 1"),
        (
            {"weight": {"kind": "ar", "a": [1.25]}},
            ("weight", "a"),
            "the noise is unstable: poles must lie inside the unit circle, not at modulus 1.25",
        ),
        (
            {"weight": {"kind": "estimated_ar", "method": "burgh"}},
            ("weight", "method"),
            "must be 'burg', 'yule_walker' or 'least_squares'",
        ),
    ],
)
def test_wrong_fields(fields, where, message):
    with pytest.raises(ValidationError) as error:
        spec(**fields)
    (found,) = error.value.errors()
    assert found["loc"] == where
    assert found["msg"].removeprefix("Value error, ").startswith(message)


def test_cramer_rao_bound_is_reached_by_no_two_stage_estimate():
    record = simulated(24)
    bound = CramerRao(lags=2, degree=5, variance=1.0)
    limits = bound.fit(record, RNG).values
    assert bound.provides() == {f"value {name}" for name in limits}
    phi = regressors(powers(record.u, 5), 2)
    found = two_stage(Regression.of(phi, 2), record.y[2:] + np.random.default_rng(25).normal(size=(4000, 98)))
    spread = np.concatenate([np.std(found.b, axis=0), np.std(found.a, axis=0)])
    ratio = spread / list(limits.values())
    assert np.all(ratio > 0.97)
    assert ratio[0] > 3.0
    doubled = CramerRao(lags=2, degree=5, variance=4.0).fit(record, RNG).values
    np.testing.assert_allclose(list(doubled.values()), 2.0 * np.array(list(limits.values())), rtol=1e-12)
    white = CramerRao.model_validate(
        {"lags": 2, "degree": 5, "variance": 1, "noise": {"kind": "ar", "a": [0.0]}}
    )
    np.testing.assert_allclose(
        list(white.fit(record, RNG).values.values()), list(limits.values()), rtol=1e-10
    )


@pytest.mark.parametrize(
    ("truth", "message"),
    [
        (None, "the true parameters are needed, and the record has none"),
        (
            Truth(Polynomial(coefficients=(0.0, 1.0)), TransferFunction(b=(0.0, 1.0), a=(0.5,))),
            "the true linear block is not a finite response at the lags 1 to 2",
        ),
        (
            Truth(Polynomial(coefficients=(0.0, 1.0)), TransferFunction(b=(1.0, 1.0))),
            "the true linear block is not a finite response at the lags 1 to 2",
        ),
        (
            Truth(Polynomial(coefficients=(0.0, 1.0)), TransferFunction(b=(0.0, 1.0, 1.0, 1.0))),
            "the true linear block is not a finite response at the lags 1 to 2",
        ),
        (
            Truth(Polynomial(coefficients=(1.0, 1.0)), TransferFunction(b=(0.0, 1.0))),
            "the true nonlinearity is not a combination of the basis functions",
        ),
    ],
)
def test_bound_needs_the_truth(truth, message):
    x = np.random.default_rng(26).normal(size=50)
    with pytest.raises(EstimationError, match=f"^{message}$"):
        CramerRao(lags=2, degree=2, variance=1.0).fit(Record(x, x, None, truth), RNG)


def test_known_nonlinearity():
    record = simulated(27)
    fields = {"lags": 2, "nonlinearity": {"kind": "polynomial", "coefficients": [0, 2, 4, 10, 14, 2]}}
    exact = KnownNonlinearity.model_validate(fields).fit(record, RNG)
    # The known scale is kept: twice the nonlinearity gives half of b.
    np.testing.assert_allclose([exact.values["b_1"], exact.values["b_2"]], 0.5 * B, rtol=1e-12)
    for weight in ("identity", "estimated_ar"):
        estimator = KnownNonlinearity.model_validate({**fields, "weight": weight})
        found = estimator.fit(simulated(27, noise=1.0), RNG)
        values = {f"value {name}" for name in found.values}
        assert estimator.provides() == {"linear", "nonlinearity", "response"} | values
        error = found.values["b_1"] - 0.5 * B[0]
        assert 0.0 < abs(error) < 4.0 * found.values["se_b_1"]
