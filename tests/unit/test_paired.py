"""Paired differences: what failures and ties count as, intervals, tests, and their error rates by simulation.

The rates are those that docs/comparisons.md states. A rate that is exact is held within the binomial interval
of 99.8 % of so many replications, one that is a bound below its upper end.
"""

import numpy as np
import pytest
from scipy.stats import PermutationMethod, binom, chi2, wilcoxon

from hident.numerics.influence import hangs_on_one, largest_share
from hident.numerics.paired import (
    critical_difference,
    friedman_p,
    groups_within,
    holm,
    mean_interval,
    median_interval,
    paired,
    shared_ranks,
    signed_rank_p,
    trials_to_tell,
)

NAN, INF = float("nan"), float("inf")


def most(replications, rate):
    return binom.ppf(0.999, replications, rate)


def within(count, replications, rate):
    return binom.ppf(0.001, replications, rate) <= count <= most(replications, rate)


# --- outcomes


def test_a_failure_is_a_loss_and_two_are_a_tie():
    pair = paired([NAN, 1.0, INF, 2.0], [1.0, NAN, NAN, 3.0])
    assert pair.outcomes.tolist() == [-1, 1, 0, 1]
    assert pair.differences.tolist() == [INF, -INF, 0.0, -1.0]
    assert (pair.wins, pair.ties, pair.losses, pair.failed, pair.both_failed) == (2, 1, 1, (2, 2), 1)
    assert pair.win_rate == 0.625


def test_high_values_are_good_where_they_are():
    pair = paired([NAN, 90.0, 80.0], [1.0, 80.0, 80.0], best="highest")
    assert pair.outcomes.tolist() == [-1, 1, 0]
    assert pair.differences.tolist() == [-INF, 10.0, 0.0]


def test_signed_errors_are_compared_by_their_size():
    pair = paired([-5.0, 0.1, -2.0], [1.0, -0.2, 2.0], best="zero")
    assert pair.outcomes.tolist() == [-1, 1, 0]
    assert pair.differences.tolist() == pytest.approx([4.0, -0.1, 0.0])


def test_values_that_differ_by_rounding_are_tied():
    a = np.array([0.1 + 0.2, 1.0, 1.0])
    b = np.array([0.3, 1.0 + 1e-12, 1.01])
    assert paired(a, b).outcomes.tolist() == [0, 0, 1]
    assert paired(a, b, equal=0.02).outcomes.tolist() == [0, 0, 0]
    assert paired(a, b, equal=0.02).p == 1.0


def test_ratios_of_what_has_no_logarithm_are_undefined():
    pair = paired([1.0, 0.0, 0.0, -1.0], [2.0, 0.0, 1.0, 1.0], log=True)
    assert pair.differences[:2].tolist() == [pytest.approx(-np.log(2.0)), 0.0]
    assert (pair.undefined, pair.wins, pair.ties, pair.losses) == (2, 3, 1, 0)
    assert np.isnan([pair.p, *pair.interval("mean"), *pair.interval("median")]).all()


def test_the_side_is_that_of_the_ranks_not_of_the_mean():
    # Better in nine of ten trials, and much worse in one.
    first = np.r_[np.full(9, 1.0), 100.0]
    pair = paired(first, np.arange(10) * 0.01 + 1.5)
    assert (pair.side, np.sign(pair.interval("mean").estimate)) == (1, 1.0)
    assert paired([1.0, 2.0], [2.0, 1.0]).side == 0


# --- intervals


def test_an_interval_needs_two_values_and_a_spread():
    assert mean_interval(np.array([2.0]))[0] == 2.0
    assert np.isnan(mean_interval(np.array([2.0]))[1:]).all()
    assert mean_interval(np.array([0.1 + 0.2, 0.3])) == (0.1 + 0.2,) * 3
    assert np.isnan(mean_interval(np.array([]))).all()
    assert np.isnan(median_interval(np.array([]))).all()


def test_the_interval_of_the_mean_is_that_of_student():
    # Student 1908, the additional sleep by two drugs: R, t.test(extra ~ group, paired = TRUE).
    sleep = np.array([-1.2, -2.4, -1.3, -1.3, 0.0, -1.0, -1.8, -0.8, -4.6, -1.4])
    np.testing.assert_allclose(mean_interval(sleep), (-1.58, -2.4598858, -0.7001142), atol=1e-7)


