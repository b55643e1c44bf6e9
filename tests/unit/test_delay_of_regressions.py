"""The delay of kernel and series estimators: given or searched for, in every experiment by itself."""

import re
from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.signal import lfilter

import hident as hi
from hident.engine.runner import run
from hident.estimators.nonparametric.delay import _by_chance, delayed, late, search_delay, unexplained
from hident.metrics.base import MetricSpec
from hident.records import Held, Part, Record, Truth
from tests.documented import ROOT
from tests.unit.plans import planned, refusals

BANDWIDTH = {"h0": 0.5, "alpha": 0.2}
POINTS = np.linspace(-0.8, 0.8, 9)
IID = hi.Iid(distribution="uniform", low=-1, high=1)


def kernel(**fields):
    return hi.Kernel(kernel="epanechnikov", bandwidth=BANDWIDTH, **fields)


def series(**fields):
    basis = hi.Legendre(interval=[-1, 1])
    return hi.Orthogonal(basis=basis, terms={"q0": 3, "alpha": 0}, **fields)


def record(b, a=(), samples=400, nonlinearity="abs", noise=()):
    linear = hi.Arma(a=list(a), b=b) if a else hi.Fir(b=b)
    system = hi.Hammerstein(nonlinearity=nonlinearity, linear=linear)
    return hi.simulate(system, IID, samples, noise=noise)


BOTH = pytest.mark.parametrize("estimator", [kernel, series])
PREFILTERS = {
    "none": (None, ()),
    "least squares": (hi.LeastSquares(order=1), (0.6,)),
    "instruments": (hi.InstrumentalVariables(order=1, instrument="abs"), (0.6,)),
    "known": (hi.KnownDynamics(a=[0.6]), (0.6,)),
}
each_prefilter = pytest.mark.parametrize(("prefilter", "a"), PREFILTERS.values(), ids=PREFILTERS)


@BOTH
@each_prefilter
@pytest.mark.parametrize("delay", [1, 3])
def test_it_is_the_estimate_from_the_pairs_moved_by_the_delay(estimator, prefilter, a, delay):
    made = record([0.0] * delay + [1.0], a)
    found = estimator(prefilter=prefilter, delay=delay).fit(made)
    pairs = Record(made.u[:-delay], made.y[delay:])
    plain = estimator(prefilter=prefilter).fit(pairs)
    np.testing.assert_array_equal(found.nonlinearity(POINTS), plain.nonlinearity(POINTS))
    np.testing.assert_array_equal(found.left_out(-0.5, 0.5), plain.left_out(-0.5, 0.5))
    assert found.values["delay"] == delay
    if prefilter is not None:
        assert found.linear == replace(plain.linear, b=(0.0,) * delay + plain.linear.b)
        assert found.values["a_1"] == plain.values["a_1"]


@BOTH
@each_prefilter
def test_a_search_finds_the_delay_and_gives_what_it_gives_when_given(estimator, prefilter, a):
    made = record([0.0, 0.0, 1.0], a, noise=hi.White(std=0.1))
    searched = estimator(prefilter=prefilter, delay="search", largest_delay=6)
    found = searched.fit(made)
    given = estimator(prefilter=prefilter, delay=2).fit(made)
    assert found.values["delay"] == 2.0
    assert found.linear == given.linear
    np.testing.assert_array_equal(found.nonlinearity(POINTS), given.nonlinearity(POINTS))
    search = found.details["delay"]
    assert (search.chosen, search.unexplained.shape) == (2, (7,))
    # What the noise of variance .01 leaves, and the other delays explain nothing but by chance.
    assert search.unexplained[2] < 0.2
    assert min(np.delete(search.unexplained, 2)) > 0.8


def test_a_block_without_delay_is_found_to_have_none():
    made = record([1.0, 0.3])
    found = kernel(delay="search").fit(made)
    assert found.values == {"delay": 0.0}
    np.testing.assert_array_equal(found.nonlinearity(POINTS), kernel().fit(made).nonlinearity(POINTS))


