"""Tables of kind comparison, and the figures of them."""

import itertools
import re
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.axis import XTick
from matplotlib.text import Annotation, Text

from hident import plugins
from hident.config.spec import components
from hident.engine.results import Results, Series
from hident.errors import ConfigError
from hident.ledger.verdicts import judge
from hident.metrics.base import MetricSpec
from hident.reports.base import misfits
from hident.reports.mathematics import typeset
from hident.reports.output import check
from hident.reports.style import style
from tests.unit.plans import planned, refusals
from tests.unit.results_maker import made

NAN = float("nan")
TABLE = """\
tables:
  t: {kind: comparison, title: C, metric: mise OPTIONS}
"""
THIRD = "  three: {kind: kernel, kernel: epanechnikov, bandwidth: {h0: 1, alpha: 1/5}}\n"
ALL = "  all: {kind: mise, interval: [-1, 1]}\n"


def table(options=""):
    return TABLE.replace("OPTIONS", f", {options}" if options else "")


def built(results, name="t"):
    return results.plan.experiment.tables[name].build(results, judge(results))


def cells(table, *columns):
    places = [table.header.index(column) for column in columns]
    return [tuple(row[place] for place in places) for row in table.rows]


def scores(n, seed=1):
    return np.random.default_rng(seed).uniform(1.0, 2.0, n)


# --- pairs


def test_a_pair_has_its_difference_with_an_interval_its_wins_and_a_test(tmp_path):
    one = scores(12)
    values = {("one", "10"): one, ("two", "10"): one + np.linspace(0.5, 1.5, 12)}
    found = built(made(tmp_path, values, rest=table()))
    assert found.header == (
        *("samples", "first", "second", "mean difference [95 %]", "wins", "adjusted p", "better", "ranks"),
    )
    # sd of 12 even steps 0.328, times t = 2.201, over sqrt(12).
    assert found.rows[0] == ("10", "one", "two", "-1.00 [-1.21, -0.792]", "100 %", "0.0015", "one", "1, 2")
    # All others are ones.
    assert found.rows[1] == ("100", "one", "two", "0 [0, 0]", "50 %", "1.0", "tied", "1, 1")
    assert found.notes == (
        "Mean of first less second in the same trials, with a 95 % interval for each pair by itself. Wins: "
        "trials in which the first has the lower value of 'mise', ties counting half.",
        "Better: by Wilcoxon's signed-rank test of the differences at 5 %, adjusted by Holm over the 3 tests "
        "of this table.",
        "Rank: one more than the number of methods that are better in that case; those that the test does "
        "not tell apart share one.",
    )


def test_all_numbers_are_in_the_csv(tmp_path):
    values = {("one", "10"): [1.0, 2.0, NAN, NAN, 5.0], ("two", "10"): [2.0, 2.0, 1.0, NAN, 3.0]}
    row = built(made(tmp_path, values, rest=table())).data.iloc[0]
    assert [row[name] for name in ("wins", "ties", "losses")] == [1, 2, 2]
    assert [row[name] for name in ("failed_first", "failed_second", "failed_both")] == [2, 1, 1]
    assert row["estimate"] == pytest.approx((-1.0 + 0.0 + 2.0) / 3.0)
    assert (row["rank_first"], row["rank_second"], row["better"]) == (1, 1, "")


def test_failures_are_losses_and_are_said(tmp_path):
    one = scores(12)
    values = {("one", "10"): one, ("two", "10"): np.where(np.arange(12) < 10, NAN, one - 0.1)}
    found = built(made(tmp_path, values, rest=table()))
    assert cells(found, "wins", "better")[0] == ("83 %", "one")
    assert found.notes[3] == (
        "Failed trials: two 10 of 36 in 1 of 3 cases. They count as lost against a method that did not fail, "
        "and as tied where both failed, and are left out of means."
    )
    # The two trials that are left speak for the other.
    assert cells(found, "mean difference [95 %]", "failed") == [
        ("0.100 [0.100, 0.100] †", "0, 10 of 12"),
        ("0 [0, 0]", "0, 0 of 12"),
        ("0 [0, 0]", "0, 0 of 12"),
    ]
    assert found.notes[4:] == (
        "† The mean is of the trials in which neither failed, and says something else than the test, for "
        "which the others count too: one and two at samples 10 have failures that decide.",
    )
    median = built(made(tmp_path, values, rest=table("statistic: median")))
    assert cells(median, "median difference [95 %]")[0] == ("-inf [-inf, -inf]",)
    assert median.notes[3].endswith("as tied where both failed, and are infinite in medians.")
    assert len(median.notes) == 4


