"""Verdicts on printed numbers."""

import json

import numpy as np
import pytest
from scipy.stats import norm

from hident.engine.results import Results, Series
from hident.errors import ConfigError
from hident.ledger.power import NumberPower, VerdictPower, without_reports
from hident.ledger.verdicts import COLUMNS, frame, judge, stand
from tests.unit.results_maker import PUBLISHED, made

TRIALS = np.random.default_rng(5).normal(10.0, 1.0, 400)


def judged(tmp_path, printed, *, runs="unknown", statistic="mean", values=TRIALS, reasons="", more=""):
    numbers = "".join(f"T,N={n},error,{printed},\n" for n in (10, 100, 1000))
    results = made(
        tmp_path,
        {("one", "10"): values},
        rest=PUBLISHED.format(runs=runs, statistic=statistic) + more,
        printed=numbers,
        reasons=reasons,
    )
    return judge(results)[0]


def test_exact_is_rounding_to_the_printed_digits(tmp_path):
    mean = float(TRIALS.mean())
    assert judged(tmp_path, f"{mean:.3f}").word == "exact"
    assert judged(tmp_path, f"{mean + 0.0006:.3f}").word == "untestable"


def test_a_number_on_the_rounding_boundary_is_exact(tmp_path):
    assert judged(tmp_path, "2.5", values=[2.55] * 4).word == "exact"
    assert judged(tmp_path, "2.5", values=[2.551] * 4).word == "differs"


def test_single_trials_make_the_interval_where_the_number_of_runs_is_unknown(tmp_path):
    verdict = judged(tmp_path, "11.5")
    low, high = np.quantile(TRIALS, [0.025, 0.975])
    assert (verdict.low, verdict.high) == (low, high)
    assert verdict.word == "untestable"
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


def test_a_number_agrees_that_some_alternative_would_not_give(tmp_path):
    folder = tmp_path / "results" / "power" / "some"
    folder.mkdir(parents=True)
    more = "alternatives: {x: {system.linear.a: [0.9]}, y: {system.linear.a: [0.8]}}\n"

    rest = PUBLISHED.format(runs="unknown", statistic="mean") + more
    numbers = "".join(f"T,N={n},error,11.5,\n" for n in (10, 100, 1000))
    plan = made(tmp_path, {("one", "10"): TRIALS}, rest=rest, printed=numbers).plan

    ours = without_reports(plan.experiment)

    def with_power(printed, known=ours, **excluded):
        power = VerdictPower({("T", "N=10", "error", ""): NumberPower(printed, excluded)}, ())
        for name, text in power.files().items():
            (folder / name).write_text(text)
        (folder / "run.json").write_text(json.dumps({"experiment": {"hash": known}}))
        return judged(tmp_path, "11.5", more=more)

    found = with_power("11.5", x=True, y=False)
    assert (found.word, found.excluded, found.alternatives) == ("agrees", 1, 2)
    assert with_power("11.5", x=False, y=False).word == "untestable"
    # What was said of another printed number says nothing of this one.
    assert with_power("11.6", x=True, y=True).alternatives == 0
    # Nor what was found for another configuration.
    assert with_power("11.5", known="other", x=True, y=True).alternatives == 0
    with_power("11.5", x=True)
    (folder / "numbers.csv").write_text("a,b\n1,2\n")
    with pytest.raises(ConfigError, match="accepted results of its alternatives cannot be read"):
        judged(tmp_path, "11.5", more=more)


def test_cases_that_share_random_numbers_are_judged_together(tmp_path):
    numbers = "".join(f"T,N={n},error,11.5,\n" for n in (10, 100, 1000))
    values = {("one", str(n)): TRIALS + n for n in (10, 100, 1000)}
    for share, groups in (("[]", [0, 1, 2]), ("[noise]", [0, 0, 0])):
        more = f"streams: {{kind: numpy, share: {share}}}\n"
        rest = PUBLISHED.format(runs=1, statistic="mean") + more
        found = judge(made(tmp_path, values, rest=rest, printed=numbers))
        assert [verdict.group for verdict in found] == groups


def test_of_the_papers_own_data_digits_are_equal_or_differ(tmp_path):
    mean = float(TRIALS.mean())

    def same(printed, values=TRIALS):
        rest = PUBLISHED.format(runs=400, statistic="mean").replace(
            "published:", "published:\n  same_data: true"
        )
        numbers = "".join(f"T,N={n},error,{printed},\n" for n in (10, 100, 1000))
        return judge(made(tmp_path, {("one", "10"): values}, rest=rest, printed=numbers))[0]

    assert same(f"{mean:.4f}").word == "exact"
    off = same(f"{mean + 0.0002:.4f}")
    assert (off.word, off.low, off.high) == ("differs", mean, mean)
    assert "the paper's own data" in off.interval
    assert np.isnan(off.joint)
    # Of fewer trials than the paper ran, its mean is another one.
    assert same(f"{TRIALS[:200].mean() + 0.0002:.4f}", TRIALS[:200]).word == "untestable"