def test_without_the_field_nothing_changes():
    made, plain = record([1.0], (0.5,)), kernel(prefilter=hi.LeastSquares(order=1))
    found = plain.fit(made)
    assert list(found.values) == list(plain.names()) == ["a_1", "c"]
    assert plain.takes_experiments() == "at_one_interval"
    assert kernel().takes_experiments() == "any"
    assert kernel(delay=1).takes_experiments() == "at_one_interval"


@pytest.mark.parametrize("delay", [2, "search"])
def test_no_pair_reaches_from_one_experiment_into_another(delay):
    rng = np.random.default_rng(3)
    u = rng.uniform(-1, 1, 300)
    lengths = (100, 2, 198)
    waveform, parts, start, y = Held(np.zeros(1), np.zeros(1)), {}, 0, []
    for name, length in zip("abc", lengths, strict=True):
        parts[name] = Part(start, start + length, 1.0, waveform)
        # Each begins at a level of its own, which no other one may see.
        y.append(np.concatenate((np.full(min(2, length), 1e6), np.abs(u[start : start + length - 2]))))
        start += length
    made = Record(u, np.concatenate(y), parts=parts)
    found = kernel(delay=delay, **({"largest_delay": 5} if delay == "search" else {})).fit(made)
    pairs = [part.samples for part in parts.values() if len(part) > 2]
    moved = Record(
        np.concatenate([u[part][:-2] for part in pairs]), np.concatenate([made.y[part][2:] for part in pairs])
    )
    np.testing.assert_array_equal(found.nonlinearity(POINTS), kernel().fit(moved).nonlinearity(POINTS))
    later = delayed(made, 2)
    assert [(name, part.start, part.stop) for name, part in later.parts.items()] == [
        ("a", 0, 98),
        ("c", 98, 294),
    ]


def test_ties_go_to_the_shortest_delay_whatever_the_last_bit():
    # The binary input repeats after 7 samples, so that delays that differ by 7 explain the same.
    u = hi.Prbs(order=3).sample(280, 1.0, np.random.default_rng(4))
    y = np.roll(u, 2) + 0.1 * np.random.default_rng(5).normal(size=280)
    for seed in range(5):
        moved = np.where(np.random.default_rng(seed).random(len(y)) < 0.5, np.nextafter(y, 0.0), y)
        assert kernel(delay="search", largest_delay=12).fit(Record(u, moved)).values["delay"] == 2.0


def test_the_regressogram_knows_the_variance_that_is_left():
    rng = np.random.default_rng(5)
    u = rng.uniform(-1, 1, 20_000)
    y = u + rng.normal(scale=np.sqrt(1 / 3), size=len(u))
    # Half of the variance is noise, of which 141 means take 141 of 20 000.
    assert unexplained(u, y) == pytest.approx(0.5, abs=0.02)
    assert unexplained(u, np.full(len(u), 2.0)) == 1.0
    assert unexplained(np.full(100, 2.0), y[:100]) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    ("delay", "b", "factor"), [(2, [0, 0, 4, 1], 4.0), ("search", [0, 0, 4, 1], 4.0), (0, [0.5, 1], 0.5)]
)
@pytest.mark.parametrize("prefilter", [None, hi.LeastSquares(order=1)])
def test_the_rule_is_that_of_the_coefficient_at_the_delay(delay, b, factor, prefilter):
    system = hi.Hammerstein(nonlinearity="abs", linear=hi.Arma(a=[0.5], b=b))
    (rule,) = kernel(prefilter=prefilter, delay=delay).normalisations()
    assert rule.factors(system.truth(), None) == {"linear": factor}
    counted = {2: ", lags counted from the delay 2", "search": ", lags counted from the delay found", 0: ""}[
        delay
    ]
    assert rule.rule == ("b_0 = 1" if prefilter else "gamma_0 = 1, a constant left open") + counted


