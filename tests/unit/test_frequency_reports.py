"""Tables against truth, signals, level means and Bode diagrams: what they show, read back."""

import numpy as np
import pytest

from hident import plugins
from hident.engine.experiment import load
from hident.engine.results import Results, Series
from hident.errors import ConfigError
from hident.ledger.verdicts import judge
from hident.metrics import frequency
from hident.reports.output import check
from hident.reports.style import style

CONFIG = """\
version: 1
title: Two blocks
paper: someone2001
trials: 4
dt: 0.5
samples: 560
system:
  kind: wiener_hammerstein
  input_linear: {kind: continuous, a: [0.5]}
  nonlinearity: {kind: polynomial, coefficients: [2, 1, 0.5]}
  output_linear: {kind: continuous, a: [1]}
excitation:
  kind: experiments
  parts:
    - {name: steps, excitation: {kind: staircase, levels: [-1, 0, 1], hold: 40, initial: 0}, samples: 240}
    - name: sines
      excitation: {kind: stepped_sine, frequencies: [0.5, 1], periods: 5, samples_per_period: 32}
noise: {kind: white, std: 0.01}
estimators:
  FGI:
    kind: frequency_gain_identification
    frequencies: [0.5, 1]
    order: 2
    nonlinearity: {kind: nonlinearity_identification, degree: 2}
    phases: single
    gauge: {kind: rational, input: [0, 1], output: [0, 1]}
  NI: {kind: nonlinearity_identification, degree: 2}
metrics:
  found: {kind: response, of: [gain_i_1..2, gain_o_1..2_1, phase_i_1..2, phase_o_1..2_1], estimators: [FGI]}
  truth: {kind: true_response, of: [gain_i_1, phase_i_1], estimators: [FGI]}
  c: {kind: value, of: [c_0], estimators: [NI]}
"""
PUBLISHED = """\
published:
  paper_trials: 10
  cells: [{table: T, row: r, quantity: gain, estimator: FGI, metric: found gain_i_1, statistic: median}]
"""
TABLE = """\
tables:
  t:
    kind: against_truth
    title: Against truth
    rows: {"|Gi|": gain_i_1, arg Gi: phase_i_1}
    metric: found
    truth: truth
    estimators: {ours: FGI}
"""
SIGNALS = """\
figures:
  f: {kind: signals, curve: {estimator: NI}, experiment: steps, t_label: t (s)}
"""
LEVELS = """\
figures:
  f: {kind: level_means, curves: [{estimator: NI}], x_label: level, y_label: output}
"""
BODE = """\
figures:
  f: {kind: bode, metric: found, frequencies: 2, estimators: [FGI], x_label: frequency}
"""


def planned(folder, rest):
    plugins.load()
    (folder / "configs").mkdir(exist_ok=True)
    paper = folder / "experiments" / "someone2001"
    paper.mkdir(parents=True, exist_ok=True)
    (paper / "published.csv").write_text("table,row,quantity,printed,note\nT,r,gain,0.97,\n")
    path = folder / "configs" / "some.yaml"
    path.write_text(CONFIG + rest)
    return load(path)


def results(folder, rest, values=None):
    """Results with the given trials by metric label, and 0.5, 0.6, 0.7, 0.8 for all others."""
    plan = planned(folder, rest)
    series = tuple(
        Series(unit, label, np.array((values or {}).get(label, [0.5, 0.6, 0.7, 0.8])))
        for unit in plan.units
        for label in unit.metric_labels
    )
    return Results(plan, series)


@pytest.fixture
def draw():
    """Draw the figure ``f`` and close it afterwards."""
    import matplotlib.pyplot as plt

    with style():
        yield lambda made: made.plan.experiment.figures["f"].draw(made, judge(made))
        plt.close("all")


def built(made):
    return made.plan.experiment.tables["t"].build(made, judge(made))


def misfit(folder, rest):
    with pytest.raises(ConfigError) as caught:
        check(planned(folder, rest))
    return str(caught.value)


