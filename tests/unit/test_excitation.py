"""Every excitation by the properties that define it."""

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
from hident.signals.base import ExcitationSpec
from hident.signals.excitation import (
    Filtered,
    Iid,
    Multisine,
    Multistep,
    Prbs,
    Sine,
    Staircase,
    maximal_sequence,
)
from hident.signals.matlab5 import Rand
from hident.signals.matlab5_streams import Matlab5Streams
from hident.systems.linear import Ar, Fir

AR = Ar(a=(0.5, 0.2))
AT_REST = Ar(a=(0.5, 0.2), initial="zero")
ONE_OF_EACH: dict[str, ExcitationSpec] = {
    "iid uniform": Iid(distribution="uniform", low=-2.0, high=3.0),
    "iid gaussian": Iid(distribution="gaussian", mean=1.0, std=2.0),
    "prbs random": Prbs(order=5, clock=3),
    "prbs ones": Prbs(order=4, clock=2, start="ones"),
    "multistep gaussian": Multistep(std=2.0, switching_time=0.35, limits=(-3.0, 3.0)),
    "multistep uniform": Multistep(distribution="uniform", switching_time=0.3, limits=(0.0, 1.0)),
    "sine": Sine(amplitude=2.0, offset=0.5, period=1.7, phase=0.3),
    "staircase": Staircase(levels=(1.0, -2.0, 0.5), hold=1.3),
    "multisine": Multisine(period=16, rms=1.5, grid="odd", offset=-1.0),
    "filtered iid": Filtered(excitation=Iid(distribution="gaussian", std=1.0), linear=AR),
    "filtered multistep": Filtered(excitation=Multistep(std=2.0, switching_time=0.35), linear=AR),
    "filtered prbs": Filtered(excitation=Prbs(order=5), linear=AR),
    "filtered sine": Filtered(excitation=Sine(period=1.7), linear=Fir(b=(0.0, 1.0, 2.0))),
    "filtered from rest": Filtered(excitation=Iid(distribution="gaussian", std=1.0), linear=AT_REST),
    "filtered from a past": Filtered(excitation=Prbs(order=5), linear=Ar(a=(0.5, 0.2), initial=(1.0, -1.0))),
    "filtered twice": Filtered(
        excitation=Filtered(excitation=Iid(distribution="gaussian", std=1.0), linear=AR),
        linear=Fir(b=(1.0, 2.0)),
    ),
}
DETERMINISTIC = {"prbs ones", "sine", "staircase", "filtered sine"}


def rng(seed=0):
    return np.random.default_rng(seed)


class Case(Spec):
    """What an excitation stands in."""

    excitation: Annotated[ExcitationSpec, Of("excitation")]


def refused(cls, **fields):
    """The message with which the fields are refused."""
    with pytest.raises(ValidationError) as caught:
        Case.model_validate({"excitation": {"kind": cls.kind, **fields}})
    (detail,) = caught.value.errors()
    return detail["msg"]


def test_every_kind_is_tried():
    built_in = {
        kind
        for kind, cls in components("excitation").items()
        if cls.__module__ == "hident.signals.excitation"
    }
    assert {spec.kind for spec in ONE_OF_EACH.values()} == built_in


@pytest.mark.parametrize("name", ONE_OF_EACH)
@settings(deadline=None, derandomize=True, max_examples=20)
@given(n=st.integers(1, 60), burn_in=st.integers(0, 60), more=st.integers(0, 30))
def test_the_record_does_not_depend_on_the_burn_in(name, n, burn_in, more):
    spec = ONE_OF_EACH[name]
    whole = spec.sample(n, 0.1, rng(), burn_in)
    assert whole.shape == (burn_in + n,)
    assert whole.dtype == np.float64
    np.testing.assert_array_equal(whole[burn_in:], spec.sample(n, 0.1, rng()))
    np.testing.assert_array_equal(whole[burn_in:], spec.sample(n + more, 0.1, rng())[:n])


@pytest.mark.parametrize("name", ONE_OF_EACH)
def test_the_generator_decides_the_random_ones_only(name):
    spec = ONE_OF_EACH[name]
    same = np.array_equal(spec.sample(50, 0.1, rng(1), 5), spec.sample(50, 0.1, rng(2), 5))
    assert same == (name in DETERMINISTIC)


