"""Every noise by its level, its colour and its messages."""

import math
from typing import Annotated

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy import stats

from hident.config.spec import Of, Spec, components
from hident.linear_blocks import TransferFunction
from hident.signals.base import NoiseSpec
from hident.signals.noise import Autoregressive, Rounding, White

N = 100_000
ONE_OF_EACH: list[NoiseSpec] = [
    White(std=0.5),
    White(distribution="uniform", half_width=0.1),
    Autoregressive(a=(0.9,), variance=2.0),
    Autoregressive(a=(1.2, -0.6), nsr=0.3, distribution="uniform", initial="zero"),
    Rounding(step=0.01),
]


def rng(seed=0):
    return np.random.default_rng(seed)


def noise(spec, n=N, seed=0):
    return spec.measure(np.zeros(n), rng(seed))


class Case(Spec):
    """What a noise stands in."""

    noise: Annotated[NoiseSpec, Of("noise")]


def refused(cls, **fields):
    """The message with which the fields are refused."""
    with pytest.raises(ValidationError) as caught:
        Case.model_validate({"noise": {"kind": cls.kind, **fields}})
    (detail,) = caught.value.errors()
    return detail["msg"]


def test_every_kind_is_tried():
    built_in = {kind for kind, cls in components("noise").items() if cls.__module__ == "hident.signals.noise"}
    assert {spec.kind for spec in ONE_OF_EACH} == built_in


@pytest.mark.parametrize("spec", ONE_OF_EACH, ids=repr)
def test_noise_is_a_function_of_the_generator_and_leaves_the_output_alone(spec):
    output = rng(1).standard_normal(200)
    before = output.copy()
    measured = spec.measure(output, rng(2))
    np.testing.assert_array_equal(output, before)
    assert not np.shares_memory(measured, output)
    assert measured.shape == output.shape
    assert measured.dtype == np.float64
    np.testing.assert_array_equal(measured, spec.measure(output, rng(2)))
    drawn = not isinstance(spec, Rounding)
    assert np.array_equal(measured, spec.measure(output, rng(3))) != drawn


# --- levels

LEVELS = [
    ({"std": 0.3}, 0.3),
    ({"variance": 0.09}, 0.3),
    ({"distribution": "uniform", "std": 0.3}, 0.3),
    ({"distribution": "uniform", "variance": 0.09}, 0.3),
]


@pytest.mark.parametrize(
    ("level", "std"), [*LEVELS, ({"distribution": "uniform", "half_width": 0.3}, 0.1 * 3**0.5)]
)
def test_white_noise_has_its_distribution_and_level(level, std):
    values = noise(White(**level))
    width = math.sqrt(3) * std
    law = stats.uniform(-width, 2 * width) if "distribution" in level else stats.norm(0, std)
    assert stats.kstest(values, law.cdf).pvalue > 0.01
    assert values.std() == pytest.approx(std, rel=0.01)
    assert abs(values.mean()) < 3 * std / math.sqrt(N)
    assert abs(values[1:] @ values[:-1] / (values @ values)) < 3 / math.sqrt(N)


@pytest.mark.parametrize(("level", "std"), LEVELS)
@pytest.mark.parametrize("a", [(0.8,), (-0.5,), (1.2, -0.6)])
def test_autoregressive_noise_has_its_level(level, std, a):
    assert noise(Autoregressive(a=a, **level)).std() == pytest.approx(std, rel=0.02)


@pytest.mark.parametrize("initial", ["stationary", "zero"])
@pytest.mark.parametrize("distribution", ["gaussian", "uniform"])
def test_the_level_of_the_innovation_is_that_of_the_driving_noise(initial, distribution):
    a = (1.2, -0.6)
    spec = Autoregressive(a=a, std=0.3, of="innovation", initial=initial, distribution=distribution)
    coloured = noise(spec)
    driving = TransferFunction(b=(1.0, *(-value for value in a))).filter(coloured)[2:]
    width = 0.3 * math.sqrt(3)
    law = stats.norm(0, 0.3) if distribution == "gaussian" else stats.uniform(-width, 2 * width)
    assert stats.kstest(driving, law.cdf).pvalue > 0.01


@settings(deadline=None, derandomize=True, max_examples=50)
@given(pole=st.floats(-0.99, 0.99))
def test_stationary_variance_of_first_order_noise_is_exact(pole):
    by_noise = Autoregressive(a=(pole,), std=1.0)
    by_innovation = Autoregressive(a=(pole,), variance=1 - pole**2, of="innovation")
    np.testing.assert_allclose(noise(by_noise, 50), noise(by_innovation, 50), rtol=1e-12)


@settings(deadline=None, derandomize=True, max_examples=50)
@given(radius=st.floats(0.05, 0.98), angle=st.floats(0.1, 3.0))
def test_stationary_variance_of_second_order_noise_is_exact(radius, angle):
    a1, a2 = 2 * radius * math.cos(angle), -(radius**2)
    variance = (1 - a2) / ((1 + a2) * ((1 - a2) ** 2 - a1**2))
    by_noise = Autoregressive(a=(a1, a2), std=math.sqrt(variance))
    by_innovation = Autoregressive(a=(a1, a2), std=1.0, of="innovation")
    np.testing.assert_allclose(noise(by_noise, 50), noise(by_innovation, 50), rtol=1e-9)


@settings(deadline=None, derandomize=True, max_examples=30)
@given(nsr=st.floats(0.01, 0.95), scale=st.floats(1e-3, 1e3), shift=st.floats(-10, 10))
def test_nsr_scales_the_noise_with_the_output(nsr, scale, shift):
    output = np.sin(np.arange(500.0))
    for unit in (White(nsr=nsr), Autoregressive(a=(0.7,), nsr=nsr)):
        added = unit.measure(output, rng()) - output
        scaled = scale * (output + shift)
        np.testing.assert_allclose(
            unit.measure(scaled, rng()) - scaled, scale * added, atol=1e-12 * scale * (1 + abs(shift))
        )


