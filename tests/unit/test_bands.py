"""Curves of estimates over trials: the metrics that hold them, and the figure of their bands."""

from __future__ import annotations

import numpy as np
import pytest

import hident as hi
from hident.block_chain import BlockChain
from hident.engine.runner import run
from hident.errors import ConfigError, EstimationError
from hident.linear_blocks import TransferFunction
from hident.reports.output import check
from hident.reports.style import style
from hident.static_functions import Chebyshev, StaticFunction
from tests.unit.plans import planned, replaced

CONFIG = """\
version: 1
title: A tank
record: {file: tank.csv, input: u, output: y, dt: 2, bootstrap: {kind: block, length: 10}}
trials: 21
estimators:
  square:
    kind: prediction_error
    n_init: 20
    blocks: [{kind: polynomial, degree: 2}, {kind: linear, nb: 1, nf: 1, nk: 1}]
metrics:
  f: {kind: static_function, interval: [-1, 1], points: 5}
  g: {kind: frequency_response, band: [0.01, 1], points: 4}
  y: {kind: model_output, samples: [31, 40], n_init: 20}
  fit: {kind: fit_index, n_init: 20}
figures:
  bands:
    kind: bands
    panels:
      - {metric: f, estimators: [square], x_label: u, y_label: f(u)}
      - {metric: g, curve: gain, estimators: [square], x_label: frequency, y_label: gain (dB)}
      - {metric: y, estimators: [square], x_label: time (s), y_label: y}
"""


@pytest.fixture
def folder(tmp_path):
    draws = np.random.default_rng(0)
    u = draws.uniform(-1.0, 1.0, 300)
    y = TransferFunction((0.0, 0.5), (0.5,)).filter(u + 0.5 * u**2) + 0.05 * draws.standard_normal(300)
    rows = "\n".join(f"{a!r},{b!r}" for a, b in zip(u.tolist(), y.tolist(), strict=True))
    (tmp_path / "tank.csv").write_text(f"u,y\n{rows}\n")
    return tmp_path


def test_a_band_holds_the_bootstraps_and_its_line_is_the_record(folder):
    results = run(planned(folder, CONFIG))
    figure = results.plan.experiment.figures["bands"]
    with style():
        drawn = figure.draw(results, [])  # type: ignore[attr-defined]
    function, gain, output = (axes for axes in drawn.axes if axes.lines)
    values = np.array(
        [series.values for series in results.select("square", None) if series.metric[:2] == "f "]
    )
    assert values.shape == (5, 21)
    np.testing.assert_allclose(function.lines[-1].get_ydata(), values[:, 0])
    low = np.quantile(values[:, 1:], 0.05, axis=1)
    np.testing.assert_allclose(function.lines[0].get_ydata(), low)
    # The truth, whose linear block has the static gain 1.
    x = np.linspace(-1.0, 1.0, 5)
    assert np.max(np.abs(values[:, 0] - (x + 0.5 * x**2))) < 0.1
    assert np.all(values.std(axis=1) > 0.0)
    assert gain.get_xscale() == "log"
    np.testing.assert_allclose(gain.lines[-1].get_xdata(), np.geomspace(0.01, 1.0, 4))
    # Samples count from 1 behind those that are left out, and every one takes 2 s.
    np.testing.assert_allclose(output.lines[-1].get_xdata(), 2.0 * np.arange(50, 60))
    measured = np.loadtxt(folder / "tank.csv", delimiter=",", skiprows=1)[50:60, 1]
    np.testing.assert_allclose(output.lines[0].get_ydata(), measured)
    assert figure.says(results) == "bands: central 90 % of 20 bootstraps, at each point"  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"{metric: f,": "{metric: h,"}, "there is no metric 'h' (there are: f, g, y)"),
        (
            {"{metric: f,": "{metric: fit,"},
            "the metric 'fit' gives no curve (those that do: f, g, y)",
        ),
        ({"curve: gain, ": ""}, "must say which curve: gain or phase"),
        (
            {"curve: gain": "curve: gian"},
            "there is no curve 'gian'; did you mean 'gain'? (there are: gain, phase)",
        ),
        ({"samples: [31, 40]": "samples: [0, 40]"}, "'samples' must count from 1 upwards, not from 0 to 40"),
        ({"band: [0.01, 1]": "band: [0, 1]"}, "'band' must begin above zero, not at 0"),
    ],
)
def test_what_cannot_be_shown_is_refused(folder, words, message):
    with pytest.raises(ConfigError) as error:
        check(planned(folder, replaced(CONFIG, words)))
    assert message in str(error.value)


def test_blocks_go_by_their_names_in_the_chain():
    square = StaticFunction(Chebyshev(2, -1.0, 1.0), (0.5, 0.0, 0.5))
    chain = BlockChain((TransferFunction((2.0,)), square, TransferFunction((0.0, 10.0))), dt=1.0)
    estimate = hi.Estimate(model=hi.FittedModel(chain))
    record = hi.Record(np.zeros(1), np.zeros(1), 1.0)
    value = hi.StaticFunctionValues(block="N", interval=[0, 1], points=2)
    gain = hi.FrequencyResponse(block="L2", band=[0.1, 1], points=2)
    assert hi.score(estimate, record, f=value) == pytest.approx({"f 1": 0.0, "f 2": 1.0})
    found = hi.score(estimate, record, g=gain)
    assert found["g gain 1"] == pytest.approx(20.0)
    assert found["g phase 2"] == pytest.approx(-np.degrees(1.0))
    with pytest.raises(EstimationError, match=r"there is no block 'N2'; did you mean 'N'\? \(there are: N\)"):
        hi.StaticFunctionValues(block="N2", interval=[0, 1]).evaluate(estimate, record)
    with pytest.raises(EstimationError, match="is no chain of blocks that have names: leave 'block' out"):
        gain.evaluate(hi.Estimate(linear=TransferFunction((1.0,))), record)


def test_a_response_at_more_samples_than_there_are_is_a_failed_trial():
    estimate = hi.Estimate(response=lambda u, dt: u)
    with pytest.raises(EstimationError, match="there are 2 samples, and 'samples' ends with 3"):
        hi.ModelOutput(samples=[1, 3]).evaluate(estimate, hi.Record(np.ones(2), np.ones(2)))
