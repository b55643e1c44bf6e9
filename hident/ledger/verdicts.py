"""Verdicts: how our numbers stand to the printed ones, and what that can tell.

``exact``: ours rounds to the printed digits. ``agrees``: the printed number lies in the interval that the
trials give, widened by its rounding, and not in that of every alternative that the configuration names.
``untestable``: it is one of these two, and no alternative is excluded by it. ``differs``: else, and then a
reason is owed. The interval is

- none where the trials are the paper's own data: digits are equal or differ;
- the central 95 % of single trials where the paper ran one realisation or does not say how many it averaged;
- the statistic +- 3 standard errors where it averaged: its own Monte Carlo error counts too, from the number
  of its runs, except where it printed a formula's value;
- open on one side for a bound, such as "<5".

docs/verdicts.md states all of it with its error rates.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from hident.arrays import Array
from hident.engine.experiment import Published, PublishedCells, Statistic
from hident.engine.results import Results, Series
from hident.ledger.joint import adjusted_p, combined_p, joint_p, replicates
from hident.ledger.power import VerdictPower, power_of
from hident.ledger.published import CASE, Key, Place, Printed, beside_series, misprints_of, reasons_of
from hident.numerics.rounding import is_constant

if TYPE_CHECKING:
    import pandas as pd

Word = Literal["exact", "agrees", "untestable", "differs"]
COLUMNS = (
    "table",
    "row",
    "quantity",
    "printed",
    "ours",
    "low",
    "high",
    "verdict",
    "reason",
    "interval",
    "ratio",
    "width",
    "p",
    "flips",
    "excluded",
    "alternatives",
    "runs",
    "mark",
    "adjusted_p",
    "group",
    "joint_p",
)
COUNTED = ("", "misprint", "multiplicity")
"""The marks of numbers that count."""
RUNS = (1, 10, 100)
"""How many runs a paper may have averaged that does not say it."""
LEVEL = 0.05
KNOWN = 0.9
"""The share of trials in which a number must be known to be judged together with others."""
OWN_DATA = "none: the trials are the paper's own data, so digits are equal or differ"
"""What stands in the place of an interval where the trials are those that the paper ran."""
_MOST_ROWS = 10_000
_NAN = float("nan")


@dataclass(frozen=True, eq=False)
class Verdict:
    """One printed number beside ours."""

    printed: Printed
    cell: PublishedCells
    series: Series
    ours: float
    low: float
    high: float
    word: Word
    reason: str
    interval: str
    p: float = _NAN
    """How likely a paper of the same experiment prints a number as far out."""
    flips: float = _NAN
    """How likely another block of as many trials would decide otherwise."""
    excluded: int = 0
    """How many alternatives it excludes."""
    alternatives: int = 0
    """How many alternatives change what stands beside it."""
    runs: tuple[int, ...] = ()
    """Of :data:`RUNS`, the numbers of runs the mean of which it may be, where the paper does not say it."""
    mark: str = ""
    """Why it does not count: 'structural', 'duplicate' or 'circular'. Of one that does: 'misprint' by what
    the paper itself prints, or 'multiplicity'."""
    case: str = ""
    """What tells it apart from others on the same printed number; empty where there is one."""
    group: int = 0
    """The number, within the configuration, of the printed numbers from the same data."""
    joint: float = _NAN
    """The p-value of its group."""
    adjusted: float = _NAN
    """How likely some number of its table lies as far out."""

    @property
    def counts(self) -> bool:
        """Whether it says anything that another number, or the configuration itself, does not."""
        return self.mark in COUNTED

    @property
    def is_drawn(self) -> bool:
        """Whether it belongs to the joint test: it counts, is no misprint, no bound, and a draw."""
        return self.counts and self.mark != "misprint" and not self.printed.bound and self.is_random

    @property
    def is_known(self) -> bool:
        """Whether so many trials have a value that those that lack one do not decide."""
        return len(self.series.valid) >= KNOWN * len(self.series.values)

    @property
    def is_random(self) -> bool:
        """Whether it is known and varies over the trials, so that a printed one is a draw."""
        return self.is_known and not is_constant(self.series.valid)

    def row(self) -> tuple[object, ...]:
        """The row of verdicts.csv."""
        p = self.printed
        head = (p.table, p.row, p.quantity, p.printed)
        ratio = self.ours / p.value if p.value else _NAN
        width = (self.high - self.low) / abs(p.value) if p.value else _NAN
        judged = (self.ours, self.low, self.high, self.word, self.reason, self.interval, ratio, width)
        power = (self.p, self.flips, self.excluded, self.alternatives, " ".join(map(str, self.runs)))
        return (*head, *judged, *power, self.mark, self.adjusted, self.group, self.joint, self.case)

    @property
    def place(self) -> Place:
        """Which printed number it is on, and which of ours stands beside it."""
        return (*self.printed.key, self.case)

    @property
    def name(self) -> str:
        """The same in words."""
        return " / ".join(self.printed.key) + (f", {self.case}" if self.case else "")


Beside = dict[tuple[int, str], "Verdict"]
"""The verdicts by series (its id) and statistic."""


def beside(verdicts: Iterable[Verdict]) -> Beside:
    """Each verdict by what it stands beside: a series' mean and its std are two numbers."""
    return {(id(verdict.series), verdict.cell.statistic): verdict for verdict in verdicts}


