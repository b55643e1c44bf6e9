"""Several experiments in one record: nothing that looks back in time reaches from one into another."""

import re

import numpy as np
import pytest

from hident import plugins
from hident.config.spec import Of, component, components
from hident.engine.preflight import check_records
from hident.engine.trial import Data, Job, estimate, generate
from hident.errors import ConfigError, EstimationError
from hident.estimators.base import EstimatorSpec
from hident.estimators.bilinear_models.ar_noise import METHODS
from hident.estimators.moving_horizon.transform.time_weighted import Horizons, Knots
from hident.estimators.nonparametric.instrumental_variables import instrumental_variables
from hident.estimators.nonparametric.least_squares import least_squares
from hident.estimators.nonparametric.prefilter import FilteredRecord, prefilter
from hident.linear_blocks import TransferFunction
from hident.metrics.disturbance import DisturbanceVariance
from hident.numerics.autoregression import ArModel
from hident.numerics.parts import following, in_each, joined, longer_than, whole
from hident.records import Estimate, Held, Part, Record
from tests.unit.plans import planned, replaced
from tests.unit.tried import tried

plugins.load()

# Without noise, and the second experiment far from the first.
TWO = """\
version: 1
title: Two experiments in one record, without noise
trials: 3
samples: 200
system:
  kind: hammerstein
  nonlinearity: {kind: polynomial, coefficients: [0, 1, 0.5]}
  linear: {kind: fir, b: [0, 0.8, 0.6]}
excitation:
  kind: experiments
  parts:
    - {name: low, samples: 100, excitation: {kind: iid, distribution: uniform, low: -1, high: 1}}
    - {name: high, samples: 100, excitation: {kind: iid, distribution: uniform, low: 4, high: 6}}
estimators:
  it: ESTIMATOR
metrics:
  theta: {kind: METRIC, of: [VALUES]}
"""
BASIS = "basis: [{kind: power, exponent: 1}, {kind: power, exponent: 2}], lags: 2, delay: 1"


def plan(folder, estimator, values="b_1, b_2, a_1, a_2", metric="error", changes=()):
    words = {"ESTIMATOR": estimator, "VALUES": values, "METRIC": metric}
    return planned(folder, replaced(TWO, words | dict(changes)))


def errors(plan):
    (unit,) = plan.units
    job = Job(unit.estimator, tuple(unit.metrics.values()))
    outcomes = tried(unit.data, [job], {trial: [0] for trial in range(3)}, plan.experiment.seed)
    scores = [score for outcome in outcomes for score in outcome.scores]
    assert {score.failure for score in scores} == {""}
    assert not any(score.crash for score in scores)
    return np.array([outcome.values for outcome in outcomes])


@pytest.mark.parametrize(
    "settings",
    [
        "kind: two_stage",
        "kind: two_stage, weight: inverse_gram",
        "kind: two_stage, weight: {kind: ar, a: [0.9, -0.2]}",
        "kind: two_stage, weight: {kind: inverse_gram, of: {kind: ar, a: [0.9, -0.2]}}",
        *(f"kind: two_stage, weight: {{kind: estimated_ar, method: {method}}}" for method in METHODS),
        "kind: bilinear_least_squares",
    ],
)
def test_rows_that_straddle_two_experiments_are_left_out(tmp_path, settings):
    found = plan(tmp_path, f"{{{settings}, {BASIS}}}")
    check_records(found)
    assert np.max(np.abs(errors(found))) < 1e-9


def test_feedback_looks_back_in_its_own_experiment_only(tmp_path):
    found = plan(
        tmp_path,
        f"{{kind: separable_least_squares, feedback: 1, {BASIS}}}",
        "a_1, b_1, b_2, c_1, c_2",
        changes=[("{kind: fir, b: [0, 0.8, 0.6]}", "{kind: arma, a: [0.7], b: [0, 0.8, 0.6]}")],
    )
    assert np.max(np.abs(errors(found))) < 1e-9


def test_a_finite_response_behind_a_known_nonlinearity_is_exact(tmp_path):
    square = "{kind: polynomial, coefficients: [0, 1, 0.5]}"
    found = plan(tmp_path, f"{{kind: known_nonlinearity, nonlinearity: {square}, lags: 2}}", "b_1, b_2")
    assert np.max(np.abs(errors(found))) < 1e-9


def test_a_key_term_looks_back_in_its_own_experiment_only(tmp_path):
    found = plan(
        tmp_path,
        "{kind: voros_hammerstein, n: 1, m: 2, degree: 2, tolerance: 1e-13, max_iterations: 5000}",
        "a_1, b_1, b_2, f_1, f_2, g_1, g_2",
        metric="value",
        changes=[("{kind: fir, b: [0, 0.8, 0.6]}", "{kind: arma, a: [0.4], b: [0, 0.8, 0.2]}")],
    )
    truth = [0.4, 1.0, 0.25, 0.8, 0.4, 0.8, 0.4]
    np.testing.assert_allclose(errors(found), np.tile(truth, (3, 1)), atol=1e-9)


