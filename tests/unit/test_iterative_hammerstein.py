"""The two-stage algorithm for continuous-time Hammerstein systems, its searches and its standard errors."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from hident.errors import EstimationError
from hident.estimators.moving_horizon.hammerstein import iterative_hammerstein
from hident.estimators.moving_horizon.hammerstein.iteration import iterate
from hident.estimators.moving_horizon.hammerstein.iterative_hammerstein import IterativeHammerstein
from hident.estimators.moving_horizon.hammerstein.stage import first_stage
from hident.estimators.moving_horizon.hammerstein.static_functions import (
    PolynomialFunction,
    ThreeSegmentFunction,
    powers,
    three_segments,
)
from hident.estimators.moving_horizon.transform.horizon_least_squares import solve
from hident.estimators.moving_horizon.transform.sandwich import standard_errors
from hident.linear_blocks import ContinuousTransferFunction
from hident.records import Record
from hident.systems.nonlinearity import ChenType1
from tests.unit.multisteps import BLOCK, CUBIC, THREE_SEGMENTS, levels, record

RNG = np.random.default_rng(0)
QUICK = settings(deadline=None, derandomize=True, max_examples=10)
FINE: dict[str, Any] = {"dt": 0.02, "duration": 50.0}
MATCHED = {"kind": "three_segment", "partition": [-0.8, 0.6]}
THIRD_DEGREE = {"kind": "polynomial", "degree": 3}
SEARCHED = {"kind": "three_segment"}
TRUTH = {**BLOCK.values(), **{f"c_{j}": c for j, c in enumerate(THREE_SEGMENTS.c, start=1)}}
DYNAMICS = ("a_1", "a_2", "a_3", "b_1")


def spec(nonlinearity=MATCHED, **fields):
    """Both stages with the true structure, unless told otherwise."""
    known = {"n": 3, "m": 1}
    both = {"first": {**known, "horizon": 15}, "second": known, "delay": 2, "start": 2.5}
    return IterativeHammerstein.model_validate({"nonlinearity": nonlinearity, **both, **fields})


def fitted(made, nonlinearity=MATCHED, **fields):
    return spec(nonlinearity, **fields).fit(made, RNG)


class TestStaticFunctions:
    U = np.linspace(-3, 3, 61)

    @QUICK
    @given(c=st.lists(st.floats(-2, 2), min_size=5, max_size=5), lower=st.floats(-2, -0.1))
    def test_three_segments_join_and_are_straight_outside(self, c, lower):
        f = ThreeSegmentFunction(tuple(c), lower, 0.7)
        inside = self.U[(lower < self.U) & (self.U < 0.7)]
        np.testing.assert_allclose(f(inside), np.polyval([c[2], c[1], c[0], 0.0], inside), atol=1e-12)
        for point, slope, away in ((lower, c[4], -1.0), (0.7, c[3], 1.0)):
            edge = np.polyval([c[2], c[1], c[0], 0.0], point)
            beyond = point + away * np.array([0.0, 0.5, 2.0])
            np.testing.assert_allclose(f(beyond), edge + slope * (beyond - point), atol=1e-12)
        assert f(np.zeros(1))[0] == 0.0

    def test_partition_points_broadcast(self):
        lower, upper = np.array([-1.0, -0.5, -2.0]), np.array([0.5, 1.0, 2.0])
        found = three_segments(self.U[:, None], lower, upper)
        assert found.shape == (61, 3, 5)
        for j in range(3):
            np.testing.assert_array_equal(found[:, j], three_segments(self.U, lower[j], upper[j]))

    def test_powers(self):
        np.testing.assert_allclose(powers(self.U, 3), np.column_stack((self.U, self.U**2, self.U**3)))
        np.testing.assert_allclose(CUBIC(self.U), np.polyval([-0.2, 0.3, 1.0, 0.0], self.U), atol=1e-13)
        np.testing.assert_allclose(CUBIC.basis(self.U) @ CUBIC.c, CUBIC(self.U))


class TestIteration:
    @staticmethod
    def transforms(stack, m, p=3, rows=30, n=2):
        rng = np.random.default_rng(stack)
        y, initial = rng.normal(size=(n + 1, rows)), rng.normal(size=(m + 1, rows))
        return y, rng.normal(size=(stack, m + 1, rows, p)), initial

    @pytest.mark.parametrize("m", [0, 1])
    def test_is_equations_25_and_27(self, m):
        y, basis, initial = self.transforms(4, m)
        found = iterate(y, basis, initial, m=m, tolerance=1e-30, max_iterations=3)
        for b, functions in enumerate(basis):
            derivatives = initial[1:]
            for _ in range(3):
                phi = np.column_stack((*-y[1:], *derivatives, functions[0]))
                theta = solve(phi, y[0])
                derivatives = functions[1:] @ theta[-3:]
            np.testing.assert_allclose(found.theta[b], theta, rtol=1e-9)
            assert found.loss[b] == pytest.approx(np.sum((y[0] - phi @ theta) ** 2), rel=1e-9)
        assert found.iterations.tolist() == [3 if m else 1] * 4
        assert found.converged.tolist() == [m == 0] * 4
        assert found.history.shape == (3 if m else 1, 2 + m + 3)
        np.testing.assert_array_equal(found.history[-1], found.theta[0])

    def test_one_singular_function_leaves_the_others(self):
        y, basis, initial = self.transforms(3, 1)
        basis[1, ..., 1] = basis[1, ..., 0]
        found = iterate(y, basis, initial, m=1, tolerance=1e-3, max_iterations=4)
        alone = iterate(y, basis[[2]], initial, m=1, tolerance=1e-3, max_iterations=4)
        assert not np.all(np.isfinite(found.theta[1]))
        assert not np.isfinite(found.loss[1])
        assert not found.converged[1]
        np.testing.assert_allclose(found.theta[2], alone.theta[0], rtol=1e-9)
        assert found.iterations[2] == alone.iterations[0]


class TestRecovery:
    def test_of_a_three_segment_function_is_exact(self):
        found = fitted(record(**FINE), tolerance=1e-12)
        values = found.values
        assert {name: values[name] for name in TRUTH} == pytest.approx(TRUTH, abs=1e-8)
        first = {name.removeprefix("first_"): v for name, v in values.items() if name.startswith("first_a")}
        assert first == pytest.approx({name: TRUTH[name] for name in first}, abs=1e-8)
        assert (values["n"], values["m"], values["converged"]) == (3.0, 1.0, 1.0)
        assert (values["u_-1"], values["u_1"]) == (-0.8, 0.6)
        assert values["settling_time"] == pytest.approx(10.8077, abs=1e-3)
        assert values["horizon"] == pytest.approx(values["settling_time"] / 2, abs=0.02)
        assert found.continuous.delay == 2.0

    def test_of_a_polynomial_is_exact(self):
        values = fitted(record(f=CUBIC, **FINE), THIRD_DEGREE, tolerance=1e-12).values
        truth = {**BLOCK.values(), "c_1": 1.0, "c_2": 0.3, "c_3": -0.2}
        assert {name: values[name] for name in truth} == pytest.approx(truth, abs=1e-8)

    def test_without_a_second_stage_the_first_is_the_estimate(self):
        values = fitted(record(**FINE), second=None, tolerance=1e-12).values
        assert {name: values[name] for name in TRUTH} == pytest.approx(TRUTH, abs=1e-8)
        assert values["horizon"] == 15.0

    def test_a_numerator_of_order_zero_needs_no_iteration(self):
        block = ContinuousTransferFunction((1.0,), (2.0, 1.5), 0.4)
        plain = {"first": {"n": 2, "horizon": 8}, "second": {"n": 2}, "delay": 0.4, "start": 0.4}
        values = fitted(record(f=CUBIC, block=block, **FINE), THIRD_DEGREE, **plain).values
        assert (values["iterations"], values["converged"]) == (1.0, 1.0)
        assert [values["a_1"], values["a_2"], values["c_3"]] == pytest.approx([2.0, 1.5, -0.2], abs=1e-8)

    def test_of_a_wrong_first_structure_is_mended_by_the_second_stage(self):
        made = record(f=ChenType1(), nsr=0.1)
        values = fitted(made, {"kind": "polynomial", "degree": 5}, first={"n": 2, "horizon": 15}).values
        assert values["first_a_3"] == values["first_b_1"] == 0.0
        assert [values[name] for name in DYNAMICS] == pytest.approx([4, 4, 3, -1], abs=0.6)

    def test_the_response_is_that_of_the_model(self):
        made = record(**FINE)
        found = fitted(made, tolerance=1e-12)
        np.testing.assert_allclose(found.response(made.u, made.dt), made.y, atol=1e-8)
        coarse = levels(9, 200)
        np.testing.assert_allclose(
            found.response(coarse, 0.3), BLOCK.respond(THREE_SEGMENTS(coarse), 0.3), atol=1e-8
        )

    def test_the_history_ends_at_the_first_stage_s_estimate(self):
        found = fitted(record(**FINE))
        history = found.details["history"]
        count = int(found.values["iterations"])
        assert history.converged
        assert set(history.values) == set(TRUTH)
        assert {len(values) for values in history.values.values()} == {count}
        assert history.values["a_3"][-1] == found.values["first_a_3"]
        np.testing.assert_array_equal(history.values["b_0"], 1.0)
        stopped = fitted(record(**FINE), max_iterations=2, unconverged="keep")
        assert not stopped.details["history"].converged
        assert (stopped.values["iterations"], stopped.values["converged"]) == (2.0, 0.0)

    def test_an_iteration_that_has_not_converged_fails(self):
        with pytest.raises(EstimationError, match=r"^the iteration has not converged in 2 iterations: allow"):
            fitted(record(**FINE), max_iterations=2)

    def test_gives_what_it_provides(self):
        for fields in (
            {},
            {"second": None},
            {"nonlinearity": THIRD_DEGREE},
            {"nonlinearity": SEARCHED, "second": {"structure": "search"}},
        ):
            estimator = spec(**fields)
            found = estimator.fit(record(nsr=0.1), RNG)
            names = {
                name.removeprefix("value ") for name in estimator.provides() if name.startswith("value ")
            }
            assert set(found.values) == names


class TestInvariances:
    @QUICK
    @given(tau=st.floats(1e-4, 1e4))
    def test_the_unit_of_time_scales_the_parameters(self, tau):
        made = record(nsr=0.1)
        plain = fitted(made).values
        times = {"delay": 2 * tau, "start": 2.5 * tau, "first": {"n": 3, "m": 1, "horizon": 15 * tau}}
        scaled = fitted(replace(made, dt=made.dt * tau), **times).values
        for name, power in (("a_1", 1), ("a_2", 2), ("a_3", 3), ("b_1", 1), ("settling_time", 1), ("c_3", 0)):
            assert scaled[name] == pytest.approx(plain[name] * tau**power, rel=1e-5)
        for name in ("vif_max", "first_vif_max", "condition"):
            assert scaled[name] == pytest.approx(plain[name], rel=1e-4)
        assert scaled["se_a_3"] == pytest.approx(plain["se_a_3"] * tau**3, rel=1e-4)

    @QUICK
    @given(gain=st.floats(-100, 100).filter(lambda gain: abs(gain) > 0.01))
    def test_the_unit_of_the_output_scales_the_function_alone(self, gain):
        made = record(nsr=0.1)
        plain = fitted(made, tolerance=1e-9).values
        scaled = fitted(replace(made, y=gain * made.y), tolerance=1e-9).values
        for name in (*DYNAMICS, "se_a_3", "se_b_1", "settling_time", "vif_max"):
            assert scaled[name] == pytest.approx(plain[name], rel=1e-5)
        for j in range(1, 6):
            assert scaled[f"c_{j}"] == pytest.approx(gain * plain[f"c_{j}"], rel=1e-5)


class TestStandardErrors:
    @staticmethod
    def derivative(monkeypatch, made, **fields):
        """The derivative (P, N) of the parameters by the output's samples that the standard errors use."""
        seen = []

        def spy(derivative, residual):
            seen.append(derivative)
            return standard_errors(derivative, residual)

        monkeypatch.setattr(iterative_hammerstein, "standard_errors", spy)
        found = fitted(made, tolerance=1e-13, **fields)
        return seen[0], np.array([found.values[name] for name in DYNAMICS])

    @pytest.mark.parametrize("second", [{"n": 3, "m": 1}, None])
    def test_the_influence_is_the_derivative_by_single_samples(self, monkeypatch, second):
        made, step = record(dt=0.05, duration=60.0), 1e-6
        derivative, plain = self.derivative(monkeypatch, made, second=second)
        for k in (50, 213, 700, 1190):
            y = made.y.copy()
            y[k] += step
            moved = self.derivative(monkeypatch, replace(made, y=y), second=second)[1]
            np.testing.assert_allclose(
                derivative[:4, k], (moved - plain) / step, rtol=0, atol=1e-5 * np.abs(derivative[:4]).max()
            )

    @staticmethod
    def coverage(nsr, trials):
        """The percentage of 95 % intervals that hold the truth, for each parameter of the linear block."""
        inside = []
        for seed in range(trials):
            values = fitted(record(seed, nsr=nsr)).values
            inside.append([abs(values[x] - TRUTH[x]) <= 1.96 * values[f"se_{x}"] for x in DYNAMICS])
        return 100.0 * np.mean(inside, axis=0)

    def test_intervals_hold_the_truth_as_often_as_they_say(self):
        found = self.coverage(0.02, 200)
        assert np.all((found >= 90.0) & (found <= 99.0)), found

    def test_strong_noise_in_the_regressors_costs_some_coverage(self):
        found = self.coverage(0.1, 200)
        assert np.all((found >= 85.0) & (found <= 99.0)), found
        assert found.mean() < 95.0

    def test_searched_partition_points_count_as_given(self):
        made = record(nsr=0.1)
        searched = fitted(made, SEARCHED).values
        given = fitted(
            made, {"kind": "three_segment", "partition": [searched["u_-1"], searched["u_1"]]}
        ).values
        assert {name: searched[f"se_{name}"] for name in DYNAMICS} == pytest.approx(
            {name: given[f"se_{name}"] for name in DYNAMICS}
        )

    def test_parameters_that_the_structure_lacks_have_none(self):
        values = fitted(record(nsr=0.1), second={"structure": "search"}).values
        assert (values["n"], values["m"]) == (3.0, 1.0)
        assert values["se_a_4"] == values["se_b_2"] == values["se_b_3"] == 0.0
        assert min(values[f"se_{name}"] for name in DYNAMICS) > 0.0