def beside_trials(verdicts: Iterable[Verdict]) -> dict[int, Verdict]:
    """By series (its id) the verdict that stands beside its trials: on the mean or median, not on the std."""
    return {id(verdict.series): verdict for verdict in verdicts if verdict.cell.statistic != "std"}


def judge(results: Results) -> tuple[Verdict, ...]:
    """The verdicts on all printed numbers that the configuration names.

    ConfigError if a cell that the configuration names is not among the printed numbers.
    """
    if results.plan.experiment.published is None or results.plan.paper is None:
        return ()
    power, reasons = power_of(results.plan), reasons_of(results.plan)
    verdicts = []
    unknown = results.plan.experiment.published.paper_trials == "unknown"
    for verdict in (_with_power(one, power) for one in _with_groups(stand(results), results)):
        why = next((r.reason for r in reasons if r.covers(results.plan.name, verdict.printed.key)), "")
        runs = _fitting_runs(verdict) if unknown else ()
        verdicts.append(replace(verdict, reason=why if verdict.word == "differs" else "", runs=runs))
    return tuple(verdicts)


def stand(results: Results) -> list[Verdict]:
    """How the numbers stand to the printed ones, by themselves: what may be untestable agrees."""
    published = results.plan.experiment.published
    if published is None or results.plan.paper is None:
        return []
    seen: set[tuple[int, str, str]] = set()
    misprints = misprints_of(results.plan)
    verdicts = []
    for cell, series, printed in beside_series(results, published.cells):
        verdict = _judged(printed, cell, series, published)
        again = (id(series), cell.statistic, printed.printed)
        verdicts.append(replace(verdict, mark=_mark(verdict, misprints, repeated=again in seen)))
        seen.add(again)
    return [replace(one, case=case) for one, case in zip(verdicts, _cases(verdicts), strict=True)]


def _cases(verdicts: Sequence[Verdict]) -> list[str]:
    """What tells verdicts on the same printed number apart, for each; empty where there is one."""
    parts = [
        {
            **{axis: str(label) for axis, label in one.series.unit.labels.items()},
            "estimator": one.cell.estimator,
            "metric": one.series.metric,
            "statistic": one.cell.statistic,
        }
        for one in verdicts
    ]
    alike: dict[Key, list[dict[str, str]]] = {}
    for one, part in zip(verdicts, parts, strict=True):
        alike.setdefault(one.printed.key, []).append(part)
    return [
        ", ".join(
            f"{name} {text}"
            for name, text in part.items()
            if any(other.get(name) != text for other in alike[one.printed.key])
        )
        for one, part in zip(verdicts, parts, strict=True)
    ]


def frame(verdicts: Sequence[Verdict]) -> pd.DataFrame:
    """The table verdicts.csv; without the column of cases where each number is judged once."""
    import pandas as pd

    found = pd.DataFrame([verdict.row() for verdict in verdicts], columns=[*COLUMNS, CASE])
    return found if any(one.case for one in verdicts) else found[list(COLUMNS)]


def _mark(verdict: Verdict, misprints: Container[Key], *, repeated: bool) -> str:
    if verdict.cell.circular:
        return "circular"
    valid = verdict.series.valid
    if verdict.printed.value == 0.0 and len(valid) and not np.any(valid):
        return "structural"
    if repeated:
        return "duplicate"
    return "misprint" if verdict.printed.key in misprints else ""


