"""Running a plan: what is stored is kept, what is missing is computed, chunk by chunk."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any, Protocol

from hident.engine.chunks import Chunk, all_chunks
from hident.engine.executors import Given, SerialExecutor, WorkerDied, Workers, WorkersGone
from hident.engine.experiment import Plan, Unit
from hident.engine.lost import Attempt, Queue
from hident.engine.results import Results
from hident.engine.store import MemoryStore, Store, Trial, TrialStore
from hident.engine.trial import Outcome
from hident.engine.unit_trials import UnitTrials
from hident.engine.work import Done, Terms, compute
from hident.errors import TrialsCrashed

_POLL_SECONDS = 0.1
# So long an executor that is broken may take to say what becomes of each call.
_SECONDS_TO_BREAK = 60
# So often in a row workers may be lost while they have nothing to do.
_IDLE_LOSSES = 3


class Progress(Protocol):
    """What a run tells about itself."""

    def start(self, total: int, stored: int) -> None:
        """The run wants ``total`` trials of units, of which ``stored`` are there already."""

    def advance(self, trials: int) -> None:
        """This many more are stored."""

    def stopping(self) -> None:
        """The run was interrupted, and waits for the chunks in flight."""

    def finish(self) -> None:
        """The run ended, in whatever way."""


class Silent:
    """A run that tells nothing."""

    def start(self, total: int, stored: int) -> None: ...

    def advance(self, trials: int) -> None: ...

    def stopping(self) -> None: ...

    def finish(self) -> None: ...


def run(
    plan: Plan,
    *,
    store: TrialStore | None = None,
    executor: Executor | None = None,
    workers: int = 1,
    keep_going: bool = False,
    progress: Progress | None = None,
) -> Results:
    """Compute the missing scores of all units and return all trials.

    Parameters
    ----------
    plan : Plan
        With its seed, its number of trials and its perturbation.
    store : TrialStore, optional
        Where scores are kept: what :meth:`Store.writing` gives, or a :class:`MemoryStore`; by default, one
        that ends with the run.
    executor : Executor, optional
        Where trials are computed; this process by default.
    workers : int
        How many calls the executor makes at once, if it is none of :mod:`hident.engine.executors`.
    keep_going : bool
        Whether the other trials are computed after a crash.
    progress : Progress, optional
        Whom the run tells about itself.

    Raises
    ------
    TrialsCrashed
        If a trial ended in an error that is not a result, or three worker processes with it, or if there are
        no workers any more; finished ones are kept if there is a store.
    ConfigError
        If a worker lacks what it must have in common with this process.
    StoreError
        If the store cannot be used.
    KeyboardInterrupt
        At Ctrl-C; with several workers when the chunks in flight are stored, and at a second one at once.
    """
    kept = store is not None
    store = MemoryStore() if store is None else store
    if executor is None:
        executor = SerialExecutor()
    elif not isinstance(executor, Workers):
        executor = Given(executor, workers, Terms.anywhere(plan.plugin_files, [plan]))
    return _Run(plan, store, kept, executor, keep_going, progress or Silent()).results()


class _Run:
    """One run of a plan, from what is stored to the results."""

    def __init__(
        self,
        plan: Plan,
        store: TrialStore,
        kept: bool,
        workers: Workers,
        keep_going: bool,
        progress: Progress,
    ) -> None:
        self._plan, self._store, self._kept = plan, store, kept
        self._workers, self._keep_going, self._progress = workers, keep_going, progress
        self._units = [UnitTrials(*of, plan.trials) for of in zip(plan.units, plan.keys, strict=True)]
        # Made one by one, as they are asked for.
        self._queue = Queue(all_chunks(self._units))
        self._pending: dict[Future[Done], Attempt] = {}
        self._idle_losses = 0
        self._crashes: list[Crash] = []

    def results(self) -> Results:
        """Read what is stored, compute the rest."""
        for unit in self._units:
            unit.read(self._store)
        self._progress.start(
            len(self._units) * self._plan.trials, sum(unit.complete() for unit in self._units)
        )
        try:
            self._compute()
        except BrokenExecutor:
            raise WorkerEnded(kept=self._kept) from None
        except WorkersGone as gone:
            raise TrialsCrashed(
                f"{gone}, and its workers with it.\n{_fate(kept=self._kept)}: run again."
            ) from None
        finally:
            self._progress.finish()
        if self._crashes:
            raise CrashReport(self._crashes, kept=self._kept)
        return Results(self._plan, tuple(series for unit in self._units for series in unit.series()))

    def _compute(self) -> None:
        """Go on until nothing is missing, or a crash or Ctrl-C ends it."""
        # What an earlier run has met is not of this one.
        self._workers.others.clear()
        if not self._queue:
            return
        self._workers.start()
        # Alone, this process is inside a trial at Ctrl-C, and need not wait for another one.
        alone = nullcontext(threading.Event())
        with _interrupt_deferred() if self._workers.most > 1 else alone as interrupted:
            self._submit()
            while self._pending and not interrupted.is_set():
                self._collect()
                self._submit()
            if interrupted.is_set():
                self._stop()
                raise KeyboardInterrupt

    def _submit(self) -> None:
        while len(self._pending) < self._workers.most and (self._keep_going or not self._crashes):
            attempt = self._queue.take(len(self._pending))
            if attempt is None:
                return
            chunk, of = attempt.chunk, (self._plan.seed, self._plan.perturbation)
            try:
                future = self._workers.submit(compute, chunk.case.data, chunk.jobs(), chunk.wanted, *of)
            except BrokenExecutor:
                self._queue.back(attempt)
                self._renew()
            else:
                self._pending[future] = attempt

    def _collect(self) -> None:
        done = wait(self._pending, _POLL_SECONDS, FIRST_COMPLETED).done
        self._take(done)
        if any(isinstance(future.exception(), BrokenExecutor) for future in done):
            self._renew()

    def _take(self, futures: Iterable[Future[Done]]) -> None:
        """Keep what is finished, before an error ends the run; leave what was lost with a broken executor."""
        for future in sorted(futures, key=lambda future: future.exception() is not None):
            try:
                done = future.result()
            except BrokenExecutor:
                continue
            except WorkerDied as died:
                self._lost(self._pending.pop(future), died.deaths, "")
                continue
            chunk = self._pending.pop(future).chunk
            chunk.case.seconds = done.seconds / len(chunk.wanted)
            self._idle_losses = 0
            self._workers.compare(done.arithmetic, done.worker)
            self._keep(chunk, done.outcomes)

    def _renew(self) -> None:
        """Others take the place of the workers; whatever these had is lost with them."""
        self._take(wait(self._pending, _SECONDS_TO_BREAK).done)
        self._idle_losses += not self._pending
        if self._idle_losses >= _IDLE_LOSSES:
            raise BrokenExecutor
        how = self._workers.renew()
        lost = [*self._pending.values()]
        self._pending.clear()
        for attempt in lost:
            self._lost(attempt, 1, how)
        self._workers.start()

    def _lost(self, attempt: Attempt, deaths: int, how: str) -> None:
        if not self._queue.died(attempt, deaths):
            [(task, _)], [trial] = attempt.chunk.tasks, attempt.chunk.wanted
            said = f"its worker process ended abruptly{how and f' ({how})'}"
            self._crashes.append(Crash(task.unit, trial, said, f"{said}\n"))

    def _stop(self) -> None:
        """Give up what no worker has begun, and keep what is in flight."""
        for future in [future for future in self._pending if future.cancel()]:
            del self._pending[future]
        if self._pending:
            self._progress.stopping()
        while self._pending:
            self._collect()

    def _keep(self, chunk: Chunk, outcomes: Sequence[Outcome]) -> None:
        described: dict[str, Any] = {}
        rows: list[tuple[str, Trial]] = []
        finished = 0
        for outcome in outcomes:
            task, names = chunk.tasks[outcome.job]
            crash = None
            for name, score in zip(names, outcome.scores, strict=True):
                if score.crash:
                    crash = crash or Crash(task.unit, outcome.trial, score.failure, score.crash)
                    continue
                trial = Trial(outcome.trial, score.values, score.failure)
                described[task.keys[name]] = _described(self._plan, task.unit, name)
                rows.append((task.keys[name], trial))
                task.put(name, trial)
            if crash:
                self._crashes.append(crash)
            else:
                finished += 1
        self._store.add(described, rows)
        self._progress.advance(finished)


def _described(plan: Plan, unit: Unit, metric: str) -> dict[str, Any]:
    return {"config": plan.name, "estimator": unit.name, "case": unit.labels, "metric": metric}


@contextmanager
def _interrupt_deferred() -> Iterator[threading.Event]:
    """The first Ctrl-C sets the event instead of raising KeyboardInterrupt; the next one raises it."""
    event = threading.Event()
    usual = signal.default_int_handler
    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or signal.getsignal(signal.SIGINT) is not usual:
        yield event
        return

    def first(number: int, frame: object) -> None:
        signal.signal(signal.SIGINT, usual)
        event.set()

    signal.signal(signal.SIGINT, first)
    try:
        yield event
    finally:
        signal.signal(signal.SIGINT, usual)


def _fate(*, kept: bool) -> str:
    return "All finished trials are kept" if kept else "Without a store no trial is kept"


@dataclass(frozen=True)
class Crash:
    """An error in a trial that is not a result."""

    unit: Unit
    trial: int
    error: str
    traceback: str


class CrashReport(TrialsCrashed):
    """The crashes of a run, with their tracebacks in ``tracebacks``."""

    def __init__(self, crashes: Sequence[Crash], *, kept: bool) -> None:
        first = crashes[0]
        more = f" (and {len(crashes) - 1} more)" if len(crashes) > 1 else ""
        super().__init__(
            f"trial {first.trial} of {first.unit.described()} crashed{more}: {first.error}\n"
            + (
                "All finished trials are kept; a run after the repair resumes."
                if kept
                else "Without a store no trial is kept; with one, a run after the repair resumes."
            )
        )
        self.tracebacks = "\n".join(
            f"trial {crash.trial} of {crash.unit.described()}\n{crash.traceback}" for crash in crashes
        )


class WorkerEnded(TrialsCrashed):
    """A worker process ended abruptly, with the trials that it had.

    ``kept`` says whether a store has the others, ``in_python`` whether a script may have started the run.
    """

    def __init__(self, *, kept: bool, in_python: bool = False) -> None:
        script = (
            ", or it ran the script that started it from the top, as each worker does, where the call is not "
            'under `if __name__ == "__main__":`'
        )
        super().__init__(
            "a worker process ended abruptly: it was killed, perhaps for want of memory, or an estimator "
            f"ended it{script if in_python else ''}.\n{_fate(kept=kept)}: run again, with fewer "
            f"{'workers' if in_python else '--jobs'} if memory is short."
        )
        self.kept = kept


def stored(plan: Plan, store: Store) -> list[int]:
    """For each unit, how many of its trials the store holds with the scores of all metrics."""
    found = store.read({key for keys in plan.keys for key in keys.values()}, plan.trials)
    return [complete(found, keys) for keys in plan.keys]


def complete(found: Mapping[str, Iterable[Trial]], keys: Mapping[str, str]) -> int:
    """How many trials are found under every one of a unit's keys."""
    return len(set.intersection(*({trial.trial for trial in found[key]} for key in keys.values())))
