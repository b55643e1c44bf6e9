"""What one metric gave in some trials: what workers return, stores keep and results are made of."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hident.arrays import Array

Trials = NDArray[np.int64]
SECONDS = "seconds "
"""How the keys begin under which stores keep how long fits took: scores of no metric."""


@dataclass(frozen=True, eq=False)
class Scores:
    """The values (n, labels) of n trials, whose numbers rise; nan throughout where a trial failed.

    ``failures`` says why, by the number of the trial.

    Examples
    --------
    >>> scores = Scores(np.array([3, 4, 7]), np.array([[0.5], [np.nan], [0.25]]), {4: "singular"})
    >>> [(part.trials.tolist(), part.failures) for part in scores.runs()]
    [([3, 4], {4: 'singular'}), ([7], {})]
    >>> scores.below(7).values.tolist()
    [[0.5], [nan]]
    """

    trials: Trials
    values: Array
    failures: Mapping[int, str] = field(default_factory=dict)

    def of(self, chosen: slice | NDArray[np.intp]) -> Scores:
        """Some of the trials."""
        trials = self.trials[chosen]
        failures = {trial: self.failures[trial] for trial in trials.tolist() if trial in self.failures}
        return Scores(trials, self.values[chosen], failures if self.failures else {})

    def below(self, limit: int) -> Scores:
        """The trials with numbers under ``limit``."""
        within = int(np.searchsorted(self.trials, limit))
        return self if within == len(self.trials) else self.of(slice(within))

    def where(self, chosen: NDArray[np.bool_]) -> Scores:
        """The chosen (n,) trials."""
        return self if chosen.all() else self.of(np.flatnonzero(chosen))

    def runs(self) -> Iterator[Scores]:
        """Parts in which each trial follows the one before."""
        edges = [0, *np.flatnonzero(np.diff(self.trials) != 1) + 1, len(self.trials)]
        for first, last in itertools.pairwise(edges):
            if first < last:
                yield self if last - first == len(self.trials) else self.of(slice(first, last))


def gathered(found: Mapping[int, Array | str], labels: int) -> Scores:
    """The scores of trials, each of which has its values or failed for a reason."""
    values = np.full((len(found), labels), np.nan)
    failures = {}
    for row, (trial, one) in enumerate(found.items()):
        if isinstance(one, str):
            failures[trial] = one
        else:
            values[row] = one
    return Scores(np.array([*found], dtype=np.int64), values, failures)