@pytest.mark.parametrize("runs", [1, 25, "exact"])
def test_a_bound_is_judged_on_its_own_side(tmp_path, runs):
    assert judged(tmp_path, "<8", runs=runs).word == "differs"
    below = judged(tmp_path, "<30", runs=runs)
    assert (below.word, below.high, below.p > 0.5) == ("untestable", np.inf, True)
    above = judged(tmp_path, ">0", runs=runs)
    assert (above.word, above.low) == ("untestable", -np.inf)
    assert judged(tmp_path, ">13", runs=runs).word == "differs"
    assert below.flips == pytest.approx(0.0, abs=1e-9)


def test_a_bound_that_one_trial_in_twenty_keeps_is_not_excluded(tmp_path):
    q05 = float(np.quantile(TRIALS, 0.05))
    assert judged(tmp_path, f"<{q05 + 0.01:.4f}", runs=1).word == "untestable"
    assert judged(tmp_path, f"<{q05 - 0.01:.4f}", runs=1).word == "differs"


@pytest.mark.parametrize("runs", [1, 25])
def test_flips_are_how_often_another_block_decides_otherwise(tmp_path, runs):
    rng = np.random.default_rng(7)
    edge = 1.96 if runs == 1 else 3 * (1 / 25 + 1 / 400) ** 0.5
    rest = PUBLISHED.format(runs=runs, statistic="mean")
    numbers = "".join(f"T,N={n},error,0.000,\n" for n in (10, 100, 1000))
    results = made(tmp_path, {("one", "10"): TRIALS}, rest=rest, printed=numbers)

    def of_a_block(truth):
        series = Series(results.series[0].unit, "mise", rng.normal(truth, 1.0, 400))
        return stand(Results(results.plan, (series,)))[0]

    said, done = [], []
    for truth in edge * np.linspace(0.8, 1.2, 200):
        one, another = of_a_block(truth), of_a_block(truth)
        said.append(one.flips)
        done.append((one.word == "differs") != (another.word == "differs"))
    assert 0.05 < np.mean(said) < 0.35
    assert np.mean(done) == pytest.approx(np.mean(said), abs=0.08)


@pytest.mark.parametrize(
    ("printed", "runs"), [("10.0", (1, 10, 100)), ("10.5", (1, 10)), ("11.5", (1,)), ("20", ())]
)
def test_the_numbers_of_runs_that_a_number_permits(tmp_path, printed, runs):
    assert judged(tmp_path, printed).runs == runs
    assert judged(tmp_path, printed, runs=1).runs == ()


def test_a_mean_outside_its_own_interval_is_said(tmp_path):
    values = np.append(np.ones(199), 1e6)
    assert "ours lies outside it" in judged(tmp_path, "1.0", values=values).interval


def test_what_does_not_count_is_marked(tmp_path):
    zero = judged(tmp_path, "0.000", values=np.zeros(20))
    assert (zero.word, zero.mark, zero.counts) == ("exact", "structural", False)
    rest = PUBLISHED.format(runs=1, statistic="mean") + "      circular: true\n"
    numbers = "".join(f"T,N={n},error,1,\n" for n in (10, 100, 1000))
    assert {v.mark for v in judge(made(tmp_path, {}, rest=rest, printed=numbers))} == {"circular"}


def test_one_of_many_cells_is_multiplicity_where_the_table_is_sound(tmp_path):
    rng = np.random.default_rng(8)
    values = {("one", str(n)): rng.normal(size=400) for n in (10, 100, 1000)}

    def marks(*printed):
        numbers = "".join(f"T,N={n},error,{p},\n" for n, p in zip((10, 100, 1000), printed, strict=True))
        found = judge(
            made(tmp_path, values, rest=PUBLISHED.format(runs=1, statistic="mean"), printed=numbers)
        )
        return [(verdict.word == "differs", verdict.mark) for verdict in found]

    assert marks("2.15", "0.5", "-0.5")[0] == (True, "multiplicity")
    assert marks("9", "0.5", "-0.5")[0] == (True, "")
    # Each by itself might be chance, and the three together are not.
    assert marks("2.3", "2.3", "2.3")[0] == (True, "")


MISPRINT = "reasons: [{row: N=10, quantity: error, reason: a misprint, misprint: MISPRINT}]"


def with_reason(tmp_path, misprint, printed="99"):
    rng = np.random.default_rng(8)
    values = {("one", str(n)): rng.normal(size=400) for n in (10, 100, 1000)}
    rest = PUBLISHED.format(runs=1, statistic="mean") + "streams: {kind: numpy, share: [input]}\n"
    numbers = f"T,N=10,error,{printed},\n" + "".join(f"T,N={n},error,0.5,\n" for n in (100, 1000))
    numbers += "T,N=10,largest,5,\nT,N=10,smallest,150,\n"
    reasons = MISPRINT.replace("MISPRINT", misprint)
    return judge(made(tmp_path, values, rest=rest, printed=numbers, reasons=reasons))


