"""What went wrong in a trial: which metric of which estimate, why, and how often; nothing else is lost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from hident import plugins
from hident.config.spec import component
from hident.engine.experiment import load
from hident.engine.results import Results, grouped
from hident.engine.runner import CrashReport, run, stored
from hident.engine.store import Store
from hident.engine.trial import Job
from hident.errors import EstimationError
from hident.estimators.base import EstimatorSpec
from hident.metrics.base import MetricSpec
from hident.metrics.values import Value
from hident.records import Estimate, Record
from hident.reports.output import markdown
from tests.unit.tried import Tried, tried

if TYPE_CHECKING:
    from tests.conftest import Lab

plugins.load()


class Unspeakable(Exception):
    """An error whose message cannot be made."""

    def __str__(self) -> str:
        raise RuntimeError("no words")


_ERRORS: dict[str, Any] = {
    "division": lambda: 1 / 0,
    "overflow": lambda: _raise(OverflowError("too large")),
    "floating": lambda: _raise(FloatingPointError("underflow")),
    "estimation": lambda: _raise(EstimationError("stopped at t = 3.5")),
    "unspeakable": lambda: _raise(Unspeakable()),
    "generator": lambda: _raise(GeneratorExit()),
    "surrogate": lambda: _raise(ValueError("\udc80")),
}


def _raise(error: BaseException) -> None:
    raise error


@component("estimator", "erring")
class Erring(EstimatorSpec):
    """Raises what it is told to."""

    raises: str = ""

    def names(self) -> list[str]:
        return ["a_1"]

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        if self.raises:
            _ERRORS[self.raises]()
        return Estimate(values={"a_1": float(record.y[0])})


@component("metric", "erring")
class ErringMetric(MetricSpec):
    """Raises what it is told to."""

    raises: str

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        if self.raises == "nan":
            return [float("nan")]
        _ERRORS[self.raises]()
        return [1.0]


def _outcome(lab: Lab, job: Job) -> Tried:
    data = load(lab.folder / "tiny.yaml").units[0].data
    (outcome,) = tried(data, [job], {0: [0]}, seed=7)
    return outcome


_A = Value(of=("a_1",))


@pytest.mark.parametrize(
    ("raises", "why"),
    [
        ("division", "ZeroDivisionError: division by zero"),
        ("overflow", "OverflowError: too large"),
        ("floating", "FloatingPointError: underflow"),
        ("estimation", "stopped at t = 3.5"),
    ],
)
def test_an_arithmetic_error_is_a_failed_trial_with_its_reason(lab: Lab, raises: str, why: str) -> None:
    of_estimate = _outcome(lab, Job(Erring(raises=raises), (_A, _A)))
    assert [(s.failure, s.crash) for s in of_estimate.scores] == [(why, ""), (why, "")]
    assert np.isnan(of_estimate.values).all()
    of_metric = _outcome(lab, Job(Erring(), (ErringMetric(raises=raises), _A)))
    assert [(s.failure, s.crash) for s in of_metric.scores] == [(f"metric: {why}", ""), ("", "")]
    assert np.isnan(of_metric.values).tolist() == [True, False]


@pytest.mark.parametrize(
    ("raises", "said"),
    [
        ("unspeakable", "Unspeakable: (its message cannot be shown)"),
        ("generator", "GeneratorExit: "),
        ("surrogate", "ValueError: \\udc80"),
    ],
)
def test_whatever_a_component_raises_is_told(lab: Lab, raises: str, said: str) -> None:
    for job in (Job(Erring(raises=raises), (_A,)), Job(Erring(), (ErringMetric(raises=raises),))):
        (score,) = _outcome(lab, job).scores
        assert score.failure == said
        assert score.crash.encode().startswith(b"Traceback")


def test_reasons_that_differ_in_their_numbers_are_of_one_kind() -> None:
    texts = [f"the loss {i * 0.37:.3g} is above {-i}e-3 at a_1 of 5" for i in range(1000)]
    assert grouped([*texts, "a_2", "singular", "singular", "a_1"]) == (
        ("the loss ... is above ... at a_1 of 5", 1000),
        ("singular", 2),
        ("a_2", 1),
        ("a_1", 1),
    )
    assert grouped(["stopped at t = 3", "stopped at t = nan"]) == (("stopped at t = ...", 2),)
    assert grouped(["as it is: 3"] * 4) == (("as it is: 3", 4),)


def _run(lab: Lab, **changes: Any) -> Results:
    lab.configure(**changes)
    plan = load(lab.folder / "tiny.yaml")
    with Store(lab.folder / "s").writing() as writer:
        return run(plan, store=writer)


def test_a_metric_that_fails_takes_no_other_metric_along(lab: Lab) -> None:
    estimators: dict[str, Any] = {"e": {"kind": "erring"}, "f": {"kind": "erring", "raises": "estimation"}}
    metrics: dict[str, Any] = {
        "a": {"kind": "value", "of": ["a_1"]},
        "b": {"kind": "erring", "raises": "division"},
        "c": {"kind": "erring", "raises": "nan"},
    }
    results = _run(lab, estimators=estimators, metrics=metrics, tables={}, cases={"samples": [50]})
    failed = [(s.unit.name, s.metric, s.statistics["failed"], s.reasons) for s in results.series]
    stopped = (("stopped at t = 3.5", 6),)
    assert failed == [
        ("e", "a a_1", 0, ()),
        ("e", "b", 6, (("b: ZeroDivisionError: division by zero", 6),)),
        ("e", "c", 6, (("c: the value is nan", 6),)),
        *(("f", label, 6, stopped) for label in ("a a_1", "b", "c")),
    ]
    notes = [line for line in markdown(results, (), {}).splitlines() if "failed" in line and "|" not in line]
    assert notes == [
        f"6 of 6 trials of estimator '{name}' at samples 50 failed{why} statistics."
        for name, why in (
            ("e", " for b (ZeroDivisionError: division by zero) and are left out of its"),
            ("e", " for c (the value is nan) and are left out of its"),
            ("f", " (stopped at t = 3.5) and are left out of the"),
        )
    ]


def test_a_metric_that_crashes_leaves_the_others_stored(lab: Lab) -> None:
    estimators: dict[str, Any] = {"e": {"kind": "erring"}}
    sound = {"a": {"kind": "value", "of": ["a_1"]}}
    crashing: dict[str, Any] = {**sound, "b": {"kind": "erring", "raises": "unspeakable"}}
    with pytest.raises(CrashReport, match="of estimator 'e' at samples 50 crashed: Unspeakable"):
        _run(lab, estimators=estimators, metrics=crashing, tables={}, trials=1)
    lab.configure(metrics=sound)
    assert stored(load(lab.folder / "tiny.yaml"), Store(lab.folder / "s")) == [1, 0]


def test_a_truth_that_is_no_number_is_named_with_its_place(lab: Lab) -> None:
    results = _run(
        lab,
        trials=5,
        system={
            "kind": "hammerstein",
            "nonlinearity": {"kind": "expression", "expression": "log(u + 1)"},
            "linear": {"kind": "ar", "a": [0.5]},
        },
        excitation={"kind": "iid", "distribution": "uniform", "low": -0.9, "high": 3},
        noise=[],
        cases={},
        samples=80,
        estimators={"k": {"kind": "kernel", "kernel": "gaussian", "bandwidth": {"h0": 0.5, "alpha": 0.2}}},
        metrics={"mise": {"kind": "mise", "interval": [-3, 3]}},
        tables={},
    )
    assert (
        "5 of 5 trials of estimator 'k' failed for mise (the true nonlinearity is nan at u = -2.99"
        in markdown(results, (), {})
    )


def test_a_division_by_zero_in_an_estimator_of_the_library_is_a_failed_trial(lab: Lab) -> None:
    results = _run(
        lab,
        trials=3,
        cases={},
        samples=90,
        system={
            "kind": "hammerstein",
            "nonlinearity": "identity",
            "linear": {"kind": "fir", "b": [0, 0.7, 0.4], "initial": "zero"},
        },
        excitation={"kind": "sine", "period": 2, "phase": "pi/2"},
        noise=[],
        estimators={
            "iv": {"kind": "instrumental_variables", "order": 1, "instrument": "identity", "ma_order": 1}
        },
        metrics={"a": {"kind": "value", "of": ["a_1"]}},
        tables={},
    )
    (series,) = results.series
    assert series.statistics["failed"] == 3
    ((why, count),) = series.reasons
    assert count == 3
    assert why
