"""What a metric cannot score is refused before the run, or fails the trial with its reason."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hident import plugins
from hident.config.spec import Of
from hident.engine.trial import Data, generate
from hident.errors import EstimationError, SimulationError
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction
from hident.metrics.disturbance import DisturbanceVariance
from hident.metrics.frequency import MovedDelay, ResponseError
from hident.metrics.models import LinearPercentError, discretised_percent_error, fit_error
from hident.records import Estimate, Held, Part, Record, Truth
from hident.systems.base import SystemSpec
from tests.unit.plans import planned, refusals, replaced
from tests.unit.tried import tried

plugins.load()
QUICK = settings(deadline=None, derandomize=True, max_examples=30)

BASE = """\
version: 1
title: A continuous block
trials: 3
dt: DT
samples: 1001
system:
  kind: SYSTEM
  nonlinearity: NONLINEARITY
  linear: {kind: continuous, a: AS, b: BS}
excitation: EXCITATION
noise: {kind: white, nsr: 0.05}
estimators:
  e: ESTIMATOR
metrics:
  m: METRIC
"""
DEFAULTS = {
    "DT": "0.1",
    "SYSTEM": "hammerstein",
    "NONLINEARITY": "identity",
    "AS": "[3, 2]",
    "BS": "[1]",
    "EXCITATION": "{kind: multistep, switching_time: 1, std: 1, limits: [-3, 3]}",
    "ESTIMATOR": "{kind: linear_model, block: {n: 2, m: 1, horizon: 10}}",
    "METRIC": "{kind: linear_percent_error}",
}
BLOCKS = """\
version: 1
title: Two blocks
trials: 2
dt: 0.5
samples: 400
system:
  kind: wiener_hammerstein
  input_linear: {kind: continuous, a: [1], b: BS}
  nonlinearity: {kind: polynomial, coefficients: [0, 1, 0.5]}
  output_linear: {kind: continuous, a: [1]}
excitation:
  kind: experiments
  parts:
    - {name: w, excitation: {kind: sine, frequency: 1}, periods: 5, samples_per_period: 32}
    - {name: 2w, excitation: {kind: sine, frequency: 2}, periods: 5, samples_per_period: 32}
    - {name: steps, excitation: {kind: staircase, levels: [-1, 0, 1, 2], hold: 10}, samples: 80}
estimators:
  e: {kind: frequency_gain_identification, frequencies: [1, 2], order: 2, coefficients: [0, 1, 0.5]}
metrics:
  m: METRIC