@pytest.mark.parametrize(("failed", "better"), [(0, "one"), (3, "tied"), (6, "two")])
def test_a_row_says_why_its_interval_and_its_test_differ(tmp_path, failed, better):
    one = scores(8)
    values = {("one", "10"): np.where(np.arange(8) < failed, NAN, one), ("two", "10"): 1.1 * one}
    found = built(made(tmp_path, values, rest=table("of: log_ratio, at: {samples: 10}")))
    shown = "0.909 [0.909, 0.909]" + " †" * (failed > 0)
    assert cells(found, "geometric mean ratio [95 %]", "better") == [(shown, better)]


def test_an_interval_without_equality_may_stand_beside_a_tie(tmp_path):
    one = scores(7)
    values = {("one", n): one for n in ("10", "100")} | {("two", "10"): one + np.r_[-0.1, np.full(6, 0.5)]}
    found = built(made(tmp_path, values, rest=table()))
    assert cells(found, "better")[0] == ("tied",)
    assert found.notes[3] == (
        "Tied beside an interval without 0: one and two at samples 10 have an interval for that pair by "
        "itself, and a p-value that is adjusted for all."
    )


RANKED = [
    ("median", [1.0, 2.0, 3.0, 4.0], "(2.50)"),
    ("median", [1.0, 2.0, NAN, NAN], "(inf, 2 of 4 failed)"),
    ("median", [1.0, 2.0, 3.0, NAN], "(2.50, 1 of 4 failed)"),
    ("median", [NAN, NAN, NAN, NAN], "(inf, 4 of 4 failed)"),
    ("mean", [1.0, 2.0, 3.0, NAN], "(2.00, 1 of 4 failed)"),
    ("mean", [NAN, NAN, NAN, NAN], "(-, 4 of 4 failed)"),
    ("median, best: highest", [1.0, 2.0, NAN, NAN], "(-inf, 2 of 4 failed)"),
    ("median, best: zero", [-1.0, 2.0, -3.0, NAN], "(2.50, 1 of 4 failed)"),
]


@pytest.mark.parametrize(("statistic", "values", "shown"), RANKED)
def test_the_brackets_of_ranks_count_failures_as_the_statistic_does(tmp_path, statistic, values, shown):
    rest = table(f"show: ranks, statistic: {statistic}")
    found = built(made(tmp_path, {("one", "10"): values}, rest=rest))
    assert found.rows[0][1].partition(" ")[2] == shown
    counted = (
        "a failed trial counting as infinite"
        if "median" in statistic
        else "over the trials that did not fail"
    )
    size = " of the moduli" if "zero" in statistic else ""
    assert f"In brackets the {statistic.split(',')[0]}{size} of mise, {counted}." in found.notes


@pytest.mark.parametrize(
    ("first", "second", "shown"),
    [
        ([1.0], [2.0], ("-1.00", "100 %", "1.0", "tied")),
        ([1.0], [1.0], ("0", "50 %", "1.0", "tied")),
        ([NAN], [1.0], ("-", "0 %", "1.0", "tied")),
        ([NAN], [NAN], ("-", "50 %", "1.0", "tied")),
        ([1.0, 1.0], [2.0, 3.0], ("-1.50 [-7.85, 4.85]", "100 %", "1.0", "tied")),
        ([1.0, 1.0], [2.0, 2.0], ("-1.00 [-1.00, -1.00]", "100 %", "1.0", "tied")),
        ([NAN, NAN], [1.0, 1.0], ("-", "0 %", "1.0", "tied")),
    ],
)
@pytest.mark.parametrize("of", ["difference", "log_ratio"])
def test_few_trials_have_text_that_makes_sense(tmp_path, first, second, shown, of):
    results = made(tmp_path, {("one", "10"): first, ("two", "10"): second}, rest=table(f"of: {of}"))
    found = built(results)
    assert cells(found, "wins", "adjusted p", "better")[0] == shown[1:]
    if of == "difference":
        assert found.rows[0][3] == shown[0]
    count = "One trial tells" if len(first) == 1 else "2 trials tell"
    assert f"{count} no two methods apart, whatever they give: 3 tests take at least 7." in found.notes
    assert built(made(tmp_path, {("one", "10"): first}, rest=table("statistic: median"))).rows


