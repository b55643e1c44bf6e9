from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.signal import lfilter

from hident.engine.trial import Data, generate
from hident.errors import EstimationError
from hident.estimators.moving_horizon.wiener.batched_blocks import time_constants
from hident.estimators.moving_horizon.wiener.iteration import FourSegments, Rule, iterate
from hident.estimators.moving_horizon.wiener.iterative_wiener import smoothed
from hident.records import Record
from tests.unit.wiener_records import SEGMENTS, cubic, fit, record, spec, wiener

EXAMPLE_2 = {
    "samples": 1201,
    "dt": 0.1,
    "system": {
        "kind": "wiener",
        "linear": {"kind": "continuous", "a": [4, 5, 2], "b": [1, -2], "delay": 1},
        "nonlinearity": "chen_type_3",
    },
    "excitation": {"kind": "multistep", "switching_time": 1, "std": 1.5, "limits": [-3, 3]},
    "noise": {"kind": "white", "nsr": 0.1},
}
CASE_E = {
    "kind": "iterative_wiener",
    "nonlinearity": {"kind": "four_segment"},
    "delay": 1,
    "start": 2.5,
    "first": {"n": 3, "m": 1, "horizon": 15},
    "second": {"n": 3, "m": 1},
}


class TestRecovery:
    def test_four_segments_without_noise(self):
        found = fit(tolerance=1e-12, max_iterations=200)
        true = {"a_1": 3.0, "a_2": 2.0, "b_0": 1.2, "b_1": -0.5, "e_-2": 0.5, "e_-1": 2.0, "e_2": 3.0}
        for name, value in true.items():
            assert found.values[name] == pytest.approx(value, rel=1e-8), name
            if f"first_{name}" in found.values:
                assert found.values[f"first_{name}"] == pytest.approx(value, rel=1e-8), name
        v = np.linspace(-1.0, 1.0, 21)
        np.testing.assert_allclose(found.nonlinearity(v), SEGMENTS(1.2 * v), atol=1e-8)
        assert found.continuous.b[0] == pytest.approx(1.0, rel=1e-15)

    def test_a_polynomial_without_noise(self):
        nonlinearity = {"kind": "polynomial", "degree": 3}
        found = fit(record(cubic), nonlinearity=nonlinearity, tolerance=1e-12, max_iterations=400)
        for name, value in {"a_1": 3.0, "a_2": 2.0, "b_0": 1.2, "b_1": -0.5, "c_2": 0.2, "c_3": 0.05}.items():
            assert found.values[name] == pytest.approx(value, rel=1e-8), name
        v = np.linspace(-1.0, 1.0, 21)
        np.testing.assert_allclose(found.nonlinearity(v), cubic(1.2 * v), atol=1e-8)

    def test_the_structure_is_found(self):
        found = fit(second={"structure": "search", "largest_n": 3}, tolerance=1e-10, max_iterations=200)
        assert (found.values["n"], found.values["m"]) == (2.0, 1.0)
        assert found.values["a_3"] == found.values["b_2"] == 0.0
        search = found.details["structure"]
        assert (search.n[search.chosen], search.m[search.chosen]) == (2, 1)

    def test_the_loop_corrects_a_wrong_first_structure(self):
        changes = {
            "first": {"n": 1, "m": 0, "horizon": 12},
            "second": {"structure": "search", "largest_n": 3},
        }
        once, looped = fit(**changes), fit(**changes, automatic=True)
        assert once.values["first_a_2"] == 0.0
        assert looped.values["first_a_2"] == pytest.approx(2.0, rel=0.01)

    def test_a_collapsing_start_is_restarted_from_the_linear_model(self):
        made = record(duration=60.0, dt=0.02)
        found, data = fit(made), wiener(made)
        points = np.array([[SEGMENTS.lower], [SEGMENTS.upper]])
        from_y, restarted = (
            iterate(data, FourSegments.of_points(data, points, x), Rule())
            for x in (data.y, data.linear_output())
        )
        assert not from_y.admissible[0]
        a, _, c = data.split(from_y.theta)
        assert np.all(time_constants(a).real > 0.0)
        assert not np.all(1.0 - c > 0.0)
        np.testing.assert_array_equal(found.details["history"].a, data.split(restarted.path[:, 0])[0])
        assert found.values["iterations"] == 25.0
        assert found.values["a_1"] == pytest.approx(3.0, rel=0.01)

    def test_the_second_stage_lasts_one_settling_time(self):
        found = fit()
        assert found.values["horizon"] == pytest.approx(found.values["settling_time"], abs=0.05)

    def test_without_a_second_stage_the_first_is_the_estimate(self):
        found = fit(second=None)
        assert found.values["a_2"] == found.values["first_a_2"]
        assert found.values["vif_max"] == found.values["first_vif_max"]
        assert found.values["horizon"] == 12.0

    def test_the_response_is_that_of_the_estimated_parts(self):
        data = record()
        found = fit(data, tolerance=1e-10, max_iterations=200)
        np.testing.assert_allclose(found.response(data.u, data.dt), data.y, atol=1e-6)
        v, y = found.details["internal_variable"]
        np.testing.assert_allclose(found.nonlinearity(v), y, atol=1e-6)