def test_a_delay_beyond_the_system_s_own_fixes_the_impulse_response_there():
    system = hi.Hammerstein(nonlinearity="abs", linear=hi.Ar(a=[0.5], b0=3))
    (plain,) = kernel(delay=2).normalisations()
    assert plain.factors(system.truth(), None) == {"linear": 0.75}
    made = record([3.0], (0.5,), samples=4000)
    moved = np.ptp(kernel(delay=2).fit(made).nonlinearity(np.array([0.1, 0.9])))
    assert moved == pytest.approx(0.75 * 0.8, rel=0.1)


@pytest.mark.parametrize("delay", [0, 2])
@pytest.mark.parametrize("prefilter", [None, hi.LeastSquares(order=1)])
def test_another_delay_than_the_system_s_is_told_with_the_remedy(delay, prefilter):
    system = hi.Hammerstein(nonlinearity="abs", linear=hi.Fir(b=[0, 1]))
    (rule,) = kernel(prefilter=prefilter, delay=delay).normalisations()
    message = (
        f"the system's block delays its input by 1 sample, and the estimator counts on {delay}: "
        "set the estimator's 'delay' to 1, or to search"
    )
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        rule.factors(system.truth(), None)


def test_a_held_continuous_block_delays_by_a_sample():
    system = hi.Hammerstein(nonlinearity="abs", linear=hi.Continuous(a=[0.05]))
    (rule,) = kernel(delay=1).normalisations()
    (factor,) = (rule.factors(system.truth(), 1.0) or {}).values()
    assert factor == pytest.approx(1.0, abs=1e-8)
    record = hi.simulate(system, IID, 400, dt=1.0)
    found = hi.fit(kernel(delay="search"), record)
    assert found.values["delay"] == 1.0
    assert found.nonlinearity is not None
    np.testing.assert_allclose(found.nonlinearity(np.array([-0.6, 0.6])), 0.6, atol=0.05)


def test_coefficients_are_named_by_their_lag():
    prefilter = hi.InstrumentalVariables(order=1, instrument="abs", ma_order=1)
    made = record([0, 0, 1, 0.4], (0.5,), samples=20_000)
    given = kernel(prefilter=prefilter, delay=2)
    values = given.fit(made).values
    assert list(values) == list(given.names()) == ["a_1", "b_3", "c", "delay"]
    assert values["b_3"] == pytest.approx(0.4, abs=0.05)
    # Where the lag is not known before the fit, there is no name.
    searched = kernel(prefilter=prefilter, delay="search")
    assert list(searched.names()) == ["a_1", "c", "delay"]
    assert {f"value {name}" for name in searched.names()} < searched.provides()


CONFIGURATION = """\
version: 1
title: Behind a delay
trials: 2
samples: 300
system: {kind: hammerstein, nonlinearity: abs, linear: {kind: fir, b: [0, 1]}}
excitation: {kind: iid, distribution: uniform, low: -1, high: 1}
noise: {kind: white, std: 0.05}
estimators:
  kernel: {kind: kernel, kernel: gaussian, bandwidth: {h0: 0.2, alpha: 1/5}, delay: DELAY}
metrics:
  nonlinearity: {kind: nonlinearity_percent_error, interval: [-0.9, 0.9]}
  delay: {kind: value, of: [delay]}
"""


@pytest.mark.parametrize("delay", ["1", "search"])
def test_a_configuration_with_a_delay_runs(tmp_path, delay):
    plan = planned(tmp_path, CONFIGURATION.replace("DELAY", delay))
    table = hi.run(plan.document.data).frame()
    means = {row["metric"]: row["mean"] for row in table.to_dict("records")}
    assert means["delay delay"] == 1.0
    assert means["nonlinearity"] < 10


