"""Methods against each other on the same trials."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from hident.arrays import Array
from hident.config.references import CaseLabels, EstimatorName, MetricLabel
from hident.config.spec import Count, Real, component
from hident.config.suggest import counted, one_of
from hident.engine.comparable import in_units, to_one_unit
from hident.engine.experiment import Label, Plan, Unit
from hident.engine.results import Results, Series
from hident.ledger.verdicts import Verdict
from hident.metrics.base import Best
from hident.numerics.choices import TIE
from hident.numerics.influence import hangs_on_one
from hident.numerics.paired import LEVEL, Interval, Pair, holm, paired, trials_to_tell
from hident.reports.base import Misfit, Table, TableSpec
from hident.reports.facets import Grid, joined
from hident.reports.tables.writing import written
from hident.signals.streams import ROLES_OF_DATA

if TYPE_CHECKING:
    import pandas as pd

Statistic = Literal["mean", "median"]
_OF_SURVIVORS = "†"
_BEST: Mapping[Best, str] = {
    "lowest": "lower value of",
    "highest": "higher value of",
    "zero": "value nearer to zero of",
}


@dataclass(frozen=True, eq=False)
class Case:
    """The methods that a case holds: what there is of each, by its name."""

    labels: dict[str, Label]
    units: dict[str, Unit]

    def described(self) -> str:
        """Its labels in words."""
        return ", ".join(f"{axis} {label}" for axis, label in self.labels.items())


@dataclass(frozen=True, eq=False)
class Versus:
    """Two methods in one case; ``adjusted`` is the p-value adjusted over all tests of the table."""

    case: Case
    first: str
    second: str
    pair: Pair
    statistic: Statistic
    best: Best
    adjusted: float = float("nan")

    @cached_property
    def interval(self) -> Interval:
        """The statistic of the differences with its interval."""
        return self.pair.interval(self.statistic)

    @property
    def units(self) -> tuple[int, int]:
        """The ``id`` of the units of both: the same in the whole results and in a part of them."""
        return id(self.case.units[self.first]), id(self.case.units[self.second])

    @property
    def side(self) -> int:
        """1 where the test tells that the first method is better, -1 the second, 0 where it tells nothing."""
        return self.pair.side if self.adjusted <= LEVEL else 0

    @property
    def better(self) -> str:
        """The name of the better method; empty where the two are tied."""
        return {1: self.first, -1: self.second, 0: ""}[self.side]

    @property
    def leaves_out(self) -> bool:
        """Whether the statistic leaves out trials, as one of the methods failed there."""
        return self.statistic == "mean" and any(self.pair.failed)

    @property
    def speaks_for(self) -> int:
        """1 where the statistic speaks for the first method, -1 for the second, 0 for neither."""
        return self._side(self.interval.estimate)

    @property
    def interval_tells(self) -> int:
        """The same where the whole interval does."""
        low, high = (self._side(end) for end in (self.interval.low, self.interval.high))
        return low if low == high else 0

    @property
    def is_of_survivors(self) -> bool:
        """Whether the statistic says what the test does not, as it leaves out trials that failed."""
        against = self.side * self.speaks_for < 0 or (self.interval_tells and not self.side)
        return self.leaves_out and bool(against)

    def _side(self, difference: float) -> int:
        good = difference if self.best == "highest" else -difference
        return 0 if math.isnan(good) else int(math.copysign(good != 0.0, good))


@component("table", "comparison")
class Comparison(TableSpec):
    """Pairs of methods in each case: paired differences with intervals, wins, and a signed-rank test.

    A trial in which one method alone fails is its loss. Tests are adjusted by Holm over the whole table.
    Methods of one case share a rank unless a test tells them apart: the rank of a method is one more than the
    number of methods that are better.
    """

    metric: MetricLabel
    """Label of the metric by which they are compared."""
    estimators: tuple[EstimatorName, ...] | None = None
    """Names of the estimators; all that the metric scores by default."""
    reference: EstimatorName | None = None
    """The estimator that all others are compared with; each with each by default."""
    of: Literal["difference", "log_ratio"] = "difference"
    """What is taken of a pair: the first value less the second, or the logarithm of their ratio."""
    statistic: Statistic = "mean"
    """What the interval is of; the median counts failures as infinite, the mean leaves them out."""
    best: Best | None = None
    """Which values are good: lowest, highest or zero; by default as the metric says."""
    equal: Annotated[Real, Field(ge=0, lt=1)] = TIE
    """Two values are tied that differ by at most so much of the larger one."""
    show: Literal["pairs", "ranks"] = "pairs"
    """One row for each case and pair, or one for each case with the rank of each method."""
    at_is_own = True
    at: CaseLabels = {}
    """Labels of axes that limit the cases, here and in the figures of this table; all by default."""
    digits: Annotated[Count, Field(ge=1, le=15)] = 3
    """Significant digits."""

    @field_validator("estimators")
    @classmethod
    def _several(cls, estimators: tuple[str, ...] | None) -> tuple[str, ...] | None:
        if estimators is not None:
            if len(estimators) < 2:
                raise ValueError("must name at least two")
            if twice := [name for i, name in enumerate(estimators) if name in estimators[:i]]:
                raise ValueError(f"names {one_of(twice)} twice")
        return estimators

    @model_validator(mode="after")
    def _ranks_need_all_pairs(self) -> Comparison:
        if self.reference is not None and self.show == "ranks":
            raise ValueError("ranks need each method against each: leave out 'reference', or show pairs")
        if (
            self.reference is not None
            and self.estimators is not None
            and self.reference not in self.estimators
        ):
            raise ValueError(f"the reference '{self.reference}' must be one of the estimators")
        return self

    def misfits(self, plan: Plan) -> Iterator[Misfit]:
        if (self.best_of(plan)) is None:
            yield (
                ("metric",),
                f"the metric '{self.metric}' does not say which of its values are good: set 'best' to "
                "lowest, highest or zero",
            )
        named = "estimators" if self.estimators is not None else "metric"
        if not (cases := self.cases(plan)):
            known = self.named(plan)
            yield (named,), f"no case holds two methods to compare (there are: {one_of(known)})"
        elif apart := next(filter(None, map(self._units_of, cases)), ""):
            yield ("metric",), f"'{self.metric}' is {apart}"
        elif plan.trials > 1 and any(unit.data.resampled for case in cases for unit in case.units.values()):
            yield (
                (named,),
                "the trials are bootstraps of each method's own model, and no two methods have the same: "
                "compare them on trial 0, by 'trials: 1'",
            )
        elif plan.trials > 1 and (same := next(filter(_repeats, cases), None)):
            at = f" at {same.described()}" if same.labels else ""
            yield (
                (named,),
                f"all trials{at} are one record, as 'streams' fixes input and noise, and no test tells "
                "anything from one: let one of them vary, or set 'trials: 1'",
            )

    def _units_of(self, case: Case) -> str:
        """In which units the methods of a case are scored, and the remedy, if they are several."""
        found = []
        for name, unit in case.units.items():
            metrics = unit.metrics.items()
            (own,) = (key for key, metric in metrics if self.metric in metric.labels(key))
            found.append((name, unit.metrics[own], unit.estimator))
        unit = next(iter(case.units.values()))
        number = unit.metrics[own].labels(own).index(self.metric)
        groups = in_units(found, number, unit.data.system.truth(), unit.data.dt)
        if len(groups) < 2:
            return ""
        at = f" at {case.described()}" if case.labels else ""
        return (
            f"in several units{at}, as each method fixes the factor between the blocks by its own rule "
            f"({'; '.join(map(one_of, groups))}): {to_one_unit(one[1:] for one in found)}"
        )

    def best_of(self, plan: Plan) -> Best | None:
        """Which values are good; None if neither the table nor the metric says it."""
        specs = plan.experiment.metrics.items()
        return self.best or next((m.best for name, m in specs if self.metric in m.labels(name)), None)

    def named(self, plan: Plan) -> tuple[str, ...]:
        """The names of the methods, in their order."""
        if self.estimators is not None:
            return self.estimators
        scored = {unit.name for unit in plan.units if self.metric in unit.metric_labels}
        return tuple(name for name in plan.experiment.estimators if name in scored)

    def cases(self, plan: Plan) -> list[Case]:
        """The cases that hold at least two of the methods, the reference among them if there is one."""
        # All units of one estimator have labels on the same axes; those held are no axes of the plan.
        known = {axis.name for axis in plan.axes}
        units: dict[str, dict[tuple[str, ...], Unit]] = {name: {} for name in self.named(plan)}
        own: dict[str, tuple[str, ...]] = {}
        for unit in plan.units:
            if unit.name in units and self.metric in unit.metric_labels and unit.is_at(self.at):
                own[unit.name] = tuple(axis for axis in unit.labels if axis in known)
                units[unit.name][tuple(str(unit.labels[axis]) for axis in own[unit.name])] = unit
        touching = {axis for axes in own.values() for axis in axes}
        axes = [axis for axis in plan.axes if axis.name in touching]
        found = []
        for chosen in itertools.product(*(axis.labels for axis in axes)):
            labels = {axis.name: label for axis, label in zip(axes, chosen, strict=True)}
            if any(str(labels.get(name, label)) != str(label) for name, label in self.at.items()):
                continue
            held = {
                name: some.get(tuple(str(labels[axis]) for axis in own[name]))
                for name, some in units.items()
                if some
            }
            there = {name: unit for name, unit in held.items() if unit is not None}
            if len(there) > 1 and (self.reference is None or self.reference in there):
                found.append(Case(labels, there))
        return found

    def compared(self, results: Results) -> list[Versus]:
        """All pairs in all cases; of results that are a part, with the p-values of the whole table."""
        whole = [one for block in self._blocks(results.whole).values() for one in block]
        if results.part_of is None and self.facets is None:
            return whole
        adjusted = {one.units: one.adjusted for one in whole}
        return [replace(one, adjusted=adjusted[one.units]) for one in self._tested(results)]

    def _blocks(self, results: Results) -> dict[tuple[int, int], list[Versus]]:
        """The pairs of each row and column of blocks, their p-values adjusted as one family."""
        tested = {at: self._tested(part) for at, part in self._parts(results).items()}
        adjusted = iter(holm([one.pair.p for block in tested.values() for one in block]))
        return {
            at: [replace(one, adjusted=float(next(adjusted))) for one in block]
            for at, block in tested.items()
        }

    def _parts(self, results: Results) -> dict[tuple[int, int], Results]:
        """The results of each row and column of blocks."""
        parts = {(f.row, f.column): results.at(f.labels) for f in Grid(self.facets, results.plan)}
        return {at: part for at, part in parts.items() if part.series}

    def _tested(self, results: Results) -> list[Versus]:
        """All pairs in all cases, each by itself."""
        best = self.best_of(results.plan) or "lowest"
        series = series_of_units(results, self.metric)
        found = []
        for case in self.cases(results.plan):
            values = {name: series[id(unit)].values for name, unit in case.units.items()}
            for first, second in self._pairs(case.units):
                pair = paired(
                    values[first], values[second], best=best, log=self.of == "log_ratio", equal=self.equal
                )
                found.append(Versus(case, first, second, pair, self.statistic, best))
        return found

    def _pairs(self, names: Iterable[str]) -> Iterator[tuple[str, str]]:
        if self.reference is None:
            yield from itertools.combinations(names, 2)
        else:
            yield from ((name, self.reference) for name in names if name != self.reference)

    def built(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        if self.facets is None:
            return super().built(results, verdicts)
        parts, blocks = self._parts(results), self._blocks(results)
        tests = sum(map(_tests, blocks.values()))
        return joined(
            Grid(self.facets, results.plan),
            {at: self._table(parts[at], block, tests) for at, block in blocks.items()},
        )

    def build(self, results: Results, verdicts: Sequence[Verdict]) -> Table:
        found = self.compared(results)
        return self._table(results, found, _tests(found))

    def _table(self, results: Results, found: Sequence[Versus], tests: int) -> Table:
        axes = tuple(found[0].case.labels)
        of_case: dict[int, list[Versus]] = {}
        for one in found:
            of_case.setdefault(id(one.case), []).append(one)
        ranked = {key: ranks(some) for key, some in of_case.items()}
        if self.show == "pairs":
            header, rows = self._rows_of_pairs(found, ranked)
        else:
            header, rows = self._rows_of_ranks(results, found, ranked)
        notes = (*self._notes(results, tests), *self._warnings(results, found))
        return Table(self.title, (*axes, *header), rows, notes, self._data(found, ranked, axes))

    def _rows_of_pairs(
        self, found: Sequence[Versus], ranked: Mapping[int, Mapping[str, int]]
    ) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
        """Heading and rows, one for each pair."""
        geometric = "geometric " * (self.statistic == "mean" and self.of == "log_ratio")
        what = f"{geometric}{self.statistic} {'difference' if self.of == 'difference' else 'ratio'}"
        all_pairs = self.reference is None
        # Without the failures a ratio and a test that count them otherwise could not be read together.
        failed = any(any(one.pair.failed) for one in found)
        header = (
            *("first", "second", f"{what} [95 %]"),
            *["failed"] * failed,
            *("wins", "adjusted p", "better"),
        )
        rows = []
        for one in found:
            own = ranked[id(one.case)]
            rows.append(
                (
                    *map(str, one.case.labels.values()),
                    one.first,
                    one.second,
                    self._written(one),
                    *[_failed(one)] * failed,
                    f"{100.0 * one.pair.win_rate:.0f} %",
                    written(one.adjusted, 2),
                    one.better or "tied",
                    *([f"{own[one.first]}, {own[one.second]}"] * all_pairs),
                )
            )
        return (*header, *["ranks"] * all_pairs), tuple(rows)

    def _rows_of_ranks(
        self, results: Results, found: Sequence[Versus], ranked: Mapping[int, Mapping[str, int]]
    ) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
        """Heading and rows, one for each case."""
        series, names = series_of_units(results, self.metric), self.named(results.plan)

        def cell(case: Case, name: str) -> str:
            if name not in case.units:
                return "-"
            values = as_compared(series[id(case.units[name])].values, found[0].best)
            worked = values[np.isfinite(values)]
            if self.statistic == "median":
                value = float(np.median(values))
            else:
                value = float(np.mean(worked)) if len(worked) else float("nan")
            shown = f"{value:.0f}" if math.isinf(value) else written(value, self.digits)
            if failed := len(values) - len(worked):
                shown += f", {failed} of {len(values)} failed"
            return f"{ranked[id(case)][name]} ({shown})"

        cases = list({id(one.case): one.case for one in found}.values())
        rows = ((*map(str, case.labels.values()), *(cell(case, name) for name in names)) for case in cases)
        return names, tuple(rows)

    def _written(self, one: Versus) -> str:
        """The statistic of a pair with its interval, ratios as such."""
        shown = map(math.exp, one.interval) if self.of == "log_ratio" else one.interval
        estimate, *ends = (_with_infinity(value, self.digits) for value in shown)
        whole = f"{estimate} [{', '.join(ends)}]" if ends != ["-", "-"] else estimate
        return f"{whole} {_OF_SURVIVORS}" if one.is_of_survivors else whole

    def _notes(self, results: Results, tests: int) -> Iterator[str]:
        """What the columns mean."""
        best = self.best_of(results.plan) or "lowest"
        trials = results.plan.trials
        if self.show == "pairs":
            taken = {
                ("difference", "mean"): "Mean of first less second",
                ("difference", "median"): "Median of first less second",
                ("log_ratio", "mean"): "First over second, the geometric mean",
                ("log_ratio", "median"): "First over second, the median",
            }[self.of, self.statistic]
            size = " of the moduli" if best == "zero" else ""
            yield (
                f"{taken}{size} in the same trials, with a 95 % interval for each pair by itself. Wins: "
                f"trials in which the first has the {_BEST[best]} '{self.metric}', ties counting half."
            )
        better = "Better" if self.show == "pairs" else "Better than another"
        tested = "logarithms of the ratios" if self.of == "log_ratio" else "differences"
        yield (
            f"{better}: by Wilcoxon's signed-rank test of the {tested} at 5 %, adjusted by Holm over "
            f"the {counted(tests, 'test')} of this table."
        )
        if self.reference is None:
            yield (
                "Rank: one more than the number of methods that are better in that case; those that the test "
                "does not tell apart share one."
            )
        if self.show == "ranks":
            size = " of the moduli" if best == "zero" else ""
            of_failures = (
                "a failed trial counting as infinite"
                if self.statistic == "median"
                else "over the trials that did not fail"
            )
            yield f"In brackets the {self.statistic}{size} of {self.metric}, {of_failures}."
        if 0 < trials < (least := trials_to_tell(tests)):
            count = "One trial tells" if trials == 1 else f"{counted(trials, 'trial')} tell"
            yield f"{count} no two methods apart, whatever they give: {tests} tests take at least {least}."

    def _warnings(self, results: Results, found: Sequence[Versus]) -> Iterator[str]:
        """Failures, and what should not be believed without another look."""
        yield from self._failures(results, found)
        if undefined := [one for one in found if one.pair.undefined]:
            yield (
                f"A value that is not positive has no logarithm: {_of_pairs(undefined, found)} no ratio "
                "and no test. Take 'of: difference' there."
            )
        heavy = [one for one in found if hangs_on_one(one.pair.differences[one.pair.worked])]
        if heavy and self.statistic == "mean":
            yield (
                f"A single trial makes more than half of the spread: {_of_pairs(heavy, found)} a mean and an "
                "interval that hang on it; the median does not."
            )
        in_pairs = self.show == "pairs"
        if survivors := [one for one in found if one.is_of_survivors]:
            sign = f"{_OF_SURVIVORS} " * in_pairs
            yield (
                f"{sign}The {self.statistic} is of the trials in which neither failed, and says something "
                f"else than the test, for which the others count too: {_of_pairs(survivors, found)} failures "
                "that decide."
            )
        tied = [one for one in found if one.interval_tells and not one.side and not one.is_of_survivors]
        if tied and in_pairs:
            equal = 1 if self.of == "log_ratio" else 0
            yield (
                f"Tied beside an interval without {equal}: {_of_pairs(tied, found)} an interval for that "
                "pair by itself, and a p-value that is adjusted for all."
            )
        if other := [one for one in found if one.side * one.speaks_for < 0 and not one.leaves_out]:
            yield (
                f"The {self.statistic} points to the other method than the test: {_of_pairs(other, found)} "
                "one method that wins most trials and another that is better on average."
            )

    def _failures(self, results: Results, found: Sequence[Versus]) -> Iterator[str]:
        """How many trials of each method failed."""
        series = series_of_units(results, self.metric)
        units = {id(unit): unit for one in found for unit in one.case.units.values()}
        said = []
        for name in self.named(results.plan):
            own = [series[key].statistics for key, unit in units.items() if unit.name == name]
            if failed := int(sum(one["failed"] for one in own)):
                cases = sum(one["failed"] > 0 for one in own)
                where = f" in {cases} of {len(own)} cases" if len(own) > 1 else ""
                said.append(f"{name} {failed} of {int(sum(one['trials'] for one in own))}{where}")
        if said:
            how = "left out of means" if self.statistic == "mean" else "infinite in medians"
            if self.show == "ranks":
                how += " in brackets"
            yield (
                f"Failed trials: {'; '.join(said)}. They count as lost against a method that did not fail, "
                f"and as tied where both failed, and are {how}."
            )

    def _data(
        self, found: Sequence[Versus], ranked: Mapping[int, Mapping[str, int]], axes: Sequence[str]
    ) -> pd.DataFrame:
        """All numbers of all pairs."""
        import pandas as pd

        rows: list[dict[str, Any]] = []
        for one in found:
            pair, own = one.pair, ranked[id(one.case)]
            row = {
                **one.case.labels,
                "first": one.first,
                "second": one.second,
                "of": self.of,
                "statistic": self.statistic,
                **one.interval._asdict(),
                "wins": pair.wins,
                "ties": pair.ties,
                "losses": pair.losses,
                "failed_first": pair.failed[0],
                "failed_second": pair.failed[1],
                "failed_both": pair.both_failed,
                "p": pair.p,
                "adjusted_p": one.adjusted,
                "better": one.better,
            }
            if self.reference is None:
                row |= {"rank_first": own[one.first], "rank_second": own[one.second]}
            rows.append(row)
        return pd.DataFrame(rows, columns=[*axes, *(key for key in rows[0] if key not in axes)])


def _repeats(case: Case) -> bool:
    """Whether all trials of a case are the same to the last bit."""
    data = next(iter(case.units.values())).data
    drawn = any(unit.estimator.draws() for unit in case.units.values())
    return not drawn and all(data.streams.is_fixed(role) for role in ROLES_OF_DATA)


def ranks(pairs: Sequence[Versus]) -> dict[str, int]:
    """The rank of each method, from all pairs of a case: one more than the number of better ones."""
    worse = [one.second if one.side > 0 else one.first for one in pairs if one.side]
    return {name: 1 + worse.count(name) for name in pairs[0].case.units}


def as_compared(values: Array, best: Best) -> Array:
    """The values of trials as they are compared: a failure is worst, and moduli count where zero is best."""
    sizes = np.abs(values) if best == "zero" else values
    return np.where(np.isfinite(values), sizes, -np.inf if best == "highest" else np.inf)


def series_of_units(results: Results, metric: str) -> dict[int, Series]:
    """The series of a metric by the ``id`` of their units."""
    return {id(one.unit): one for one in results.series if one.metric == metric}


def _tests(found: Iterable[Versus]) -> int:
    return sum(not math.isnan(one.pair.p) for one in found)


def _failed(one: Versus) -> str:
    """How often each of two methods failed."""
    return f"{one.pair.failed[0]}, {one.pair.failed[1]} of {len(one.pair.outcomes)}"


def _of_pairs(some: Sequence[Versus], found: Sequence[Versus]) -> str:
    """Which pairs have something, in words that go on with what."""
    first = some[0]
    at = f" at {first.case.described()}" if first.case.labels else ""
    named = f"{first.first} and {first.second}{at}"
    if len(some) == 1:
        return f"{named} have"
    return f"{len(some)} of {len(found)} pairs (the first: {named}) have"


def _with_infinity(value: float, digits: int) -> str:
    return f"{value:+.0f}" if math.isinf(value) else written(value, digits)
