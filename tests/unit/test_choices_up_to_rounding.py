"""Choices that another last bit does not turn."""

import math
from pathlib import Path

import numpy as np
import pytest

from hident import plugins
from hident.engine.experiment import load
from hident.engine.trial import Job, estimate, generate
from hident.estimators.moving_horizon.searches import best_pair
from hident.numerics.choices import first_least, nearly_least, simplest, sorting


def test_the_first_of_values_that_are_equal_up_to_rounding_is_chosen():
    values = np.array([0.5, 0.021709218322063586, 0.021709218322063614])
    assert first_least(values) == 1
    assert first_least(np.nextafter(values, [1.0, 1.0, 0.0])) == 1


def test_a_value_that_is_really_smaller_is_chosen():
    assert first_least([1.0, 1.0 - 1e-6]) == 1


def test_what_is_not_finite_is_never_chosen():
    assert first_least([math.nan, math.inf, -math.inf, 2.0]) == 3
    with pytest.raises(ValueError, match="no candidate"):
        first_least([math.nan, math.inf])


def test_differences_below_the_rounding_of_the_terms_do_not_count():
    assert first_least([3e-16, 1e-16], scale=10.0) == 0
    assert first_least([3e-16, 1e-16]) == 1


def test_a_grid_is_searched_in_its_written_order():
    assert first_least([[2.0, 1.0], [1.0, 3.0]]) == 1


def test_within_a_factor_of_the_least_the_bound_itself_counts_whatever_its_last_bit():
    bound = 1.25 * 0.3
    for last in (np.nextafter(bound, 0.0), bound, np.nextafter(bound, 1.0)):
        assert nearly_least([last, 0.3, 0.376, math.nan], factor=1.25).tolist() == [True, True, False, False]


def test_of_the_nearly_best_the_simplest_is_chosen_then_the_best_then_the_first():
    assert simplest([0.9, 0.12, 0.11, 0.1], [1, 2, 2, 3], factor=1.25) == 2
    assert simplest([0.11 * (1 + 1e-15), 0.11, 0.1], [2, 2, 3], factor=1.25) == 0
    assert simplest([3e-16, 1e-16, math.inf], [2, 2, 1], factor=1.25, scale=1.0) == 0


@pytest.mark.parametrize("count", [50, 5000])
def test_equal_values_keep_their_order_when_they_are_sorted(count):
    values = np.random.default_rng(1).integers(0, 7, count).astype(float)
    order = sorting(values)
    np.testing.assert_array_equal(order, sorted(range(count), key=values.__getitem__))


def test_without_equal_values_the_order_is_any_sort_s():
    values = np.random.default_rng(1).normal(size=1000)
    np.testing.assert_array_equal(sorting(values), np.argsort(values))


def test_a_pair_that_has_not_converged_wins_only_where_none_has():
    loss, converged = np.array([[0.1, 0.3], [0.2, math.nan]]), np.array([[False, True], [True, False]])
    assert best_pair(loss, converged, 1.0) == 2
    assert best_pair(loss, np.zeros((2, 2), dtype=bool), 1.0) == 0
    assert best_pair(np.full(2, 0.2) - [0.0, 3e-17], np.ones(2, dtype=bool), 1.0) == 0


def test_partition_points_that_tie_in_theory_are_the_first_pair_whatever_the_last_bits_of_the_record():
    # Beyond both of two upper points lies one level of the input, so that the fits are the same.
    plugins.load()
    plan = load(Path(__file__).parents[2] / "configs" / "chen_fig4.yaml")
    unit = next(u for u in plan.units if u.name.startswith("three-segment") and u.labels["type"] == "II")
    points = [
        estimate(unit.data, Job(unit.estimator, ()), generate(unit.data, 2009, 10, k), 2009, 10).values["u_1"]
        for k in range(4)
    ]
    np.testing.assert_allclose(points, points[0], rtol=1e-12)
