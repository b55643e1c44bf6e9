"""The printed numbers of Brouri, judged from the accepted trials."""

import re

import numpy as np
import pandas as pd
import pytest

from tests.accepted import ROOT, accepted_results, accepted_verdicts


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
    assert (50.0 - c0.printed.value) / c0.series.value("std") > 30.0
    assert c0.reason


def test_whole_levels_as_printed_allow_all_of_45_from_half_a_second_on():
    """Seven levels, the cubic through four of them, T_r = 220 or 230 s; at 0.1 s no reading does."""
    read = pd.read_csv(
        ROOT / "results/brouri_reading/coefficients.csv", dtype={"noise interval": str, "Tr": str}
    )
    readings = read.groupby(["noise interval", "estimator", "staircase", "Tr"])["inside"].sum()
    assert len(readings) == 96
    assert readings.loc["0.1"].max() < 4
    allowing = readings[readings == 4].reset_index()
    assert set(allowing["estimator"]) == {"whole (10)"}
    assert set(allowing["staircase"]) == {"seven, cubic through 0 to 1.5"}
    assert {("0.5", "220"), ("0.5", "230"), ("1", "220"), ("1", "230")} <= {
        *allowing[["noise interval", "Tr"]].itertuples(index=False, name=None)
    }


def test_the_coefficients_that_allow_45_do_not_give_the_gains_of_46():
    read = pd.read_csv(ROOT / "results/brouri_reading_gains/gains.csv", dtype={"noise interval": str})
    one = read[
        (read["staircase"] == "seven, cubic through 0 to 1.5") & (read["estimator"] == "gains, whole (10)")
    ]
    assert one.groupby("noise interval")["inside"].sum().loc[["0.5", "1"]].max() < 4


def test_three_of_four_gains_agree_and_the_fourth_has_its_reason(gains):
    differing = {q for q in gains if q.startswith("|") and gains[q].word == "differs"}
    assert differing == {"|Go(j2w)|"}
    assert len([q for q in gains if q.startswith("|")]) == 4
    assert gains["|Go(j2w)|"].reason


def test_our_medians_are_within_half_a_spread_of_the_true_gains_and_phases(gains):
    true = {"|Gi(jw)|": 0.9948, "|Go(j2w)|": 0.4450, "arg Gi(jw)": -0.1197, "arg Go(j6w)": -1.6971}
    for quantity, value in true.items():
        assert abs(gains[quantity].ours - value) < 0.5 * gains[quantity].series.value("std")
        assert gains[quantity].low < value < gains[quantity].high


def test_every_number_that_differs_has_a_reason(nonlinearity, gains):
    assert len(gains) == 21
    assert all(v.reason for v in (*nonlinearity.values(), *gains.values()) if v.word == "differs")


def test_the_sums_at_the_second_harmonics_contradict_the_printed_phases(gains):
    """Also with what the rounding of the printed phases may have moved them by."""
    sums = {q: v for q, v in gains.items() if "+" in q or q.startswith(("2 arg", "3 arg"))}
    assert len(sums) == 8
    differing = {q for q, v in sums.items() if v.word == "differs"}
    assert differing == {
        "2 arg Gi(jw) + arg Go(j2w)",
        "2 arg Gi(j2w) + arg Go(j4w)",
        "2 arg Gi(j3w) + arg Go(j6w)",
    }
    for quantity in differing:
        v = sums[quantity]
        assert not v.low - 0.015 <= v.printed.value <= v.high + 0.015
        assert v.reason


def test_every_single_phase_is_allowed(gains):
    single = {q: v.word for q, v in gains.items() if q.startswith("arg") and "+" not in q}
    assert len(single) == 9
    assert "differs" not in single.values()


def test_the_order_by_power_is_one():
    (order,) = accepted_verdicts("brouri_order")
    assert (order.printed.printed, order.word, order.ours) == (">3", "differs", 1.0)
    assert order.reason


def test_the_fit_finds_the_gain_of_a_nonlinearity_that_is_not_monotone():
    found = accepted_results("brouri_nonmonotone")
    for m, true in ((1, 0.95276), (2, 0.84184), (3, 0.71761)):
        for series in found.select("f known", f"found gain_i_{m}", {"V": "1.5"}):
            assert len(series.valid) > 20
            assert abs(np.median(series.valid) - true) < 0.002


def test_the_printed_phases_share_out_right_sums_at_random(gains):
    """What the fundamentals tell is right; what Gi gains, Go loses."""
    true = {"w": (-0.1197, -0.8354), "2w": (-0.2374, -1.2068), "3w": (-0.3514, -1.3979)}
    for multiple, (first, second) in true.items():
        gained = gains[f"arg Gi(j{multiple})"].printed.value - first
        lost = gains[f"arg Go(j{multiple})"].printed.value - second
        assert abs(gained + lost) < 0.01  # two roundings
        assert abs(gained) > 0.009


def test_the_sums_of_phases_are_those_of_the_accepted_results():
    def rows(path):
        unlinked = re.sub(r"\[([^][]+)\]\[[^][]+\]", r"\1", path.read_text(encoding="utf-8"))
        lines = unlinked.splitlines()
        return {" ".join(line.split()) for line in lines if re.match(r" *\| *(\d )?arg \S+ \+ ", line)}

    shown = rows(ROOT / "experiments/brouri/README.md")
    assert len(shown) == 8
    assert shown <= rows(ROOT / "results/brouri_gains/table.md")
