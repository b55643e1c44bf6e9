"""Printed numbers against the joint distribution of our trials: error rates with known truth."""

import numpy as np
import pytest

from hident.ledger.joint import adjusted_p, combined_p, joint_p, replicates

MIXED = np.linalg.cholesky(0.8 * np.ones((6, 6)) + 0.2 * np.eye(6))


def drawn(rng, n):
    """Correlated rows with a heavy tail, a skewed column and rounding."""
    rows = rng.standard_normal((n, 6)) @ MIXED.T
    rows[:, 1] = np.exp(2 * rows[:, 1])
    rows[:, 2] = np.tan(0.45 * np.pi * np.tanh(rows[:, 2]))
    return rows


def values(function, shift, *, tables=2000, n=60):
    rng = np.random.default_rng(11)
    half = np.array([0.05, 0.5, 0.0, 0.0, 0.05, 0.0])
    found = []
    for _ in range(tables):
        pool = drawn(rng, n + 1)
        unit = np.where(half > 0, 2 * half, 1.0)
        printed = np.where(half > 0, np.rint(pool[-1] / unit) * unit, pool[-1]) + shift
        found.append(function(pool[:-1], printed, half))
    return np.array(found)


@pytest.mark.parametrize("level", [0.05, 0.2, 0.5])
def test_a_true_row_is_rejected_at_the_stated_rate(level):
    p = values(joint_p, 0.0)
    # Of 2000 tables 3 standard errors; ties make it no less than exact.
    assert np.mean(p <= level) == pytest.approx(level, abs=3 * (level * (1 - level) / 2000) ** 0.5 + 1 / 61)


def test_a_true_row_of_several_blocks_is_rejected_at_the_stated_rate():
    def in_blocks(rows, printed, half):
        return joint_p(rows, printed, half, "aabbbb")

    p = values(in_blocks, 0.0)
    assert np.mean(p <= 0.05) == pytest.approx(0.05, abs=3 * (0.05 * 0.95 / 2000) ** 0.5 + 1 / 61)


def test_blocks_find_in_few_trials_what_the_whole_does_not():
    """Six rows of seven numbers, forty trials."""
    rng = np.random.default_rng(4)
    mixed = np.linalg.cholesky(0.9 * np.ones((7, 7)) + 0.1 * np.eye(7))

    def table(n):
        return (rng.standard_normal((n, 6, 7)) @ mixed.T).reshape(n, 42)

    labels = np.repeat(range(6), 7).tolist()
    shift = np.tile([1.0, 0, 0, 0, 0, 0, 0], 6)
    found = []
    for _ in range(100):
        rows, printed = table(40), table(1)[0] + shift
        found.append([joint_p(rows, printed, np.zeros(42), blocks) for blocks in ((), labels)])
    whole, blocks = np.mean(np.array(found) <= 0.05, axis=0)
    assert blocks > 0.7
    assert whole < blocks - 0.4


def test_a_shift_against_the_correlation_is_found_that_no_number_shows():
    shift = np.array([1.4, 0, 0, -1.4, 0, 0])
    rejected = np.mean(values(joint_p, shift, tables=300) <= 0.05)
    alone = np.mean([p[0] <= 0.05 for p in values(adjusted_p, shift, tables=300)])
    assert rejected > 0.8
    assert alone < 0.2


def test_the_least_adjusted_p_is_small_at_the_stated_rate():
    least = values(adjusted_p, 0.0).min(axis=1)
    assert np.mean(least <= 0.05) == pytest.approx(0.05, abs=3 * (0.05 * 0.95 / 2000) ** 0.5 + 1 / 61)


def test_a_number_far_out_is_found_among_many():
    p = values(adjusted_p, np.array([50.0, 0, 0, 0, 0, 0]), tables=50)
    assert p[:, 0].max() < 0.05
    assert p[:, 3].min() > 0.01


def test_the_most_extreme_row_has_the_least_p():
    rows = np.random.default_rng(3).normal(size=(99, 4))
    assert joint_p(rows, np.full(4, 50.0), np.zeros(4)) == 0.01
    assert joint_p(rows, np.zeros(4), np.zeros(4)) > 0.5


def test_constants():
    rows = np.ones((50, 2))
    assert joint_p(rows, np.ones(2), np.zeros(2)) == 1.0
    # What does not vary has no distribution to be far out in.
    assert joint_p(rows, np.array([1.0, 2.0]), np.zeros(2)) == 0.0
    assert joint_p(rows, np.array([1.0, 1.04]), np.array([0.0, 0.05])) == 1.0
    assert adjusted_p(rows, np.array([1.0, 2.0]), np.zeros(2)).tolist() == pytest.approx([1.0, 1 / 51])


def test_combined_p_is_uniform_and_leaves_out_what_is_unknown():
    p = np.random.default_rng(2).uniform(size=(2000, 5))
    found = np.array([combined_p(row) for row in p])
    assert np.mean(found < 0.05) == pytest.approx(0.05, abs=0.015)
    assert combined_p([0.3, float("nan")]) == pytest.approx(0.3)
    assert np.isnan(combined_p([float("nan")]))
    assert combined_p([0.0, 0.9]) == 0.0


@pytest.mark.parametrize("runs", [10, 100, None])
def test_averages_are_rejected_at_about_the_stated_rate(runs):
    """The bootstrap's rate is its large-sample one."""
    rng = np.random.default_rng(5)
    mean = [lambda values: values.mean(axis=-1)] * 6
    rejected = 0
    for _ in range(200):
        ours = rng.standard_normal((100, 6)) @ MIXED.T
        theirs = np.zeros(6) if runs is None else (rng.standard_normal((runs, 6)) @ MIXED.T).mean(axis=0)
        rejected += joint_p(replicates(ours, mean, runs), theirs, np.zeros(6)) <= 0.05
    assert 2 <= rejected <= 24