class TestSearches:
    def structures(self, nonlinearity, **fields):
        found = [
            fitted(record(seed, ChenType1(), nsr=0.1), nonlinearity, **fields).values for seed in range(20)
        ]
        return [(values["n"], values["m"]) for values in found]

    def test_the_second_stage_finds_the_structure(self):
        guess = {"n": 2, "horizon": 15}
        found = self.structures(
            {"kind": "polynomial", "degree": 5}, first=guess, second={"structure": "search"}
        )
        assert found.count((3, 1)) >= 18

    def test_the_loop_finds_the_structure_from_a_wrong_guess(self):
        guess = {"n": 2, "m": 0, "horizon": 15}
        found = self.structures(SEARCHED, automatic=True, first=guess, second={"structure": "search"})
        assert found.count((3, 1)) >= 18

    def test_the_loop_ends_where_the_structure_of_both_stages_is_one(self):
        made = record(3, ChenType1(), nsr=0.1)
        search = {"structure": "search"}
        looped = fitted(made, automatic=True, first={"n": 2, "horizon": 15}, second=search).values
        assert looped == pytest.approx(fitted(made, second=search).values, rel=1e-9)

    def test_the_loop_goes_on_until_the_structure_repeats(self, monkeypatch):
        stages = []

        def spy(u, y, dt, nonlinearity, stage, **options):
            stages.append((nonlinearity.kind, stage.n, stage.m))
            return first_stage(u, y, dt, nonlinearity, stage, **options)

        monkeypatch.setattr(iterative_hammerstein, "first_stage", spy)
        poor = {"n": 1, "horizon": 8}
        made = record(1, ChenType1(), nsr=0.1)
        values = fitted(made, SEARCHED, automatic=True, first=poor, second={"structure": "search"}).values
        assert stages == [("polynomial", 1, 0), ("three_segment", 3, 2), ("three_segment", 3, 1)]
        assert (values["n"], values["m"]) == (3.0, 1.0)

    def test_the_partition_points_of_a_saturation_are_near_its_bends(self):
        found = [fitted(record(seed, ChenType1(), nsr=0.1), SEARCHED).values for seed in range(10)]
        assert np.median([values["u_-1"] for values in found]) == pytest.approx(-0.5, abs=0.15)
        assert np.median([values["u_1"] for values in found]) == pytest.approx(0.5, abs=0.15)

    def test_without_noise_refinements_close_in_on_the_true_points(self):
        made = record(dt=0.05)
        found = [
            fitted(made, {**SEARCHED, "points": 8, "refinements": count}).details["partition"]
            for count in range(4)
        ]
        losses = [search.best_loss for search in found]
        assert losses == sorted(losses, reverse=True)
        assert losses[-1] < 0.2 * losses[0]
        np.testing.assert_allclose(found[-1].best, (-0.8, 0.6), atol=0.05)

    def test_the_surface_is_that_of_the_first_grid(self):
        made = record(nsr=0.1)
        search = fitted(made, {**SEARCHED, "points": 5, "refinements": 0}).details["partition"]
        assert search.loss.shape == (5, 5)
        np.testing.assert_allclose(search.lower, made.u.min() * np.arange(1, 6) / 6)
        np.testing.assert_allclose(search.upper, made.u.max() * np.arange(1, 6) / 6)
        i, j = np.unravel_index(np.argmin(search.loss), (5, 5))
        assert search.best == (search.lower[i], search.upper[j])
        assert search.best_loss == search.loss[i, j]

    def test_the_second_stage_may_search_for_the_delay(self):
        second = {"structure": "search", "delays": [1.8, 2.0, 2.2]}
        found = fitted(record(nsr=0.05), second=second)
        assert found.values["delay"] == found.continuous.delay == 2.0
        assert len(found.details["structure"].error) == 30


