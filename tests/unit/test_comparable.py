"""Absolute values are compared only where the system keeps the rule that fixes the free factor."""

import textwrap
from functools import partial

import numpy as np
import pytest

from hident import plugins
from hident.config.spec import Of, component
from hident.engine.comparable import governed
from hident.engine.trial import Data, generate
from hident.estimators.base import EstimatorSpec
from hident.metrics.nonlinearity import NonlinearityPercentError
from hident.records import Estimate
from hident.reports.scoring import scoring
from tests.unit import plans

plugins.load()

SCALE = """\
version: 1
title: The same system with another split of the gain
trials: 10
samples: 400
system:
  kind: hammerstein
  nonlinearity: {kind: polynomial, coefficients: [0, 1, 0.5]}
  linear: {kind: fir, b: [0, 2, 1]}
excitation: {kind: iid, distribution: uniform, low: -2, high: 2}
noise: {kind: white, nsr: 0.02}
estimators:
  two-stage: {kind: two_stage, lags: 3, degree: 2}
  kernel: {kind: kernel, kernel: gaussian, bandwidth: {h0: 0.4, alpha: 1/5}}
metrics:
  nonlinearity: {kind: nonlinearity_percent_error, interval: [-2, 2]}
"""
CONTINUOUS = """\
version: 1
title: A continuous block
trials: 2
dt: 0.1
samples: 500
system: SYSTEM
excitation: {kind: multistep, switching_time: 1, std: 1, limits: [-3, 3]}
estimators:
  e: ESTIMATOR
metrics:
  m: METRIC
"""
WIENER = "{kind: wiener, nonlinearity: NONLINEARITY, linear: {kind: continuous, a: [3, 2], b: B}}"
HORIZONS = "first: {n: 2, m: 1, horizon: 5}"
CURVE = "{kind: nonlinearity_percent_error, interval: [-1, 1]}"


@pytest.fixture
def plan_of(tmp_path):
    return partial(plans.planned, tmp_path)


@pytest.fixture
def refusals(tmp_path):
    return partial(plans.refusals, tmp_path)


def discrete(system, estimator, metric=CURVE):
    keep = textwrap.dedent(SCALE).split("system:")[0]
    return (
        f"{keep}system: {system}\nexcitation: {{kind: iid, distribution: uniform, low: -2, high: 2}}\n"
        f"estimators:\n  e: {estimator}\nmetrics:\n  m: {metric}\n"
    )


def hammerstein(b, nonlinearity="{kind: polynomial, coefficients: [0, 1, 0.5]}"):
    return f"{{kind: hammerstein, nonlinearity: {nonlinearity}, linear: {{kind: fir, b: {b}}}}}"


def continuous(system, estimator, metric=CURVE):
    return plans.replaced(CONTINUOUS, {"SYSTEM": system, "ESTIMATOR": estimator, "METRIC": metric})


def test_another_split_of_the_gain_is_refused_with_the_remedy(refusals):
    first, second = refusals(SCALE)
    assert first.endswith(
        "metrics.nonlinearity: the metric 'nonlinearity_percent_error' compares absolute values "
        "(nonlinearity), and no data determine the factor between the blocks: estimator 'two-stage' "
        "(two_stage) fixes it by the rule '|b| = 1, b_1 > 0', and the system has 2.236 in place of 1. "
        "Divide b of the linear block by 2.236067977 and multiply the nonlinearity by it, which is the "
        "same system, score what does not depend on it (validation_error), or limit the metric to other "
        "estimators by 'estimators:' under it"
    )
    assert (
        "estimator 'kernel' (kernel) fixes it by the rule 'gamma_0 = 1, a constant left in'; the system's "
        in (second)
    )
    said = (
        "delays its input by 1 sample, and the estimator counts on 0: set the estimator's 'delay' to 1, or to"
    )
    assert said in second


def test_no_remedy_is_given_that_another_estimators_rule_forbids(refusals):
    two = SCALE.replace(
        "kernel: {kind: kernel, kernel: gaussian, bandwidth: {h0: 0.4, alpha: 1/5}}",
        "Voros: {kind: voros_hammerstein, n: 1, m: 2, degree: 2}",
    )
    first, second = refusals(two)
    assert first.endswith(
        "by the rule '|b| = 1, b_1 > 0', and the system has 2.236 in place of 1. The same system with that "
        "factor moved would not keep the rule of estimator 'Voros', 'b_1 = 1': score what does not depend on "
        "it (validation_error), or limit the metric to other estimators by 'estimators:' under it"
    )
    assert "the rule of estimator 'two-stage', '|b| = 1, b_1 > 0'" in second
    # One factor may do for two rules.
    for line in refusals(two.replace("b: [0, 2, 1]", "b: [0, 2]")):
        assert "Divide b of the linear block by 2 and multiply the nonlinearity by it" in line


