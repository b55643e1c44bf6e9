"""The curves of an estimate beside those of the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

import hident as hi
from hident import plugins
from hident.engine.estimate_curves import POINTS, Curve, curves, parameters
from hident.engine.replay import OneTrial, Realised
from tests.unit.plans import planned

if TYPE_CHECKING:
    from pathlib import Path

plugins.load()

DISCRETE = """
version: 1
title: A pole and a dead zone
trials: 2
samples: 400
system: {kind: hammerstein, nonlinearity: {kind: dead_zone, low: -1, high: 1}, linear: {kind: ar, a: [0.8]}}
excitation: {kind: iid, distribution: uniform, low: -3, high: 2}
estimators:
  found:
    {kind: kernel, kernel: gaussian, bandwidth: {h0: 1, alpha: 1/5},
     prefilter: {kind: known_dynamics, a: [0.8]}}
metrics: {c: {kind: nonlinearity_value, at: [0.5]}}
"""
CONTINUOUS = """
version: 1
title: A process
trials: 1
dt: 0.1
samples: 401
system: {kind: hammerstein, nonlinearity: identity, linear: {kind: continuous, a: [2.5, 1.5], delay: 1}}
excitation: {kind: multistep, switching_time: 1, std: 1.25, limits: [-2.5, 2.5]}
estimators:
  found: {kind: linear_model, block: {n: 2, m: 0, horizon: 15}, delay: 1, start: 2}
metrics: {a: {kind: value, of: [a_1]}}
"""
WIENER = """
version: 1
title: A pole and a parabola
trials: 1
samples: 400
system:
  {kind: wiener, linear: {kind: ar, a: [0.8]}, nonlinearity: {kind: polynomial, coefficients: [0, 1, 0.1]}}
excitation: {kind: iid, distribution: uniform, low: -3, high: 2}
estimators:
  found: {kind: prediction_error, blocks: [{kind: linear, nb: 1, nf: 1}, {kind: polynomial, degree: 2}]}
