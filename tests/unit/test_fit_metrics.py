"""The distance of the model's output from the measured one, as the nonlinear benchmarks measure it."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hident import plugins
from hident.block_chain import BlockChain
from hident.config.spec import Of
from hident.errors import ConfigError, EstimationError
from hident.fitted_model import FittedModel, NoiseModel
from hident.linear_blocks import TransferFunction
from hident.metrics.fit import Rmse
from hident.metrics.outputs import OutputMetric
from hident.model_output import simulated
from hident.records import Estimate, Held, Part, Record
from hident.reports.scoring import scoring
from tests.unit.plans import planned, refusals, replaced

plugins.load()
QUICK = settings(deadline=None, derandomize=True, max_examples=25)
KINDS = ("rmse", "nrmse", "r_squared", "mae", "fit_index")
THEIRS = ("RMSE", "NRMSE", "R_squared", "MAE", "fit_index")
LAG = TransferFunction(b=(0.5,), a=(0.5,))
CHAIN = BlockChain((LAG,))


def written_out(kind, y, y_hat):
    """The definitions of nonlinear_benchmarks, one by one."""
    mse, variance = np.mean((y_hat - y) ** 2), np.mean((y - np.mean(y)) ** 2)
    return {
        "rmse": np.sqrt(mse),
        "nrmse": np.sqrt(mse) / np.sqrt(variance),
        "r_squared": 1 - mse / variance,
        "mae": np.mean(np.abs(y - y_hat)),
        "fit_index": 100 * (1 - np.sqrt(mse) / np.sqrt(variance)),
    }[kind]


def metric(kind, **settings):
    spec = Of("metric").validate({"kind": kind, **settings})
    assert isinstance(spec, OutputMetric)
    return spec


def scored(kind, estimate, record, **settings):
    (found,) = metric(kind, **settings).evaluate(estimate, record)
    return found


def giving(y_hat):
    """An estimate that gives one output whatever the input."""
    return Estimate(response=lambda u, dt: np.asarray(y_hat))


def several(u, y, *lengths, dt=1.0):
    starts = np.cumsum([0, *lengths])
    parts = {
        f"part {i}": Part(start, start + length, dt, Held(np.zeros(1), np.zeros(1)))
        for i, (start, length) in enumerate(zip(starts.tolist(), lengths, strict=False))
    }
    return Record(u, y, dt, parts=parts)


def noisy(n=400, seed=1, pole=0.8):
    """A record of the lag with autoregressive noise, and the model that made it."""
    rng = np.random.default_rng(seed)
    u, e = rng.normal(size=n), 0.1 * rng.normal(size=n)
    y = CHAIN.response(u) + TransferFunction(b=(1.0,), a=(pole,)).filter(e)
    return Record(u, y), Estimate(model=FittedModel(CHAIN, "rest", NoiseModel(ar=(pole,), variance=0.01)))


class TestDefinitions:
    @pytest.mark.parametrize("kind", KINDS)
    @QUICK
    @given(seed=st.integers(0, 10**6), scale=st.floats(1e-3, 1e3), offset=st.floats(-10, 10))
    def test_are_those_of_the_benchmarks(self, kind, seed, scale, offset):
        rng = np.random.default_rng(seed)
        y = scale * rng.normal(size=50) + offset
        y_hat = y + 0.3 * scale * rng.normal(size=50)
        found = scored(kind, giving(y_hat), Record(np.zeros(50), y))
        assert found == pytest.approx(written_out(kind, y, y_hat), rel=1e-12)

    @pytest.mark.parametrize(("kind", "name"), list(zip(KINDS, THEIRS, strict=True)))
    @pytest.mark.parametrize("n_init", [0, 50])
    def test_give_the_numbers_of_their_package(self, kind, name, n_init):
        theirs = pytest.importorskip("nonlinear_benchmarks.error_metrics")
        record, estimate = noisy()
        y_hat = simulated(estimate, record)
        wanted = getattr(theirs, name)(record.y[n_init:], y_hat[n_init:])
        assert scored(kind, estimate, record, n_init=n_init) == pytest.approx(float(wanted), rel=1e-12)

    def test_of_a_model_that_is_right(self):
        y = np.array([1.0, 3.0, 2.0])
        assert [scored(kind, giving(y), Record(y, y)) for kind in KINDS] == [0.0, 0.0, 1.0, 0.0, 100.0]

    @pytest.mark.parametrize("kind", ["nrmse", "r_squared", "fit_index"])
    def test_what_is_relative_fails_on_a_constant_output(self, kind):
        with pytest.raises(EstimationError, match="the output is 2 throughout: no error is relative"):
            scored(kind, giving([1.0, 2.0]), Record(np.zeros(2), np.full(2, 2.0)))


class TestSeveralExperiments:
    def test_the_first_samples_of_each_are_left_out_and_errors_are_pooled(self):
        y = np.arange(10.0)
        record = several(np.zeros(10), y, 6, 4)
        wrong = np.zeros(10)
        wrong[[0, 1, 6, 7]] = 100.0
        estimate = Estimate(model=SimpleNamespace(simulate=lambda record: record.y + wrong + 0.5))
        assert scored("rmse", estimate, record, n_init=2) == pytest.approx(0.5)
        kept = np.r_[y[2:6], y[8:]]
        assert scored("nrmse", estimate, record, n_init=2) == pytest.approx(0.5 / np.std(kept))

    def test_an_experiment_that_is_left_out_as_a_whole_does_not_count(self):
        record = several(np.zeros(7), np.arange(7.0), 2, 5)
        estimate = Estimate(
            model=SimpleNamespace(simulate=lambda record: record.y + np.r_[[9.0] * 5, 0.5, 0.5])
        )
        assert scored("mae", estimate, record, n_init=3) == pytest.approx(0.5)

    def test_the_response_begins_at_rest_in_each_at_its_own_interval(self):
        seen = []

        def response(u, dt):
            seen.append((len(u), dt))
            return LAG.filter(u)

        record = several(np.ones(5), np.zeros(5), 3, 2, dt=0.5)
        found = simulated(Estimate(response=response), record)
        np.testing.assert_allclose(found, [0.5, 0.75, 0.875, 0.5, 0.75])
        assert seen == [(3, 0.5), (2, 0.5)]

    def test_a_model_that_looks_back_keeps_them_apart(self):
        record, estimate = noisy(100)
        halves = several(record.u, record.y, 50, 50)
        first = Record(record.u[:50], record.y[:50])
        second = Record(record.u[50:], record.y[50:])
        apart = [scored("rmse", estimate, one, by="prediction", n_init=5) for one in (first, second)]
        together = scored("rmse", estimate, halves, by="prediction", n_init=5)
        assert together == pytest.approx(np.sqrt(np.mean(np.square(apart))))


class TestSimulationAndPrediction:
    def test_a_prediction_gains_what_the_noise_model_knows(self):
        record, estimate = noisy(5000)
        one, four, none = (
            scored("rmse", estimate, record, by="prediction", steps=1, n_init=20),
            scored("rmse", estimate, record, by="prediction", steps=4, n_init=20),
            scored("rmse", estimate, record, n_init=20),
        )
        # Of AR noise with the pole .8: sqrt(1 - .8^2k)/sqrt(1 - .8^2) standard deviations of its innovation.
        wanted = 0.1 * np.sqrt((1 - 0.8 ** np.array([2.0, 8.0, np.inf])) / (1 - 0.64))
        np.testing.assert_allclose([one, four, none], wanted, rtol=0.05)

    def test_a_simulation_that_grows_beyond_all_numbers_fails(self):
        chain = BlockChain((TransferFunction(b=(1.0,), a=(1e200,)),))
        with (
            np.errstate(all="ignore"),
            pytest.raises(EstimationError, match="simulated output is inf at sample 2"),
        ):
            scored("rmse", Estimate(model=FittedModel(chain, "rest")), Record(np.ones(9), np.ones(9)))

    def test_an_unstable_block_beside_a_response_fails(self):
        estimate = Estimate(response=lambda u, dt: u, linear=TransferFunction(b=(1.0,), a=(1.1,)))
        with pytest.raises(EstimationError, match="the linear block is unstable"):
            scored("rmse", estimate, Record(np.arange(2.0), np.arange(2.0)))

    def test_steps_are_of_a_prediction(self):
        with pytest.raises(
            ConfigError, match="'steps' is of a prediction: set 'by: prediction', or leave it out"
        ):
            Rmse(steps=2)


class TestValidation:
    def test_is_scored_on_its_own_record(self):
        record, estimate = noisy(200)
        other, _ = noisy(300, seed=2)
        both = Record(record.u, record.y, validation=other)
        for kind in KINDS:
            assert scored(kind, estimate, both, on="validation") == scored(kind, estimate, other)
            assert scored(kind, estimate, both) == scored(kind, estimate, record)

    def test_a_record_without_one_fails(self):
        record, estimate = noisy(20)
        with pytest.raises(EstimationError, match="the record has no validation part to score the model on"):
            scored("rmse", estimate, record, on="validation")


CONFIG = """\
version: 1
title: A lag
trials: 2
dt: 0.1
samples: 1001
system: {kind: hammerstein, nonlinearity: identity, linear: {kind: continuous, a: [3, 2], b: [1]}}
excitation: {kind: multistep, switching_time: 1, std: 1, limits: [-3, 3]}
noise: {kind: white, nsr: 0.05}
estimators:
  e: {kind: linear_model, block: {n: 2, m: 1, horizon: 10}}