def _with_power(verdict: Verdict, power: VerdictPower | None) -> Verdict:
    number = None if power is None else power.numbers.get(verdict.place)
    # Of a number that has changed since, nothing is known.
    known = number.excluded if number and number.printed == verdict.printed.printed else {}
    excluded = sum(known.values())
    # Digits say something by themselves where nothing was tried.
    idle = verdict.word == "agrees" or (verdict.word == "exact" and known and verdict.counts)
    word: Word = "untestable" if idle and not excluded else verdict.word
    return replace(verdict, word=word, excluded=excluded, alternatives=len(known))


def _with_groups(verdicts: Sequence[Verdict], results: Results) -> list[Verdict]:
    """The verdicts with the p-values of those from the same data, and what is multiplicity."""
    published = results.plan.experiment.published
    assert published is not None
    groups = grouped(verdicts)
    of_table = Counter(group[0].printed.table for group in groups)
    found: dict[int, Verdict] = {}
    for number, group in enumerate(groups):
        p, adjusted = _NAN, dict.fromkeys(map(id, group), _NAN)
        if pool := _pool(group, results.plan.trials, published):
            p = pool.joint_p()
            every = adjusted_p(pool.rows, pool.printed, pool.half_unit) * of_table[group[0].printed.table]
            adjusted |= zip(map(id, pool.verdicts), np.minimum(every, 1.0).tolist(), strict=True)
        for one in group:
            found[id(one)] = replace(one, group=number, joint=p, adjusted=adjusted[id(one)])
    sound = {name for name in of_table if _table_p(found.values(), name) > LEVEL}
    return [_with_multiplicity(found[id(verdict)], sound) for verdict in verdicts]


def fitting_runs(verdicts: Sequence[Verdict], results: Results) -> dict[str, tuple[int, ...]]:
    """For each table, and each quantity of it, which of :data:`RUNS` its numbers together permit.

    Empty where the paper says how many runs it averaged.
    """
    published = results.plan.experiment.published
    if published is None or published.paper_trials != "unknown":
        return {}
    found: dict[str, tuple[int, ...]] = {}
    tables = dict.fromkeys(one.printed.table for one in verdicts)
    columns = dict.fromkeys((one.printed.table, one.printed.quantity) for one in verdicts)
    parts = {table: [one for one in verdicts if one.printed.table == table] for table in tables}
    if len(columns) > len(tables):
        parts |= {
            f"{table}, {quantity}": [one for one in parts[table] if one.printed.quantity == quantity]
            for table, quantity in columns
        }
    for name, part in parts.items():
        p = {
            runs: combined_p(group_p(group, results.plan.trials, published, runs) for group in grouped(part))
            for runs in RUNS
        }
        found[name] = tuple(runs for runs, value in p.items() if value > LEVEL)
    return found


def _table_p(verdicts: Iterable[Verdict], table: str) -> float:
    """The p-value of a table: that of its groups together, whose data are independent."""
    return combined_p({one.group: one.joint for one in verdicts if one.printed.table == table}.values())


def _with_multiplicity(verdict: Verdict, sound: Container[str]) -> Verdict:
    """Marked if it differs as some number of a table may that is sound as a whole."""
    likely = verdict.word == "differs" and not verdict.mark and verdict.adjusted > LEVEL
    return replace(verdict, mark="multiplicity") if likely and verdict.printed.table in sound else verdict


def grouped(verdicts: Iterable[Verdict]) -> list[list[Verdict]]:
    """The verdicts on numbers of one table from the same data together, or from data that share draws."""
    groups: dict[tuple[str, str], list[Verdict]] = {}
    for verdict in verdicts:
        data = verdict.series.unit.data
        # Trials that draw the same numbers in all cases are not independent over the cases.
        drawn = "shared" if data.streams.share else str(data.key)
        groups.setdefault((verdict.printed.table, drawn), []).append(verdict)
    return list(groups.values())


@dataclass(frozen=True)
class _Pool:
    """Printed numbers of one group, and the rows that are as likely as theirs."""

    verdicts: Sequence[Verdict]
    rows: Array
    printed: Array
    half_unit: Array

    def joint_p(self) -> float:
        """The p-value, the numbers of a printed row taken together."""
        return joint_p(self.rows, self.printed, self.half_unit, [one.printed.row for one in self.verdicts])