@pytest.mark.parametrize(
    ("delay", "message"),
    [
        ("-1", "must be a whole number of samples, 0 or more, or 'search', not -1"),
        ("0.5", "must be a whole number of samples, 0 or more, or 'search', not 0.5"),
        ("true", "must be a whole number of samples, 0 or more, or 'search', not True"),
        ("find", "must be a whole number of samples, 0 or more, or 'search', not 'find'"),
    ],
)
def test_what_is_no_delay_is_refused(tmp_path, delay, message):
    (line,) = refusals(tmp_path, CONFIGURATION.replace("DELAY", delay))
    assert line.startswith(f"a.yaml:9: estimators.kernel.delay: {message}")


def test_a_largest_delay_belongs_to_a_search(tmp_path):
    with pytest.raises(hi.ConfigError, match="only 'delay: search' takes largest_delay"):
        kernel(delay=2, largest_delay=5)
    with pytest.raises(ValidationError):
        hi.Kernel.model_validate({"kernel": "gaussian", "bandwidth": BANDWIDTH, "largest_delay": 5})


def test_records_that_are_too_short_are_refused():
    assert kernel(delay=7).fewest_samples() == 8
    assert kernel(delay="search").fewest_samples() == 14
    assert kernel(delay=7, prefilter=hi.LeastSquares(order=2)).fewest_samples() == 13
    short = Record(np.arange(5.0), np.arange(5.0))
    with pytest.raises(hi.EstimationError, match=r"^no experiment holds more than the 5 samples that the d"):
        kernel(delay=5).fit(short)


def test_a_search_in_which_no_delay_can_be_judged_says_why():
    def refused(delay, first):
        raise hi.EstimationError(f"not with {delay}")

    message = "no delay from 0 to 3 can be judged (the last: not with 3)"
    with pytest.raises(hi.EstimationError, match=f"^{re.escape(message)}$"):
        search_delay(refused, 3)


def test_a_prefilter_whose_block_delays_names_the_remedy():
    made = record([0, 1], (0.5,))
    with pytest.raises(hi.EstimationError, match=r"give their number as 'delay' of the estimator$"):
        kernel(prefilter=hi.KnownDynamics(a=[0.5], b=[0, 1])).fit(made)


@each_prefilter
def test_errors_stand_where_the_output_has_them(prefilter, a):
    made = record([0.0, 0.0, 3.0], a, noise=hi.White(std=0.01))
    estimator = kernel(prefilter=prefilter, delay="search")
    found = estimator.fit(made)
    errors = estimator.errors(found, made)
    dropped = 2 + len(a)
    assert np.all(np.isnan(errors[:dropped]))
    predicted = found.nonlinearity(made.u[dropped - 2 : -2])
    if a:
        predicted = predicted + found.values["a_1"] * made.y[dropped - 1 : -1]
    np.testing.assert_allclose(errors[dropped:], made.y[dropped:] - predicted, atol=1e-12)
    left_out = estimator.left_out_errors(found, made)
    assert np.all(np.isnan(left_out[:dropped]))
    # Without its own sample an estimate is farther from it.
    assert np.mean(left_out[dropped:] ** 2) > np.mean(errors[dropped:] ** 2)


def test_a_delay_may_be_one_of_the_settings_that_the_data_choose():
    made = record([0.0, 1.0], noise=hi.White(std=0.05))
    settings = {"kind": "kernel", "kernel": "gaussian", "bandwidth": BANDWIDTH}
    for by in ("leave_one_out", "cross_validation"):
        found = hi.fit(hi.Select(by=by, over={"delay": [1, 2, 3]}, estimator=settings), made)
        assert found.values["selected delay"] == 1.0


def _behind(delay, n, nsr=0.1, trial=0, a=0.5):
    system = hi.Hammerstein(
        nonlinearity=hi.Polynomial(coefficients=[0, 1, 0.5]),
        linear=hi.Arma(b=[*[0] * delay, 1], a=[a]),
    )
    noise = hi.White(nsr=nsr)
    return hi.simulate(system, hi.Iid(distribution="uniform", low=-2, high=2), n, noise=noise, trial=trial)


