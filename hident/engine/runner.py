"""Running a plan: what is stored is kept, what is missing is computed, chunk by chunk."""

from __future__ import annotations

import gc
import threading
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from hident import stopping
from hident.config.suggest import counted
from hident.engine.chunks import Chunk, all_chunks
from hident.engine.clock import Limit
from hident.engine.executors import Given, SerialExecutor, WorkerDied, Workers, WorkersGone
from hident.engine.experiment import Plan, Unit
from hident.engine.log import tell, warn
from hident.engine.lost import Attempt, Queue
from hident.engine.results import Results
from hident.engine.scores import Scores
from hident.engine.store import MemoryStore, Reader, Store, TrialStore, Writer
from hident.engine.timing import timings
from hident.engine.trial import Outcome
from hident.engine.unit_trials import Recent, UnitTrials
from hident.engine.work import Done, Terms, compute
from hident.errors import ConfigError, TrialsCrashed

_POLL_SECONDS = 0.1
_HELD = 8_000_000
"""How many numbers of a run are held in memory; of more, those that were asked for last."""
# So long an executor that is broken may take to say what becomes of each call.
_SECONDS_TO_BREAK = 60
# So often in a row workers may be lost while they have nothing to do.
_IDLE_LOSSES = 3


class Progress(Protocol):
    """What a run tells about itself."""

    def start(self, total: int, stored: int) -> None:
        """The run wants ``total`` trials of units, of which ``stored`` are there already."""

    def begins(self, work: str) -> None:
        """Some trials, which ``work`` names, are given to a worker; it may begin them later."""

    def ends(self, work: str) -> None:
        """They came back."""

    def advance(self, trials: int) -> None:
        """This many more are stored."""

    def stopping(self) -> None:
        """The run was interrupted, and waits for the chunks in flight."""

    def finish(self) -> None:
        """The run ended, in whatever way."""


class Silent:
    """A run that tells nothing."""

    def start(self, total: int, stored: int) -> None: ...

    def begins(self, work: str) -> None: ...

    def ends(self, work: str) -> None: ...

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

    With a rule in the place of a number of trials, a run goes on from decision to decision, and the plan of
    the results has the trials of the last one. What it decides by is the trials alone, not the workers.

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
    # What an earlier run has met is not of this one.
    executor.others.clear()
    before: _Run | None = None
    for number in plan.decisions:
        one = _Run(plan.upto(number), store, kept, executor, keep_going, progress or Silent(), before)
        results, before = one.results(), one
        imprecise = results.imprecise()
        if plan.rule is not None:
            after = f"{plan.name}: after {counted(number, 'trial')}"
            said = f"{after}, {len(imprecise)} of its series are not precise yet"
            tell("decision", said, config=plan.name, trials=number, imprecise=len(imprecise))
        if not imprecise:
            break
    return replace(results, how=executor.used)