AWAY = """\
  away:
    kind: response_error
    of: [gain_i_1..2, gain_o_1..2_1, phase_i_1..2, phase_o_1..2_1]
    estimators: [FGI]
"""


@pytest.mark.parametrize(
    ("rest", "message"),
    [
        (
            TABLE.replace("truth: truth", "truth: found"),
            "tables.t.truth: the metric 'found' depends on the estimates: the truth is one of kind",
        ),
        (
            TABLE.replace("metric: found", "metric: away"),
            "tables.t.metric: the metric 'away' is of the truth, or compares with it: the estimates are",
        ),
        (
            BODE.replace("metric: found", "metric: away"),
            "figures.f.metric: holds gains and phases, and is of kind response: the errors below are drawn "
            "from it; 'away' is of kind response_error",
        ),
    ],
)
def test_errors_do_not_stand_where_estimates_or_the_truth_belong(tmp_path, rest, message):
    assert message in misfit(tmp_path, AWAY + rest)


def test_a_table_puts_truth_print_and_estimate_side_by_side(tmp_path):
    values = {"truth gain_i_1": [0.9701] * 4, "found gain_i_1": [0.96, 0.97, 0.98, 0.99]}
    table = built(results(tmp_path, TABLE + PUBLISHED, values))
    assert table.header == ("quantity", "truth", "printed", "ours")
    assert table.rows[0] == ("|Gi|", "0.9701", "0.97 =", "0.9750 ± 0.0129")
    assert table.rows[1] == ("arg Gi", "0.6500", "", "0.6500 ± 0.1291")
    assert table.notes[0] == "Ours: mean ± standard deviation over the trials."


def test_a_table_without_printed_numbers_has_no_column_for_them(tmp_path):
    assert built(results(tmp_path, TABLE)).header == ("quantity", "truth", "ours")


def test_a_table_says_what_is_not_determined(tmp_path):
    nan = float("nan")
    values = {"found gain_i_1": [0.9, nan, nan, 0.9], "found phase_i_1": [nan] * 4}
    table = built(results(tmp_path, TABLE, values))
    assert [row[-1] for row in table.rows] == ["0.9000 ± 0.0000", "-"]
    assert table.notes[1:] == (
        "ours: gain_i_1 is not determined in 2 of 4 trials.",
        "ours: phase_i_1 is not determined in 4 of 4 trials.",
    )


def test_a_table_needs_what_its_estimators_are_scored_by(tmp_path):
    said = misfit(tmp_path, TABLE.replace("ours: FGI", "ours: NI"))
    assert "the metric 'found gain_i_1' does not score the estimator 'NI'" in said


def test_the_signals_are_those_of_the_experiment(tmp_path, draw):
    above, below = draw(results(tmp_path, SIGNALS)).axes
    levels = above.lines[0].get_ydata()
    assert levels.tolist() == [-1.0] * 80 + [0.0] * 80 + [1.0] * 80
    measured, free = (line.get_ydata() for line in below.lines)
    assert 0.005 < np.std(measured - free) < 0.02
    # f(-1), f(0), f(1) at the end of each level
    assert free[[79, 159, 239]] == pytest.approx([1.5, 2.0, 3.5], abs=1e-6)
    assert below.get_xlabel() == "t (s)"


def test_an_experiment_that_is_not_there_is_said(tmp_path):
    said = misfit(tmp_path, SIGNALS.replace("experiment: steps", "experiment: step"))
    assert "there is no experiment 'step' (there are: steps, sines 1, sines 2)" in said


def test_the_means_of_levels_stand_on_the_nonlinearity(tmp_path, draw):
    above, below = draw(results(tmp_path, LEVELS)).axes
    means = {line.get_label(): line for line in above.lines}
    assert means["NI"].get_xdata().tolist() == [-1.0, 0.0, 1.0]
    assert means["NI"].get_ydata() == pytest.approx([1.5, 2.0, 3.5], abs=0.01)
    assert means["true"].get_ydata()[[0, -1]] == pytest.approx([1.5, 3.5])
    assert np.abs(below.lines[0].get_ydata()).max() < 0.01