def test_enough_trials_are_not_complained_of(tmp_path):
    values = {("one", "10"): scores(7)}
    assert not any("take at least" in note for note in built(made(tmp_path, values, rest=table())).notes)


def test_ratios_are_shown_as_such(tmp_path):
    one = scores(12)
    values = {("one", "10"): one, ("two", "10"): 2.0 * one}
    found = built(made(tmp_path, values, rest=table("of: log_ratio")))
    assert cells(found, "geometric mean ratio [95 %]")[0] == ("0.500 [0.500, 0.500]",)
    assert found.data.iloc[0]["estimate"] == pytest.approx(-np.log(2.0))


def test_ratios_that_do_not_exist_are_said(tmp_path):
    values = {("one", "10"): [0.0, *scores(11)], ("two", "10"): 2.0 + scores(12, 2)}
    found = built(made(tmp_path, values, rest=table("of: log_ratio")))
    assert found.rows[0][3:7] == ("-", "100 %", "-", "tied")
    assert "adjusted by Holm over the 2 tests" in found.notes[1]
    assert found.notes[3] == (
        "A value that is not positive has no logarithm: one and two at samples 10 have no ratio and no test. "
        "Take 'of: difference' there."
    )


def test_a_mean_that_hangs_on_a_trial_is_said(tmp_path):
    values = {("one", "10"): np.r_[scores(29), 100.0], ("two", "10"): scores(30, 2)}
    said = [note for note in built(made(tmp_path, values, rest=table())).notes if "single trial" in note]
    assert said == [
        "A single trial makes more than half of the spread: one and two at samples 10 have a mean and an "
        "interval that hang on it; the median does not."
    ]
    assert not any(
        "single trial" in note
        for note in built(made(tmp_path, values, rest=table("statistic: median"))).notes
    )


def test_the_family_is_the_whole_table(tmp_path):
    one = scores(7)
    values = {("one", n): one for n in ("10", "100", "1000")} | {("two", "10"): one + scores(7, 2)}
    found = built(made(tmp_path, values, rest=table()))
    # 2/128, three times; the others are ones against other numbers.
    assert cells(found, "adjusted p")[0] == ("0.047",)
    alone = built(made(tmp_path, values, rest=table("at: {samples: 10}")))
    assert cells(alone, "adjusted p") == [("0.016",)]


# --- ranks


def three(tmp_path, values, options):
    rest = ALL + table(options).replace("mise", "all")
    return made(tmp_path, values, rest=rest, estimators=THIRD)


@pytest.mark.parametrize(
    ("further", "rank", "second_is"), [(0.4, "2", "tied"), (0.8, "3", "two")], ids=["tied with one", "last"]
)
def test_methods_that_no_test_tells_apart_share_a_rank(tmp_path, further, rank, second_is):
    base, noise = scores(20), np.random.default_rng(5).normal(0.0, 0.3, (2, 20))
    values = {
        ("one", "10"): base,
        ("two", "10"): base + 0.12 + noise[0],
        ("three", "10"): base + further + noise[1],
    }
    results = three(tmp_path, values, "show: ranks, at: {samples: 10}")
    found = built(results)
    assert found.header == ("samples", "one", "two", "three")
    assert [cell.split()[0] for cell in found.rows[0][1:]] == ["1", "1", rank]
    pairs = built(three(tmp_path, values, "at: {samples: 10}"))
    assert cells(pairs, "first", "second", "better", "ranks") == [
        ("one", "two", "tied", "1, 1"),
        ("one", "three", "one", f"1, {rank}"),
        ("two", "three", second_is, f"1, {rank}"),
    ]
    assert found.rows[0][1] == f"1 ({np.mean(base):.2f})"


def test_equal_methods_share_a_rank(tmp_path):
    one = scores(12)
    values = {("one", "10"): one, ("two", "10"): one * (1.0 + 1e-12), ("three", "10"): one + 1.0}
    found = built(three(tmp_path, values, "show: ranks, at: {samples: 10}"))
    assert [cell.split()[0] for cell in found.rows[0][1:]] == ["1", "1", "3"]


