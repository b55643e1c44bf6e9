"""How often each outcome comes out, one metric against another, small searches, and legends that fit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hident import plugins
from hident.engine.experiment import load
from hident.engine.results import Results, Series
from hident.errors import ConfigError
from hident.estimators.moving_horizon.searches import PartitionSearch
from hident.ledger.verdicts import judge
from hident.reports.figures.scatter import rank_correlation
from hident.reports.one_trial.searches import draw_partition
from hident.reports.output import check
from hident.reports.style import legend_columns, style

CONFIG = """\
version: 1
title: t
paper: p
trials: 4
samples: 50
dt: 0.1
system:
  kind: hammerstein
  nonlinearity: identity
  linear: {kind: continuous, a: [4, 4, 3], b: [1, -1], delay: 2}
excitation: {kind: multistep, switching_time: 1, std: 1}
cases:
  type:
    I: {system.nonlinearity: chen_type_1}
    II: {system.nonlinearity: chen_type_2}
estimators:
  one: {kind: linear_model, block: {n: 1, horizon: 2}}
  two: {kind: linear_model, block: {n: 1, horizon: 2}}
metrics:
  structure: {kind: value, of: [n, m]}
  vif: {kind: value, of: [vif_mean], estimators: [one]}
published:
  paper_trials: 1
  cells:
    - {table: T, row: r, quantity: n, estimator: one, metric: structure n, statistic: median, at: {type: I}}
    - {table: T, row: r, quantity: m, estimator: two, metric: structure m, statistic: median, at: {type: I}}
"""
CHOICES = """\
tables:
  f:
    kind: choices
    title: C
    of: [structure n, structure m]
    estimators: [one, two]
"""
SCATTER = """\
figures:
  f:
    kind: scatter
    panels:
      - {x: {estimator: one, metric: structure n}, y: {estimator: two, metric: structure m, label: order m}}
      - title: II
        x: {estimator: one, metric: structure n, at: {type: II}}
        y: {estimator: two, metric: structure n, at: {type: II}}
