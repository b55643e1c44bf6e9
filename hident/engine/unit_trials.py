"""The trials of one unit, as far as they are there: the scores of its metrics."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hident.arrays import Array
from hident.engine.expansion import Unit
from hident.engine.results import Series, grouped
from hident.engine.scores import Scores
from hident.engine.store import Stored
from hident.engine.trial import OF_METRIC
from hident.errors import StoreError


class Recent:
    """What was read last, up to ``most`` numbers: tables and verdicts ask for a series several times."""

    def __init__(self, most: int) -> None:
        self.most = most
        self._arrays: dict[Hashable, Array] = {}

    def array(self, name: Hashable, read: Callable[[], Array]) -> Array:
        """The array of this name, which is read if it is not there."""
        found = self._arrays.pop(name, None)
        if found is None:
            found = read()
        if found.size <= self.most:
            self._arrays[name] = found
        while sum(array.size for array in self._arrays.values()) > self.most:
            del self._arrays[next(iter(self._arrays))]
        return found


class _Gathered:
    """All trials of one metric: held in memory, or read from the store again when they are asked for."""

    def __init__(
        self, labels: Sequence[str], key: str, trials: int, store: Stored, recent: Recent | None
    ) -> None:
        self.labels, self._recent = labels, recent
        self.there = np.zeros(trials, dtype=bool)
        self._key, self._store = key, store
        self.not_stored: list[Scores] = []
        self._failures: dict[int, str] = {}
        self._held = (
            Scores(np.arange(trials), np.full((len(labels), trials), np.nan).T, self._failures)
            if recent is None
            else None
        )

    def read(self) -> None:
        """Take what is stored."""
        for scores in self._store.trials(self._key, len(self.there)):
            self.put(scores)

    def put(self, scores: Scores, *, stored: bool = True) -> None:
        """Take these scores, which the store has too or not."""
        self._check(scores)
        self.there[scores.trials] = True
        if not stored and scores.trials.size:
            self.not_stored.append(scores)
        if self._held is not None:
            self._held.values[scores.trials] = scores.values
            self._failures.update(scores.failures)

    def series(self, unit: Unit) -> Iterator[Series]:
        for i, label in enumerate(self.labels):
            column = self._column(i)
            reasons = () if np.isfinite(column).all() else grouped(self._reasons(i))
            yield Series(unit, label, column if self._held else partial(self._column, i), reasons)

    def _parts(self) -> Iterator[Scores]:
        """All trials, each once."""
        if self._held is not None:
            yield self._held
            return
        missing = np.ones(len(self.there), dtype=bool)
        for scores in itertools.chain(self._store.trials(self._key, len(self.there)), self.not_stored):
            self._check(scores)
            part = scores.where(missing[scores.trials])
            missing[part.trials] = False
            yield part
        if missing.any():
            raise StoreError("the trials store was changed while the run was going: run again")

    def _column(self, i: int) -> Array:
        if self._held is not None:
            return self._held.values[:, i]
        assert self._recent is not None
        # All labels stand in one block: what one costs to read, all cost.
        if len(self.there) * len(self.labels) <= self._recent.most:
            values = self._recent.array(self._key, partial(self._read, slice(None)))[i]
        else:
            [values] = self._recent.array((self._key, i), partial(self._read, slice(i, i + 1)))
        found: Array = values
        return found

    def _read(self, labels: slice) -> Array:
        """The values of some labels (L, N)."""
        values = np.empty((len(self.labels[labels]), len(self.there)))
        for part in self._parts():
            values[:, part.trials] = part.values[:, labels].T
        return values

    def _reasons(self, i: int) -> Iterator[str]:
        """Why trials failed, in their order."""
        for part in self._parts():
            column = part.values[:, i]
            for row in np.flatnonzero(~np.isfinite(column)):
                failure = part.failures.get(int(part.trials[row])) or f"{OF_METRIC}the value is {column[row]}"
                own = failure.removeprefix(OF_METRIC)
                yield failure if own == failure else f"{self.labels[i]}: {own}"

    def _check(self, scores: Scores) -> None:
        trials, last = scores.trials, len(self.there) - 1
        outside = trials[(trials < 0) | (trials > last)]
        if outside.size or scores.values.shape != (len(trials), len(self.labels)):
            raise StoreError(
                f"the store gives trial {[*outside, *trials][0]} with {scores.values.shape[-1]} values, "
                f"where trials 0 to {last} have {len(self.labels)}: {', '.join(self.labels)}"
            )


class UnitTrials:
    """One unit with the scores of its metrics, by their names; held in memory, or ``recent`` ones alone."""

    def __init__(
        self,
        unit: Unit,
        keys: Mapping[str, str],
        timing_key: str,
        trials: int,
        store: Stored,
        recent: Recent | None = None,
    ) -> None:
        self.unit, self.keys, self.timing_key = unit, keys, timing_key
        self._gathered = {
            name: _Gathered(metric.labels(name), keys[name], trials, store, recent)
            for name, metric in unit.metrics.items()
        }

    def read(self) -> None:
        """Take what is stored."""
        for gathered in self._gathered.values():
            gathered.read()

    def put(self, name: str, scores: Scores, *, stored: bool = True) -> None:
        """Take scores of the metric of this name, which the store has too or not."""
        self._gathered[name].put(scores, stored=stored)

    def take_not_stored(self, earlier: UnitTrials) -> None:
        """Take what an earlier round of the run has of the same unit, and no store."""
        for name, gathered in earlier._gathered.items():
            for scores in gathered.not_stored:
                self.put(name, scores, stored=False)

    def complete(self) -> int:
        """How many trials have the scores of all metrics."""
        return int((~self.trials_missing()).sum())

    def trials_missing(self) -> NDArray[np.bool_]:
        """Whether each trial lacks any metric."""
        there = [gathered.there for gathered in self._gathered.values()]
        missing: NDArray[np.bool_] = ~np.all(there, axis=0)
        return missing

    def lacking(self, trials: Sequence[int]) -> Iterator[tuple[tuple[str, ...], list[int]]]:
        """The sets of metrics that trials lack, each with its trials."""
        found: dict[tuple[str, ...], list[int]] = {}
        there = np.array([gathered.there[trials] for gathered in self._gathered.values()])
        for trial, missing in zip(trials, (~there).T.tolist(), strict=True):
            names = tuple(itertools.compress(self._gathered, missing))
            found.setdefault(names, []).append(trial)
        return ((names, of) for names, of in found.items() if names)

    def series(self) -> Iterator[Series]:
        """The series of all labels of all metrics."""
        for gathered in self._gathered.values():
            yield from gathered.series(self.unit)
