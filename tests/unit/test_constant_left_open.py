"""A constant that a method leaves open is no error of the method: by default the nearest one is taken."""

from functools import partial

import pytest

import hident as hi
from hident.engine.runner import run
from hident.reports.scoring import scoring
from tests.unit import plans

QUADRATIC = hi.Polynomial(coefficients=[0.6, 1, 0.5])
FIRST = {"n": 2, "horizon": 8}
POLYNOMIAL = {"kind": "polynomial", "degree": 2}
KERNEL = {"kernel": "gaussian", "bandwidth": {"h0": 0.3, "alpha": "1/5"}}
SERIES = {"basis": {"kind": "legendre", "interval": [-2, 2]}, "terms": {"q0": 4, "alpha": "0"}}


@pytest.fixture
def plan_of(tmp_path):
    return partial(plans.planned, tmp_path)


def _continuous():
    system = hi.Hammerstein(nonlinearity=QUADRATIC, linear=hi.Continuous(a=[1.5, 0.7]))
    steps = hi.Multistep(switching_time=1, std=1, limits=[-2, 2])
    return hi.simulate(system, steps, 1000, dt=0.1)


def _hammerstein(**changes):
    # Of a constant before the block it sees the settled response only.
    return hi.IterativeHammerstein(nonlinearity=POLYNOMIAL, first=FIRST, start=15.0, **changes)


def _errors(estimator, record, interval):
    given = {"interval": interval, "points": 512}
    return hi.score(
        hi.fit(estimator, record),
        record,
        estimator,
        mise=hi.IntegratedSquaredError(**given),
        percent=hi.NonlinearityPercentError(**given),
        absolute=hi.IntegratedSquaredError(**given, up_to=[]),
    )


@pytest.mark.parametrize(
    "estimator", [_hammerstein(constant=True), hi.OutputError(start=_hammerstein(constant=True))]
)
def test_the_constant_beside_a_continuous_hammerstein_model_is_taken_off(estimator):
    scores = _errors(estimator, _continuous(), [-1.5, 1.5])
    assert scores["mise"] < 0.01
    assert scores["percent"] < 5.0
    # As it stands, all but nothing is the constant: 3 times 0.6 squared.
    assert scores["absolute"] == pytest.approx(3 * 0.36, rel=0.1)


def test_the_constant_beside_a_continuous_wiener_model_is_taken_off():
    system = hi.Wiener(
        nonlinearity=hi.Polynomial(coefficients=[0.6, 1, 0.2]), linear=hi.Continuous(a=[1.5, 0.7])
    )
    steps = hi.Multistep(switching_time=1, std=0.7, limits=[-1, 1])
    record = hi.simulate(system, steps, 1000, dt=0.1)
    scores = _errors(
        hi.IterativeWiener(nonlinearity=POLYNOMIAL, first=FIRST, constant=True), record, [-0.8, 0.8]
    )
    assert scores["mise"] < 0.01
    assert scores["absolute"] == pytest.approx(1.6 * 0.36, rel=0.1)


@pytest.mark.parametrize("estimator", [partial(hi.Kernel, **KERNEL), partial(hi.Orthogonal, **SERIES)])
def test_the_mean_of_all_that_is_past_is_taken_off_a_regression(estimator):
    system = hi.Hammerstein(nonlinearity=QUADRATIC, linear=hi.Ar(a=[0.5]))
    record = hi.simulate(system, hi.Iid(distribution="uniform", low=-2, high=2), 20_000)
    scores = _errors(estimator(), record, [-1.5, 1.5])
    assert scores["mise"] < 0.02
    at_samples = hi.IntegratedSquaredError(interval=[-1.5, 1.5], at="samples")
    left_out = hi.IntegratedSquaredError(interval=[-1.5, 1.5], at="left_out_samples")
    found = hi.fit(estimator(), record)
    assert max(hi.score(found, record, estimator(), own=at_samples, out=left_out).values()) < 0.02
    # The mean of w is 0.6 + 2/3, and as much of it again is in the past.
    assert scores["absolute"] > 3.0
    # Where the block is undone, or a point is known, nothing is open.
    for closed in (
        {"known_point": {"u": 0, "value": 0.6}},
        {"prefilter": hi.KnownDynamics(a=[0.5])},
    ):
        scores = _errors(estimator(**closed), record, [-1.5, 1.5])
        assert scores["mise"] == scores["absolute"] < 0.02


