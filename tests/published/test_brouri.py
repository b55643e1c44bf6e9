"""The printed numbers of Brouri, judged from the accepted trials."""

import pytest

from tests.accepted import accepted_verdicts


@pytest.fixture(scope="module")
def nonlinearity():
    return {v.printed.quantity: v for v in accepted_verdicts("brouri_nonlinearity")}


@pytest.fixture(scope="module")
def gains():
    return {v.printed.quantity: v for v in accepted_verdicts("brouri_gains")}


def test_all_coefficients_but_the_constant_agree(nonlinearity):
    assert {q: v.word for q, v in nonlinearity.items() if v.word == "differs"} == {"c0": "differs"}
    assert len(nonlinearity) == 4


def test_the_constant_is_tens_of_standard_deviations_off(nonlinearity):
    c0 = nonlinearity["c0"]
    assert (50.0 - c0.printed.value) / c0.series.value("std") > 40.0
    assert c0.reason


def test_three_of_four_gains_agree_and_the_fourth_has_its_reason(gains):
    differing = {q for q in gains if q.startswith("|") and gains[q].word == "differs"}
    assert differing == {"|Go(j2w)|"}
    assert gains["|Go(j2w)|"].reason


def test_our_medians_are_within_half_a_spread_of_the_true_gains_and_phases(gains):
    true = {"|Gi(jw)|": 0.9948, "|Go(j2w)|": 0.4450, "arg Gi(jw)": -0.1197, "arg Go(j6w)": -1.6971}
    for quantity, value in true.items():
        assert abs(gains[quantity].ours - value) < 0.5 * gains[quantity].series.value("std")
        assert gains[quantity].low < value < gains[quantity].high


def test_every_number_that_differs_has_a_reason(nonlinearity, gains):
    assert len(gains) == 13
    assert all(v.reason for v in (*nonlinearity.values(), *gains.values()) if v.word == "differs")


def test_the_printed_phases_share_out_right_sums_at_random(gains):
    """What the fundamentals tell is right; what Gi gains, Go loses."""
    true = {"w": (-0.1197, -0.8354), "2w": (-0.2374, -1.2068), "3w": (-0.3514, -1.3979)}
    for multiple, (first, second) in true.items():
        gained = gains[f"arg Gi(j{multiple})"].printed.value - first
        lost = gains[f"arg Go(j{multiple})"].printed.value - second
        assert abs(gained + lost) < 0.01  # two roundings
        assert abs(gained) > 0.009
