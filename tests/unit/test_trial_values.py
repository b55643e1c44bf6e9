"""The file of all trials' values: exact, for pandas too; when two values are equal; what share is likely."""

import io
import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hident.ledger.sensitivity import Count, Sensitivity
from hident.ledger.trial_values import TrialValues, difference


def values(**series):
    """Series of estimators at one case, by 'estimator_metric'."""
    found = {("50", *name.split("_")): np.array(v, dtype=float) for name, v in series.items()}
    return TrialValues(("samples",), found)


@settings(deadline=None, derandomize=True, max_examples=100)
@given(st.lists(st.floats(), min_size=1, max_size=20))
def test_values_come_back_to_the_last_bit(numbers):
    data = values(e_m=numbers).encoded()
    (found,) = TrialValues.decoded(data).series.values()
    expected = np.where(np.isnan(numbers), np.nan, numbers)
    assert found.tobytes() == expected.tobytes()
    assert TrialValues.decoded(data).encoded() == data
    # As older versions of pandas do with float_precision="round_trip".
    frame = pd.read_csv(io.BytesIO(data), compression="xz")
    np.testing.assert_array_equal(frame.iloc[0, 3:].to_numpy(float), expected)


def test_columns_are_the_axes_the_names_and_the_trials():
    data = values(e_m=[1.0, math.nan], f_m=[math.inf, -0.0]).encoded()
    frame = pd.read_csv(io.BytesIO(data), compression="xz")
    assert list(frame.columns) == ["samples", "estimator", "metric", "0", "1"]
    assert frame["estimator"].tolist() == ["e", "f"]
    again = TrialValues.decoded(data)
    assert again.axes == ("samples",)
    assert again.described(("50", "e")) == "samples 50, estimator 'e'"
    assert again.units == {("50", "e"): [("50", "e", "m")], ("50", "f"): [("50", "f", "m")]}


@pytest.mark.parametrize("damage", [b"", b"a,b\n1,2\n", values(e_m=[1.0]).encoded()[:-20]])
def test_what_is_no_such_file_is_a_value_error(damage):
    with pytest.raises((ValueError, EOFError)):
        TrialValues.decoded(damage)


def test_a_value_that_passes_near_zero_is_held_against_what_is_typical():
    typical = np.array([1.0, -2.0, 1.5, -1.0, 1e-9])
    near = typical + np.array([0, 0, 0, 0, 5e-10])
    assert not difference(near, typical, 1e-6).moved.any()
    assert difference(near, typical, 1e-6).largest == pytest.approx(5e-10, rel=0.6)
    far = typical + np.array([0, 0, 0, 0, 5e-6])
    assert difference(far, typical, 1e-6).moved.tolist() == [False] * 4 + [True]


def test_nan_equals_nan_and_infinity_itself_and_nothing_else():
    special = np.array([np.nan, np.inf, -np.inf, np.nan, np.inf, 0.0])
    other = np.array([np.nan, np.inf, np.inf, 1.0, 1.0, 0.0])
    for pair in ((special, other), (other, special)):
        assert difference(*pair, 1e-6).moved.tolist() == [False, False, True, True, True, False]
    assert difference(special, special, 0.0).largest == 0.0


@pytest.mark.parametrize(("moved", "perturbed"), [(0, 400), (3, 400), (40, 400), (400, 400)])
def test_more_than_likely_has_at_most_the_chance(moved, perturbed):
    rng = np.random.default_rng(1)
    share = rng.beta(moved + 0.5, perturbed - moved + 0.5, 200_000)
    drawn = rng.binomial(200, share)
    most = Count(200, perturbed, moved).likely(200, 0.01)
    assert np.mean(drawn > most) <= 0.0115
    assert most == 0 or np.mean(drawn > most - 1) >= 0.0085


@pytest.mark.parametrize("trials", [1, 2, 5])
def test_of_few_trials_not_all_may_move_where_none_has(trials):
    assert Count(trials, trials, 0).likely(trials, 1e-9) == trials - 1
    assert Count(trials, trials, trials).likely(trials, 1e-9) == trials
    assert Count(trials, 0, 0).likely(trials, 1e-9) == 0


def test_what_moves_in_any_metric_counts_once():
    plain = values(e_m=[1.0, 2.0, 3.0], e_n=[1.0, 2.0, 3.0], f_m=[1.0, np.nan, 3.0])
    first = values(e_m=[1.1, 2.0, 3.0], e_n=[1.1, 2.0, 3.1], f_m=[1.0, np.nan, 3.0 + 1e-9])
    second = values(e_m=[1.0, 2.0, 3.0], e_n=[1.0, 2.0, 3.0], f_m=[1.0, 2.0, 3.0])
    found = Sensitivity.measured(plain, [first, second])
    assert found.counts == {("50", "e"): Count(3, 6, 2), ("50", "f"): Count(3, 6, 1)}
    assert Sensitivity.decoded(found.encoded()) == found
    assert found.encoded().decode().splitlines() == [
        "samples,estimator,trials,perturbed,moved",
        "50,e,3,6,2",
        "50,f,3,6,1",
    ]
