"""What a worker is given at once: some trials of one case, as many as take a quarter of a second or more."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hident.engine.clock import Limit
from hident.engine.experiment import Label
from hident.engine.trial import Data, Job, Outcome, run_trials
from hident.engine.unit_trials import UnitTrials

SECONDS = 0.25
"""What a chunk is meant to take, at least."""
# More for each of many workers, so that one process can serve them: to give out a chunk and to store it takes
# that process some milliseconds, with Dask some twenty.
_SECONDS_OF_EACH = 0.04
# Each of its trials and estimators stands alone where its workers die.
_LARGEST = 10_000


def in_common(labels: Iterable[Mapping[str, Label]]) -> dict[str, Label]:
    """The labels of a case: those that all of its units have, as axes of an estimator are not its own."""
    first, *others = [of.items() for of in labels]
    return dict(label for label in first if all(label in of for of in others))


@dataclass
class Case:
    """The units that share one set of data."""

    data: Data
    units: list[UnitTrials] = field(default_factory=list)
    seconds: float = 0.0
    """Measured seconds for one trial."""

    def chunks(self, workers: Callable[[], int]) -> Iterator[Chunk]:
        """What its units lack, in chunks that are judged by the trials that are finished."""
        waiting = np.flatnonzero(np.any([unit.trials_missing() for unit in self.units], axis=0))
        while len(waiting):
            trials, waiting = np.split(waiting, [self._size(len(waiting), max(1, workers()))])
            yield Chunk.of(self, trials.tolist())

    def _size(self, waiting: int, workers: int) -> int:
        """The trials of the next chunk, which become fewer to the end, so that no worker waits long there."""
        if not self.seconds:
            return 1
        of_many = min(_SECONDS_OF_EACH * workers / self.seconds, waiting / (2 * workers))
        return max(1, min(int(max(SECONDS / self.seconds, of_many)), _LARGEST))


@dataclass
class Task:
    """A unit, some of its metrics, and the trials that lack just these."""

    of: UnitTrials
    metrics: tuple[str, ...]
    trials: list[int]


@dataclass
class Chunk:
    """Some trials of a case, as tasks."""

    case: Case
    trials: list[int]
    tasks: list[Task]

    @classmethod
    def of(cls, case: Case, trials: list[int]) -> Chunk:
        """What the case's units lack of the trials, which rise."""
        tasks = [Task(unit, *lacks) for unit in case.units for lacks in unit.lacking(trials)]
        return cls(case, trials, tasks)

    def fields(self) -> dict[str, Any]:
        """What it is of: the labels that all its units have, the estimators, and its trials."""
        return {
            "case": in_common(task.of.unit.labels for task in self.tasks),
            "estimators": [*dict.fromkeys(task.of.unit.name for task in self.tasks)],
            "trials": len(self.trials),
            "first": self.trials[0],
            "last": self.trials[-1],
        }

    def described(self) -> str:
        """The same in words."""
        of = self.fields()
        trials = f"trials {of['first']} to {of['last']}" if of["trials"] > 1 else f"trial {of['first']}"
        at = ", ".join(f"{axis} {label}" for axis, label in of["case"].items())
        return f"{trials} of {', '.join(map(repr, of['estimators']))}" + (f" at {at}" if at else "")

    def jobs(self) -> list[Job]:
        """The tasks as a trial needs them."""
        units = [(task.of.unit, task.metrics) for task in self.tasks]
        return [Job(unit.estimator, tuple(unit.metrics[name] for name in names)) for unit, names in units]

    def wanted(self) -> list[list[int]]:
        """The trials of each job."""
        return [task.trials for task in self.tasks]


def all_chunks(units: Iterable[UnitTrials], workers: Callable[[], int]) -> Iterator[Chunk]:
    """What the units lack: the first chunk of every case, which is one trial, and then case by case.

    So the first trials show what the whole costs, and a case that crashes does so early. ``workers`` says how
    many there are.
    """
    cases: dict[int, Case] = {}
    for unit in units:
        cases.setdefault(unit.unit.data.key, Case(unit.unit.data)).units.append(unit)
    rests = [case.chunks(workers) for case in cases.values()]
    firsts = itertools.chain.from_iterable(itertools.islice(rest, 1) for rest in rests)
    return itertools.chain(firsts, *rests)


def timed(
    data: Data,
    jobs: Sequence[Job],
    wanted: Sequence[Sequence[int]],
    seed: int,
    perturbation: int,
    limit: Limit | None = None,
) -> tuple[list[Outcome], float]:
    """What the jobs give, and the seconds that they took."""
    start = time.perf_counter()
    return run_trials(data, jobs, wanted, seed, perturbation, limit), time.perf_counter() - start
