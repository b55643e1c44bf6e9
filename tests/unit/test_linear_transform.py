"""A linear block from a known input: exact recovery, the search for its structure, its messages."""

import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from hident.errors import EstimationError
from hident.estimators.moving_horizon.transform.linear_transform import (
    Measured,
    SecondStageSpec,
    StageSpec,
    block_of,
    linear_block,
    search_structure,
)
from hident.estimators.moving_horizon.transform.sandwich import influence, standard_errors
from hident.linear_blocks import ContinuousTransferFunction
from tests.unit.multisteps import BLOCK, levels, record

QUICK = settings(deadline=None, derandomize=True, max_examples=20)
FINE: dict[str, Any] = {"dt": 0.02, "duration": 50.0}
GIVEN: dict[str, Any] = {"n": 3, "m": 1, "delay": 2.0, "eta": 5.4, "overlap": 0.1, "start": 2.5}
OF_SEARCH: dict[str, Any] = {"largest_n": 4, "delays": [2.0], "eta": 5.4, "overlap": 0.1, "start": 2.5}


def data(seed=0, *, block=BLOCK, **options):
    """The output and the held input of a linear block, and the sampling interval."""
    made = record(seed, np.positive, block=block, **options)
    return made.y, made.u, made.dt


def parameters(block):
    return np.array([*block.a, *block.b])


class TestRecovery:
    @pytest.mark.parametrize("gain", [None, 1.0])
    def test_of_example_1_is_exact(self, gain):
        fit = linear_block(*data(**FINE), **GIVEN, gain=gain)
        np.testing.assert_allclose(parameters(fit.block), parameters(BLOCK), atol=1e-9)
        assert fit.block.delay == 2.0
        assert fit.phi.shape == (fit.horizons.count, 4 + (gain is None))
        if gain is not None:
            assert fit.block.b[0] == gain

    @QUICK
    @given(
        poles=st.lists(st.floats(0.3, 1.5), min_size=1, max_size=3),
        b=st.tuples(st.floats(0.5, 2), st.floats(-2, 2)),
        delay=st.integers(0, 150),
    )
    def test_of_any_block_is_exact(self, poles, b, delay):
        falling = np.poly([-p for p in poles])
        n, dt = len(poles), 0.02
        b = b[:n]
        block = ContinuousTransferFunction(b, tuple((falling / falling[-1])[-2::-1]), delay * dt)
        fit = linear_block(
            *data(1, block=block, **FINE),
            n=n,
            m=len(b) - 1,
            delay=block.delay,
            eta=6.0,
            overlap=0.1,
            start=block.delay,
        )
        # Poles that nearly coincide with the zero leave the parameters nearly undetermined.
        np.testing.assert_allclose(
            fit.block.respond(levels(2, 400), 0.1), block.respond(levels(2, 400), 0.1), atol=1e-7
        )

    def test_of_more_than_there_is_finds_zeros(self):
        fit = linear_block(*data(**FINE), **{**GIVEN, "m": 2})
        np.testing.assert_allclose(fit.block.b, [1.0, -1.0, 0.0], atol=1e-7)

    def test_with_a_delay_off_the_samples_is_good_but_not_exact(self):
        block = ContinuousTransferFunction(BLOCK.b, BLOCK.a, 2.013)
        fit = linear_block(*data(block=block, **FINE), **{**GIVEN, "delay": 2.013})
        error = np.max(np.abs(parameters(fit.block) - parameters(BLOCK)))
        assert 1e-9 < error < 1e-3

    @QUICK
    @given(tau=st.floats(1e-4, 1e4), gain=st.floats(-9, 9).filter(lambda g: abs(g) > 0.1))
    def test_follows_the_units_of_time_and_output(self, tau, gain):
        y, u, dt = data(nsr=0.1)
        fit = linear_block(y, u, dt, **GIVEN).block
        times = {name: GIVEN[name] * tau for name in ("delay", "eta", "start")}
        scaled = linear_block(gain * y, u, dt * tau, **{**GIVEN, **times}).block
        np.testing.assert_allclose(scaled.a, np.array(fit.a) * tau ** np.arange(1, 4), rtol=1e-6)
        np.testing.assert_allclose(scaled.b, gain * np.array(fit.b) * tau ** np.arange(2), rtol=1e-6)

    def test_does_not_change_the_data(self):
        y, u, dt = data()
        y.flags.writeable = u.flags.writeable = False
        linear_block(y, u, dt, **GIVEN)


