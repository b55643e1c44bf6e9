"""What a run shows while it goes: a bar on a terminal, plain lines in a log."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hident.config.suggest import counted
from hident.engine.runner import Progress, Silent

_EVERY_SECONDS = 10.0
_LONG_SECONDS = 600.0
"""What a run may take without a word on what it costs."""
_LOOK_SECONDS = 1.0


def chosen(name: str, estimates: int, *, quiet: bool) -> Progress:
    """Nothing if quiet, a bar on a terminal, else lines; all on standard error."""
    if quiet:
        return Silent()
    return (Bar if sys.stderr.isatty() else Lines)(name, estimates=estimates)


def duration(seconds: float) -> str:
    """A time to two digits or so: ``45 s``, ``12 min``, ``3.4 h``, ``12 days``."""
    for unit, length, most in (("s", 1.0, 120.0), ("min", 60.0, 120.0), ("h", 3600.0, 48.0)):
        if (count := seconds / length) < most:
            return f"{count:.1f} {unit}" if unit == "h" and count < 10.0 else f"{count:.0f} {unit}"
    return f"{seconds / 86400.0:.0f} days"


@contextmanager
def reminder(said: str, *, quiet: bool) -> Iterator[None]:
    """Say on standard error that something goes on, if it takes more than ten seconds."""
    timer = threading.Timer(_EVERY_SECONDS, lambda: print(said, file=sys.stderr, flush=True))
    timer.daemon = True
    if not quiet:
        timer.start()
    try:
        yield
    finally:
        timer.cancel()


def rate_of(trials: float, seconds: float) -> str:
    """A rate in the unit that gives it a digit before the point: ``12 trials/s``, ``3 trials/h``."""
    rate = trials / max(seconds, 1e-9)
    unit, length = next((u for u in (("s", 1.0), ("min", 60.0)) if rate * u[1] >= 1.0), ("h", 3600.0))
    return f"{counted(round(rate * length), 'trial')}/{unit}"


def _stored(stored: int, total: int) -> str:
    if stored == total:
        return f"{'all ' * (total != 1)}{counted(total, 'trial', 'are')} stored"
    return counted(total, "trial") + (f", {stored} of them stored" if stored else "")


class _Pace:
    """How fast trials end, from the first one on: before, workers start and load what they need."""

    def __init__(self) -> None:
        self._first: tuple[int, float] | None = None
        self._ended = 0

    def advance(self, trials: int, now: float) -> None:
        self._ended += trials
        if self._first is None and trials:
            self._first = self._ended, now

    def measured(self, now: float) -> tuple[int, float] | None:
        """So many trials in so many seconds; None before some more ended, at a later time."""
        if self._first is None or self._ended == self._first[0] or now <= self._first[1]:
            return None
        return self._ended - self._first[0], now - self._first[1]


class _Notices:
    """What a run says beside its progress: that it takes long, and that nothing has ended for a while.

    It looks at the clock once a second, in a thread of its own, as a run of one worker is inside its trials.
    """

    def __init__(self, estimates: int, say: Callable[[str], None], clock: Callable[[], float]) -> None:
        self._estimates, self._say, self._clock = estimates, say, clock
        self.pace = _Pace()
        self._works: dict[str, None] = {}
        self._patience = _EVERY_SECONDS
        self._cost_said = False
        self._stopped = threading.Event()
        self._lock = threading.Lock()

    def start(self, total: int, stored: int) -> None:
        self._left = total - stored
        self._start = self._last = self._clock()
        # A run may have several rounds, each with a watch of its own.
        self._stopped = threading.Event()
        if stored < total:
            watch = threading.Thread(target=self._watch, args=(self._stopped,), name="progress", daemon=True)
            watch.start()

    def begins(self, work: str) -> None:
        with self._lock:
            self._works[work] = None

    def ends(self, work: str) -> None:
        with self._lock:
            self._works.pop(work, None)

    def advance(self, trials: int) -> None:
        self._left -= trials
        self._last = self._clock()
        self.pace.advance(trials, self._last)

    def finish(self) -> None:
        self._stopped.set()

    def look(self) -> None:
        """Say what is to be said now."""
        now = self._clock()
        pace = self.pace.measured(now)
        if pace and now - self._start >= _EVERY_SECONDS and not self._cost_said:
            left = self._left * pace[1] / pace[0]
            if left > _LONG_SECONDS:
                self._cost_said = True
                self._say(
                    f"about {duration(left)} to go for {counted(self._left, 'trial')} of "
                    f"{self._estimates} estimates; fewer --trials, more --jobs or a --trial-timeout shorten "
                    "it, and Ctrl-C keeps what is stored"
                )
        if now - self._last >= self._patience:
            with self._lock:
                work = next(iter(self._works), None)
            if work is not None:
                silent = duration(now - self._last)
                # Said less and less often where every trial takes long.
                self._patience *= 2
                self._say(
                    f"nothing has ended for {silent}; at work on {work}. Ctrl-C stops, and --trial-timeout "
                    "SECONDS ends trials that take longer"
                )

    def _watch(self, stopped: threading.Event) -> None:
        while not stopped.wait(_LOOK_SECONDS):
            self.look()


class _Shown:
    """What both forms of progress share."""

    def __init__(self, name: str, clock: Callable[[], float] = time.monotonic, estimates: int = 1) -> None:
        self._name, self._clock = name, clock
        self._notices = _Notices(estimates, self._say, clock)

    def _say(self, text: str) -> None:
        raise NotImplementedError

    def begins(self, work: str) -> None:
        self._notices.begins(work)

    def ends(self, work: str) -> None:
        self._notices.ends(work)

    def look(self) -> None:
        """Say what the clock alone gives reason to say; a run does so once a second."""
        self._notices.look()

    def stopping(self) -> None:
        self._say("stopping when the trials in flight are stored; Ctrl-C again stops at once")


class Lines(_Shown):
    """One line at the start, one every ten seconds of the clock, one at the end."""

    def _say(self, text: str) -> None:
        print(f"{self._name}: {text}", file=sys.stderr, flush=True)

    def start(self, total: int, stored: int) -> None:
        self._total, self._done, self._stored = total, stored, stored
        self._start = self._last = self._clock()
        self._say(_stored(stored, total))
        self._notices.start(total, stored)

    def advance(self, trials: int) -> None:
        self._done += trials
        self._notices.advance(trials)
        now = self._clock()
        if self._stored < self._done < self._total and now - self._last >= _EVERY_SECONDS:
            self._last = now
            said = f"{self._done}/{counted(self._total, 'trial')}"
            if pace := self._notices.pace.measured(now):
                left = duration((self._total - self._done) * pace[1] / pace[0])
                said += f", {rate_of(*pace)}, {left} left"
            self._say(said)

    def finish(self) -> None:
        self._notices.finish()
        if self._done > self._stored:
            seconds = self._clock() - self._start
            self._say(f"{self._done}/{counted(self._total, 'trial')} done, {seconds:.1f} s")


class Bar(_Shown):
    """A bar with the rate and the remaining time."""

    def __init__(self, name: str, clock: Callable[[], float] = time.monotonic, estimates: int = 1) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        super().__init__(name, clock, estimates)
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

    def _say(self, text: str) -> None:
        self._console.print(f"{self._name}: {text}", highlight=False, markup=False)

    def start(self, total: int, stored: int) -> None:
        self._say(_stored(stored, total))
        self._task = self._bar.add_task(self._name, total=total, completed=stored, rate="")
        if stored < total:
            self._bar.start()
        self._notices.start(total, stored)

    def advance(self, trials: int) -> None:
        self._notices.advance(trials)
        self._bar.advance(self._task, trials)
        if pace := self._notices.pace.measured(self._clock()):
            self._bar.update(self._task, rate=rate_of(*pace))

    def finish(self) -> None:
        self._notices.finish()
        self._bar.stop()