class TestLeftOut:
    """Without a word on the delay it is 0, unless the newest input says nothing and an earlier one does."""

    @pytest.mark.parametrize("delay", [1, 3, 10])
    def test_a_late_block_is_noticed(self, delay):
        record = _behind(delay, 400)
        found, given = hi.fit(kernel(), record), hi.fit(kernel(delay=delay), record)
        u = np.linspace(-1.5, 1.5, 20)
        assert found.nonlinearity is not None
        assert given.nonlinearity is not None
        np.testing.assert_array_equal(found.nonlinearity(u), given.nonlinearity(u))
        assert found.values == {}

    def test_a_block_that_is_not_late_is_taken_as_it_is(self):
        u = np.linspace(-1.5, 1.5, 20)
        for trial in range(100):
            # The block remembers most of its output, and noise hides what the newest input does.
            record = _behind(0, 50, nsr=0.5, trial=trial, a=0.9)
            found, given = hi.fit(kernel(), record), hi.fit(kernel(delay=0), record)
            assert found.nonlinearity is not None
            assert given.nonlinearity is not None
            np.testing.assert_array_equal(found.nonlinearity(u), given.nonlinearity(u))

    def test_noise_alone_is_no_reason(self):
        for seed in range(200):
            rng = np.random.default_rng(seed)
            assert late(hi.Record(rng.uniform(-1, 1, 200), rng.standard_normal(200)), 10) == 0

    def test_the_chance_of_a_dependence_is_uniform_without_one(self):
        chances = []
        for seed in range(1000):
            rng = np.random.default_rng(seed)
            chances.append(_by_chance(rng.uniform(-1, 1, 100), rng.standard_normal(100)))
        for level in (0.01, 0.1, 0.5):
            share = np.mean(np.array(chances) < level)
            assert abs(share - level) < 4.0 * np.sqrt(level * (1.0 - level) / 1000)

    def test_experiments_of_other_intervals_have_no_lags(self):
        u = np.random.default_rng(1).uniform(-1, 1, 400)
        wave = Held(np.zeros(1), np.zeros(1))
        for intervals, expected in (((1.0, 1.0), 1), ((1.0, 0.5), 0)):
            places = ((0, 200), (200, 400))
            parts = {
                f"{start}": Part(start, stop, dt, wave)
                for (start, stop), dt in zip(places, intervals, strict=True)
            }
            assert late(Record(u, np.roll(u, 1), 1.0, parts=parts), 10) == expected


@pytest.mark.parametrize("prefilter", [None, hi.KnownDynamics(a=[0.5])])
@pytest.mark.parametrize("delay", ["search", None])
def test_an_absolute_score_is_at_the_delay_that_was_found(prefilter, delay):
    """The system's first coefficient is small, and the estimate that of the larger one behind it."""
    if prefilter is not None and delay is None:
        pytest.skip("a prefilter takes no delay that was not asked for")
    system = hi.Hammerstein(
        nonlinearity=hi.Polynomial(coefficients=[0, 1, 0.5]), linear=hi.Arma(a=[0.5], b=[0, 0.02, 1])
    )
    made = hi.simulate(system, IID, 3000)
    own, given = kernel(prefilter=prefilter, delay=delay), kernel(prefilter=prefilter, delay=2)
    metrics: dict[str, MetricSpec] = {"n": hi.NonlinearityPercentError(interval=[-0.8, 0.8])}
    if prefilter is not None:
        metrics["b"] = hi.ImpulseResponseError()
    found = hi.fit(own, made)
    assert hi.score(found, made, own, **metrics) == hi.score(hi.fit(given, made), made, given, **metrics)
    (rule,) = own.normalisations()
    assert rule.factors(system.truth(), None) == {"linear": 0.02}