class TestFailures:
    def test_an_input_that_rests_is_dependent(self):
        with pytest.raises(
            EstimationError, match=r"^the regressors over the horizons are linearly dependent$"
        ):
            linear_block(np.ones(1001), np.ones(1001), 0.1, **GIVEN)

    @pytest.mark.parametrize("a", [[1.0, 0.0], [np.nan, 1.0], [np.inf, 1.0]])
    def test_parameters_that_are_no_block(self, a):
        with pytest.raises(EstimationError, match=r"^the regressors over the horizons are linearly dep"):
            block_of(a, [1.0], 0.0)

    def test_horizons_that_do_not_suit(self):
        with pytest.raises(EstimationError, match=r"^the horizon 1 holds 10 sampling intervals of 0\.1"):
            linear_block(*data(), **{**GIVEN, "eta": 1.0})
        with pytest.raises(EstimationError, match=r"^3 horizons are fewer than the 5 parameters"):
            linear_block(*data(), **{**GIVEN, "eta": 26.0, "overlap": 0.8})

    def test_no_stable_structure(self):
        y = np.exp(0.1 * np.arange(1001) * 0.1)
        with pytest.raises(EstimationError, match=r"^no structure up to n = 1 gives a stable linear block$"):
            search_structure(y, levels(0, 1001), 0.1, **{**OF_SEARCH, "largest_n": 1})


class TestSearch:
    def test_finds_the_structure_of_example_1_in_noise(self):
        found = [search_structure(*data(seed, nsr=0.1), **OF_SEARCH)[0].block for seed in range(20)]
        assert sum((len(block.a), len(block.b) - 1) == (3, 1) for block in found) >= 19

    def test_tells_the_error_of_every_candidate(self):
        y, u, dt = data(nsr=0.1)
        fit, search = search_structure(y, u, dt, **{**OF_SEARCH, "delays": [1.5, 2.0]})
        assert len(search.n) == len(search.m) == len(search.delay) == len(search.error) == 20
        assert np.all(search.m < search.n)
        assert sorted(set(search.delay)) == [1.5, 2.0]
        chosen = search.chosen
        assert (search.n[chosen], search.m[chosen], search.delay[chosen]) == (3, 1, 2.0)
        assert search.error[chosen] == pytest.approx(
            Measured.directly(y).error_of(fit.block, u, dt), rel=1e-12
        )
        near = search.error <= 1.25 * search.error.min()
        assert near[chosen]
        assert (search.n + search.m)[near].min() == 4

    def test_finds_the_delay_off_the_grid_without_noise(self):
        block = ContinuousTransferFunction(BLOCK.b, BLOCK.a, 2.013)
        delays = [1.9, 1.98, 2.013, 2.05]
        fit, _ = search_structure(*data(block=block, **FINE), **{**OF_SEARCH, "delays": delays})
        assert fit.block.delay == 2.013

    def test_the_error_of_the_truth_is_that_of_the_noise(self):
        y, u, dt = data(nsr=0.1)
        measured = Measured.directly(y)
        assert measured.error_of(BLOCK, u, dt) == pytest.approx(0.1, rel=0.1)
        assert measured.error_of(ContinuousTransferFunction((1.0,), (-1.0,)), u, dt) == np.inf


