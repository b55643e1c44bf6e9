"""Table I of Mzyk 2009: the configuration that is measured, and its numbers for other ways to compute it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from hident import plugins
from hident.engine.experiment import load
from hident.engine.trial import Data, Job, run_trials

CONFIG = Path("configs/mzyk_table1.yaml")
FEEDBACK = 0.8
H0 = 0.2
Q0 = 8.0
ALPHA = 1.0 / 5.0
HALF_WIDTH = 0.1
LENGTH = 4.0 * math.pi


def cases(*assignments: str) -> list[tuple[Data, list[Job]]]:
    """The data and the jobs of each case, as the runner collects them; ``assignments`` are those of --set."""
    plugins.load()
    found: dict[int, tuple[Data, list[Job]]] = {}
    for unit in load(CONFIG, assignments).units:
        _, jobs = found.setdefault(unit.data.key, (unit.data, []))
        jobs.append(Job(unit.estimator, tuple(unit.metrics.values())))
    return list(found.values())


def scores(data: Data, jobs: list[Job], seed: int, numbers: range) -> list[list[float]]:
    """All scores of each trial: the error of (4), (15) and its a, (7), (16) and its a."""
    outcomes = run_trials(data, jobs, [numbers] * len(jobs), seed)
    columns = [scores.values for outcome in outcomes for scores in outcome.scores]
    found: list[list[float]] = np.concatenate(columns, axis=1).tolist()
    return found