def test_the_case_is_named_where_not_all_are_alike(refusals):
    alone = SCALE.replace(
        "  kernel: {kind: kernel, kernel: gaussian, bandwidth: {h0: 0.4, alpha: 1/5}}\n", ""
    )
    cases = "cases: {b: {one: {system.linear.b: [0, 0.6, 0.8]}, two: {system.linear.b: [0, 2, 1]}}}\n"
    (message,) = refusals(alone + cases)
    assert "the metric 'nonlinearity_percent_error' at b two compares absolute values" in message
    (message,) = refusals(f"{alone}cases: {{samples: [400, 500]}}\n")
    assert "the metric 'nonlinearity_percent_error' compares absolute values" in message


def test_the_remedy_gives_the_same_system_and_a_right_score(plan_of):
    estimator = "{kind: two_stage, lags: 3, degree: 2}"
    split = hammerstein(
        "[0, 2/sqrt(5), 1/sqrt(5)]", "{kind: polynomial, coefficients: [0, sqrt(5), 0.5*sqrt(5)]}"
    )
    (unit,) = plan_of(discrete(split, estimator)).units
    (other,) = plan_of(discrete(hammerstein([0, 2, 1]), estimator, "{kind: value, of: [b_1]}")).units
    u = np.linspace(-1, 1, 50)
    same = unit.data.system.simulate(u), other.data.system.simulate(u)
    np.testing.assert_allclose(same[0], same[1], rtol=1e-12, atol=1e-12)
    found = unit.estimator.fit(generate(unit.data, 1, 0), np.random.default_rng(0))
    (percent,) = unit.metrics["m"].evaluate(found, generate(unit.data, 1, 0))
    assert percent < 1e-9


@pytest.mark.parametrize(
    ("b", "estimator", "said"),
    [
        ("[1]", "{kind: kernel, kernel: gaussian, bandwidth: {h0: 1, alpha: 0}}", None),
        ("[2]", "{kind: kernel, kernel: gaussian, bandwidth: {h0: 1, alpha: 0}}", "has 2 in place of 1"),
        (
            "[0, 1]",
            "{kind: kernel, kernel: gaussian, bandwidth: {h0: 1, alpha: 0}}",
            "set the estimator's 'delay' to 1",
        ),
        (
            "[sin(pi), 1]",
            "{kind: kernel, kernel: gaussian, bandwidth: {h0: 1, alpha: 0}}",
            "set the estimator's 'delay' to 1",
        ),
        (
            "[0, 1]",
            "{kind: kernel, kernel: gaussian, bandwidth: {h0: 1, alpha: 0}, prefilter: "
            "{kind: known_dynamics, b: [sin(pi), 1]}}",
            None,
        ),
        (
            "[0, 1]",
            "{kind: orthogonal, basis: {kind: trigonometric, interval: [-2, 2]}, terms: {q0: 1, alpha: 0}}",
            "set the estimator's 'delay' to 1",
        ),
        (
            "[3, 1]",
            "{kind: kernel, kernel: gaussian, bandwidth: {h0: 1, alpha: 0}, prefilter: "
            "{kind: known_dynamics, b: [3, 1]}}",
            None,
        ),
        (
            "[3, 1]",
            "{kind: kernel, kernel: gaussian, bandwidth: {h0: 1, alpha: 0}, prefilter: "
            "{kind: instrumental_variables, order: 1, instrument: identity, ma_order: 1}}",
            "'b_0 = 1', and the system has 3 in place of 1",
        ),
        ("[0, 0.6, -0.8]", "{kind: bilinear_least_squares, lags: 2, degree: 2}", None),
        # Written with four digits, as papers print it.
        ("[0, 0.4472, -0.8944]", "{kind: two_stage, lags: 2, degree: 2}", None),
        ("[0, -0.6, 0.8]", "{kind: two_stage, lags: 2, degree: 2}", "the system has -1 in place of 1"),
        ("[0, 0, 1]", "{kind: two_stage, lags: 2, degree: 2}", "begin with zero, and noise gives b_1 a sign"),
        ("[0, 1e-17, 1]", "{kind: two_stage, lags: 2, degree: 2}", "begin with zero, and noise gives b_1 a"),
        ("[1]", "{kind: two_stage, lags: 2, degree: 2}", "b_1 to b_2 are zero"),
        ("[1, 1e-17]", "{kind: two_stage, lags: 2, degree: 2}", "b_1 to b_2 are zero"),
        ("[0, 3]", "{kind: separable_least_squares, lags: 1, degree: 2, feedback: 1}", "has 3 in place of 1"),
        ("[0, 1, 0.5]", "{kind: voros_hammerstein, n: 1, m: 2, degree: 2}", None),
        (
            "[0, 2, 0.5]",
            "{kind: voros_hammerstein, n: 1, m: 2, degree: 2}",
            "'b_1 = 1', and the system has 2",
        ),
    ],
)
def test_every_discrete_method_by_its_own_rule(refusals, b, estimator, said):
    found = refusals(discrete(hammerstein(b), estimator))
    assert (len(found) == 1 and said in found[0]) if said else found == []


