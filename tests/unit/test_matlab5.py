"""MATLAB's generators: known numbers, a plain reference word by word, and the properties of the streams."""

import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, stats

from hident.signals import matlab5
from hident.signals.matlab5 import Beginnings, MatlabStream, Rand, Randn, normals, twister

STATES = [0, 1, 2, 100, 31415926, 2**31, 2**32 - 1]
MASK32 = 2**32 - 1


# --- the reference: one number at a time, in floats, as MATLAB computes


def shr3(j):
    j ^= j << 13 & MASK32
    j ^= j >> 17
    return j ^ (j << 5 & MASK32)


def reference_rand(state, n):
    start = j = state or 2**31
    z = []
    for _ in range(32):
        x = 0.0
        for _ in range(53):
            j = shr3(j)
            x = 2 * x + (j >> 19 & 1)
        z.append(x * 2.0**-53)
    j, i, borrow, drawn = start, 0, 0.0, []
    for _ in range(n):
        x = z[(i + 20) % 32] - z[(i + 5) % 32] - borrow
        borrow = 0.0
        if x < 0:
            x, borrow = x + 1, 2.0**-53
        z[i] = x
        i = (i + 1) % 32
        old, j = j, shr3(j)
        fraction, exponent = math.frexp(x)
        mask = (j << 32 & (2**52 - 1)) ^ old
        drawn.append(math.ldexp(int(fraction * 2**53) ^ mask, exponent - 53))
    return drawn


def words_of(state):
    cong, jsr = 362436069, state or 521288629
    while True:
        cong, jsr = (69069 * cong + 1234567) & MASK32, shr3(jsr)
        word = (cong + jsr) & MASK32
        yield word - 2**32 if word >= 2**31 else word


def log(x):
    return math.log(x) if x else -math.inf


def reference_normal(words):
    """One draw from an iterator of signed words."""
    z, a, b, c, xn = matlab5._Z, 12.37586, 0.4878992, 12.67706, 2.776994
    word = next(words)
    strip, high = word % 64, z[word % 64 + 1]
    r = word * 2.0**-31 * high
    if abs(r) <= z[strip]:
        return r
    x = (abs(r) - z[strip]) / (high - z[strip])
    y = 0.5 + next(words) * 2.0**-32
    if x + y > 1.301198:
        return math.copysign(b - b * x, r)
    if x + y <= 0.9689279:
        return r
    x = b - b * x
    if y > c - a * math.exp(-0.5 * x * x):
        return math.copysign(x, r)
    if math.exp(-0.5 * high * high) + y * 0.01958303 / high <= math.exp(-0.5 * r * r):
        return r
    while True:
        x = log(0.5 + next(words) * 2.0**-32) / xn
        if -2 * log(0.5 + next(words) * 2.0**-32) > x * x:
            return math.copysign(xn - x, r)


def reference_randn(state, n):
    words = words_of(state)
    return [reference_normal(words) for _ in range(n)]


# --- known numbers


def test_rand_begins_as_in_matlab():
    printed = [0.95012928514718, 0.23113851357429, 0.60684258354179, 0.48598246870930, 0.89129896614890]
    np.testing.assert_allclose(Rand(0).random(5), printed, rtol=0, atol=5e-15)


def test_randn_begins_as_in_matlab():
    printed = [-0.43256481152822, -1.66558437823810, 0.12533230647483, 0.28767642035855]
    np.testing.assert_allclose(Randn(0).standard_normal(4), printed, rtol=0, atol=5.1e-15)


@pytest.mark.parametrize("state", [0, 1, 1337, 5489, 2**32 - 1])
def test_twister_is_mt19937_with_the_original_seeding(state):
    np.testing.assert_array_equal(
        twister(state).random(1000), np.random.RandomState(state).random_sample(1000)
    )


def test_twister_begins_as_in_matlab():
    printed = [0.262024675015582, 0.158683972154466, 0.278126519494360, 0.459316887214567]
    np.testing.assert_allclose(twister(1337).random(4), printed, rtol=0, atol=5e-16)
    # MATLAB's start-up state.
    np.testing.assert_allclose(twister(5489).random(2), [0.814723686393179, 0.905791937075619], atol=5e-16)


# --- the ziggurat


def density(x):
    return np.exp(-0.5 * np.asarray(x) ** 2)


def test_the_strips_of_the_ziggurat_have_equal_areas():
    area = math.sqrt(math.pi / 2) / 64
    widest = optimize.brentq(lambda x: x * density(x) - 3 * area, 1, 5, xtol=1e-15)
    z = np.full(65, widest)
    for k in range(60, -1, -1):
        z[k] = math.sqrt(-2 * math.log(density(z[k + 1]) + area / z[k + 1]))
    np.testing.assert_allclose(matlab5._Z, z, rtol=0, atol=1.3e-7)
    assert round(z[64], 6) == matlab5._XN
    assert round(area, 8) == matlab5._PC