# --- iid


@pytest.mark.parametrize(
    ("name", "law"),
    [("iid uniform", stats.uniform(-2, 5)), ("iid gaussian", stats.norm(1, 2))],
)
def test_iid_has_its_distribution_and_is_white(name, law):
    n = 100_000
    values = ONE_OF_EACH[name].sample(n, 1.0, rng(3))
    assert stats.kstest(values, law.cdf).pvalue > 0.01
    assert abs(values.mean() - law.mean()) < 3 * law.std() / math.sqrt(n)
    assert values.std() == pytest.approx(law.std(), rel=0.01)
    centred = values - values.mean()
    assert abs(centred[1:] @ centred[:-1] / (centred @ centred)) < 3 / math.sqrt(n)


def test_iid_uniform_is_an_affine_map_of_the_generators_numbers():
    values = Iid(distribution="uniform", low=-3.0, high=3.0).sample(100, 1.0, rng(4))
    np.testing.assert_array_equal(values, 6 * rng(4).random(100) - 3)


def test_iid_messages():
    uniform = {"distribution": "uniform", "low": 0, "high": 1}
    assert refused(Iid, **uniform, std=1.0) == "a uniform distribution takes no std"
    assert refused(Iid, **uniform, mean=0, std=1) == "a uniform distribution takes no mean, std"
    assert refused(Iid, distribution="uniform", low=0) == "a uniform distribution needs high"
    assert refused(Iid, distribution="gaussian", std=1, low=0) == "a gaussian distribution takes no low"
    assert refused(Iid, distribution="gaussian") == "a gaussian distribution needs std"
    assert refused(Iid, distribution="gaussian", std=0) == "must be greater than 0"
    message = "low must be below high, not 1 and 1"
    assert refused(Iid, distribution="uniform", low=1, high=1) == message


# --- prbs


def smallest_period(chips):
    """The smallest cyclic shift that leaves the sequence as it is."""
    size = len(chips)
    divisors = [d for d in range(1, size + 1) if size % d == 0]
    return next(d for d in divisors if np.array_equal(np.roll(chips, d), chips))


@pytest.mark.parametrize("order", range(2, 21))
def test_prbs_is_a_maximal_sequence(order):
    period = 2**order - 1
    u = Prbs(order=order).sample(period, 1.0, rng(order))
    assert set(u) == {-1.0, 1.0}
    assert u.sum() == 1  # one more high than low
    assert smallest_period(u) == period
    correlation = np.fft.irfft(np.abs(np.fft.rfft(u)) ** 2, period) / period
    assert correlation[0] == pytest.approx(1.0, abs=1e-10)
    np.testing.assert_allclose(correlation[1:], -1 / period, atol=1e-10)


@pytest.mark.parametrize("order", range(2, 13))
def test_prbs_runs_through_every_register_but_zero(order):
    chips = maximal_sequence(np.ones(order, dtype=np.uint8)).astype(int)
    registers = sum(np.roll(chips, -stage) << stage for stage in range(order))
    np.testing.assert_array_equal(np.sort(registers), np.arange(1, 2**order))


def test_prbs_follows_the_shift_register_step_by_step():
    order, taps = 12, (12, 6, 4, 1)
    expected = [1, 0, 0, 1, 1, 0, 1, 0, 1, 1, 1, 0]
    for t in range(order, 2**order - 1):
        expected.append(sum(expected[t - tap] for tap in taps) % 2)
    chips = maximal_sequence(np.array(expected[:order], dtype=np.uint8))
    np.testing.assert_array_equal(chips, expected)


