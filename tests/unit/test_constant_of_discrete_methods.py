"""A constant added to the output of discrete systems: the bias that it leaves, and its estimate."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import hident as hi
from hident.records import Held, Part

OFFSET = 0.4
CUBIC = [0.0, 1.0, 0.5, -0.2]
SHORT = hi.Fir(b=[0, 0.6, -0.5, 0.3])
KNOWN = {"kind": "ar", "a": [0.6]}
BILINEAR: dict[str, Any] = {"lags": 3, "degree": 3}
FEEDBACK: dict[str, Any] = {"lags": 2, "degree": 3, "feedback": 1}
VOROS: dict[str, Any] = {"n": 1, "m": 2, "degree": 3, "tolerance": 1e-12, "max_iterations": 1000}
ESTIMATORS: dict[str, tuple[Any, dict[str, Any]]] = {
    "two_stage": (hi.TwoStage, BILINEAR),
    "two_stage, known noise": (hi.TwoStage, {**BILINEAR, "weight": KNOWN}),
    "two_stage, estimated noise": (hi.TwoStage, {**BILINEAR, "weight": "estimated_ar"}),
    "bilinear_least_squares": (hi.BilinearLeastSquares, BILINEAR),
    "bilinear_least_squares, (17)": (hi.BilinearLeastSquares, {**BILINEAR, "weight": "inverse_gram"}),
    "bilinear_least_squares, theorem 3": (
        hi.BilinearLeastSquares,
        {**BILINEAR, "weight": {"kind": "inverse_gram", "of": KNOWN}},
    ),
    "known_nonlinearity": (
        hi.KnownNonlinearity,
        {"lags": 3, "nonlinearity": hi.Polynomial(coefficients=CUBIC)},
    ),
    "separable_least_squares": (hi.SeparableLeastSquares, FEEDBACK),
    "voros_hammerstein": (hi.VorosHammerstein, VOROS),
    "voros_wiener": (hi.VorosWiener, {**VOROS, "degree": 2}),
}
LINEAR = {"separable_least_squares", "voros_hammerstein", "voros_wiener"}


def made(kind, **changes):
    cls, settings = ESTIMATORS[kind]
    return cls.model_validate({**settings, **changes})


def simulated(kind, constant=0.0, samples=400, noise=()):
    """A record whose nonlinearity has a constant of its own."""
    curve = hi.Polynomial(coefficients=[constant, *CUBIC[1:]])
    uniform = hi.Iid(distribution="uniform", low=-1.5, high=1.5)
    if kind == "voros_wiener":
        # From rest, as the method has it.
        curve = hi.Polynomial(coefficients=[constant, 1.0, 0.2])
        system = hi.Wiener(linear=hi.Arma(a=[0.6], b=[0, 0.5, 0.2]), nonlinearity=curve)
        u = hi.simulate(system, uniform, samples).u
        response = hi.TransferFunction(b=(0.0, 0.5, 0.2), a=(0.6,)).filter(u)
        return hi.Record(u, curve(response), truth=system.truth())
    block = hi.Arma(a=[0.6], b=[0, 1, 0.4]) if kind in LINEAR else SHORT
    return hi.simulate(hi.Hammerstein(nonlinearity=curve, linear=block), uniform, samples, noise=noise)


def moved(record, offset=OFFSET):
    return replace(record, y=record.y + offset)


def parameters(values):
    """The values that are no measure of the fit."""
    apart = ("se_", "loss", "iterations", "converged", "ar_order", "constant")
    return {name: value for name, value in values.items() if not name.startswith(apart)}


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_an_offset_biases_a_discrete_model_unless_it_is_estimated(kind):
    record = simulated(kind)
    truth = parameters(hi.fit(made(kind), record).values)
    found = hi.fit(made(kind, constant=True), moved(record))
    assert parameters(found.values) == pytest.approx(truth, abs=1e-7)
    assert found.values["constant"] == pytest.approx(OFFSET, abs=1e-7)
    assert found.response is not None
    # The record begins in motion, the response at rest.
    np.testing.assert_allclose(found.response(record.u, 1.0)[60:], record.y[60:] + OFFSET, atol=1e-6)
    try:
        biased = parameters(hi.fit(made(kind), moved(record)).values)
    except hi.EstimationError as error:
        # Its internal variable takes the offset for one of the linear block.
        assert kind == "voros_wiener"
        assert "has not converged" in str(error) or "diverged" in str(error)
    else:
        # An offset looks like noise with a pole near one, and such a weight takes it out.
        if kind == "two_stage, estimated noise":
            return
        assert max(abs(biased[name] - truth[name]) for name in truth) > 0.02


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_a_constant_of_the_nonlinearity_is_one_of_the_output(kind):
    """That of 0.4 before a block that was always at rest with it."""
    record, plain = simulated(kind, OFFSET), simulated(kind)
    truth = parameters(hi.fit(made(kind), plain).values)
    found = hi.fit(made(kind, constant=True), record)
    assert parameters(found.values) == pytest.approx(truth, abs=1e-7)
    gain = 1.0 if kind == "voros_wiener" else record.truth.linear.static_gain()
    assert found.values["constant"] == pytest.approx(OFFSET * gain, abs=1e-7)
    scored = hi.NonlinearityPercentError(interval=[-1, 1])
    assert hi.score(found, record, made(kind, constant=True), error=scored)["error"] < 1e-4


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_a_record_without_an_offset_has_the_constant_zero(kind):
    record = simulated(kind)
    plain, found = (hi.fit(made(kind, constant=one), record) for one in (False, True))
    assert [*plain.values, "constant"] == [*(name for name in found.values if name != "constant"), "constant"]
    assert found.values["constant"] == pytest.approx(0.0, abs=1e-8)
    assert parameters(found.values) == pytest.approx(parameters(plain.values), abs=1e-7)


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_it_is_named_and_counts_as_a_parameter(kind):
    plain, more = made(kind), made(kind, constant=True)
    assert "value constant" in more.provides()
    assert "value constant" not in plain.provides()
    assert more.free_parameters() == plain.free_parameters() + 1
    assert more.fewest_samples() == plain.fewest_samples() + 1
    left = {freedom for rule in more.normalisations() for freedom in rule.left}
    assert left == {"constant"}
    assert all(not rule.left for rule in plain.normalisations())


@pytest.mark.parametrize(("constant", "least"), [(0.02, 0.4), (0.5, 10.0)])
def test_even_a_small_constant_is_not_harmless(constant, least):
    """u + 0.5 u^2 plus a constant, in percent of which on [-2, 2] the error is, the constant apart."""
    system = hi.Hammerstein(
        nonlinearity=hi.Polynomial(coefficients=[constant, 1, 0.5]), linear=hi.Fir(b=[0, 2, 1])
    )
    record = hi.simulate(
        system, hi.Iid(distribution="uniform", low=-2, high=2), 400, noise=hi.White(nsr=1e-4)
    )
    error = hi.NonlinearityPercentError(interval=[-2, 2], up_to=["constant"])
    without, estimated = (
        hi.score(hi.fit(one, record), record, one, error=error)["error"]
        for one in (hi.TwoStage(lags=3, degree=2, constant=constant) for constant in (False, True))
    )
    assert without > least
    assert estimated < 0.01


@pytest.mark.parametrize("weight", ["identity", KNOWN])
def test_it_is_the_best_of_one_regression_with_a_column_of_ones(weight):
    record = moved(simulated("two_stage", noise=hi.Autoregressive(std=0.3, a=[0.6])))
    estimator = made("two_stage", constant=True, weight=weight)
    found = hi.fit(estimator, record)
    phi, y, _ = estimator.data(record)
    weighted = estimator.weighted(phi, y)
    white = made("two_stage", weight=weight).weighted(phi, y).regression.root
    columns = white(np.column_stack([phi, np.ones(len(y))]).T).T
    theta, (rss,), *_ = np.linalg.lstsq(columns, white(y), rcond=None)
    np.testing.assert_allclose(weighted.regression.theta(y).T.ravel(), theta[:-1], atol=1e-10)
    spare = len(y) - columns.shape[1]
    variance = weighted.white.variance(y, weighted.white.theta(y))
    assert variance == pytest.approx(rss / spare, rel=1e-10)
    assert found.values["constant"] == pytest.approx(OFFSET, abs=0.2)


@pytest.mark.parametrize(
    "kind", ["two_stage, known noise", "bilinear_least_squares", "separable_least_squares"]
)
def test_standard_errors_are_those_of_repeated_noise(kind):
    record, rng = simulated(kind), np.random.default_rng(5)
    colour = hi.TransferFunction(a=(0.6,) if "known" in kind else ())
    estimates, errors = [], []
    for _ in range(200):
        e = colour.filter(0.1 * rng.standard_normal(len(record) + 100))[100:]
        values = hi.fit(made(kind, constant=True), replace(record, y=record.y + OFFSET + e)).values
        estimates.append([values["b_1"], values["b_2"]])
        errors.append([values["se_b_1"], values["se_b_2"]])
    # The standard deviation of 200 has a relative standard error of 5 %.
    np.testing.assert_allclose(np.std(estimates, axis=0, ddof=1), np.mean(errors, axis=0), rtol=0.15)


@pytest.mark.parametrize("kind", ["two_stage", "bilinear_least_squares, theorem 3"])
def test_many_records_at_once_give_the_same_bits(kind):
    records = [moved(simulated(kind, noise=hi.White(std=0.1)), offset) for offset in (0.0, 0.3, -2.0)]
    estimator = made(kind, constant=True)
    for one, record in zip(estimator.fit_many(records), records, strict=True):
        assert one.values == hi.fit(estimator, record).values


@pytest.mark.parametrize("kind", [one for one in ESTIMATORS if one != "voros_wiener"])
def test_several_experiments_share_it(kind):
    records = [simulated(kind, samples=n) for n in (200, 150)]
    parts = {
        "a": Part(0, 200, 1.0, Held(np.zeros(1), np.zeros(1))),
        "b": Part(200, 350, 1.0, Held(np.zeros(1), np.zeros(1))),
    }
    u, y = (np.concatenate([getattr(one, name) for one in records]) for name in "uy")
    found = hi.fit(made(kind, constant=True), hi.Record(u, y + OFFSET, 1.0, parts=parts))
    assert found.values["constant"] == pytest.approx(OFFSET, abs=1e-7)


@pytest.mark.parametrize("kind", ["two_stage", "separable_least_squares"])
def test_a_basis_that_holds_a_constant_has_it_already(kind):
    cls, settings = ESTIMATORS[kind]
    basis = ["identity", {"kind": "power", "exponent": 0}]
    settings = {**{name: value for name, value in settings.items() if name != "degree"}, "basis": basis}
    settings["lags"] = 1
    record = moved(simulated(kind))
    cls.model_validate(settings).fit(record)
    with pytest.raises(hi.EstimationError) as caught:
        cls.model_validate({**settings, "constant": True}).fit(record)
    assert str(caught.value) == (
        "the regressors phi_2(x(t-1)) and the constant of the output are linearly dependent (rank 2 of 3): a "
        "combination of the basis functions is constant, as 'constant' is: leave one function out, or "
        "'constant'"
    )


def test_a_bound_counts_it_as_not_known():
    record, settings = simulated("two_stage"), {"lags": 3, "variance": 0.01, "degree": 3}
    known = hi.fit(hi.CramerRao(**settings), record).values
    bound = hi.fit(hi.CramerRao(**settings, constant=True), record).values
    assert all(bound[name] >= value for name, value in known.items())
    assert bound["se_b_2"] > 1.2 * known["se_b_2"]
    with_own = simulated("two_stage", OFFSET)
    assert hi.fit(hi.CramerRao(**settings, constant=True), with_own).values.keys() == bound.keys()
    with pytest.raises(hi.EstimationError, match="not a combination of the basis functions"):
        hi.fit(hi.CramerRao(**settings), with_own)
