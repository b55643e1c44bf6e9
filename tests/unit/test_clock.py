"""The time limit of one trial: what never ends is ended, what ends is left alone, in any thread."""

from __future__ import annotations

import contextlib
import functools
import importlib
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from hident.engine import clock
from hident.engine.clock import Clock, Limit, TookTooLong
from tests.forked import GUARD_SECONDS


def _loop() -> None:
    while True:
        pass


def _numpy() -> None:
    while True:
        np.linalg.inv(np.eye(50))


def _catching() -> None:
    while True:
        try:
            _loop()
        except Exception:
            continue


def _swallowing() -> None:
    for _ in range(2):
        try:
            _loop()
        except BaseException:
            continue


def _turned_into_another_error() -> None:
    try:
        _loop()
    except BaseException:
        raise ValueError("something went wrong") from None


@pytest.mark.parametrize("work", [_loop, _numpy, _catching, _swallowing, _turned_into_another_error])
def test_what_never_ends_is_ended_with_a_reason(work, monkeypatch):
    monkeypatch.setattr(clock, "_AGAIN_SECONDS", 0.02)
    with Clock(Limit(0.02)) as limited:
        for _ in range(2):
            with pytest.raises(TookTooLong, match=r"^took longer than the trial timeout of 0.02 s$"):
                limited.limited(work)
        assert limited.limited(lambda: 5) == 5


def test_what_ends_is_left_alone_and_keeps_its_errors():
    with Clock(Limit(900.0)) as limited:
        assert limited.limited(lambda: 5) == 5
        with pytest.raises(ZeroDivisionError):
            limited.limited(lambda: 1 / 0)
        with pytest.raises(KeyboardInterrupt):
            limited.limited(_interrupted)
    with Clock(None) as limited:
        assert limited.limited(lambda: 5) == 5


def _interrupted() -> None:
    raise KeyboardInterrupt


def test_a_module_is_loaded_to_its_end(tmp_path, monkeypatch):
    # It ends when it was seen twice that it is loading.
    code = "from hident.engine.clock import looks\nwhile len(looks) < 2: pass\n"
    (tmp_path / "slowly_loaded.py").write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    loads = clock._Work.loads
    looks: list[bool] = []

    def looking(work: clock._Work) -> bool:
        looks.append(loads(work))
        return looks[-1]

    monkeypatch.setattr(clock, "looks", looks, raising=False)
    monkeypatch.setattr(clock._Work, "loads", looking)
    with Clock(Limit(0.5)) as limited:
        assert limited.limited(lambda: importlib.import_module("slowly_loaded")).looks is looks
        assert looks == [True, True]
        with pytest.raises(TookTooLong):
            limited.limited(_loop)


def test_work_that_a_module_does_while_it_is_imported_is_ended(tmp_path, monkeypatch):
    (tmp_path / "works_at_once.py").write_text(
        """
from hident.engine.clock import Clock, Limit, TookTooLong

def work():
    while True:
        pass

try:
    with Clock(Limit(0.02)) as limited:
        limited.limited(work)
except TookTooLong:
    ended = True
""",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert importlib.import_module("works_at_once").ended


def test_threads_have_clocks_of_their_own():
    def ended(_: int) -> bool:
        with Clock(Limit(0.02)) as limited:
            try:
                limited.limited(_loop)
            except TookTooLong:
                return threading.current_thread() is not threading.main_thread()
        return False

    with ThreadPoolExecutor(2) as threads:
        assert all(threads.map(ended, range(4)))


def test_no_alarm_leaves_the_call_that_it_is_for(monkeypatch):
    # Limits and calls of about one length, and the alarm again at once: whether a call is ended is open, but
    # nothing may be raised after it.
    monkeypatch.setattr(clock, "_AGAIN_SECONDS", 1e-5)
    done = 0
    with Clock(Limit(2e-5)) as limited:
        for turns in range(2000):
            with contextlib.suppress(TookTooLong):
                limited.limited(functools.partial(sum, range(turns)))
            done += 1
    assert done == 2000


def test_alarms_leave_nothing_behind_that_a_debugger_would_hang_on():
    code = """
import sys
from tests.unit import test_clock
with test_clock.pytest.MonkeyPatch.context() as patch:
    test_clock.test_no_alarm_leaves_the_call_that_it_is_for(patch)
sys.setprofile(lambda *event: None)
(lambda: None)()
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=GUARD_SECONDS)
