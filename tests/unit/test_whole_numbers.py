"""Whole numbers of samples in times that are no whole numbers in binary."""

import numpy as np
import pytest

from hident.numerics.whole import nearest_whole, split, whole_part

JUST_BELOW, JUST_ABOVE = np.nextafter(3.0, 0.0), np.nextafter(3.0, 4.0)


@pytest.mark.parametrize("three", [JUST_BELOW, 3.0, JUST_ABOVE, 0.3 / 0.1, 3.0 - 5e-10, 3.0 + 5e-10])
def test_a_last_bit_makes_no_sample(three):
    assert split(three) == (3, 0.0)
    assert nearest_whole(three) == 3
    assert whole_part(three) == 3


def test_a_fraction_is_left():
    assert split(2.75) == (2, 0.75)
    assert split(0.0) == (0, 0.0)
    whole, rest = split(3.0 - 1e-8)
    assert whole == 2
    assert rest == pytest.approx(1.0 - 1e-8)


def test_whole_parts_are_those_of_exact_quotients_far_from_zero_and_below_it():
    k = np.concatenate((np.arange(-1000, 1000), np.arange(10**7, 10**7 + 1000)))
    np.testing.assert_array_equal(whole_part(k * 0.1 / 0.7), k // 7)


def test_no_whole_number_is_near_what_lies_between_or_below_one():
    assert nearest_whole(2.5) is None
    assert nearest_whole(1e-12) is None
    assert nearest_whole(0.0) is None
    assert nearest_whole(1000.0 + 1e-7) == 1000
    assert nearest_whole(1000.0 + 1e-7, 1e-12) is None
    assert nearest_whole(np.inf) is None
    assert nearest_whole(np.nan) is None
