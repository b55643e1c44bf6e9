"""Where a constant stands, before or behind the linear block, is no error of a method that leaves it open."""

from functools import partial

import numpy as np
import pytest

import hident as hi
from hident.engine.runner import run
from hident.errors import EstimationError
from hident.model_output import from_equilibrium
from hident.reports.scoring import scoring
from tests.unit import plans

UNIFORM = hi.Iid(distribution="uniform", low=-2, high=2)
VALIDATION = {"excitation": UNIFORM, "samples": 500}


@pytest.fixture
def plan_of(tmp_path):
    return partial(plans.planned, tmp_path)


def _quadratic(constant):
    return hi.Polynomial(coefficients=[constant, 1, 0.5])


def _record(constant, linear, samples=600, **changes):
    return hi.simulate(
        hi.Hammerstein(nonlinearity=_quadratic(constant), linear=linear), UNIFORM, samples, **changes
    )


def _error(estimator, record, **changes):
    metric = hi.ValidationPercentError(**VALIDATION, **changes)
    return hi.score(hi.fit(estimator, record), record, estimator, error=metric)["error"]


FIR, ARMA = hi.Fir(b=[2, 1]), hi.Arma(a=[0.9], b=[2, 1])
KNOWN = {"lags": 2, "delay": 0, "nonlinearity": _quadratic(0)}


@pytest.mark.parametrize("constant", [0.2, 5.0, 500.0])
@pytest.mark.parametrize(
    ("estimator", "linear"),
    [
        (hi.KnownNonlinearity(**KNOWN, constant=True), FIR),
        (hi.TwoStage(lags=2, delay=0, degree=2, constant=True), FIR),
        (hi.BilinearLeastSquares(lags=2, delay=0, degree=2, constant=True), FIR),
        (hi.SeparableLeastSquares(lags=2, delay=0, feedback=1, degree=2, constant=True), ARMA),
        (hi.VorosHammerstein(n=1, m=2, delay=0, degree=2, constant=True, tolerance=1e-12), ARMA),
        (
            hi.Select(
                by="aic",
                over={"lags": [2, 3]},
                estimator=hi.TwoStage(lags=2, delay=0, degree=2, constant=True),
            ),
            FIR,
        ),
    ],
    ids=lambda one: getattr(one, "kind", ""),
)
def test_the_start_of_a_constant_before_the_block_is_no_error(estimator, linear, constant):
    record = _record(constant, linear)
    assert _error(estimator, record) < 1e-6
    assert _error(estimator, record, up_to=[]) > 0.1


def test_a_basis_that_is_not_zero_at_zero_begins_in_its_equilibrium_too():
    basis = ["identity", {"kind": "expression", "expression": "cos(u)"}]
    nonlinearity = hi.Expression(expression="3 + u + 2*cos(u)")
    record = hi.simulate(hi.Hammerstein(nonlinearity=nonlinearity, linear=ARMA), UNIFORM, 600)
    estimator = hi.SeparableLeastSquares(lags=2, delay=0, feedback=1, basis=basis, constant=True)
    assert _error(estimator, record) < 1e-6


def test_a_continuous_block_and_a_block_behind_a_wiener_hammerstein_system_are_as_any():
    steps = hi.Multistep(switching_time=1, std=1, limits=[-2, 2])
    system = hi.Hammerstein(nonlinearity=_quadratic(5), linear=hi.Continuous(a=[1.5, 0.7]))
    record = hi.simulate(system, steps, 1000, dt=0.1)
    first = {"n": 2, "horizon": 8}
    polynomial = {"kind": "polynomial", "degree": 2}
    estimator = hi.IterativeHammerstein(nonlinearity=polynomial, first=first, start=15.0, constant=True)
    found, given = hi.fit(estimator, record), {"excitation": steps, "samples": 400}
    scores = hi.score(
        found,
        record,
        estimator,
        open=hi.ValidationPercentError(**given),
        written=hi.ValidationPercentError(**given, up_to=[]),
    )
    assert scores["open"] < 0.2 * scores["written"]


def test_the_level_of_the_output_is_determined_and_counts():
    metric = hi.ValidationPercentError(**VALIDATION, up_to=["constant"])
    right, wrong = (
        hi.score(_behind(level), _record(5, ARMA), error=metric)["error"] for level in (150.0, 151.0)
    )
    assert right < 1e-6
    assert wrong > 5.0


def test_a_method_that_takes_the_nonlinearity_through_zero_is_charged():
    assert _error(hi.KnownNonlinearity(**KNOWN), _record(5, FIR)) > 100.0


def test_a_method_that_determines_the_constant_is_compared_from_rest_unless_asked():
    blocks = [{"kind": "polynomial", "degree": 2}, {"kind": "linear", "nb": 2, "nf": 1, "nk": 0}]
    estimator = hi.PredictionError(blocks=blocks, starts=2, start="rest", n_init=200)
    record = _record(5, ARMA)
    assert _error(estimator, record) < 1e-4
    assert _error(estimator, record, up_to=["constant"]) < 1e-4
    # A constant of the same level behind the block: from rest it is another model.
    found = hi.fit(hi.SeparableLeastSquares(lags=2, delay=0, feedback=1, degree=2, constant=True), record)
    other = hi.Estimate(response=found.response)
    rest, equal = (
        hi.score(other, record, error=hi.ValidationPercentError(**VALIDATION, up_to=up_to))["error"]
        for up_to in ([], ["constant"])
    )
    assert rest > 10.0
    assert equal < 1e-6


