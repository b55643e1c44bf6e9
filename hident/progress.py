"""What a run shows while it goes: a bar on a terminal, plain lines in a log."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from hident.engine.runner import Progress, Silent

_EVERY_SECONDS = 10.0


def chosen(name: str, *, quiet: bool) -> Progress:
    """Nothing if quiet, a bar on a terminal, else lines; all on standard error."""
    if quiet:
        return Silent()
    return Bar(name) if sys.stderr.isatty() else Lines(name)


def _stored(stored: int, total: int) -> str:
    if stored == total:
        return f"all {total} trials are stored"
    return f"{total} trials" + (f", {stored} of them stored" if stored else "")


class Lines:
    """One line at the start, one every ten seconds of the clock, one at the end."""

    def __init__(self, name: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._name = name
        self._clock = clock

    def _say(self, text: str) -> None:
        print(f"{self._name}: {text}", file=sys.stderr, flush=True)

    def start(self, total: int, stored: int) -> None:
        self._total, self._done, self._stored = total, stored, stored
        self._start = self._last = self._clock()
        self._say(_stored(stored, total))

    def advance(self, trials: int) -> None:
        self._done += trials
        now = self._clock()
        if self._stored < self._done < self._total and now - self._last >= _EVERY_SECONDS:
            self._last = now
            rate = (self._done - self._stored) / (now - self._start)
            left = (self._total - self._done) / rate
            self._say(f"{self._done}/{self._total} trials, {rate:.0f} a second, {left:.0f} s left")

    def stopping(self) -> None:
        self._say("stopping when the trials in flight are stored; Ctrl-C again stops at once")

    def finish(self) -> None:
        if self._done > self._stored:
            seconds = self._clock() - self._start
            self._say(f"{self._done}/{self._total} trials done, {seconds:.1f} s")


class Bar:
    """A bar with the rate and the remaining time."""

    def __init__(self, name: str, clock: Callable[[], float] = time.monotonic) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        self._name = name
        self._clock = clock
        self._console = Console(stderr=True)
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(),
            console=self._console,
            get_time=clock,
        )

    def start(self, total: int, stored: int) -> None:
        self._console.print(f"{self._name}: {_stored(stored, total)}", highlight=False)
        self._stored = stored
        self._task = self._bar.add_task(self._name, total=total, completed=stored, rate="")
        self._began = self._clock()
        if stored < total:
            self._bar.start()

    def advance(self, trials: int) -> None:
        self._bar.advance(self._task, trials)
        done = self._bar.tasks[0].completed - self._stored
        rate = done / max(self._clock() - self._began, 1e-9)
        self._bar.update(self._task, rate=f"{rate:.0f} trials/s")

    def stopping(self) -> None:
        self._console.print("stopping when the trials in flight are stored; Ctrl-C again stops at once")

    def finish(self) -> None:
        self._bar.stop()
