"""The trials of one unit, as far as they are there: the scores of its metrics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hident.arrays import Array
from hident.engine.expansion import Unit
from hident.engine.results import Series, grouped
from hident.engine.store import Trial, TrialStore
from hident.engine.trial import OF_METRIC
from hident.errors import StoreError


class _Scores:
    """All trials of one metric; nan, and not ``there``, as long as they are missing."""

    def __init__(self, labels: Sequence[str], trials: int) -> None:
        self.labels = labels
        self.values = np.full((len(labels), trials), np.nan)
        self.there = np.zeros(trials, dtype=bool)
        self._failures: dict[int, str] = {}

    def put(self, trial: Trial) -> None:
        if not (0 <= trial.trial < len(self.there) and len(trial.values) == len(self.labels)):
            raise StoreError(
                f"the store gives trial {trial.trial} with {len(trial.values)} values, where trials 0 to "
                f"{len(self.there) - 1} have {len(self.labels)}: {', '.join(self.labels)}"
            )
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


class UnitTrials:
    """One unit with the scores of its metrics, by their names."""

    def __init__(self, unit: Unit, keys: Mapping[str, str], trials: int) -> None:
        self.unit, self.keys, self._trials = unit, keys, trials
        self._scores = {name: _Scores(metric.labels(name), trials) for name, metric in unit.metrics.items()}

    def read(self, store: TrialStore) -> None:
        """Take what is stored."""
        for name, scores in self._scores.items():
            for trial in store.trials(self.keys[name], self._trials):
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
        """Take a trial's score of the metric of this name."""
        self._scores[name].put(trial)

    def series(self) -> Iterator[Series]:
        """The series of all labels of all metrics."""
        for scores in self._scores.values():
            yield from scores.series(self.unit)