@pytest.mark.parametrize(
    ("system", "estimator", "metric", "said"),
    [
        (
            WIENER.replace("NONLINEARITY", "chen_type_3").replace("B", "[2]"),
            f"{{kind: iterative_wiener, nonlinearity: {{kind: four_segment}}, {HORIZONS}}}",
            CURVE,
            "multiply the nonlinearity's argument by it",
        ),
        (
            WIENER.replace("NONLINEARITY", "chen_type_3").replace("B", "[1]"),
            f"{{kind: iterative_wiener, nonlinearity: {{kind: four_segment}}, {HORIZONS}}}",
            "{kind: error, of: [a_1, b_0]}",
            "'e_1 = 1', and the system has 3.162 in place of 1",
        ),
        (
            WIENER.replace("NONLINEARITY", "chen_type_3").replace("B", "[1]"),
            f"{{kind: iterative_wiener, nonlinearity: {{kind: four_segment}}, {HORIZONS}}}",
            "{kind: error, of: [a_1, a_2]}",
            None,
        ),
        (
            WIENER.replace("NONLINEARITY", "chen_type_3").replace("B", "[1]"),
            "{kind: voros_wiener, n: 2, m: 2, degree: 3}",
            CURVE,
            "Divide the nonlinearity's argument by 3.16227766 and multiply b of the linear block by it",
        ),
        (
            WIENER.replace("NONLINEARITY", "identity").replace("B", "[3]"),
            "{kind: linear_model, block: {n: 2, m: 0, horizon: 5}}",
            "{kind: error, of: [b_0]}",
            None,
        ),
        (
            WIENER.replace("NONLINEARITY", "{kind: polynomial, coefficients: [0, 2]}").replace("B", "[3]"),
            "{kind: linear_model, block: {n: 2, m: 0, horizon: 5}}",
            "{kind: error, of: [b_0]}",
            "'the nonlinearity is u', and the system has 2 in place of 1",
        ),
        (
            WIENER.replace("NONLINEARITY", "chen_type_3").replace("B", "[3]"),
            "{kind: linear_model, block: {n: 2, m: 0, horizon: 5}}",
            "{kind: error, of: [b_0]}",
            "the system's nonlinearity is not a multiple of it",
        ),
        (
            WIENER.replace("NONLINEARITY", "chen_type_3").replace("B", "[0, 1]"),
            f"{{kind: iterative_wiener, nonlinearity: {{kind: four_segment}}, {HORIZONS}}}",
            CURVE,
            "the system's linear block has no static gain",
        ),
        (
            WIENER.replace("NONLINEARITY", "chen_type_3").replace("B", "[sin(pi), 1]"),
            f"{{kind: iterative_wiener, nonlinearity: {{kind: four_segment}}, {HORIZONS}}}",
            CURVE,
            "the system's linear block has no static gain",
        ),
        (
            "{kind: hammerstein, nonlinearity: abs, linear: {kind: continuous, a: [3, 2]}}",
            "{kind: kernel, kernel: gaussian, bandwidth: {h0: 1, alpha: 0}}",
            CURVE,
            "set the estimator's 'delay' to 1",
        ),
    ],
)
def test_every_continuous_method_by_its_own_rule(refusals, system, estimator, metric, said):
    found = refusals(continuous(system, estimator, metric))
    assert (len(found) == 1 and said in found[0]) if said else found == []