metrics:
  m: METRIC
"""


class TestInARun:
    def refused(self, folder, metric):
        return refusals(folder, replaced(CONFIG, {"METRIC": metric}))

    def test_a_model_from_rest_is_scored_on_simulated_data(self, tmp_path):
        assert self.refused(tmp_path, "{kind: fit_index, n_init: 50}") == []

    def test_there_is_no_validation_record_of_a_simulation(self, tmp_path):
        (said,) = self.refused(tmp_path, "{kind: rmse, on: validation}")
        assert said.endswith(
            "the metric 'rmse' is on a validation record, and this record has none, as no simulated one has: "
            "score 'on: estimation', or the response to another input by kind validation_error"
        )

    def test_more_than_a_record_cannot_be_left_out(self, tmp_path):
        (said,) = self.refused(tmp_path, "{kind: mae, n_init: 1001}")
        assert said.endswith(
            "the metric 'mae' leaves the first 1001 samples of each experiment out, and none has more "
            "(the longest: 1001): set a smaller 'n_init'"
        )

    def test_a_prediction_needs_a_model(self, tmp_path):
        (said,) = self.refused(tmp_path, "{kind: nrmse, by: prediction}")
        assert "the metric 'nrmse' needs the model of the estimate" in said

    @pytest.mark.parametrize(
        ("metric", "said"),
        [
            ("{kind: rmse}", "on the record that was fitted, by simulation"),
            (
                "{kind: rmse, n_init: 50}",
                "on the record that was fitted, by simulation, "
                "without the first 50 samples of each experiment",
            ),
        ],
    )
    def test_tables_say_how_it_scores(self, tmp_path, metric, said):
        plan = planned(tmp_path, replaced(CONFIG, {"METRIC": metric}))
        assert f"Metric m: {said}." in list(scoring(plan))

    def test_predictions_and_validation_are_said(self):
        spec = metric("rmse", on="validation", by="prediction", steps=3)
        assert spec.says(None) == "on the validation record, by 3-step prediction"