def test_a_reference_is_compared_with_all_others(tmp_path):
    found = built(three(tmp_path, {}, "reference: two, at: {samples: 10}"))
    assert cells(found, "first", "second") == [("one", "two"), ("three", "two")]
    assert "ranks" not in found.header
    assert "rank_first" not in found.data


def test_cases_may_be_held_or_stand_in_tables_of_their_own(tmp_path):
    one = scores(12)
    values = {("one", "10"): one, ("two", "10"): one + np.linspace(0.5, 1.5, 12)}
    row = ("-1.00 [-1.21, -0.792]", "one")
    results = made(tmp_path, values, rest=table("at: {samples: 10}"))
    held: Any = results.plan.experiment.tables["t"]
    assert misfits(results.plan, held) == []
    assert cells(held.built(results, judge(results)), "mean difference [95 %]", "better") == [row]
    (tmp_path / "b").mkdir()
    results = made(tmp_path / "b", values, rest=table("facets: {rows: samples}"))
    each: Any = results.plan.experiment.tables["t"]
    assert misfits(results.plan, each) == []
    found = each.built(results, judge(results))
    assert row in cells(found, "mean difference [95 %]", "better")
    # The tests of all blocks are one family: of three p-values of which two are 1, the least is tripled.
    assert cells(found, "adjusted p")[0] == ("0.0015",)
    assert any("over the 3 tests of this table" in note for note in found.notes)


def test_an_estimator_that_is_left_out_has_no_row_there(tmp_path):
    rest = "skip: [{samples: 10, estimator: three}, {samples: 100, estimator: [one, three]}]\n"
    results = made(tmp_path, {}, rest=ALL + rest + table().replace("mise", "all"), estimators=THIRD)
    assert cells(built(results), "samples", "first", "second") == [
        ("10", "one", "two"),
        ("1000", "one", "two"),
        ("1000", "one", "three"),
        ("1000", "two", "three"),
    ]
    rest += table("show: ranks").replace("mise", "all")
    ranked = built(made(tmp_path, {}, rest=ALL + rest, estimators=THIRD))
    assert [row[-1] for row in ranked.rows] == ["-", "1 (1.00)"]


def test_without_axes_there_is_one_case(tmp_path):
    found = built(made(tmp_path, {}, rest=table("at: {samples: 100}")))
    assert len(found.rows) == 1


# --- messages

NO_SCORES = {
    *("value", "true_value", "share", "coverage", "nonlinearity_value", "settling_time", "moved_delay"),
    *("response", "true_response", "residual_test", "disturbance_variance", "disturbance_variance_formula"),
    *("static_function", "frequency_response", "model_output"),
}


def test_every_metric_says_which_values_are_good_or_is_known_to_be_no_score():
    plugins.load()
    own = {
        kind: cls for kind, cls in components("metric").items() if cls.__module__.startswith("hident.metrics")
    }
    assert {
        kind for kind, cls in own.items() if issubclass(cls, MetricSpec) and cls.best is None
    } == NO_SCORES


CONFIG = """\
version: 1
title: T
trials: TRIALS
samples: 50
system:
  kind: hammerstein
  nonlinearity: {kind: polynomial, coefficients: [0, 1, 2]}
  linear: {kind: fir, b: [0, 0.6, -0.8]}
excitation: &uniform {kind: iid, distribution: uniform, low: -3, high: 3}
noise: {kind: white, std: $s}
streams: {kind: numpy, share: SHARE}
cases: {s: [CASES]}
estimators:
  a: {kind: two_stage, lags: 2, degree: 2}
  b: {kind: bilinear_least_squares, lags: 2, degree: 2}
  c: {kind: two_stage, lags: 2, degree: 3}
metrics:
  error: {kind: validation_error, excitation: *uniform, samples: 100}
  a_1: {kind: value, of: [a_1]}
  signed: {kind: error, of: [a_1]}
  two: {kind: validation_error, excitation: *uniform, samples: 99, estimators: [a, b]}
  one: {kind: validation_error, excitation: *uniform, samples: 98, estimators: [a]}
REST
"""


