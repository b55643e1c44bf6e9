"""A constant added to the output of continuous-time systems: the bias that it leaves, and its estimate."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import hident as hi
from hident.estimators.moving_horizon.hammerstein.static_functions import PolynomialFunction
from hident.estimators.moving_horizon.transform.time_weighted import Horizons
from hident.records import Held, Part
from tests.unit import multisteps, wiener_records

OFFSET = 0.1
FINE: dict[str, Any] = {"dt": 0.02, "duration": 50.0}
KNOWN = {"n": 3, "m": 1}
LINEAR = {"delay": 2, "start": 2.5, "block": {**KNOWN, "horizon": 5.4}}
HAMMERSTEIN = {
    "nonlinearity": {"kind": "three_segment", "partition": [-0.8, 0.6]},
    "first": {**KNOWN, "horizon": 15},
    "second": KNOWN,
    "delay": 2,
    "start": 2.5,
    "tolerance": 1e-12,
}
PARTITION = {"kind": "four_segment", "partition": [-0.6, 0.5]}
WIENER = {
    "nonlinearity": PARTITION,
    "delay": 0.4,
    "first": {"n": 2, "m": 1, "horizon": 12},
    "second": {"n": 2, "m": 1},
    "tolerance": 1e-9,
    "max_iterations": 200,
}
MODELS: dict[str, tuple[Any, dict[str, Any]]] = {
    "linear_model": (hi.LinearModel, LINEAR),
    "iterative_hammerstein": (hi.IterativeHammerstein, HAMMERSTEIN),
    "iterative_wiener": (hi.IterativeWiener, WIENER),
}
TRUTH = multisteps.BLOCK.values()


def fitted(kind, record, **changes):
    cls, settings = MODELS[kind]
    return cls.model_validate({**settings, **changes}).fit(record)


def moved(record, offset=OFFSET):
    return replace(record, y=record.y + offset)


def test_the_transform_of_one_is_that_of_the_operators():
    for order in (1, 3):
        horizons = Horizons.of(400, 0.1, eta=8, overlap=0.1, order=order)
        found = horizons.transform(horizons.sampled(), np.ones(400))
        np.testing.assert_allclose(found[0], horizons.constant, rtol=1e-12)
        np.testing.assert_allclose(found[1:], 0, atol=1e-10)
    # The integral of 4 s (1 - s).
    assert Horizons.of(400, 0.1, eta=8, overlap=0.1, order=1).constant[0] == pytest.approx(2 / 3)


@pytest.mark.parametrize("block", [{**KNOWN, "horizon": 5.4}, {"structure": "search", "horizon": 5.4}])
def test_an_offset_biases_a_linear_model_unless_it_is_estimated(block):
    record = multisteps.record(f=np.positive, **FINE)
    found = fitted("linear_model", moved(record), constant=True, block=block)
    assert {name: found.values[name] for name in TRUTH} == pytest.approx(TRUTH, abs=1e-7)
    assert found.values["constant"] == pytest.approx(OFFSET, abs=1e-9)
    np.testing.assert_allclose(found.response(record.u, record.dt), record.y + OFFSET, atol=1e-7)
    biased = fitted("linear_model", moved(record), block={**KNOWN, "horizon": 5.4})
    assert abs(biased.values["a_1"] - TRUTH["a_1"]) > 0.3


@pytest.mark.parametrize("second", [KNOWN, {"structure": "search", "largest_n": 3}, None])
def test_an_offset_biases_a_hammerstein_model_unless_it_is_estimated(second):
    record = multisteps.record(**FINE)
    found = fitted("iterative_hammerstein", moved(record), constant=True, second=second)
    truth = {**TRUTH, **{f"c_{j}": c for j, c in enumerate(multisteps.THREE_SEGMENTS.c, start=1)}}
    assert {name: found.values[name] for name in truth} == pytest.approx(truth, abs=1e-7)
    assert found.values["constant"] == pytest.approx(OFFSET, abs=1e-9)
    np.testing.assert_allclose(found.response(record.u, record.dt), record.y + OFFSET, atol=1e-7)
    # The function is the one that vanishes at zero.
    assert found.nonlinearity(np.zeros(1)) == 0.0
    assert list(found.details["history"].others)[-1] == "constant"
    biased = fitted("iterative_hammerstein", moved(record), second=None if second is None else KNOWN)
    assert abs(biased.values["c_1"] - 1.5) > 0.3


def test_the_constant_of_a_hammerstein_system_s_own_function_is_one_of_its_output():
    quadratic = PolynomialFunction((1.0, 0.3))
    record = multisteps.record(f=quadratic, **FINE)
    nonlinearity = {"kind": "polynomial", "degree": 2}
    # From rest, a constant before the block of static gain 1 is one behind it once that has settled.
    found = fitted(
        "iterative_hammerstein",
        replace(record, y=record.y + multisteps.BLOCK.respond(np.full(len(record), 0.5), FINE["dt"])),
        nonlinearity=nonlinearity,
        constant=True,
        start=18.0,
    )
    assert found.values["constant"] == pytest.approx(0.5, abs=0.01)
    assert found.values["c_2"] == pytest.approx(0.3, abs=0.01)


@pytest.mark.parametrize("second", [{"n": 2, "m": 1}, None])
@pytest.mark.parametrize("offset", [0.03, -0.2, 0.3])
def test_an_offset_biases_a_wiener_model_unless_it_is_estimated(second, offset):
    record = wiener_records.record()
    found = fitted("iterative_wiener", moved(record, offset), constant=True, second=second)
    truth = {**wiener_records.TRUTH.values(), "e_-2": 0.5, "e_-1": 2.0, "e_2": 3.0, "constant": offset}
    assert {name: found.values[name] for name in truth} == pytest.approx(truth, abs=1e-6)
    np.testing.assert_allclose(found.response(record.u, record.dt), record.y + offset, atol=1e-6)
    assert found.nonlinearity(np.zeros(1)) == 0.0
    try:
        values = fitted("iterative_wiener", moved(record, offset), second=second).values
    except hi.EstimationError as error:
        assert "slopes e_i that are not all positive" in str(error)
    else:
        assert abs(values["e_2"] - 3.0) > 0.5


def test_a_polynomial_after_the_block_has_one_too():
    record = wiener_records.record(wiener_records.cubic)
    polynomial = {"kind": "polynomial", "degree": 3}
    found = fitted("iterative_wiener", moved(record), nonlinearity=polynomial, constant=True)
    truth = {**wiener_records.TRUTH.values(), "c_2": 0.2, "c_3": 0.05, "constant": OFFSET}
    assert {name: found.values[name] for name in truth} == pytest.approx(truth, abs=1e-6)
    biased = fitted("iterative_wiener", moved(record), nonlinearity=polynomial)
    assert abs(biased.values["a_1"] - 3.0) > 0.1


def test_partition_points_are_searched_for_around_the_constant():
    record = moved(wiener_records.record())
    found = fitted(
        "iterative_wiener", record, nonlinearity={"kind": "four_segment"}, constant=True, tolerance=1e-3
    )
    assert found.values["constant"] == pytest.approx(OFFSET, abs=0.02)
    assert (found.values["y_-1"], found.values["y_1"]) == pytest.approx((-0.6, 0.5), abs=0.06)
    assert found.values["a_1"] == pytest.approx(3.0, abs=0.05)


@pytest.mark.parametrize("kind", MODELS)
def test_several_experiments_share_it(kind):
    make = wiener_records.record if kind == "iterative_wiener" else multisteps.record
    options: dict[str, Any] = (
        {}
        if kind == "iterative_wiener"
        else {**FINE, **({"f": np.positive} if kind == "linear_model" else {})}
    )
    records = [make(seed=seed, **options) for seed in (0, 1)]
    n, dt = len(records[0]), records[0].dt
    assert dt is not None
    parts = {
        name: Part(start, start + n, dt, Held(np.zeros(1), np.zeros(1)))
        for name, start in (("a", 0), ("b", n))
    }
    both = hi.Record(
        np.concatenate([one.u for one in records]),
        np.concatenate([one.y for one in records]) + OFFSET,
        dt,
        parts=parts,
    )
    assert fitted(kind, both, constant=True).values["constant"] == pytest.approx(OFFSET, abs=1e-7)


@pytest.mark.parametrize("kind", MODELS)
def test_a_record_without_an_offset_has_the_constant_zero(kind):
    record = wiener_records.record() if kind == "iterative_wiener" else multisteps.record(**FINE)
    if kind == "linear_model":
        record = multisteps.record(f=np.positive, **FINE)
    plain, found = fitted(kind, record), fitted(kind, record, constant=True)
    assert [*plain.values, "constant"] == list(found.values)
    assert found.values["constant"] == pytest.approx(0, abs=1e-8)
    for name in ("a_1", "a_2", "b_1", "vif_max", "first_a_1"):
        if name in plain.values:
            assert found.values[name] == pytest.approx(plain.values[name], rel=0.02, abs=1e-6)


@pytest.mark.parametrize("kind", MODELS)
def test_gives_what_it_provides(kind):
    cls, settings = MODELS[kind]
    estimator = cls.model_validate({**settings, "constant": True})
    assert estimator.names()[-1] == "constant"
    assert "value constant" in estimator.provides()
    assert "value constant" not in cls.model_validate(settings).provides()


def test_standard_errors_are_those_of_repeated_noise():
    record, rng = moved(wiener_records.record(dt=0.1)), np.random.default_rng(3)
    estimates, errors = [], []
    for _ in range(60):
        noisy = replace(record, y=record.y + 0.01 * rng.standard_normal(len(record)))
        values = fitted("iterative_wiener", noisy, constant=True, tolerance=1e-4).values
        estimates.append([values["a_1"], values["b_0"]])
        errors.append([values["se_a_1"], values["se_b_0"]])
    # The standard deviation of 60 has a relative standard error of 9 %.
    np.testing.assert_allclose(np.std(estimates, axis=0, ddof=1), np.median(errors, axis=0), rtol=0.3)


def test_each_constant_needs_a_horizon():
    block = {**KNOWN, "horizon": 5.4, "overlap": 1.0}
    few = hi.LinearModel.model_validate({"block": block})
    few.check(331, 0.1)
    with pytest.raises(ValueError, match=r"^5 horizons are fewer than the 6 parameters"):
        few.model_copy(update={"constant": True}).check(331, 0.1)


@pytest.mark.parametrize("kind", ["iterative_hammerstein", "iterative_wiener"])
def test_the_refinement_keeps_it_and_gives_its_standard_error(kind):
    record = multisteps.record(**FINE) if kind == "iterative_hammerstein" else wiener_records.record()
    cls, settings = MODELS[kind]
    start = {**settings, "constant": True, "tolerance": 1e-3, "unconverged": "keep"}
    refined = hi.OutputError(start=cls.model_validate(start))
    rng, estimates, errors = np.random.default_rng(4), [], []
    exact = refined.fit(moved(record))
    assert exact.values["constant"] == pytest.approx(OFFSET, abs=1e-6)
    assert exact.response is not None
    assert record.dt is not None
    np.testing.assert_allclose(exact.response(record.u, record.dt), record.y + OFFSET, atol=1e-5)
    assert f"value {refined.names()[-4]}" in refined.provides()
    for _ in range(40):
        noisy = replace(record, y=record.y + OFFSET + 0.05 * rng.standard_normal(len(record)))
        try:
            values = refined.fit(noisy).values
        except hi.EstimationError as error:
            # A minimum on a kink of the criterion.
            assert "no step lowers the output error" in str(error)
            continue
        estimates.append(values["constant"])
        errors.append(values["se_constant"])
    assert len(estimates) >= 37
    assert np.mean(estimates) == pytest.approx(OFFSET, abs=4 * np.mean(errors) / np.sqrt(40))
    # The standard deviation of 40 has a relative standard error of 11 %.
    assert np.std(estimates, ddof=1) == pytest.approx(np.mean(errors), rel=0.4)


@pytest.mark.parametrize("kind", ["iterative_hammerstein", "iterative_wiener"])
def test_without_it_the_refinement_is_biased(kind):
    record = multisteps.record(**FINE) if kind == "iterative_hammerstein" else wiener_records.record()
    cls, settings = MODELS[kind]
    start = cls.model_validate({**settings, "tolerance": 1e-3})
    biased = hi.OutputError(start=start).fit(moved(record, 0.03)).values
    assert abs(biased["a_1"] - (4.0 if kind == "iterative_hammerstein" else 3.0)) > 1e-3
    assert "constant" not in biased


@pytest.mark.parametrize("kind", MODELS)
def test_it_counts_as_a_parameter(kind):
    cls, settings = MODELS[kind]
    plain, more = (cls.model_validate({**settings, "constant": one}) for one in (False, True))
    assert more.free_parameters() == plain.free_parameters() + 1
    if kind != "linear_model":
        refined, without = hi.OutputError(start=more), hi.OutputError(start=plain)
        assert refined.free_parameters() == without.free_parameters() + 1 == len(refined.parameters())
