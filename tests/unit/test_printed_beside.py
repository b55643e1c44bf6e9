"""A printed number stands beside the statistic that it is: a mean and a std of one series are two numbers."""

import numpy as np
import pytest

from hident.ledger.verdicts import judge
from hident.reports.style import style
from tests.unit.results_maker import made

BOTH = """
published:
  paper_trials: 10
  cells:
    - {table: T, row: "N={samples}", quantity: error, estimator: one, metric: mise}
    - {table: T, row: "N={samples}", quantity: std, estimator: one, metric: mise, statistic: std}
    - {table: T, row: "N={samples}", quantity: error, estimator: two, metric: mise}
"""
# The std comes last among the verdicts of a series.
NUMBERS = "".join(f"T,N={n},error,{4.0 / n},\nT,N={n},std,{9.0 / n},\n" for n in (10, 100, 1000))
VALUES = {(name, str(n)): np.array([3.0, 5.0]) / n for name in ("one", "two") for n in (10, 100, 1000)}
CURVE = """
figures:
  f: {{kind: curve, x: samples, metric: mise, x_label: N, y_label: e, panels: [[one]], {more}}}
"""
SCATTER = """
figures:
  f:
    kind: scatter
    panels: [{x: {estimator: one, metric: mise}, y: {estimator: two, metric: mise}}]
"""
DISTRIBUTION = """
tables:
  t:
    kind: distribution
    title: D
    columns: {e: e}
    rows: [{label: r, estimator: one, metric: m, metrics: {e: mise}}]
"""


def results(folder, rest):
    return made(folder, VALUES, rest=BOTH + rest, printed=NUMBERS)


@pytest.fixture
def draw():
    import matplotlib.pyplot as plt

    with style():
        yield lambda made: made.plan.experiment.figures["f"].draw(made, judge(made))
        plt.close("all")


def printed(axes):
    (line,) = (line for line in axes.lines if "printed" in line.get_label())
    return line.get_ydata()


@pytest.mark.parametrize(("statistic", "wanted"), [("mean", 4.0), ("std", 9.0)])
def test_a_curve_shows_the_number_of_its_statistic(tmp_path, draw, statistic, wanted):
    axes = draw(results(tmp_path, CURVE.format(more=f"statistic: {statistic}"))).axes[0]
    np.testing.assert_allclose(printed(axes), wanted / np.array([10, 100, 1000]))


def test_a_curve_without_a_number_for_its_statistic_shows_none(tmp_path, draw):
    axes = draw(results(tmp_path, CURVE.format(more="statistic: median"))).axes[0]
    assert not [line for line in axes.lines if "printed" in line.get_label()]


def test_the_root_is_taken_of_ours_and_of_the_printed_number(tmp_path, draw):
    axes = draw(results(tmp_path, CURVE.format(more="root: true"))).axes[0]
    n = np.array([10.0, 100.0, 1000.0])
    np.testing.assert_allclose(printed(axes), np.sqrt(4.0 / n))
    (ours,) = (line for line in axes.lines if line.get_label() == "one")
    np.testing.assert_allclose(ours.get_ydata(), np.sqrt(4.0 / n))


def test_a_scatter_of_trials_shows_the_printed_pair_of_means(tmp_path, draw):
    axes = draw(results(tmp_path, SCATTER)).axes[0]
    (line,) = (line for line in axes.lines if line.get_label() == "printed")
    assert (line.get_xdata()[0], line.get_ydata()[0]) == (0.4, 0.4)
    # Black is the truth, and what is printed is open in every figure.
    assert line.get_markerfacecolor() == "none" and line.get_color() != "black"


def test_a_distribution_of_trials_shows_the_printed_mean(tmp_path):
    found = results(tmp_path, DISTRIBUTION)
    table = found.plan.experiment.tables["t"].build(found, judge(found))
    assert table.rows[1][1].startswith("0.4 ")
    assert table.data["printed"].tolist() == ["0.4"]