def test_the_constants_of_the_tips():
    z, area = matlab5._Z, math.sqrt(math.pi / 2)
    b = math.sqrt(area * z[0] * (1 - np.mean(z[:64] / z[1:])) / (1 - density(z[0])))
    a = z[0] / (b * (1 - density(z[0])))
    assert round(b, 7) == matlab5._B
    assert round(a, 5) == matlab5._A
    assert round(1 + a * density(z[0]), 5) == matlab5._C
    assert round(2 - z[0] / b, 6) == matlab5._C2
    c1 = 0.5 + 64 * z[61] * (density((z[61] + z[60]) / 2) - density(z[61])) / area
    assert c1 == pytest.approx(matlab5._C1, abs=7e-6)


def test_the_tail_is_a_normal_tail():
    drawn = Randn(3).standard_normal(400_000)
    tail = np.abs(drawn[np.abs(drawn) > matlab5._XN])
    expected = 2 * stats.norm.sf(matlab5._XN) * len(drawn)
    assert abs(len(tail) - expected) < 3 * math.sqrt(expected)
    law = stats.truncnorm(matlab5._XN, np.inf)
    assert stats.kstest(tail, law.cdf).pvalue > 0.01


# --- against the reference


@pytest.mark.parametrize("state", STATES)
def test_streams_are_those_of_the_reference(state):
    n = 100_000 if state == 1 else 5_000
    np.testing.assert_array_equal(Rand(state).random(n), reference_rand(state, n))
    np.testing.assert_allclose(Randn(state).standard_normal(n), reference_randn(state, n), rtol=4e-15)


def by_reference(words):
    """The draws that a row of words completes."""
    signed, drawn = iter(words.astype(np.int32).tolist()), []
    try:
        while True:
            drawn.append(reference_normal(signed))
    except StopIteration:
        return drawn


@settings(deadline=None, derandomize=True, max_examples=60)
@given(seed=st.integers(0, 10**6), width=st.integers(1, 12))
def test_draws_that_need_several_words_never_cross_a_row(seed, width):
    words = np.random.default_rng(seed).integers(0, 2**32, (40, width), dtype=np.uint32)
    # Extreme positions: most draws take several words, in every strip up to the tail.
    often = np.random.default_rng(seed + 1).random(words.shape) < 0.7
    words[often] |= np.uint32(0x7FF00000)
    values, starts = matlab5._ziggurat(words)
    for row, value, start in zip(words, values, starts, strict=True):
        np.testing.assert_allclose(value[start], by_reference(row), rtol=4e-15)


def test_a_uniform_number_of_zero_in_the_tail_is_harmless():
    tail = np.uint32(0x7FFFFFFC)  # strip 60, at its edge: the slow path
    lowest = np.uint32(0x80000000)
    middle = np.uint32(0x6E000000)
    row = [tail, middle, lowest, middle, middle, lowest, np.uint32(5)]
    reached = False
    for y in range(0, 2**32, 2**22):
        row[1] = np.uint32(y)
        words = np.array([row], dtype=np.uint32)
        values, starts = matlab5._ziggurat(words)
        np.testing.assert_allclose(values[starts], by_reference(words[0]), rtol=4e-15)
        reached |= bool(starts.sum() == 2)
    assert reached


# --- streams


@settings(deadline=None, derandomize=True, max_examples=40)
@given(state=st.integers(0, 2**32 - 1), sizes=st.lists(st.integers(0, 90), min_size=1, max_size=8))
def test_a_stream_goes_on_where_the_last_call_ended(state, sizes):
    uniform, normal, n = Rand(state), Randn(state), sum(sizes)
    np.testing.assert_array_equal(
        np.concatenate([uniform.random(size) for size in sizes]), Rand(state).random(n)
    )
    np.testing.assert_array_equal(
        np.concatenate([normal.standard_normal(size) for size in sizes]), Randn(state).standard_normal(n)
    )


def test_calls_of_irregular_sizes_make_one_sequence():
    sizes = [1, 0, 5000, 3, 12, 27, 13, 40_000, 1, 1]
    uniform, normal = Rand(7), Randn(7)
    np.testing.assert_array_equal(
        np.concatenate([uniform.random(size) for size in sizes]), Rand(7).random(sum(sizes))
    )
    np.testing.assert_array_equal(
        np.concatenate([normal.standard_normal(size) for size in sizes]),
        Randn(7).standard_normal(sum(sizes)),
    )


def test_sizes_are_those_of_numpy():
    whole = Randn(4).standard_normal(12)
    np.testing.assert_array_equal(Randn(4).standard_normal((3, 4)), whole.reshape(3, 4))
    assert Randn(4).standard_normal() == whole[0]
    assert Rand(4).random() == Rand(4).random(1)[0]
    assert Rand(4).random((0, 3)).shape == (0, 3)