"""


@pytest.fixture
def plan_of(tmp_path):
    def plan_of(text=BASE, **changes):
        return planned(tmp_path, replaced(text, DEFAULTS | changes))

    return plan_of


@pytest.fixture
def refused(tmp_path):
    def refused(text=BASE, **changes):
        """The one thing that is wrong, without its place; None if nothing is."""
        lines = refusals(tmp_path, replaced(text, DEFAULTS | changes))
        assert len(lines) <= 1
        return lines[0].partition(": ")[2] if lines else None

    return refused


class TestStaticGain:
    @pytest.mark.parametrize("b", ["[0, 1]", "[1e-17, 1]", "[sin(pi), 1]"])
    def test_a_truth_without_one_is_refused(self, refused, b):
        assert refused(BS=b) == (
            "metrics.m: the metric 'linear_percent_error' leaves the gain apart, and the system's linear "
            "block has no static gain (b_0 = 0) to be divided by: score the parameters by kind error, or the "
            "whole model by validation_error"
        )

    def test_a_step_response_without_one_settles_nowhere(self, refused):
        assert refused(BS="[sin(pi), 1]", METRIC="{kind: settling_time}") == (
            "metrics.m: the metric 'settling_time' measures from the final value of the step response, and "
            "the system's linear block has no static gain (b_0 = 0): score the whole model by "
            "validation_error"
        )
        assert refused(BS="[1, 1]", METRIC="{kind: settling_time}") is None

    def test_rounding_is_the_same_in_every_unit_of_time(self):
        minutes, nanoseconds = (
            ContinuousTransferFunction((1.0, 2.0 * unit), (3.0 * unit, 2.0 * unit**2)) for unit in (1.0, 6e10)
        )
        assert (minutes.static_gain(), nanoseconds.static_gain()) == (1.0, 1.0)
        assert ContinuousTransferFunction((1e-17, 1.0), (3.0, 2.0)).static_gain() == 0.0
        assert math.isinf(ContinuousTransferFunction((1e-17, 1.0), (3.0, 2.0)).settling_time())

    @pytest.mark.parametrize(
        "block",
        [
            ContinuousTransferFunction((0.0, 1.0), (3.0, 2.0)),
            ContinuousTransferFunction((1e-17, 1.0), (3.0, 2.0)),
            TransferFunction(b=(0.0, 0.3, -0.1, -0.2), a=(0.5,)),
            TransferFunction(b=(1.0,), a=(1.5, -0.5)),
        ],
    )
    def test_an_estimate_without_one_fails_with_its_reason(self, block):
        truth = ContinuousTransferFunction((1.0,), (3.0, 2.0))
        with pytest.raises(EstimationError, match="the estimated block has the static gain"):
            discretised_percent_error(block, truth, 0.1)

    @QUICK
    @given(b=st.lists(st.floats(-5, 5), min_size=1, max_size=4), a=st.floats(-0.9, 0.9))
    def test_the_static_gain_is_the_sum_of_the_impulse_response(self, b, a):
        block = TransferFunction(b=tuple(b), a=(a,))
        wanted = np.sum(block.impulse_response(2000))
        assert block.static_gain() == pytest.approx(wanted, rel=1e-9, abs=1e-12)

    @pytest.mark.parametrize(
        "metric",
        ["{kind: true_response, of: [gain_i_1]}", "{kind: response_error, of: [phase_sum_1_1, gain_i_1]}"],
    )
    def test_gains_and_phases_are_relative_to_it(self, refused, metric):
        text = BLOCKS.replace("a: [1], b: BS", "a: [2, 1], b: BS")
        for b in ("[0, 1]", "[sin(pi), 1]"):
            assert "the system's input_linear has none (b_0 = 0)" in refused(text, BS=b, METRIC=metric)
        assert refused(text, BS="[1]", METRIC=metric) is None


class TestZeroTruths:
    def test_a_percentage_of_a_nonlinearity_that_is_zero(self, refused):
        found = refused(
            NONLINEARITY="{kind: dead_zone, low: -1, high: 1}",
            ESTIMATOR="{kind: iterative_hammerstein, nonlinearity: {kind: polynomial, degree: 3}, "
            "first: {n: 2, m: 1, horizon: 5}}",
            METRIC="{kind: nonlinearity_percent_error, interval: [-0.5, 0.5]}",
        )
        assert "which is zero throughout the interval: take a wider interval, or the kind mise" in found

    @pytest.mark.parametrize(("gain", "refused"), [(0.03, 0), (1.0, 0), (4000.0, 1)])
    def test_the_interval_is_of_the_truth_in_the_method_s_form(self, tmp_path, gain, refused):
        """A dead zone whose argument is written in another unit, and one that is wide in the method's too."""
        reach = 0.4 / gain if refused == 0 else 2.0
        block = f"{{kind: fir, b: [{0.6 / gain}, {0.4 / gain}]}}"
        curve = f"{{kind: dead_zone, low: {-reach}, high: {reach}}}"
        found = refusals(
            tmp_path,
            f"""\
version: 1
title: A dead zone
trials: 2
samples: 100
system: {{kind: wiener, nonlinearity: {curve}, linear: {block}}}
excitation: {{kind: iid, distribution: uniform, low: -1, high: 1}}
estimators:
  e: {{kind: prediction_error, blocks: [{{kind: linear, nb: 2, nf: 0}}, {{kind: cubic_spline, knots: 4}}]}}
metrics:
  m: {{kind: nonlinearity_percent_error, interval: [-1, 1]}}
""",
        )
        assert len([line for line in found if "zero throughout the interval" in line]) == refused

    def test_a_percentage_of_values_that_are_zero(self, refused):
        metric = "{kind: percent_error, of: [b_1]}"
        assert "which are all zero: take the kind error" in refused(BS="[1, 0]", METRIC=metric)

    def test_a_relative_error_of_a_phase_of_zero_is_no_number(self):
        # At the frequency of an estimate that is zero, no block turns the phase.
        truth = Truth(blocks={"input": BLOCK, "output": BLOCK})
        metric = ResponseError(of=("phase_i_1",), relative=True)
        estimate = Estimate(frequencies=np.zeros(1), values={"phase_i_1": 0.1})
        record = Record(np.zeros(1), np.zeros(1), 1.0, truth)
        assert np.isnan(metric.evaluate(estimate, record)[0])

    def test_an_output_that_does_not_vary(self):
        with pytest.raises(SimulationError, match="does not vary under the validation's excitation"):
            fit_error(np.zeros(5), np.full(5, 0.3))

    def test_a_disturbance_needs_a_first_coefficient_of_one(self, tmp_path):
        (line,) = refusals(
            tmp_path,
            "version: 1\ntitle: t\ntrials: 1\nsamples: 50\n"
            "system: {kind: hammerstein, nonlinearity: identity, linear: {kind: ar, a: [0.5], b0: 2}}\n"
            "excitation: {kind: iid, distribution: gaussian, std: 1}\n"
            "estimators: {e: {kind: least_squares, order: 1}}\n"
            "metrics: {m: {kind: disturbance_variance}}\n",
        )
        assert "holds where gamma_0 = 1, and the system has 2" in line
        assert DisturbanceVariance(filtered=True).compares() == {"linear"}


