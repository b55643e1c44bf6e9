"""What a worker is given at once: some trials of one case, as many as take about a quarter of a second."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hident.engine.clock import Limit
from hident.engine.experiment import Label
from hident.engine.trial import Data, Job, Outcome, run_trials
from hident.engine.unit_trials import UnitTrials

_SECONDS = 0.25
_LARGEST = 1000


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

    def chunks(self) -> Iterator[Chunk]:
        """What its units lack, in chunks that are judged by the trials that are finished."""
        waiting = map(int, np.flatnonzero(np.any([u.trials_missing() for u in self.units], axis=0)))
        while True:
            size = int(_SECONDS / self.seconds) if self.seconds else 1
            trials = list(itertools.islice(waiting, max(1, min(size, _LARGEST))))
            if not trials:
                return
            yield Chunk.of(self, trials)


@dataclass
class Chunk:
    """Some trials of a case: each task is a unit with the metrics that some of them lack."""

    case: Case
    tasks: list[tuple[UnitTrials, tuple[str, ...]]]
    wanted: dict[int, list[int]]
    """For each trial the tasks that it is for."""

    @classmethod
    def of(cls, case: Case, trials: Iterable[int]) -> Chunk:
        """What the case's units lack of the trials."""
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

    def fields(self) -> dict[str, Any]:
        """What it is of: the labels that all its units have, the estimators, and its trials."""
        return {
            "case": in_common(unit.unit.labels for unit, _ in self.tasks),
            "estimators": [*dict.fromkeys(unit.unit.name for unit, _ in self.tasks)],
            "trials": len(self.wanted),
            "first": min(self.wanted),
            "last": max(self.wanted),
        }

    def described(self) -> str:
        """The same in words."""
        of = self.fields()
        trials = f"trials {of['first']} to {of['last']}" if of["trials"] > 1 else f"trial {of['first']}"
        at = ", ".join(f"{axis} {label}" for axis, label in of["case"].items())
        return f"{trials} of {', '.join(map(repr, of['estimators']))}" + (f" at {at}" if at else "")

    def jobs(self) -> list[Job]:
        """The tasks as a trial needs them."""
        return [
            Job(task.unit.estimator, tuple(task.unit.metrics[name] for name in names))
            for task, names in self.tasks
        ]


def all_chunks(units: Iterable[UnitTrials]) -> Iterator[Chunk]:
    """What the units lack: the first chunk of every case, which is one trial, and then case by case.

    So the first trials show what the whole costs, and a case that crashes does so early.
    """
    cases: dict[int, Case] = {}
    for unit in units:
        cases.setdefault(unit.unit.data.key, Case(unit.unit.data)).units.append(unit)
    rests = [case.chunks() for case in cases.values()]
    firsts = itertools.chain.from_iterable(itertools.islice(rest, 1) for rest in rests)
    return itertools.chain(firsts, *rests)


def timed(
    data: Data,
    jobs: Sequence[Job],
    wanted: dict[int, list[int]],
    seed: int,
    perturbation: int,
    limit: Limit | None = None,
) -> tuple[list[Outcome], float]:
    """What the trials give, and the seconds that they took."""
    start = time.perf_counter()
    return run_trials(data, jobs, wanted, seed, perturbation, limit), time.perf_counter() - start
