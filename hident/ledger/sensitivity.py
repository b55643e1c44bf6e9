"""How often a last bit sends an estimate down another branch: measured at accept, used by compare.

A search among near ties, a convergence test, a rejection rule may turn on a rounding error, and another
processor rounds otherwise. So the trials of a configuration are repeated with records that are a last bit
away (see :func:`hident.engine.trial.generate`), and for each unit ``sensitivity.csv`` holds how many of the
perturbed estimates moved: some metric differs by more than the tolerance of :func:`~hident.ledger.
trial_values.difference`, or fails where it did not.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from hident.ledger.trial_values import Key, TrialValues, difference

RTOL = 1e-6
"""Relative tolerance of a trial's value."""
_COLUMNS = ("estimator", "trials", "perturbed", "moved")


@dataclass(frozen=True)
class Count:
    """Of one unit: its trials, the estimates from perturbed records, and how many of those moved."""

    trials: int
    perturbed: int
    moved: int

    def likely(self, trials: int, chance: float) -> int:
        """How many of so many trials may move on another arithmetic: more has at most this chance.

        The predictive distribution is beta-binomial: the share that moves is unknown, has Jeffreys' prior
        Beta(1/2, 1/2), and ``moved`` of ``perturbed`` estimates have been seen. Where none has moved, not
        all may.
        """
        from scipy.stats import betabinom

        if not self.perturbed:
            return 0
        shape = self.moved + 0.5, self.perturbed - self.moved + 0.5
        most = int(betabinom.isf(chance, trials, *shape))
        return most if self.moved else min(most, trials - 1)

    def described(self, most: int) -> str:
        """The share in words, and what it makes likely."""
        if not self.perturbed:
            return "no share is stored: hident accept measures it"
        return f"the stored share, {self.moved} of {self.perturbed}, makes up to {most} likely"

    @classmethod
    def together(cls, counts: Iterable[Count]) -> Count:
        """The counts of several units as one."""
        every = [*counts]
        return cls(
            *(sum(getattr(count, name) for count in every) for name in ("trials", "perturbed", "moved"))
        )


@dataclass(frozen=True)
class Sensitivity:
    """The counts of all units."""

    axes: tuple[str, ...]
    counts: Mapping[Key, Count]

    @classmethod
    def measured(cls, plain: TrialValues, perturbed: Iterable[TrialValues]) -> Sensitivity:
        """Count what moved between the trials and their perturbed repetitions."""
        moved, repetitions = dict.fromkeys(plain.units, 0), 0
        for values in perturbed:
            repetitions += 1
            for unit, keys in plain.units.items():
                found = [difference(values.series[key], plain.series[key], RTOL).moved for key in keys]
                moved[unit] += int(np.any(found, axis=0).sum())
        trials = plain.trials
        counts = {unit: Count(trials, trials * repetitions, number) for unit, number in moved.items()}
        return cls(plain.axes, counts)

    @classmethod
    def decoded(cls, data: bytes) -> Sensitivity:
        """What :meth:`encoded` gave; ValueError if the bytes are no such file."""
        header, *rows = csv.reader(io.StringIO(data.decode(), newline=""), strict=True)
        width = len(header) - len(_COLUMNS)
        if tuple(header[width:]) != _COLUMNS or any(len(row) != len(header) for row in rows):
            raise ValueError("it is no table of perturbed trials")
        return cls(
            tuple(header[:width]),
            {tuple(row[: width + 1]): Count(*map(int, row[width + 1 :])) for row in rows},
        )

    def encoded(self) -> bytes:
        """The bytes of the file."""
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([*self.axes, *_COLUMNS])
        for unit, count in self.counts.items():
            writer.writerow([*unit, count.trials, count.perturbed, count.moved])
        return text.getvalue().encode()
