"""Continuous Wiener-Hammerstein systems against an ODE solver, their own symmetries, and each other."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.integrate import solve_ivp

import hident.systems.nonlinearity  # noqa: F401  (for its registration)
from hident.config.spec import Of
from hident.errors import SimulationError
from hident.linear_blocks import ContinuousTransferFunction
from hident.records import Held, Periodic
from hident.systems.base import SystemSpec
from hident.systems.blocks import WienerHammerstein
from hident.systems.continuous_wiener_hammerstein import respond

# Brouri, eq. (43): (s + 0.1)(s + 0.5) and (s + 0.2)(s + 0.01), both with static gain 1.
FIRST = ContinuousTransferFunction((1.0,), (12.0, 20.0))
SECOND = ContinuousTransferFunction((1.0,), (105.0, 500.0))
OSCILLATING = ContinuousTransferFunction((1.0, 0.5), (0.4, 1.0))
LEVELS = np.array([-1.5, -0.5, 0.5, 1.5])


def exponential(x):
    return 50.0 * np.exp(0.2 * x)


def sine(period, amplitude=1.5, offset=0.0, settled=True):
    return Periodic(period, offset, np.array([1]), np.array([-1j * amplitude]), settled)


def _slope(block, x, u):
    highest = (u - x[0] - block.a[0] * x[1]) / block.a[1]
    return [x[1], highest]


def _output(block, x):
    return sum(b * state for b, state in zip(block.b, x, strict=False))


def reference(first, f, second, v, times, start, breaks=()):
    """The output at the times by DOP853 at rtol 1e-11, from the equilibrium at ``start``."""
    rest, found = f(first.b[0] * start), []
    state = np.array([start, 0.0, rest, 0.0])
    edges = [times[0], *breaks, times[-1] + 1e-9]
    for begin, end in itertools.pairwise(edges):
        within = times[(times >= begin) & (times < end)]
        middle = (begin + end) / 2
        held = v(middle) if len(breaks) else None

        def rhs(t, x, held=held):
            u_i = _output(first, x[:2])
            return [*_slope(first, x[:2], v(t) if held is None else held), *_slope(second, x[2:], f(u_i))]

        solved = solve_ivp(
            rhs, (begin, end), state, "DOP853", np.append(within, end), rtol=1e-11, atol=1e-11, max_step=5.0
        )
        found.append(_output(second, solved.y[2:, :-1]))
        state = solved.y[:, -1]
    return np.concatenate(found)


def step_at(times, levels):
    return lambda t: levels[max(np.searchsorted(times, t, side="right") - 1, 0)]


class TestAgainstDop853:
    @pytest.mark.parametrize("hold", [400.0, 33.33], ids=["settled", "unsettled"])
    def test_staircase(self, hold):
        n, dt = 3000, 0.5
        switches = np.arange(4) * hold
        found = respond(FIRST, exponential, SECOND, Held(switches, LEVELS), n, dt)
        times = np.arange(n) * dt
        v = step_at(switches, LEVELS)
        expected = reference(FIRST, exponential, SECOND, v, times, 0.0, switches[1:])
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)

    @pytest.mark.parametrize(("first", "second"), [(FIRST, OSCILLATING), (OSCILLATING, FIRST)])
    def test_staircase_through_a_block_that_oscillates(self, first, second):
        switches = np.array([0.0, 7.0, 50.0, 51.0])
        found = respond(first, np.tanh, second, Held(switches, LEVELS, before=0.3), 400, 0.25)
        v = step_at(switches, LEVELS)
        expected = reference(first, np.tanh, second, v, np.arange(400) * 0.25, 0.3, switches[1:])
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)

    def test_sine_in_steady_state(self):
        period = 2 * np.pi / 0.05
        times = np.linspace(0.0, 12 * period, 12 * 50 + 1)
        v = lambda t: 0.3 + 1.5 * np.sin(0.05 * t)  # noqa: E731
        expected = reference(FIRST, exponential, SECOND, v, times, 0.3)[-50:]
        found = respond(FIRST, exponential, SECOND, sine(period, offset=0.3), len(times), period / 50)
        # After 11 periods the slowest transient, of 100 time units, is e^-13.8 of its start.
        from_start = respond(
            FIRST, exponential, SECOND, sine(period, offset=0.3, settled=False), len(times), period / 50
        )
        np.testing.assert_allclose(from_start[-50:], expected, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found[-50:], expected, rtol=0, atol=2e-5)
        longer = respond(
            FIRST, exponential, SECOND, sine(period, offset=0.3, settled=False), 40 * 50, period / 50
        )
        np.testing.assert_allclose(found[:50], longer[-50:], rtol=0, atol=1e-9)


def test_a_linear_chain_has_the_product_of_the_gains():
    omega = 0.037
    gain = FIRST.frequency_response(np.array(omega)) * SECOND.frequency_response(np.array(omega))
    found = respond(FIRST, np.positive, SECOND, sine(2 * np.pi / omega, 2.0), 500, 0.7)
    t = np.arange(500) * 0.7
    expected = 2.0 * np.abs(gain) * np.sin(omega * t + np.angle(gain))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("samples", [3, 7, 400])
def test_whole_fractions_of_the_period_are_any_other_times(samples):
    dt = 100.0 / samples
    whole = respond(FIRST, exponential, SECOND, sine(100.0), 1000, dt)
    other = respond(FIRST, exponential, SECOND, sine(100.0 * (1 + 1e-11)), 1000, dt)
    np.testing.assert_allclose(whole, other, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(whole[:samples], whole[samples : 2 * samples])


def test_harmonics_beyond_half_the_sampling_frequency_are_folded_not_lost():
    wave = Periodic(10.0, 0.0, np.array([1, 4]), np.array([1.0, 0.5j]))
    coarse = respond(OSCILLATING, np.tanh, OSCILLATING, wave, 5, 2.0)
    fine = respond(OSCILLATING, np.tanh, OSCILLATING, wave, 500, 0.02)
    np.testing.assert_allclose(coarse, fine[::100], rtol=0, atol=1e-13)


def test_a_held_signal_through_a_linear_chain_is_that_of_the_exact_blocks():
    v = np.random.default_rng(3).normal(size=300)
    found = respond(FIRST, np.positive, SECOND, Held(np.arange(300.0), v), 300, 1.0)
    product = ContinuousTransferFunction(
        (1.0,), tuple(np.convolve([1.0, *FIRST.a], [1.0, *SECOND.a])[1:].tolist())
    )
    np.testing.assert_allclose(found, product.respond(v, 1.0), rtol=0, atol=1e-12)


@pytest.mark.parametrize("settled", [True, False])
def test_delays_shift_the_output_wherever_they_stand(settled):
    wave = sine(90.0, settled=settled)
    late = [ContinuousTransferFunction(b.b, b.a, 3.0) for b in (FIRST, SECOND)]
    prompt = respond(FIRST, exponential, SECOND, wave, 200, 1.0)
    for first, second in [(late[0], SECOND), (FIRST, late[1])]:
        found = respond(first, exponential, second, wave, 203, 1.0)
        np.testing.assert_allclose(found[3:], prompt, rtol=0, atol=1e-11)
    if not settled:
        np.testing.assert_allclose(found[:3], prompt[0], rtol=0, atol=1e-11)


@given(level=st.floats(-2, 2))
@settings(deadline=None, derandomize=True, max_examples=20)
def test_the_equilibrium_is_left_by_nothing(level):
    found = respond(FIRST, exponential, SECOND, Held(np.zeros(1), np.array([level]), level), 50, 100.0)
    np.testing.assert_allclose(found, exponential(level), rtol=1e-13)


@given(hold=st.floats(0.05, 3000), levels=st.lists(st.floats(-2, 2), min_size=1, max_size=5))
@settings(deadline=None, derandomize=True, max_examples=20)
def test_every_staircase_settles_at_the_nonlinearity(hold, levels):
    switches = np.arange(len(levels)) * hold
    n = 50
    dt = (switches[-1] + 6000.0) / (n - 1)
    found = respond(FIRST, exponential, SECOND, Held(switches, np.array(levels)), n, dt)
    np.testing.assert_allclose(found[-1], exponential(levels[-1]), rtol=1e-11)


@given(scale=st.floats(0.1, 100))
@settings(deadline=None, derandomize=True, max_examples=20)
def test_the_unit_of_time_does_not_matter(scale):
    def slower(block):
        return ContinuousTransferFunction(block.b, (block.a[0] * scale, block.a[1] * scale**2))

    switches = np.array([0.0, 60.0, 300.0])
    once = respond(FIRST, exponential, SECOND, Held(switches, LEVELS[:3]), 100, 5.0)
    scaled = Held(switches * scale, LEVELS[:3])
    again = respond(slower(FIRST), exponential, slower(SECOND), scaled, 100, 5.0 * scale)
    np.testing.assert_allclose(again, once, rtol=1e-11)


def test_gain_and_delay_move_freely_between_the_blocks():
    """What the output can never tell: Brouri, section II, and a delay besides."""
    moved = ContinuousTransferFunction((2.0,), FIRST.a, 4.0), ContinuousTransferFunction((3.0,), SECOND.a)
    late = ContinuousTransferFunction((1.0,), SECOND.a, 4.0)
    here = respond(FIRST, exponential, late, sine(200.0), 300, 1.0)
    there = respond(moved[0], lambda x: exponential(x / 2) / 3, moved[1], sine(200.0), 300, 1.0)
    np.testing.assert_allclose(here, there, rtol=1e-13)


def test_a_kink_is_followed_by_shorter_panels():
    switches = np.array([0.0, 100.0])
    found = respond(FIRST, np.abs, SECOND, Held(switches, np.array([-1.0, 1.0])), 300, 1.0)
    expected = reference(
        FIRST, np.abs, SECOND, step_at(switches, [-1.0, 1.0]), np.arange(300.0), 0.0, switches[1:]
    )
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)


class TestWhatCannotBeSimulated:
    def test_a_jump(self):
        with pytest.raises(SimulationError) as caught:
            respond(FIRST, np.sign, SECOND, sine(100.0), 100, 1.0)
        assert str(caught.value) == (
            "the nonlinearity is not smooth enough to be simulated: relative accuracy 3e-06, not 1e-11"
        )

    def test_a_jump_on_a_staircase(self):
        with pytest.raises(SimulationError, match="is not smooth enough to be simulated"):
            respond(FIRST, np.sign, SECOND, Held(np.array([0.0, 50.0]), np.array([-1.0, 1.0])), 100, 1.0)

    @pytest.mark.parametrize("wave", [sine(100.0, 1.5), sine(100.0, 1.5, settled=False)])
    def test_a_value_that_is_not_finite(self, wave):
        with np.errstate(all="ignore"), pytest.raises(SimulationError) as caught:
            respond(FIRST, lambda x: np.exp(1e4 * x), SECOND, wave, 100, 1.0)
        assert str(caught.value) == "the nonlinearity is not finite in the range of its input"


CONTINUOUS = {
    "kind": "wiener_hammerstein",
    "input_linear": {"kind": "continuous", "a": [12, 20]},
    "nonlinearity": {"kind": "exponential", "scale": 50, "rate": 0.2},
    "output_linear": {"kind": "continuous", "a": [105, 500]},
}


class TestSpec:
    def spec(self) -> SystemSpec:
        found = Of("system").validate(CONTINUOUS)
        assert isinstance(found, WienerHammerstein)
        return found

    def test_it_follows_waveforms_and_has_no_burn_in(self):
        assert self.spec().follows_waveforms()
        assert self.spec().burn_in() == 0

    def test_samples_alone_are_held(self):
        u = np.random.default_rng(1).normal(size=40)
        found = self.spec().simulate(u, 2.0)
        expected = respond(FIRST, exponential, SECOND, Held(np.arange(40.0) * 2, u), 40, 2.0)
        np.testing.assert_array_equal(found, expected)

    def test_truth(self):
        truth = self.spec().truth()
        assert truth.blocks == {"input": FIRST, "output": SECOND}
        assert truth.response is not None
        assert truth.values["input_a_2"] == 20
        assert {"blocks", "response", "nonlinearity"} <= self.spec().provides()

    def test_it_needs_a_sampling_interval(self):
        with pytest.raises(
            ValueError, match=r"^a continuous block needs the sampling interval 'dt' of the data$"
        ):
            self.spec().check(None)

    @pytest.mark.parametrize("side", ["input_linear", "output_linear"])
    def test_mixed_blocks_are_refused(self, side):
        kinds = ["ar", "continuous"] if side == "input_linear" else ["continuous", "ar"]
        with pytest.raises(ValidationError) as caught:
            Of("system").validate({**CONTINUOUS, side: {"kind": "ar", "a": [0.5]}})
        (error,) = caught.value.errors()
        assert error["msg"].removeprefix("Value error, ") == (
            f"both linear blocks must be discrete, or both continuous, not {' and '.join(kinds)}"
        )
