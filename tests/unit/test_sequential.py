"""Trials until a statistic is precise: the same number by any workers, stores and interruptions."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from hident import plugins
from hident.engine import trial
from hident.engine.clock import Limit, TookTooLong
from hident.engine.executors import make_executor
from hident.engine.runner import Silent, reached, run
from hident.engine.store import MemoryStore, Store
from hident.reports.output import Outputs
from tests.unit.plans import planned, refusals, replaced

if TYPE_CHECKING:
    from pathlib import Path

    from hident.engine.experiment import Plan
    from hident.engine.results import Results
    from hident.engine.trial import Data, Job
    from hident.records import Estimate, Record
    from tests.conftest import Lab

plugins.load()

TEXT = """
version: 1
title: The pole, to a percent or so
trials: {until: {relative_se: 0.005, of: [a a_1], least: 20, most: 2000}}
system: {kind: hammerstein, nonlinearity: mzyk2009, linear: {kind: ar, a: [0.8]}}
excitation: {kind: iid, distribution: uniform, low: -6, high: 6}
noise: {kind: white, distribution: uniform, half_width: 0.1}
cases: {samples: [200, 300]}
estimators:
  known: {kind: known_dynamics, a: [0.8]}
  iv: {kind: instrumental_variables, order: 1, instrument: abs}
metrics:
  a: {kind: value, of: [a_1]}
