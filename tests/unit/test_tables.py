"""Tables of table.md."""

from dataclasses import replace

import numpy as np
import pytest

from hident.engine.results import Series
from hident.ledger.verdicts import judge
from hident.reports.base import Table, TableSpec
from hident.reports.tables.writing import written
from tests.unit.results_maker import PUBLISHED, made

GRID = """
tables:
  t:
    kind: grid
    title: Errors
    rows: samples
    row_header: N
    columns: [{estimator: one, metric: mise}, {estimator: two, metric: mise, statistic: spread}]
"""
AXES = "  pole:\n    small: {system.linear.a: [0.1]}\n    large: {system.linear.a: [0.2]}\n"


def built(results, name="t"):
    return results.plan.experiment.tables[name].build(results, judge(results))


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (37.3712, "37.4"),
        (0.22012, "0.220"),
        (34003.2, "34003"),
        (0.0, "0"),
        (1.2954e7, "1.30e+07"),
        (-6.96e-5, "-6.96e-05"),
        (float("nan"), "-"),
        (float("inf"), "-"),
        (9.9996, "10.0"),
    ],
)
def test_numbers_keep_three_digits(value, text):
    assert written(value) == text


def test_a_grid_without_printed_numbers(tmp_path):
    table = built(made(tmp_path, {("one", "10"): [1.0, 3.0]}, rest=GRID))
    assert table.header == ("N", "one", "two")
    assert table.rows[0] == ("10", "2.00", "1.00 [1.00, 1.00]")
    assert table.notes == ()


def test_printed_numbers_stand_beside_ours_with_their_verdict(tmp_path):
    numbers = "T,N=10,error,2.0,\nT,N=100,error,1.5,\nT,N=1000,error,1.0,\n"
    values = {("one", "10"): [1.0, 3.0], ("one", "100"): [1.0, 1.6]}
    rest = GRID + PUBLISHED.format(runs=1, statistic="mean")
    table = built(made(tmp_path, values, rest=rest, printed=numbers))
    assert table.header == ("N", "one", "printed", "two")
    assert [row[2] for row in table.rows] == ["2.0 =", "1.5 ?", "1.0 ="]
    assert "Interval: central 95 % of single trials: the paper ran one." in table.notes


def test_printed_numbers_stand_beside_their_own_statistic_only(tmp_path):
    numbers = "".join(f"T,N={n},error,1.0,\n" for n in (10, 100, 1000))
    rest = GRID + PUBLISHED.format(runs=1, statistic="median")
    assert built(made(tmp_path, {}, rest=rest, printed=numbers)).header == ("N", "one", "two")


def test_other_axes_go_down_with_the_rows(tmp_path):
    table = built(made(tmp_path, {}, rest=GRID, axes=AXES))
    assert table.header[0] == "N, pole"
    assert [row[0] for row in table.rows][:3] == ["10, small", "10, large", "100, small"]


def test_failed_trials_are_said(tmp_path):
    table = built(made(tmp_path, {("one", "10"): [1.0, np.nan, np.inf]}, rest=GRID))
    assert table.rows[0][1] == "1.00"
    assert table.notes == (
        "2 of 3 trials of estimator 'one' at samples 10 failed and are left out of the statistics.",
    )


def test_why_trials_failed_is_said(tmp_path):
    results = made(tmp_path, {("one", "10"): [1.0, np.nan]}, rest=GRID)
    one = results.series[0]
    first = Series(one.unit, one.metric, one.values, (("it is singular", 1),))
    table = built(replace(results, series=(first, *results.series[1:])))
    assert "1 of 2 trials of estimator 'one' at samples 10 failed (it is singular) and" in table.notes[0]


RATE = """
tables:
  t: {kind: rate, title: R, axis: samples, metric: mise, estimators: [one], root: ROOT, expected: EXPECTED}
"""


