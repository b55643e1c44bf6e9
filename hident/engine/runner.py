"""Running a plan: what is stored is kept, what is missing is computed, chunk by chunk."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from hident.config.spec import Spec, canonical
from hident.engine.experiment import Plan, Unit
from hident.engine.fingerprint import fingerprint, libraries
from hident.engine.results import Results, Series
from hident.engine.store import Store, Trial, Writer
from hident.engine.trial import Data, Job, Outcome, digest, run_trials
from hident.errors import TrialsCrashed

_CHUNK_SECONDS = 0.25
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
    traceback: str

    @property
    def error(self) -> str:
        """The last line of the traceback: the exception and its message."""
        return self.traceback.strip().splitlines()[-1]


@dataclass
class _Case:
    """The units that share one set of data, and the trials that each of them misses."""

    data: Data
    units: list[int]
    wanted: dict[int, list[int]] = field(default_factory=dict)
    seconds: float = 0.0
    """Measured seconds for one trial."""


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
    store: Store,
    executor: Executor,
    workers: int,
    *,
    trials: int,
    seed: int,
    keep_going: bool = False,
    wait_for_store: float = 0.0,
    progress: Progress | None = None,
) -> Results:
    """Compute the missing trials of all units and return all trials.

    Raises
    ------
    TrialsCrashed
        If a trial ended in an error that is not a result; finished trials are kept.
    StoreBusy, StoreError
        If the store is held by another run, or cannot be used.
    KeyboardInterrupt
        After the chunks in flight are stored.
    """
    progress = progress or Silent()
    keys = [unit_key(unit, seed) for unit in plan.units]
    with store.writing(wait_for_store) as writer:
        found = {key: {t.trial for t in done} for key, done in writer.read(keys, trials).items()}
        cases = _cases(plan.units, [found[key] for key in keys], trials)
        done = sum(len(found[key]) for key in keys)
        progress.start(len(keys) * trials, done)
        try:
            if done < len(keys) * trials:
                _compute(plan, keys, cases, writer, executor, workers, seed, keep_going, progress)
        finally:
            progress.finish()
        complete = writer.read(keys, trials)
    series = [
        Series(unit, label, values)
        for unit, key in zip(plan.units, keys, strict=True)
        for label, values in zip(unit.metric_labels, _columns(complete[key]), strict=True)
    ]
    return Results(plan, seed, trials, tuple(series))


def _columns(trials: Sequence[Trial]) -> Any:
    return np.stack([trial.values for trial in trials], axis=1)


def _cases(units: Sequence[Unit], found: Sequence[set[int]], trials: int) -> list[_Case]:
    cases: dict[int, _Case] = {}
    for index, unit in enumerate(units):
        case = cases.setdefault(unit.data.key, _Case(unit.data, []))
        position = len(case.units)
        case.units.append(index)
        for trial in range(trials):
            if trial not in found[index]:
                case.wanted.setdefault(trial, []).append(position)
    return [case for case in cases.values() if case.wanted]


def _compute(
    plan: Plan,
    keys: Sequence[str],
    cases: Iterable[_Case],
    writer: Writer,
    executor: Executor,
    workers: int,
    seed: int,
    keep_going: bool,
    progress: Progress,
) -> None:
    chunks = _chunks(plan.units, cases)
    pending: dict[Future[tuple[list[Outcome], float]], tuple[_Case, int]] = {}
    crashes: list[Crash] = []

    def collect(future: Future[tuple[list[Outcome], float]]) -> None:
        case, size = pending.pop(future)
        if future.cancelled():
            return
        outcomes, seconds = future.result()
        case.seconds = seconds / size
        good = [outcome for outcome in outcomes if not outcome.crash]
        index = {outcome.job: case.units[outcome.job] for outcome in outcomes}
        writer.add(
            {keys[i]: _described(plan, plan.units[i]) for i in index.values()},
            [(keys[index[o.job]], Trial(o.trial, o.values, o.failure)) for o in good],
        )
        crashes.extend(Crash(plan.units[index[o.job]], o.trial, o.crash) for o in outcomes if o.crash)
        progress.advance(len(good))

    try:
        while True:
            while len(pending) < (2 * workers if workers > 1 else 1) and (keep_going or not crashes):
                chunk = next(chunks, None)
                if chunk is None:
                    break
                case, jobs, wanted = chunk
                pending[executor.submit(_timed, case.data, jobs, wanted, seed)] = (case, len(wanted))
            if not pending:
                break
            for future in wait(pending, return_when=FIRST_COMPLETED).done:
                collect(future)
    except KeyboardInterrupt:
        progress.stopping()
        for future in list(pending):
            future.cancel()
        wait(pending)
        for future in list(pending):
            collect(future)
        raise
    except BrokenExecutor:
        raise TrialsCrashed(
            "a worker process was ended from outside, perhaps for want of memory; all finished trials "
            "are kept: run again, with fewer --jobs if memory is short"
        ) from None
    if crashes:
        raise CrashReport(crashes)


class CrashReport(TrialsCrashed):
    """The crashes of a run, with their tracebacks in ``tracebacks``."""

    def __init__(self, crashes: Sequence[Crash]) -> None:
        first = crashes[0]
        more = f" ({len(crashes) - 1} more like it or others)" if len(crashes) > 1 else ""
        super().__init__(
            f"trial {first.trial} of {first.unit.described()} crashed{more}: {first.error}\n"
            "All finished trials are kept; a run after the repair resumes."
        )
        self.tracebacks = "\n".join(
            f"trial {crash.trial} of {crash.unit.described()}\n{crash.traceback}" for crash in crashes
        )


def _chunks(
    units: Sequence[Unit], cases: Iterable[_Case]
) -> Iterator[tuple[_Case, list[Job], dict[int, list[int]]]]:
    """Chunks of about a quarter of a second, judged by the trials of the case that are finished."""
    for case in cases:
        jobs = [Job(units[i].estimator, tuple(units[i].metrics.values())) for i in case.units]
        waiting = list(case.wanted.items())
        while waiting:
            size = int(_CHUNK_SECONDS / case.seconds) if case.seconds else 1
            size = max(1, min(size, _LARGEST_CHUNK))
            yield case, jobs, dict(waiting[:size])
            del waiting[:size]


def _timed(
    data: Data, jobs: Sequence[Job], wanted: dict[int, list[int]], seed: int
) -> tuple[list[Outcome], float]:
    start = time.perf_counter()
    return run_trials(data, jobs, wanted, seed), time.perf_counter() - start


def _described(plan: Plan, unit: Unit) -> dict[str, Any]:
    return {"config": plan.name, "estimator": unit.name, "case": unit.labels}
