"""The truth is compared in the form that an estimator's rule asks for; where none does, before the run."""

import re
import textwrap
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import hident as hi
from hident import plugins
from hident.config.spec import Of, component
from hident.engine.comparable import governed, truth_for
from hident.engine.runner import run
from hident.engine.trial import Data, Job, run_trials
from hident.estimators.base import EstimatorSpec
from hident.estimators.normalisation import brought, first_coefficient, unit_slope, unit_static_gain
from hident.metrics.nonlinearity import NonlinearityPercentError
from hident.records import Estimate
from hident.reports.base import FigureSpec
from hident.reports.output import Outputs
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


def scored(unit, metric, trial=0):
    """What a run gives for a metric of a unit."""
    (outcome,) = run_trials(unit.data, [Job(unit.estimator, (unit.metrics[metric],))], [[trial]], seed=1)
    (value,) = outcome.scores[0].values[0]
    return float(value)


def test_another_split_of_the_gain_reads_a_few_per_cent_and_says_up_to_what(plan_of, tmp_path):
    plan = plan_of(SCALE)
    results = run(plan)
    read = {series.unit.name: series.value("median") for series in results.series}
    assert read["two-stage"] < 1.0
    assert read["kernel"] < 10.0
    assert Outputs(plan, tmp_path / "out").write(results, {}) == ()
    assert (
        "Absolute values are compared in nonlinearity; the free factor between the blocks: |b| = 1, b_1 > 0 "
        "(two-stage); gamma_0 = 1, a constant left open, lags counted from the delay found (kernel). The "
        "truth is brought to that form: linear block divided by 2.236 (two-stage); linear block divided by 2 "
        "at the system's own delay (kernel). "
        "Metric nonlinearity: up to a constant, which the method leaves open (kernel)."
    ) in (tmp_path / "out" / "table.md").read_text(encoding="utf-8")


AT_ONCE = SCALE.replace("{kind: kernel,", "{kind: kernel, delay: 0,")


def test_what_no_factor_brings_to_the_rule_is_refused_with_the_remedies(refusals):
    (message,) = refusals(AT_ONCE)
    assert message.endswith(
        "metrics.nonlinearity: the metric 'nonlinearity_percent_error' compares absolute values "
        "(nonlinearity), and no data determine the factor between the blocks: estimator 'kernel' (kernel) "
        "fixes it by the rule 'gamma_0 = 1, a constant left open'; the system's block delays its input by 1 "
        "sample, and the estimator counts on 0: set the estimator's 'delay' to 1, or to search, choose it "
        "for the least error by 'up_to: [gain, sign, constant]' under it, or limit the metric to other "
        "estimators by 'estimators:' under it"
    )
    for chosen in ("[gain, sign]", "[]", "[gain, sign, constant]"):
        assert refusals(AT_ONCE, f"metrics.nonlinearity.up_to={chosen}") == []
    for chosen in ("[sign]", "[constant]"):
        assert refusals(AT_ONCE, f"metrics.nonlinearity.up_to={chosen}") == [message]


SAME_SYSTEM = SCALE.replace("b: [0, 2, 1]", "b: [2, 1]").replace("lags: 3", "lags: 3, delay: 0")


def test_every_method_reads_right_whatever_the_split_of_the_gain(plan_of):
    """The same system four times: the errors are those of the methods."""
    read: dict[str, list[float]] = {}
    for gain in (0.25, 1.0, 4.0, -3.0):
        text = SAME_SYSTEM.replace("b: [2, 1]", f"b: [{2 * gain}, {gain}]").replace(
            "coefficients: [0, 1, 0.5]", f"coefficients: [0, {1 / gain}, {0.5 / gain}]"
        )
        for unit in plan_of(text).units:
            read.setdefault(unit.name, []).append(scored(unit, "nonlinearity"))
    assert max(read["two-stage"]) < 1.0
    assert max(read["kernel"]) < 12.0, read
    assert min(read["kernel"]) > 0.5 * max(read["kernel"]), read