def test_a_rate_over_cases_that_share_random_numbers_says_so(tmp_path):
    rest = RATE.replace("ROOT", "false").replace("EXPECTED", "-1")
    values = {("one", str(n)): np.array([0.9, 1.0, 1.1]) / n for n in (10, 100, 1000)}
    shared = made(tmp_path, values, rest=rest + "streams: {kind: numpy, share: [noise]}\n")
    assert built(shared).notes == (
        "The cases share random numbers, and the standard errors take them as independent.",
    )
    assert built(made(tmp_path, values, rest=rest)).notes == ()


@pytest.mark.parametrize(("root", "slope"), [("false", -0.8), ("true", -0.4)])
def test_a_rate_is_found_within_its_standard_error(tmp_path, root, slope):
    rng = np.random.default_rng(3)
    values = {("one", str(n)): n**-0.8 * rng.normal(1.0, 0.1, 500) for n in (10, 100, 1000)}
    rest = RATE.replace("ROOT", root).replace("EXPECTED", str(slope))
    row = built(made(tmp_path, values, rest=rest)).data.iloc[0]
    assert row["slope"] == pytest.approx(slope, abs=4 * row["standard_error"])
    # Three points with relative standard error 0.1/sqrt(500), evenly spaced in log N.
    expected = 0.1 / 500**0.5 / (np.log(10.0) * 2**0.5) * (0.5 if root == "true" else 1.0)
    assert expected * 0.9 < row["standard_error"] < 4 * expected


def test_an_exact_power_has_its_slope(tmp_path):
    values = {("one", str(n)): np.array([0.9, 1.0, 1.1]) * n**-0.5 for n in (10, 100, 1000)}
    rest = RATE.replace("ROOT", "false").replace("EXPECTED", "-1/2")
    assert built(made(tmp_path, values, rest=rest)).data.iloc[0]["slope"] == pytest.approx(-0.5, abs=1e-12)


DISTANCE = """
tables:
  t: {kind: KIND, title: D, rows: samples, best: 5, cells: [
    {table: T, row: "N={samples}", quantity: error, estimator: one, metric: mise},
    {table: T, row: "N={samples}", quantity: other, estimator: two, metric: mise}]}
"""
BOTH = "".join(f"T,N={n},{q},1.0,\n" for n in (10, 100, 1000) for q in ("error", "other"))
WIDTHS = "  width:\n    a: {estimators.one.bandwidth.h0: 1}\n    b: {estimators.one.bandwidth.h0: 2}\n"


def test_distances_are_mean_absolute_log_ratios(tmp_path):
    values = {("one", "10"): [np.e, np.e], ("one", "100"): [1 / np.e, 1 / np.e]}
    rest = DISTANCE.replace("KIND", "distance")
    data = built(made(tmp_path, values, rest=rest, axes=WIDTHS, printed=BOTH)).data
    assert list(data["quantity"]) == ["error", "error", "other"]
    assert list(data["width"]) == ["a", "b", ""]
    assert data["distance"].to_numpy() == pytest.approx([2 / 3, 2 / 3, 0.0])


def test_a_joint_distance_holds_for_all_quantities(tmp_path):
    values = {("one", "10"): [np.e, np.e]}
    rest = DISTANCE.replace("KIND", "joint_distance")
    data = built(made(tmp_path, values, rest=rest, axes=WIDTHS, printed=BOTH)).data
    assert list(data.columns) == ["metric", "statistic", "width", "error", "other", "mean"]
    assert len(data) == 2
    assert data["mean"].to_numpy() == pytest.approx([1 / 6, 1 / 6])