@pytest.mark.parametrize("misprint", ["{formula: 2*3}", "{at_least: smallest}"])
def test_what_the_paper_itself_shows_to_be_misprinted_is_left_out_of_the_joint_test(tmp_path, misprint):
    first, *others = with_reason(tmp_path, misprint)
    assert (first.word, first.mark, first.counts) == ("differs", "misprint", True)
    assert np.isnan(first.adjusted)
    assert [one.mark for one in others] == ["", ""]
    assert first.joint == others[0].joint > 0.3
    counted = with_reason(tmp_path, "null")
    assert (counted[0].mark, counted[0].joint < 0.02) == ("", True)


def test_a_misprint_does_not_depend_on_ours(tmp_path):
    assert with_reason(tmp_path, "{formula: 2*3}", printed="0.1")[0].mark == "misprint"


@pytest.mark.parametrize(
    ("misprint", "message"),
    [
        ("{formula: 100 - 1}", r"reasons.yaml: the misprint of T / N=10 / error: the printed 99 is what 100"),
        ("{formula: 98 + 0.6}", r"the printed 99 is what 98 \+ 0.6 = 98.6 gives"),
        ("{at_least: largest}", "the printed 99 is not below the printed 5 of largest"),
        ("{at_least: mean}", "the printed 99 is to lie below T / N=10 / mean, which is not in published.csv"),
        ("{formula: 1 + 1, at_least: largest}", "must have either 'formula' or 'at_least'"),
        ("{formula: sum}", "sum"),
        ("true", "misprint"),
    ],
)
def test_a_misprint_that_the_paper_does_not_show_is_refused(tmp_path, misprint, message):
    with pytest.raises(ConfigError, match=message):
        with_reason(tmp_path, misprint)


def test_several_of_ours_on_one_printed_number_are_told_apart(tmp_path):
    rest = PUBLISHED.format(runs=1, statistic="mean").replace("N={samples}", "all N")
    values = {("one", n): TRIALS + i for i, n in enumerate(("10", "100", "1000"))}
    found = judge(made(tmp_path, values, rest=rest, printed="T,all N,error,9,\n"))
    assert [one.case for one in found] == ["samples 10", "samples 100", "samples 1000"]
    assert found[0].name == "T / all N / error, samples 10"
    assert list(frame(found).columns) == [*COLUMNS, "case"]
    assert list(frame(found)["case"]) == [one.case for one in found]


def test_one_of_ours_on_each_printed_number_needs_no_case(tmp_path):
    one = judged(tmp_path, "9")
    assert (one.case, one.name) == ("", "T / N=10 / error")
    assert list(frame([one]).columns) == list(COLUMNS)


def test_of_few_trials_the_range_is_the_interval(tmp_path):
    values = np.arange(20.0)
    inside = judged(tmp_path, "18.9", runs=1, values=values)
    assert (inside.word, inside.low, inside.high) == ("untestable", 0.0, 19.0)
    assert "the range of 20 single trials, 19 of 21 more of which lie in it" in inside.interval
    assert judged(tmp_path, "19.6", runs=1, values=values).word == "differs"
    one = judged(tmp_path, "5", runs=10, values=[1.0])
    assert (one.word, one.interval) == ("untestable", "none: a single trial has no spread")


@pytest.mark.parametrize("n", [19, 39, 60])
def test_p_is_small_at_most_as_often_as_it_says(tmp_path, n):
    rng = np.random.default_rng(9)
    rest = PUBLISHED.format(runs=1, statistic="mean")
    numbers = "".join(f"T,N={k},error,0.000,\n" for k in (10, 100, 1000))
    results = made(tmp_path, {("one", "10"): np.zeros(n)}, rest=rest, printed=numbers)
    p = []
    for _ in range(400):
        # The printed 0 is one more draw where the others are seen from it.
        draws = rng.normal(size=n + 1)
        series = Series(results.series[0].unit, "mise", draws[1:] - draws[0])
        p.append(stand(Results(results.plan, (series,)))[0].p)
    for level in (0.05, 0.2):
        assert np.mean(np.array(p) <= level) <= level + 3 * (level / 400) ** 0.5


def test_the_spread_of_one_run_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="the std of one run does not exist"):
        judged(tmp_path, "1", runs=1, statistic="std")


@pytest.mark.parametrize("number", ["1e400", "1_0", "<1e999"])
def test_numbers_that_no_computer_holds_are_refused(tmp_path, number):
    with pytest.raises(ConfigError, match="is not a number"):
        judged(tmp_path, number)
