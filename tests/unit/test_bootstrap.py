"""Blocks of residuals that are drawn again, and standard errors of what follows each other."""

from __future__ import annotations

import numpy as np
import pytest

from hident.numerics.bootstrap import block_length
from hident.numerics.choices import standard_error, within_one_standard_error
from hident.numerics.parts import joined, whole


def autoregressive(a, n, seed):
    from scipy.signal import lfilter

    return np.asarray(lfilter([1.0], [1.0, -a], np.random.default_rng(seed).standard_normal(n + 500))[500:])


def test_blocks_grow_with_what_the_residuals_remember():
    lengths = [
        np.median([block_length(autoregressive(a, 2000, seed), whole(2000)) for seed in range(9)])
        for a in (0.0, 0.5, 0.9)
    ]
    assert lengths[0] <= 3
    # Politis and White's optimum for AR(1): G/g(0) = 2 a/((1 - a)^2 (1 + a)) (1 - a)^2 = 2 a/(1 - a^2).
    for length, a in zip(lengths[1:], (0.5, 0.9), strict=True):
        exact = (1.5 * (2.0 * a / (1.0 - a**2)) ** 2 * 2000) ** (1.0 / 3.0)
        assert length == pytest.approx(exact, rel=0.35)


@pytest.mark.parametrize(
    ("residuals", "parts"),
    [(np.zeros(50), whole(50)), (np.ones(1), whole(1)), (np.arange(6.0), joined([3, 3]))],
)
def test_what_tells_nothing_has_some_length(residuals, parts):
    assert 1 <= block_length(residuals, parts) <= 3


def test_no_product_reaches_from_one_experiment_into_another():
    # Halves of opposite mean, cut where they meet: a slow signal for one experiment, none for many.
    e = np.repeat(np.random.default_rng(0).standard_normal(400), 5)
    one = block_length(e, whole(2000))
    assert block_length(e, joined([5] * 400)) <= 2 < one


def test_the_standard_error_of_correlated_values_is_that_of_their_mean():
    means = [autoregressive(0.9, 1000, seed).mean() for seed in range(400)]
    estimated = [standard_error(autoregressive(0.9, 1000, seed)) for seed in range(100)]
    # Independent, they would have a fourth of it.
    assert np.mean(estimated) == pytest.approx(np.std(means), rel=0.2)
    assert standard_error(np.zeros(1)) == 0.0


def test_equal_candidates_are_all_within():
    squared = np.random.default_rng(0).chisquare(1, 100)
    assert within_one_standard_error([squared, squared.copy()]).all()
