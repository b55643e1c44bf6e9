"""Ctrl-C and kills: nothing stored is lost, nothing left running, and the rerun ends as if never stopped."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.conftest import HOLD
from tests.forked import GUARD_SECONDS

if TYPE_CHECKING:
    from tests.conftest import Lab

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="signals and /proc")

_RESUMES = "interrupted: all stored trials are kept in .hident; the same command resumes"


@pytest.fixture
def held(lab: Lab) -> Lab:
    lab.probe(HOLD)
    (lab.folder / "hold").touch()
    return lab


@pytest.fixture(scope="module")
def uninterrupted(make_lab: Callable[[Path], Lab], tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The table of a run that nothing stopped."""
    lab = make_lab(tmp_path_factory.mktemp("uninterrupted"))
    lab.probe()
    lab.run("-q")
    return lab.table


def test_first_interrupt_of_a_pool_keeps_what_is_in_flight(held: Lab, uninterrupted: bytes) -> None:
    process = held.start("run", "tiny.yaml", "--jobs", "2")
    held.await_((held.folder / "reached").exists)
    os.killpg(process.pid, signal.SIGINT)
    held.await_(lambda: "stopping when the trials in flight are stored" in held.log)
    assert process.poll() is None
    (held.folder / "hold").unlink()
    assert process.wait() == 130
    assert _RESUMES in held.log
    assert "Traceback" not in held.log
    held.await_alone()
    stored = held.trials()
    assert any("80" in case for _, case, _ in stored)
    assert len(stored) < 24
    assert not (held.folder / "out").exists()
    held.run("-q", "--jobs", "2")
    assert held.table == uninterrupted


def test_an_interrupted_run_under_a_rule_comes_to_the_same_number(held: Lab) -> None:
    held.configure(trials={"until": {"relative_se": 0.02, "least": 5, "most": 1000}})
    process = held.start("run", "tiny.yaml", "--jobs", "2")
    held.await_((held.folder / "reached").exists)
    os.killpg(process.pid, signal.SIGINT)
    held.await_(lambda: "stopping when the trials in flight are stored" in held.log)
    (held.folder / "hold").unlink()
    assert process.wait() == 130
    assert _RESUMES in held.log
    held.await_alone()
    assert " or more" in held.hident("status", "tiny.yaml").stdout
    held.run("-q", "--jobs", "2")
    table = held.table
    trials = {int(row.split(",")[3]) for row in table.decode().splitlines()[1:]}
    assert len(trials) == 1
    assert 5 < trials.pop() < 1000
    held.forget()
    held.run("-q")
    assert held.table == table


@pytest.mark.parametrize(
    ("number", "whole_group", "ignored"),
    [
        (signal.SIGTERM, True, []),
        (signal.SIGTERM, False, []),
        (signal.SIGHUP, True, []),
        (signal.SIGTERM, False, [signal.SIGINT]),
    ],
    ids=["SIGTERM to all", "SIGTERM to one", "SIGHUP to all", "SIGTERM in the background of a script"],
)
def test_other_signals_end_a_pool_as_an_interrupt_does(
    held: Lab,
    number: signal.Signals,
    whole_group: bool,
    ignored: list[signal.Signals],
    uninterrupted: bytes,
) -> None:
    def prepare() -> None:
        for other in ignored:
            signal.signal(other, signal.SIG_IGN)

    process = held.start("run", "tiny.yaml", "--jobs", "2", preexec_fn=prepare)
    held.await_((held.folder / "reached").exists)
    (os.killpg if whole_group else os.kill)(process.pid, number)
    held.await_(lambda: "stopping when the trials in flight are stored" in held.log)
    (held.folder / "hold").unlink()
    assert process.wait() == 128 + number
    assert _RESUMES in held.log
    assert "Traceback" not in held.log
    held.await_alone()
    assert any("80" in case for _, case, _ in held.trials())
    assert not (held.folder / "out").exists()
    held.run("-q", "--jobs", "2")
    assert held.table == uninterrupted


def test_second_signal_of_a_pool_stops_at_once(held: Lab) -> None:
    process = held.start("run", "tiny.yaml", "--jobs", "2")
    held.await_((held.folder / "reached").exists)
    os.killpg(process.pid, signal.SIGTERM)
    held.await_(lambda: "stopping when the trials in flight are stored" in held.log)
    os.killpg(process.pid, signal.SIGTERM)
    assert process.wait() == 143
    assert _RESUMES in held.log
    held.await_alone()


def test_signal_that_is_ignored_stays_so(held: Lab) -> None:
    process = held.start(
        "run", "tiny.yaml", "--jobs", "1", preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN)
    )
    held.await_((held.folder / "reached").exists)
    os.killpg(process.pid, signal.SIGHUP)
    (held.folder / "hold").unlink()
    assert process.wait() == 0


def test_other_signals_end_a_serial_run_that_ignores_interrupts(held: Lab) -> None:
    process = held.start(
        "run", "tiny.yaml", "--jobs", "1", preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN)
    )
    held.await_((held.folder / "reached").exists)
    os.killpg(process.pid, signal.SIGINT)
    os.killpg(process.pid, signal.SIGTERM)
    assert process.wait() == 143
    assert _RESUMES in held.log
    held.await_alone()