CONFIGURATION = """\
version: 1
title: Methods that leave a constant open beside one that does not
trials: 6
samples: 300
system:
  kind: hammerstein
  nonlinearity: {kind: polynomial, coefficients: [0.6, 1, 0.5]}
  linear: {kind: ar, a: [0.5]}
excitation: {kind: iid, distribution: uniform, low: -2, high: 2}
estimators:
  plain: &kernel {kind: kernel, kernel: gaussian, bandwidth: {h0: 0.5, alpha: 1/5}}
  undone: {<<: *kernel, prefilter: {kind: known_dynamics, a: [0.5]}}
metrics:
  m: {kind: mise, interval: [-1.5, 1.5]}
"""


def test_a_table_says_which_methods_are_scored_up_to_a_constant(plan_of):
    plan = plan_of(CONFIGURATION)
    assert list(scoring(plan)) == [
        "Absolute values are compared in m; the free factor between the blocks: gamma_0 = 1, a constant left "
        "open (plain); b_0 = 1 (undone).",
        "Metric m: up to a constant, which the method leaves open (plain).",
    ]
    scores = {series.unit.name: series.value("mean") for series in run(plan).series}
    written = plan_of(CONFIGURATION, "metrics.m.up_to=[]")
    absolute = {series.unit.name: series.value("mean") for series in run(written).series}
    assert scores["undone"] == absolute["undone"]
    assert scores["plain"] < 0.5
    assert absolute["plain"] > 3.0
    assert list(scoring(written)) == ["Metric m: as written."]


THROUGH_ZERO = {
    "two-stage": "{kind: two_stage, lags: 8, degree: 2, delay: 0}",
    "separable": "{kind: separable_least_squares, lags: 1, degree: 2, feedback: 1, delay: 0}",
    "Voros": "{kind: voros_hammerstein, n: 1, m: 1, degree: 2, delay: 0}",
}
HELD = "'constant: true' estimates a constant."
NOTE = "takes it to be 0 there, which biases the estimates: 'constant: true' estimates a constant."


def _beside(estimators, metric="{kind: mise, interval: [-1.5, 1.5]}"):
    head = CONFIGURATION.split("estimators:", maxsplit=1)[0]
    named = "".join(f"  {name}: {one}\n" for name, one in estimators.items())
    return f"{head}estimators:\n{named}metrics:\n  m: {metric}\n"


def test_a_table_says_where_a_true_nonlinearity_has_a_constant_that_a_method_does_not(plan_of):
    said = [line for line in scoring(plan_of(_beside(THROUGH_ZERO))) if "at zero" in line]
    assert said == [
        "The system's nonlinearity is 0.6 at zero, and two-stage, separable, Voros "
        + NOTE.replace("takes", "take")
    ]
    text = _beside({"e": THROUGH_ZERO["two-stage"]})
    assert f"The system's nonlinearity is 0.6 at zero, and e {NOTE}" in list(scoring(plan_of(text)))
    levels = ", ".join(f"{c}: {{system.nonlinearity.coefficients: [{c}, 1]}}" for c in (0.1, 0, -2))
    axis = f"cases: {{level: {{{levels}}}}}\n"
    said = [line for line in scoring(plan_of(text + axis)) if "at zero" in line]
    assert said == [f"The system's nonlinearity is 0.1, -2 at zero, and e {NOTE}"]
    # Nothing is said where a constant is estimated, the basis holds one, or there is none.
    for one in (
        "{kind: two_stage, lags: 8, degree: 2, delay: 0, constant: true}",
        "{kind: two_stage, lags: 8, basis: [identity, {kind: power, exponent: 0}], delay: 0}",
        "{kind: kernel, kernel: gaussian, bandwidth: rule_of_thumb}",
    ):
        assert not [line for line in scoring(plan_of(_beside({"e": one}))) if "at zero" in line]
    through = text.replace("[0.6, 1, 0.5]", "[0, 1, 0.5]")
    assert not [line for line in scoring(plan_of(through)) if "at zero" in line]