def test_a_median_may_be_infinite_and_has_no_interval_of_five():
    assert median_interval(np.array([1.0, INF, INF])).estimate == INF
    assert median_interval(np.array([INF, INF])).estimate == INF
    assert np.isnan(median_interval(np.array([-INF, INF])).estimate)
    assert np.isnan(median_interval(np.arange(5.0))[1:]).all()
    assert median_interval(np.arange(6.0))[1:] == (0.0, 5.0)


DRAWS = {
    "normal": (lambda rng, n: rng.normal(size=n), 0.0),
    "difference of exponentials": (lambda rng, n: rng.exponential(size=n) - rng.exponential(size=n), 0.0),
    "chi-squared": (lambda rng, n: rng.normal(size=n) ** 2, 1.0),
    "lognormal": (lambda rng, n: np.exp(rng.normal(size=n)), np.exp(0.5)),
}


@pytest.mark.parametrize(
    ("name", "n", "rate"),
    [
        ("normal", 10, 0.95),
        ("normal", 50, 0.95),
        ("difference of exponentials", 10, 0.96),
        ("difference of exponentials", 50, 0.95),
        ("chi-squared", 10, 0.86),
        ("chi-squared", 20, 0.89),
        ("chi-squared", 100, 0.93),
        ("lognormal", 10, 0.84),
        ("lognormal", 20, 0.87),
        ("lognormal", 100, 0.91),
    ],
)
def test_coverage_of_the_interval_of_the_mean(name, n, rate):
    draw, mean = DRAWS[name]
    rng, count = np.random.default_rng(1), 2000
    held = sum(low <= mean <= high for _, low, high in (mean_interval(draw(rng, n)) for _ in range(count)))
    # The rates are given to a hundredth.
    assert abs(held / count - rate) < 0.005 + 3.0 * np.sqrt(rate * (1.0 - rate) / count)


@pytest.mark.parametrize("n", [6, 20, 51])
def test_the_interval_of_the_median_holds_it_at_least_as_often_as_it_says(n):
    rng, count = np.random.default_rng(2), 600
    draws = (np.exp(2.0 * rng.normal(size=n)) for _ in range(count))
    missed = sum(not low <= 1.0 <= high for _, low, high in map(median_interval, draws))
    assert missed <= most(count, 0.05)


# --- tests


def test_the_signed_rank_test_of_darwins_maize():
    # Charles Darwin 1876, heights of cross- less self-fertilised plants: R, wilcox.test(d).
    d = np.array([49, -67, 8, 16, 6, 23, 28, 41, 14, 29, 56, 24, 75, 60, -48])
    assert signed_rank_p(d.astype(float)) == pytest.approx(0.04126, abs=5e-6)


