"""Blocks by zeros and poles and by second-order sections: narrow filters keep their accuracy."""

import pickle
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

import hident as hi
from hident.linear_blocks import TransferFunction
from hident.second_order_sections import SecondOrderSections

QUICK = settings(deadline=None, derandomize=True, max_examples=40)
U = np.random.default_rng(1).normal(size=400)
BAND = (0.1, 0.102)
NARROW = signal.butter(8, BAND, "bandpass", output="sos")
ZEROS, POLES, GAIN = signal.butter(8, BAND, "bandpass", output="zpk")


def written(roots):
    """As a configuration writes them: real ones, and one of each pair."""
    return [
        float(root.real) if root.imag == 0 else [float(root.real), float(root.imag)]
        for root in roots
        if root.imag >= 0
    ]


def by_sections(**fields):
    return hi.Sos(sections=NARROW.tolist(), **fields)


def by_roots(**fields):
    return hi.Zpk(zeros=written(ZEROS), poles=written(POLES), gain=float(GAIN), **fields)


def response(omega):
    """The frequency response of the narrow filter by the product of its factors."""
    z = np.exp(1j * omega)
    return GAIN * np.prod(z - ZEROS) / np.prod(z - POLES)


@pytest.mark.parametrize("make", [by_sections, by_roots])
class TestNarrowFilter:
    @pytest.mark.parametrize("place", [0.1002, 0.101, 0.1019])
    def test_a_sine_in_the_band_has_the_amplitude_and_phase_of_the_product(self, make, place):
        omega = np.pi * place
        block = make()
        n = np.arange(-block.burn_in(), 200)
        y = block.simulate(np.sin(omega * n))[-200:]
        wanted = (response(omega) * np.exp(1j * omega * n[-200:])).imag
        np.testing.assert_allclose(y, wanted, rtol=0, atol=1e-8)

    def test_the_coefficients_of_the_product_lose_it(self, make):
        block = make(initial="zero")
        y = block.simulate(np.tile(U, 50))
        assert np.max(np.abs(y)) < 1
        product = block.transfer_function()
        coefficients = TransferFunction(product.b, product.a)
        with np.errstate(all="ignore"):
            lost = coefficients.filter(np.tile(U, 50))
        assert not np.all(np.abs(lost) < 1e6)
        assert not coefficients.is_stable()
        assert product.is_stable()

    def test_what_is_asked_of_the_block_is_accurate(self, make):
        block = make().transfer_function()
        for found, wanted in ((block.poles(), POLES), (block.zeros(), ZEROS)):
            np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(wanted), atol=1e-12)
        assert block.radius() == pytest.approx(np.max(np.abs(POLES)), rel=1e-12)
        assert block.static_gain() == 0.0
        late = block.impulse_response(2 * block.memory())
        assert np.max(np.abs(late[block.memory() :])) <= 1e-15 * np.max(np.abs(late))


def test_both_ways_are_one():
    np.testing.assert_allclose(
        by_roots(initial="zero").simulate(U), by_sections(initial="zero").simulate(U), rtol=1e-12
    )


roots = st.lists(
    st.floats(-0.9, 0.9) | st.tuples(st.floats(-0.6, 0.6), st.floats(0.1, 0.6)).map(list), max_size=4
)


@QUICK
@given(zeros=roots, poles=roots, gain=st.floats(0.1, 10))
def test_of_low_order_they_are_the_block_of_their_coefficients(zeros, poles, gain):
    def count(roots):
        return sum(1 + isinstance(one, list) for one in roots)

    poles = [*poles, *[0] * max(0, count(zeros) - count(poles))]
    block = hi.Zpk(zeros=zeros, poles=poles, gain=gain, initial="zero")

    def polynomial(roots):
        factors = [
            np.poly([complex(*one), complex(one[0], -one[1])]).real for one in roots if isinstance(one, list)
        ]
        factors += [np.array([1.0, -one]) for one in roots if not isinstance(one, list)]
        found = np.ones(1)
        for factor in factors:
            found = np.convolve(found, factor)
        return found

    top, bottom = gain * polynomial(zeros), polynomial(poles)
    b = np.concatenate((np.zeros(len(bottom) - len(top)), top))
    wanted = signal.lfilter(b, bottom, U)
    np.testing.assert_allclose(block.simulate(U), wanted, rtol=0, atol=1e-9 * np.max(np.abs(wanted)))
    transfer = block.transfer_function()
    assert transfer.static_gain() == pytest.approx(top.sum() / bottom.sum(), rel=1e-9)
    np.testing.assert_allclose(transfer.denominator, bottom[: len(transfer.a) + 1], atol=1e-12)