def test_second_interrupt_of_a_pool_stops_at_once(held: Lab) -> None:
    process = held.start("run", "tiny.yaml", "--jobs", "2")
    held.await_((held.folder / "reached").exists)
    # Both cases are begun together.
    held.await_(held.trials)
    os.killpg(process.pid, signal.SIGINT)
    held.await_(lambda: "Ctrl-C again stops at once" in held.log)
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait() == 130
    assert _RESUMES in held.log
    assert "Traceback" not in held.log
    held.await_alone()
    assert {case for _, case, _ in held.trials()} == {"{'samples': 50}"}


def test_interrupt_while_workers_start(held: Lab) -> None:
    process = held.start("run", "tiny.yaml", "--jobs", "2", fresh_workers=True)
    held.await_(lambda: "24 trials" in held.log)
    os.killpg(process.pid, signal.SIGINT)
    (held.folder / "hold").unlink()
    assert process.wait() == 130
    assert _RESUMES in held.log
    assert "Traceback" not in held.log
    held.await_alone()


def test_interrupt_of_a_serial_run(held: Lab, uninterrupted: bytes) -> None:
    process = held.start("run", "tiny.yaml", "--jobs", "1")
    held.await_((held.folder / "reached").exists)
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait() == 130
    assert _RESUMES in held.log
    assert "Traceback" not in held.log
    assert {case for _, case, _ in held.trials()} == {"{'samples': 50}"}
    (held.folder / "hold").unlink()
    held.run("-q")
    assert held.table == uninterrupted


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_interrupts_end_estimates_that_never_end(lab: Lab, jobs: str) -> None:
    lab.probe("Path('reached').touch()\nwhile True:\n    np.linalg.inv(np.eye(9))")
    process = lab.start("run", "tiny.yaml", "--jobs", jobs)
    lab.await_((lab.folder / "reached").exists)
    os.killpg(process.pid, signal.SIGINT)
    if jobs != "1":
        lab.await_(lambda: "Ctrl-C again stops at once" in lab.log)
        os.killpg(process.pid, signal.SIGINT)
    assert process.wait() == 130
    assert "Traceback" not in lab.log
    lab.await_alone()


_SCRIPT = """
import os, signal, threading, time
from pathlib import Path
import hident as hi

def interrupt():
    while not Path("reached").exists():
        time.sleep(0.01)
    os.kill(os.getpid(), signal.SIGINT)
    # The first one brings Python's own handler back.
    while signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        time.sleep(0.01)
    os.kill(os.getpid(), signal.SIGINT)

if __name__ == "__main__":
    threading.Thread(target=interrupt, daemon=True).start()
    try:
        hi.run("tiny.yaml", executor=2)
    except KeyboardInterrupt:
        print("interrupted")
"""


def test_second_interrupt_of_a_script_ends_estimates_that_never_end(lab: Lab) -> None:
    lab.probe("Path('reached').touch()\nwhile True:\n    pass")
    lab.configure(plugins=["probe.py"])
    (lab.folder / "script.py").write_text(_SCRIPT, encoding="utf-8")
    said = subprocess.run(
        [sys.executable, "script.py"],
        cwd=lab.folder,
        capture_output=True,
        text=True,
        timeout=GUARD_SECONDS,
        check=True,
    )
    assert said.stdout == "interrupted\n"
    lab.await_alone()


def test_interrupt_while_outputs_are_written_leaves_the_old_ones(lab: Lab) -> None:
    lab.probe()
    lab.run("-q")
    before = {path.name: path.read_bytes() for path in (lab.folder / "out/tiny").iterdir()}
    # A figure that waits: with it, everything is to be written anew, and the trials are there already.
    plugin = lab.folder / "probe.py"
    plugin.write_text(
        plugin.read_text()
        + """
import signal

from hident.reports.base import FigureSpec


@component("figure", "slow")
class Slow(FigureSpec):
    def draw(self, results, verdicts):
        Path("drawing").touch()
        signal.pause()
"""
    )
    lab.configure(figures={"slow": "slow"}, title="Another")
    process = lab.start("run", "tiny.yaml", "--jobs", "1")
    lab.await_((lab.folder / "drawing").exists)
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait() == 130
    assert "Traceback" not in lab.log
    assert {path.name: path.read_bytes() for path in (lab.folder / "out/tiny").iterdir()} == before


def test_kill_of_the_main_process_leaves_no_socket(held: Lab) -> None:
    # That of the test may be too long for a socket.
    with tempfile.TemporaryDirectory(dir="/tmp") as name:
        process = held.start(
            *("run", "tiny.yaml", "--jobs", "2"),
            preexec_fn=lambda: setattr(tempfile, "tempdir", name),
            fresh_workers=True,
        )
        held.await_((held.folder / "reached").exists)
        assert [*Path(name).glob("*/listener-*")]
        process.kill()
        process.wait()
        held.await_alone()
        assert not [*Path(name).iterdir()]


def test_kills_at_any_moment_lose_nothing(lab: Lab, uninterrupted: bytes) -> None:
    lab.probe("""
        with open("fits", "ab") as file:
            file.write(b".")
    """)
    fits = lab.folder / "fits"
    for jobs, moment in (("2", 0), ("1", 2), ("2", 4)):
        fits.write_bytes(b"")
        process = lab.start("run", "tiny.yaml", "--jobs", jobs, fresh_workers=not moment)
        lab.await_(lambda: "24 trials" in lab.log)
        # With few enough left, it ends of itself before.
        ended, wanted = process.poll, moment
        lab.await_(lambda: fits.stat().st_size >= wanted or ended() is not None)  # noqa: B023
        process.kill()
        process.wait()
        lab.await_alone()
    lab.run("-q", "--jobs", "2")
    assert lab.table == uninterrupted