def group_p(group: Sequence[Verdict], trials: int, published: Published, runs: int = 1) -> float:
    """The p-value of numbers from the same data, against the joint distribution of our trials; nan: none.

    Bounds, misprints, what does not count, what is known in few trials and what does not vary (its digits
    are equal or differ) are left out. Where the paper does not say how many runs it averaged, as many as
    ``runs`` are taken.
    """
    pool = _pool(group, trials, published, runs)
    return pool.joint_p() if pool else _NAN


def _pool(group: Sequence[Verdict], trials: int, published: Published, runs: int = 1) -> _Pool | None:
    group = [one for one in group if one.is_drawn]
    if not group or is_same_data(published, trials):
        return None
    rows = np.stack([one.series.values[:_MOST_ROWS] for one in group], axis=1)
    rows = rows[np.all(np.isfinite(rows), axis=1)]
    if len(rows) < 2:
        return None
    averaged = runs if published.paper_trials == "unknown" else published.paper_trials
    if averaged != 1:
        theirs = None if averaged == "exact" else int(averaged)
        rows = replicates(rows, [_STATISTICS[one.cell.statistic] for one in group], theirs)
    printed = np.array([one.printed.value for one in group])
    return _Pool(group, rows, printed, np.array([one.printed.half_unit for one in group]))


_STATISTICS: Mapping[Statistic, Callable[[Array], Array]] = {
    "mean": lambda values: np.asarray(np.mean(values, axis=-1)),
    "median": lambda values: np.asarray(np.median(values, axis=-1)),
    "std": lambda values: np.asarray(np.std(values, axis=-1, ddof=1)),
}


def is_same_data(published: Published, trials: int) -> bool:
    """Whether the trials are those that the paper ran."""
    return published.same_data and trials == published.paper_trials


@dataclass(frozen=True)
class _Judgement:
    ours: float
    low: float
    high: float
    interval: str
    p: float = _NAN
    agreement: float = _NAN
    """How likely the interval of another block of trials holds the printed number."""


@np.errstate(all="ignore")
def _judged(printed: Printed, cell: PublishedCells, series: Series, published: Published) -> Verdict:
    found = _judgement(printed, series, cell.statistic, published)
    word: Word = "agrees" if printed.lies_in(found.low, found.high) else "differs"
    if not printed.bound and abs(found.ours - printed.value) <= printed.slack:
        word = "exact"
    interval = found.interval
    if published.same_data and not is_same_data(published, len(series.values)):
        interval += f"; the paper's own data are {published.paper_trials} trials, not {len(series.values)}"
    if not found.low <= found.ours <= found.high and not math.isnan(found.ours):
        interval += f"; ours lies outside it, as a {cell.statistic} may that hangs on few trials"
    flips = max(0.0, found.agreement if word == "differs" else 1.0 - found.agreement)
    if is_constant(series.valid):
        flips = 0.0
    return Verdict(
        printed,
        cell,
        series,
        found.ours,
        found.low,
        found.high,
        word,
        "",
        interval,
        p=found.p,
        flips=flips,
    )


def _judgement(printed: Printed, series: Series, statistic: Statistic, published: Published) -> _Judgement:
    ours, runs = series.value(statistic), published.paper_trials
    valid = series.valid
    if not len(valid):
        return _Judgement(ours, ours, ours, "no trial succeeded")
    if is_same_data(published, len(series.values)):
        return _Judgement(ours, ours, ours, OWN_DATA)
    if runs in ("unknown", 1):
        return replace(_of_single_trials(printed, valid, runs), ours=ours)
    return _of_averages(printed, series, statistic, runs)