"""
RULE = "{until: {relative_se: 0.005, of: [a a_1], least: 20, most: 2000}}"


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    return planned(tmp_path, TEXT)


def _csv(results: Results) -> str:
    return results.trials_frame().to_csv()


def test_a_run_ends_at_the_first_decision_at_which_all_series_are_precise(plan: Plan) -> None:
    results = run(plan)
    fixed = run(plan.changed(trials=2000))

    def worst(trials: int) -> float:
        values = np.array([one.values[:trials] for one in fixed.series])
        return float(np.max(values.std(axis=1, ddof=1) / np.sqrt(trials) / np.abs(values.mean(axis=1))))

    expected = next(n for n in (20, 40, 80, 160, 320, 640, 1280) if worst(n) <= 0.005)
    assert expected > 80
    assert results.plan.trials == expected
    assert [len(one.values) for one in results.series] == [expected] * 4
    assert results.imprecise() == ()
    for one, other in zip(results.series, fixed.series, strict=True):
        np.testing.assert_array_equal(one.values, other.values[:expected])


def test_workers_stores_and_more_stored_trials_change_nothing(plan: Plan) -> None:
    expected = _csv(run(plan))
    store = MemoryStore()
    run(plan.changed(trials=700), store=store)
    assert _csv(run(plan, store=store)) == expected
    with make_executor(2) as pool:
        assert _csv(run(plan, executor=pool, workers=2)) == expected


class _Stops(Silent):
    """Presses Ctrl-C after so many trials of units."""

    def __init__(self, after: int) -> None:
        self._left = after

    def advance(self, trials: int) -> None:
        self._left -= trials
        if self._left <= 0:
            raise KeyboardInterrupt


@pytest.mark.parametrize("after", [10, 150, 700])
def test_an_interrupted_run_goes_on_to_the_same_number(plan: Plan, tmp_path: Path, after: int) -> None:
    expected = run(plan)
    store = Store(tmp_path / "s")
    with pytest.raises(KeyboardInterrupt), store.writing() as writer:
        run(plan, store=writer, progress=_Stops(after))
    with store.reading() as reader:
        now = reached(plan, reader)
        assert 20 <= now.trials <= expected.plan.trials
        assert now.trials in plan.decisions
    with store.writing() as writer:
        assert _csv(run(plan, store=writer)) == _csv(expected)
    with store.reading() as reader:
        assert reached(plan, reader).trials == expected.plan.trials


def test_a_run_ends_at_the_most_that_is_allowed_and_says_so(tmp_path: Path) -> None:
    results = run(planned(tmp_path, TEXT.replace("most: 2000", "most: 50")))
    assert results.plan.trials == 50
    assert {one.unit.name for one in results.imprecise()} == {"iv"}
    outputs = Outputs(results.plan, tmp_path / "out")
    outputs.write(results, {})
    page = " ".join((tmp_path / "out/table.md").read_text().split())
    assert "50 trials, seed 1." in page
    said = (
        "A sequential rule ended the run: the standard error of the mean of a a_1 was to be at most 0.5 % of "
        "it, for every estimator and case. It was asked after 20, 40, 50 trials, and with the most allowed "
        "not met by a a_1 of estimator 'iv' at samples 200; a a_1 of estimator 'iv' at samples 300."
    )
    assert said in page
    of_run = json.loads((tmp_path / "out/run.json").read_text())["experiment"]
    assert of_run["trials"] == 50
    assert of_run["sequential"] == {"looks": [20, 40, 50], "met": False}
    assert of_run["resolved"]["trials"]["until"]["most"] == 50


def test_what_never_succeeds_is_never_precise(tmp_path: Path) -> None:
    changed = {"mzyk2009": "{kind: expression, expression: '0*u'}", "most: 2000": "most: 45"}
    text = replaced(TEXT, changed).replace("noise: {kind: white, distribution: uniform, half_width: 0.1}", "")
    results = run(planned(tmp_path, text))
    assert results.plan.trials == 45
    assert [one.unit.name for one in results.imprecise()] == ["iv", "iv"]


@pytest.mark.parametrize(
    ("of", "statistic"), [("", "statistic: median"), ("of: all,", ""), ("of: [a a_1],", "statistic: std")]
)
def test_all_metrics_by_default_and_other_statistics(tmp_path: Path, of: str, statistic: str) -> None:
    rule = f"{{until: {{relative_se: 0.1, {of} least: 20, most: 2000, {statistic}}}}}"
    # What does not vary has no relative error of its std.
    text = TEXT.replace(RULE, rule).replace("  known: {kind: known_dynamics, a: [0.8]}\n", "")
    results = run(planned(tmp_path, text))
    rule_of = results.plan.rule
    assert rule_of is not None
    assert all(
        one.standard_error(rule_of.statistic) <= 0.1 * one.value(rule_of.statistic) for one in results.series
    )


def test_trials_on_the_command_line_take_the_place_of_the_rule(tmp_path: Path) -> None:
    plan = planned(tmp_path, TEXT, trials=7)
    assert (plan.trials, plan.rule, plan.decisions) == (7, None, (7,))
    plan = planned(tmp_path, TEXT)
    assert (plan.trials, plan.decisions) == (20, (20, 40, 80, 160, 320, 640, 1280, 2000))
    assert plan.at_most(5).decisions == (5,)
    assert plan.at_most(50).decisions == (20, 40, 50)
    assert plan.at_most(5000).decisions == plan.decisions
    assert plan.changed(trials=3).at_most(2).decisions == (2,)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[a a_1]", "[b]", "trials.until.of[0]: there is no metric 'b' (there are: a a_1)"),
        (
            "[a a_1]",
            "[]",
            "trials.until.of: must name a metric's label; leave it out for all of them (got [])",
        ),
        ("0.005", "0", "trials.until.relative_se: must be greater than 0 (got 0)"),
        ("least: 20", "least: 1", "trials.until.least: must be greater than or equal to 2 (got 1)"),
        ("most: 2000", "most: 19", "trials.until: 'most' must be at least 'least', 20, not 19"),
        (", most: 2000", "", "trials.until.most: is required: The trials at which a run ends in any case"),
        ("until:", "til:", "trials.til: unknown key; did you mean 'until'? (allowed: until)"),
        (RULE, "0", "trials: must be greater than or equal to 1 (got 0)"),
        (RULE, "few", "trials: must be a whole number >= 1 (got 'few')"),
    ],
)
def test_what_is_wrong_with_a_rule_is_said(tmp_path: Path, old: str, new: str, said: str) -> None:
    found = refusals(tmp_path, replaced(TEXT, {old: new}))
    assert f"a.yaml:4: {said}" in found


def test_trials_that_took_too_long_are_not_made_again_in_the_next_round(
    plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, limit = [], Limit.of(60.0)
    estimate = trial.estimate
    assert limit is not None

    def slow(data: Data, job: Job, record: Record, seed: int, number: int) -> Estimate:
        made.append((data.key, job.key, number))
        if number == 3:
            raise TookTooLong(limit)
        return estimate(data, job, record, seed, number)

    monkeypatch.setattr(trial, "estimate", slow)
    store = _Counts()
    results = run(plan, store=store)
    assert results.plan.trials > 40
    assert len(made) == len(set(made)) == 4 * results.plan.trials
    assert results.timed_out == 4
    assert store.added == 4 * (results.plan.trials - 1)
    assert all(np.isnan(one.values[3]) for one in results.series)


class _Counts(MemoryStore):
    """Counts what is computed."""

    def __init__(self) -> None:
        super().__init__()
        self.added = 0

    def add(self, units: Any, scores: Any) -> None:
        scores = list(scores)
        self.added += sum(len(one.trials) for key, one in scores if not key.startswith("seconds"))
        super().add(units, scores)


def test_no_trial_is_computed_twice(plan: Plan) -> None:
    store = _Counts()
    results = run(plan, store=store)
    assert store.added == 4 * results.plan.trials


def _configured(lab: Lab, **until: Any) -> None:
    rule = {"relative_se": 0.03, "of": ["a a_1"], "least": 10, "most": 800, **until}
    lab.configure(trials={"until": rule}, metrics={"a": {"kind": "value", "of": ["a_1"]}})


def test_run_status_accept_and_compare(lab: Lab) -> None:
    _configured(lab)
    assert lab.hident("status", "tiny.yaml").stdout.splitlines()[1].split(maxsplit=2) == [
        "tiny", "0", "40 or more  none",
    ]  # fmt: skip
    lab.run("-q")
    trials = json.loads((lab.folder / "out/tiny/run.json").read_text())["experiment"]["trials"]
    assert 10 < trials < 800
    state = ["tiny", str(4 * trials), str(4 * trials), "up to date"]
    assert lab.hident("status", "tiny.yaml").stdout.splitlines()[1].split(maxsplit=3) == state
    assert lab.hident("status", "--watch", "tiny.yaml").stdout.splitlines()[0] == (
        f"tiny: {4 * trials}/{4 * trials} trials, done"
    )
    assert "up to date" in lab.run()
    said = lab.hident("accept", "tiny", "-j1").stderr
    assert f"tiny, perturbation 1 of 2: {4 * trials} trials\n" in said
    lab.forget()
    lab.run("-q", "--jobs", "2")
    assert "1 configuration, no differences" in lab.hident("compare").stdout
    lab.run("-q", "--at-most", "5")
    assert f"5 trials, reference {trials}" in lab.hident("compare", code=1).stdout
    assert "no differences" in lab.hident("compare", "--partial").stdout
    rows = f"{4 * trials} rows of {4 * trials} trials"
    assert lab.hident("export", "tiny.yaml", "x.csv").stdout == f"x.csv: {rows}\n"


def test_another_rule_is_another_run(lab: Lab) -> None:
    _configured(lab)
    lab.run("-q")
    _configured(lab, relative_se=0.029)
    assert lab.hident("status", "tiny.yaml").stdout.splitlines()[1].endswith("old")
    assert "hident run tiny" in lab.hident("accept", "tiny", "-j1", code=2).stderr


def test_the_same_data_as_a_paper_s_are_counted(tmp_path: Path) -> None:
    text = TEXT + "published: {paper_trials: 20, same_data: true, cells: []}\npaper: none\n"
    assert any("needs a number of trials, not a rule" in line for line in refusals(tmp_path, text))
