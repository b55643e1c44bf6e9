"""The figure of residuals: what it shows, read back from the axes."""

import numpy as np
import pytest

from hident.engine.replay import OneTrial
from hident.engine.runner import run
from hident.errors import ConfigError
from hident.metrics.residuals import judged
from hident.records import needed
from hident.reports.one_trial.residuals import ResidualFigure
from hident.reports.output import check
from hident.reports.style import style
from tests.unit.plans import planned, replaced

CONFIG = """\
version: 1
title: A lag behind a saturation
trials: 1
dt: 0.1
samples: 1001
system: {kind: hammerstein, nonlinearity: SYSTEM, linear: {kind: continuous, a: [1], b: [1]}}
excitation: {kind: multistep, switching_time: 0.5, std: 1, limits: [-3, 3]}
noise: {kind: white, nsr: 0.05}
estimators:
  lag: {kind: linear_model, block: {n: 1, m: 0, horizon: 10}}
metrics:
  m: {kind: rmse}
figures:
  f: {kind: residuals, curve: {estimator: lag}, t_label: t (min), y_label: residual (K)SETTINGS}
"""
SATURATION = "{kind: saturation, low: -1, high: 1}"


def shown(plan):
    figure = plan.experiment.figures["f"]
    assert isinstance(figure, ResidualFigure)
    return figure


def drawn(folder, system="identity", settings=""):
    plan = planned(folder, replaced(CONFIG, {"SYSTEM": system, "SETTINGS": settings}))
    check(plan)
    with style():
        return plan, shown(plan).draw(run(plan), [])


def refused(folder, settings):
    plan = planned(folder, replaced(CONFIG, {"SYSTEM": "identity", "SETTINGS": settings}))
    with pytest.raises(ConfigError) as caught:
        check(plan)
    return str(caught.value)


def of_trial(plan, n_init=0):
    realised = OneTrial(plan, 0).of("lag", {})
    estimate = needed(realised.found)
    held = shown(plan).compared(estimate, needed(realised.record))
    assert len(held.y) == 1001 - n_init
    return judged(held, estimate, "simulation")


def test_shows_the_residuals_and_their_correlations(tmp_path):
    plan, figure = drawn(tmp_path, settings=", n_init: 20")
    found = of_trial(plan, 20)
    in_time, auto, cross, quantiles = figure.axes
    t, e = in_time.lines[0].get_data()
    np.testing.assert_array_equal(e, found.e)
    assert (t[0], t[-1]) == (pytest.approx(2.0), pytest.approx(100.0))
    assert (in_time.get_xlabel(), in_time.get_ylabel()) == ("t (min)", "residual (K)")
    np.testing.assert_array_equal(auto.lines[0].get_ydata(), found.whiteness.values)
    upper = auto.lines[2]
    np.testing.assert_array_equal(upper.get_ydata(), found.whiteness.band)
    np.testing.assert_array_equal(cross.lines[0].get_ydata(), found.input.values)
    assert len(quantiles.lines[1].get_ydata()) == len(found.innovations.white(found.e))
    assert figure.get_suptitle() == (
        "lag, on the record that was fitted, by simulation, without the first 20 samples of each experiment"
    )


def test_names_the_nonlinear_function_that_stands_out_most(tmp_path):
    plan, figure = drawn(tmp_path, SATURATION)
    found = of_trial(plan).nonlinear_input
    most = max(found, key=lambda name: found[name].test.statistic)
    labels = [text.get_text() for text in figure.axes[2].get_legend().get_texts()]
    assert labels[1] == f"{most}, p < 0.001"


def test_the_marks_of_two_signals_are_told_apart_without_colour(tmp_path):
    _, figure = drawn(tmp_path)
    first, second = (figure.axes[2].lines[i] for i in (0, 3))
    assert first.get_marker() != second.get_marker()
    assert first.get_markerfacecolor() != second.get_markerfacecolor()


def test_a_line_stands_where_a_new_experiment_begins(tmp_path):
    several = replaced(
        CONFIG,
        {
            "excitation: {kind: multistep, switching_time: 0.5, std: 1, limits: [-3, 3]}": (
                "excitation:\n  kind: experiments\n  parts:\n"
                "    - {name: a, samples: 600, excitation: &x {kind: multistep, switching_time: 0.5, std: 1, "
                "limits: [-3, 3]}}\n    - {name: b, samples: 401, excitation: *x}"
            ),
            "SYSTEM": "identity",
            "SETTINGS": "",
        },
    )
    plan = planned(tmp_path, several)
    with style():
        figure = shown(plan).draw(run(plan), [])
    assert figure.axes[0].get_title() == "residuals (dotted: a new experiment)"
    assert figure.axes[0].lines[1].get_xdata()[0] == pytest.approx(59.95)


def test_what_cannot_be_judged_is_said_in_the_panel(tmp_path):
    _, figure = drawn(tmp_path, settings=", n_init: 980")
    (said,) = figure.axes[0].texts
    assert said.get_text().startswith("lag failed: 21 residuals, at most 21 in one experiment, are too few")


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (", on: validation", "this record has none, as no simulated one has"),
        (", n_init: 1001", "leaves the first 1001 samples of each experiment out, and none has more"),
        (", by: prediction", "the estimator 'lag' does not give a model"),
    ],
)
def test_what_cannot_be_shown_is_refused_before_the_run(tmp_path, settings, said):
    assert said in refused(tmp_path, settings)
