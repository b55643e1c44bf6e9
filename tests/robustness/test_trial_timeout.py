"""Trials that never end: by the clock they are failed ones, and a later run computes them."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pandas as pd
import pytest

if TYPE_CHECKING:
    from pathlib import Path

    from tests.conftest import Lab

# Some trials with 80 samples, those whose input begins above zero, never end, unless the file is there.
_ENDLESS = """
while len(record) == 80 and record.u[0] > 0 and not Path("repaired").exists():
    np.linalg.inv(np.eye(9))
"""
# No other trial takes as long.
_TIMEOUT = ("--trial-timeout", "1.5")


@pytest.fixture
def endless(lab: Lab) -> Lab:
    lab.probe(_ENDLESS)
    lab.configure(trials=3)
    return lab


def _run_json(lab: Lab) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((lab.folder / "out/tiny/run.json").read_text())
    return content


def _failed(lab: Lab) -> int:
    table = pd.read_csv(lab.folder / "out/tiny/table.csv").query("estimator == 'probe'")
    return int(table["failed"].sum())


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_endless_trials_are_failed_ones_that_are_not_stored(endless: Lab, jobs: str) -> None:
    said = endless.run("--quiet", "--jobs", jobs, *_TIMEOUT)
    late = _failed(endless)
    assert 0 < late < 3
    trials = f"{late} trial{'s' * (late != 1)}"
    assert said == (
        f"warning: tiny: {trials} took longer than the trial timeout of 1.5 s: counted as failed, "
        "not stored, and computed by the next run\n"
    )
    assert f"{late} of 3 trials of estimator 'probe' at samples 80 failed" in (
        (endless.folder / "out/tiny/table.md").read_text()
    )
    assert "took longer than the trial timeout of 1.5 s" in (endless.folder / "out/tiny/table.md").read_text()
    assert _run_json(endless)["timed_out"] == {"trials": late, "trial_timeout": 1.5}
    assert len(endless.trials()) == 12 - late
    status = endless.hident("status", "tiny.yaml").stdout.splitlines()[1].split()
    assert status == ["tiny", str(12 - late), "12", "incomplete"]
    refused = endless.hident("accept", "tiny", code=2).stderr
    assert refused == (
        f"error: out/tiny lacks {trials}, which the trial timeout ended: hident run tiny, without it or with "
        "a longer one\n"
    )

    # The file stands for a machine that is fast enough.
    (endless.folder / "repaired").touch()
    assert f"12 trials, {12 - late} of them stored" in endless.run()
    assert "timed_out" not in _run_json(endless)
    assert _failed(endless) == 0
    resumed = endless.table
    endless.forget()
    endless.run("--quiet", "--trial-timeout", "900")
    assert endless.table == resumed
    assert "up to date" in endless.run()


@pytest.mark.parametrize("call", ["time.sleep(1e6)", "sum(itertools.repeat(0))"])
def test_a_call_that_never_returns_ends_its_worker_process(lab: Lab, call: str) -> None:
    # The sum keeps the interpreter's lock.
    lab.probe(f"import itertools\nif len(record) == 80:\n    {call}")
    plugin = lab.folder / "probe.py"
    plugin.write_text(
        plugin.read_text() + "\nfrom hident.engine import clock\n\nclock.GRACE_SECONDS = 0.1\n",
        encoding="utf-8",
    )
    said = lab.run("--jobs", "2", "--trial-timeout", "0.3", code=3)
    alone = (
        "hident: a call in a trial did not return, 0.1 s after the trial timeout of 0.3 s: this worker "
        "process ends itself\n"
    )
    assert (alone if "sleep" in call else "in fit\n") in said
    assert "worker" in said.partition("error: ")[2]
    lab.await_alone()


@pytest.mark.parametrize(("part", "of"), [("system", ""), ("metric", " for a")])
def test_a_simulation_and_a_metric_that_never_end(lab: Lab, part: str, of: str) -> None:
    _write_plugin(lab.folder)
    lab.probe()
    (lab.folder / "probe.py").write_text((lab.folder / "endless.py").read_text(), encoding="utf-8")
    lab.configure(
        trials=2,
        cases={},
        samples=50,
        estimators={"known": lab.config["estimators"]["known"]},
        system="endless" if part == "system" else "square_too",
        metrics={"a": "endless" if part == "metric" else {"kind": "value", "of": ["a_1"]}},
    )
    lab.run("--quiet", "--trial-timeout", "0.3")
    text = (lab.folder / "out/tiny/table.md").read_text()
    assert (
        f"2 of 2 trials of estimator 'known' failed{of} (took longer than the trial timeout of 0.3 s" in text
    )
    assert lab.trials() == {}


def _write_plugin(folder: Path) -> None:
    (folder / "endless.py").write_text('''
from hident.config.spec import component
from hident.metrics.base import MetricSpec
from hident.records import Truth
from hident.systems.base import SystemSpec


@component("system", "square_too")
class Square(SystemSpec):
    """A square."""

    def simulate(self, u, dt=1.0):
        return u**2

    def truth(self):
        return Truth()


@component("system", "endless")
class Endless(Square):
    """Never ends."""

    def simulate(self, u, dt=1.0):
        while True:
            pass


@component("metric", "endless")
class EndlessMetric(MetricSpec):
    """Never ends."""

    def evaluate(self, estimate, record):
        while True:
            pass
''')


@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "inf"])
def test_a_timeout_is_a_number_above_zero(lab: Lab, seconds: str) -> None:
    said = lab.run("--trial-timeout", seconds, code=2)
    assert said == f"error: the trial timeout must be a number of seconds above 0, not {seconds}\n"
