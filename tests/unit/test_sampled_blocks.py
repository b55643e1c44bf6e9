"""Continuous blocks as their samples see them: exact for their inputs, with exact derivatives."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hident as hi
from hident.linear_blocks import ContinuousTransferFunction
from hident.sampled_blocks import SampledTransferFunction

CHEN = ContinuousTransferFunction((1.0, -1.0), (4.0, 4.0, 3.0), 2.0)
BLOCKS = (
    CHEN,
    replace(CHEN, delay=2.03),
    # Two equal poles, of which no formula by differences of poles knows anything.
    ContinuousTransferFunction((1.0, 0.5), (1.0, 0.25)),
    ContinuousTransferFunction((0.0, 2.0), (0.3, 0.2), 0.05),
    ContinuousTransferFunction((2.0,), (1.0,), 0.3),
)
INTERSAMPLE = ("held", "linear")
DT = 0.1


@st.composite
def blocks(draw):
    """A stable block of up to four poles, real ones and pairs, with some zeros and a delay."""
    poles: list[complex] = []
    for _ in range(draw(st.integers(1, 2))):
        size, angle = draw(st.floats(0.1, 3.0)), draw(st.floats(0.0, 1.2))
        poles += [-size] if angle < 0.2 else [-size * np.exp(1j * angle), -size * np.exp(-1j * angle)]
    denominator = np.poly(poles).real[::-1]
    b = [k / 10.0 for k in draw(st.lists(st.integers(-20, 20), min_size=1, max_size=len(poles)))]
    feedback = tuple((denominator[1:] / denominator[0]).tolist())
    return ContinuousTransferFunction(tuple(b), feedback, draw(st.sampled_from([0.0, 0.3, 1.0, 2.75])))


@given(block=blocks(), dt=st.floats(0.2, 2.0))
@settings(deadline=None)
def test_a_held_input_gives_what_the_block_itself_does(block, dt):
    sampled = SampledTransferFunction(block, dt)
    x = np.random.default_rng(0).normal(size=60)
    expected = block.respond(x, dt)
    np.testing.assert_allclose(sampled.filter(x), expected, rtol=0.0, atol=1e-9 * np.max(np.abs(expected)))


@pytest.mark.parametrize("block", BLOCKS)
def test_straight_lines_are_what_many_small_steps_come_to(block):
    # Lines through the middles of m steps: what is left falls with the square of m.
    x = np.concatenate(([0.0], np.random.default_rng(0).normal(size=60).cumsum()))
    y = SampledTransferFunction(block, DT, "linear").filter(x)
    left = []
    for m in (50, 100):
        fine = np.interp((np.arange(60 * m + 1) + 0.5) / m, np.arange(61), x)
        left.append(float(np.max(np.abs(block.respond(fine, DT / m)[::m] - y))))
    assert left[1] < 1e-4 * np.max(np.abs(y))
    assert left[1] == pytest.approx(left[0] / 4.0, rel=0.05)


@pytest.mark.parametrize("intersample", INTERSAMPLE)
@pytest.mark.parametrize("block", BLOCKS)
def test_derivatives(block, intersample):
    """Against differences of fourth order, with one more coefficient of the numerator than the block has."""
    count = len(block.b) + (len(block.b) < len(block.a))
    numbers = np.concatenate((block.b, np.zeros(count - len(block.b)), block.a))

    def coefficients(values):
        moved = ContinuousTransferFunction(tuple(values[:count]), tuple(values[count:]), block.delay)
        sampled = SampledTransferFunction(moved, DT, intersample)
        return np.concatenate((sampled.b, sampled.denominator[1:]))

    rows = SampledTransferFunction(block, DT, intersample).derivatives(count)
    for k, row in enumerate(rows):
        step = 1e-3 * np.eye(len(numbers))[k] * max(abs(numbers[k]), 0.1)
        sides = [coefficients(numbers + j * step) for j in (-2, -1, 1, 2)]
        expected = (sides[0] - 8.0 * sides[1] + 8.0 * sides[2] - sides[3]) / (12.0 * np.sum(step))
        size = np.max(np.abs(expected))
        np.testing.assert_allclose(row, expected[-len(row) :], rtol=0.0, atol=1e-8 * size)
        assert not np.any(expected[: -len(row)])


def test_they_do_not_lose_digits_where_poles_crowd():
    """The response to derivatives that nearly cancel, beside that of -s^i B/A^2 by itself."""
    dt = 0.02
    sampled = SampledTransferFunction(CHEN, dt)
    x = np.random.default_rng(0).normal(size=3000)
    y = sampled.filter(x)
    lag = 101
    from_input = hi.TransferFunction(a=sampled.a).filter(x)
    from_output = hi.TransferFunction(a=sampled.a).filter(y)
    terms = [np.concatenate((np.zeros(lag + j), from_input[: len(x) - lag - j])) for j in range(3)]
    terms += [-np.concatenate((np.zeros(j), from_output[: len(x) - j])) for j in (1, 2, 3)]
    made = sampled.derivatives(2) @ np.array(terms)
    denominator = (1.0, *CHEN.a)
    square = tuple(np.convolve(denominator, denominator)[1:].tolist())
    for i in (1, 2, 3):
        numerator = (*(0.0,) * i, *(-b for b in CHEN.b))
        expected = ContinuousTransferFunction(numerator, square, CHEN.delay).respond(x, dt)
        np.testing.assert_allclose(made[1 + i], expected, rtol=0.0, atol=1e-7 * np.max(np.abs(expected)))


def test_a_gain_stays_with_the_continuous_block():
    block = SampledTransferFunction(CHEN, DT)
    assert block.scaled(2.0).continuous == CHEN.scaled(2.0)
    assert block.divided(2.0).continuous == CHEN.scaled(0.5)
    assert block.static_gain() == 1.0
    assert block.values() == CHEN.values()
    assert block.every(0.2) == SampledTransferFunction(CHEN, 0.2)


def test_coefficients_cannot_be_exchanged_for_others():
    with pytest.raises((TypeError, ValueError), match="b"):
        replace(SampledTransferFunction(CHEN, DT), b=(1.0,))


def test_samples_that_come_too_fast_are_refused():
    with pytest.raises(ValueError, match="take every second sample, or fewer"):
        SampledTransferFunction(CHEN, 1e-5)


def test_a_delay_of_millions_of_samples_is_refused():
    with pytest.raises(ValueError, match="is longer than 1000000 samples"):
        SampledTransferFunction(replace(CHEN, delay=1e9), DT)


def test_an_integrator_is_refused():
    with pytest.raises(ValueError, match="pole at zero"):
        SampledTransferFunction(ContinuousTransferFunction((1.0,), (), integrators=1), DT)
