"""Outcomes of jobs, told trial by trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hident.arrays import Array
from hident.engine.clock import Limit
from hident.engine.trial import Data, Job, Outcome, run_trials


@dataclass(frozen=True, eq=False)
class Score:
    """What one metric gave in one trial; of a crash, its message and its traceback."""

    values: Array
    failure: str = ""
    crash: str = ""
    late: bool = False


@dataclass(frozen=True, eq=False)
class Tried:
    """What one job gave in one trial: a score for each of its metrics."""

    job: int
    trial: int
    scores: list[Score]

    @property
    def values(self) -> Array:
        """The numbers of all metrics, one after the other."""
        return np.concatenate([score.values for score in self.scores])


def tried(
    data: Data,
    jobs: Sequence[Job],
    wanted: Mapping[int, Sequence[int]],
    seed: int,
    limit: Limit | None = None,
) -> list[Tried]:
    """What the jobs give in the trials that want them."""
    trials = [sorted(trial for trial, of in wanted.items() if job in of) for job in range(len(jobs))]
    outcomes = run_trials(data, jobs, trials, seed, limit=limit)
    return [_tried(job, trial, outcomes[job]) for trial, of in wanted.items() for job in of]


def _tried(job: int, trial: int, outcome: Outcome) -> Tried:
    found = []
    for scores, late in zip(outcome.scores, outcome.late, strict=True):
        for of, is_late in ((scores, False), (late, True)):
            if trial in of.trials:
                [values] = of.values[of.trials == trial]
                found.append(Score(values, of.failures.get(trial, ""), late=is_late))
                break
        else:
            found.append(Score(np.empty(0), *outcome.crashes[trial]))
    return Tried(job, trial, found)