class TestTheHistory:
    def test_the_history_ends_with_the_estimate(self):
        found = fit()
        history = found.details["history"]
        assert history.converged
        assert found.values["converged"] == 1.0
        for name in ("a_1", "a_2", "b_0", "b_1"):
            assert len(history.values[name]) == found.values["iterations"] + 1
            assert history.values[name][-1] == found.values[f"first_{name}"]
        assert history.values["e_2"][-1] == found.values["e_2"]

    def test_few_iterations_are_said_not_to_have_converged(self):
        found = fit(max_iterations=3, unconverged="keep")
        assert found.values["converged"] == 0.0
        assert found.values["iterations"] == 3.0
        assert not found.details["history"].converged
        with pytest.raises(EstimationError, match=r"^the iteration has not converged in 3 iterations: allow"):
            fit(max_iterations=3)

    @settings(deadline=None, derandomize=True, max_examples=8)
    @given(time=st.floats(0.01, 100.0), output=st.floats(0.01, 100.0), source=st.floats(0.01, 100.0))
    def test_the_units_do_not_matter(self, time, output, source):
        data = record(dt=0.1)
        here = fit(data)
        there = spec(
            nonlinearity={"kind": "four_segment", "partition": [-0.6 * output, 0.5 * output]},
            delay=0.4 * time,
            first={"n": 2, "m": 1, "horizon": 12 * time},
        ).fit(Record(source * data.u, output * data.y, data.dt * time), None)
        expected = {
            "a_1": time,
            "a_2": time**2,
            "b_0": output / source,
            "b_1": output / source * time,
            "e_2": 1.0,
        }
        for name, unit in expected.items():
            assert there.values[name] == pytest.approx(here.values[name] * unit, rel=1e-6), name
        assert there.values["iterations"] == here.values["iterations"]


class TestTheSearch:
    def test_finds_the_break_points(self):
        found = fit(record(dt=0.1), nonlinearity={"kind": "four_segment"})
        assert found.values["y_-1"] == pytest.approx(-0.6, abs=0.12)
        assert found.values["y_1"] == pytest.approx(0.5, abs=0.12)
        assert found.values["a_1"] == pytest.approx(3.0, rel=0.05)

    def test_the_loss_is_the_integral_of_the_squared_output_error(self):
        data = record(dt=0.1)
        found = fit(data, nonlinearity={"kind": "four_segment"}, second=None)
        error = data.y - found.response(data.u, data.dt)
        assert found.details["partition"].best_loss == pytest.approx(data.dt * error @ error, rel=1e-6)

    def test_example_2_of_the_paper(self):
        """Case E: the medians of nine runs lie near the truth, and multicollinearity goes in stage 2."""
        data = Data.model_validate(EXAMPLE_2)
        runs = []
        for trial in range(9):
            with suppress(EstimationError):
                runs.append(spec(**CASE_E).fit(generate(data, 7, trial), None).values)
        assert len(runs) >= 8
        medians = {name: np.median([values[name] for values in runs]) for name in runs[0]}
        assert medians["a_1"] == pytest.approx(4.0, rel=0.05)
        assert medians["a_2"] == pytest.approx(5.0, rel=0.05)
        assert medians["b_1"] / medians["b_0"] == pytest.approx(-2.0, rel=0.1)
        assert 5.0 * medians["vif_max"] < medians["first_vif_max"]
        assert medians["converged"] == 1.0