def config(rest, cases="0.1, 0.2", trials="2", share="[]"):
    words = {"REST": rest, "CASES": cases, "TRIALS": trials, "SHARE": share}
    text = CONFIG
    for old, new in words.items():
        text = text.replace(old, new)
    return text


RATE = "  g: {kind: rate, title: R, axis: s, metric: error, estimators: [a]}\n"


def said(folder, table="", figure="", **words):
    rest = f"tables:\n  t: {{kind: comparison, title: T, {table}}}\n{RATE}"
    rest += f"figures:\n  f: {{{figure}}}\n" if figure else ""
    text = config(rest, **words)
    if lines := refusals(folder, text):
        return lines
    try:
        check(planned(folder, text))
    except ConfigError as error:
        return str(error).replace(f"{folder}/", "").splitlines()
    return []


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("metric: error", None),
        ("metric: signed a_1", None),
        (
            "metric: a_1 a_1",
            "'a_1 a_1' does not say which of its values are good: set 'best' to lowest, highest or zero",
        ),
        ("metric: a_1 a_1, best: highest", None),
        ("metric: one", "no case holds two methods to compare (there are: a)"),
        ("metric: error, estimators: [a]", "must name at least two"),
        ("metric: error, estimators: [a, b, a]", "names a twice"),
        ("metric: error, estimators: [a, d]", "there is no estimator 'd'"),
        ("metric: two, estimators: [a, c]", "the metric 'two' does not score the estimator 'c'"),
        (
            "metric: error, reference: c, estimators: [a, b]",
            "the reference 'c' must be one of the estimators",
        ),
        (
            "metric: error, reference: a, show: ranks",
            "ranks need each method against each: leave out 'reference', or show pairs",
        ),
        ("metric: error, equal: 1", "must be less than 1"),
        ("metric: eror", "there is no metric 'eror'; did you mean 'error'?"),
    ],
)
def test_what_cannot_be_compared_is_said_before_the_run(tmp_path, table, message):
    lines = said(tmp_path, table)
    assert (not lines) if message is None else any(message in line for line in lines), lines


@pytest.mark.parametrize(
    ("fixed", "trials", "refused"),
    [("[input, noise]", "2", True), ("[input, noise]", "1", False), ("[input]", "2", False)],
)
def test_trials_that_are_one_record_are_refused(tmp_path, fixed, trials, refused):
    lines = said(tmp_path, "metric: error", share=f"[], fixed: {fixed}", trials=trials)
    wanted = (
        "all trials at s 0.1 are one record, as 'streams' fixes input and noise, and no test tells anything "
        "from one: let one of them vary, or set 'trials: 1'"
    )
    assert [line.partition("metric: ")[2].startswith(wanted) for line in lines] == [True] * refused


# --- figures


@pytest.mark.parametrize(
    ("figure", "words", "message"),
    [
        ("kind: paired_differences, table: t, x_label: x", {}, None),
        (
            "kind: paired_differences, table: g, x_label: x",
            {},
            "the table 'g' must be of kind comparison, not rate",
        ),
        (
            "kind: critical_differences, table: t",
            {"cases": "1, 2, 3, 4, 5, 6, 7, 8, 9"},
            "averages ranks over at least 10 cases, and 9 of the table 't' hold all 3 methods",
        ),
        ("kind: critical_differences, table: t", {"cases": "1, 2, 3, 4, 5, 6, 7, 8, 9, 10"}, None),
        (
            "kind: critical_differences, table: t",
            {"cases": "1, 2, 3, 4, 5, 6, 7, 8, 9, 10", "share": "[noise]"},
            "takes the cases as independent, and they share random numbers: leave out 'streams.share'",
        ),
        (
            "kind: critical_differences, table: t",
            {"table": "metric: two", "cases": "1, 2, 3, 4, 5, 6, 7, 8, 9, 10"},
            "ranks at least 3 methods, and the table 't' has 2: its rows tell two apart",
        ),
    ],
)
def test_what_a_figure_cannot_show_is_said_before_the_run(tmp_path, figure, words, message):
    lines = said(tmp_path, words.pop("table", "metric: error"), figure, **words)
    assert (not lines) if message is None else any(message in line for line in lines), lines


def drawn(results, name="f"):
    with style():
        figure = results.plan.experiment.figures[name].draw(results, [])
        figure.canvas.draw()
    return figure


