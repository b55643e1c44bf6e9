"""What is done to measured samples: ranges, gaps, even times, trends, decimation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import decimate

from hident.measurements.preparation import (
    Samples,
    at_even_times,
    between_gaps,
    decimated,
    less,
    means,
    range_of,
    record_of,
    within,
    without_line,
)
from hident.records import Held

NAN = np.nan


def samples(u, y=None, t=None, name="run", dt=None):
    u = np.asarray(u, dtype=float)
    return Samples(name, u, -u if y is None else np.asarray(y, dtype=float), dt, t)


@pytest.mark.parametrize("text", ["", "..", "3", "a..b", "1..2..3", "-1..4", "1.5..3"])
def test_what_is_no_range(text):
    with pytest.raises(ValueError, match=r"must be a range of samples, .* such as 801\.\.1000"):
        range_of(text)


@pytest.mark.parametrize("text", ["0..4", "5..4"])
def test_a_range_that_holds_nothing(text):
    with pytest.raises(ValueError, match="1 <= FIRST <= LAST"):
        range_of(text)


def test_a_range_counts_from_1_and_has_both_ends():
    ten = samples(range(1, 11), t=np.arange(10.0))
    assert within(ten, "3..5").u.tolist() == [3, 4, 5]
    np.testing.assert_array_equal(within(ten, "9..").t, [8, 9])
    assert within(ten, None) is ten
    with pytest.raises(ValueError, match=r"has 10 samples, fewer than 3\.\.11 needs"):
        within(ten, "3..11")
    with pytest.raises(ValueError, match=r"has 10 samples, fewer than 11\.\. needs"):
        within(ten, "11..")


@given(st.lists(st.sampled_from([0.0, 1.0, 2.0, NAN]), max_size=12))
def test_parts_between_gaps_hold_all_runs_of_two_and_more(u):
    text = "".join("." if np.isnan(value) else str(int(value)) for value in u)
    found = ["".join(str(int(value)) for value in part.u) for part in between_gaps(samples(u))]
    assert found == [run for run in text.split(".") if len(run) > 1]


def test_gaps_of_the_output_and_holes_in_the_times_end_a_part():
    t = np.array([0, 1, 2, 3, 7, 8, 9, NAN, 11, 12])
    y = [1, NAN, 3, 4, 5, 6, 7, 8, 9, 10]
    parts = between_gaps(samples(range(10), y, t))
    assert [(part.name, part.y.tolist()) for part in parts] == [
        ("run 1", [3, 4]),
        ("run 2", [5, 6, 7]),
        ("run 3", [9, 10]),
    ]
    assert [part.t is not None and part.t[0] for part in parts] == [2, 7, 11]


def test_a_line_is_interpolated_exactly_at_even_times():
    t = np.sort(np.random.default_rng(1).uniform(0, 10, 40))
    t[0], t[-1] = 0.0, 10.0
    even = at_even_times(samples(3 * t + 1, 2 - t, t), 0.1)
    grid = 0.1 * np.arange(101)
    np.testing.assert_allclose(even.u, 3 * grid + 1, rtol=1e-13)
    np.testing.assert_allclose(even.y, 2 - grid, rtol=1e-12, atol=1e-12)
    assert (even.dt, even.t) == (0.1, None)


def test_the_error_of_interpolation_falls_with_the_square_of_the_interval():
    def error(n):
        t = np.linspace(0, 6, n) + 0.2 * 6 / n * np.sin(np.arange(n))
        even = at_even_times(samples(np.sin(t), np.cos(t), t), 0.05)
        return np.max(np.abs(even.y - np.cos(t[0] + 0.05 * np.arange(len(even)))))

    orders = np.diff(np.log([error(100), error(200), error(400)])) / -np.log(2)
    assert orders == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize(
    ("t", "dt", "message"),
    [
        (
            [0, 1, 2.2, 3],
            None,
            r"the times are uneven: 2\.2 follows 1 .sample 3., .* 'resample' .--resample 1. ",
        ),
        (
            [0, 1, 2, 5, 6, 9],
            None,
            r"are 1 apart and have 2 holes: 5 follows 2 .sample 4.; .* .--gaps split. ",
        ),
        ([0, 1, 2, 9, 10], None, "are 1 apart and have a hole: 9 follows 2 .sample 4.; 'gaps: split' "),
        (
            [0, 1, 2, 1, 2, 3],
            None,
            "1 follows 2 .sample 4.; records that stand one below the other are read by",
        ),
        ([0, 1, 3, 2, 4], None, "2 follows 3 .sample 4.; sort the lines by time, if they are of one record"),
        ([3, 2, 1], None, "2 follows 3 .sample 2., and so at 1 more samples; .*: turn the lines round"),
        ([0, 1, 1, 2], None, "1 follows 1 .sample 3.; one of two samples at one time must go"),
        ([0, 1, 1], 0.5, "the times do not increase: 1 follows 1 .sample 3."),
        ([0, 2, 1], 0.5, "the times do not increase: 1 follows 2 .sample 3."),
        ([0, 1, 3], 4, "3 samples over a time of 3 cannot be interpolated at intervals of 4"),
        ([0, 1, 3], 1e-9, "3 samples over a time of 3 cannot be interpolated at intervals of 1e-09"),
    ],
)
def test_times_that_cannot_be_made_even(t, dt, message):
    with pytest.raises(ValueError, match=message):
        at_even_times(samples(np.arange(len(t)), t=np.array(t, dtype=float)), dt)


def test_means_are_of_all_experiments():
    assert means([samples([1, 2, 3]), samples([8])]) == (3.5, -3.5)
    assert less(samples([1, 2]), 1, -2).y.tolist() == [1, 0]


def test_a_line_is_taken_off():
    t = np.arange(50.0)
    without = without_line(samples(2 + 3 * t, np.sin(t)))
    np.testing.assert_allclose(without.u, 0, atol=1e-11)
    assert abs(np.polyfit(t, without.y, 1)).max() < 1e-12


@pytest.mark.parametrize("factor", [2, 5])
def test_decimation_is_that_of_scipy_away_from_the_ends(factor):
    u, y = np.random.default_rng(2).normal(size=(2, 400))
    slow = decimated(samples(u, y, dt=0.5), factor)
    for signal, found in ((u, slow.u), (y, slow.y)):
        expected = decimate(signal, factor, ftype="fir")
        np.testing.assert_allclose(found[25:-25], expected[25:-25], rtol=1e-10, atol=1e-12)
    assert slow.dt == 0.5 * factor
    assert decimated(slow, 1) is slow


def test_decimation_keeps_a_level_and_what_is_slow_and_takes_away_what_is_fast():
    k = np.arange(2000)
    slow = decimated(samples(98.6 + np.sin(2 * np.pi * k / 200), np.sin(2 * np.pi * 0.4 * k)), 4)
    np.testing.assert_allclose(slow.u, 98.6 + np.sin(2 * np.pi * k[::4] / 200), atol=0.02)
    assert np.abs(slow.y[30:-30]).max() < 3e-3


def test_too_few_samples_for_the_filter():
    with pytest.raises(ValueError, match="decimation by 3 needs more than 61 samples, not 61"):
        decimated(samples(range(61)), 3)
    with pytest.raises(ValueError, match="decimation by 1000000000 needs"):
        decimated(samples(range(61)), 10**9)


def test_experiments_are_parts_of_one_record():
    one = record_of([samples([1, 2], dt=0.5)], {"input": "V"}, {"output": 3.0})
    assert (one.parts, one.units, one.offsets) == ({}, {"input": "V"}, {"output": 3.0})
    both = record_of([samples([1, 2], dt=0.5, name="a"), samples([3, 4, 5], dt=0.5, name="b")], {}, {})
    assert both.u.tolist() == [1, 2, 3, 4, 5]
    assert both.experiments == (slice(0, 2), slice(2, 5))
    assert list(both.parts) == ["a", "b"]
    held = both.parts["b"].waveform
    assert isinstance(held, Held)
    assert (held.times.tolist(), held.levels.tolist()) == ([0, 0.5, 1], [3, 4, 5])
    with pytest.raises(ValueError, match=r"'b' has an interval of 0\.4, and 'a' of 0\.5: 'resample'"):
        record_of([samples([1, 2], dt=0.5, name="a"), samples([3, 4], dt=0.4, name="b")], {}, {})


def test_no_estimator_can_write_into_a_record():
    record = record_of([samples([1, 2])], {}, {})
    with pytest.raises(ValueError, match="read-only"):
        record.u[0] = 3