def square(u):
    return u + 0.5 * u**2


def hammerstein(linear, samples=(80, 120)):
    parts = [
        {
            "name": name,
            "samples": n,
            "excitation": {"kind": "iid", "distribution": "uniform", "low": low, "high": low + 2},
        }
        for name, n, low in zip(("low", "high"), samples, (-1, 4), strict=True)
    ]
    return Data.model_validate(
        {
            "samples": sum(samples),
            "system": {
                "kind": "hammerstein",
                "nonlinearity": {"kind": "polynomial", "coefficients": [0, 1, 0.5]},
                "linear": linear,
            },
            "excitation": {"kind": "experiments", "parts": parts},
        }
    )


def test_a_prefilter_undoes_the_block_in_each_experiment():
    record = generate(hammerstein({"kind": "arma", "a": [0.7, -0.2], "b": [1, 0.3], "initial": "zero"}), 1, 0)
    block = TransferFunction(b=(1.0, 0.3), a=(0.7, -0.2))
    filtered = FilteredRecord.of(record, block)
    assert len(filtered) == 200 - 2 * 2
    assert np.array_equal(filtered.u[filtered.order], np.sort(filtered.u))
    kept = np.delete(np.arange(200), [0, 1, 80, 81])
    assert np.array_equal(filtered.u, record.u[kept])
    # 1/B forgets its start.
    w = square(record.u)[kept]
    forgotten = np.r_[30:78, 110:196]
    np.testing.assert_allclose(filtered.y[forgotten], w[forgotten], atol=1e-12)
    with pytest.raises(
        EstimationError, match=r"^no experiment holds more than the 2 samples that the filter"
    ):
        prefilter(np.ones(4), block, joined([2, 2]))


LEVELS = joined([2000, 2000, 2000])


def at_two_levels(block):
    """An input of two levels in three experiments, the block's output without noise, and what it filtered."""
    rng = np.random.default_rng(5)
    u = np.concatenate([rng.uniform(low, low + 2, 2000) for low in (-1, 4, -1)])
    return u, in_each(LEVELS, block.filter, square(u)), square(u)


ESTIMATORS = {
    "least_squares": lambda u, y: least_squares(y, 2, LEVELS),
    "instrumental_variables": lambda u, y: instrumental_variables(y, square(u), 2, parts=LEVELS),
    "moving_average": lambda u, y: instrumental_variables(y, square(u), 2, 1, LEVELS),
}


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_experiments_of_different_levels_have_a_constant_each(kind):
    b = (1.0, 0.4) if kind == "moving_average" else (1.0,)
    u, y, w = at_two_levels(TransferFunction(b=b, a=(0.5, -0.2)))
    found = ESTIMATORS[kind](u, y)
    assert found.linear is not None
    np.testing.assert_allclose(found.linear.a, [0.5, -0.2], atol=0.05)
    np.testing.assert_allclose(found.linear.b, b, atol=0.05)
    assert found.values["c"] == pytest.approx(w.mean(), rel=0.05)
    offset = np.repeat([3.0, -20.0, 7.0], 2000)
    other = ESTIMATORS[kind](u, y + offset)
    assert other.linear is not None
    np.testing.assert_allclose(other.linear.a, found.linear.a, rtol=1e-9)
    np.testing.assert_allclose(other.linear.b, found.linear.b, rtol=1e-9)
    steady = offset.mean() / found.linear.static_gain()
    assert other.values["c"] - found.values["c"] == pytest.approx(steady, rel=1e-9)


def test_a_prefilter_that_was_estimated_from_several_levels_leaves_the_characteristic():
    u, y, _ = at_two_levels(TransferFunction(a=(0.5, -0.2)))
    record = Record(u, y, parts={f"{p.start}": Part(p.start, p.stop, 1.0, Held(u[p], u[p])) for p in LEVELS})
    kernel = {"kind": "kernel", "kernel": "gaussian", "bandwidth": {"h0": 0.1, "alpha": 0}}
    estimator = Of("estimator").validate({**kernel, "prefilter": {"kind": "least_squares", "order": 2}})
    assert isinstance(estimator, EstimatorSpec)
    found = estimator.fit(record)
    assert found.nonlinearity is not None
    points = np.array([-0.5, 0.0, 0.5, 4.5, 5.0, 5.5])
    # Three standard errors of a_1 + a_2, which are 0.024 each, times the output's upper level, 25.
    np.testing.assert_allclose(found.nonlinearity(points), square(points), atol=3 * 0.024 * 25)


