"""A run seen from another terminal, by counts and a clock that the test gives."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from rich.console import Console

from hident import plugins
from hident.commands.watching import View
from hident.engine.experiment import load
from hident.engine.runner import run
from hident.engine.scores import Scores
from hident.engine.store import Store

if TYPE_CHECKING:
    from hident.engine.experiment import Plan
    from tests.conftest import Lab

plugins.load()


class Clock:
    """A clock that stands until it is turned."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def plan(lab: Lab) -> Plan:
    lab.configure(trials=10)
    return load(lab.folder / "tiny.yaml")


def _store(lab: Lab, plan: Plan, samples: int, trials: range, failure: str = "") -> None:
    values = np.full((len(trials), 1), np.nan if failure else 0.5)
    scores = Scores(np.array(trials), values, dict.fromkeys(trials, failure) if failure else {})
    with Store(lab.folder / "s").writing() as writer:
        for unit, keys in zip(plan.units, plan.keys, strict=True):
            if unit.data.samples == samples:
                writer.add({}, [(keys["a"], scores)])


def test_each_case_has_its_progress_rate_failures_and_expected_end(lab: Lab, plan: Plan) -> None:
    clock = Clock()
    view = View([plan], Store(lab.folder / "s"), clock)
    view.look()
    of_all, first, second = view.rows
    assert [row.said for row in view.rows] == [
        "tiny: 0/40 trials",
        "tiny, samples 50: 0/20 trials",
        "tiny, samples 80: 0/20 trials",
    ]
    _store(lab, plan, 50, range(4))
    clock.now = 2.0
    view.look()
    assert of_all.said == "tiny: 8/40 trials, 4 trials/s, 8 s left"
    assert first.said == "tiny, samples 50: 8/20 trials, 4 trials/s, 3 s left"
    assert second.said == "tiny, samples 80: 0/20 trials"
    _store(lab, plan, 50, range(4, 10), "diverged")
    clock.now = 4.0
    view.look()
    assert first.cells == ("tiny", "samples 50", "20", "20", "12", "5 trials/s", "done")
    assert first.said == "tiny, samples 50: 20/20 trials, 12 failed, 5 trials/s, done"
    assert not view.complete
    # The rate is that of the last half minute, or of the last ten trials.
    clock.now = 80.0
    view.look()
    assert (of_all.rate, of_all.left) == ("9 trials/min", "2 min")
    _store(lab, plan, 80, range(1))
    clock.now = 100.0
    view.look()
    assert (first.rate, first.left, second.rate) == ("", "done", "1 trial/min")
    _store(lab, plan, 80, range(10))
    view.look()
    assert view.complete


def test_counts_are_those_of_the_trials_that_are_wanted(lab: Lab, plan: Plan) -> None:
    _store(lab, plan, 50, range(10), "diverged")
    keys = [keys["a"] for keys in plan.keys]
    with Store(lab.folder / "s").reading() as reader:
        found = [reader.counted(key, 7) for key in keys]
    assert sorted((one.trials, one.failed) for one in found) == [(0, 0), (0, 0), (7, 7), (7, 7)]


def test_a_trial_that_lacks_a_metric_is_not_there(lab: Lab) -> None:
    one = {"kind": "value", "of": ["a_1"]}
    lab.configure(metrics={"a": one}, tables={}, trials=4)
    with Store(lab.folder / "s").writing() as writer:
        run(load(lab.folder / "tiny.yaml"), store=writer)
    lab.configure(metrics={"a": one, "b": {"kind": "error", "of": ["a_1"]}})
    view = View([load(lab.folder / "tiny.yaml")], Store(lab.folder / "s"))
    view.look()
    assert view.rows[0].stored == 0


def test_a_short_terminal_has_the_cases_at_which_something_happens(lab: Lab) -> None:
    lab.configure(cases={"samples": [*range(50, 80)]}, trials=10, tables={})
    plan = load(lab.folder / "tiny.yaml")
    clock = Clock()
    _store(lab, plan, 50, range(10))
    view = View([plan], Store(lab.folder / "s"), clock)
    view.look()
    _store(lab, plan, 70, range(5))
    clock.now = 2.0
    view.look()
    lines = _printed(view)
    assert len(lines) == 12
    shown = [line.split() for line in lines]
    assert ["configuration", "case", "stored", "of", "failed", "rate", "left"] in shown
    assert ["tiny", "samples", "70", "10", "20", "0", "5", "trials/s", "2", "s"] in shown
    assert lines[-1] == "and 21 cases more, of which 1 are done"
    assert ["tiny", "samples", "50"] not in [words[:3] for words in shown]
    assert ["tiny", "samples", "51", "0", "20", "0"] in shown
    # However many are at work.
    for samples in range(51, 70):
        _store(lab, plan, samples, range(5))
    clock.now = 4.0
    view.look()
    assert len(_printed(view)) == 12


def _printed(view: View) -> list[str]:
    console = Console(width=100, height=12)
    with console.capture() as captured:
        console.print(view.shown(console.height))
    return captured.get().splitlines()