@pytest.mark.parametrize(
    ("over", "when"),
    [
        ("{constant: [true, false]}", "constant {}"),
        ("{constant: [true, false], lags: [7, 8]}", "constant {}"),
        ("{constant: [true]}", ""),
    ],
)
def test_what_is_said_of_a_selection_holds_with_the_settings_that_are_named(plan_of, over, when):
    chosen = f"{{kind: select, by: bic, over: {over}, estimator: {{kind: two_stage, lags: 8, degree: 2}}}}"
    text = _beside({"e": chosen.replace("degree: 2", "degree: 2, delay: 0")})
    said = list(scoring(plan_of(text)))
    with_true = f" with {when.format('true')}: so in all trials" if when else ""
    assert f"Metric m: up to a constant, which the method leaves open{with_true} (e)." in said
    missed = [line for line in said if "at zero" in line]
    assert missed == (
        [
            "The system's nonlinearity is 0.6 at zero, and e takes it to be 0 there with constant false, "
            f"which biases the estimates: {HELD}"
        ]
        if when
        else []
    )
    counted = " ".join(scoring(plan_of(text, "metrics.m.up_to=[gain, sign]")))
    beside = f" with {when.format('true')}" if when else ""
    assert f"a constant counts, which the method leaves open{beside}, unless" in counted


def test_a_selection_whose_settings_decide_together_says_so(plan_of):
    over = "{degree: [1, 2], constant: [true, false]}"
    chosen = f"{{kind: select, by: bic, over: {over}, estimator: {{kind: two_stage, lags: 8, delay: 0}}}}"
    said = [line for line in scoring(plan_of(_beside({"e": chosen}))) if "at zero" in line]
    assert "with constant false" in said[0]
    basis = "[[identity], [identity, {kind: power, exponent: 0}]]"
    over = f"{{basis: {basis}, constant: [true, false]}}"
    chosen = f"{{kind: select, by: bic, over: {over}, estimator: {{kind: two_stage, lags: 8, delay: 0}}}}"
    said = [line for line in scoring(plan_of(_beside({"e": chosen}))) if "at zero" in line]
    assert "with some of its settings" in said[0]


COSINE = "{kind: expression, expression: cos(u)}"


def test_a_basis_that_is_not_zero_at_zero_holds_a_constant_only_in_its_span(plan_of):
    def said(basis, nonlinearity="{kind: polynomial, coefficients: [0.6, 1, 0.5]}"):
        text = _beside({"e": f"{{kind: two_stage, lags: 8, basis: [{basis}], delay: 0}}"})
        text = text.replace("{kind: polynomial, coefficients: [0.6, 1, 0.5]}", nonlinearity)
        return [line for line in scoring(plan_of(text)) if "at zero" in line]

    assert said(f"identity, {COSINE}") == [
        "The system's nonlinearity is 0.6 at zero, and e has basis functions that hold no constant, which "
        f"biases the estimates: {HELD}"
    ]
    # A sum of them is one, or the nonlinearity itself.
    assert not said(f"identity, {COSINE}, {{kind: expression, expression: 2 - cos(u)}}")
    assert not said(f"identity, {COSINE}", "{kind: expression, expression: u + 2*cos(u)}")


PEM = "{{kind: prediction_error, blocks: [{}, {{kind: linear, nb: 1, nf: 1, nk: 0}}]}}"
BLOCK = (
    "a static block that holds a constant estimates it, such as a polynomial, or an expansion with {kind: "
    "power, exponent: 0} in its basis."
)


def test_prediction_error_tells_where_no_block_holds_a_constant(plan_of):
    def said(block):
        text = _beside({"e": PEM.format(block)}, "{kind: value, of: [mse]}")
        return [line for line in scoring(plan_of(text)) if "at zero" in line]

    zero = (
        "The system's nonlinearity is 0.6 at zero, and e takes it to be 0 there, which biases the estimates"
    )
    square = "{kind: power, exponent: 2}"
    assert said(f"{{kind: expansion, basis: [identity, {square}]}}") == [f"{zero}: {BLOCK}"]
    held = "{kind: expansion, basis: [identity], held: true, start: identity, range: [-1, 1]}"
    assert said(held) == [f"{zero}: {BLOCK}"]
    assert said("{kind: linear, nb: 1, nf: 0, nk: 0}") == [f"{zero}: {BLOCK}"]
    cosine = said(f"{{kind: expansion, basis: [identity, {COSINE}]}}")
    assert cosine == [
        "The system's nonlinearity is 0.6 at zero, and e has basis functions that hold no constant, which "
        f"biases the estimates: {BLOCK}"
    ]
    for block in (
        "{kind: polynomial, degree: 2}",
        "{kind: piecewise_linear, knots: 5}",
        "{kind: cubic_spline, knots: 5}",
        "{kind: saturation}",
        "{kind: dead_zone}",
        "{kind: series, basis: {kind: trigonometric, interval: [-2, 2]}, q: 2}",
        f"{{kind: expansion, basis: [identity, {{kind: power, exponent: 0}}, {square}]}}",
    ):
        assert not said(block)


