"""Finished trials, and their statistics."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from hident.arrays import Array
from hident.engine.experiment import Label, Plan, Statistic, Unit
from hident.engine.timing import Timing, timing_frame
from hident.numerics.influence import hangs_on_one
from hident.numerics.rounding import is_constant

if TYPE_CHECKING:
    import pandas as pd

QUANTILES = {"q05": 0.05, "q25": 0.25, "q75": 0.75, "q95": 0.95}
# A number, but not the one in a name such as a_1 or x2.
_NUMBER = re.compile(r"(?<![\w.])[+-]?(?:\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+|nan\b|inf\b)")
STATISTICS = ("trials", "failed", "mean", "std", "se", "median", *QUANTILES)


class Series:
    """One label of a metric of one unit over all trials.

    ``values`` may be a function that reads them: then they are read each time when they are asked for, so
    that of very many trials a series at a time is in memory. ``reasons`` are the kinds of reasons why trials
    failed, each with the number of its trials (see :func:`grouped`).
    """

    def __init__(
        self,
        unit: Unit,
        metric: str,
        values: Array | Callable[[], Array],
        reasons: tuple[tuple[str, int], ...] = (),
    ) -> None:
        self.unit, self.metric, self.reasons = unit, metric, reasons
        self._values = values

    @property
    def values(self) -> Array:
        """The value of each trial; nan where it failed."""
        return self._values() if callable(self._values) else self._values

    @property
    def valid(self) -> Array:
        """The values of the trials that did not fail; all the first where they differ by rounding only."""
        return _valid(self.values)

    @cached_property
    def statistics(self) -> dict[str, float]:
        """The statistics of table.csv."""
        return statistics(self.values)

    def value(self, statistic: Statistic) -> float:
        """The statistic over the trials that did not fail; nan if there are too few."""
        return self.statistics[statistic]

    @np.errstate(all="ignore")
    def standard_error(self, statistic: Statistic) -> float:
        """Standard error of the statistic, by its large-sample formula."""
        valid, n = self.valid, len(self.valid)
        if n < 2:
            return float("nan")
        if np.all(valid == valid[0]):
            return 0.0
        match statistic:
            case "mean":
                return self.statistics["se"]
            case "std":
                variance = float(np.var(valid, ddof=1))
                fourth = float(np.mean((valid - valid.mean()) ** 4))
                return float(np.sqrt((fourth - variance**2) / (4.0 * variance * n))) if variance else 0.0
            case "median":
                # From the order statistics two standard errors (of a rank) either side of the median.
                low, high = np.quantile(valid, np.clip(0.5 + np.array([-1.0, 1.0]) / np.sqrt(n), 0.0, 1.0))
                return float(high - low) / 4.0


@np.errstate(all="ignore")
def statistics(values: Array) -> dict[str, float]:
    """The statistics of table.csv of a value for each trial; std is the sample one, se that of the mean."""
    valid = _valid(values)
    counts = {"trials": len(values), "failed": len(values) - len(valid)}
    if not len(valid):
        return {**counts, **dict.fromkeys(STATISTICS[2:], float("nan"))}
    # The mean of equal numbers may differ from them in the last digit, and each from that mean.
    constant = bool(np.all(valid == valid[0]))
    std = float("nan") if len(valid) < 2 else 0.0 if constant else float(np.std(valid, ddof=1))
    return {
        **counts,
        "mean": float(valid[0] if constant else np.mean(valid)),
        "std": std,
        "se": std / len(valid) ** 0.5,
        "median": float(np.median(valid)),
        **dict(zip(QUANTILES, np.quantile(valid, [*QUANTILES.values()]).tolist(), strict=True)),
    }


def _valid(values: Array) -> Array:
    found = values[np.isfinite(values)]
    return np.full_like(found, found[0]) if len(found) and is_constant(found) else found


def grouped(reasons: Iterable[str]) -> tuple[tuple[str, int], ...]:
    """The kinds of reasons with their counts, the most frequent first.

    Reasons that differ in their numbers only are of one kind, and a number in which they differ is shown as
    three dots.

    Examples
    --------
    >>> grouped(["stopped at t = 3", "singular", "stopped at t = 4.5"])
    (('stopped at t = ...', 2), ('singular', 1))
    """
    kinds: dict[str, _Kind] = {}
    for text in reasons:
        words = _NUMBER.split(text)
        kinds.setdefault("\0".join(words), _Kind(words)).add(_NUMBER.findall(text))
    return tuple(sorted(((kind.text(), kind.count) for kind in kinds.values()), key=lambda kind: -kind[1]))


class _Kind:
    """Reasons that differ in their numbers only."""

    def __init__(self, words: Sequence[str]) -> None:
        self._words, self._numbers, self.count = words, [""] * (len(words) - 1), 0

    def add(self, numbers: Sequence[str]) -> None:
        pairs = zip(self._numbers, numbers, strict=True)
        self._numbers = [*numbers] if not self.count else [a if a == b else "..." for a, b in pairs]
        self.count += 1

    def text(self) -> str:
        return "".join(itertools.chain(*itertools.zip_longest(self._words, self._numbers, fillvalue="")))


@dataclass(frozen=True, eq=False)
class Results:
    """All trials of a plan: complete, or it would not exist.

    ``series`` holds one :class:`Series` for each label of a metric of each unit, ``plan`` what was run,
    ``timed_out`` how many trials of units count as failed because they took longer than the trial timeout,
    ``timings`` how long the fits of each unit took, ``how`` what run.json says of the run, such as its number
    of workers, ``part_of`` the results of which :meth:`at` took a part.
    :meth:`frame` gives the statistics, :meth:`trials_frame` every trial's value, :meth:`timing_frame` the
    seconds.
    """

    plan: Plan
    series: tuple[Series, ...]
    timed_out: int = 0
    timings: tuple[Timing, ...] = ()
    how: Mapping[str, Any] = field(default_factory=dict, repr=False)
    part_of: Results | None = field(default=None, repr=False)

    @property
    def whole(self) -> Results:
        """The results of all cases of the experiment, of which these may be a part."""
        return self.part_of or self

    @cached_property
    def hanging(self) -> tuple[Series, ...]:
        """The series whose mean hangs on a single trial."""
        return tuple(one for one in self.series if hangs_on_one(one.values))

    def select(
        self,
        estimator: str | None = None,
        metric: str | None = None,
        labels: Mapping[str, Label] = MappingProxyType({}),
    ) -> Iterator[Series]:
        """The series of an estimator and a metric at the given labels of axes."""
        for series in self.series:
            named = estimator in (None, series.unit.name) and metric in (None, series.metric)
            if named and series.unit.is_at(labels):
                yield series

    def at(self, labels: Mapping[str, Label]) -> Results:
        """The results of the cases at these labels (:meth:`Plan.at`); their series are the same objects."""
        if not labels:
            return self
        plan = self.plan.at(labels)
        series = tuple(one for one in self.series if plan.units and one.unit.is_at(labels))
        return replace(self, plan=plan, series=series, part_of=self.whole)

    def varied(self, series: Series) -> dict[str, Label]:
        """The labels of a series on the axes of the plan: on those that are not held."""
        axes = {axis.name for axis in self.plan.axes}
        return {axis: label for axis, label in series.unit.labels.items() if axis in axes}

    def labels(self, axis: str) -> tuple[Label, ...]:
        """The labels of an axis in their written order."""
        return next((a.labels for a in self.plan.axes if a.name == axis), ())

    def frame(self) -> pd.DataFrame:
        """The tidy table: the case's columns, estimator, metric and the statistics."""
        import pandas as pd

        axes = [axis.name for axis in self.plan.axes]
        rows = [{**self._names(series), **series.statistics} for series in self.series]
        return pd.DataFrame(rows, columns=[*axes, "estimator", "metric", *STATISTICS])

    def trials_frame(self) -> pd.DataFrame:
        """The value of every trial: the case's columns, estimator, metric, trial and value (nan: failed)."""
        import pandas as pd

        trials = range(self.plan.trials)
        parts = (
            pd.DataFrame({**self._names(series), "trial": trials, "value": series.values})
            for series in self.series
        )
        return pd.concat(parts, ignore_index=True)

    def timing_frame(self) -> pd.DataFrame:
        """The seconds of a fit: the case's columns, estimator, number of fits, median and quartiles.

        ``relative`` is the median in units of that of the fastest of the case. Of a ``batched`` estimator, a
        fit has an even share of the time of its batch.
        """
        return timing_frame(self.plan, self.timings)

    def imprecise(self) -> tuple[Series, ...]:
        """The series whose statistic is not as precise yet as ``trials.until`` of the experiment asks."""
        rule = self.plan.rule
        if rule is None:
            return ()
        with np.errstate(all="ignore"):
            return tuple(
                one
                for one in self.series
                if (not rule.of or one.metric in rule.of)
                and not one.standard_error(rule.statistic)
                <= rule.relative_se * abs(one.value(rule.statistic))
            )

    def _names(self, series: Series) -> dict[str, Label]:
        """What a series is of, by the columns of a table."""
        labels = {axis.name: series.unit.labels.get(axis.name, "") for axis in self.plan.axes}
        return {**labels, "estimator": series.unit.name, "metric": series.metric}