@pytest.mark.parametrize(
    ("b", "said"), [([0, 0, 1], True), ([0.1, 1], True), ([1, 0.5], False), ([1, 1.3], False)]
)
def test_the_rule_says_where_an_earlier_input_is_taken(b, said):
    """Without a word on the delay: lags count from the one that is noticed, which is another one's gamma."""
    system = hi.Hammerstein(nonlinearity="abs", linear=hi.Fir(b=b))
    (rule,) = kernel().normalisations()
    counted = ", lags counted from the delay found" if said else ""
    assert rule.said(system.truth(), None) == f"gamma_0 = 1, a constant left open{counted}"
    assert rule.said(Truth(), None) == "gamma_0 = 1, a constant left open"


def test_a_delay_at_which_the_system_gives_nothing_is_scored_by_the_system_s_own():
    """What was found is wrong, and its score says how much."""
    system = hi.Hammerstein(nonlinearity="abs", linear=hi.Fir(b=[0, 4]))
    (rule,) = kernel(delay="search").normalisations()
    assert rule.of(hi.Estimate(values={"delay": 3.0})).factors(system.truth(), None) == {"linear": 4.0}


@pytest.mark.parametrize("delay", ["search", 2])
def test_a_run_scores_a_search_as_the_delay_that_it_finds(tmp_path, delay):
    text = f"""\
version: 1
title: A small coefficient before the larger one
trials: 2
samples: 400
system:
  kind: hammerstein
  nonlinearity: {{kind: polynomial, coefficients: [0, 1, 0.5]}}
  linear: {{kind: arma, a: [0.5], b: [0, 0.1, 1]}}
excitation: {{kind: iid, distribution: uniform, low: -1, high: 1}}
estimators:
  k:
    kind: kernel
    kernel: gaussian
    bandwidth: {{h0: 0.3, alpha: 1/5}}
    prefilter: {{kind: known_dynamics, a: [0.5]}}
    delay: {delay}
metrics:
  m: {{kind: mise, interval: [-0.9, 0.9]}}
"""
    (series,) = run(planned(tmp_path, text)).series
    assert series.value("mean") < 0.01


def _signal(rng, n, pole):
    return lfilter([1.0], [1.0, -pole], rng.standard_normal(n + 300))[300:]


def _measured(u, delay, pole, noise, rng):
    """The output behind a quadratic and a pole, which moved before the record too, with noise as ``nsr``."""
    before = rng.choice(u, 300)
    driven = np.concatenate((before, u))
    y = lfilter([0.0] * delay + [1.0], [1.0, -pole], driven + 0.5 * driven**2)[300:]
    return y + noise / np.sqrt(1.0 - noise**2) * np.std(y) * rng.standard_normal(len(u))