PAIRED = table("OF") + "figures:\n  f: {kind: paired_differences, table: t, x_label: Difference of MISE}\n"


@pytest.mark.parametrize("of", ["of: difference", "of: log_ratio", "statistic: median"])
def test_paired_differences_show_trials_intervals_and_failures(tmp_path, of):
    one = scores(12)
    values = {("one", "10"): one, ("two", "10"): np.r_[NAN, NAN, one[2:] + 0.5]}
    figure = drawn(made(tmp_path, values, rest=PAIRED.replace("OF", of)))
    (axes,) = (axes for axes in figure.axes if axes.get_visible())
    lines: dict[str, list[Any]] = {}
    for line in axes.get_lines():
        lines.setdefault(str(line.get_label()), []).append(line)
    expected = np.log(one[2:] / (one[2:] + 0.5)) if of == "of: log_ratio" else np.full(10, -0.5)
    shown = lines["a trial"][0].get_xdata()
    np.testing.assert_allclose(np.log(shown) if of == "of: log_ratio" else shown, expected)
    assert len(lines["a trial"]) == 3
    statistic = {"statistic: median": "median", "of: log_ratio": "geometric mean"}.get(of, "mean")
    (told,) = lines[f"{statistic}, 95 % interval; first is better"]
    # The better one has the lower values.
    assert told.get_marker() == "<"
    without = "interval without the trials in which one failed"
    assert (without in lines) == (statistic != "median")
    assert len(lines[f"{statistic}, 95 % interval; tied"]) == 2
    (strip,) = axes.child_axes
    assert [text.get_text() for text in strip.texts] == ["0, 2"]
    assert strip.get_xlabel() == "failed\nof 12"
    assert [tick.get_text() for tick in axes.get_yticklabels()] == [f"samples {n}" for n in (10, 100, 1000)]
    assert axes.get_title() == ("one / two" if of == "of: log_ratio" else "one \N{MINUS SIGN} two")


@pytest.mark.parametrize(("first", "arrows"), [([1.0, 2.0], 2), ([1.0] * 30 + [2.0] * 30, 0)])
def test_an_interval_that_goes_on_beyond_the_panel_ends_in_arrows(tmp_path, first, arrows):
    results = made(tmp_path, {("one", "10"): first}, rest=PAIRED.replace("OF", "at: {samples: 10}"))
    (axes,) = (axes for axes in drawn(results).axes if axes.get_visible())
    ends = [text.xy[0] for text in axes.texts if isinstance(text, Annotation) and text.arrow_patch]
    assert ends == [*axes.get_xlim()][:arrows]


@pytest.mark.parametrize(
    ("low", "high"),
    [
        (0.999, 1.001),
        (0.6, 1.02),
        (1.1, 1.9),
        (0.16, 1.3),
        (0.13, 7.5),
        (0.05, 1.3),
        (0.012, 1.3),
        (0.001, 1.3),
    ],
)
@pytest.mark.parametrize("columns", [1, 3])
def test_ratios_have_two_numbers_at_least_in_each_panel_and_none_that_touch(tmp_path, low, high, columns):
    rest = "figures:\n  f: {kind: paired_differences, table: t, x_label: X, size: column, columns: 2}\n"
    rest = ALL + table("of: log_ratio").replace("mise", "all") + rest.replace("2}", f"{columns}}}")
    values = {("one", n): np.geomspace(low, high, 9) for n in ("10", "100", "1000")}
    results = made(tmp_path, values, rest=rest, estimators=THIRD)
    spec: Any = results.plan.experiment.figures["f"]
    with style():
        figure = spec.drawn(results, [])
        figure.draw_without_rendering()
    for axes in [one for one in figure.axes if one.get_visible()][:2]:
        start, end = axes.get_xlim()
        boxes = [
            label.get_window_extent()
            for tick, label in zip(axes.get_xticks(), axes.get_xticklabels(), strict=True)
            if start <= tick <= end
        ]
        assert len(boxes) > 1
        assert all(left.x1 < right.x0 for left, right in itertools.pairwise(boxes))


