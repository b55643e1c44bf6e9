"""Gains and phases of both blocks against truth, and what a moved delay changes."""

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hident import plugins
from hident.errors import ConfigError
from hident.linear_blocks import ContinuousTransferFunction
from hident.metrics.frequency import (
    GainShapeError,
    MovedDelay,
    Response,
    ResponseError,
    TrueResponse,
    gain,
    phase,
    sine_frequencies,
    true_response,
)
from hident.records import Estimate, Part, Periodic, Record, Truth
from hident.systems.blocks import WienerHammerstein

INPUT = ContinuousTransferFunction((2.0,), (12.0, 20.0))
OUTPUT = ContinuousTransferFunction((1.0, 3.0), (105.0, 500.0), 20.0)
TRUTH = Truth(blocks={"input": INPUT, "output": OUTPUT})
OMEGA = np.array([0.01, 0.03])


def sine(omega, start=0, harmonics=(1,)):
    amplitudes = np.ones(len(harmonics), dtype=complex)
    wave = Periodic(2.0 * math.pi / omega, 0.0, np.array(harmonics), amplitudes)
    return Part(start, start + 8, wave.period / 8, wave)


def record(*parts, truth=TRUTH):
    n = 8 * len(parts)
    named = {f"part {i}": part for i, part in enumerate(parts)}
    return Record(np.zeros(n), np.zeros(n), 1.0, truth, named)


def test_the_frequencies_are_those_of_single_sines_in_order_and_once():
    parts = sine(0.03), sine(0.01, 8), sine(0.03, 16), sine(0.002, 24, harmonics=(1, 3))
    np.testing.assert_allclose(sine_frequencies(record(*parts)), OMEGA, rtol=1e-12)


@settings(deadline=None, derandomize=True, max_examples=30)
@given(st.floats(1e-4, 10.0))
def test_gain_and_phase_make_the_response(omega):
    at = np.array([omega])
    for block in (INPUT, OUTPUT):
        made = block.b[0] * gain(block, at) * np.exp(1j * phase(block, at))
        np.testing.assert_allclose(made, block.frequency_response(at), rtol=1e-10)


def test_the_phase_is_continuous_from_zero_where_the_angle_wraps():
    omega = np.geomspace(1e-6, 10.0, 4000)
    found = phase(OUTPUT, omega)
    assert abs(found[0]) < 1e-3
    assert found[-1] < -190.0
    np.testing.assert_allclose(found, np.unwrap(np.angle(OUTPUT.frequency_response(omega))), atol=1e-9)


def test_names_mean_what_they_say():
    def of(name):
        return true_response(name, TRUTH, OMEGA[int(re.findall(r"\d", name)[0]) - 1])

    assert of("gain_i_1") == pytest.approx(abs(INPUT.frequency_response(OMEGA)[0]) / 2.0)
    assert of("gain_o_2_3") == pytest.approx(abs(OUTPUT.frequency_response(np.array(0.09))))
    assert of("series_gain_2") == pytest.approx(of("gain_i_2") * of("gain_o_2_1"))
    assert of("phase_sum_1_3") == pytest.approx(3 * of("phase_i_1") + of("phase_o_1_3"))
    assert of("phase_o_1_3") == pytest.approx(of("phase_o_2_1"))


def test_estimates_and_errors():
    values, omega = {"gain_i_1": 0.9, "gain_o_1_1": 0.5, "phase_i_1": -0.1}, np.array([0.01])
    estimate = Estimate(frequencies=omega, values=values)
    at = record(sine(0.01))
    names = ("series_gain_1", "phase_i_1")
    assert Response(of=names).evaluate(estimate, at) == pytest.approx([0.45, -0.1])
    true = np.array(TrueResponse(of=names).evaluate(Estimate(), at))
    error = ResponseError(of=names).evaluate(estimate, at)
    assert error == pytest.approx(np.array([0.45, -0.1]) - true)
    percent = ResponseError(of=names, relative=True).evaluate(estimate, at)
    assert percent == pytest.approx(100.0 * (np.array([0.45, -0.1]) / true - 1.0))
    assert ResponseError(of=names).needs_of_estimate() == {
        "frequencies",
        "value gain_i_1",
        "value gain_o_1_1",
        "value phase_i_1",
    }
    turned = Estimate(frequencies=omega, values=values | {"phase_i_1": -0.1 + 2.0 * math.pi})
    assert ResponseError(of=names).evaluate(turned, at) == pytest.approx(error)