BLOCK = ContinuousTransferFunction((1.0,), (3.0, 2.0))


class TestStep:
    def test_the_default_is_the_sampling_interval_of_the_data(self):
        truth, other = BLOCK, ContinuousTransferFunction((1.0,), (3.3, 2.0))
        record = Record(np.zeros(2), np.zeros(2), 0.1, Truth(continuous=truth))
        found = LinearPercentError().evaluate(Estimate(continuous=other), record)
        assert found == LinearPercentError(step=0.1).evaluate(Estimate(continuous=other), record)
        assert found != LinearPercentError(step=1).evaluate(Estimate(continuous=other), record)
        assert LinearPercentError().says(0.1) == "gain and delay apart, blocks sampled every 0.1"
        assert LinearPercentError(step=1).says(0.1) == "gain and delay apart, blocks sampled every 1"

    def test_a_process_of_milliseconds_has_an_error_of_some_percent(self, plan_of):
        plan = plan_of(
            DT="0.0001",
            AS="[0.003, 2.0e-6]",
            EXCITATION="{kind: multistep, switching_time: 0.001, std: 1, limits: [-3, 3]}",
            ESTIMATOR="{kind: linear_model, block: {n: 2, m: 0, horizon: 0.01}}",
        )
        (unit,) = plan.units
        found = unit.estimator.fit(generate(unit.data, 1, 0), np.random.default_rng(0))
        (error,) = unit.metrics["m"].evaluate(found, generate(unit.data, 1, 0))
        assert 1e-3 < error < 50.0

    def test_a_step_in_which_the_block_forgets_all_is_refused(self, refused):
        block = {
            "DT": "0.0001",
            "AS": "[0.003, 2.0e-6]",
            "EXCITATION": "{kind: multistep, switching_time: 0.001, std: 1, limits: [-3, 3]}",
            "ESTIMATOR": "{kind: linear_model, block: {n: 2, m: 0, horizon: 0.01}}",
        }
        assert refused(**block, METRIC="{kind: linear_percent_error, step: 1}") == (
            "metrics.m: the metric 'linear_percent_error' compares blocks sampled every 1, in which the "
            "system's linear block (its longest time constant is 0.002) forgets all that its parameters say: "
            "set a smaller 'step'"
        )
        assert refused(**block, METRIC="{kind: linear_percent_error, step: 0.02}") is None

    def test_a_discrete_estimate_of_another_step_is_refused(self, refused):
        voros = "{kind: voros_hammerstein, n: 2, m: 2, degree: 2, step: 1}"
        assert refused(ESTIMATOR=voros) == (
            "metrics.m: the metric 'linear_percent_error' compares blocks sampled every 0.1, and the "
            "estimate's is sampled every 1: set 'step: 1'"
        )
        assert refused(ESTIMATOR=voros, METRIC="{kind: linear_percent_error, step: 1}") is None


