"""Tables and figures of named parameters."""

import re
from pathlib import Path

import numpy as np
import pytest

from hident import plugins
from hident.engine.experiment import load
from hident.engine.results import Results, Series
from hident.errors import ConfigError
from hident.ledger.verdicts import judge
from hident.reports.output import check
from hident.reports.style import style

CONFIG = """\
version: 1
title: t
paper: p
trials: 3
samples: 50
system:
  kind: hammerstein
  nonlinearity: {kind: polynomial, coefficients: [0, 2]}
  linear: {kind: fir, b: [0, 1]}
excitation: {kind: iid, distribution: gaussian, std: 1}
noise: {kind: ar, a: [0.5], std: 1}
cases: {noise.a: [[0.5]]}
estimators:
  one: {kind: two_stage, lags: 1, degree: 1}
  two: {kind: two_stage, lags: 1, degree: 1, weight: {kind: ar, a: [0.5]}}
  bound: {kind: cramer_rao, lags: 1, degree: 1, variance: 1}
metrics:
  theta: {kind: value, of: [a_1, loss], estimators: [one, two]}
  error: {kind: error, of: [a_1], estimators: [one, two]}
  least: {kind: value, of: [se_a_1], estimators: [bound]}
published:
  paper_trials: 10
  cells:
    - {table: T, row: r, quantity: mean, estimator: one, metric: theta a_1}
    - {table: T, row: r, quantity: std, estimator: one, metric: theta a_1, statistic: std}
    - {table: T, row: s, quantity: std, estimator: two, metric: theta a_1, statistic: std}
tables:
  t:
    kind: parameters
    title: P
    metric: theta
    of: [a_1]
    mean_only: [loss]
    estimators: [one, two]
    decimals: 2
  e:
    kind: efficiency
    title: E
    metric: error
    of: [a_1]
    estimators: [one]
    bound: bound
    bound_metric: least
figures:
  p: {kind: parameters, metric: theta, of: [a_1], estimators: [one, two]}
  g: {kind: gain, metric: theta, of: [a_1], reference: one, estimator: two, y_label: ratio}
  e: {kind: efficiency, x: noise.a, table: TABLE, of: [a_1], x_label: pole}
"""
VALUES = {
    ("one", "theta a_1"): [1.0, 2.0, 3.0],
    ("two", "theta a_1"): [1.5, 2.0, 2.5],
    ("one", "error a_1"): [-1.0, 0.0, 1.0],
    ("bound", "least se_a_1"): [0.5, 0.5, 0.5],
}


@pytest.fixture
def make(tmp_path: Path):
    plugins.load()
    paper = tmp_path / "experiments" / "p"
    paper.mkdir(parents=True)
    rows = "T,r,mean,2.0,\nT,r,std,1.5,\nT,s,std,0.5,\n"
    (paper / "published.csv").write_text("table,row,quantity,printed,note\n" + rows)

    def results(table: str = "e", change: tuple[str, str] = ("", ""), *more: tuple[str, str]) -> Results:
        path = tmp_path / "c.yaml"
        text = CONFIG.replace("TABLE", table)
        for words in (change, *more):
            text = text.replace(*words)
        path.write_text(text)
        plan = load(path)
        series = tuple(
            Series(unit, label, np.array(VALUES.get((unit.name, label), [7.0, 7.0, 7.0])))
            for unit in plan.units
            for label in unit.metric_labels
        )
        return Results(plan, series)

    return results


@pytest.fixture
def draw():
    import matplotlib.pyplot as plt

    with style():
        yield lambda results, name: results.plan.experiment.figures[name].draw(results, judge(results))
        plt.close("all")


def test_parameters_stand_beside_the_printed_ones(make):
    results = make()
    table = results.plan.experiment.tables["t"].build(results, judge(results))
    assert table.header == ("parameter", "one", "printed", "two", "printed")
    assert table.rows == (
        ("a_1", "2.00 ± 1.00", "2.0 = ± 1.5 ?", "2.00 ± 0.50", "0.5 ="),
        ("loss", "7.00", "", "7.00", ""),
    )