def test_what_does_not_depend_on_the_factor_is_named_and_allowed(refusals):
    system = WIENER.replace("NONLINEARITY", "chen_type_3").replace("B", "[2]")
    estimator = f"{{kind: iterative_wiener, nonlinearity: {{kind: four_segment}}, {HORIZONS}}}"
    (refused,) = refusals(continuous(system, estimator))
    assert "score what does not depend on it (validation_error, linear_percent_error)" in refused
    steps = "{kind: multistep, switching_time: 1, std: 1}"
    for metric in (
        "{kind: linear_percent_error}",
        f"{{kind: validation_error, samples: 100, excitation: {steps}}}",
        "{kind: settling_time}",
        "{kind: value, of: [b_0]}",
    ):
        assert refusals(continuous(system, estimator, metric)) == []


def test_a_known_nonlinearity_fixes_the_factor(refusals):
    def found(known):
        estimator = f"{{kind: known_nonlinearity, lags: 2, nonlinearity: {known}}}"
        return refusals(discrete(hammerstein("[0, 3, 1]"), estimator, "{kind: error, of: [b_1]}"))

    assert found("{kind: polynomial, coefficients: [0, 1, 0.5]}") == []
    assert "the system has 0.5 in place of 1" in found("{kind: polynomial, coefficients: [0, 2, 1]}")[0]
    assert "is not a multiple of it" in found("identity")[0]


BLOCKS = """\
version: 1
title: Two blocks
trials: 2
dt: 0.5
samples: 400
system:
  kind: wiener_hammerstein
  input_linear: {kind: continuous, a: [1], b: [2]}
  nonlinearity: {kind: polynomial, coefficients: [0, 1, 0.5]}
  output_linear: {kind: continuous, a: [1], b: [3]}
excitation: {kind: staircase, levels: [-1, 0, 1, 2], hold: 50}
estimators: {e: {kind: nonlinearity_identification}}
metrics: {m: {kind: mise, interval: [-1, 1]}}
"""


def test_two_linear_blocks_have_a_factor_each(refusals):
    (found,) = refusals(BLOCKS)
    assert "'static gain 1', and the system has 2, 3 in place of 1" in found
    assert "Divide b of input_linear by 2, b of output_linear by 3, and multiply before and after" in found
    assert refusals(BLOCKS.replace("b: [2]", "b: [1]").replace("b: [3]", "b: [1]")) == []


def test_an_estimator_that_does_not_say_is_not_refused_and_its_tables_say_so(plan_of):
    @component("estimator", "says_nothing")
    class SaysNothing(EstimatorSpec):
        """The identity as a characteristic."""

        def provides(self):
            return frozenset({"nonlinearity"})

        def fit(self, record, rng=None):
            return Estimate(nonlinearity=np.positive)

    spec = Of("estimator").validate({"kind": "says_nothing"})
    assert isinstance(spec, EstimatorSpec)
    assert spec.normalisations() is None
    assert list(governed(NonlinearityPercentError(interval=(-1, 1)), spec)) == []
    plan = plan_of(discrete(hammerstein("[2]"), "{kind: says_nothing}"))
    assert list(scoring(plan)) == [
        "Absolute values are compared in m; the free factor between the blocks: not stated."
    ]


def test_tables_say_which_rule_a_score_used_and_what_it_leaves_apart(plan_of):
    kernel = "{kind: kernel, kernel: gaussian, bandwidth: {h0: 1, alpha: 0}}"
    plan = plan_of(discrete(hammerstein("[1]"), kernel))
    assert list(scoring(plan)) == [
        "Absolute values are compared in m; "
        "the free factor between the blocks: gamma_0 = 1, a constant left in."
    ]
    system = WIENER.replace("NONLINEARITY", "chen_type_3").replace("B", "[2]")
    estimator = f"{{kind: iterative_wiener, nonlinearity: {{kind: four_segment}}, {HORIZONS}}}"
    assert list(scoring(plan_of(continuous(system, estimator, "{kind: linear_percent_error}")))) == [
        "Metric m: gain and delay apart, blocks sampled every 0.1."
    ]


def test_a_process_has_no_block_that_could_break_a_rule():
    tank = {"kind": "acid_tank", "volume": 1, "q_a": 14.2, "q_b": 13.5, "acetic_acid": 1, "propionic_acid": 1}
    tank |= {"sodium_hydroxide": 2, "pk_acetic": 4.75, "pk_propionic": 4.87}
    steps = {"kind": "multistep", "switching_time": 1, "std": 1}
    data = Data.model_validate({"samples": 10, "dt": 0.1, "system": tank, "excitation": steps})
    spec = Of("estimator").validate({"kind": "nonlinearity_identification"})
    assert isinstance(spec, EstimatorSpec)
    (rule,) = spec.normalisations() or ()
    assert rule.factors(data.system.truth(), 0.1) is None