def test_poles_without_zeros_delay():
    np.testing.assert_array_equal(hi.Zpk(poles=[0, 0, 0], gain=2).simulate(U)[3:], 2 * U[:-3])
    assert hi.Zpk(poles=[0.5, 0.2]).transfer_function().b == (0.0, 0.0, 1.0)
    np.testing.assert_array_equal(hi.Zpk(gain=3).simulate(U), 3 * U)


def test_they_start_stationary_or_at_zero():
    block = hi.Sos(sections=[[1, 0, 0, 1, -0.5, 0]])
    assert block.burn_in() == hi.Ar(a=[0.5]).burn_in()
    assert hi.Sos(sections=[[1, 0, 0, 1, -0.5, 0]], initial="zero").burn_in() == 0
    with pytest.raises(ValueError, match=r"^second-order sections begin at rest: past outputs do not tell"):
        block.transfer_function().filter(U, np.ones(1))


def test_they_are_blocks_of_systems_with_their_coefficients_as_truth():
    system = hi.Hammerstein(nonlinearity="abs", linear=hi.Zpk(zeros=[-0.2], poles=[[0.3, 0.4]], gain=2))
    truth = system.truth()
    assert truth.linear is not None
    assert truth.response is not None
    assert truth.values == pytest.approx({"a_1": 0.6, "a_2": -0.25, "b_0": 0, "b_1": 2, "b_2": 0.4})
    np.testing.assert_allclose(truth.linear.filter(np.abs(U)), truth.response(U, 1.0), atol=1e-12)
    record = hi.simulate(system, hi.Iid(distribution="gaussian", std=1), 100)
    assert np.all(np.isfinite(record.y))


def test_an_integrator_among_the_poles():
    block = hi.Zpk(zeros=[0, 0], poles=[1, 0.5], initial="zero")
    assert block.transfer_function().integrators() == 1
    np.testing.assert_allclose(block.simulate(U), np.cumsum(hi.Ar(a=[0.5], initial="zero").simulate(U)))
    with pytest.raises(hi.ConfigError, match="has a pole at 1, an integrator, which has no stationary start"):
        hi.Zpk(poles=[1])


def test_survives_pickling_and_goes_to_scipy():
    block = by_sections().transfer_function()
    assert pickle.loads(pickle.dumps(block)) == block
    found = block.to_scipy(dt=0.5)
    np.testing.assert_allclose(np.sort_complex(found.poles), np.sort_complex(POLES), atol=1e-12)
    assert found.dt == 0.5
    assert SecondOrderSections.of([(1, 0, 0, 1, 0, 0)]).b == (1.0,)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: hi.Zpk(poles=[1.1]), "is unstable: poles 1.1 lie on or outside the unit circle"),
        (lambda: hi.Zpk(poles=[[0.8, 0.8]]), "is unstable: poles 0.8+-0.8j (modulus 1.13137) lie on or"),
        (
            lambda: hi.Zpk(zeros=[0.5, [0, 1]], poles=[0.5]),
            "3 zeros are more than 1 poles, and the output wo",
        ),
        (
            lambda: hi.Zpk(poles=[[0.3, 0.4, 0.5]]),
            "poles[0]: must be a number, or [re, im] for the pair re +-",
        ),
        (lambda: hi.Zpk(poles=["x"]), "poles[0]: must be a number, or a formula such as '2*pi' or '1/5'"),
        (lambda: hi.Zpk(poles=[0.5], gain=0), "gain: must not be zero"),
        (lambda: hi.Zpk(poles=[0.5], initial=[1]), "initial: must be 'stationary' or 'zero'"),
        (
            lambda: hi.Sos(sections=[[1, 0, 0]]),
            "sections[0]: must be the six coefficients [b_0, b_1, b_2, 1,",
        ),
        (lambda: hi.Sos(sections=[[1, 0, 0, 2, 0, 0]]), "section 0 must have 1 as its fourth number, not 2"),
        (lambda: hi.Sos(sections=[[0, 0, 0, 1, 0, 0]]), "section 0 has no numerator: b_0, b_1 and b_2 are z"),
        (
            lambda: hi.Sos(sections=[[1, 0, 0, 1, -2, 0]]),
            "is unstable: poles 2 lie on or outside the unit ci",
        ),
        (lambda: hi.Sos(sections=[]), "sections: must be a list of at least 1"),
    ],
)
def test_what_is_refused(make, message):
    with pytest.raises(hi.ConfigError, match=re.escape(message)):
        make()