class TestValidation:
    @pytest.mark.parametrize(
        ("excitation", "said"),
        [
            (
                "{kind: staircase, levels: [0, 1, 2], hold: 50}",
                "has an excitation that does not fit: a record of 100 samples ends before the last of 3",
            ),
            (
                "{kind: sine, period: 0.7, whole_periods: true}",
                "has an excitation that does not fit: a record of 100 samples holds 14.28571429 periods",
            ),
            (
                "{kind: stepped_sine, frequencies: [1, 2], periods: 1, samples_per_period: 50}",
                "takes one experiment, not several",
            ),
            (
                "{kind: staircase, levels: [0, 1], hold: 5, initial: 3}",
                "leave out 'initial' of its excitation",
            ),
        ],
    )
    def test_an_excitation_that_does_not_fit_is_refused_before_the_run(self, refused, excitation, said):
        found = refused(METRIC=f"{{kind: validation_error, samples: 100, excitation: {excitation}}}")
        assert found.startswith("metrics.m: the metric 'validation_error' ")
        assert said in found


class TestFrequencies:
    @pytest.mark.parametrize(
        ("metric", "said"),
        [
            (
                "{kind: true_response, of: [gain_i_1, gain_i_3]}",
                "asks for gain_i_3, and the record has sines at 2",
            ),
            (
                "{kind: moved_delay, experiments: [w, step]}",
                "names the experiment 'step', which there is not; did you mean 'steps'? (there are: w, 2w",
            ),
        ],
    )
    def test_what_the_record_will_not_hold_is_refused(self, refused, metric, said):
        assert said in refused(BLOCKS, BS="[1]", METRIC=metric)

    def test_harmonics_need_multisines(self, refused):
        text = BLOCKS.replace(
            "{kind: frequency_gain_identification, frequencies: [1, 2], order: 2, coefficients: [0, 1, 0.5]}",
            "{kind: best_linear_approximation, harmonics: [1, 3]}",
        )
        found = refused(text, BS="[1]", METRIC="{kind: gain_shape_error, harmonics: [1, 3]}")
        assert "counts the harmonics of multisines, and the record has none" in found

    def test_a_change_below_the_accuracy_of_the_simulation_is_none(self):
        system = {"kind": "wiener_hammerstein", "input_linear": {"kind": "continuous", "a": [12, 20]}}
        system |= {"nonlinearity": {"kind": "exponential", "scale": 50, "rate": 0.2}}
        system |= {"output_linear": {"kind": "continuous", "a": [105, 500], "delay": 20}}
        sines = {"kind": "stepped_sine", "frequencies": [0.01, 0.08], "amplitude": 1.5, "periods": 2}
        excitation = sines | {"samples_per_period": 64}
        data = Data.model_validate({"samples": 256, "dt": 1, "system": system, "excitation": excitation})
        assert MovedDelay(experiments=("1", "2")).evaluate(Estimate(), generate(data, 1, 0)) == [0.0, 0.0]

    def test_a_change_above_it_is_kept(self):
        # A nonlinearity that depends on when it is asked: the delay before it matters.
        wave = Held(np.array([0.0]), np.array([1.0]))
        calls = iter(range(100))
        truth = Truth(
            blocks={"input": BLOCK, "output": BLOCK}, nonlinearity=lambda u: u * (1 + 1e-6 * next(calls))
        )
        record = Record(np.zeros(9), np.zeros(9), 1.0, truth, {"a": Part(0, 9, 1.0, wave)})
        (change,) = MovedDelay(experiments=("a",)).evaluate(Estimate(), record)
        assert 1e-8 < change < 1e-3


