"""Choices that another last bit does not turn."""

import math

import numpy as np
import pytest

from hident.numerics.choices import first_least, simplest


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


@pytest.mark.parametrize("bit", [-1, 0, 1])
def test_an_error_at_the_limit_is_nearly_the_least_whatever_its_last_bit(bit):
    at_limit = 1.25 if bit == 0 else np.nextafter(1.25, 10.0 * bit)
    assert simplest([at_limit, 1.0], [1, 2], factor=1.25) == 0
    assert simplest([1.2501, 1.0], [1, 2], factor=1.25) == 1


def test_of_one_size_the_most_accurate_is_chosen_and_of_equal_ones_the_first():
    assert simplest([1.0, 1.2, 1.1, 1.1 - 2e-16, math.inf], [3, 2, 2, 2, 1], factor=1.25) == 2
