"""Running a plan: what is stored is kept, what is missing is computed, chunk by chunk."""

from __future__ import annotations

import itertools
import signal
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from hident.config.spec import Spec, canonical
from hident.engine.experiment import Plan, Unit
from hident.engine.fingerprint import fingerprint, libraries
from hident.engine.results import Results, Series
from hident.engine.store import Store, Trial, Writer
from hident.engine.trial import Data, Job, Outcome, digest, run_trials
from hident.errors import StoreError, TrialsCrashed

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


@dataclass
class _Case:
    """The units that share one set of data, and the trials of each that are stored."""

    data: Data
    units: list[int] = field(default_factory=list)
    found: list[set[int]] = field(default_factory=list)
    seconds: float = 0.0
    """Measured seconds for one trial."""

    def wanted(self, trials: int) -> Iterator[tuple[int, list[int]]]:
        """Each trial that some unit misses, with the places of those units."""
        for trial in range(trials):
            missing = [place for place, found in enumerate(self.found) if trial not in found]
            if missing:
                yield trial, missing


def unit_key(unit: Unit, seed: int) -> str:
    """The key of a unit's trials: everything that their numbers depend on, besides the trial."""
    data, metrics = unit.data, tuple(unit.metrics.values())
    parts: tuple[Spec, ...] = (
        data.system,
        data.excitation,
        *data.noise,
        data.streams,
        unit.estimator,
        *metrics,
    )
    return digest(
        {
            "data": canonical(data),
            "estimator": canonical(unit.estimator),
            "metrics": canonical([_numbers(metric) for metric in metrics]),
            "seed": seed,
            "code": fingerprint(parts),
            "libraries": libraries(),
        }
    )


def _numbers(metric: Spec) -> Any:
    """A metric without the names of the estimators that it is for, which change no number."""
    return {name: value for name, value in canonical(metric).items() if name != "estimators"}


def stored(plan: Plan, store: Store, trials: int, seed: int) -> list[int]:
    """For each unit, how many of its trials the store holds."""
    keys = [unit_key(unit, seed) for unit in plan.units]
    found = store.read(keys, trials)
    return [len(found[key]) for key in keys]


def run(
    plan: Plan,
    writer: Writer,
    executor: Executor,
    workers: int,
    *,
    trials: int,
    seed: int,
    keep_going: bool = False,
    progress: Progress | None = None,
) -> Results:
    """Compute the missing trials of all units and return all trials.

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
    keys = [unit_key(unit, seed) for unit in plan.units]
    found = {key: {t.trial for t in writer.trials(key, trials)} for key in keys}
    cases = _cases(plan.units, [found[key] for key in keys])
    done = sum(len(found[key]) for key in keys)
    progress.start(len(keys) * trials, done)
    try:
        _compute(plan, keys, cases, trials, writer, executor, workers, seed, keep_going, progress)
    except BrokenExecutor:
        raise TrialsCrashed(
            "a worker process ended abruptly: it was killed, perhaps for want of memory, or an estimator "
            "ended it.\nAll finished trials are kept: run again, with fewer --jobs if memory is short."
        ) from None
    finally:
        progress.finish()
    series: list[Series] = []
    for unit, key in zip(plan.units, keys, strict=True):
        columns = np.full((len(unit.metric_labels), trials), np.nan)
        failure, read = "", 0
        for trial in writer.trials(key, trials):
            columns[:, trial.trial] = trial.values
            failure, read = failure or trial.failure, read + 1
        if read < trials:
            raise StoreError("the trials store was changed while the run was going: run again")
        series += [
            Series(unit, label, values, failure)
            for label, values in zip(unit.metric_labels, columns, strict=True)
        ]
    return Results(plan, seed, trials, tuple(series))


def _cases(units: Sequence[Unit], found: Sequence[set[int]]) -> list[_Case]:
    cases: dict[int, _Case] = {}
    for index, unit in enumerate(units):
        case = cases.setdefault(unit.data.key, _Case(unit.data))
        case.units.append(index)
        case.found.append(found[index])
    return list(cases.values())


def _compute(
    plan: Plan,
    keys: Sequence[str],
    cases: Iterable[_Case],
    trials: int,
    writer: Writer,
    executor: Executor,
    workers: int,
    seed: int,
    keep_going: bool,
    progress: Progress,
) -> None:
    chunks = _chunks(plan.units, cases, trials)
    # A worker finds its next chunk waiting while this process stores the last one.
    most = 2 * workers if workers > 1 else 1
    pending: dict[Future[tuple[list[Outcome], float]], tuple[_Case, int]] = {}
    crashes: list[Crash] = []

    def submit() -> None:
        while len(pending) < most and (keep_going or not crashes):
            chunk = next(chunks, None)
            if chunk is None:
                return
            case, jobs, wanted = chunk
            pending[executor.submit(_timed, case.data, jobs, wanted, seed)] = (case, len(wanted))

    def collect() -> None:
        done = wait(pending, _POLL_SECONDS, FIRST_COMPLETED).done
        # What is finished is stored before an error ends the run.
        for future in sorted(done, key=lambda future: future.exception() is not None):
            store(*future.result(), *pending.pop(future))

    def store(outcomes: Sequence[Outcome], seconds: float, case: _Case, size: int) -> None:
        case.seconds = seconds / size
        finished = [(case.units[o.job], o) for o in outcomes if not o.crash]
        writer.add(
            {keys[i]: _described(plan, plan.units[i]) for i, _ in finished},
            [(keys[i], Trial(o.trial, o.values, o.failure)) for i, o in finished],
        )
        crashes.extend(
            Crash(plan.units[case.units[o.job]], o.trial, o.failure, o.crash) for o in outcomes if o.crash
        )
        progress.advance(len(finished))

    # Alone, this process is inside a trial at Ctrl-C, and need not wait for another one.
    with _interrupt_deferred() if workers > 1 else nullcontext(threading.Event()) as interrupted:
        submit()
        while pending and not interrupted.is_set():
            collect()
            submit()
        if interrupted.is_set():
            for future in [future for future in pending if future.cancel()]:
                del pending[future]
            if pending:
                progress.stopping()
            while pending:
                collect()
            raise KeyboardInterrupt
    if crashes:
        raise CrashReport(crashes)


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


def _chunks(
    units: Sequence[Unit], cases: Iterable[_Case], trials: int
) -> Iterator[tuple[_Case, list[Job], dict[int, list[int]]]]:
    """Chunks of about a quarter of a second, judged by the trials of the case that are finished."""
    for case in cases:
        jobs = [Job(units[i].estimator, tuple(units[i].metrics.values())) for i in case.units]
        waiting = case.wanted(trials)
        while True:
            size = int(_CHUNK_SECONDS / case.seconds) if case.seconds else 1
            chunk = dict(itertools.islice(waiting, max(1, min(size, _LARGEST_CHUNK))))
            if not chunk:
                break
            yield case, jobs, chunk


def _timed(
    data: Data, jobs: Sequence[Job], wanted: dict[int, list[int]], seed: int
) -> tuple[list[Outcome], float]:
    start = time.perf_counter()
    return run_trials(data, jobs, wanted, seed), time.perf_counter() - start


def _described(plan: Plan, unit: Unit) -> dict[str, Any]:
    return {"config": plan.name, "estimator": unit.name, "case": unit.labels}