"""


@pytest.fixture
def make(tmp_path):
    """Results with the given trials by (metric, estimator, type), else ones."""
    plugins.load()
    paper = tmp_path / "experiments" / "p"
    paper.mkdir(parents=True)
    (paper / "published.csv").write_text("table,row,quantity,printed,note\nT,r,n,3,\nT,r,m,1,\n")

    def results(rest, values=None):
        path = tmp_path / "c.yaml"
        path.write_text(CONFIG + rest)
        plan = load(path)
        check(plan)
        series = [
            Series(unit, label, np.asarray(found, dtype=float))
            for unit in plan.units
            for label in unit.metric_labels
            for found in [(values or {}).get((label, unit.name, unit.labels["type"]), np.ones(4))]
        ]
        return Results(plan, tuple(series))

    return results


class TestChoices:
    VALUES = {
        ("structure n", "one", "I"): [3, 3, 2, np.nan],
        ("structure m", "one", "I"): [1, 1, 1, np.nan],
        ("structure n", "two", "II"): [3, 3, 3, 4],
        ("structure m", "two", "II"): [1, 1, 2, 1],
    }

    def test_the_most_frequent_outcome_comes_first_and_failures_last(self, make):
        results = make(CHOICES, self.VALUES)
        table = results.plan.experiment.tables["f"].build(results, ())
        heads = ("(1, 1)", "(3, 1)", "(2, 1)", "(3, 2)", "(4, 1)", "failed")
        assert table.header == ("type", "estimator", *heads)
        assert table.rows == (
            ("I", "one", "0", "50", "25", "0", "0", "25"),
            ("II", "one", "100", "0", "0", "0", "0", "0"),
            ("I", "two", "100", "0", "0", "0", "0", "0"),
            ("II", "two", "0", "50", "0", "25", "25", "0"),
        )
        assert table.notes == ("Percent of 4 trials.",)
        assert table.data.loc[0, "(3, 1)"] == 50.0

    def test_a_single_metric_needs_no_parentheses(self, make):
        results = make(CHOICES.replace("[structure n, structure m]", "[structure n]"), self.VALUES)
        table = results.plan.experiment.tables["f"].build(results, ())
        assert table.header == ("type", "estimator", "1", "3", "2", "4", "failed")

    def test_a_metric_that_does_not_score_the_estimator_is_refused(self, make):
        with pytest.raises(
            ConfigError, match=r"of\[1\]: the metric 'vif vif_mean' does not score the estimator 'two'"
        ):
            make(CHOICES.replace("structure m]", "vif vif_mean]"))

    def test_an_unknown_estimator_is_refused(self, make):
        with pytest.raises(ConfigError, match=r"estimators\[0\]: there is no estimator 'onne'; did you"):
            make(CHOICES.replace("[one, two]", "[onne, two]"))


class TestScatter:
    def draw(self, results):
        return results.plan.experiment.figures["f"].draw(results, judge(results))

    def test_each_trial_is_a_point_beside_the_printed_pair(self, make):
        import matplotlib.pyplot as plt

        values = {
            ("structure n", "one", "I"): [1, 2, 3, np.nan],
            ("structure m", "two", "I"): [2, 1, 0, 5],
        }
        with style():
            left, right = self.draw(make(SCATTER, values)).axes
            lines = {line.get_label(): line for line in left.lines}
            assert lines["our trials"].get_xydata()[:3].tolist() == [[1, 2], [2, 1], [3, 0]]
            assert lines["printed"].get_xydata().tolist() == [[3, 1]]
            assert (left.get_xlabel(), left.get_ylabel()) == ("one, structure n", "order m")
            assert left.get_title() == "rank correlation -1.00"
            assert [line.get_label() for line in right.lines] == ["our trials"]
            assert right.get_title().startswith("II, rank correlation")
            plt.close("all")

    def test_axes_may_be_logarithmic(self, make):
        import matplotlib.pyplot as plt

        with style():
            axes = self.draw(make(SCATTER + "    log: true\n")).axes[0]
            assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
            plt.close("all")

    def test_a_metric_that_does_not_score_the_estimator_is_refused(self, make):
        with pytest.raises(
            ConfigError, match=r"panels\[0\].y.metric: the metric 'vif vif_mean' does not score"
        ):
            make(SCATTER.replace("metric: structure m", "metric: vif vif_mean"))


class TestRankCorrelation:
    @settings(deadline=None, derandomize=True, max_examples=50)
    @given(st.sets(st.integers(-1000, 1000), min_size=2, max_size=30))
    def test_any_rising_map_gives_one_and_any_falling_one_minus_one(self, values):
        x = np.array(list(values), dtype=float)
        assert rank_correlation(x, x**3 - 1.0) == pytest.approx(1.0)
        assert rank_correlation(x, -x) == pytest.approx(-1.0)

    def test_trials_that_failed_do_not_count(self):
        x = np.array([1.0, 2.0, np.nan, 3.0, 4.0])
        y = np.array([1.0, 3.0, 9.0, np.inf, 2.0])
        assert rank_correlation(x, y) == pytest.approx(0.5)

    def test_equal_values_share_their_rank(self):
        # Pearson's coefficient of the ranks 1, 2.5, 2.5, 4 and 1, 2, 3, 4.
        found = rank_correlation(np.array([1.0, 2.0, 2.0, 3.0]), np.array([1.0, 2.0, 3.0, 4.0]))
        assert found == pytest.approx(4.5 / np.sqrt(4.5 * 5.0))

    @pytest.mark.parametrize("x", [[1.0, np.nan, np.nan], [1.0, 1.0, 1.0], [np.nan] * 3])
    def test_what_does_not_vary_has_none(self, x):
        assert np.isnan(rank_correlation(np.array(x), np.array([1.0, 2.0, 3.0])))


@pytest.mark.parametrize("falling", [False, True])
def test_a_partition_search_with_few_pairs_left_shows_their_numbers(falling):
    import matplotlib.pyplot as plt

    lower, upper = np.linspace(-2.0, -0.2, 10), np.linspace(0.2, 2.0, 10)
    loss = np.full((10, 10), np.nan)
    loss[8, 8:] = [3.0, 2.0]
    if falling:
        lower, loss = lower[::-1], loss[::-1]
    with style():
        figure, axes = plt.subplots()
        draw_partition(axes, PartitionSearch(lower, upper, loss, (-0.45, 1.9), 1.9))
        figure.draw_without_rendering()
        numbers = {text.get_text(): text.get_position() for text in axes.texts}
        assert numbers["1.50"] == pytest.approx((-0.4, 1.8))
        assert numbers["1.00"] == pytest.approx((-0.4, 2.0))
        # From a point of the grid beyond what is shown to the last one, with a margin.
        assert axes.get_xlim() == pytest.approx((-0.6 - 0.032, -0.2 + 0.032))
        assert axes.get_ylim() == pytest.approx((1.6 - 0.032, 2.0 + 0.032))
        plt.close("all")


@pytest.mark.parametrize(
    ("lengths", "width", "columns"),
    [
        ([5], 1.0, 1),
        ([5, 5, 5, 5, 5], 7.0, 5),
        # Five that do not fit one row stand in rows of three and two, not of four and one.
        ([20, 20, 20, 20, 20], 7.0, 3),
        ([12, 20, 35], 5.0, 2),
        ([90, 90], 5.0, 1),
    ],
)
def test_a_legend_has_as_few_rows_as_its_labels_allow(lengths, width, columns):
    assert legend_columns(lengths, width) == columns
