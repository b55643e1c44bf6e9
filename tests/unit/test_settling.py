"""Settling times: the last crossing of the band, whatever the damping and the multiplicity of the poles."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.stats import gamma

from hident.linear_blocks import ContinuousTransferFunction

QUICK = settings(deadline=None, derandomize=True, max_examples=60)


def from_poles(poles, b=(1.0,)):
    falling = np.poly(poles).real
    return ContinuousTransferFunction(tuple(b), tuple((falling / falling[-1])[-2::-1]))


def error(block, t):
    """The error of the step response relative to its final value at the times (K,), by partial fractions."""
    poles = block.poles()
    others = poles[:, None] - poles + np.eye(len(poles))
    leading = block.a[-1] * np.prod(others, axis=1)
    residues = np.polyval(block.b[::-1], poles) / (block.b[0] * poles * leading)
    return (residues @ np.exp(np.outer(poles, t))).real


def test_a_lightly_damped_block_settles_at_the_last_crossing_not_the_last_seen():
    assert ContinuousTransferFunction((1.0,), (0.02, 1.0)).settling_time() == pytest.approx(
        298.614820, abs=1e-6
    )


@pytest.mark.parametrize("damping", [0.3, 1e-1, 1e-2, 1e-3, 1e-4, 1e-6])
@pytest.mark.parametrize("band", [0.05, 0.02, 0.3])
def test_any_damping(damping, band):
    found = ContinuousTransferFunction((1.0,), (2 * damping, 1.0)).settling_time(band)
    omega = np.sqrt(1 - damping**2)

    def away(t):
        return np.exp(-damping * t) * (np.cos(omega * t) + damping / omega * np.sin(omega * t))

    assert abs(away(found)) == pytest.approx(band, rel=1e-9)
    # The peaks, at multiples of pi / omega, are e^(-damping t) high: the next one is inside.
    half = np.pi / omega
    following = np.ceil(found / half) * half
    assert np.exp(-damping * following) <= band
    assert np.exp(-damping * (following - half)) >= band


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5, 6])
@pytest.mark.parametrize("tau", [1e-3, 1.0, 4e5])
def test_multiple_poles(order, tau):
    wanted = tau * brentq(lambda t: gamma.sf(t, order) - 0.05, 0.0, 50.0, xtol=1e-13, rtol=1e-14)
    assert from_poles([-1.0 / tau] * order).settling_time() == pytest.approx(wanted, rel=1e-9)


def test_a_slow_pole_with_fast_ones():
    slow = -np.log(0.05) * 1e6
    for fast in ([-1.0], [-1.0, -1.0], [-1.0 + 3j, -1.0 - 3j]):
        found = from_poles([-1e-6, *fast]).settling_time()
        assert found == pytest.approx(slow, rel=1e-5)
        assert found > slow


def test_a_fast_oscillation_on_a_slow_decay():
    block = from_poles([-1e-3, -0.02 + 10j, -0.02 - 10j], b=(1.0, 500.0, 9.0))
    found = block.settling_time()
    after = np.linspace(found, found + 4000.0, 2_000_001)[1:]
    assert abs(error(block, np.array([found]))[0]) == pytest.approx(0.05, rel=1e-9)
    assert np.max(np.abs(error(block, after))) < 0.05


def test_a_response_that_never_leaves_the_band_has_settled():
    # The zero all but cancels the pole.
    block = ContinuousTransferFunction((1.0, 0.99), (2.0, 1.0))
    assert block.settling_time(0.999) == pytest.approx(-np.log(0.999), rel=0.02)
    assert ContinuousTransferFunction((0.0, 1.0), (2.0, 1.0)).settling_time() == np.inf
    assert ContinuousTransferFunction((1.0,), (-2.0, 1.0)).settling_time() == np.inf


@st.composite
def blocks(draw):
    real = [-(10.0 ** draw(st.floats(-2, 2))) for _ in range(draw(st.integers(0, 2)))]
    pairs = draw(st.integers(0 if real else 1, 2))
    poles = list(real)
    for _ in range(pairs):
        omega, damping = 10.0 ** draw(st.floats(-1, 1)), 10.0 ** draw(st.floats(-2.5, -0.1))
        poles += [omega * (-damping + 1j * np.sqrt(1 - damping**2))]
        poles += [poles[-1].conjugate()]
    b = [1.0, *draw(st.lists(st.floats(-3, 3), max_size=len(poles) - 1))]
    gaps = np.abs(np.subtract.outer(poles, poles)) + np.eye(len(poles))
    assume(np.min(gaps / np.abs(poles)) > 1e-2)
    return from_poles(poles, b)


@QUICK
@given(block=blocks(), band=st.sampled_from([0.02, 0.05, 0.2]))
def test_after_it_the_response_stays_in_the_band_and_at_it_it_enters(block, band):
    found = block.settling_time(band)
    poles = block.poles()
    slowest, fastest = np.min(-poles.real), np.max(np.abs(poles))
    points = min(int(40 * fastest * 12 / slowest), 400_000)
    after = found + np.linspace(0.0, 12.0 / slowest, points)
    assert np.max(np.abs(error(block, after))) <= band * (1 + 1e-6)
    if found > 0.0:
        assert abs(error(block, np.array([found]))[0]) == pytest.approx(band, rel=1e-6)


@QUICK
@given(block=blocks(), unit=st.sampled_from([1e-6, 1e-2, 1e3]))
def test_time_is_in_the_unit_of_the_coefficients(block, unit):
    other = ContinuousTransferFunction(
        tuple(b * unit**i for i, b in enumerate(block.b)),
        tuple(a * unit**i for i, a in enumerate(block.a, start=1)),
    )
    assert other.settling_time() == pytest.approx(unit * block.settling_time(), rel=1e-6)
