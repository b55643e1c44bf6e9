"""Running a plan: what is stored is kept, what is missing is computed, chunk by chunk."""

from __future__ import annotations

import itertools
import signal
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hident.arrays import Array
from hident.engine.experiment import Plan, Unit
from hident.engine.results import Results, Series, grouped
from hident.engine.store import Store, Trial, Writer
from hident.engine.trial import OF_METRIC, Data, Job, Outcome, run_trials
from hident.errors import TrialsCrashed

_CHUNK_SECONDS = 0.25
_POLL_SECONDS = 0.1
_LARGEST_CHUNK = 1000


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


@dataclass(frozen=True)
class Crash:
    """An error in a trial that is not a result."""

    unit: Unit
    trial: int
    error: str
    traceback: str


def stored(plan: Plan, store: Store, trials: int, seed: int) -> list[int]:
    """For each unit, how many of its trials the store holds with the scores of all metrics."""
    keys = [unit.keys(seed) for unit in plan.units]
    found = store.read({key for of_unit in keys for key in of_unit.values()}, trials)
    return [complete(found, of_unit) for of_unit in keys]


def complete(found: Mapping[str, Iterable[Trial]], keys: Mapping[str, str]) -> int:
    """How many trials are found under every one of a unit's keys."""
    return len(set.intersection(*({trial.trial for trial in found[key]} for key in keys.values())))


def run(
    plan: Plan,
    writer: Writer,
    executor: Executor,
    workers: int,
    *,
    trials: int,
    seed: int,
    perturbation: int = 0,
    keep_going: bool = False,
    progress: Progress | None = None,
) -> Results:
    """Compute the missing scores of all units and return all trials.

    With a ``perturbation`` k > 0, the records are those of :func:`hident.engine.trial.generate` a last bit
    away, and the scores are stored under keys of their own.

    Raises
    ------
    TrialsCrashed
        If a trial ended in an error that is not a result; finished trials are kept.
    StoreError
        If the store cannot be used.
    KeyboardInterrupt
        At Ctrl-C; with several workers when the chunks in flight are stored, and at a second one at once.
    """
    progress = progress or Silent()
    units = [_UnitTrials(unit, unit.keys(seed, perturbation), trials) for unit in plan.units]
    for unit in units:
        unit.read(writer, trials)
    progress.start(len(units) * trials, sum(unit.complete() for unit in units))
    try:
        _Computation(plan, units, writer, seed, perturbation, progress).go(executor, workers, keep_going)
    except BrokenExecutor:
        raise TrialsCrashed(
            "a worker process ended abruptly: it was killed, perhaps for want of memory, or an estimator "
            "ended it.\nAll finished trials are kept: run again, with fewer --jobs if memory is short."
        ) from None
    finally:
        progress.finish()
    return Results(plan, seed, trials, tuple(series for unit in units for series in unit.series()))


class _Scores:
    """All trials of one metric of one unit; nan, and not ``there``, as long as they are missing."""

    def __init__(self, labels: Sequence[str], trials: int) -> None:
        self.labels = labels
        self.values = np.full((len(labels), trials), np.nan)
        self.there = np.zeros(trials, dtype=bool)
        self._failures: dict[int, str] = {}

    def put(self, trial: Trial) -> None:
        self.values[:, trial.trial] = trial.values
        self.there[trial.trial] = True
        if trial.failure:
            self._failures[trial.trial] = trial.failure

    def series(self, unit: Unit) -> Iterator[Series]:
        for label, values in zip(self.labels, self.values, strict=True):
            yield Series(unit, label, values, grouped(self._reasons(label, values)))

    def _reasons(self, label: str, values: Array) -> Iterator[str]:
        for trial in np.flatnonzero(~np.isfinite(values)):
            failure = self._failures.get(int(trial)) or f"{OF_METRIC}the value is {values[trial]}"
            yield f"{label}: {failure.removeprefix(OF_METRIC)}" if failure.startswith(OF_METRIC) else failure


class _UnitTrials:
    """One unit with the scores of its metrics, by their names."""

    def __init__(self, unit: Unit, keys: Mapping[str, str], trials: int) -> None:
        self.unit, self.keys = unit, keys
        self._scores = {name: _Scores(metric.labels(name), trials) for name, metric in unit.metrics.items()}

    def read(self, writer: Writer, trials: int) -> None:
        for name, scores in self._scores.items():
            for trial in writer.trials(self.keys[name], trials):
                scores.put(trial)

    def complete(self) -> int:
        """How many trials have the scores of all metrics."""
        return int((~self.trials_missing()).sum())

    def missing(self, trial: int) -> tuple[str, ...]:
        """The metrics that the trial lacks."""
        return tuple(name for name, scores in self._scores.items() if not scores.there[trial])

    def trials_missing(self) -> NDArray[np.bool_]:
        """Whether each trial lacks any metric."""
        missing: NDArray[np.bool_] = np.any([~scores.there for scores in self._scores.values()], axis=0)
        return missing

    def put(self, name: str, trial: Trial) -> None:
        self._scores[name].put(trial)

    def series(self) -> Iterator[Series]:
        for scores in self._scores.values():
            yield from scores.series(self.unit)


