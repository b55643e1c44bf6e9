"""The tests of residuals as scores."""

import numpy as np
import pytest

from hident.block_chain import BlockChain
from hident.errors import ConfigError, EstimationError
from hident.fitted_model import FittedModel, NoiseModel
from hident.linear_blocks import TransferFunction
from hident.metrics.residuals import ResidualTest
from hident.numerics.judgement import judgement
from hident.records import Estimate, Record, needed
from tests.unit.plans import planned, refusals, replaced

CHAIN = BlockChain((TransferFunction(b=(0.5,), a=(0.5,)),))


def record(n=500, pole=0.8, seed=1):
    rng = np.random.default_rng(seed)
    u, e = rng.normal(size=n), 0.1 * rng.normal(size=n)
    return Record(u, CHAIN.response(u) + TransferFunction(b=(1.0,), a=(pole,)).filter(e))


def model(pole=0.8):
    return Estimate(model=FittedModel(CHAIN, "rest", NoiseModel(ar=(pole,), variance=0.01)))


def scored(given, estimate=None, **settings):
    (found,) = ResidualTest(**settings).evaluate(estimate or model(), given)
    return found


def test_is_that_of_the_residuals():
    given = record()
    found = judgement(given.u, given.y, CHAIN.response(given.u))
    tests = {
        "whiteness": found.whiteness.test,
        "input": needed(found.input).test,
        "nonlinear_input": needed(found.nonlinearity),
        "normality": found.normality.test,
        "drift": found.drift.test,
    }
    for of, test in tests.items():
        assert scored(given, of=of) == test.p_value
        assert scored(given, of=of, gives="statistic") == test.statistic
        assert scored(given, of=of, gives="rejected") == 100.0 * (test.p_value < 0.01)


def test_a_simulation_leaves_the_colour_that_a_prediction_takes_away():
    given = record()
    assert scored(given, of="whiteness") < 1e-10
    assert scored(given, of="whiteness", by="prediction", n_init=1) > 0.01


def test_the_parameters_of_the_noise_model_count_in_a_prediction():
    given, estimate = record(), model()
    y_hat = needed(estimate.model).predict(given)
    wanted = judgement(given.u[1:], given.y[1:], y_hat[1:], fitted=1).whiteness.test.p_value
    assert scored(given, of="whiteness", by="prediction", n_init=1) == wanted


def test_how_often_it_rejects():
    right = [scored(record(300, 0.0, seed), of="input", gives="rejected", level=0.1) for seed in range(100)]
    other = Estimate(model=FittedModel(BlockChain((TransferFunction(b=(0.5,), a=(0.4,)),)), "rest"))
    wrong = [scored(record(300, 0.0, seed), other, of="input", gives="rejected") for seed in range(20)]
    assert 3.0 <= np.mean(right) <= 20.0
    assert np.mean(wrong) == 100.0


@pytest.mark.parametrize(
    ("u", "of", "said"),
    [
        ("constant", "input", "the input is constant: the residuals cannot depend on it"),
        (
            "constant",
            "nonlinear_input",
            "on this input every nonlinear function is a line: none can be tested",
        ),
        ("noise-free", "drift", "the residuals are no more than rounding: there is nothing to test"),
    ],
)
def test_what_cannot_be_tested_fails(u, of, said):
    given = record()
    if u == "constant":
        estimate = Estimate(response=lambda u, dt: np.zeros(len(u)))
        given = Record(np.ones(500), given.y)
    else:
        estimate = model()
        given = Record(given.u, CHAIN.response(given.u))
    with pytest.raises(EstimationError, match=said):
        scored(given, estimate, of=of)


def test_errors_of_several_steps_are_not_white_anyway():
    with pytest.raises(
        ConfigError, match="the errors of a prediction 3 steps ahead are not white under any model"
    ):
        ResidualTest(of="whiteness", by="prediction", steps=3)
    assert ResidualTest(of="input", by="prediction", steps=3).steps == 3


CONFIG = """\
version: 1
title: A lag
trials: 2
dt: 0.1
samples: 1001
system: {kind: hammerstein, nonlinearity: identity, linear: {kind: continuous, a: [3, 2], b: [1]}}
excitation: {kind: multistep, switching_time: 1, std: 1, limits: [-3, 3]}
estimators:
  e: {kind: linear_model, block: {n: 2, m: 1, horizon: 10}}
metrics:
  m: METRIC
"""


def test_too_few_residuals_are_refused_before_the_run(tmp_path):
    (said,) = refusals(
        tmp_path, replaced(CONFIG, {"METRIC": "{kind: residual_test, of: drift, n_init: 971}"})
    )
    assert said.endswith(
        "the metric 'residual_test' cannot judge this: 30 residuals, at most 30 in one experiment, are too "
        "few to be judged: 40 are needed, and 20 in one experiment"
    )


def test_tables_say_what_is_tested(tmp_path):
    plan = planned(
        tmp_path, replaced(CONFIG, {"METRIC": "{kind: residual_test, of: input, gives: rejected}"})
    )
    assert plan.units[0].metrics["m"].says(0.1) == (
        "rejections at 0.01 in % of the test of independence of the input, on the record that was fitted, by "
        "simulation"
    )
    assert ResidualTest(of="whiteness").says(None) == (
        "p-value of the test of whiteness by Ljung and Box, on the record that was fitted, by simulation"
    )