def test_level_means_need_a_staircase_estimator(tmp_path):
    said = misfit(tmp_path, LEVELS.replace("estimator: NI", "estimator: FGI"))
    assert "the estimator 'FGI' is not of kind nonlinearity_identification" in said


def test_a_bode_diagram_shows_truth_medians_and_errors(tmp_path, draw):
    made = results(tmp_path, BODE)
    figure = draw(made)
    assert len(figure.axes) == 8
    block = made.plan.units[0].data.system.truth().blocks["input"]
    gains, errors = figure.axes[0], figure.axes[2]
    lines = {line.get_label(): line for line in gains.lines}
    assert lines["FGI"].get_xdata() == pytest.approx([0.5, 1.0])
    assert lines["FGI"].get_ydata() == pytest.approx([0.65, 0.65])
    assert lines["true"].get_ydata()[-1] == pytest.approx(frequency.gain(block, np.array([1.0]))[0])
    true = frequency.gain(block, np.array([0.5, 1.0]))
    assert errors.lines[-1].get_ydata() == pytest.approx(100.0 * (0.65 / true - 1.0))
    band = errors.collections[0].get_paths()[0].get_extents()
    assert band.y1 == pytest.approx(np.max(100.0 * (0.785 / true - 1.0)))
    entries = [text.get_text() for text in figure.legends[0].get_texts()]
    assert entries == ["true", "FGI", "FGI, central 90 %"]
    phases = figure.axes[6].lines[-1].get_ydata()
    assert phases == pytest.approx(0.65 - frequency.phase(block, np.array([0.5, 1.0])))


def test_equal_marks_of_a_bode_diagram_are_all_seen(tmp_path, draw):
    more = BODE.replace("estimators: [FGI]", "estimators: [FGI, FGI]")
    marks = draw(results(tmp_path, more)).axes[0].lines[1:]
    first, second = ((mark.get_markersize(), mark.get_markerfacecolor()) for mark in marks)
    assert first[0] > second[0]
    assert first[1] == second[1] == "none"


def test_a_bode_diagram_leaves_out_what_most_trials_lack(tmp_path, draw):
    nan = float("nan")
    figure = draw(results(tmp_path, BODE, {"found gain_i_2": [nan, nan, nan, 0.9]}))
    assert figure.axes[0].lines[-1].get_xdata() == pytest.approx([0.5])


def test_a_bode_diagram_needs_the_responses(tmp_path):
    said = misfit(tmp_path, BODE.replace("estimators: [FGI]", "estimators: [NI]"))
    assert "the metric 'found phase_o_1_1' does not score the estimator 'NI'" in said


LOUD = """\
  input_linear: {kind: continuous, a: [0.5]}
  nonlinearity: {kind: exponential, rate: 1e4}
"""
QUIET = """\
  input_linear: {kind: continuous, a: [0.5]}
  nonlinearity: {kind: polynomial, coefficients: [2, 1, 0.5]}
"""


@pytest.mark.parametrize("rest", [SIGNALS, BODE, LEVELS])
def test_a_record_that_cannot_be_simulated_is_said_in_the_figure(tmp_path, draw, monkeypatch, rest):
    monkeypatch.setitem(globals(), "CONFIG", CONFIG.replace(QUIET, LOUD))
    figure = draw(results(tmp_path, rest))
    said = " ".join(text.get_text() for axes in figure.axes for text in axes.texts)
    assert rest == BODE or "failed: the nonlinearity is not finite in the range of its input" in said


def test_the_printed_number_of_a_table_is_no_standard_deviation(tmp_path):
    spread = PUBLISHED.replace("statistic: median", "statistic: std")
    assert built(results(tmp_path, TABLE + spread)).header == ("quantity", "truth", "ours")