class TestBeyondReach:
    """A search whose true delay lies behind its largest one takes none by chance without a word."""

    NONE = (
        r"^the output depends on no input of 0 to 10 samples before by more than chance makes \(p = "
        r"0\.\d+ at \d+, which tells most of it\): raise 'largest_delay', or give the 'delay'$"
    )
    MORE = (
        "the output depends more on the input of 11 samples before than on any of 0 to 10: raise "
        "'largest_delay', or give the 'delay'"
    )

    @BOTH
    @each_prefilter
    def test_of_independent_inputs_none_explains_anything(self, estimator, prefilter, a):
        made = record([0.0] * 14 + [1.0], a)
        with pytest.raises(hi.EstimationError, match=self.NONE):
            estimator(prefilter=prefilter, delay="search").fit(made)
        found = estimator(prefilter=prefilter, delay="search", largest_delay=14).fit(made)
        assert found.values["delay"] == 14.0

    def test_of_inputs_that_are_alike_the_next_one_explains_more(self):
        rng = np.random.default_rng(3)
        u = _signal(rng, 400, 0.9)
        made = Record(u[12:], u[:-12] + 0.1 * rng.standard_normal(388))
        with pytest.raises(hi.EstimationError, match=f"^{re.escape(self.MORE)}$"):
            kernel(delay="search").fit(made)
        assert kernel(delay="search", largest_delay=12).fit(made).values["delay"] == 12.0

    @pytest.mark.parametrize("period", [37, 50])
    def test_a_periodic_input_has_a_delay_as_any_other(self, period):
        """Of shifts by whole periods the output depends as it does of none."""
        rng = np.random.default_rng(4)
        u = np.tile(rng.uniform(-1, 1, period), 20)
        for delay in (0, 3, 10):
            made = Record(u, np.roll(u, delay) + 0.1 * rng.standard_normal(len(u)))
            assert kernel(delay="search").fit(made).values["delay"] == delay

    @pytest.mark.parametrize(("poles", "share"), [((0.0, 0.0), 0.01), ((0.0, 0.9), 0.01), ((0.9, 0.9), 0.04)])
    def test_without_a_dependence_the_stated_share_of_records_has_a_delay(self, poles, share):
        searched, n = kernel(delay="search"), 400
        taken = 0
        for seed in range(n):
            rng = np.random.default_rng([seed, 2031])
            u, y = (_signal(rng, 120, pole) for pole in poles)
            try:
                searched.fit(Record(u, y))
            except hi.EstimationError:
                continue
            taken += 1
        assert taken <= n * share + 4.0 * np.sqrt(n * share)

    def test_a_run_counts_it_with_its_reason(self, tmp_path):
        text = CONFIGURATION.replace("DELAY", "search").replace("b: [0, 1]", f"b: {[0] * 15 + [1]}")
        results = run(planned(tmp_path, text))
        assert {series.statistics["failed"] for series in results.series} == {2.0}
        assert "raise 'largest_delay'" in results.series[0].reasons[0][0]


class TestRatesOfNoticing:
    """What docs/concepts.md and the docstring state, on other seeds than those by which it was chosen."""

    @pytest.mark.parametrize("pole_of_input", [0.0, 0.5, 0.9])
    def test_a_delay_that_is_none_is_hardly_ever_noticed(self, pole_of_input):
        """Where inputs beside each other are alike, an output of long memory tells most of an earlier one."""
        noticed = 0
        for seed in range(1000):
            rng = np.random.default_rng([seed, 2032])
            u = _signal(rng, (30, 100, 200, 500)[seed % 4], pole_of_input)
            pole = (0.5, 0.9, 0.98)[seed % 3]
            noticed += late(Record(u, _measured(u, 0, pole, (0.1, 0.5)[seed % 2], rng)), 10) > 0
        assert noticed == 0

    def test_a_delay_is_noticed_and_found_as_often_as_the_page_says(self):
        page = (ROOT / "docs" / "concepts.md").read_text(encoding="utf-8")
        rows = re.findall(r"^\| (0\.\d) \| (\d+) % \| (noticed|searched) \|(.*)\|$", page, re.M)
        assert len(rows) == 8
        lengths = [int(n) for n in re.findall(r"\d+", page.partition("| pole | noise | |")[2].split("\n")[0])]
        assert lengths == [50, 100, 200, 400, 1000]
        searched, n = kernel(delay="search"), 40
        for pole, percent, how, cells in rows:
            for length, cell in zip(lengths[:-1], cells.split("|"), strict=False):
                share, found = float(cell.strip(" %")) / 100.0, 0
                for seed in range(n):
                    rng = np.random.default_rng([seed, length, 2033])
                    u = rng.uniform(-1.0, 1.0, length)
                    made = Record(u, _measured(u, 3, float(pole), float(percent) / 100.0, rng))
                    if how == "noticed":
                        found += late(made, 10) == 3
                        continue
                    try:
                        found += searched.fit(made).values["delay"] == 3.0
                    except hi.EstimationError:
                        continue
                assert abs(found - n * share) <= 4.0 * np.sqrt(n * share * (1.0 - share)) + 2.0, (pole, cell)
