"""A linear model of the whole system by the time-weighted transform."""

import re

import numpy as np
import pytest
from pydantic import ValidationError

from hident.errors import EstimationError
from hident.estimators.moving_horizon.iterative import padded, parameter_names
from hident.estimators.moving_horizon.linear_model import LinearModel
from hident.records import Record
from hident.systems.nonlinearity import ChenType1
from tests.unit.multisteps import BLOCK, record

RNG = np.random.default_rng(0)
THIRD = {"n": 3, "m": 1, "horizon": 5.4}
SEARCH = {"structure": "search", "horizon": 5.4}


def spec(**block):
    return LinearModel.model_validate({"delay": 2, "start": 2.5, "block": block})


def linear(**options):
    return record(f=np.positive, **options)


def test_a_linear_system_is_recovered_exactly():
    made = linear(dt=0.02, duration=50.0)
    found = spec(**THIRD).fit(made, RNG)
    wanted = {**BLOCK.values(), "n": 3.0, "m": 1.0, "delay": 2.0, "settling_time": BLOCK.settling_time()}
    assert {name: found.values[name] for name in wanted} == pytest.approx(wanted, abs=1e-8)
    np.testing.assert_allclose(found.response(made.u, made.dt), made.y, atol=1e-8)
    assert found.continuous.delay == 2.0
    assert found.nonlinearity is None


def test_the_gain_is_free():
    found = spec(**THIRD).fit(linear(dt=0.02, duration=50.0, block=BLOCK.scaled(-3.0)), RNG)
    assert (found.values["b_0"], found.values["b_1"]) == pytest.approx((-3.0, 3.0), abs=1e-8)


@pytest.mark.parametrize("block", [THIRD, SEARCH])
def test_gives_what_it_provides(block):
    estimator = spec(**block)
    found = estimator.fit(linear(nsr=0.1), RNG)
    assert {f"value {name}" for name in found.values} | {"continuous", "response"} == estimator.provides()
    assert ("structure" in found.details) == (block is SEARCH)
    assert not estimator.draws()


def test_a_searched_structure_is_padded_with_zeros():
    values = spec(**SEARCH).fit(linear(nsr=0.1), RNG).values
    assert (values["n"], values["m"]) == (3.0, 1.0)
    assert values["a_4"] == values["b_2"] == values["b_3"] == 0.0
    assert values["a_3"] == pytest.approx(3.0, abs=0.3)


def test_of_a_saturating_system_it_misses_what_is_not_linear():
    made = record(f=ChenType1())
    found = spec(**SEARCH).fit(made, RNG)
    residual = made.y - found.response(made.u, made.dt)
    assert 0.2 < np.std(residual) / np.std(made.y) < 0.8


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ({"n": 3}, "block.horizon is required: the length eta of the horizons"),
        ({"horizon": 5}, "give the order 'n', or 'structure: search'"),
        ({"n": 2, "m": 2, "horizon": 5}, "m must be below n = 2, not 2: take m = 1 or less, or a larger n"),
    ],
)
def test_messages_of_the_spec(block, message):
    with pytest.raises(ValidationError, match=re.escape(message)):
        spec(**block)


@pytest.mark.parametrize(
    ("samples", "dt", "message"),
    [
        (1001, None, "a continuous-time method needs the sampling interval 'dt' of the data"),
        (1001, 1.0, "the horizon 5.4 holds 5 sampling intervals of 1, and order 3 needs 16"),
        (51, 0.1, "the horizon 5.4 is too long for the record: it spans 2.5 from the start 2.5, and 5.94 is"),
        (101, 0.1, "3 horizons are fewer than the 5 parameters"),
    ],
)
def test_messages_of_records_that_do_not_suit(samples, dt, message):
    spec(**THIRD).check(1001, 0.1)
    with pytest.raises(ValueError, match=f"^{re.escape(message)}"):
        spec(**THIRD).check(samples, dt)


@pytest.mark.parametrize(
    ("b", "lowest", "expected"),
    [
        ((2.0,), 0, {"a_1": 3.0, "a_2": 0.0, "b_0": 2.0, "b_1": 0.0}),
        ((), 1, {"a_1": 3.0, "a_2": 0.0, "b_1": 0.0}),
    ],
)
def test_parameters_are_padded_to_their_names(b, lowest, expected):
    found = padded((3.0,), b, 2, lowest)
    assert dict(zip(parameter_names(2, lowest), found, strict=True)) == expected


def test_a_delay_as_long_as_the_record_is_refused():
    model = LinearModel.model_validate({"delay": 150, "block": {"n": 1, "horizon": 10}})
    with pytest.raises(ValueError, match=r"^the delay 150 is no shorter than the record, 99\.9: take a"):
        model.check(1000, 0.1)


def test_a_structure_search_says_why_the_last_candidate_was_refused():
    spec = LinearModel.model_validate({"block": {"structure": "search", "largest_n": 2, "horizon": 1}})
    rng = np.random.default_rng(1)

    record = Record(np.zeros(300), rng.standard_normal(300), 0.05)
    with pytest.raises(EstimationError, match=r"^no structure up to n = 2 .* \(the last"):
        spec.fit(record, rng)