def _of_single_trials(printed: Printed, valid: Array, runs: int | str) -> _Judgement:
    """Against the distribution of single trials."""
    from scipy.stats import betabinom

    n = len(valid)
    below = int(np.sum(valid < printed.value - printed.slack))
    above = int(np.sum(valid > printed.value + printed.slack))
    why = "the paper ran one" if runs == 1 else "the paper does not say how many runs it averages"
    share = LEVEL if printed.bound else LEVEL / 2.0
    low, high = central(valid, printed.bound)
    interval = f"central 95 % of single trials: {why}"
    if printed.bound:
        interval = (
            f"all but the {'highest' if printed.bound == '>' else 'lowest'} 5 % of single trials: {why}"
        )
    if share * (n + 1.0) < 1.0 and not is_constant(valid):
        # So few trials have no such quantiles.
        low, high = _open(float(valid.min()), float(valid.max()), printed.bound)
        interval = f"the range of {n} single trials, {n - 1} of {n + 1} more of which lie in it: {why}"
    # Another block finds the number outside if too few of its trials lie on one side of it. How many do so is
    # beta-binomial, as the share is known from these trials only, with Jeffreys' prior.
    ties = (n - below - above) / 2.0
    shape = below + ties + 0.5, above + ties + 0.5
    too_few = math.floor(share * n)
    outside = {"<": betabinom.cdf(too_few, n, *shape), ">": betabinom.cdf(too_few, n, *shape[::-1])}
    beyond = outside[printed.bound] if printed.bound else outside["<"] + outside[">"]
    tail = {"<": n - above, ">": n - below}.get(printed.bound, n - max(below, above))
    p = min(1.0, (1.0 if printed.bound else 2.0) * (tail + 1.0) / (n + 1.0))
    return _Judgement(_NAN, low, high, interval, p, float(min(max(1.0 - beyond, 0.0), 1.0)))


def central(values: Array, bound: str) -> tuple[float, float]:
    """The central 95 % of values; for a bound all but the 5 % on the side that speaks against it."""
    share = LEVEL if bound else LEVEL / 2.0
    low, high = np.quantile(values, [share, 1.0 - share])
    return _open(float(low), float(high), bound)


def _open(low: float, high: float, bound: str) -> tuple[float, float]:
    """The interval, open on the side of the claim."""
    return -math.inf if bound == ">" else low, math.inf if bound == "<" else high


def _fitting_runs(verdict: Verdict) -> tuple[int, ...]:
    """The numbers of runs whose statistic may be the printed one."""
    valid, printed = verdict.series.valid, verdict.printed
    fitting = []
    for runs in RUNS if len(valid) else ():
        low, high = verdict.low, verdict.high
        if runs > 1:
            statistic = _STATISTICS[verdict.cell.statistic]
            low, high = central(replicates(valid[:_MOST_ROWS, None], [statistic], runs), printed.bound)
        if printed.lies_in(low, high):
            fitting.append(runs)
    return tuple(fitting)


def _of_averages(printed: Printed, series: Series, statistic: Statistic, runs: int | str) -> _Judgement:
    """Against the distribution of a statistic over so many runs."""
    from scipy.special import ndtr

    ours, error = series.value(statistic), series.standard_error(statistic)
    if math.isnan(error):
        return _Judgement(ours, -math.inf, math.inf, "none: a single trial has no spread")
    theirs = 0.0 if runs == "exact" else len(series.valid) / float(runs)
    both = error * (1.0 + theirs) ** 0.5
    reach = 3.0 * both
    side = {"<": "-", ">": "+"}.get(printed.bound, "+-")
    source = "a formula" if runs == "exact" else f"{runs} runs"
    interval = f"{statistic} {side} 3 standard errors; the paper: {source}"
    low, high = _open(ours - reach, ours + reach, printed.bound)
    # How far ours lies on the wrong side, and where it would have to lie.
    above, below = ours - printed.value, printed.value - ours
    away = {"<": above, ">": below}.get(
        printed.bound, max(above, below, printed.half_unit) - printed.half_unit
    )
    tails = 1.0 if printed.bound else 2.0
    p = tails * ndtr(-away / both) if both else float(away <= 0.0)
    if not error:
        return _Judgement(ours, low, high, interval, float(min(p, 1.0)), float(away <= 0.0))
    # Another block's statistic differs from ours by the errors of both.
    slack, spread = reach + printed.half_unit, error * 2.0**0.5
    too_high = 0.0 if printed.bound == ">" else ndtr((ours - printed.value - slack) / spread)
    too_low = 0.0 if printed.bound == "<" else ndtr((printed.value - slack - ours) / spread)
    return _Judgement(ours, low, high, interval, float(min(p, 1.0)), float(1.0 - too_high - too_low))