class TestSmoothing:
    def test_means_of_equal_clusters_in_order(self):
        v, y = np.array([3.0, 1.0, 2.0, 4.0]), np.array([30.0, 10.0, 20.0, 50.0])
        np.testing.assert_array_equal(smoothed(v, y, 2), [[1.5, 3.5], [15.0, 40.0]])

    def test_clusters_at_one_place_are_one(self):
        assert smoothed(np.zeros(9), np.arange(9.0), 3).shape == (2, 1)

    def test_the_smoothed_points_can_be_the_estimate(self):
        data = record(cubic)
        noisy = replace(data, y=data.y + 0.05 * np.random.default_rng(1).standard_normal(len(data)))
        straight, smooth = fit(noisy), fit(noisy, smooth=20)
        points = smooth.details["smoothed"]
        assert points.shape == (2, 20)
        np.testing.assert_allclose(smooth.nonlinearity(points[0]), points[1], atol=1e-12)
        v = np.quantile(smooth.details["internal_variable"][0], np.linspace(0.05, 0.95, 41))
        errors = [np.abs(found.nonlinearity(v) - cubic(1.2 * v)).max() for found in (smooth, straight)]
        assert errors[0] < 0.5 * errors[1]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"weight": 1.5}, "less than or equal to 1"),
        ({"weight": -0.1}, "greater than or equal to 0"),
        ({"delay": -1}, "greater than or equal to 0"),
        ({"first": {"n": 2, "m": 2, "horizon": 12}}, "m must be below n = 2, not 2"),
        (
            {"nonlinearity": {"kind": "four_segment", "partition": [0.1, 0.5]}},
            r"must be \[lower, upper\] with lower < 0 < upper, zero being the steady state, not \[0.1, 0.5\]",
        ),
        ({"automatic": True}, "'automatic' needs a second stage with 'structure: search'"),
        ({"nonlinearity": {"kind": "polynomial", "degree": 1}}, "greater than or equal to 2"),
        ({"smooth": 1}, "greater than or equal to 2"),
    ],
)
def test_settings_that_cannot_work_are_refused(changes, message):
    with pytest.raises(ValidationError, match=message):
        spec(**changes)


@pytest.mark.parametrize(
    ("samples", "dt", "message"),
    [
        (2001, None, "a continuous-time method needs the sampling interval 'dt' of the data"),
        (201, 0.05, "the horizon 12 is too long for the record"),
        (301, 0.05, "2 horizons are fewer than the 7 parameters"),
        (2001, 2.0, "the horizon 12 holds 6 sampling intervals of 2, and order 2 needs 12"),
    ],
)
def test_records_that_do_not_suit_are_refused(samples, dt, message):
    with pytest.raises(ValueError, match=message):
        spec().check(samples, dt)
    with pytest.raises(EstimationError, match=message):
        spec().fit(Record(np.ones(samples), np.ones(samples), dt), None)


class TestHopelessRecords:
    def test_partition_points_outside_the_data(self):
        hopeless = spec(nonlinearity={"kind": "four_segment", "partition": [-0.6, 50]})
        message = (
            r"partition points \[-0.6, 50\] must lie inside the output's range \[.*\]: move them, or let"
        )
        with pytest.raises(EstimationError, match=message):
            hopeless.check_record(record())
        with pytest.raises(EstimationError, match=message):
            hopeless.fit(record(), None)
        spec().check_record(record())

    def test_an_output_of_one_sign_has_no_partition(self):
        data = record()
        with pytest.raises(EstimationError, match="on both sides of zero; subtract the steady state"):
            fit(replace(data, y=data.y + 100.0), nonlinearity={"kind": "four_segment"})

    def test_an_input_at_rest(self):
        data = record()
        with pytest.raises(EstimationError, match="met linearly dependent regressors or diverged"):
            fit(replace(data, u=np.zeros(len(data))))

    def test_no_pair_is_admissible(self):
        data = record()
        with pytest.raises(EstimationError, match="no pair of partition points gives a stable linear block"):
            fit(replace(data, u=np.zeros(len(data))), nonlinearity={"kind": "four_segment"})

    def test_the_trivial_solution(self):
        message = (
            "the first stage's iteration fell to the trivial solution x = 0, also from the linear model's "
            "output: try longer horizons, another structure or other partition points"
        )
        with pytest.raises(EstimationError, match=message):
            fit(nonlinearity={"kind": "four_segment", "partition": [-0.01, 0.01]})

    def test_slopes_that_are_not_positive(self):
        with pytest.raises(
            EstimationError, match="iteration ended in slopes e_i that are not all positive, also"
        ):
            fit(nonlinearity={"kind": "four_segment", "partition": [-0.05, 0.05]})

    def test_an_unstable_block(self):
        data = record(duration=60.0)
        growing = lfilter([0.0, data.dt], [1.0, -np.exp(0.03 * data.dt)], data.u)
        with pytest.raises(EstimationError, match="iteration ended in an unstable linear block, also"):
            fit(
                replace(data, y=growing),
                nonlinearity={"kind": "polynomial", "degree": 2},
                delay=0,
                first={"n": 1, "m": 0, "horizon": 12},
            )