def test_agreement_says_for_each_setting_which_printed_numbers_the_trials_allow(tmp_path):
    values = {
        ("one", "10"): [0.8, 1.2, 1.4],
        ("one", "100"): [1.5, 1.6, 1.7],
        ("one", "1000"): [0.0, 0.5, 0.99],
    }
    rest = DISTANCE.replace("KIND", "agreement").replace("rows: samples, best: 5, ", "")
    table = built(made(tmp_path, values, rest=rest, axes=WIDTHS, printed=BOTH))
    assert table.header == ("estimator", "samples", "width", "error: 1.0", "other: 1.0", "inside")
    one = [row for row in table.rows if row[0] == "one" and row[2] == "a"]
    # The central 95 % end at 0.966, which is no farther from 1.0 than its rounding.
    assert [row[3:] for row in one] == [
        ("1.200 ~", "-", "1 of 1"),
        ("1.600 !", "-", "0 of 1"),
        ("0.5000 ~", "-", "1 of 1"),
    ]
    assert {(row[2], row[5]) for row in table.rows if row[0] == "two"} == {("-", "1 of 1")}


def test_a_narrow_column_of_numbers_has_a_rule():
    table = Table("T", ("h", "n"), (("a", "1"), ("b", "2")))
    assert table.markdown().splitlines()[2:] == ["| h |  n |", "| - | -: |", "| a |  1 |", "| b |  2 |"]


def test_markdown_is_aligned_and_bars_are_escaped():
    table = Table("T", ("name", "value"), (("|u|", "1.5"), ("b", "-10")), ("a note",))
    assert table.markdown().splitlines() == [
        "## T",
        "",
        "| name  | value |",
        "| ----- | ----: |",
        r"| \|u\| |   1.5 |",
        "| b     |   -10 |",
        "",
        "a note",
    ]


@pytest.mark.parametrize("kind", ["distance", "joint_distance"])
def test_a_distance_needs_its_printed_numbers(tmp_path, kind):
    plan = made(
        tmp_path, {}, rest=DISTANCE.replace("KIND", kind), printed=BOTH.replace("N=100,", "N=99,")
    ).plan
    spec = plan.experiment.tables["t"]
    assert isinstance(spec, TableSpec)
    assert list(spec.misfits(plan)) == [
        (("cells", i), f"published.csv has no number for T / N=100 / {q}; did you mean 'T / N=1000 / {q}'?")
        for i, q in enumerate(("error", "other"))
    ]
    homeless = replace(plan, experiment=plan.experiment.model_copy(update={"paper": None}))
    assert list(spec.misfits(homeless)) == [
        (("cells",), "needs 'paper', the folder under experiments/ with the numbers")
    ]


OPEN_RATE = """
tables:
  t: {kind: rate, title: R, axis: samples, metric: mise, estimators: [one, two]}
"""


@pytest.mark.parametrize("values", [[np.nan, np.nan], [np.inf, np.inf], [0.0, 0.0], [-1.0, 1.0], [2.0, 2.0]])
def test_a_rate_of_what_has_no_logarithm_or_no_error_is_left_open(tmp_path, values):
    # Numpy's warnings are errors here.
    table = built(made(tmp_path, {("one", str(n)): values for n in (10, 100, 1000)}, rest=OPEN_RATE))
    assert table.rows[0] == ("one", "-", "-")


def test_a_rate_leaves_out_the_points_that_failed(tmp_path):
    values = {("one", str(n)): np.array([0.9, 1.1]) / n for n in (10, 100)} | {("one", "1000"): [np.nan] * 2}
    table = built(made(tmp_path, values, rest=OPEN_RATE))
    assert table.rows[0][1] == "-1.00"


ATTAINED = """
tables:
  t: {kind: attained, title: As good, metric: mise, reference: one, estimators: [two], within: 0.1}
"""


def test_how_often_an_estimator_comes_as_low_as_another(tmp_path):
    nan = np.nan
    values = {
        ("one", "10"): [1.0, 1.0, nan, 2.0, 1.0],
        ("two", "10"): [1.1, 1.2, 0.5, 1.0, nan],
        ("one", "100"): [nan] * 5,
    }
    table = built(made(tmp_path, values, rest=ATTAINED))
    # A trial without a mark does not count, one that failed has not attained it.
    assert table.rows == (("10", "50"), ("100", "-"), ("1000", "100"))
    assert table.header == ("samples", "two")
    assert table.notes == ("Percentage of 5 trials in which mise is at most 1.1 times that of one.",)