@pytest.mark.parametrize("of_table", ["", "facets: {rows: samples}"])
@pytest.mark.parametrize("of_figure", ["", "facets: {rows: samples}", "at: {samples: 10}"])
def test_a_figure_tells_apart_what_its_table_does_whatever_part_it_shows(tmp_path, of_table, of_figure):
    one = scores(6)
    # 2/64, which alone would be told, and with the tests of other cases is not.
    values = {("one", n): one for n in ("10", "100", "1000")} | {("two", "10"): one + scores(6, 2)}
    rest = PAIRED.replace("OF", of_table).replace("label: Difference of MISE", f"label: D, {of_figure}")
    results = made(tmp_path, values, rest=rest)
    figure: Any = results.plan.experiment.figures["f"]
    assert misfits(results.plan, figure) == []
    with style():
        shown = figure.drawn(results, [])
    labels = [str(line.get_label()) for axes in shown.axes for line in axes.get_lines()]
    assert labels.count("mean, 95 % interval; tied") == (1 if "at" in of_figure[:2] else 3)
    assert not any("is better" in label for label in labels)


def test_a_figure_of_labels_that_its_table_leaves_out_is_refused(tmp_path):
    rest = PAIRED.replace("OF", "at: {samples: 10}").replace("Difference of MISE", "D, at: {samples: 100}")
    results = made(tmp_path, {}, rest=rest)
    figure: Any = results.plan.experiment.figures["f"]
    assert misfits(results.plan, figure) == [(("table",), "the table 't' compares no two methods there")]


@pytest.mark.parametrize("values", [[1.0], [NAN], [NAN, NAN], [0.0, 0.0]])
@pytest.mark.parametrize("of", ["of: difference", "of: log_ratio", "statistic: median"])
def test_paired_differences_of_next_to_nothing_are_drawn(tmp_path, values, of):
    rest = PAIRED.replace("OF", of)
    drawn(made(tmp_path, {(name, n): values for name in ("one", "two") for n in ("10", "100")}, rest=rest))
    drawn(made(tmp_path, {("one", "10"): values}, rest=rest))


def test_critical_differences_join_what_is_not_told_apart(tmp_path):
    axes = f"  pole:\n{''.join(f'    p{i}: {{system.linear.a: [0.{i}]}}{chr(10)}' for i in range(1, 5))}"
    rest = ALL + table().replace("mise", "all") + "figures:\n  f: {kind: critical_differences, table: t}\n"
    one = scores(5)
    samples = ("10", "100", "1000")
    values = {("one", n): one for n in samples} | {("two", n): one for n in samples}
    values |= {("three", n): [NAN, NAN, NAN, 0.0, 0.0] for n in samples}
    results = made(tmp_path, values, rest=rest, estimators=THIRD, axes=axes)
    spec: Any = results.plan.experiment.figures["f"]
    found, failed = spec.scores(results)
    # The median of a method that fails in most trials is the worst.
    assert found.tolist() == [[np.median(one), np.median(one), np.inf]] * 12
    assert failed == {"one": 0, "two": 0, "three": 36}
    texts = [text.get_text().strip() for text in drawn(results).axes[0].texts]
    assert {"one (1.50)", "two (1.50)", "three (3.00), 36 failed", "critical difference 0.96"} <= set(texts)
    (axes,) = drawn(results).axes
    bars = [line for line in axes.get_lines() if line.get_linewidth() > 3.0]
    assert [np.round(bar.get_xdata(), 2).tolist() for bar in bars] == [[1.46, 1.54]]


def fitting(folder, figure, names, **words):
    """A figure of methods with these names as it is laid out, of random errors."""
    rest = f"tables:\n  t: {{kind: comparison, metric: error, title: T}}\nfigures:\n  f: {{{figure}}}\n"
    text = re.sub(r"  (two|one): \{kind: validation_error.*\n", "", config(rest, **words))
    for old, new in zip("abc", names, strict=True):
        text = text.replace(f"\n  {old}: ", f"\n  {new!r}: ")
    plan = planned(folder, text)
    check(plan)
    rng = np.random.default_rng(1)
    series = [
        Series(unit, label, rng.uniform(1.0, 9.0, plan.trials))
        for unit in plan.units
        for label in unit.metric_labels
    ]
    spec: Any = plan.experiment.figures["f"]
    with style():
        shown = spec.drawn(Results(plan, tuple(series)), [])
        typeset(shown)
        shown.draw_without_rendering()
    return shown


