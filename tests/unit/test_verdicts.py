"""Verdicts on printed numbers."""

import numpy as np
import pytest
from scipy.stats import norm

from hident.errors import ConfigError
from hident.ledger.verdicts import COLUMNS, frame, judge
from tests.unit.results_maker import PUBLISHED, made

TRIALS = np.random.default_rng(5).normal(10.0, 1.0, 400)


def judged(tmp_path, printed, *, runs="unknown", statistic="mean", values=TRIALS, reasons=""):
    numbers = "".join(f"T,N={n},error,{printed},\n" for n in (10, 100, 1000))
    results = made(
        tmp_path,
        {("one", "10"): values},
        rest=PUBLISHED.format(runs=runs, statistic=statistic),
        printed=numbers,
        reasons=reasons,
    )
    return judge(results)[0]


def test_exact_is_rounding_to_the_printed_digits(tmp_path):
    mean = float(TRIALS.mean())
    assert judged(tmp_path, f"{mean:.3f}").word == "exact"
    assert judged(tmp_path, f"{mean + 0.0006:.3f}").word == "agrees"


def test_a_number_on_the_rounding_boundary_is_exact(tmp_path):
    assert judged(tmp_path, "2.5", values=[2.55] * 4).word == "exact"
    assert judged(tmp_path, "2.5", values=[2.551] * 4).word == "differs"


def test_single_trials_make_the_interval_where_the_number_of_runs_is_unknown(tmp_path):
    verdict = judged(tmp_path, "11.5")
    low, high = np.quantile(TRIALS, [0.025, 0.975])
    assert (verdict.low, verdict.high) == (low, high)
    assert verdict.word == "agrees"
    assert verdict.interval == (
        "central 95 % of single trials: the paper does not say how many runs it averages"
    )
    assert judged(tmp_path, "12.5").word == "differs"
    assert judged(tmp_path, "11.5", runs=1).interval == "central 95 % of single trials: the paper ran one"


def test_averages_are_judged_by_standard_errors_of_both_sides(tmp_path):
    error = TRIALS.std(ddof=1)
    verdict = judged(tmp_path, "10.3", runs=100)
    assert verdict.high - verdict.ours == pytest.approx(3 * error * (1 / 400 + 1 / 100) ** 0.5)
    assert verdict.interval == "mean +- 3 standard errors; the paper: 100 runs"
    assert judged(tmp_path, "10.3", runs="exact").high - verdict.ours == pytest.approx(3 * error / 20)


@pytest.mark.parametrize(("statistic", "expected"), [("std", 1 / 2**0.5), ("median", (np.pi / 2) ** 0.5)])
def test_standard_errors_of_other_statistics_are_those_of_theory(tmp_path, statistic, expected):
    values = norm.ppf((np.arange(40_000) + 0.5) / 40_000)
    verdict = judged(tmp_path, "0.5", runs="exact", statistic=statistic, values=values)
    assert (verdict.high - verdict.ours) / 3 * 200 == pytest.approx(expected, rel=1e-3)


def test_failed_trials_are_left_out(tmp_path):
    values = np.append(TRIALS, [np.nan, np.inf])
    assert judged(tmp_path, "9", values=values).ours == TRIALS.mean()
    none = judged(tmp_path, "9", values=[np.nan] * 3)
    assert (none.word, none.interval) == ("differs", "no trial succeeded")


def test_a_reason_is_given_where_one_is_owed(tmp_path):
    reasons = "reasons: [{reason: because, row: N=10}]\n"
    assert judged(tmp_path, "20", reasons=reasons).reason == "because"
    assert judged(tmp_path, "10.0", reasons=reasons).reason == ""


def test_a_cell_without_a_printed_number_is_an_error(tmp_path):
    results = made(tmp_path, {}, rest=PUBLISHED.format(runs=1, statistic="mean"), printed="T,N=10,error,1,\n")
    with pytest.raises(ConfigError, match=r"published.csv has no number for T / N=100 / error; did"):
        judge(results)


def test_the_frame_has_the_columns_of_verdicts_csv(tmp_path):
    numbers = "".join(f"T,N={n},error,1.0,\n" for n in (10, 100, 1000))
    results = made(tmp_path, {}, rest=PUBLISHED.format(runs=1, statistic="mean"), printed=numbers)
    table = frame(judge(results))
    assert tuple(table.columns) == COLUMNS
    assert list(table["verdict"]) == ["exact"] * 3
    assert list(table["printed"]) == ["1.0"] * 3