def test_the_disturbance_after_filtering_is_that_of_each_experiment():
    record = generate(hammerstein({"kind": "ar", "a": [0.8]}), 1, 0)
    block = Estimate(linear=TransferFunction(a=(0.8,)))
    assert DisturbanceVariance(filtered=True).evaluate(block, record)[0] < 1e-20


def output_error():
    start = {
        "kind": "iterative_hammerstein",
        "nonlinearity": {"kind": "polynomial", "degree": 2},
        "delay": 0.3,
        "first": {"n": 2, "m": 1, "horizon": 8},
    }
    return Of("estimator").validate({"kind": "output_error", "start": start})


def test_the_simulated_output_of_each_experiment_begins_at_rest():
    # Held longer than a horizon's stencil, so that the two-stage estimate is near the truth.
    steps = {"kind": "multistep", "distribution": "uniform", "switching_time": 1}
    data = Data.model_validate(
        {
            "samples": 700,
            "dt": 0.1,
            "system": {
                "kind": "hammerstein",
                "nonlinearity": {"kind": "polynomial", "coefficients": [0, 1, 0.5]},
                "linear": {"kind": "continuous", "a": [2.5, 1.5], "b": [1, 0.2], "delay": 0.3},
            },
            "excitation": {
                "kind": "experiments",
                "parts": [
                    {"name": "low", "samples": 300, "excitation": {**steps, "limits": [-1, 1]}},
                    {"name": "high", "samples": 400, "excitation": {**steps, "limits": [3, 5]}},
                ],
            },
        }
    )
    record = generate(data, 3, 0)
    found = output_error().fit(record, np.random.default_rng(0))
    values = [found.values[name] for name in ("a_1", "a_2", "b_1", "c_1", "c_2")]
    np.testing.assert_allclose(values, [2.5, 1.5, 0.2, 1.0, 0.5], atol=1e-9)


class TestHorizons:
    PARTS = joined([201, 60, 301])

    def horizons(self, **changes):
        options = {"eta": 8.0, "overlap": 0.1, "order": 2, "start": 1.0, "parts": self.PARTS, **changes}
        return Horizons.of(562, 0.1, **options)

    def test_lie_inside_one_experiment_each(self):
        over = self.horizons()
        # The second experiment, of 5.9, holds none.
        alone = [Horizons.of(n, 0.1, eta=8.0, overlap=0.1, order=2, start=1.0) for n in (201, 301)]
        assert over.count == alone[0].count + alone[1].count
        expected = np.concatenate([alone[0].starts, 261 + alone[1].starts])
        assert np.array_equal(over.starts, expected)

    @pytest.mark.parametrize("knots", [Knots(), Knots(10, 3)])
    def test_transform_each_experiment_as_if_it_were_alone(self, knots):
        rng = np.random.default_rng(0)
        signal, over = rng.normal(size=562), self.horizons()
        for build in (lambda h: h.sampled(knots), lambda h: h.held(0.55)):
            alone = []
            for part in (self.PARTS[0], self.PARTS[2]):
                single = Horizons.of(part.stop - part.start, 0.1, eta=8.0, overlap=0.1, order=2, start=1.0)
                alone.append(single.transform(build(single), signal[part]))
            found = over.transform(build(over), signal)
            np.testing.assert_allclose(found, np.concatenate(alone, axis=1), atol=1e-13)

    def test_knots_are_counted_from_the_start_of_each_experiment(self):
        u = np.concatenate([np.repeat([1.0, 2, 3], 10), np.repeat([5.0, 1], 20)])
        assert Knots.of(u, 0.3, 0.1, joined([30, 40])) == Knots(10, 3)
        shifted = np.concatenate([np.repeat([1.0, 2, 3], 10)[:-3], np.repeat([5.0, 1], 20)])
        assert Knots.of(shifted, 0.3, 0.1, joined([27, 40])) == Knots(10, 3)

    def test_that_no_experiment_holds_are_an_error(self):
        with pytest.raises(ValueError, match=r"^the horizon 40 is too long for the record: it spans 29 "):
            self.horizons(eta=40.0)