metrics: {error: rmse}
"""


def _realised(folder: Path, text: str) -> Realised:
    plan = planned(folder, text)
    return OneTrial(plan, 0).of_unit(plan.units[0])


def _curves(realised: Realised) -> dict[str, Curve]:
    return {one.part: one for one in curves(realised)}


def test_of_a_discrete_block_and_a_nonlinearity(tmp_path: Path) -> None:
    realised = _realised(tmp_path, DISCRETE)
    found = _curves(realised)
    assert list(found) == ["nonlinearity", "step_response", "gain", "phase"]
    assert realised.record is not None
    assert realised.found is not None
    assert realised.found.nonlinearity is not None
    f = found["nonlinearity"]
    assert (f.x[0], f.x[-1], len(f.x)) == (realised.record.u.min(), realised.record.u.max(), POINTS)
    np.testing.assert_array_equal(f.values, realised.found.nonlinearity(f.x))
    np.testing.assert_array_equal(f.true, hi.DeadZone(low=-1, high=1)(f.x))
    step = found["step_response"]
    k = np.arange(len(step.x))
    np.testing.assert_array_equal(step.x, k)
    np.testing.assert_allclose(step.values, 5.0 * (1.0 - 0.8 ** (k + 1)), rtol=1e-12)
    np.testing.assert_array_equal(step.values, step.true)
    # It is shown until it has settled.
    assert abs(step.values[-1] - 5.0) <= 0.001 * 5.0
    response = 1.0 / (1.0 - 0.8 * np.exp(-1j * found["gain"].x))
    np.testing.assert_allclose(found["gain"].values, np.abs(response), rtol=1e-12)
    np.testing.assert_allclose(found["phase"].values, np.angle(response), rtol=1e-12)
    assert found["gain"].x[-1] == np.pi


def test_where_a_metric_scores_a_nonlinearity_it_is_shown(tmp_path: Path) -> None:
    scored = DISCRETE.replace("kind: nonlinearity_value, at: [0.5]", "kind: mise, interval: [-2, 1.5]")
    f = _curves(_realised(tmp_path, scored))["nonlinearity"]
    assert (f.x[0], f.x[-1]) == (-2.0, 1.5)


def test_of_a_continuous_block(tmp_path: Path) -> None:
    realised = _realised(tmp_path, CONTINUOUS)
    found = _curves(realised)
    block = hi.ContinuousTransferFunction(b=(1.0,), a=(2.5, 1.5), delay=1.0)
    step, gain = found["step_response"], found["gain"]
    # (1 + s)(1 + 1.5 s), a delay of 1.
    t = np.maximum(step.x - 1.0, 0.0)
    np.testing.assert_allclose(step.true, 1.0 + 2.0 * np.exp(-t) - 3.0 * np.exp(-t / 1.5), atol=1e-9)
    np.testing.assert_array_equal(gain.true, np.abs(block.frequency_response(gain.x)))
    np.testing.assert_allclose(step.values, step.true, atol=0.02)
    np.testing.assert_allclose(found["phase"].values[:100], found["phase"].true[:100], atol=0.02)


def test_a_wiener_nonlinearity_is_shown_where_its_input_was(tmp_path: Path) -> None:
    realised = _realised(tmp_path, WIENER)
    assert realised.found is not None
    model = realised.found.model
    assert isinstance(model, hi.FittedModel)
    f = _curves(realised)["nonlinearity"]
    assert (f.x[0], f.x[-1]) == model.range_of(1)


def test_parameters_stand_beside_the_truth_where_it_is_known(tmp_path: Path) -> None:
    realised = _realised(tmp_path, DISCRETE)
    found = {name: (value, true) for name, value, true in parameters(realised)}
    assert found["a_1"] == (0.8, 0.8)
    assert realised.found is not None
    assert list(found) == list(realised.found.values)


@pytest.mark.parametrize("a", ["[1.5]", "[-1.01]"])
def test_an_unstable_block_has_curves_too(tmp_path: Path, a: str) -> None:
    text = DISCRETE.replace("{kind: known_dynamics, a: [0.8]}", f"{{kind: known_dynamics, a: {a}}}")
    found = _curves(_realised(tmp_path, text))
    assert len(found["step_response"].x) < 1000
    assert np.isfinite(found["gain"].values).all()


SEARCHED = """
version: 1
title: A small coefficient before the larger one
trials: 1
samples: 1000
system: {kind: hammerstein, nonlinearity: identity, linear: {kind: arma, a: [0.5], b: [0, 0.1, 1]}}
excitation: {kind: iid, distribution: uniform, low: -1, high: 1}
estimators:
  found:
    {kind: kernel, kernel: gaussian, bandwidth: {h0: 0.3, alpha: 1/5},
     prefilter: {kind: known_dynamics, a: [0.5]}, delay: search}
metrics: {m: {kind: mise, interval: [-0.9, 0.9]}}
"""


def test_the_truth_is_shown_at_the_delay_that_was_found(tmp_path: Path) -> None:
    realised = _realised(tmp_path, SEARCHED)
    curve = _curves(realised)["nonlinearity"]
    np.testing.assert_allclose(curve.true, curve.x, rtol=1e-12)
    assert realised.truth.nonlinearity is not None
    np.testing.assert_allclose(realised.truth.nonlinearity(curve.x), curve.x, rtol=1e-12)


def test_a_value_of_the_name_of_another_quantity_has_no_truth_beside_it(tmp_path: Path) -> None:
    """a_1 is the system's feedback, and the method's coefficient of u."""
    text = DISCRETE.replace(
        DISCRETE[DISCRETE.index("    {kind: kernel") : DISCRETE.index("metrics:")], "    ESTIMATOR\n"
    )
    text = text.replace("ESTIMATOR", "{kind: two_stage, lags: 3, degree: 2, delay: 0}")
    beside = {name: true for name, _, true in parameters(_realised(tmp_path, text))}
    assert np.isfinite(beside["b_0"])
    assert np.isnan(beside["a_1"])