class TestStandardErrors:
    def test_the_influence_is_the_derivative_by_single_samples(self):
        y, u, dt = data()
        fit = linear_block(y, u, dt, **GIVEN)
        onto = np.asarray(np.linalg.pinv(fit.phi), dtype=float)
        derivative = influence(onto, fit.horizons, fit.knots, fit.block.a)
        assert derivative.shape == (5, len(y))
        step, order = 1e-6, [0, 1, 2, 4, 3]
        for k in (25, 26, 300, 999):
            moved = y.copy()
            moved[k] += step
            found = linear_block(moved, u, dt, **GIVEN)
            change = (parameters(found.block) - parameters(fit.block)) / step
            np.testing.assert_allclose(
                derivative[:, k], change[order], rtol=0, atol=1e-5 * np.abs(derivative).max()
            )

    def test_are_those_of_independent_noise(self):
        derivative = np.array([[3.0, 0.0, 4.0], [1.0, 1.0, 1.0]])
        np.testing.assert_allclose(
            standard_errors(derivative, np.array([1.0, -9.0, -1.0])), [5.0, np.sqrt(83)]
        )


class TestSpecs:
    @pytest.mark.parametrize(
        ("fields", "message"),
        [
            ({"n": 2, "m": 2}, "m must be below n = 2, not 2: take m = 1 or less, or a larger n"),
            ({"n": 1, "m": 3}, "m must be below n = 1, not 3: take m = 0 or less, or a larger n"),
            ({"n": 0}, "must be greater than or equal to 1"),
            ({"n": 9}, "must be less than or equal to 8"),
            ({"n": 2, "horizon": 0}, "must be greater than 0"),
            ({"n": 2, "overlap": 0}, "must be greater than 0"),
            ({"n": 2, "overlap": 1.01}, "must be less than or equal to 1"),
        ],
    )
    def test_messages_of_the_first_stage(self, fields, message):
        with pytest.raises(ValidationError, match=re.escape(message)):
            StageSpec.model_validate({"horizon": 5, **fields})

    @pytest.mark.parametrize(
        ("fields", "message"),
        [
            ({}, "give the order 'n', or 'structure: search'"),
            ({"m": 1}, "give the order 'n', or 'structure: search'"),
            ({"n": 2, "m": 2}, "m must be below n = 2, not 2: take m = 1 or less, or a larger n"),
            ({"n": 2, "largest_n": 3}, "only 'structure: search' takes largest_n"),
            ({"n": 2, "largest_n": 3, "delays": [1]}, "only 'structure: search' takes delays and largest_n"),
            ({"structure": "search", "n": 3}, "a search finds n and m: leave out n"),
            ({"structure": "search", "m": 1, "n": 3}, "a search finds n and m: leave out m, n"),
            ({"structure": "guess"}, "must be 'given' or 'search'"),
            ({"n": 2, "overlap": 2}, "must be less than or equal to 1"),
            ({"structure": "search", "delays": [-1]}, "must be greater than or equal to 0"),
        ],
    )
    def test_messages_of_the_second_stage(self, fields, message):
        with pytest.raises(ValidationError, match=re.escape(message)):
            SecondStageSpec.model_validate(fields)

    @pytest.mark.parametrize(
        ("fields", "gain", "parameters"),
        [
            ({"n": 3, "m": 1}, False, 4),
            ({"n": 3, "m": 1}, True, 5),
            ({"structure": "search"}, False, 7),
            ({"structure": "search", "largest_n": 2}, True, 4),
        ],
    )
    def test_given_horizons_must_be_enough_for_all_parameters(self, fields, gain, parameters):
        spec = SecondStageSpec.model_validate({"horizon": 10, "overlap": 1, **fields})
        fits = round(10 * (parameters + 1) / 0.1) + 1
        spec.check(fits, 0.1, 0.0, gain=gain)
        with pytest.raises(
            ValueError, match=f"^{parameters - 1} horizons are fewer than the {parameters} parameters: "
        ):
            spec.check(fits - 100, 0.1, 0.0, gain=gain)

    def test_a_horizon_by_the_settling_time_is_not_checked(self):
        SecondStageSpec(n=3).check(2, 0.1, 0.0, gain=True)


def test_an_error_that_is_no_number_is_infinite():
    block = ContinuousTransferFunction((1.0,), (1.0,))
    wild = Measured(np.ones(10), lambda x: np.full_like(x, np.nan))
    flat = Measured.directly(np.ones(10))
    with np.errstate(all="ignore"):
        assert wild.error_of(block, np.ones(10), 0.1) == np.inf
        assert flat.error_of(block, np.ones(10), 0.1) == np.inf
