"""One trial again: the same record and the same estimate as in the run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import hident as hi
from hident import plugins
from hident.engine.estimate_curves import parameters
from hident.engine.experiment import load
from hident.engine.replay import OneTrial
from hident.engine.runner import run
from hident.errors import ConfigError

if TYPE_CHECKING:
    from hident.engine.experiment import Plan
    from tests.conftest import Lab

plugins.load()


def _plan(lab: Lab, **changes: Any) -> Plan:
    lab.configure(metrics={"a": {"kind": "value", "of": ["a_1"]}}, **changes)
    return load(lab.folder / "tiny.yaml")


@pytest.mark.parametrize("perturbation", [0, 1])
def test_the_estimate_is_that_of_the_run(lab: Lab, perturbation: int) -> None:
    plan = _plan(lab).changed(perturbation=perturbation)
    results = run(plan)
    for trial in (0, 5):
        again = OneTrial(plan, trial)
        for series in results.series:
            realised = again.of(series.unit.name, series.unit.labels)
            assert realised.found is not None
            assert realised.found.values["a_1"] == series.values[trial]


def test_records_and_estimates_are_made_once(lab: Lab) -> None:
    trial = OneTrial(_plan(lab), 2)
    one, other = (trial.of(name, {"samples": 80}) for name in ("iv", "known"))
    assert one is trial.of("iv", {"samples": "80"})
    assert one.record is not None
    assert one.record is other.record
    assert len(one.record.y) == 80
    assert trial.of("iv", {}).unit.labels == {"samples": 50}


def test_a_failed_trial_fails_again_with_its_reason(lab: Lab) -> None:
    silent = {**lab.config["system"], "nonlinearity": {"kind": "expression", "expression": "0*u"}}
    plan = _plan(lab, system=silent, noise=[])
    realised = OneTrial(plan, 1).of("iv", {})
    assert realised.found is None
    assert realised.record is not None
    assert not np.any(realised.record.y)
    ((why, count),) = next(run(plan).select("iv")).reasons
    assert (why, count) == (realised.failure, 6)


@pytest.mark.parametrize(
    ("estimator", "labels", "message"),
    [
        ("ive", {}, "there is no estimate of 'ive' at any case; did you mean 'iv'?"),
        ("iv", {"samples": 60}, "there is no estimate of 'iv' at samples 60"),
    ],
)
def test_what_is_not_there_is_named(lab: Lab, estimator: str, labels: dict[str, int], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        OneTrial(_plan(lab), 0).of(estimator, labels)
    assert str(caught.value) == message


def test_scores_are_those_of_the_run_where_the_truth_is_brought_to_another_form() -> None:
    plan = hi.validate(
        {
            "version": 1,
            "title": "The gain in the other block",
            "trials": 3,
            "samples": 300,
            "system": {
                "kind": "hammerstein",
                "nonlinearity": {"kind": "polynomial", "coefficients": [0, 1, 0.5]},
                "linear": {"kind": "fir", "b": [2, 1]},
            },
            "excitation": {"kind": "iid", "distribution": "uniform", "low": -2, "high": 2},
            "noise": {"kind": "white", "std": 0.01},
            "estimators": {"FIR": {"kind": "two_stage", "lags": 3, "degree": 2, "delay": 0}},
            "metrics": {
                "form": {"kind": "nonlinearity_percent_error", "interval": [-2, 2]},
                "units": {"kind": "nonlinearity_percent_error", "interval": [-2, 2], "up_to": ["gain"]},
                "values": {"kind": "error", "of": ["b_0", "a_1"]},
            },
        }
    )
    results = run(plan)
    (unit,) = plan.units
    found = OneTrial(plan, 2).scores(unit)
    stored = {series.metric: float(series.values[2]) for series in results.series}
    assert {label: value for label, (value, _) in found.items()} == stored
    assert max(map(abs, stored.values())) < 1.0
    # What is shown beside the estimate is the truth in its form.
    for _, value, true in parameters(OneTrial(plan, 2).of_unit(unit)):
        assert np.isnan(true) or value == pytest.approx(true, abs=0.02)