@settings(deadline=None, derandomize=True, max_examples=30)
@given(order=st.integers(2, 8), clock=st.integers(1, 7), burn_in=st.integers(0, 40), seed=st.integers(0, 99))
def test_prbs_holds_each_chip_for_a_clock_period(order, clock, burn_in, seed):
    n = 3 * clock * (2**order - 1)
    fast = Prbs(order=order, levels=(0, 5)).sample(n // clock, 1.0, rng(seed))
    slow = Prbs(order=order, levels=(0, 5), clock=clock).sample(n, 1.0, rng(seed), burn_in)
    np.testing.assert_array_equal(slow[burn_in:], np.repeat(fast, clock))
    period = clock * (2**order - 1)
    np.testing.assert_array_equal(slow[period:], slow[:-period])


def test_prbs_starts():
    np.testing.assert_array_equal(Prbs(order=6, start="ones").sample(6, 1.0, rng()), np.ones(6))
    starts = {tuple(Prbs(order=2).sample(2, 1.0, rng(seed))) for seed in range(40)}
    assert starts == {(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0)}


def test_prbs_messages():
    assert refused(Prbs, order=1) == "must be greater than or equal to 2"
    assert refused(Prbs, order=21) == "must be less than or equal to 20"
    assert refused(Prbs, order=5, clock=0) == "must be greater than or equal to 1"
    assert refused(Prbs, order=5, clock=1.5) == "must be a whole number >= 1"
    assert refused(Prbs, order=5, levels=[1, -1]) == "must be [low, high] with low < high"


# --- multistep


@settings(deadline=None, derandomize=True, max_examples=60)
@given(
    dt=st.sampled_from([0.001, 0.01, 0.05, 0.1, 0.3, 1.0]),
    samples=st.integers(1, 50),
    burn_in=st.integers(0, 100),
)
def test_multistep_switches_on_time_when_the_time_is_a_multiple_of_dt(dt, samples, burn_in):
    u = Multistep(std=1.0, switching_time=samples * dt).sample(500, dt, rng(), burn_in)
    switches = np.flatnonzero(np.diff(u)) + 1 - burn_in
    every = np.arange(-(burn_in // samples) * samples, 500, samples)
    np.testing.assert_array_equal(switches, every[every > -burn_in])


def test_multistep_switches_at_the_first_sample_after_another_time():
    u = Multistep(std=1.0, switching_time=2.5).sample(20, 1.0, rng())
    np.testing.assert_array_equal(np.flatnonzero(np.diff(u)) + 1, [3, 5, 8, 10, 13, 15, 18])


def test_multistep_levels():
    free = Multistep(std=2.0, mean=1.0, switching_time=5).sample(500_000, 1.0, rng(5))[::5]
    assert stats.kstest(free, stats.norm(1, 2).cdf).pvalue > 0.01
    clipped = Multistep(std=2.0, mean=1.0, switching_time=5, limits=(-1, 2))
    np.testing.assert_array_equal(clipped.sample(500_000, 1.0, rng(5))[::5], np.clip(free, -1, 2))
    uniform = Multistep(distribution="uniform", switching_time=5, limits=(-1, 2))
    levels = uniform.sample(500_000, 1.0, rng(6))[::5]
    assert stats.kstest(levels, stats.uniform(-1, 3).cdf).pvalue > 0.01


def test_multistep_messages():
    assert refused(Multistep, switching_time=1) == "a gaussian distribution needs std"
    uniform = {"distribution": "uniform", "switching_time": 1}
    assert refused(Multistep, **uniform) == "a uniform distribution needs limits"
    message = "a uniform distribution takes no std"
    assert refused(Multistep, **uniform, limits=[0, 1], std=1) == message
    assert refused(Multistep, std=1, switching_time=0) == "must be greater than 0"
    message = "must be [low, high] with low < high"
    assert refused(Multistep, std=1, switching_time=1, limits=[2, 2]) == message
    open_end = {"distribution": "uniform", "switching_time": 1, "limits": [0, math.inf]}
    assert refused(Multistep, **open_end) == "a uniform distribution needs finite limits"


def test_a_multistep_may_be_clipped_on_one_side_only():
    one = Multistep(std=2.0, switching_time=1, limits=(0, math.inf)).sample(500, 1.0, rng())
    free = Multistep(std=2.0, switching_time=1).sample(500, 1.0, rng())
    np.testing.assert_array_equal(one, np.maximum(free, 0))


# --- sine


@settings(deadline=None, derandomize=True, max_examples=50)
@given(
    periods=st.integers(1, 9),
    per_period=st.integers(3, 40),
    frequency=st.floats(0.01, 100),
    phase=st.floats(-4, 4),
    burn_in=st.integers(0, 50),
)
def test_sine_over_whole_periods_has_the_mean_and_rms_of_its_formula(
    periods, per_period, frequency, phase, burn_in
):
    dt, n = 2 * math.pi / frequency / per_period, periods * per_period
    spec = Sine(amplitude=3.0, offset=2.0, frequency=frequency, phase=phase, whole_periods=True)
    spec.check(n, dt)
    u = spec.sample(n, dt, rng(), burn_in)
    assert u[burn_in:].mean() == pytest.approx(2.0, abs=1e-10)
    assert u[burn_in:].std() == pytest.approx(3 / math.sqrt(2), abs=1e-10)
    assert u[burn_in] == pytest.approx(2 + 3 * math.sin(phase), abs=1e-12)
    np.testing.assert_allclose(u[per_period:], u[:-per_period] if per_period < len(u) else [], atol=1e-10)


def test_sine_takes_the_period_or_the_frequency():
    by_period = Sine(period="200*pi").sample(100, 0.1, rng())
    np.testing.assert_allclose(by_period, np.sin(0.01 * 0.1 * np.arange(100)), atol=1e-12)
    np.testing.assert_allclose(by_period, Sine(frequency=0.01).sample(100, 0.1, rng()), atol=1e-12)


def test_sine_messages():
    expected = "give exactly one of frequency and period ({} found)"
    assert refused(Sine) == expected.format("neither")
    assert refused(Sine, frequency=1, period=1) == expected.format("both")
    assert refused(Sine, frequency=0) == "must be greater than 0"


def not_whole(spec, n, dt):
    with pytest.raises(ValueError, match="not a whole number") as caught:
        spec.check(n, dt)
    return str(caught.value)


def test_whole_periods_messages():
    sine = Sine(period=2.5, whole_periods=True)
    assert not_whole(sine, 101, 1.0) == (
        "a record of 101 samples holds 40.4 periods of 2.5 samples, "
        "not a whole number (nearest sample counts that fit: 100, 105)"
    )
    assert not_whole(sine, 3, 1.0) == (
        "a record of 3 samples holds 1.2 periods of 2.5 samples, "
        "not a whole number (nearest sample counts that fit: 5)"
    )
    golden = Sine(period=(1 + math.sqrt(5)) / 2, whole_periods=True)
    assert not_whole(golden, 3, 1.0) == (
        "a record of 3 samples holds 1.854101966 periods of 1.618033989 samples, not a whole number "
        "(nearest sample counts that fit: none; make the period a multiple of dt)"
    )
    multisine = Multisine(period=20, rms=1.0, whole_periods=True)
    assert not_whole(multisine, 50, 0.1) == (
        "a record of 50 samples holds 2.5 periods of 20 samples, "
        "not a whole number (nearest sample counts that fit: 40, 60)"
    )
    multisine.check(60, 0.1)


def test_whole_periods_are_asked_for_only_when_wanted():
    Sine(period=2.5).check(101, 1.0)
    Multisine(period=20, rms=1.0).check(50, 1.0)


@settings(deadline=None, derandomize=True, max_examples=50)
@given(n=st.integers(1, 500), tenths=st.integers(20, 200))
def test_whole_periods_names_the_nearest_counts_that_fit(n, tenths):
    spec = Sine(period=tenths / 10, whole_periods=True)
    fitting = [m for m in range(1, n + 201) if 10 * m % tenths == 0]
    if n in fitting:
        spec.check(n, 1.0)
    else:
        nearest = [m for m in fitting if m < n][-1:] + [m for m in fitting if m > n][:1]
        assert f"that fit: {', '.join(map(str, nearest))})" in not_whole(spec, n, 1.0)


# --- staircase


def test_staircase_holds_each_level_and_goes_on_with_the_last():
    u = Staircase(levels=(3, 1, 2), hold=0.3).sample(11, 0.1, rng(), burn_in=2)
    np.testing.assert_array_equal(u, [3, 3] + [3] * 3 + [1] * 3 + [2] * 5)


@settings(deadline=None, derandomize=True, max_examples=50)
@given(
    levels=st.lists(st.floats(-9, 9), min_size=1, max_size=8, unique=True),
    hold=st.floats(0.1, 30) | st.integers(1, 300).map(lambda tenths: tenths / 10),
    dt=st.sampled_from([0.01, 0.1, 0.3]),
)
def test_staircase_needs_the_samples_that_its_message_names(levels, hold, dt):
    spec = Staircase(levels=levels, hold=hold)
    needed = next(
        n
        for n in range(max(int((len(levels) - 1) * hold / dt) - 2, 1), 100_000)
        if spec.sample(n, dt, rng())[-1] == levels[-1]
    )
    spec.check(needed, dt)
    if len(levels) > 1:
        with pytest.raises(ValueError, match="ends before") as caught:
            spec.check(needed - 1, dt)
        assert str(caught.value) == (
            f"a record of {needed - 1} samples ends before the last of {len(levels)} levels "
            f"(at least {needed} samples reach it)"
        )


def test_staircase_messages():
    message = "must be a list of at least 1"
    assert refused(Staircase, levels=[], hold=1) == message
    assert refused(Staircase, levels=[1], hold=-1) == "must be greater than 0"


# --- multisine


@settings(deadline=None, derandomize=True, max_examples=50)
@given(
    period=st.integers(3, 80),
    fraction=st.floats(0, 1),
    grid=st.sampled_from(["odd", "full"]),
    seed=st.integers(0, 99),
)
def test_multisine_excites_the_wanted_harmonics_equally(period, fraction, grid, seed):
    largest = (period - 1) // 2
    highest = max(1, round(fraction * largest))
    spec = Multisine(period=period, rms=2.5, grid=grid, highest=highest, offset=0.7)
    u = spec.sample(2 * period, 1.0, rng(seed), burn_in=period)
    wave = u[period : 2 * period]
    np.testing.assert_array_equal(u, np.tile(wave, 3))
    amplitudes = 2 * np.abs(np.fft.rfft(wave - 0.7)) / period
    wanted = np.zeros(len(amplitudes), dtype=bool)
    wanted[1 : highest + 1 : 2 if grid == "odd" else 1] = True
    np.testing.assert_allclose(amplitudes[wanted], 2.5 * math.sqrt(2 / wanted.sum()), rtol=1e-10)
    np.testing.assert_allclose(amplitudes[~wanted], 0, atol=1e-10)
    assert np.sqrt(np.mean((wave - 0.7) ** 2)) == pytest.approx(2.5, rel=1e-12)


def test_multisine_reaches_just_below_half_the_period_by_default():
    for period, largest in [(8, 3), (9, 4), (10, 4)]:
        default = Multisine(period=period, rms=1.0).sample(period, 1.0, rng())
        named = Multisine(period=period, rms=1.0, highest=largest).sample(period, 1.0, rng())
        np.testing.assert_array_equal(default, named)


def test_multisine_on_the_odd_grid_is_half_wave_antisymmetric():
    u = Multisine(period=64, rms=1.0, grid="odd").sample(64, 1.0, rng(7))
    np.testing.assert_allclose(u[32:], -u[:32], atol=1e-14)


def test_multisine_phases_are_uniform_and_independent():
    spec = Multisine(period=2001, rms=1.0)
    phases = np.angle(np.fft.rfft(spec.sample(2001, 1.0, rng(8)))[1:])
    assert stats.kstest(phases, stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 0.01
    assert abs(np.mean(np.exp(1j * np.diff(phases)))) < 3 / math.sqrt(len(phases))


def test_multisine_messages():
    message = "highest must be below period/2, not 5 (allowed: 1 to 4 for the period 10)"
    assert refused(Multisine, period=10, rms=1, highest=5) == message
    assert refused(Multisine, period=2, rms=1) == "must be greater than or equal to 3"
    assert refused(Multisine, period=10, rms=0) == "must be greater than 0"


# --- filtered


def test_filtered_from_rest_is_the_recursion_on_the_sources_record():
    source = Iid(distribution="uniform", low=-3.0, high=3.0)
    spec = Filtered(excitation=source, linear=Ar(a=(0.5,), initial="zero"))
    x, w = spec.sample(50, 1.0, rng(1), burn_in=7), 6 * rng(1).random(50) - 3
    np.testing.assert_array_equal(x[:7], 0)
    np.testing.assert_allclose(x[7], w[0], atol=1e-15)
    np.testing.assert_allclose(x[8:], 0.5 * x[7:-1] + w[1:], atol=1e-14)


def test_filtered_input_of_wang_zhang_ljung():
    spec = Filtered(
        excitation=Iid(distribution="uniform", low=-3, high=3), linear=Ar(a=(0.5,), initial="zero")
    )
    expected = TransferFunction(a=(0.5,)).filter(6 * Rand(1).random(100) - 3)
    streams = Matlab5Streams.model_validate({"input": {"state": 1}})
    found = spec.sample(100, 1.0, streams.generator("input", 0, 0, 0))
    np.testing.assert_allclose(found, expected, rtol=1e-14)
    printed = [2.716692897939691, 2.582719449619831, 4.014624566363304, 2.596263428214787, 3.342590902785814]
    np.testing.assert_allclose(found[:5], printed, rtol=1e-14)


@pytest.mark.parametrize(
    ("burn_in", "before"), [(0, []), (1, [1.0]), (2, [-3.0, 1.0]), (4, [0.0, 0.0, -3.0, 1.0])]
)
def test_filtered_from_past_outputs_has_them_before_the_record(burn_in, before):
    spec = Filtered(excitation=Prbs(order=5), linear=Ar(a=(0.5, 0.2), initial=(1.0, -3.0)))
    x, w = spec.sample(10, 1.0, rng(2), burn_in), Prbs(order=5).sample(10, 1.0, rng(2))
    np.testing.assert_array_equal(x[:burn_in], before)
    assert x[burn_in] == pytest.approx(0.5 * 1.0 + 0.2 * -3.0 + w[0], abs=1e-14)
    assert x[burn_in + 1] == pytest.approx(0.5 * x[burn_in] + 0.2 * 1.0 + w[1], abs=1e-14)


@pytest.mark.parametrize("burn_in", [0, 5, 300])
@pytest.mark.parametrize("name", ["filtered iid", "filtered prbs", "filtered multistep", "filtered sine"])
def test_filtered_stationary_obeys_the_block_from_the_burn_in_on(name, burn_in):
    spec = ONE_OF_EACH[name]
    assert isinstance(spec, Filtered)
    settling = spec.linear.burn_in()
    x = spec.sample(200, 0.1, rng(3), burn_in)
    lead = 0 if name in ("filtered prbs", "filtered sine") else settling
    w = spec.excitation.sample(200 + lead, 0.1, rng(3), burn_in + settling - lead)
    expected = spec.linear.transfer_function().filter(w)[settling:]
    np.testing.assert_allclose(x, expected, rtol=1e-12, atol=1e-13)


def test_filtered_stationary_is_stationary_from_the_first_sample_on():
    spec = Filtered(excitation=Iid(distribution="gaussian", std=1.0), linear=Ar(a=(0.9,)))
    generator = rng(4)
    drawn = np.array([spec.sample(3, 1.0, generator, burn_in=2) for _ in range(4000)])
    law = stats.norm(0, 1 / math.sqrt(1 - 0.9**2))
    for column in drawn.T:
        assert stats.kstest(column, law.cdf).pvalue > 0.01
    np.testing.assert_allclose(np.corrcoef(drawn.T)[0], 0.9 ** np.arange(5), atol=0.03)


@settings(deadline=None, derandomize=True, max_examples=30)
@given(frequency=st.floats(0.01, 3), a=st.floats(-0.9, 0.9), burn_in=st.integers(0, 50))
def test_filtered_sine_is_the_frequency_response(frequency, a, burn_in):
    spec = Filtered(excitation=Sine(frequency=frequency), linear=Ar(a=(a,)))
    response = 1 / (1 - a * np.exp(-1j * frequency))
    t = np.arange(-burn_in, 60)
    expected = np.abs(response) * np.sin(frequency * t + np.angle(response))
    np.testing.assert_allclose(spec.sample(60, 1.0, rng(), burn_in), expected, atol=1e-11)


def test_filtered_passes_on_what_its_source_checks():
    source = Multisine(period=20, rms=1.0, whole_periods=True)
    assert not_whole(Filtered(excitation=source, linear=AR), 50, 1.0) == not_whole(source, 50, 1.0)


def test_filtered_messages():
    linear = {"kind": "ar", "a": [0.5]}
    message = "is required: The excitation that drives the block"
    assert refused(Filtered, linear=linear) == message
    message = "is required: The block: its output is applied to the system"
    assert refused(Filtered, excitation={"kind": "sine", "period": 3}) == message
    excitation = {"kind": "sine", "period": 3}
    message = "is unstable: poles 1.5 lie on or outside the unit circle"
    assert refused(Filtered, excitation=excitation, linear={"kind": "ar", "a": [1.5]}) == message
