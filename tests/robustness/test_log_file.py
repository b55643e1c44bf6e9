"""The file of --log: a line for each chunk and each fault, which costs no run."""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import hident as hi

if TYPE_CHECKING:
    from tests.conftest import Lab


def _lines(lab: Lab) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (lab.folder / "run.log").read_text().splitlines()]


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_line_for_each_chunk_and_for_start_and_end(lab: Lab, jobs: str) -> None:
    lab.run("--quiet", "--jobs", jobs, "--log", "run.log")
    start, *chunks, end, outputs = _lines(lab)
    assert start["event"] == "start"
    assert (start["config"], start["total"], start["stored"], start["workers"]) == ("tiny", 24, 0, int(jobs))
    assert start["time"].endswith("+00:00")
    assert (end["event"], end["outcome"], end["message"]) == (
        "end",
        "finished",
        "tiny: all 24 trials are there",
    )
    assert (outputs["event"], outputs["message"]) == ("outputs", "tiny: wrote out/tiny")
    assert {line["event"] for line in chunks} == {"chunk"}
    trials: Counter[int] = Counter()
    for line in chunks:
        assert line["estimators"] == ["known", "iv"]
        assert line["seconds"] > 0
        assert line["last"] - line["first"] + 1 == line["trials"]
        trials[line["case"]["samples"]] += line["trials"]
    assert trials == {50: 6, 80: 6}
    # Appended to: the same again, and nothing to do.
    lab.run("--quiet", "--log", "run.log")
    (lab.folder / "out/tiny/run.json").unlink()
    lab.run("--quiet", "--log", "run.log")
    events = [line["event"] for line in _lines(lab)[len(chunks) + 3 :]]
    assert events == ["outputs", "start", "end", "outputs"]


def test_crashes_and_trials_that_took_too_long_have_lines(lab: Lab) -> None:
    lab.probe("""
        if len(record) == 80:
            raise ValueError("a crash")
        while record.u[0] > 0:
            pass
    """)
    lab.configure(trials=3)
    lab.run("--quiet", "--keep-going", "--trial-timeout", "1.5", "--log", "run.log", code=3)
    faults = [line for line in _lines(lab) if line["level"] == "warning"]
    assert {(line["event"], line.get("reason")) for line in faults} == {
        ("crash", "ValueError: a crash"),
        ("timed out", "took longer than the trial timeout of 1.5 s"),
        ("end", None),
    }
    crash = next(line for line in faults if line["event"] == "crash")
    assert (crash["case"], crash["estimator"], crash["trial"]) == ({"samples": 80}, "probe", 0)
    assert crash["message"] == "tiny: trial 0 of estimator 'probe' at samples 80: ValueError: a crash"
    assert faults[-1]["outcome"] == "CrashReport"


@pytest.mark.skipif(sys.platform != "linux", reason="signals and /proc")
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_an_interrupt_has_a_line(lab: Lab, jobs: str) -> None:
    lab.probe("Path('reached').touch()\nwhile True:\n    pass")
    process = lab.start("run", "tiny.yaml", "--jobs", jobs, "--log", "run.log")
    lab.await_((lab.folder / "reached").exists)
    os.killpg(process.pid, signal.SIGINT)
    if jobs != "1":
        lab.await_(lambda: "Ctrl-C again stops at once" in lab.log)
        assert _lines(lab)[-1]["event"] == "interrupt"
        os.killpg(process.pid, signal.SIGINT)
    assert process.wait() == 130
    assert (_lines(lab)[-1]["event"], _lines(lab)[-1]["outcome"]) == ("end", "KeyboardInterrupt")


def test_a_log_that_cannot_be_written_is_an_error_before_the_run(lab: Lab) -> None:
    said = lab.run("--log", "none/run.log", code=2)
    assert said == (
        "error: the log none/run.log cannot be written (no such file or directory): --log names another\n"
    )
    assert "is a directory" in lab.run("--log", ".", code=2)
    assert not (lab.folder / ".hident").exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="/dev/full is always full")
def test_a_full_disk_costs_lines_and_nothing_else(lab: Lab) -> None:
    said = lab.run("--quiet", "--log", "/dev/full")
    assert said.startswith("warning: ")
    assert said.endswith(" lines of the log /dev/full could not be written (no space left on device)\n")
    assert (lab.folder / "out/tiny/table.csv").exists()


def test_a_logger_of_python_s_is_told_the_same_and_is_silent_by_default(
    lab: Lab, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, "hident"):
        hi.run(lab.folder / "tiny.yaml")
    fields = [getattr(record, "hident", {}) for record in caplog.records]
    assert [fields[0]["event"], fields[1]["event"], fields[-1]["event"]] == ["start", "chunk", "end"]
    assert caplog.messages[0] == "tiny: 24 trials, 0 of them stored"
    assert caplog.messages[1].startswith("tiny: trial 0 of 'known', 'iv' at samples 50: ")
    assert any(isinstance(handler, logging.NullHandler) for handler in logging.getLogger("hident").handlers)