def test_many_states_at_once_are_the_single_ones():
    states = [0, 5, 1, 10_000, 2**32 - 1]
    expected = [Randn(state).standard_normal(300) for state in states]
    np.testing.assert_array_equal(normals(states, 300), expected)
    assert normals(states, 0).shape == (5, 0)


def test_what_is_drawn_belongs_to_the_caller():
    beginnings = Beginnings([4, 5])
    first = Randn(4, beginnings).standard_normal(9)
    kept = first.copy()
    first *= 2.0
    np.testing.assert_array_equal(Randn(4, beginnings).standard_normal(9), kept)


def test_a_short_reserve_of_words_is_made_longer(monkeypatch):
    expected = normals(range(1, 200), 15)
    monkeypatch.setattr(matlab5, "_SPARE", 1)
    np.testing.assert_array_equal(normals(range(1, 200), 15), expected)


@pytest.mark.parametrize("drawn", [Rand(1).random(10**6), twister(1).random(10**6)], ids=["state", "twister"])
def test_a_million_uniform_numbers(drawn):
    assert drawn.min() > 0
    assert drawn.max() < 1
    assert stats.kstest(drawn, "uniform").pvalue > 0.01
    pairs = np.histogram2d(drawn[::2], drawn[1::2], bins=20, range=[[0, 1]] * 2)[0]
    assert stats.chisquare(pairs.ravel()).pvalue > 0.01


def test_a_million_normal_numbers():
    drawn = Randn(1).standard_normal(10**6)
    assert stats.kstest(drawn, "norm").pvalue > 0.01
    assert abs(drawn.mean()) < 3e-3
    assert abs(drawn.var() - 1) < 3 * math.sqrt(2e-6)
    assert abs(stats.kurtosis(drawn)) < 3 * math.sqrt(24e-6)
    assert abs(drawn[1:] @ drawn[:-1]) < 3e3


def test_streams_of_different_states_are_uncorrelated():
    n = 2000
    drawn = normals(range(1, 101), n)[:, 50:]
    correlation = np.asarray(np.corrcoef(drawn))[np.triu_indices(100, 1)] * math.sqrt(n - 50)
    assert stats.kstest(correlation, "norm").pvalue > 0.01
    uniform = np.array([Rand(state).random(n) for state in range(1, 41)])
    correlation = np.asarray(np.corrcoef(uniform))[np.triu_indices(40, 1)] * math.sqrt(n)
    assert stats.kstest(correlation, "norm").pvalue > 0.01


def test_the_first_draws_of_neighbouring_states_are_not_independent():
    first = normals(range(1, 101), 1)[:, 0]
    assert first.min() > 0
    assert abs(normals(range(1, 101), 10)[:, 9].mean()) < 3 / math.sqrt(100)


@pytest.mark.parametrize("stream", [Rand(1).random, Randn(1).standard_normal], ids=["rand", "randn"])
def test_memory_is_a_small_multiple_of_the_output(stream):
    stream(10)
    tracemalloc.start()
    try:
        drawn = stream(200_000)
        assert tracemalloc.get_traced_memory()[1] < 10 * drawn.nbytes
    finally:
        tracemalloc.stop()


# --- what excitations and noises call


def test_a_matlab_stream_joins_rand_and_randn_of_one_state():
    stream, uniform, normal = MatlabStream(9), Rand(9), Randn(9)
    for size in (3, 5):
        np.testing.assert_array_equal(stream.random(size), uniform.random(size))
        np.testing.assert_array_equal(stream.standard_normal(size), normal.standard_normal(size))


def test_a_matlab_stream_with_the_twister_keeps_the_ziggurat():
    stream = MatlabStream(9, "twister")
    np.testing.assert_array_equal(stream.random(5), twister(9).random(5))
    np.testing.assert_array_equal(stream.standard_normal(5), Randn(9).standard_normal(5))


@pytest.mark.parametrize("generator", ["state", "twister"])
def test_whole_numbers_are_uniform(generator):
    stream = MatlabStream(2, generator)
    drawn = [stream.integers(1, 8) for _ in range(3500)]
    assert all(type(number) is int for number in drawn)
    assert stats.chisquare(np.bincount(drawn, minlength=9)[1:8]).pvalue > 0.01
    assert set(drawn) == set(range(1, 8))


@pytest.mark.parametrize("make", [Rand, Randn, twister, MatlabStream, lambda state: normals([1, state], 3)])
@pytest.mark.parametrize(
    ("state", "shown"),
    [(-1, "-1"), (2**32, "4294967296"), (1.5, "1.5"), (math.nan, "nan"), (math.inf, "inf")],
)
def test_states_out_of_range_are_refused(make, state, shown):
    with pytest.raises(ValueError, match="whole number") as caught:
        make(state)
    assert str(caught.value) == f"a state is a whole number from 0 to 4294967295, not {shown}"
