"""up_to: [gain] leaves the sign to the estimator's rule, which is named, kept, or refused before the run."""

from functools import partial

import numpy as np
import pytest

import hident as hi
from hident.config.spec import component
from hident.engine.runner import run
from hident.estimators.base import EstimatorSpec
from hident.records import Estimate
from hident.reports.scoring import scoring
from tests.unit import plans

TEXT = """\
version: 1
title: A positive factor
trials: 2
samples: 300
system:
  kind: hammerstein
  nonlinearity: {kind: polynomial, coefficients: [0, 1, 0.5]}
  linear: {kind: fir, b: B}
excitation: {kind: iid, distribution: uniform, low: -2, high: 2}
estimators:
  e: ESTIMATOR
metrics:
  m: {kind: nonlinearity_percent_error, interval: [-1, 1], up_to: [gain]}
"""
TWO_STAGE = "{kind: two_stage, lags: 2, degree: 2}"
KERNEL = "{kind: kernel, kernel: gaussian, bandwidth: {h0: 0.4, alpha: 1/5}, delay: 0}"
# Of several key terms, each with a rule of its own.
KEYS = (
    "{kind: select, by: holdout, over: {key: [1, 2]}, "
    "estimator: {kind: voros_hammerstein, n: 1, m: 2, degree: 2}}"
)


@pytest.fixture
def plan_of(tmp_path):
    return partial(plans.planned, tmp_path)


@pytest.fixture
def refusals(tmp_path):
    return partial(plans.refusals, tmp_path)


def text(b, estimator=TWO_STAGE):
    return TEXT.replace("b: B", f"b: {b}").replace("ESTIMATOR", estimator)


def test_a_table_says_whose_sign_it_is_and_where_the_truth_was_turned(plan_of):
    positive = "Metric m: up to a positive factor, whichever fits the truth best."
    sign = "A positive factor is chosen in m, and has the sign of the method's rule: |b| = 1, b_1 > 0."
    assert list(scoring(plan_of(text("[0, 4, 2]")))) == [sign, positive]
    assert list(scoring(plan_of(text("[0, -4, -2]")))) == [
        sign,
        "The truth is turned to that sign: linear block divided by -1 (e).",
        positive,
    ]
    (unit,) = plan_of(text("[0, -4, -2]")).units
    assert max(run(plan_of(text("[0, -4, -2]"))).series[0].values) < 1.0
    assert unit.metrics["m"].up_to == ("gain",)
    both = plan_of(text("[0, -4, -2]"), "metrics.m.up_to=[gain,sign]")
    assert list(scoring(both)) == ["Metric m: up to a factor of either sign, whichever fits the truth best."]


def test_a_sign_that_no_system_has_is_refused_before_the_run(refusals):
    (message,) = refusals(text("[0, 4, 2]", KERNEL))
    assert message.endswith(
        "metrics.m: the metric 'nonlinearity_percent_error' compares up to a positive factor (nonlinearity), "
        "and no data determine the sign of the factor between the blocks: estimator 'e' (kernel) fixes it by "
        "the rule 'gamma_0 = 1, a constant left open'; the system's block delays its input by 1 sample, and "
        "the estimator counts on 0: set the estimator's 'delay' to 1, or to search, choose it for the least "
        "error by 'up_to: [gain, sign]' under it, or limit the metric to other estimators by 'estimators:' "
        "under it"
    )
    assert refusals(text("[0, 4, 2]", KERNEL), "metrics.m.up_to=[gain,sign]") == []
    assert refusals(text("[0, 4, 2]", KERNEL), "metrics.m.up_to=[]") == []
    assert refusals(text("[4, 2]", KERNEL)) == []


def test_rules_of_opposite_signs_are_refused_before_the_run(refusals, plan_of):
    (message,) = refusals(text("[0, 2, -1]", KEYS))
    assert (
        "fixes it by the rule 'b_1 = 1' and 'b_2 = 1'; the rules 'b_1 = 1' and 'b_2 = 1' ask for" in message
    )
    assert "choose it for the least error by 'up_to: [gain, sign]' under it" in message
    # Both signs are one: the sizes do not matter.
    plan = plan_of(text("[0, 2, 1]", KEYS))
    assert max(run(plan).series[0].values) < 1.0


def test_python_refuses_it_too():
    system = hi.Hammerstein(nonlinearity="identity", linear=hi.Fir(b=[0, 2, 1]))
    record = hi.simulate(system, hi.Iid(distribution="uniform", low=-2, high=2), 300)
    kernel = hi.Kernel(kernel="gaussian", bandwidth={"h0": 0.4, "alpha": "1/5"}, delay=0)
    metric = hi.NonlinearityPercentError(interval=[-1, 1], up_to=["gain"])
    with pytest.raises(hi.ConfigError, match="delays its input by 1 sample"):
        hi.score(hi.fit(kernel, record), record, kernel, m=metric)


def test_the_sign_of_an_estimator_that_does_not_say_is_not_stated(plan_of):
    @component("estimator", "says_no_sign")
    class SaysNoSign(EstimatorSpec):
        """The identity as a characteristic."""

        def provides(self):
            return frozenset({"nonlinearity"})

        def fit(self, record, rng=None):
            return Estimate(nonlinearity=np.positive)

    assert list(scoring(plan_of(text("[2]", "{kind: says_no_sign}")))) == [
        "A positive factor is chosen in m, and has the sign of the method's rule: not stated.",
        "Metric m: up to a positive factor, whichever fits the truth best.",
    ]


def test_a_sign_is_that_of_the_delay_that_an_estimate_found(plan_of):
    """The impulse response [0, 1, -3]: the kernel takes the larger lag, whose sign is the other one."""
    noticed = KERNEL.replace("delay: 0", "delay: search")
    (series,) = run(plan_of(text("[0, 1, -3]", noticed), "metrics.m.up_to=[gain,constant]")).series
    assert max(series.values) < 15.0
