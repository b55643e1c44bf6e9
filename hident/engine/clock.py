"""The time limit of one trial: what takes longer is ended where it computes.

A thread of its own watches the clock. When the time is up, it raises an exception inside the thread that
computes (``PyThreadState_SetAsyncExc``), whichever of its process that is. Python raises it between two
instructions: a loop or a chain of calls to numpy ends at once, a single call into a library when it returns.
An import goes on, as half a module would be of no use to the trials to come.

A worker process in which such a call does not return ends itself after a grace period, and its executor deals
with its trials as with those of any lost worker. So it does where the call keeps the interpreter's lock, so
that the thread that watches cannot run: ``faulthandler``, which needs no lock, ends the process unless that
thread puts it off in time. The process of the run does not end itself, and waits.
"""

from __future__ import annotations

import ctypes
import faulthandler
import os
import platform
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import NoReturn, Self, TypeVar

from hident.errors import Exit, TrialFailed

T = TypeVar("T")

GRACE_SECONDS = 10.0
"""How much longer a worker process waits for a call that does not return."""
_IMPORTING = "importlib._bootstrap"
_LONGEST_SECONDS = 1e6
"""No clock is set further ahead: days."""
_AGAIN_SECONDS = 1.0
"""How long after the exception it is raised again: code may have swallowed it."""


def _here() -> tuple[str, int]:
    return platform.node(), os.getpid()


@dataclass(frozen=True)
class Limit:
    """How many seconds a trial may take; ``home`` is the process of the run, which does not end itself."""

    seconds: float
    home: tuple[str, int] = field(default_factory=_here)

    @classmethod
    def of(cls, seconds: float | None) -> Limit | None:
        """The limit of a run in this process, if there is one."""
        return None if seconds is None else cls(seconds)


class TookTooLong(TrialFailed):
    """The trial was ended by the clock. That is no property of the trial: another machine may finish it."""

    def __init__(self, limit: Limit) -> None:
        super().__init__(f"took longer than the trial timeout of {limit.seconds:g} s")


class _Alarm(BaseException):
    """What ends the work: no Exception, which an estimator may catch."""


def _arrive() -> None:
    """A call, at the beginning of which the interpreter looks for what was raised in its thread."""


class _Work:
    """One call under the clock."""

    def __init__(self, seconds: float) -> None:
        self.began = time.monotonic()
        self.due = self.began + seconds
        self.alarmed = self.over = False
        self._thread = threading.get_ident()
        # Held by whoever may raise the alarm, at last by the computing thread for ever. Reentrant: where the
        # alarm comes just after that one took it, it takes it again.
        self._turn = threading.RLock()

    def loads(self) -> bool:
        """Whether the work is importing a module, of which an alarm would leave half behind."""
        frame = sys._current_frames().get(self._thread)
        # What called the work may be in an import too.
        while frame is not None and frame.f_code is not Clock.limited.__code__:
            if frame.f_globals.get("__name__") == _IMPORTING:
                return True
            frame = frame.f_back
        return False

    def alarm(self) -> bool:
        """Raise the alarm in the computing thread; False if the work is over."""
        if self.over or not self._turn.acquire(blocking=False):
            return False
        try:
            self.alarmed = True
            ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self._thread), ctypes.py_object(_Alarm))
        finally:
            self._turn.release()
        return True

    def end(self) -> None:
        """Let no alarm come any more: called by the computing thread, until it returns."""
        while True:
            try:
                self._turn.acquire()
                # One that was raised and has not arrived yet does so in the next call. To take it back would
                # leave a mark on the interpreter, with which 3.11 hangs under a debugger.
                _arrive()
            except _Alarm:
                continue
            return


class Clock:
    """Watches over calls of one thread, one after the other, each with the same limit, if there is one."""

    def __init__(self, limit: Limit | None) -> None:
        self._limit = limit
        self._work: _Work | None = None
        self._stopped = threading.Event()
        self._in_worker = limit is not None and limit.home != _here()
        self._turn = threading.Lock()

    def __enter__(self) -> Self:
        if self._limit is not None:
            self._put_off(self._limit)
            threading.Thread(
                target=self._watch, args=(self._limit,), name="trial timeout", daemon=True
            ).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._turn:
            self._stopped.set()
            if self._in_worker:
                faulthandler.cancel_dump_traceback_later()

    def limited(self, make: Callable[[], T]) -> T:
        """What is made; TookTooLong if that takes longer than the limit."""
        if self._limit is None:
            return make()
        work = self._work = _Work(self._limit.seconds)
        try:
            try:
                made = make()
            finally:
                work.end()
        except BaseException as error:
            # The alarm may have come on the way into it. Two more may come at most: one that was raised, and
            # one that is just being raised.
            work.over = True
            try:
                work.end()
            except _Alarm:
                try:
                    work.end()
                except _Alarm:
                    work.end()
            self._work = None
            if work.alarmed and not isinstance(error, KeyboardInterrupt):
                raise TookTooLong(self._limit) from None
            raise
        self._work = None
        if work.alarmed:
            # The code swallowed it, and what it made of that is not its answer.
            raise TookTooLong(self._limit)
        return made

    def _watch(self, limit: Limit) -> None:
        # No work that begins in a pause of this length is due before it is looked at.
        longest = min(limit.seconds, _LONGEST_SECONDS)
        pause = longest
        while not self._stopped.wait(pause):
            self._put_off(limit)
            work, now = self._work, time.monotonic()
            pause = longest
            if work is None:
                continue
            if now < work.due:
                pause = min(work.due - now, longest)
            elif work.loads():
                work.due = now + limit.seconds
            elif work.alarm():
                if self._in_worker and now > work.began + limit.seconds + GRACE_SECONDS:
                    _end_process(limit)
                work.due = now + _AGAIN_SECONDS
                pause = min(_AGAIN_SECONDS, longest)

    def _put_off(self, limit: Limit) -> None:
        """Let the process end if this is not called again soon enough; threads of one worker share that."""
        with self._turn:
            if self._in_worker and not self._stopped.is_set():
                # It is called after a limit at the latest, and a call may keep the lock for another one.
                soon = min(2.0 * limit.seconds + GRACE_SECONDS, _LONGEST_SECONDS)
                faulthandler.dump_traceback_later(soon, exit=True, file=2)


def _end_process(limit: Limit) -> NoReturn:
    said = (
        f"hident: a call in a trial did not return, {GRACE_SECONDS:g} s after the trial timeout of "
        f"{limit.seconds:g} s: this worker process ends itself\n"
    )
    os.write(2, said.encode())
    os._exit(Exit.CRASHED)