class _Run:
    """One round of a run of a plan, from what is stored to the results; ``before`` is the round before."""

    def __init__(
        self,
        plan: Plan,
        store: TrialStore,
        kept: bool,
        workers: Workers,
        keep_going: bool,
        progress: Progress,
        before: _Run | None,
    ) -> None:
        self._plan, self._store, self._kept = plan, store, kept
        self._workers, self._keep_going, self._progress = workers, keep_going, progress
        numbers = plan.trials * sum(len(unit.metric_labels) for unit in plan.units)
        recent = Recent(_HELD) if numbers > _HELD else None
        self._units = [
            UnitTrials(*of, plan.trials, store, recent)
            for of in zip(plan.units, plan.keys, plan.timing_keys, strict=True)
        ]
        self._before = before
        # Made one by one, as they are asked for.
        self._queue = Queue(all_chunks(self._units, lambda: workers.count))
        self._pending: dict[Future[Done], Attempt] = {}
        self._idle_losses = 0
        self._crashes: list[Crash] = []
        self._limit = Limit.of(plan.trial_timeout)
        self._late: int = before._late if before else 0

    def results(self) -> Results:
        """Read what is stored, compute the rest."""
        self._store.add(self._described(), ())
        for unit in self._units:
            unit.read()
        for unit, earlier in zip(self._units, self._before._units if self._before else (), strict=False):
            unit.take_not_stored(earlier)
        self._before = None
        with self._told():
            try:
                self._compute()
            except BrokenExecutor:
                raise WorkerEnded(kept=self._kept) from None
            except (WorkersGone, CancelledError) as gone:
                why = f"{gone}" or "the executor has cancelled calls of the run"
                raise TrialsCrashed(f"{why}.\n{_fate(kept=self._kept)}: run again.") from None
            if self._crashes:
                raise CrashReport(self._crashes, kept=self._kept)
        return Results(
            self._plan,
            tuple(series for unit in self._units for series in unit.series()),
            self._late,
            timings(self._plan, self._store),
        )

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Tell how the run begins and how it ends."""
        total, stored = len(self._units) * self._plan.trials, sum(unit.complete() for unit in self._units)
        of = {"config": self._plan.name, "perturbation": self._plan.perturbation}
        self._progress.start(total, stored)
        said = f"{self._plan.name}: {counted(total, 'trial')}, {stored} of them stored"
        tell("start", said, **of, total=total, stored=stored, workers=self._workers.count)
        try:
            yield
        except BaseException as error:
            said = f"{self._plan.name}: ended by {type(error).__name__}: {error}"
            warn("end", said, **of, outcome=type(error).__name__)
            raise
        finally:
            self._progress.finish()
        there = f"{'all ' * (total != 1)}{counted(total, 'trial', 'are')} there"
        tell("end", f"{self._plan.name}: {there}", **of, outcome="finished")

    def _described(self) -> dict[str, Any]:
        """What the keys stand for."""
        return {
            key: {"config": self._plan.name, "estimator": unit.unit.name, "case": unit.unit.labels, **of}
            for unit in self._units
            for key, of in (
                *((key, {"metric": metric}) for metric, key in unit.keys.items()),
                (unit.timing_key, {"seconds": "of a fit"}),
            )
        }

    def _compute(self) -> None:
        """Go on until nothing is missing, or a crash or Ctrl-C ends it."""
        if not self._queue:
            return
        self._workers.start()
        # Alone, this process is inside a trial at Ctrl-C, and need not wait for another one.
        alone = nullcontext(threading.Event())
        with _loaded_for_good(), stopping.deferred() if self._workers.most > 1 else alone as interrupted:
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
            chunk, of = attempt.chunk, (self._plan.seed, self._plan.perturbation, self._limit)
            # Before: an executor without workers is in the trials until it returns.
            self._progress.begins(chunk.described())
            try:
                future = self._workers.submit(compute, chunk.case.data, chunk.jobs(), chunk.wanted(), *of)
            except BrokenExecutor:
                self._progress.ends(chunk.described())
                self._queue.back(attempt)
                self._renew()
            else:
                self._pending[future] = attempt

    def _collect(self) -> None:
        done = wait(self._pending, _POLL_SECONDS, FIRST_COMPLETED).done
        self._take(done)
        if any(_has_failed(future) and isinstance(future.exception(), BrokenExecutor) for future in done):
            self._renew()

    def _take(self, futures: Iterable[Future[Done]]) -> None:
        """Keep what is finished, before an error ends the run; leave what was lost with a broken executor."""
        for future in sorted(futures, key=_has_failed):
            try:
                done = future.result()
            except BrokenExecutor:
                continue
            except WorkerDied as died:
                self._lost(self._pending.pop(future), died.deaths, "")
                continue
            if not isinstance(done, Done):
                raise ConfigError(f"executor: gave no answer of the call that it was given (got {done!r})")
            chunk = self._pending.pop(future).chunk
            chunk.case.seconds = done.seconds / len(chunk.trials)
            self._idle_losses = 0
            self._workers.compare(done.arithmetic, done.worker)
            self._keep(chunk, done.outcomes)
            self._progress.ends(chunk.described())
            said = f"{self._plan.name}: {chunk.described()}: {done.seconds:.3f} s"
            took = {"seconds": round(done.seconds, 6), "worker": done.worker}
            tell("chunk", said, config=self._plan.name, **chunk.fields(), **took)

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
        chunk = attempt.chunk
        self._progress.ends(chunk.described())
        said = f"its worker process ended abruptly{how and f' ({how})'}"
        again = self._queue.died(attempt, deaths)
        fate = "sent again" if again else "given up"
        text = f"{self._plan.name}: {chunk.described()}: {said}; {fate}"
        warn("worker lost", text, config=self._plan.name, **chunk.fields(), how=how, again=again)
        if not again:
            [task], [trial] = chunk.tasks, chunk.trials
            self._crashes.append(Crash(task.of.unit, trial, said, f"{said}\n"))

    def _stop(self) -> None:
        """Give up what no worker has begun, and keep what is in flight."""
        warn("interrupt", f"{self._plan.name}: interrupted", config=self._plan.name)
        for future in [future for future in self._pending if future.cancel()]:
            del self._pending[future]
        if self._pending:
            self._progress.stopping()
        while self._pending:
            self._collect()

    def _keep(self, chunk: Chunk, outcomes: Sequence[Outcome]) -> None:
        rows: list[tuple[str, Scores]] = []
        finished = 0
        for task, outcome in zip(chunk.tasks, outcomes, strict=True):
            unit = task.of.unit
            late: dict[int, str] = {}
            if outcome.seconds.trials.size:
                # Seven digits of a time are enough, and take half the room in the store.
                taken = outcome.seconds.values.astype(np.float32).astype(float)
                rows.append((task.of.timing_key, replace(outcome.seconds, values=taken)))
            for name, scores, of_late in zip(task.metrics, outcome.scores, outcome.late, strict=True):
                rows.append((task.of.keys[name], scores))
                task.of.put(name, scores)
                task.of.put(name, of_late, stored=False)
                late |= of_late.failures
            for trial in sorted(late):
                self._fault("timed out", unit, trial, late[trial])
            for trial in sorted(outcome.crashes):
                self._crashes.append(Crash(unit, trial, *outcome.crashes[trial]))
                self._fault("crash", unit, trial, outcome.crashes[trial].error)
            self._late += len(late)
            finished += len(task.trials) - len(outcome.crashes)
        self._store.add({}, rows)
        self._progress.advance(finished)

    def _fault(self, event: str, unit: Unit, trial: int, reason: str) -> None:
        """Tell the log what went wrong in a trial."""
        said = f"{self._plan.name}: trial {trial} of {unit.described()}: {reason}"
        of = {"config": self._plan.name, "case": unit.labels, "estimator": unit.name, "trial": trial}
        warn(event, said, **of, reason=reason)


def _has_failed(future: Future[Done]) -> bool:
    return future.cancelled() or future.exception() is not None


@contextmanager
def _loaded_for_good() -> Iterator[None]:
    """Let the garbage collector pass over all that is there already.

    Trials make so many small objects that it comes often, and beside them all that is loaded is much: to look
    through that again and again took a third of the time of short trials.
    """
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


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
    with store.reading() as reader:
        return _stored(plan, reader)


def _stored(plan: Plan, reader: Reader) -> list[int]:
    return [complete(reader, keys.values(), plan.trials) for keys in plan.keys]


def mended(plan: Plan, writer: Writer) -> str:
    """What was saved of a damaged store, and of the trials of a plan; empty if the store was sound."""
    if not writer.mended:
        return ""
    now = reached(plan, writer)
    saved, total = sum(_stored(now, writer)), now.trials * len(now.units)
    return f"{writer.mended}; {saved} of the {counted(total, 'trial')} of {plan.name} are saved"


def reached(plan: Plan, reader: Reader) -> Plan:
    """The plan up to the decision at which a run would stand that has computed what is stored, and no more.

    Without a rule that is the plan itself, and nothing is read.
    """
    now = plan
    for number in plan.decisions if plan.rule else ():
        now = plan.upto(number)
        if any(complete(reader, keys.values(), number) < number for keys in now.keys):
            break
        if number < plan.decisions[-1] and not _read(now, reader).imprecise():
            break
    return now


def _read(plan: Plan, reader: Reader) -> Results:
    """The results of a plan all of whose trials are stored."""
    units = [
        UnitTrials(*of, plan.trials, reader)
        for of in zip(plan.units, plan.keys, plan.timing_keys, strict=True)
    ]
    for unit in units:
        unit.read()
    return Results(plan, tuple(series for unit in units for series in unit.series()))


def complete(store: Reader, keys: Iterable[str], trials: int) -> int:
    """How many trials a store holds under every one of a unit's keys."""
    there = np.ones(trials, dtype=bool)
    for key in keys:
        of_key = np.zeros(trials, dtype=bool)
        for scores in store.trials(key, trials):
            of_key[scores.trials] = True
        there &= of_key
    return int(there.sum())