class TestFailures:
    def test_two_levels_cannot_tell_the_terms_of_a_polynomial_apart(self):
        made = record()
        u = np.where(made.u > 0, 1.0, -1.0)
        with pytest.raises(
            EstimationError, match=r"^the regressors over the horizons are linearly dependent$"
        ):
            fitted(Record(u, BLOCK.respond(u, 0.1), 0.1), THIRD_DEGREE)

    def test_two_levels_cannot_tell_partition_points_apart(self):
        made = record()
        u = np.where(made.u > 0, 1.0, -1.0)
        with pytest.raises(
            EstimationError, match=r"^no partition points give a regression that is not singular$"
        ):
            fitted(Record(u, BLOCK.respond(u, 0.1), 0.1), SEARCHED)

    @pytest.mark.parametrize("nonlinearity", [SEARCHED, MATCHED])
    def test_inputs_of_one_sign(self, nonlinearity):
        made = record()
        message = (
            "the input ranges from 0.5 to 2: "
            "partition points need values on both sides of zero; subtract the steady state"
        )
        one_sided = replace(made, u=np.clip(made.u, 0.5, 2.0))
        with pytest.raises(EstimationError, match=f"^{message}$"):
            fitted(one_sided, nonlinearity)
        with pytest.raises(EstimationError, match=f"^{message}$"):
            spec(nonlinearity).check_record(one_sided)

    def test_partition_points_outside_the_inputs(self):
        made = record()
        narrow = replace(made, u=np.clip(made.u, -0.7, 1.5))
        message = re.escape(
            "the partition points [-0.8, 0.6] must lie inside the input's range [-0.7, 1.5]: "
            "move them, or let 'partition: search' find them"
        )
        with pytest.raises(EstimationError, match=message):
            spec().check_record(narrow)
        with pytest.raises(EstimationError, match=message):
            fitted(narrow)
        spec(SEARCHED).check_record(narrow)
        spec(THIRD_DEGREE).check_record(narrow)

    @pytest.mark.parametrize(
        ("y", "message"),
        [
            (np.zeros(1001), "the output is zero throughout"),
            (np.full(1001, np.nan), "the output has 1001 of 1001 samples that are not finite"),
        ],
    )
    def test_outputs_that_hold_nothing(self, y, message):
        with pytest.raises(EstimationError, match=f"^{message}$"):
            fitted(replace(record(), y=y))

    def test_a_first_block_that_never_settles(self):
        made = record()
        growing = replace(made, y=np.exp(0.1 * 0.1 * np.arange(1001.0)) + 0.01 * made.y)
        with pytest.raises(
            EstimationError,
            match=r"^the first stage's block is unstable or has no static gain: it never settles$",
        ):
            fitted(growing, THIRD_DEGREE, first={"n": 1, "horizon": 15})

    def test_records_that_do_not_suit(self):
        made = record()
        with pytest.raises(EstimationError, match=r"^a continuous-time method needs the sampling interval"):
            fitted(replace(made, dt=None))
        with pytest.raises(EstimationError, match=r"^the horizon 15 is too long for the record: it spans"):
            fitted(Record(made.u[:150], made.y[:150], 0.1))