def test_the_accepted_rule_changes_no_bit(plan_of):
    """A system that keeps the rule is compared as it is written."""
    kernel = "{kind: kernel, kernel: gaussian, bandwidth: {h0: 1, alpha: 0}, known_point: {u: 0, value: 0}}"
    for b in ("[1, 0.5]", "[1.00005, 0.5]"):
        (unit,) = plan_of(discrete(hammerstein(b), kernel, "{kind: mise, interval: [-1, 1]}")).units
        truth = unit.data.system.truth()
        assert truth_for(unit.metrics["m"], unit.estimator, truth, None) is truth


def test_absolute_values_are_compared_by_asking_for_it(plan_of):
    found = discrete(
        hammerstein("[0, 4, 2]"), "{kind: two_stage, lags: 2, degree: 2}", CURVE[:-1] + ", up_to: []}"
    )
    (unit,) = plan_of(found).units
    # |b| is 4.472.
    assert scored(unit, "m") == pytest.approx(100.0 * (np.sqrt(20.0) - 1.0), rel=0.01)


def test_a_factor_that_is_asked_for_is_the_best_one(plan_of):
    two_stage = "{kind: two_stage, lags: 2, degree: 2}"
    for b, up_to, least, most in (
        ("[0, 4, 2]", "[gain]", 0.0, 1.0),
        # The method holds b_1 > 0, and what is not listed stays in its form.
        ("[0, -4, -2]", "[gain]", 0.0, 1.0),
        ("[0, -4, -2]", "[gain, sign]", 0.0, 1.0),
        ("[0, -0.8, -0.6]", "[sign]", 0.0, 2.0),
    ):
        (unit,) = plan_of(discrete(hammerstein(b), two_stage, f"{CURVE[:-1]}, up_to: {up_to}}}")).units
        assert least <= scored(unit, "m") <= most, (b, up_to)


@pytest.mark.parametrize("up_to", ["[constant]", "[sign]", "[sign, constant]"])
def test_what_is_not_listed_stays_in_the_method_s_form(plan_of, up_to):
    found = discrete(hammerstein("[0, 4, 2]"), "{kind: two_stage, lags: 2, degree: 2}")
    (unit,) = plan_of(found, f"metrics.m.up_to={up_to}").units
    assert scored(unit, "m") < 1.0


def test_a_delay_alone_is_chosen_in_the_method_s_form(plan_of):
    """The impulse response b = [0, 4, 2] of a method that holds |b| = 1."""
    (unit,) = plan_of(
        discrete(
            hammerstein("[0, 4, 2]"),
            "{kind: two_stage, lags: 2, degree: 2}",
            "{kind: impulse_response_error, up_to: [delay]}",
        )
    ).units
    assert scored(unit, "m") < 1.0


def test_the_case_is_named_where_not_all_are_alike(refusals):
    alone = SCALE.replace(
        "  kernel: {kind: kernel, kernel: gaussian, bandwidth: {h0: 0.4, alpha: 1/5}}\n", ""
    )
    cases = "cases: {b: {one: {system.linear.b: [0, 0.6, 0.8]}, two: {system.linear.b: [0, 0, 1]}}}\n"
    (message,) = refusals(alone + cases)
    assert "the metric 'nonlinearity_percent_error' at b two compares absolute values" in message
    late = alone.replace("[0, 2, 1]", "[0, 0, 1]")
    (message,) = refusals(f"{late}cases: {{samples: [400, 500]}}\n")
    assert "the metric 'nonlinearity_percent_error' compares absolute values" in message


SPLIT = hi.Hammerstein(nonlinearity=hi.Polynomial(coefficients=[0, 1, 0.5]), linear=hi.Fir(b=[0, 2, 1]))