class TestContinuous:
    T = 0.1 * np.arange(300)

    def test_is_the_block_of_its_coefficients(self):
        # 5 (s + 2)/((s + 0.5)((s + 1)^2 + 4)), delayed
        block = hi.ContinuousZpk(zeros=[-2], poles=[-0.5, [-1, 2]], gain=5, delay=0.37)
        found = block.transfer_function()
        assert found.b == pytest.approx((4.0, 2.0))
        assert found.a == pytest.approx((2.4, 1.0, 0.4))
        same = hi.Continuous(b=[4, 2], a=[2.4, 1, 0.4], delay=0.37)
        np.testing.assert_allclose(block.simulate(U, 0.1), same.simulate(U, 0.1), atol=1e-12)

    def test_a_pole_at_zero_is_an_integrator(self):
        ramp = hi.ContinuousZpk(poles=[0], gain=3).simulate(np.ones(300), 0.1)
        np.testing.assert_allclose(ramp, 3 * self.T, atol=1e-10)
        block = hi.ContinuousZpk(poles=[0, -0.5], gain=0.5)
        wanted = self.T - 2 * (1 - np.exp(-self.T / 2))
        np.testing.assert_allclose(block.simulate(np.ones(300), 0.1), wanted, atol=1e-10)

    def test_a_resonance_rings_as_its_pair_says(self):
        # The step response of 4.01/(s^2 + 0.2 s + 4.01)
        y = hi.ContinuousZpk(poles=[[-0.1, 2]], gain=4.01).simulate(np.ones(300), 0.1)
        wanted = 1 - np.exp(-0.1 * self.T) * (np.cos(2 * self.T) + 0.05 * np.sin(2 * self.T))
        np.testing.assert_allclose(y, wanted, atol=1e-11)

    def test_it_is_a_block_of_every_system(self):
        block = hi.ContinuousZpk(poles=[-1])
        for system in (
            hi.Hammerstein(nonlinearity="abs", linear=block),
            hi.Wiener(nonlinearity="abs", linear=block),
            hi.WienerHammerstein(input_linear=block, nonlinearity="identity", output_linear=block),
        ):
            steps = hi.Staircase(levels=[0, 1], hold=1)
            assert hi.simulate(system, steps, 200, dt=0.1).y[-1] == pytest.approx(1, abs=1e-6)

    @pytest.mark.parametrize(
        ("fields", "message"),
        [
            ({}, "poles: is required"),
            ({"poles": []}, "the block is improper: 0 zeros must be fewer than the 0 poles"),
            ({"poles": [-1], "zeros": [1]}, "the block is improper: 1 zeros must be fewer than the 1 poles"),
            ({"poles": [1, -1]}, "is unstable: the poles 1 do not lie in the left half plane"),
            ({"poles": [[0, 2]]}, "is unstable: the poles 0+-2j do not lie in the left half plane"),
            ({"poles": [0, -1], "gain": 0}, "gain: must not be zero"),
            ({"poles": [-1, 0], "zeros": [0]}, "b_0 = 0 takes an integrator away"),
        ],
    )
    def test_what_is_refused(self, fields, message):
        with pytest.raises(hi.ConfigError, match=re.escape(message)):
            hi.ContinuousZpk(**fields)

    def test_repeated_poles_are_held(self):
        block = hi.ContinuousZpk(poles=[-1] * 4).transfer_function()
        assert block.a == pytest.approx((4, 6, 4, 1))

    def test_an_order_that_its_coefficients_cannot_hold_is_refused(self):
        zeros, poles, gain = signal.butter(8, [1, 1.02], "bandpass", output="zpk", analog=True)
        with pytest.raises(hi.ConfigError, match="has zeros and poles that its coefficients cannot hold"):
            hi.ContinuousZpk(zeros=written(zeros), poles=written(poles), gain=float(gain))


def test_a_block_that_is_scaled_keeps_its_sections_and_its_digits():
    block = SecondOrderSections.of(signal.butter(8, [0.49, 0.51], "bandpass", output="sos"))
    scaled = block.scaled(-2.5)
    assert isinstance(scaled, SecondOrderSections)
    u = np.random.default_rng(1).uniform(-1, 1, 500)
    np.testing.assert_allclose(scaled.filter(u), -2.5 * block.filter(u), rtol=1e-12, atol=1e-15)
    # In the middle of the band the gain is one.
    gain = np.abs(scaled.frequency_response(np.array([np.pi / 2 / 0.1]), 0.1))
    np.testing.assert_allclose(gain, 2.5, rtol=1e-6)