class TestWhatWasBeforeTheRecord:
    STEPS = "{kind: staircase, levels: [5, 6], hold: 10, initial: INITIAL}"

    @pytest.mark.parametrize("system", ["hammerstein", "wiener"])
    def test_a_system_that_starts_from_rest_refuses_another_start(self, refused, system):
        found = refused(SYSTEM=system, EXCITATION=self.STEPS.replace("INITIAL", "5"))
        assert found == (
            f"excitation: 'initial' names what was applied before the record, but this {system} system "
            "starts from rest, as if nothing had been: leave it out (discrete blocks that are stationary, "
            "and a wiener_hammerstein system with continuous blocks, start from the equilibrium)"
        )
        assert refused(SYSTEM=system, EXCITATION=self.STEPS.replace("INITIAL", "0")) is None
        assert refused(SYSTEM=system, EXCITATION=self.STEPS.replace(", initial: INITIAL", "")) is None

    def test_rest_is_that_of_the_linear_block(self, refused):
        excitation = self.STEPS.replace("INITIAL", "0")
        curve = "{kind: polynomial, coefficients: [2, 1]}"
        assert "starts from rest" in refused(NONLINEARITY=curve, EXCITATION=excitation)
        assert refused(SYSTEM="wiener", NONLINEARITY=curve, EXCITATION=excitation) is None

    def test_a_filtered_or_one_of_several_excitations_is_asked_too(self, refused):
        steps = self.STEPS.replace("INITIAL", "5")
        filtered = f"{{kind: filtered, excitation: {steps}, linear: {{kind: ar, a: [0.5]}}}}"
        assert "starts from rest" in refused(EXCITATION=filtered)
        several = f"{{kind: experiments, parts: [{{name: a, samples: 1001, excitation: {steps}}}]}}"
        assert "starts from rest" in refused(EXCITATION=several)

    @pytest.mark.parametrize(
        ("kind", "settings"),
        [
            (
                "acid_tank",
                {
                    "volume": 1,
                    "q_a": 14.2,
                    "q_b": 13.5,
                    "acetic_acid": 1,
                    "propionic_acid": 1,
                    "sodium_hydroxide": 2,
                    "pk_acetic": 4.75,
                    "pk_propionic": 4.87,
                },
            ),
        ],
    )
    def test_a_process_starts_from_its_steady_state(self, kind, settings):
        system = Of("system").validate({"kind": kind, **settings})
        assert isinstance(system, SystemSpec)
        system.check_before(0.0)
        with pytest.raises(ValueError, match=f"this {kind} system starts from rest"):
            system.check_before(1.0)

    @pytest.mark.parametrize(
        "system",
        [
            {
                "kind": "hammerstein",
                "nonlinearity": "identity",
                "linear": {"kind": "ar", "a": [0.5], "b0": 0.5},
            },
            {"kind": "wiener", "nonlinearity": "identity", "linear": {"kind": "fir", "b": [0.5, 0.5]}},
            {
                "kind": "wiener_hammerstein",
                "input_linear": {"kind": "continuous", "a": [3, 2]},
                "nonlinearity": "identity",
                "output_linear": {"kind": "continuous", "a": [3, 2]},
            },
        ],
    )
    def test_those_that_honour_it_start_from_the_equilibrium(self, system):
        steps = {"kind": "staircase", "levels": [5, 6], "hold": 10, "initial": 5}
        dt = 1.0 if system["kind"] == "wiener_hammerstein" else None
        data = Data.model_validate({"samples": 101, "dt": dt, "system": system, "excitation": steps})
        data.system.check_before(5.0)
        y = generate(data, 1, 0).y
        np.testing.assert_allclose(y[:10], 5.0, rtol=1e-9)
        assert y[-1] > 5.0

    def test_a_discrete_block_with_a_given_start_refuses_another(self):
        linear = {"kind": "ar", "a": [0.5], "initial": "zero"}
        system = Of("system").validate({"kind": "hammerstein", "nonlinearity": "identity", "linear": linear})
        assert isinstance(system, SystemSpec)
        with pytest.raises(ValueError, match="starts from rest"):
            system.check_before(5.0)


def test_a_trial_whose_estimate_has_no_static_gain_is_failed_with_the_reason(plan_of):
    from hident.engine.trial import Job

    (unit,) = plan_of().units

    class Flat(type(unit.estimator)):  # type: ignore[misc]
        def fit(self, record, rng):
            return Estimate(continuous=ContinuousTransferFunction((0.0, 1.0), (3.0, 2.0)))

    job = Job(Flat.model_construct(**dict(unit.estimator)), (unit.metrics["m"],))
    (outcome,) = tried(unit.data, [job], {0: [0]}, 1)
    (score,) = outcome.scores
    assert (score.crash, score.failure) == (
        "",
        "metric: the estimated block has the static gain 0, and cannot be brought to 1",
    )