def texts_of(figure):
    """All texts that are seen, with their boxes."""
    axes = figure.findobj(Axes)
    ticks = [tick for one in axes for axis in (one.xaxis, one.yaxis) for tick in axis.get_major_ticks()]
    unseen = {tick.label2 for tick in ticks}
    for tick in ticks:
        low, high = sorted(tick.axes.get_xlim() if isinstance(tick, XTick) else tick.axes.get_ylim())
        if not tick.axes.axison or not low <= tick.get_loc() <= high:
            unseen.add(tick.label1)
    found = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    found = [text for text in found if text not in unseen and (text.axes is None or text.axes.get_visible())]
    return [(text.get_text(), text.get_window_extent()) for text in found]


def _lie_apart(shown, texts):
    for said, box in texts:
        assert min(box.x0, box.y0, shown.bbox.x1 - box.x1, shown.bbox.y1 - box.y1) > -1.0, said
    for (said, at), (other, there) in itertools.combinations(texts, 2):
        overlap = min(at.x1, there.x1) - max(at.x0, there.x0), min(at.y1, there.y1) - max(at.y0, there.y0)
        assert min(overlap) < 2.0, (said, other)


ORDINARY = ("instrumental variables, order 2", "bilinear least squares, degree 4", "two-stage, nine lags")
LONG = ("a method whose name goes on and on, never ends, and says all of its settings", *ORDINARY[1:])
TEN = ", ".join(f"0.{i}" for i in range(11, 21))


@pytest.mark.parametrize("names", [ORDINARY, LONG], ids=["ordinary", "long"])
@pytest.mark.parametrize(
    "figure",
    [
        "kind: paired_differences, table: t, x_label: error",
        "kind: paired_differences, table: t, x_label: error, size: column",
        "kind: paired_differences, table: t, x_label: error, size: page",
        "kind: paired_differences, table: t, x_label: error, facets: {rows: s}",
        "kind: critical_differences, table: t, size: column",
        "kind: critical_differences, table: t",
    ],
)
def test_no_text_of_a_comparison_lies_on_another_or_is_cut(tmp_path, figure, names):
    shown = fitting(tmp_path, figure, names, cases=TEN if "critical" in figure else "0.1, 0.2", trials="12")
    texts = texts_of(shown)
    _lie_apart(shown, texts)
    assert any("never ends" in " ".join(said.split()) for said, _ in texts) == (names is LONG)
    if "column" in figure:
        assert shown.get_figwidth() * 25.4 == pytest.approx(88.0)


LEVELS = f"{TEN}], excitation.high: [3, 2.5, 2"


@pytest.mark.parametrize("facets", ["rows: excitation.high", "columns: excitation.high"])
@pytest.mark.parametrize("names", [ORDINARY, LONG], ids=["ordinary", "long"])
def test_critical_differences_in_panels_keep_apart_and_say_what_each_is_of(tmp_path, facets, names):
    figure = f"kind: critical_differences, table: t, facets: {{{facets}}}"
    shown = fitting(tmp_path, figure, names, cases=LEVELS, trials="12")
    texts = texts_of(shown)
    _lie_apart(shown, texts)
    headings = [said.split("\n")[0] for said, _ in texts if "average rank" in said]
    assert headings == [f"excitation.high = {high}" for high in ("3", "2.5", "2")]
    words = {word for name in names for word in name.split()}
    assert words <= {word for said, _ in texts for word in said.split()}


def test_critical_differences_in_panels_too_narrow_for_a_name_say_so(tmp_path):
    figure = "kind: critical_differences, table: t, facets: {columns: excitation.high}, size: column"
    said = r"^beside the names of the methods the scale has 0 mm of 29: repeat it over 'rows', take a wider "
    with pytest.raises(ValueError, match=said):
        fitting(tmp_path, figure, ORDINARY, cases=LEVELS, trials="12")


def test_comparisons_for_which_paper_has_no_room_say_so(tmp_path):
    with pytest.raises(ValueError, match=r"it would be \d+ mm high, and a page has 220: take a wider 'size'"):
        fitting(
            tmp_path,
            "kind: paired_differences, table: t, x_label: error, size: column",
            LONG,
            cases=", ".join(f"0.{i}" for i in range(10, 90)),
        )
