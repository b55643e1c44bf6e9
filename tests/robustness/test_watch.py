"""``hident status --watch`` beside a run, from another process."""

from __future__ import annotations

import os
import pty
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.conftest import HOLD
from tests.forked import Forked

if TYPE_CHECKING:
    from tests.conftest import Lab

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="signals and /proc")

_WATCH = ("status", "tiny.yaml", "--watch", "--interval", "0.1")


@pytest.fixture
def held(lab: Lab) -> Lab:
    """A run that waits in its second case."""
    lab.probe(HOLD)
    (lab.folder / "hold").touch()
    lab.start("run", "tiny.yaml", "--jobs", "1", log="run.txt")
    lab.await_((lab.folder / "reached").exists)
    return lab


def test_lines_say_how_far_each_case_is_until_all_is_stored(held: Lab) -> None:
    watching = held.start(*_WATCH)
    held.await_(lambda: "samples 50" in held.log and "samples 80: 0/12 trials" in held.log)
    assert watching.poll() is None
    (held.folder / "hold").unlink()
    assert watching.wait() == 0
    lines = held.log.splitlines()
    assert any(line.startswith("tiny: 24/24 trials") and line.endswith("done") for line in lines)
    assert any(line.startswith("tiny, samples 80: 12/12 trials") for line in lines)
    assert held.started[0].wait() == 0


def test_ctrl_c_ends_the_watch_and_not_the_run(held: Lab) -> None:
    watching = held.start(*_WATCH)
    held.await_(lambda: "tiny, samples 80" in held.log)
    os.killpg(watching.pid, signal.SIGINT)
    assert watching.wait() == 130
    assert "Traceback" not in held.log
    assert held.started[0].poll() is None
    (held.folder / "hold").unlink()
    assert held.started[0].wait() == 0


def test_a_terminal_has_a_table(held: Lab) -> None:
    mine, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100", "LINES": "20"}
    with Path(os.devnull).open("wb") as nowhere, os.fdopen(theirs, "wb") as terminal:
        watching = Forked([*_WATCH, "--plugin", "probe.py"], held.folder, terminal, nowhere, environment)
    held.started.append(watching)
    shown = b""
    while True:
        if b"samples 80" in shown:
            (held.folder / "hold").unlink(missing_ok=True)
        try:
            shown += os.read(mine, 4096)
        except OSError:
            break
    os.close(mine)
    assert watching.wait() == 0
    for text in (b"configuration", b"samples 50", b"samples 80", b"done"):
        assert text in shown
    assert b"Traceback" not in shown