@pytest.mark.parametrize(
    ("spec", "factors", "dt"),
    [
        (SPLIT, {"linear": -2.5}, 1.0),
        (SPLIT, {"nonlinearity": 4.0}, 1.0),
        (
            hi.Wiener(nonlinearity=hi.DeadZone(low=-1, high=2), linear=hi.Ar(a=[0.5])),
            {"linear": -2.5},
            1.0,
        ),
        (
            hi.Wiener(nonlinearity="chen_type_3", linear=hi.Continuous(a=[3, 2], b=[2])),
            {"nonlinearity": 3.0},
            0.1,
        ),
    ],
)
def test_a_truth_that_is_brought_is_the_same_system(spec, factors, dt):
    truth, u = spec.truth(), np.random.default_rng(0).uniform(-2, 2, 300)
    assert truth.rescaled is not None
    moved = truth.rescaled(factors)
    (one, other) = (
        truth_.linear.filter if truth_.linear else partial(truth_.continuous.respond, dt=dt)
        for truth_ in (truth, moved)
    )
    if truth.structure == "N-L":
        responses = one(truth.nonlinearity(u)), other(moved.nonlinearity(u))
    else:
        responses = truth.nonlinearity(one(u)), moved.nonlinearity(other(u))
    np.testing.assert_allclose(*responses, rtol=1e-9, atol=1e-12)
    block = moved.linear or moved.continuous
    assert {name: moved.values[name] for name in block.values()} == block.values()
    for at in moved.breakpoints:
        beside = moved.nonlinearity(np.array([at - 1e-3, at, at + 1e-3]))
        assert abs(np.diff(beside, 2)[0]) > 1e-4


def test_candidates_that_hold_different_rules_are_refused(refusals):
    """Which of them the data choose in a trial, and so what the truth should be brought to, nobody knows."""
    select = (
        "{kind: select, by: bic, over: {delay: DELAYS}, estimator: {kind: two_stage, lags: 2, degree: 2}}"
    )
    (message,) = refusals(discrete(hammerstein("[1, 2, 0.5]"), select.replace("DELAYS", "[0, 1]")))
    assert (
        "estimator 'e' (select) fixes it by the rule '|b| = 1, b_0 > 0' and '|b| = 1, b_1 > 0'; the rules "
        "'|b| = 1, b_0 > 0' and '|b| = 1, b_1 > 0' ask for different factors of one system, score what"
    ) in message
    assert refusals(discrete(hammerstein("[1, 2, 0.5]"), select.replace("DELAYS", "[1]"))) == []


def test_rules_of_different_parts_do_not_meet():
    truth = SPLIT.truth()
    one, other = first_coefficient(1, values="b"), first_coefficient(2, values="b")
    with pytest.raises(ValueError, match="'b_1 = 1' and 'b_2 = 1' ask for different factors of one system"):
        brought(truth, [one, other], None)
    apart = [replace(one, parts=frozenset({"linear"})), replace(other, parts=frozenset({"nonlinearity"}))]
    moved = brought(truth, apart, None)
    assert moved.linear is not None
    assert moved.nonlinearity is not None
    assert moved.linear.b == (0.0, 1.0, 0.5)
    assert moved.nonlinearity(np.array([2.0])) == 4.0


def test_values_of_both_blocks_take_their_factors():
    moved = brought(SPLIT.truth(), [first_coefficient(1, values="b a")], None)
    assert {name: moved.values[name] for name in ("b_1", "b_2", "a_1", "a_2")} == {
        "b_1": 1.0, "b_2": 0.5, "a_1": 2.0, "a_2": 1.0,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("one", "two"),
    [
        (hi.Continuous(a=[1], b=[2]), hi.Continuous(a=[1, 2], b=[3, 1])),
        (hi.Ar(a=[0.5]), hi.Fir(b=[2, 1])),
    ],
)
def test_both_blocks_of_a_wiener_hammerstein_system_are_brought_to_static_gain_one(one, two):
    system = hi.WienerHammerstein(
        input_linear=one, nonlinearity=hi.Polynomial(coefficients=[0, 1, 0.5]), output_linear=two
    )
    truth = system.truth()
    moved = brought(truth, [unit_static_gain()], 0.5)
    assert truth.nonlinearity is not None
    assert moved.nonlinearity is not None
    x = np.linspace(-1, 1, 9)
    np.testing.assert_allclose(moved.nonlinearity(x), 3.0 * truth.nonlinearity(2.0 * x), rtol=1e-12)