class TestNoiseModels:
    PARTS = joined([3, 40, 1, 60])

    def test_whiten_each_experiment_by_itself(self):
        model, n = ArModel(np.array([0.6, -0.3, 0.2, 0.1])), 104
        F = model.whiten(np.eye(n), self.PARTS).T
        gamma = TransferFunction(a=tuple(model.a)).impulse_response(3000)
        covariance = np.array([gamma[: len(gamma) - k] @ gamma[k:] for k in range(60)])
        R = np.zeros((n, n))
        for part in self.PARTS:
            size = np.arange(part.stop - part.start)
            R[part, part] = covariance[np.abs(np.subtract.outer(size, size))]
        np.testing.assert_allclose(F @ R @ F.T, np.eye(n), atol=1e-10)

    @pytest.mark.parametrize("method", METHODS)
    def test_do_not_see_the_step_between_experiments(self, method):
        rng = np.random.default_rng(1)
        v = TransferFunction(a=(0.5,)).filter(rng.normal(size=4000))
        # A cut into experiments that are put in another order takes three products in thousands away.
        cut = joined([1000] * 4)
        moved = np.concatenate([v[part] for part in (cut[2], cut[0], cut[3], cut[1])])
        one, other = (METHODS[method](signal, 2, cut)[2] for signal in (v, moved))
        np.testing.assert_allclose(one.a, other.a, rtol=1e-10)
        assert one.variance == pytest.approx(other.variance, rel=1e-10)
        assert one.a[0] == pytest.approx(0.5, abs=0.06)

    def test_that_look_back_further_than_any_experiment(self):
        message = "no experiment holds more than 5 residuals, and so far back the noise model looks"
        with pytest.raises(EstimationError, match=f"^{message}$"):
            METHODS["least_squares"](np.ones(8), 5, joined([4, 4]))


def test_parts_of_a_signal():
    parts = joined([2, 0, 3])
    assert parts == (slice(0, 2), slice(2, 2), slice(2, 5))
    assert longer_than(parts, 1) == (slice(0, 2), slice(2, 5))
    assert following(parts, 1) == (slice(0, 1), slice(1, 3))
    assert whole(5) == (slice(0, 5),)
    rows = np.arange(10.0).reshape(2, 5)
    assert np.array_equal(in_each(parts, lambda x: x[:, ::-1], rows, axis=1), rows[:, [1, 0, 4, 3, 2]])
    assert np.array_equal(in_each(parts, np.cumsum, np.arange(5.0)), [0, 1, 2, 5, 9])


def test_experiments_of_a_record():
    u = np.zeros(5)
    assert Record(u, u).experiments == (slice(0, 5),)
    held = Held(np.zeros(1), np.zeros(1))
    parts = {"a": Part(0, 2, 1.0, held), "b": Part(2, 5, 1.0, held)}
    assert Record(u, u, parts=parts).experiments == (slice(0, 2), slice(2, 5))


@pytest.fixture
def newcomer():
    """An estimator that says nothing of several experiments."""
    if "newcomer" not in components("estimator"):

        @component("estimator", "newcomer")
        class Newcomer(EstimatorSpec):
            """An estimator of the differences of the output."""

            def names(self):
                return ["b_1"]

            def fit(self, record, rng=None):
                return Estimate(values={"b_1": float(np.mean(np.diff(record.y)))})

    return "newcomer"


def test_an_estimator_that_does_not_say_what_it_does_with_them_is_refused(tmp_path, newcomer):
    with pytest.raises(ConfigError) as caught:
        check_records(plan(tmp_path, newcomer, "b_1"))
    assert str(caught.value) == (
        f"{tmp_path}/a.yaml:15: estimators.it: newcomer takes a record of one experiment, and this one has "
        "2: it does not say that it keeps them apart"
    )


def test_a_trial_refuses_them_to_it_too(tmp_path, newcomer):
    (unit,) = plan(tmp_path, newcomer, "b_1").units
    with pytest.raises(EstimationError, match=r"^newcomer takes a record of one experiment"):
        estimate(unit.data, Job(unit.estimator, ()), generate(unit.data, 1, 0), 1, 0)


@pytest.mark.parametrize("parts", ["both", "only"])
def test_experiments_sampled_otherwise_than_the_record_are_refused_before_the_run(tmp_path, parts):
    changes = [("{name: high, samples: 100,", "{name: high, samples: 100, dt: 0.5,")]
    if parts == "only":
        (low,) = [line for line in TWO.splitlines(keepends=True) if "name: low" in line]
        changes += [(low, ""), ("samples: 200", "samples: 100")]
    with pytest.raises(ConfigError) as caught:
        check_records(plan(tmp_path, f"{{kind: two_stage, {BASIS}}}", changes=changes))
    message = (
        "two_stage works at one sampling interval, and the experiment 'high' has 0.5 where the record has 1: "
        "sample all at the record's 'dt'"
    )
    assert re.search(f": {re.escape(message)}$", str(caught.value))


def test_experiments_too_short_for_the_lags_are_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"100 samples are too few for the lags 101 to 102$"):
        late = BASIS.replace("delay: 1", "delay: 101")
        check_records(plan(tmp_path, f"{{kind: two_stage, {late}}}", "a_1, a_2", metric="value"))