class TestMessages:
    @pytest.mark.parametrize(
        ("fields", "message"),
        [
            (
                {"nonlinearity": {"kind": "three_segment", "partition": [0.1, 0.6]}},
                "must be [lower, upper] with lower < 0 < upper, zero being the steady state, not [0.1, 0.6]",
            ),
            (
                {"nonlinearity": {"kind": "three_segment", "partition": [-0.1, 0]}},
                "must be [lower, upper] with lower < 0 < upper, zero being the steady state, not [-0.1, 0]",
            ),
            ({"nonlinearity": {"kind": "three_segment", "points": 1}}, "must be greater than or equal to 2"),
            ({"nonlinearity": {"kind": "polynomial", "degree": 0}}, "must be greater than or equal to 1"),
            ({"automatic": True}, "'automatic' needs a second stage with 'structure: search'"),
            (
                {"automatic": True, "second": None},
                "'automatic' needs a second stage with 'structure: search'",
            ),
            ({"tolerance": 0}, "must be greater than 0"),
            ({"max_iterations": 0}, "must be greater than or equal to 1"),
            ({"delay": -1}, "must be greater than or equal to 0"),
        ],
    )
    def test_of_the_spec(self, fields, message):
        with pytest.raises(ValidationError, match=re.escape(message)):
            spec(**fields)

    @pytest.mark.parametrize(
        ("fields", "samples", "dt", "message"),
        [
            ({}, 1001, None, "a continuous-time method needs the sampling interval 'dt' of the data"),
            ({}, 101, 1.0, "the horizon 15 holds 15 sampling intervals of 1, and order 3 needs 16"),
            ({}, 101, 0.1, "the horizon 15 is too long for the record"),
            ({}, 301, 0.1, "8 horizons are fewer than the 9 parameters"),
            (
                {"second": {"n": 3, "horizon": 1}},
                1001,
                0.1,
                "the horizon 1 holds 10 sampling intervals of 0.1, and order 3 needs 16",
            ),
        ],
    )
    def test_of_records_that_do_not_suit(self, fields, samples, dt, message):
        spec().check(1001, 0.1)
        with pytest.raises(ValueError, match=f"^{re.escape(message)}"):
            spec(**fields).check(samples, dt)

    def test_a_polynomial_function_has_as_many_coefficients_as_its_degree(self):
        assert spec(THIRD_DEGREE).function_parameters() == 3
        assert spec(MATCHED).function_parameters() == 5
        assert isinstance(fitted(record(), THIRD_DEGREE).nonlinearity, PolynomialFunction)