def test_errors_are_taken_at_the_frequencies_of_the_estimate():
    at = record(sine(0.01), sine(0.02))
    second = true_response("gain_i_2", TRUTH, 0.02)
    estimate = Estimate(frequencies=np.array([0.02]), values={"gain_i_1": second})
    assert ResponseError(of=("gain_i_1",)).evaluate(estimate, at) == pytest.approx([0.0], abs=1e-15)


def test_the_parts_that_an_error_needs():
    names = ("gain_i_1",)
    assert ResponseError(of=names).needs_of_truth() == {"blocks"}


def test_a_range_stands_for_several_frequencies():
    assert Response(of=("gain_o_2..4_1", "phase_i_1")).labels("r") == (
        "r gain_o_2_1",
        "r gain_o_3_1",
        "r gain_o_4_1",
        "r phase_i_1",
    )


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("gain_o_1", "'gain_o_1' is no gain or phase: write gain_i_M, gain_o_M_K, phase_i_M, phase_o_M_K, "),
        ("speed_i_1", "phase_sum_M_K or series_gain_M, with M..N for several frequencies"),
        ("gain_i_4..2", "the range in 'gain_i_4..2' must rise"),
    ],
)
def test_a_name_that_is_none_is_refused(name, message):
    with pytest.raises(ConfigError) as caught:
        Response(of=(name,))
    assert message in str(caught.value)


def test_the_shape_of_the_gain_is_blind_to_a_factor_only():
    at = record(sine(0.01), sine(0.03, 8), sine(0.01, 16, harmonics=(1, 3)))
    true = [true_response(f"series_gain_{m}", TRUTH, omega) for m, omega in enumerate(OMEGA, start=1)]
    metric = GainShapeError(harmonics=(1, 3))
    linear = {"gain_1": 7.0 * true[0], "gain_3": 7.0 * true[1]}
    assert metric.evaluate(Estimate(values=linear), at)[0] == pytest.approx(0.0, abs=1e-10)
    sines = {f"gain_i_{m}": 3.0 for m in (1, 2)} | {f"gain_o_{m}_1": true[m - 1] for m in (1, 2)}
    found = Estimate(frequencies=OMEGA, values=sines)
    assert metric.evaluate(found, at)[0] == pytest.approx(0.0, abs=1e-10)
    sines["gain_i_2"] *= 1.02
    expected = 100.0 * math.log(1.02) / math.sqrt(2.0)
    assert metric.evaluate(found, at)[0] == pytest.approx(expected)


def simulated():
    plugins.load()
    system = {
        "input_linear": {"kind": "continuous", "a": [12, 20]},
        "nonlinearity": {"kind": "exponential", "scale": 50, "rate": 0.2},
        "output_linear": {"kind": "continuous", "a": [105, 500], "delay": 20},
    }
    return WienerHammerstein.model_validate(system).truth()


def test_a_delay_moves_between_the_blocks_at_the_same_output():
    parts = record(sine(0.01), sine(0.02, 8), truth=simulated())
    (change,) = MovedDelay(experiments=("part",)).evaluate(Estimate(), parts)
    assert 0.0 <= change < 1e-13


def test_an_experiment_that_is_not_there_gives_no_number():
    parts = record(sine(0.01), truth=simulated())
    (change,) = MovedDelay(experiments=("other",)).evaluate(Estimate(), parts)
    assert math.isnan(change)