@dataclass
class _Case:
    """The units that share one set of data."""

    data: Data
    units: list[_UnitTrials] = field(default_factory=list)
    seconds: float = 0.0
    """Measured seconds for one trial."""


@dataclass
class _Chunk:
    """Some trials of a case: each task is a unit with the metrics that some of them lack."""

    case: _Case
    tasks: list[tuple[_UnitTrials, tuple[str, ...]]]
    wanted: dict[int, list[int]]
    """For each trial the tasks that it is for."""

    @classmethod
    def of(cls, case: _Case, trials: Iterable[int]) -> _Chunk:
        places: dict[tuple[int, tuple[str, ...]], int] = {}
        wanted = {
            trial: [
                places.setdefault((i, missing), len(places))
                for i, unit in enumerate(case.units)
                if (missing := unit.missing(trial))
            ]
            for trial in trials
        }
        return cls(case, [(case.units[i], missing) for i, missing in places], wanted)

    def jobs(self) -> list[Job]:
        return [
            Job(task.unit.estimator, tuple(task.unit.metrics[name] for name in names))
            for task, names in self.tasks
        ]


class _Computation:
    """What is missing, computed chunk by chunk and stored as it comes."""

    def __init__(
        self,
        plan: Plan,
        units: Sequence[_UnitTrials],
        writer: Writer,
        seed: int,
        perturbation: int,
        progress: Progress,
    ) -> None:
        self._plan, self._writer, self._progress = plan, writer, progress
        self._seed, self._perturbation = seed, perturbation
        cases: dict[int, _Case] = {}
        for unit in units:
            cases.setdefault(unit.unit.data.key, _Case(unit.unit.data)).units.append(unit)
        self._chunks = itertools.chain.from_iterable(map(_chunks, cases.values()))
        self._pending: dict[Future[tuple[list[Outcome], float]], _Chunk] = {}
        self._crashes: list[Crash] = []

    def go(self, executor: Executor, workers: int, keep_going: bool) -> None:
        """Compute until nothing is missing, or a crash or Ctrl-C ends it."""
        # A worker finds its next chunk waiting while this process stores the last one.
        most = 2 * workers if workers > 1 else 1
        # Alone, this process is inside a trial at Ctrl-C, and need not wait for another one.
        with _interrupt_deferred() if workers > 1 else nullcontext(threading.Event()) as interrupted:
            self._submit(executor, most, keep_going)
            while self._pending and not interrupted.is_set():
                self._collect()
                self._submit(executor, most, keep_going)
            if interrupted.is_set():
                self._stop()
                raise KeyboardInterrupt
        if self._crashes:
            raise CrashReport(self._crashes)

    def _submit(self, executor: Executor, most: int, keep_going: bool) -> None:
        while len(self._pending) < most and (keep_going or not self._crashes):
            chunk = next(self._chunks, None)
            if chunk is None:
                return
            arguments = (chunk.case.data, chunk.jobs(), chunk.wanted, self._seed, self._perturbation)
            self._pending[executor.submit(_timed, *arguments)] = chunk

    def _collect(self) -> None:
        done = wait(self._pending, _POLL_SECONDS, FIRST_COMPLETED).done
        # What is finished is stored before an error ends the run.
        for future in sorted(done, key=lambda future: future.exception() is not None):
            outcomes, seconds = future.result()
            chunk = self._pending.pop(future)
            chunk.case.seconds = seconds / len(chunk.wanted)
            self._keep(chunk, outcomes)

    def _stop(self) -> None:
        """Give up what no worker has begun, and keep what is in flight."""
        for future in [future for future in self._pending if future.cancel()]:
            del self._pending[future]
        if self._pending:
            self._progress.stopping()
        while self._pending:
            self._collect()

    def _keep(self, chunk: _Chunk, outcomes: Sequence[Outcome]) -> None:
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
        self._writer.add(described, rows)
        self._progress.advance(finished)


def _chunks(case: _Case) -> Iterator[_Chunk]:
    """Chunks of about a quarter of a second, judged by the trials of the case that are finished."""
    waiting = map(int, np.flatnonzero(np.any([u.trials_missing() for u in case.units], axis=0)))
    while True:
        size = int(_CHUNK_SECONDS / case.seconds) if case.seconds else 1
        trials = list(itertools.islice(waiting, max(1, min(size, _LARGEST_CHUNK))))
        if not trials:
            return
        yield _Chunk.of(case, trials)


def _timed(
    data: Data, jobs: Sequence[Job], wanted: dict[int, list[int]], seed: int, perturbation: int
) -> tuple[list[Outcome], float]:
    start = time.perf_counter()
    return run_trials(data, jobs, wanted, seed, perturbation), time.perf_counter() - start


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


class CrashReport(TrialsCrashed):
    """The crashes of a run, with their tracebacks in ``tracebacks``."""

    def __init__(self, crashes: Sequence[Crash]) -> None:
        first = crashes[0]
        more = f" (and {len(crashes) - 1} more)" if len(crashes) > 1 else ""
        super().__init__(
            f"trial {first.trial} of {first.unit.described()} crashed{more}: {first.error}\n"
            "All finished trials are kept; a run after the repair resumes."
        )
        self.tracebacks = "\n".join(
            f"trial {crash.trial} of {crash.unit.described()}\n{crash.traceback}" for crash in crashes
        )
