"""Continuous linear blocks: exact responses to held inputs, whatever the delay."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete, lfilter

from hident.linear_blocks import ContinuousTransferFunction
from hident.systems.continuous import Continuous
from tests.unit.plans import refusals

QUICK = settings(deadline=None, derandomize=True, max_examples=30)
EXAMPLE_1 = ContinuousTransferFunction((1.0, -1.0), (4.0, 4.0, 3.0), 2.0)
EXAMPLE_2 = ContinuousTransferFunction((1.0, -2.0), (4.0, 5.0, 2.0), 1.0)
U = np.random.default_rng(0).uniform(-2, 2, 60)


def from_poles(*poles, b=(1.0,), delay=0.0):
    """The block with unit constant term and the given poles."""
    falling = np.poly(poles).real
    return ContinuousTransferFunction(b, tuple((falling / falling[-1])[-2::-1]), delay)


BLOCKS = {
    "n = 1": ContinuousTransferFunction((2.0,), (3.0,)),
    "n = 2, repeated": ContinuousTransferFunction((1.0, 0.5), (2.0, 1.0)),
    "n = 2, nearly repeated": from_poles(-1.0, -1.0 - 1e-7),
    "n = 2, oscillating": ContinuousTransferFunction((1.0,), (0.1, 1.0)),
    "n = 2, unstable": ContinuousTransferFunction((1.0,), (-0.5, 4.0)),
    "n = 3": EXAMPLE_1.scaled(1.0),
    "n = 3, triple pole": from_poles(-0.5, -0.5, -0.5, b=(1.0, 0.0, 2.0)),
    "n = 4, stiff": from_poles(-20.0, -0.1, -1 + 3j, -1 - 3j, b=(0.0, 1.0)),
    "n = 5": from_poles(-1, -1, -1, -0.2 + 2j, -0.2 - 2j, b=(1, -1, 0.5, 0, 0.1)),
}
each_block = pytest.mark.parametrize("block", BLOCKS.values(), ids=BLOCKS.keys())


@st.composite
def blocks(draw, largest_delay=3.0):
    n = draw(st.integers(1, 4))
    poles = [-draw(st.floats(0.1, 3.0)) for _ in range(n)]
    b = draw(st.lists(st.floats(-2, 2), min_size=1, max_size=n).filter(lambda b: max(map(abs, b)) > 0.1))
    return from_poles(*poles, b=tuple(b), delay=draw(st.floats(0, largest_delay)))


def close(found, wanted, tolerance):
    np.testing.assert_allclose(found, wanted, rtol=0, atol=tolerance * np.max(np.abs(wanted)))


class TestResponse:
    @each_block
    def test_is_that_of_scipy_on_the_grid(self, block):
        dt = 0.25
        system = (block.b[::-1], block.denominator)
        b, a, _ = cont2discrete(system, dt)
        wanted = lfilter(b.ravel(), a, np.concatenate((np.zeros(8), U[:-8])))
        delayed = ContinuousTransferFunction(block.b, block.a, 8 * dt)
        close(delayed.respond(U, dt), wanted, 1e-9)

    @each_block
    @pytest.mark.parametrize("delay", [0.37, 0.5, 1.9])
    def test_solves_the_differential_equation(self, block, delay):
        dt, n = 0.5, len(block.a)
        falling = block.denominator / block.denominator[0]
        output = np.pad(block.b, (0, n - len(block.b))) / block.denominator[0]

        def slope(t, z, level):
            return np.append(z[1:], level - falling[:0:-1] @ z)

        u = U[:6]
        jumps = np.concatenate(([0.0], delay + dt * np.arange(len(u))))
        levels, z = np.concatenate(([0.0], u)), np.zeros(n)
        wanted: dict[float, float] = {}
        times = dt * np.arange(len(u))
        for start, end, level in zip(jumps, [*jumps[1:], jumps[-1] + dt], levels, strict=True):
            inside = times[(times >= start) & (times < end)]
            solved = solve_ivp(
                slope, (start, end), z, "DOP853", [*inside, end], args=(level,), rtol=1e-11, atol=1e-13
            )
            wanted |= dict(zip(inside, output @ solved.y, strict=False))
            z = solved.y[:, -1]
        found = ContinuousTransferFunction(block.b, block.a, delay).respond(u, dt)
        close(found, np.array([wanted[t] for t in times]), 2e-9)

    @each_block
    @pytest.mark.parametrize("delay", [0.0, 0.3, 0.7, 3.1, 40.0])
    def test_does_not_depend_on_the_sampling(self, block, delay):
        block = ContinuousTransferFunction(block.b, block.a, delay)
        coarse, fine = block.respond(U, 0.7), block.respond(np.repeat(U, 7), 0.1)
        close(coarse, fine[::7], 1e-9)

    @each_block
    @pytest.mark.parametrize("delay", [0.0, 0.8, 1.0, 30.0])
    def test_equals_that_of_the_sampled_block(self, block, delay):
        block = ContinuousTransferFunction(block.b, block.a, delay)
        close(block.sampled(0.4).filter(U), block.respond(U, 0.4), 1e-8)

    @pytest.mark.parametrize(("delay", "zeros"), [(0.0, 1), (1.9999999999, 11), (2.0, 11), (2.05, 11)])
    def test_a_delay_is_a_number_of_leading_zeros(self, delay, zeros):
        sampled = ContinuousTransferFunction((1.0, -1.0), (4.0, 4.0, 3.0), delay).sampled(0.2)
        assert np.flatnonzero(sampled.b)[0] == zeros
        assert len(sampled.b) == zeros + 3 + (delay == 2.05)

    @QUICK
    @given(block=blocks(), gains=st.tuples(st.floats(-3, 3), st.floats(-3, 3)))
    def test_is_linear(self, block, gains):
        x, y = U[:30], U[30:]
        both = block.respond(gains[0] * x + gains[1] * y, 0.3)
        apart = gains[0] * block.respond(x, 0.3) + gains[1] * block.respond(y, 0.3)
        np.testing.assert_allclose(both, apart, rtol=0, atol=1e-11 * np.abs(block.b).max())

    @QUICK
    @given(block=blocks(), shift=st.integers(0, 70))
    def test_moves_with_its_input_and_with_its_delay(self, block, shift):
        dt = 0.25
        moved = np.concatenate((np.zeros(shift), U))[: len(U)]
        later = ContinuousTransferFunction(block.b, block.a, block.delay + shift * dt)
        expected = np.concatenate((np.zeros(shift), block.respond(U, dt)))[: len(U)]
        np.testing.assert_allclose(block.respond(moved, dt), expected, rtol=0, atol=1e-12)
        np.testing.assert_allclose(later.respond(U, dt), expected, rtol=0, atol=1e-12)

    @QUICK
    @given(block=blocks(), tau=st.floats(1e-6, 1e6))
    def test_does_not_depend_on_the_unit_of_time(self, block, tau):
        scaled = ContinuousTransferFunction(
            tuple(b * tau**i for i, b in enumerate(block.b)),
            tuple(a * tau**i for i, a in enumerate(block.a, start=1)),
            block.delay * tau,
        )
        wanted = block.respond(U, 0.3)
        np.testing.assert_allclose(scaled.respond(U, 0.3 * tau), wanted, rtol=0, atol=1e-8)

    def test_does_not_change_its_input(self):
        u = U.copy()
        EXAMPLE_1.respond(u, 0.3)
        np.testing.assert_array_equal(u, U)

    def test_settles_at_the_static_gain(self):
        assert EXAMPLE_1.scaled(2.5).respond(np.ones(600), 0.2)[-1] == pytest.approx(2.5, rel=1e-6)


class TestProperties:
    def test_the_frequency_response_is_the_response_to_a_sine(self):
        omega, dt = 2 * np.pi / 8, 0.005
        t = dt * np.arange(round(80 / dt))
        block = ContinuousTransferFunction((1.0, -1.0), (4.0, 4.0, 3.0), 2.003)
        # Holding a sine delays it by half an interval.
        y = block.respond(np.sin(omega * (t + dt / 2)), dt)[-round(8 / dt) :]
        found = 2j * np.mean(y * np.exp(-1j * omega * t[-len(y) :]))
        assert block.frequency_response(np.array([omega]))[0] == pytest.approx(found, rel=1e-4)

    @QUICK
    @given(block=blocks(), omega=st.floats(0, 10))
    def test_the_frequency_response_is_the_formula(self, block, omega):
        s = 1j * omega
        numerator = sum(b * s**i for i, b in enumerate(block.b))
        denominator = 1 + sum(a * s**i for i, a in enumerate(block.a, start=1))
        wanted = numerator * np.exp(-s * block.delay) / denominator
        found = block.frequency_response(np.array([[omega, 0.0]]))
        assert found.shape == (1, 2)
        np.testing.assert_allclose(found[0], [wanted, block.b[0]], rtol=1e-11, atol=1e-14)

    def test_poles_and_zeros_and_values(self):
        np.testing.assert_allclose(sorted(EXAMPLE_2.poles().real), [-1, -1, -0.5], atol=1e-7)
        np.testing.assert_allclose(EXAMPLE_2.zeros(), [0.5])
        assert EXAMPLE_2.values() == {"a_1": 4.0, "a_2": 5.0, "a_3": 2.0, "b_0": 1.0, "b_1": -2.0}
        assert BLOCKS["n = 1"].zeros().size == 0

    @pytest.mark.parametrize(("block", "printed"), [(EXAMPLE_1, 10.8), (EXAMPLE_2, 10.1)])
    def test_settling_times_of_the_paper_s_examples(self, block, printed):
        assert block.settling_time() == pytest.approx(printed, abs=0.05)

    @QUICK
    @given(
        tau=st.floats(1e-4, 1e4), band=st.floats(0.001, 0.5), gain=st.floats(0.1, 10), delay=st.floats(0, 9)
    )
    def test_the_settling_time_of_one_pole_is_known(self, tau, band, gain, delay):
        block = ContinuousTransferFunction((-gain,), (tau,), delay)
        assert block.settling_time(band) == pytest.approx(-tau * np.log(band), rel=1e-12)

    @pytest.mark.parametrize(
        "block",
        [
            ContinuousTransferFunction((1.0,), (-1.0,)),
            ContinuousTransferFunction((1.0,), (0.0, 1.0)),
            ContinuousTransferFunction((0.0, 1.0), (2.0, 1.0)),
        ],
    )
    def test_what_never_settles(self, block):
        assert block.settling_time() == np.inf


def spec(**fields):
    return Continuous.model_validate(fields)


class TestMessages:
    @pytest.mark.parametrize(
        ("fields", "message"),
        [
            (
                {"a": [4, 4, 3], "b": [1, 0, 0, 1]},
                "the block is improper: the order m = 3 of the numerator must be below the order n = 3 "
                "of the denominator",
            ),
            (
                {"a": [1], "b": [1, 2]},
                "the block is improper: the order m = 1 of the numerator must be below the order n = 1 "
                "of the denominator",
            ),
            ({"a": [4, 0]}, "the highest coefficient a_n must not be zero, and there must be one"),
            ({"a": [-2]}, "is unstable: the poles 0.5 do not lie in the left half plane"),
            (
                {"a": [-1, 1]},
                "is unstable: the poles 0.5+-0.866025j do not lie in the left half plane",
            ),
            ({"a": [0, 4]}, "is unstable: the poles 0+-0.5j do not lie in the left half plane"),
            ({"a": [1], "b": [0, 0]}, "must have a coefficient other than zero"),
            ({"a": []}, "must be a list of at least one number"),
            ({"a": [1], "delay": -0.5}, "must be greater than or equal to 0"),
        ],
    )
    def test_of_a_spec(self, fields, message):
        with pytest.raises(ValidationError, match=re.escape(message)):
            spec(**fields)

    def test_of_a_negative_delay(self):
        with pytest.raises(ValueError, match=r"^the delay must not be negative, not -0.5$"):
            ContinuousTransferFunction((1.0,), (1.0,), -0.5)

    def test_a_missing_sampling_interval_is_told_with_its_line(self, tmp_path):
        text = """\
version: 1
title: t
trials: 2
samples: 400
{dt}system:
  kind: hammerstein
  nonlinearity: identity
  linear: {{kind: continuous, a: [1], delay: -1/2}}
excitation: {{kind: multistep, switching_time: 10, std: 1}}
estimators: {{linear: {{kind: linear_model, block: {{n: 1, horizon: 20}}}}}}
metrics: {{a: {{kind: error, of: [a_1]}}}}
"""
        (line,) = refusals(tmp_path, text.format(dt="dt: 1\n"))
        assert re.fullmatch(
            r"a\.yaml:9: system\.linear\.delay: must be greater than or equal to 0 \(got '?-1/2'?\)", line
        )
        assert refusals(tmp_path, text.format(dt="").replace("-1/2", "1/2")) == [
            "a.yaml:5: system: a continuous block needs the sampling interval 'dt' of the data",
            "a.yaml:10: estimators.linear: a continuous-time method needs the sampling interval 'dt' "
            "of the data",
        ]
