"""Executors that others have made: what they do wrong is told, and Ctrl-C and kills leave nothing of them."""

from __future__ import annotations

import os
import signal
import sys
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.conftest import Lab

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="signals and /proc")
_OWN = """
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor

class None_(Executor):
    def __init__(self, workers):
        pass

class Nothing(None_):
    def submit(self, fn, *args):
        return None

class Refuses(None_):
    def submit(self, fn, *args):
        raise RuntimeError("no more")

class Cancels(None_):
    def submit(self, fn, *args):
        future = Future()
        future.cancel()
        future.set_running_or_notify_cancel()
        return future

class Answers(None_):
    def submit(self, fn, *args):
        future = Future()
        future.set_result(42)
        return future

def leaves(workers):
    raise SystemExit(0)
"""


@pytest.mark.parametrize(
    ("executor", "code", "said"),
    [
        ("syntax:f", 2, "--executor: the module of 'syntax:f' cannot be imported: SyntaxError: "),
        ("raises:f", 2, "--executor: the module of 'raises:f' cannot be imported: ValueError: no\n"),
        ("exits:f", 2, "--executor: the module of 'exits:f' cannot be imported: SystemExit: 0\n"),
        (".:f", 2, "--executor: the module of '.:f' cannot be imported: TypeError: "),
        ("own:leaves", 2, "--executor: own:leaves(2): SystemExit: 0\n"),
        ("own:Nothing", 2, "submit of own:Nothing must give a concurrent.futures.Future (got None)\n"),
        ("own:None_", 3, "the executor own:None_ takes no calls (NotImplementedError).\n"),
        ("own:Refuses", 3, "the executor own:Refuses takes no calls (RuntimeError: no more).\n"),
        ("own:Cancels", 3, "the executor has cancelled calls of the run.\n"),
        ("own:Answers", 2, "executor: gave no answer of the call that it was given (got 42)\n"),
    ],
)
def test_what_it_does_wrong_is_told(lab: Lab, executor: str, code: int, said: str) -> None:
    for name, text in (
        ("own", _OWN),
        ("syntax", "def f(:\n"),
        ("raises", "raise ValueError('no')\n"),
        ("exits", "import sys\nsys.exit(0)\n"),
    ):
        (lab.folder / f"{name}.py").write_text(text)
    error = lab.hident("run", "tiny.yaml", "-j2", "--executor", executor, code=code).stderr
    assert f"error: {said}" in error or ("error: --executor: " in error and said in error)
    assert not (lab.folder / "out").exists()


@pytest.mark.parametrize(
    "executor", ["own:ThreadPoolExecutor", "own:ProcessPoolExecutor", "loky:get_reusable_executor"]
)
@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGKILL])
def test_estimates_that_never_end(lab: Lab, executor: str, by: signal.Signals) -> None:
    if executor.startswith("loky"):
        pytest.importorskip("loky")
    (lab.folder / "own.py").write_text(_OWN)
    lab.probe('if len(record) == 80:\n    Path("reached").touch()\n    while True:\n        pass')
    process = lab.start("run", "tiny.yaml", "-j2", "--executor", executor)
    lab.await_((lab.folder / "reached").exists)
    if by == signal.SIGKILL:
        os.kill(process.pid, by)
    else:
        os.killpg(process.pid, by)
        # An executor may let all calls be taken back, and the first one is enough.
        stopping = "stopping when the trials in flight are stored"
        lab.await_(lambda: process.poll() is not None or stopping in lab.log)
        if process.poll() is None:
            os.killpg(process.pid, by)
    assert process.wait() == (-by if by == signal.SIGKILL else 130), lab.log
    lab.await_alone()