@pytest.mark.parametrize(
    ("b", "estimator", "said"),
    [
        ("[1]", "{kind: kernel, kernel: gaussian, bandwidth: {h0: 1, alpha: 0}}", None),
        ("[2]", "{kind: kernel, kernel: gaussian, bandwidth: {h0: 1, alpha: 0}}", None),
        (
            "[0, 1]",
            "{kind: kernel, kernel: gaussian, bandwidth: {h0: 1, alpha: 0}, delay: 0}",
            "'delay' to 1",
        ),
        (
            "[sin(pi), 1]",
            "{kind: kernel, kernel: gaussian, bandwidth: {h0: 1, alpha: 0}, delay: 0}",
            "set the estimator's 'delay' to 1, or to search",
        ),
        # The method finds the delay by itself.
        ("[0, 0, 1]", "{kind: kernel, kernel: gaussian, bandwidth: {h0: 1, alpha: 0}}", None),
        (
            "[0, 1]",
            "{kind: kernel, kernel: gaussian, bandwidth: {h0: 1, alpha: 0}, prefilter: "
            "{kind: known_dynamics, b: [sin(pi), 1]}}",
            None,
        ),
        (
            "[0, 1]",
            "{kind: orthogonal, basis: {kind: trigonometric, interval: [-2, 2]}, terms: {q0: 1, alpha: 0}, "
            "delay: 0}",
            "set the estimator's 'delay' to 1, or to search",
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
            None,
        ),
        ("[0, 0.6, -0.8]", "{kind: bilinear_least_squares, lags: 2, degree: 2}", None),
        # Written with four digits, as papers print it.
        ("[0, 0.4472, -0.8944]", "{kind: two_stage, lags: 2, degree: 2}", None),
        ("[0, -0.6, 0.8]", "{kind: two_stage, lags: 2, degree: 2}", None),
        ("[0, 0, 1]", "{kind: two_stage, lags: 2, degree: 2}", "begin with zero, and noise gives b_1 a sign"),
        ("[0, 1e-17, 1]", "{kind: two_stage, lags: 2, degree: 2}", "begin with zero, and noise gives b_1 a"),
        ("[1]", "{kind: two_stage, lags: 2, degree: 2}", "b_1 to b_2 are zero"),
        ("[1, 1e-17]", "{kind: two_stage, lags: 2, degree: 2}", "b_1 to b_2 are zero"),
        ("[0, 3]", "{kind: separable_least_squares, lags: 1, degree: 2, feedback: 1}", None),
        ("[0, 1, 0.5]", "{kind: voros_hammerstein, n: 1, m: 2, degree: 2}", None),
        ("[0, 2, 0.5]", "{kind: voros_hammerstein, n: 1, m: 2, degree: 2}", None),
        ("[1, 0]", "{kind: voros_hammerstein, n: 1, m: 2, degree: 2}", "the system has b_1 = 0"),
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
            None,
        ),
        (
            WIENER.replace("NONLINEARITY", "chen_type_3").replace("B", "[1]"),
            f"{{kind: iterative_wiener, nonlinearity: {{kind: four_segment}}, {HORIZONS}}}",
            "{kind: error, of: [a_1, b_0]}",
            None,
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
            None,
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
            None,
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
            "{kind: kernel, kernel: gaussian, bandwidth: {h0: 1, alpha: 0}, delay: 0}",
            CURVE,
            "set the estimator's 'delay' to 1, or to search",
        ),
    ],
)
def test_every_continuous_method_by_its_own_rule(refusals, system, estimator, metric, said):
    found = refusals(continuous(system, estimator, metric))
    assert (len(found) == 1 and said in found[0]) if said else found == []


BLOCK_ERRORS = {
    "impulse": {"kind": "impulse_response_error"},
    "frequency": {"kind": "frequency_response_error"},
}
TWO_SEGMENTS = {"n": 1, "m": 1, "delay": 1, "degree": 2, "unconverged": "keep"}
FIRST = {"n": 1, "m": 0, "horizon": 5}