def _behind(level, factor=1.0, linear=ARMA):
    """The quadratic before the block, with a constant behind it."""
    return hi.Estimate(response=lambda u, dt: level + factor * linear.simulate(_quadratic(0)(u), dt))


def test_the_unit_of_the_error_does_not_depend_on_the_constant():
    wrong = {}
    for constant in (0, 500):
        record = _record(constant, ARMA)
        estimate = _behind(30.0 * constant, 1.1)
        metric = hi.ValidationPercentError(**VALIDATION, up_to=["constant"])
        wrong[constant] = hi.score(estimate, record, error=metric)["error"]
    assert wrong[0] == pytest.approx(wrong[500], rel=1e-6)


def test_the_mean_squared_error_of_the_output_leaves_the_same_open():
    linear = hi.Arma(a=[0.9], b=[2, 1], initial="zero")
    record = _record(5, linear, samples=3000)
    estimate = _behind(30.0 * 5, linear=linear)
    scores = hi.score(estimate, record, rest=hi.OutputMse(up_to=[]), equal=hi.OutputMse(up_to=["constant"]))
    assert scores["equal"] < 1e-12
    assert scores["rest"] > 1.0


INTEGRATING = """\
version: 1
title: A constant before an integrator
trials: 1
samples: 200
system:
  kind: hammerstein
  nonlinearity: {kind: polynomial, coefficients: [0.5, 1]}
  linear: {kind: arma, a: [1], b: [0, 1], initial: zero}
excitation: &uniform {kind: iid, distribution: uniform, low: -1, high: 1}
estimators:
  one: {kind: two_stage, lags: 2, degree: 1, constant: true}
metrics:
  error: {kind: validation_error, samples: 50, excitation: *uniform}
"""


def test_a_block_that_integrates_has_no_equilibrium_with_a_constant_before_it(tmp_path):
    assert not plans.refusals(tmp_path, INTEGRATING, "metrics.error.up_to=[]")
    assert not plans.refusals(tmp_path, INTEGRATING, "system.nonlinearity.coefficients=[0, 1]")
    for settings in ((), ("metrics.error.up_to=[constant]",)):
        [said] = plans.refusals(tmp_path, INTEGRATING, *settings)
        assert said.endswith(
            "begins both outputs in equilibrium at input zero, as the estimator leaves a constant open or "
            "'up_to: [constant]' asks for it, and the system has no equilibrium there: write 'up_to: []', by "
            "which they begin at rest"
        )


SEVERAL = """\
version: 1
title: Where a constant stands
trials: 3
samples: 200
system:
  kind: hammerstein
  nonlinearity: {kind: polynomial, coefficients: [5, 1, 0.5]}
  linear: {kind: fir, b: [2, 1]}
excitation: &uniform {kind: iid, distribution: uniform, low: -2, high: 2}
estimators:
  open: {kind: two_stage, lags: 2, delay: 0, degree: 2, constant: true}
  zero: {kind: two_stage, lags: 2, delay: 0, degree: 2}
metrics:
  error: &error {kind: validation_error, samples: 50, excitation: *uniform}
  rest: {<<: *error, up_to: []}
  equal: {<<: *error, up_to: [constant]}
"""


def test_table_md_says_which_methods_are_scored_from_equilibrium(plan_of):
    plan = plan_of(SEVERAL)
    assert [line for line in scoring(plan) if line.startswith("Metric")] == [
        "Metric error: both outputs begin in equilibrium at input zero, not at rest, as the method leaves "
        "open on which side of the linear block a constant stands (open).",
        "Metric rest: both outputs begin at rest.",
        "Metric equal: both outputs begin in equilibrium at input zero.",
    ]
    found = {(one.unit.name, one.metric): one.value("mean") for one in run(plan).series}
    assert found["open", "error"] == found["open", "equal"] < 1e-6
    assert found["open", "rest"] > 1.0
    assert found["zero", "error"] == found["zero", "rest"] > 10.0


@pytest.mark.parametrize(
    "response", [lambda u, dt: 2.0 * u, lambda u, dt: 3.0 + 2.0 * u, lambda u, dt: np.cumsum(u)]
)
def test_what_is_in_equilibrium_already_is_given_to_the_last_bit(response):
    u = UNIFORM.sample(100, 1.0, np.random.default_rng(1))
    made = from_equilibrium(response, u, 1.0)
    assert made is not None
    assert np.array_equal(made, response(u, 1.0))


def test_a_slow_block_is_followed_until_it_has_settled():
    linear = hi.Arma(a=[0.999], b=[1])
    u = UNIFORM.sample(50, 1.0, np.random.default_rng(1))
    made = from_equilibrium(lambda u, dt: linear.simulate(2.0 + u, dt), u, 1.0)
    assert made == pytest.approx(2000.0 + linear.simulate(u), abs=1e-5)


def test_what_never_settles_has_no_equilibrium():
    u = UNIFORM.sample(50, 1.0, np.random.default_rng(1))
    assert from_equilibrium(lambda u, dt: np.cumsum(2.0 + u), u, 1.0) is None
    assert from_equilibrium(lambda u, dt: np.sin(np.arange(len(u))), u, 1.0) is None
    assert from_equilibrium(lambda u, dt: np.exp(0.1 * np.arange(len(u))), u, 1.0) is None
    record = _record(5, FIR)
    ramp = hi.Estimate(response=lambda u, dt: np.cumsum(2.0 + u))
    with pytest.raises(EstimationError, match="no equilibrium at input zero"):
        hi.score(ramp, record, error=hi.ValidationPercentError(**VALIDATION, up_to=["constant"]))