@pytest.mark.parametrize(("constant", "is_told"), [("false", True), ("true", False)])
def test_a_linear_model_with_a_constant_takes_a_system_that_has_one(plan_of, constant, is_told):
    text = """\
version: 1
title: A line with a constant
trials: 1
samples: 400
dt: 0.1
system:
  kind: hammerstein
  nonlinearity: {kind: polynomial, coefficients: [COEFFICIENTS]}
  linear: {kind: continuous, a: [2.5, 1.5]}
excitation: {kind: multistep, switching_time: 1, std: 1}
estimators:
  line: {kind: linear_model, start: 20, block: {n: 2, horizon: 8}, constant: CONSTANT}
metrics:
  m: {kind: error, of: [a_1, b_0]}
"""
    text = text.replace("CONSTANT", constant)
    if is_told:
        with pytest.raises(hi.ConfigError, match="the system's nonlinearity is not a multiple of it"):
            plan_of(text.replace("COEFFICIENTS", "5, 2"))
        return
    plan = plan_of(text.replace("COEFFICIENTS", "5, 2"))
    assert not [line for line in scoring(plan) if "at zero" in line]
    [a_1, b_0] = [one.value("mean") for one in run(plan).series]
    assert abs(a_1) < 0.05
    assert abs(b_0) < 0.05
    with pytest.raises(hi.ConfigError, match="is not a multiple of it and a constant"):
        plan_of(text.replace("COEFFICIENTS", "5, 2, 1"))


BESIDE = """\
version: 1
title: A constant beside what is written
trials: 2
samples: 100
system:
  kind: hammerstein
  nonlinearity: {kind: polynomial, coefficients: [0.6, 1, 0.5]}
  linear: {kind: fir, b: [2, 1]}
excitation: {kind: iid, distribution: uniform, low: -2, high: 2}
noise: {kind: white, std: 0.1}
estimators:
  with: {kind: two_stage, lags: 2, degree: 2, delay: 0, constant: true}
  without: {kind: two_stage, lags: 2, degree: 2, delay: 0}
metrics:
  m: {kind: mise, interval: [-1, 1]}
"""


def test_a_constant_that_is_not_written_beside_what_is_counts_and_table_md_says_so(plan_of):
    def said(*settings):
        return " ".join(scoring(plan_of(BESIDE, *settings)))

    counts = (
        "a constant counts, which the method leaves open, unless 'up_to: [gain, sign, constant]' is written"
    )
    assert f"{counts} (with)." in said("metrics.m.up_to=[gain, sign]")
    assert "counts" not in said("metrics.m.up_to=[gain, sign, constant]")
    assert "counts" not in said()


@pytest.mark.parametrize("constant", ["false", "true"])
def test_a_known_nonlinearity_without_the_constant_of_the_system_is_told(plan_of, constant):
    quadratic = "{kind: polynomial, coefficients: [0, 1, 0.5]}"
    known = f"{{kind: known_nonlinearity, lags: 2, delay: 0, nonlinearity: {quadratic}"
    only = "metrics={m: {kind: value, of: [b_0]}}"
    plan = plan_of(BESIDE, f"estimators={{known: {known}, constant: {constant}}}}}", only)
    assert ("takes it to be 0 there" in " ".join(scoring(plan))) is (constant == "false")


def test_the_values_of_a_known_nonlinearity_with_a_constant_are_compared():
    record = hi.simulate(
        hi.Hammerstein(nonlinearity=QUADRATIC, linear=hi.Fir(b=[2, 1])),
        hi.Iid(distribution="uniform", low=-2, high=2),
        300,
    )
    known = hi.Polynomial(coefficients=[0, 1, 0.5])
    estimator = hi.KnownNonlinearity(lags=2, delay=0, nonlinearity=known, constant=True)
    scores = hi.score(hi.fit(estimator, record), record, estimator, e=hi.Error(of=["b_0", "b_1"]))
    assert max(map(abs, scores.values())) < 1e-9