@pytest.mark.parametrize(
    ("kind", "estimator"),
    [
        ("wiener", {"kind": "voros_wiener", **TWO_SEGMENTS}),
        (
            "wiener",
            {"kind": "iterative_wiener", "nonlinearity": {"kind": "polynomial", "degree": 2}, "first": FIRST},
        ),
        ("hammerstein", {"kind": "voros_hammerstein", **TWO_SEGMENTS}),
        ("hammerstein", {"kind": "two_stage", "lags": 20, "degree": 2}),
        (
            "hammerstein",
            {
                "kind": "iterative_hammerstein",
                "nonlinearity": {"kind": "polynomial", "degree": 2},
                "first": FIRST,
            },
        ),
    ],
    ids=lambda value: value["kind"] if isinstance(value, dict) else None,
)
def test_errors_of_a_continuous_block_are_the_same_whatever_the_split_of_the_gain(kind, estimator):
    """Of discrete and of continuous estimates."""

    def written(gain):
        outside, inside = (gain, 1.0) if kind == "hammerstein" else (1.0, gain)
        curve = hi.Polynomial(coefficients=[0, outside / inside, 0.2 * outside / inside**2])
        linear = hi.Continuous(a=[2], b=[inside / outside])
        return (hi.Hammerstein if kind == "hammerstein" else hi.Wiener)(nonlinearity=curve, linear=linear)

    experiment = {
        "version": 1,
        "title": "Other splits of the gain",
        "trials": 1,
        "dt": 0.25,
        "samples": 300,
        "cases": {"written": {str(gain): {"system": written(gain)} for gain in (1, 4, -0.5)}},
        "streams": {"kind": "numpy", "share": ["input"]},
        "excitation": hi.Multistep(switching_time=1, std=0.5, limits=[-1, 1]),
        "estimators": {"e": estimator},
        "metrics": BLOCK_ERRORS,
    }
    for _, errors in hi.run(experiment).trials_frame().groupby("metric"):
        assert errors["value"].iloc[0] < 100.0
        assert errors["value"].to_numpy() == pytest.approx(errors["value"].iloc[0], rel=1e-3, abs=1e-3)


def test_a_rule_governs_a_linear_block_in_discrete_and_in_continuous_time():
    for parts in ({"linear"}, {"continuous"}):
        rule = replace(unit_static_gain(), parts=frozenset(parts))
        assert rule.governs("linear") and rule.governs("continuous") and not rule.governs("nonlinearity")


def test_what_does_not_depend_on_the_factor_is_named_and_allowed(refusals):
    system = WIENER.replace("NONLINEARITY", "chen_type_3").replace("B", "[0, 2]")
    estimator = f"{{kind: iterative_wiener, nonlinearity: {{kind: four_segment}}, {HORIZONS}}}"
    (refused,) = refusals(continuous(system, estimator))
    assert "score what does not depend on it (validation_error, linear_percent_error)" in refused
    assert "'up_to: [gain, sign]' under it" in refused
    steps = "{kind: multistep, switching_time: 1, std: 1}"
    for metric in (
        f"{{kind: validation_error, samples: 100, excitation: {steps}}}",
        "{kind: value, of: [b_0]}",
        f"{CURVE[:-1]}, up_to: [gain, sign]}}",
    ):
        assert refusals(continuous(system, estimator, metric)) == []


def test_named_values_have_no_factor_to_choose(refusals):
    system = WIENER.replace("NONLINEARITY", "{kind: polynomial, coefficients: [0, 0, 1]}").replace("B", "[2]")
    estimator = f"{{kind: iterative_wiener, nonlinearity: {{kind: four_segment}}, {HORIZONS}}}"
    (refused,) = refusals(continuous(system, estimator, "{kind: error, of: [b_0]}"))
    assert (
        "the system's nonlinearity has the slope 0 at zero, which no factor makes 1, score what does not "
        "depend on it (validation_error, linear_percent_error), compare the values as they are written by "
        "'up_to: []' under it, or limit"
    ) in refused
    assert refusals(continuous(system, estimator, "{kind: error, of: [b_0], up_to: []}")) == []
    (chosen,) = refusals(
        continuous(system, estimator, "{kind: percent_error, of: [a_1], up_to: [gain, delay]}")
    )
    assert chosen.endswith(
        "metrics.m.up_to: this metric can choose no gain or delay (allowed: [], the values as they are "
        "written) (got ['gain', 'delay'])"
    )


def test_a_known_nonlinearity_fixes_the_factor(refusals):
    def found(known):
        estimator = f"{{kind: known_nonlinearity, lags: 2, nonlinearity: {known}}}"
        return refusals(discrete(hammerstein("[0, 3, 1]"), estimator, "{kind: error, of: [b_1]}"))

    assert found("{kind: polynomial, coefficients: [0, 1, 0.5]}") == []
    assert found("{kind: polynomial, coefficients: [0, 2, 1]}") == []
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


def test_two_linear_blocks_have_a_factor_each(plan_of):
    for one, two in (("2", "3"), ("1", "1"), ("-1", "1")):
        (unit,) = plan_of(BLOCKS.replace("b: [2]", f"b: [{one}]").replace("b: [3]", f"b: [{two}]")).units
        assert scored(unit, "m") < 1e-12


