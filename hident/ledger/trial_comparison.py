"""Two runs of one configuration, trial by trial: which units moved, how far, and whether they may."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hident.arrays import Array
from hident.config.suggest import counted
from hident.engine.results import STATISTICS, statistics
from hident.ledger.contents import Row
from hident.ledger.sensitivity import RTOL, Count, Sensitivity
from hident.ledger.trial_values import Difference, Key, TrialValues, difference, scale_of
from hident.numerics.choices import ROUNDING

_SHOWN = ("failed", "mean", "std", "median")
_MOST_SERIES, _MOST_TRIALS = 6, 8
_COUNTS = ("trials", "failed")
# Statistics of the same values, on another machine.
_SAME = 1e-9


@dataclass(frozen=True)
class Moved:
    """A unit with trials that differ: what to say, and whether so many may."""

    said: str
    allowed: bool


@dataclass(frozen=True, eq=False)
class TrialComparison:
    """The series of two runs on the trials that both have.

    ``sensitivity`` is None between equal arithmetics, where no trial may move. It was measured at a relative
    tolerance of its own, and says nothing of how many trials differ by less.
    """

    ours: TrialValues
    reference: TrialValues
    rtol: float
    sensitivity: Sensitivity | None

    @cached_property
    def units(self) -> dict[Key, dict[Key, Difference]]:
        """Of each unit that both sides have, its series compared."""
        n = min(self.ours.trials, self.reference.trials)
        mine, theirs = self.ours.series, self.reference.series
        return {
            unit: {key: difference(mine[key][:n], theirs[key][:n], self.rtol) for key in common}
            for unit, keys in self.reference.units.items()
            if (common := [key for key in keys if key in mine])
        }

    def unmatched(self) -> Iterator[str]:
        """The series that only one side has."""
        for key in self.reference.series.keys() - self.ours.series.keys():
            yield f"{self.reference.described_series(key)}: its trials are missing"
        for key in self.ours.series.keys() - self.reference.series.keys():
            yield f"{self.ours.described_series(key)}: its trials are extra"

    def moved(self, chance: float) -> Iterator[Moved]:
        """Each unit with trials that differ; more than likely by this chance is more than allowed.

        All units together may not differ more often than is likely either, and no unit of which no perturbed
        estimate moved may do so in every trial: of few trials the share is hardly known.
        """
        marks = {unit: np.any([d.moved for d in of.values()], axis=0) for unit, of in self.units.items()}
        together = self._together(marks, chance)
        for unit, which in marks.items():
            if not which.any():
                continue
            series, allowed = self.units[unit], not together
            text = f"{self.reference.described(unit)}: {which.sum()} of {counted(len(which), 'trial')} "
            if self.sensitivity is None:
                text += f"differ ({_listed(which)}), though the arithmetic is the same"
                allowed = False
            elif self.rtol < RTOL:
                text += (
                    f"differ ({_listed(which)}); how many may is known at a relative tolerance of {RTOL:g}, "
                    f"and not at {self.rtol:g}"
                )
                allowed = False
            else:
                count = self.sensitivity.counts.get(unit, Count(0, 0, 0))
                most = count.likely(len(which), chance)
                allowed = allowed and int(which.sum()) <= most
                text += f"took another branch ({_listed(which)}); {count.described(most)}{together}"
            if not which.all():
                text += f"; all others {_equal(max(d.largest for d in series.values()))}"
            yield Moved("\n    ".join([text, *self._cells(series)]), allowed)

    def _together(self, marks: Mapping[Key, NDArray[np.bool_]], chance: float) -> str:
        """Why so many estimates of all units may not differ; empty if they may."""
        if self.sensitivity is None or self.rtol < RTOL:
            return ""
        estimates, moved = sum(map(len, marks.values())), int(sum(map(np.sum, marks.values())))
        count = Count.together(
            self.sensitivity.counts[unit] for unit in marks if unit in self.sensitivity.counts
        )
        if moved <= (most := count.likely(estimates, chance)):
            return ""
        return f"; in all units {moved} of {estimates} did, and {count.described(most)}"

    def _cells(self, series: Mapping[Key, Difference]) -> Iterator[str]:
        """The rows of table.csv that moved, with the old and the new values."""
        moved = [key for key, d in series.items() if d.moved.any()]
        for key in moved[:_MOST_SERIES]:
            mine, theirs = statistics(self.ours.series[key]), statistics(self.reference.series[key])
            cells = [
                "{} {} (reference {})".format(name, *_digits(mine[name], theirs[name]))
                for name in _SHOWN
                if not _agree(mine[name], theirs[name], self.rtol)
            ]
            yield f"{key[-1]}: {', '.join(cells) or 'the statistics shown agree'}"
        if len(moved) > _MOST_SERIES:
            yield f"and {len(moved) - _MOST_SERIES} metrics more"

    def rows(self, ours: Row, reference: Row, key: Key) -> Iterator[str]:
        """What two rows of table.csv differ in, of a series without moved trials.

        Statistics of equal trials agree in the scale of the trials: a spread that is rounding has no digits.
        """
        scale = scale_of(self.ours.series[key], self.reference.series[key])
        for name in STATISTICS:
            one, other = ours[name], reference[name]
            if not _agree(_number(one), _number(other), self.rtol, self.rtol * scale):
                yield f"{name} {one or 'empty'}, reference {other or 'empty'}"


def follows(row: Row, values: Array) -> Iterator[str]:
    """The cells of a row of table.csv that are not the statistics of its trials."""
    finite = np.abs(values[np.isfinite(values)])
    rounding = ROUNDING * float(finite.max(initial=0.0))
    for name, value in statistics(values).items():
        slack = 0.0 if name in _COUNTS else rounding
        if not _agree(_number(row[name]), value, 0.0 if name in _COUNTS else _SAME, slack):
            yield f"{name} {row[name] or 'empty'}, and its trials give {value:.10g}"


def _number(cell: str) -> float:
    try:
        return float(cell) if cell else math.nan
    except ValueError:
        return math.nan


def _agree(one: float, other: float, rtol: float, atol: float = 0.0) -> bool:
    if not (math.isfinite(one) and math.isfinite(other)):
        return one == other or (math.isnan(one) and math.isnan(other))
    return abs(one - other) <= max(rtol * max(abs(one), abs(other)), atol)


def _digits(one: float, other: float) -> tuple[str, str]:
    """Two numbers that differ, with six digits or as many as show it."""
    short = f"{one:.6g}", f"{other:.6g}"
    return (repr(float(one)), repr(float(other))) if short[0] == short[1] else short


def _listed(which: Array) -> str:
    trials = np.flatnonzero(which)
    more = ", ..." if len(trials) > _MOST_TRIALS else ""
    return ", ".join(map(str, trials[:_MOST_TRIALS])) + more


def _equal(largest: float) -> str:
    return f"equal to {10.0 ** math.ceil(math.log10(largest)):.0e}" if largest else "equal to the last bit"
