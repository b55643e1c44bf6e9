"""Figures: what they show, read back from the axes."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from hident.ledger.verdicts import judge
from hident.reports.mathematics import typeset
from hident.reports.style import few_log_ticks, style, subplots
from tests.unit.results_maker import PUBLISHED, made

CURVE = """
figures:
  f:
    kind: curve
    x: samples
    metric: mise
    statistic: median
    panels: [[one, two]]
    x_label: N
    y_label: error
    slopes: [{slope: -1, label: falls}]
"""
REALISATION = """
figures:
  f: {kind: realisation, at: [{samples: 10}, {samples: 1000}], estimators: [one, two], interval: [-1, 1]}
"""


@pytest.fixture
def draw():
    """Draw the figure ``f`` and close it afterwards."""
    import matplotlib.pyplot as plt

    with style():
        yield lambda results: results.plan.experiment.figures["f"].draw(results, judge(results))
        plt.close("all")


def test_a_curve_shows_statistic_band_printed_numbers_and_slope(tmp_path, draw):
    values = {("one", str(n)): np.linspace(1.0, 2.0, 21) / n for n in (10, 100, 1000)}
    numbers = "".join(f"T,N={n},error,{2 / n},\n" for n in (10, 100, 1000))
    rest = CURVE + PUBLISHED.format(runs=1, statistic="median")
    figure = draw(made(tmp_path, values, rest=rest, printed=numbers))
    axes = figure.axes[0]
    lines = {line.get_label(): line for line in axes.lines if line.get_label()[0] != "_"}
    assert list(lines) == ["one", "one, printed", "two", "falls"]
    assert lines["one"].get_ydata() == pytest.approx([0.15, 0.015, 0.0015])
    assert lines["one, printed"].get_ydata() == pytest.approx([0.2, 0.02, 0.002])
    assert lines["falls"].get_ydata() == pytest.approx([0.075, 0.0075, 0.00075])
    band = axes.collections[0].get_paths()[0].get_extents()
    assert (band.y0, band.y1) == pytest.approx((1.05 / 1000, 1.95 / 10))
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("N", "error")
    # Above the panel, where it lies over nothing.
    [legend] = figure.legends
    assert axes.get_legend() is None
    assert {text.get_text() for text in legend.get_texts()} == {*lines}
    assert lines["one, printed"].get_markerfacecolor() == "none"


def test_the_lowest_panel_of_each_column_has_numbers_and_a_label(tmp_path, draw):
    rest = CURVE.replace("[[one, two]]", "[[one], [two], [one, two]]")
    first, second, third, left_out = draw(made(tmp_path, {}, rest=rest)).axes
    assert not left_out.get_visible()
    for axes, is_lowest in ((first, False), (second, True), (third, True)):
        assert axes.get_xlabel() == ("N" if is_lowest else "")
        assert axes.xaxis.get_tick_params()["labelbottom"] == is_lowest


def test_a_curve_may_have_bars_and_a_level_beside_it(tmp_path, draw):
    values = {("one", str(n)): np.linspace(1.0, 2.0, 21) for n in (10, 100, 1000)}
    rest = CURVE.replace(
        "statistic: median", "statistic: mean\n    band: false\n    bars: true\n    level: 1.5"
    )
    results = made(tmp_path, values, rest=rest)
    axes = draw(results).axes[0]
    reach = 2.0 * np.std(np.linspace(1.0, 2.0, 21), ddof=1) / np.sqrt(21)
    bars = axes.collections[0].get_segments()
    assert len(bars) == 3
    for n, bar in zip((10, 100, 1000), bars, strict=True):
        assert bar == pytest.approx(np.array([[n, 1.5 - reach], [n, 1.5 + reach]]))
    assert [1.5, 1.5] in [list(line.get_ydata()) for line in axes.lines]


def test_curves_differ_without_colour(tmp_path, draw):
    axes = draw(made(tmp_path, {}, rest=CURVE)).axes[0]
    curves = [line for line in axes.lines if line.get_label() in ("one", "two")]
    looks = {(line.get_linestyle(), line.get_marker()) for line in curves}
    assert len(looks) == 2


def test_a_slope_stands_below_all_curves(tmp_path, draw):
    values = {("two", str(n)): np.linspace(1.0, 2.0, 21) / (3 * n) for n in (10, 100, 1000)}
    values |= {("one", str(n)): np.linspace(1.0, 2.0, 21) / n for n in (10, 100, 1000)}
    rest = CURVE.replace("[[one, two]]", "[[one], [one, two]]")
    starts = [axes.lines[-1].get_ydata()[0] for axes in draw(made(tmp_path, values, rest=rest)).axes]
    assert starts == pytest.approx([0.075, 0.025])


def test_powers_are_set_as_mathematics(draw):
    figure, axes = subplots(figsize=(2, 2))
    axes.plot([0, 1], label="W = R^-1, N = 10^3")
    axes.set_xlabel("$R^-1$ or x^2")
    axes.set_ylabel("std with W = R^-1")
    axes.legend()
    typeset(figure)
    (entry,) = axes.get_legend().get_texts()
    assert entry.get_text() == "W = $R^{-1}$, N = 10^3"
    assert axes.get_xlabel() == "$R^-1$ or x^2"
    assert axes.get_ylabel() == "std with W = $R^{-1}$"


def test_a_realisation_shows_data_truth_and_estimate_in_every_panel(tmp_path, draw):
    figure = draw(made(tmp_path, {}, rest=REALISATION))
    assert [axes.get_title() for axes in figure.axes] == [
        "one, samples = 10",
        "two, samples = 10",
        "one, samples = 1000",
        "two, samples = 1000",
    ]
    for axes, n in zip(figure.axes, (10, 10, 1000, 1000), strict=True):
        lines = {line.get_label(): line for line in axes.lines}
        assert list(lines) == ["data", "true μ", "estimate"]
        assert len(lines["data"].get_xdata()) == n
        assert lines["true μ"].get_ydata() == pytest.approx(np.linspace(-1, 1, 2001))
    # The two estimators of a case see the same data.
    first, second = (axes.lines[0].get_ydata() for axes in figure.axes[:2])
    assert np.array_equal(first, second)


def test_the_truth_is_broken_at_its_jumps(tmp_path, draw):
    rest = REALISATION.replace("interval: [-1, 1]", "interval: [-1, 1], y_limits: [-2, 2]")
    results = made(tmp_path, {}, rest=rest, axes="  system.nonlinearity: [sign]\n")
    axes = draw(results).axes[0]
    true = axes.lines[1].get_ydata()
    assert np.isnan(true).sum() == 1
    assert np.isnan(true[1000])
    assert axes.get_ylim() == (-2, 2)


@pytest.mark.parametrize(("low", "high"), [(0.6, 1.02), (0.98, 1.03), (9.0, 11.0), (2.2, 4.5), (0.1, 30.0)])
def test_few_numbers_on_a_logarithmic_axis_are_two_at_least(low, high):
    axes = Figure().add_subplot()
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    few_log_ticks(axes.yaxis)
    assert np.count_nonzero((axes.get_yticks() >= low) & (axes.get_yticks() <= high)) > 1