def test_a_block_without_static_gain_is_refused(refusals):
    (found,) = refusals(BLOCKS.replace("a: [1], b: [2]", "a: [1, 1], b: [0, 2]"))
    assert "fixes it by the rule 'static gain 1'; the system's input block has no static gain" in found


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
    mise = "{kind: mise, interval: [-1, 1]}"
    rule = (
        "Absolute values are compared in m; "
        "the free factor between the blocks: gamma_0 = 1, a constant left open."
    )
    assert list(scoring(plan_of(discrete(hammerstein("[1]"), kernel, mise)))) == [
        rule,
        "Metric m: up to a constant, which the method leaves open (e).",
    ]
    assert list(scoring(plan_of(discrete(hammerstein("[2]"), kernel)))) == [
        rule,
        "The truth is brought to that form: linear block divided by 2 at the system's own delay (e).",
        "Metric m: up to a constant, which the method leaves open (e).",
    ]
    for up_to, said in (
        ("[]", "as written"),
        (
            "[constant, sign, gain]",
            "up to a factor of either sign and a constant, whichever fits the truth best",
        ),
    ):
        plan = plan_of(discrete(hammerstein("[2]"), kernel, f"{CURVE[:-1]}, up_to: {up_to}}}"))
        assert list(scoring(plan)) == [f"Metric m: {said}."]
    for up_to, said in (("[sign]", "the sign"), ("[constant]", "a constant")):
        plan = plan_of(discrete(hammerstein("[2]"), kernel, f"{CURVE[:-1]}, up_to: {up_to}}}"))
        assert list(scoring(plan)) == [
            rule,
            "The truth is brought to that form: linear block divided by 2 at the system's own delay (e).",
            *(
                [
                    "Metric m: a constant counts, which the method leaves open, unless "
                    "'up_to: [sign, constant]' is written (e)."
                ]
                if up_to == "[sign]"
                else []
            ),
            f"Metric m: up to {said}, whichever fits the truth best.",
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


def test_a_model_without_feedback_is_normalised_by_the_impulse_response():
    """The length of b is that of what it estimates, though the system has one numerator coefficient."""
    system = hi.Hammerstein(nonlinearity=hi.Polynomial(coefficients=[0, 1, 0.5]), linear=hi.Ar(a=[0.8]))
    record = hi.simulate(system, hi.Iid(distribution="uniform", low=-2, high=2), 2000)
    metrics = {
        "form": hi.NonlinearityPercentError(interval=[-2, 2]),
        "impulse": hi.ImpulseResponseError(),
    }
    short = hi.TwoStage(lags=40, degree=2, delay=0)
    assert max(hi.score(hi.fit(short, record), record, short, **metrics).values()) < 0.1
    # One that has feedback holds the numerator.
    own = hi.SeparableLeastSquares(lags=1, feedback=1, degree=2, delay=0)
    assert max(hi.score(hi.fit(own, record), record, own, **metrics).values()) < 0.1


@pytest.mark.parametrize("constant", [0.0, 0.5])
@pytest.mark.parametrize("gain", [1e-7, -1e-3, 1.0, 1e5, -1e6, 1e12])
def test_the_slope_at_zero_is_the_same_in_any_unit(gain, constant):
    """The nonlinearity of a Wiener system, g u + 0.5 (g u)^2, in the unit of its argument that g says."""
    curve = hi.Polynomial(coefficients=[constant, gain, 0.5 * gain**2])
    system = hi.Wiener(linear=hi.Fir(b=[1.0 / gain]), nonlinearity=curve)
    factors = unit_slope("f_1 = 1", "b").factors(system.truth(), None) or {}
    assert list(factors) == ["nonlinearity"]
    assert factors["nonlinearity"] == pytest.approx(gain, rel=1e-5)


@pytest.mark.parametrize("gain", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize(
    ("curve", "slope"),
    [("(g*u)**2", "0"), ("1+(g*u)**2", "0"), ("sqrt(abs(g*u))", "inf"), ("floor(abs(u)/9)", "0")],
)
def test_a_function_without_slope_at_zero_is_refused_in_any_unit(curve, slope, gain):
    curve = hi.Expression(expression=curve.replace("g", f"{gain!r}"))
    system = hi.Wiener(linear=hi.Fir(b=[1.0]), nonlinearity=curve)
    with pytest.raises(ValueError, match=f"has the slope {slope} at zero"):
        unit_slope("f_1 = 1", "b").factors(system.truth(), None)


CUBIC = "{kind: polynomial, coefficients: [0, 1, 0.5]}"
WITH_FEEDBACK = (
    f"{{kind: hammerstein, nonlinearity: {CUBIC}, linear: {{kind: arma, a: [0.5], b: [0, 2, 1]}}}}"
)
WITHOUT = hammerstein("[0, 2, 1]")
TWO_STAGE = "{kind: two_stage, lags: 3, degree: 2}"
OWN_BASIS = "{kind: two_stage, lags: 2, basis: [abs, identity]}"
SEPARABLE = "{kind: separable_least_squares, lags: 2, degree: 2, feedback: 1}"
FEEDBACK_FREE = (
    "{kind: prediction_error, blocks: [{kind: polynomial, degree: 2}, {kind: linear, nb: 3, nf: 0, nk: 1}]}"
)
VOROS = "{kind: voros_hammerstein, n: 1, m: 2, degree: 2}"


@pytest.mark.parametrize("kind", ["error", "percent_error"])
@pytest.mark.parametrize(
    ("system", "estimator", "value", "one", "other"),
    [
        (WITH_FEEDBACK, TWO_STAGE, "a_1", "the nonlinearity's powers", "a discrete block's feedback"),
        (
            WITH_FEEDBACK,
            TWO_STAGE,
            "b_2",
            "a discrete block's impulse response",
            "a discrete block's numerator",
        ),
        (WITH_FEEDBACK, FEEDBACK_FREE, "b_2", "a discrete block's impulse", "a discrete block's numerator"),
        (WITHOUT, VOROS, "a_1", "a discrete block's feedback", "the nonlinearity's powers"),
        (WITHOUT, SEPARABLE, "a_1", "a discrete block's feedback", "the nonlinearity's powers"),
        (WITHOUT, OWN_BASIS, "a_1", "the nonlinearity's own basis functions", "the nonlinearity's powers"),
    ],
)
def test_values_of_one_name_that_are_different_quantities_are_refused(
    refusals, system, estimator, value, one, other, kind
):
    (message,) = refusals(discrete(system, estimator, f"{{kind: {kind}, of: [{value}]}}"))
    kept = rf"\({value}: \w+ of {one}.* in the estimate, \w+ of {other}.* in the system\)"
    assert re.search(rf"have one name and are different quantities with estimator 'e' .*{kept}", message)
    assert "score the impulse response (impulse_response_error) or the nonlinearity" in message


@pytest.mark.parametrize(
    ("system", "estimator", "value"),
    [
        (WITH_FEEDBACK, TWO_STAGE, "b_1"),  # The first value of the impulse response.
        (WITH_FEEDBACK, SEPARABLE, "a_1"),
        (WITH_FEEDBACK, SEPARABLE, "c_2"),
        (WITH_FEEDBACK, VOROS, "b_2"),
        (WITHOUT, VOROS, "b_2"),
        (WITHOUT, TWO_STAGE, "a_2"),
        (WITHOUT, OWN_BASIS, "b_2"),
        (WITHOUT, OWN_BASIS.replace("abs, identity", "identity, {kind: power, exponent: 2}"), "a_2"),
    ],
)
def test_values_that_are_one_quantity_are_compared(refusals, system, estimator, value):
    assert refusals(discrete(system, estimator, f"{{kind: error, of: [{value}]}}")) == []


def test_a_discrete_method_s_values_are_not_those_of_a_continuous_block(refusals):
    system = "{kind: hammerstein, nonlinearity: identity, linear: {kind: continuous, a: [3, 2], b: [1]}}"
    (message,) = refusals(continuous(system, VOROS, "{kind: error, of: [a_1]}"))
    assert "feedback in the estimate, coefficients of a continuous block's denominator in the sys" in message


def test_of_all_leaves_out_values_that_are_different_quantities(plan_of):
    plan = plan_of(discrete(WITH_FEEDBACK, TWO_STAGE, "{kind: error, of: all}"))
    assert plan.units[0].metrics["m"].labels("m") == ("m b_1",)
    plan = plan_of(discrete(WITH_FEEDBACK, SEPARABLE, "{kind: error, of: all}"))
    assert plan.units[0].metrics["m"].labels("m") == ("m a_1", "m b_1", "m b_2", "m c_1", "m c_2")


def test_a_score_from_python_with_the_estimator_is_refused_too():
    system = hi.Hammerstein(nonlinearity="identity", linear=hi.Arma(a=[0.5], b=[0, 2, 1]))
    record = hi.simulate(system, hi.Iid(distribution="uniform", low=-2, high=2), 500)
    two_stage = hi.TwoStage(lags=3, degree=1)
    with pytest.raises(hi.ConfigError, match="have one name and are different quantities"):
        hi.score(hi.fit(two_stage, record), record, two_stage, a=hi.Error(of=["a_1"]))


class _Unsaid(EstimatorSpec):
    """Feedback by least squares, without a word on what a_1 is."""

    def names(self):
        return ["a_1"]

    def fit(self, record, rng=None):
        return Estimate(values={"a_1": hi.fit(hi.LeastSquares(order=1), record).values["a_1"]})


@pytest.fixture
def unsaid():
    component("estimator", "unsaid")(
        type("Unsaid", (_Unsaid,), {"__module__": __name__, "__doc__": "A sum."})
    )
    return "{kind: unsaid}"


@pytest.mark.parametrize("metric", ["error", "value"])
def test_what_an_estimator_does_not_say_stands_beside_the_system_s_with_a_word(plan_of, unsaid, metric):
    """A plugin of old: its a_1 may be the coefficient of u, which the system's is not."""
    plan = plan_of(discrete(WITH_FEEDBACK, unsaid, f"{{kind: {metric}, of: [a_1]}}"))
    assert [said for said in scoring(plan) if "a_1" in said] == [
        "Metric m: compared by name alone, as 'letters' does not say what they are: a_1 of e with the system."
    ]
    # Where there is no place for a word, as in a figure, there is no truth either.
    assert "a_1" not in plan.units[0].truth().values
    assert plan.units[0].truth().values["b_1"] == 2.0


def _beside(*estimators, of="a_1"):
    text = discrete(hammerstein("[0, 2, 1]", "abs"), "NONE", f"{{kind: value, of: [{of}]}}")
    return text.replace("  e: NONE\n", "".join(f"  e{i}: {one}\n" for i, one in enumerate(estimators)))


def test_values_of_one_name_stand_beside_each_other_with_a_word_where_they_may_differ(plan_of, unsaid):
    voros, arx = VOROS, "{kind: least_squares, order: 1}"
    feedback, powers = (
        "coefficients of a discrete block's feedback",
        "coefficients of the nonlinearity's powers",
    )
    by_name = "compared by name alone, as 'letters' does not say what they are: a_1 of"
    several = f"several quantities have one name: a_1: {feedback} (e0); {powers} (e1)."
    for estimators, said in (
        ((voros, arx), []),
        ((voros, TWO_STAGE), [several]),
        ((unsaid,), []),
        ((arx, unsaid), [f"{by_name} e1 with e0."]),
        ((unsaid, unsaid), [f"{by_name} e0, e1."]),
        ((voros, TWO_STAGE, unsaid), [several, f"{by_name} e2 with e0, e1."]),
    ):
        plan = plan_of(_beside(*estimators))
        assert list(scoring(plan)) == [f"Metric m: {one}" for one in said]


def test_a_figure_of_values_has_the_line_of_the_truth_only_if_it_is_one_for_all(plan_of):
    figure = "figures: {f: {kind: parameters, metric: m, of: [b_1], estimators: [e0, e1]}}\n"
    for second, shown in (("{kind: voros_hammerstein, n: 1, m: 2, degree: 3}", True), (TWO_STAGE, False)):
        plan = plan_of(_beside(VOROS, second, of="b_1") + figure)
        spec = plan.experiment.figures["f"]
        assert isinstance(spec, FigureSpec)
        (axes, *_) = spec.drawn(run(plan), ()).axes
        assert ("truth" in axes.get_legend_handles_labels()[1]) == shown