def test_efficiency_is_squared_bound_over_variance(make):
    results = make()
    table = results.plan.experiment.tables["e"].build(results, ())
    assert table.data["a_1"].to_list() == pytest.approx([0.25])
    assert table.notes == ("Relative standard error of each entry: 1.000 (3 trials).",)


def test_the_parameter_figure_shows_estimates_printed_numbers_and_truth(make, draw):
    axes = draw(make(), "p").axes[0]
    labels = axes.get_legend_handles_labels()[1]
    assert labels == ["truth", "one", "one, printed", "two"]
    assert axes.get_title() == "$a_{1}$"
    truth = next(line for line in axes.lines if line.get_label() == "truth")
    assert truth.get_ydata()[0] == 2.0


@pytest.mark.parametrize(
    ("kind", "line"),
    [("{kind: error, of: [a_1]}", ("no error", 0.0)), ("{kind: share, of: [a_1], equals: 2}", None)],
)
def test_the_line_of_the_parameter_figure_is_of_the_numbers_that_it_shows(make, draw, kind, line):
    figure = "p: {kind: parameters, metric: other, of: [a_1], estimators: [one, two]}\n"
    drop = ("p: {kind: parameters, metric: theta, of: [a_1], estimators: [one, two]}\n", figure)
    axes = draw(
        make("e", ("  least:", f"  other: {kind[:-1]}, estimators: [one, two]}}\n  least:"), drop), "p"
    ).axes[0]
    lines = {one.get_label(): one.get_ydata()[0] for one in axes.lines}
    assert [(label, lines[label]) for label in ("truth", "no error") if label in lines] == [line] * bool(line)


def test_the_gain_figure_shows_both_ratios(make, draw):
    axes = draw(make(), "g").axes[0]
    points = {line.get_label(): line.get_ydata() for line in axes.lines}
    assert points["printed"] == pytest.approx([3.0])
    assert axes.containers[0].lines[0].get_ydata() == pytest.approx([2.0])
    assert axes.get_ylabel() == "ratio"


def test_an_efficiency_figure_needs_its_table(make):
    with pytest.raises(
        ConfigError, match=r"figures.e.table: the table 't' must be of kind efficiency, not param"
    ):
        check(make("t").plan)
    with pytest.raises(ConfigError, match=r"figures.e.table: there is no table 'nothing'"):
        make("nothing")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            ("    bound: bound", "    bound: one"),
            "tables.e.of[0]: the metric 'least se_a_1' does not score the estimator 'one'",
        ),
        (
            ("estimators: [one]\n    bound", "estimators: [bound]\n    bound"),
            "tables.e.of[0]: the metric 'error a_1' does not score the estimator 'bound'",
        ),
        (
            ("    bound_metric: least", "    bound_metric: last"),
            "tables.e.of[0]: there is no metric 'last se_a_1'; did you mean 'least se_a_1'?",
        ),
    ],
)
def test_an_efficiency_needs_what_its_estimators_and_its_bound_are_scored_by(make, change, message):
    with pytest.raises(ConfigError, match=re.escape(message)):
        check(make(change=change).plan)


AXES = (
    ("cases: {noise.a: [[0.5]]}", "cases: {noise.std: [1, 2], samples: [40, 50]}"),
    ("x: noise.a, table: e", "x: samples, table: e, FIELDS"),
)


def test_an_efficiency_over_one_of_two_axes_is_refused_and_held_or_repeated_over_the_other(make):
    with pytest.raises(ConfigError, match=r"the axes noise\.std too: give"):
        check(make("e", *AXES, (", FIELDS", "")).plan)
    for fields in ("at: {noise.std: 2}", "facets: {columns: noise.std}"):
        results = make("e", *AXES, ("FIELDS", fields))
        check(results.plan)
        with style():
            figure = results.plan.experiment.figures["e"].drawn(results, ())
        curves = [
            line.get_xdata() for axes in figure.axes for line in axes.lines if line.get_label() == "one"
        ]
        assert [list(x) for x in curves] == [[40.0, 50.0]] * (1 + (fields[0] == "f"))