@pytest.mark.parametrize("nsr", [0.05, 0.5, 0.9])
@pytest.mark.parametrize("kind", [White, Autoregressive])
def test_nsr_is_the_noise_over_the_measured_output(nsr, kind):
    fields = {"a": (0.5,)} if kind is Autoregressive else {}
    output = 3 + np.sin(0.1 * np.arange(N))
    measured = kind(nsr=nsr, **fields).measure(output, rng(4))
    assert (measured - output).std() / measured.std() == pytest.approx(nsr, rel=0.02)


@pytest.mark.parametrize("zero", [{"std": 0}, {"variance": 0}, {"nsr": 0}])
def test_level_zero_gives_a_copy(zero):
    output = rng().standard_normal(50)
    uniform = White(distribution="uniform", half_width=0)
    for spec in (White(**zero), Autoregressive(a=(0.5,), **zero), uniform):
        measured = spec.measure(output, rng())
        np.testing.assert_array_equal(measured, output)
        assert not np.shares_memory(measured, output)


def test_a_constant_output_has_no_noise_by_nsr():
    np.testing.assert_array_equal(White(nsr=0.5).measure(np.full(20, 2.0), rng()), np.full(20, 2.0))


# --- colour


def autocorrelation(values, lags):
    return np.array([values[lag:] @ values[: len(values) - lag] for lag in lags]) / (values @ values)


@pytest.mark.parametrize("a", [0.9, -0.6])
def test_autocorrelation_of_first_order_noise_is_a_to_the_lag(a):
    lags = np.arange(10)
    found = autocorrelation(noise(Autoregressive(a=(a,), std=1.0), seed=5), lags)
    np.testing.assert_allclose(found, a**lags, atol=0.02)


def test_stationary_noise_starts_with_its_own_variance_and_noise_at_rest_does_not():
    ends = {}
    for initial in ("stationary", "zero"):
        spec = Autoregressive(a=(0.95,), std=1.0, initial=initial)
        ends[initial] = np.array([noise(spec, 60, seed)[[0, -1]] for seed in range(2000)])
    np.testing.assert_allclose(ends["stationary"].std(axis=0), 1.0, rtol=0.05)
    at_rest = math.sqrt(1 - 0.95**2)
    np.testing.assert_allclose(ends["zero"].std(axis=0), [at_rest, 1.0], rtol=0.05)


def test_noise_at_rest_is_the_filtered_generator():
    spec = Autoregressive(a=(0.9,), std=1.0, of="innovation", initial="zero")
    expected = np.zeros(100)
    past = 0.0
    for t, e in enumerate(rng(6).standard_normal(100)):
        expected[t] = past = 0.9 * past + e
    np.testing.assert_allclose(noise(spec, 100, 6), expected, rtol=1e-12)


# --- rounding


@settings(deadline=None, derandomize=True, max_examples=50)
@given(step=st.floats(1e-3, 10), seed=st.integers(0, 99))
def test_rounding_moves_to_the_nearest_multiple(step, seed):
    output = 5 * rng(seed).standard_normal(100)
    rounded = Rounding(step=step).measure(output, rng())
    assert np.max(np.abs(rounded - output)) <= step / 2 * (1 + 1e-12)
    np.testing.assert_allclose(rounded / step, np.rint(rounded / step), rtol=1e-12)
    np.testing.assert_array_equal(Rounding(step=step).measure(rounded, rng()), rounded)


def test_rounding_to_hundredths():
    output = np.array([0.123, -0.127, 2.0, 3.14159])
    np.testing.assert_allclose(
        Rounding(step=0.01).measure(output, rng()), [0.12, -0.13, 2.0, 3.14], rtol=1e-15
    )


# --- messages


def test_level_messages():
    one = "give exactly one of std, variance, nsr"
    assert refused(White) == f"{one}, half_width (none found)"
    assert refused(White, std=1, nsr=0.1) == f"{one}, half_width (std, nsr found)"
    assert refused(Autoregressive, a=[0.5]) == f"{one} (none found)"
    assert refused(Autoregressive, a=[0.5], variance=1, std=1) == f"{one} (std, variance found)"
    assert refused(White, std=-1) == "must be greater than or equal to 0"
    assert refused(White, nsr=1) == "must be less than 1"
    assert refused(White, half_width=1) == "half_width needs the distribution uniform, not gaussian"
    message = "unknown key (allowed: distribution, std, variance, nsr, a, of, initial)"
    assert refused(Autoregressive, a=[0.5], std=1, half_width=1) == message
    message = "nsr is a level of the noise, not of the innovation"
    assert refused(Autoregressive, a=[0.5], nsr=0.1, of="innovation") == message


def test_unstable_noise_is_refused_with_its_poles():
    message = "the noise is unstable: poles must lie inside the unit circle, not at {}"
    assert refused(Autoregressive, a=[1.7, -0.6], std=1) == message.format("1.2")
    assert refused(Autoregressive, a=[1], std=1) == message.format("1")
    assert refused(Autoregressive, a=[1.0000001], std=1) == message.format("1.0000001")
    assert refused(Autoregressive, a=[1.2, -1.0000001], std=1) == message.format(
        "0.6+0.8000001j, 0.6-0.8000001j"
    )
    assert refused(Autoregressive, a=[1, -1.25], std=1) == message.format("0.5+1j, 0.5-1j")
    message = "must be a list of at least 1"
    assert refused(Autoregressive, a=[], std=1) == message


def test_rounding_messages():
    assert refused(Rounding, step=0) == "must be greater than 0"