@pytest.mark.parametrize("n", [1, 2, 9, 50])
def test_without_ties_the_test_is_that_of_scipy(n):
    d = np.random.default_rng(n).normal(0.2, 1.0, n)
    assert signed_rank_p(d) == pytest.approx(wilcoxon(d, method="exact").pvalue, rel=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_with_ties_and_zeros_the_test_is_that_of_all_signs(seed):
    d = np.random.default_rng(seed).integers(-2, 4, 8).astype(float)
    every = wilcoxon(d, zero_method="pratt", method=PermutationMethod()).pvalue
    assert signed_rank_p(d) == pytest.approx(every, rel=1e-12)


def test_beyond_fifty_trials_the_test_goes_on_without_a_step():
    d = np.random.default_rng(3).normal(0.3, 1.0, 50)
    assert signed_rank_p(np.r_[d, 1e-9]) == pytest.approx(signed_rank_p(d), rel=0.05)


def test_equal_methods_have_the_p_value_one():
    assert [signed_rank_p(np.zeros(n)) for n in (1, 2, 50)] == [1.0] * 3
    assert signed_rank_p(np.array([1.0])) == 1.0
    assert signed_rank_p(np.array([1.0, 2.0])) == 0.5


def test_only_the_sign_of_an_infinite_difference_counts():
    d = np.array([0.1, -0.2, 0.3, 0.4, INF, INF, -INF])
    assert signed_rank_p(d) == signed_rank_p(np.where(np.isinf(d), np.sign(d) * 7.0, d))


def test_holm_adjusts_as_published():
    # R, p.adjust(c(.01, .02, .03, .04), "holm").
    np.testing.assert_allclose(holm([0.01, 0.02, 0.03, 0.04]), [0.04, 0.06, 0.06, 0.06])
    np.testing.assert_allclose(holm([0.04, NAN, 0.01]), [0.04, NAN, 0.02])
    assert holm([0.9, 0.8]).tolist() == [1.0, 1.0]
    assert holm([]).tolist() == []


@pytest.mark.parametrize("tests", [1, 3, 28, 1008])
def test_the_trials_to_tell_are_the_least(tests):
    n = trials_to_tell(tests)
    assert signed_rank_p(np.arange(1.0, n + 1)) * tests <= 0.05
    assert signed_rank_p(np.arange(1.0, n)) * tests > 0.05


def exchangeable(rng, methods, n, *, ties=False, failing=0.0):
    """Scores (methods, n) of methods that differ by nothing: a trial's difficulty times an error of each."""
    scores = np.exp(rng.normal(size=n)) * rng.normal(size=(methods, n)) ** 2
    if ties:
        scores = np.ceil(2.0 * scores)
    return np.where(rng.random((methods, n)) < failing, NAN, scores)


@pytest.mark.parametrize(
    ("ties", "failing", "n"), [(False, 0.0, 20), (True, 0.0, 20), (True, 0.3, 20), (True, 0.3, 8)]
)
def test_a_single_test_is_wrong_at_most_at_its_level(ties, failing, n):
    rng, count = np.random.default_rng(3), 500
    pairs = (paired(*exchangeable(rng, 2, n, ties=ties, failing=failing)) for _ in range(count))
    wrong = sum(pair.p <= 0.05 for pair in pairs)
    assert 0 < wrong <= most(count, 0.05)


def test_a_single_exact_test_is_wrong_at_its_level():
    rng, count = np.random.default_rng(4), 1000
    wrong = sum(paired(*exchangeable(rng, 2, 20)).p <= 0.05 for _ in range(count))
    # The largest p-value below 5 % of 20 differences is 0.0484.
    assert within(wrong, count, 0.0484)


def test_a_family_of_independent_tests_is_wrong_at_most_at_the_level():
    rng, count = np.random.default_rng(5), 250
    wrong = sum(
        min(holm([paired(*exchangeable(rng, 2, 20)).p for _ in range(8)])) <= 0.05 for _ in range(count)
    )
    # Of eight independent ones, each at 0.05/8 or at the next p-value below it.
    assert 0 < wrong <= most(count, 0.05)


@pytest.mark.parametrize("failing", [0.0, 0.2])
def test_all_pairs_of_one_case_are_wrong_at_most_at_the_level(failing):
    rng, count = np.random.default_rng(6), 250
    wrong = 0
    for _ in range(count):
        scores = exchangeable(rng, 4, 20, failing=failing)
        p = [paired(scores[i], scores[j]).p for i in range(4) for j in range(i)]
        wrong += min(holm(p)) <= 0.05
    assert wrong <= most(count, 0.05)


def test_true_null_hypotheses_beside_false_ones_are_rejected_at_most_at_the_level():
    rng, count = np.random.default_rng(7), 250
    wrong = found = 0
    for _ in range(count):
        scores = exchangeable(rng, 3, 20)
        scores[2] += 5.0
        p = holm([paired(scores[i], scores[j]).p for i, j in ((0, 1), (0, 2), (1, 2))])
        wrong, found = wrong + (p[0] <= 0.05), found + int(np.sum(p[1:] <= 0.05))
    assert wrong <= most(count, 0.05)
    assert found > 0.9 * 2 * count


@pytest.mark.parametrize(("shift", "least", "greatest"), [(1.0, 0.95, 1.0), (0.5, 0.45, 0.62)])
def test_known_differences_are_found_as_often_as_theory_says(shift, least, greatest):
    # A t-test of 20 normal differences has the powers 0.989 and 0.565, the signed-rank test 0.955 of that n.
    rng, count = np.random.default_rng(8), 400
    pairs = [paired(rng.normal(size=20), np.zeros(20) + shift) for _ in range(count)]
    told = [pair.side for pair in pairs if pair.p <= 0.05]
    assert least <= len(told) / count <= greatest
    assert set(told) <= {1} or told.count(-1) <= 2


def test_a_method_that_fails_often_is_found():
    rng, count, found = np.random.default_rng(9), 100, 0
    for _ in range(count):
        first, second = exchangeable(rng, 2, 30)
        pair = paired(first, np.where(rng.random(30) < 0.6, NAN, second))
        found += pair.p <= 0.05 and pair.side == 1
    assert found > 0.8 * count


# --- ranks over cases


def test_critical_differences_are_those_of_demsar():
    # His Table 5(a): q at 5 % of 2, ..., 10 methods, right to a unit of the last digit.
    table = [1.960, 2.343, 2.569, 2.728, 2.850, 2.949, 3.031, 3.102, 3.164]
    found = [critical_difference(k, 1) / (k * (k + 1) / 6.0) ** 0.5 for k in range(2, 11)]
    np.testing.assert_allclose(found, table, rtol=0.0, atol=1e-3)


# Demsar 2006, Table 6: AUC of C4.5, +m, +cf, +m+cf on 14 data sets. Two that print alike have his ranks 2, 3.
AUC = np.array(
    [
        [0.763, 0.768, 0.771, 0.798],
        [0.599, 0.591, 0.590, 0.569],
        [0.954, 0.971, 0.968, 0.967],
        [0.628, 0.661, 0.654, 0.657],
        [0.882, 0.888, 0.886, 0.898],
        [0.936, 0.931, 0.916, 0.931],
        [0.661, 0.668, 0.609, 0.685],
        [0.583, 0.583, 0.563, 0.625],
        [0.775, 0.838, 0.866, 0.875],
        [1.000, 1.000, 1.000, 1.000],
        [0.940, 0.962, 0.965, 0.962],
        [0.619, 0.666, 0.614, 0.669],
        [0.972, 0.981, 0.9751, 0.975],
        [0.957, 0.978, 0.946, 0.970],
    ]
)


def test_the_example_of_demsar():
    ranks = np.mean([shared_ranks(-row) for row in AUC], axis=0)
    np.testing.assert_allclose(ranks, [3.143, 2.000, 2.893, 1.964], atol=6e-4)
    # He prints chi^2 = 9.28 (3 degrees of freedom), without the correction for ties (three of 2, one of 4).
    corrected = 9.28 / (1.0 - (3 * (2**3 - 2) + (4**3 - 4)) / (14 * (4**3 - 4)))
    assert friedman_p(-AUC) == pytest.approx(chi2.sf(corrected, 3), rel=3e-3)
    assert critical_difference(4, 14) == pytest.approx(1.25, abs=0.005)


def test_equal_methods_share_ranks_and_infinite_ones_are_last():
    assert shared_ranks([1.0, 1.0 + 1e-12, INF, INF]).tolist() == [1.5, 1.5, 3.5, 3.5]
    assert friedman_p(np.ones((10, 3))) == 1.0


def test_groups_are_the_longest_runs():
    assert groups_within([1.0, 1.2, 1.4, 3.0, 3.1], 1.0) == [(0, 2), (3, 4)]
    assert groups_within([1.0, 3.0], 1.0) == []


# --- heavy tails


def test_a_mean_hangs_on_one_value():
    normal = np.random.default_rng(10).normal(size=50)
    assert largest_share(normal) < 0.5
    assert not hangs_on_one(normal)
    assert hangs_on_one(np.r_[normal, 50.0])
    assert hangs_on_one(np.r_[normal, NAN, 50.0])
    # Of few values one may well be half of the spread.
    assert not hangs_on_one([1.0, 1.0, 9.0])
    assert not hangs_on_one([])
    assert not hangs_on_one(np.ones(30))


def test_without_that_value_the_mean_is_another_by_the_root_of_its_share():
    values = np.r_[np.random.default_rng(11).normal(size=200), 30.0]
    moved = abs(np.mean(values) - np.mean(values[:-1])) / (np.std(values, ddof=1) / len(values) ** 0.5)
    assert moved == pytest.approx(largest_share(values) ** 0.5, rel=0.01)


def test_normal_values_hang_on_one_in_fewer_than_one_of_a_hundred_samples():
    rng, count = np.random.default_rng(12), 3000
    wrong = sum(hangs_on_one(row) for row in rng.normal(size=(count, 20)))
    assert wrong <= most(count, 0.01)
