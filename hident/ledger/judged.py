"""The verdicts that a run wrote, and the trials behind each: read from its folder alone.

The folder of a run of long ago, or of a configuration that is not here, says what it found without being run
or loaded again.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from hident.config.suggest import one_of
from hident.engine.experiment import Statistic
from hident.errors import ConfigError
from hident.ledger.published import CASE, Key, Place, Printed
from hident.ledger.trial_values import Key as SeriesKey
from hident.ledger.trial_values import TrialValues
from hident.ledger.verdicts import COLUMNS, COUNTED, Word


@dataclass(frozen=True)
class Judged:
    """A row of verdicts.csv: a printed number beside ours (see docs/verdicts.md for its columns).

    ``statistic`` over the trials of ``series``, a key of :class:`TrialValues`, is what stands beside it; None
    where the folder does not say it.
    """

    printed: Printed
    ours: float
    low: float
    high: float
    word: Word
    reason: str
    interval: str
    p: float
    flips: float
    excluded: int
    alternatives: int
    mark: str
    joint: float
    case: str
    series: SeriesKey | None = None
    statistic: Statistic | None = None

    @property
    def key(self) -> Key:
        """Its table, row and quantity in the paper."""
        return self.printed.key

    @property
    def place(self) -> Place:
        """The same, and which of ours stands beside it."""
        return (*self.key, self.case)

    @property
    def counts(self) -> bool:
        """Whether it says anything that another number, or the configuration itself, does not."""
        return self.mark in COUNTED


def key_of(row: Mapping[str, str]) -> Key:
    """The table, row and quantity in the paper that a row of verdicts.csv is of."""
    return row["table"], row["row"], row["quantity"]


def place_of(row: Mapping[str, str]) -> Place:
    """The same, and which of ours stands beside it."""
    return (*key_of(row), row.get(CASE) or "")


def verdict_rows(file: Path) -> list[dict[str, str]]:
    """The rows of a verdicts.csv.

    ConfigError if it cannot be read, holds none, lacks a column, or holds a verdict that is none.
    """
    again = "run the configuration again"
    try:
        with file.open(newline="", encoding="utf-8") as lines:
            rows = list(csv.DictReader(lines))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{file} cannot be read ({error}): {again}") from None
    if not rows:
        raise ConfigError(f"{file} holds no verdict: {again}")
    if any(row.get(name) is None for row in rows for name in COLUMNS):
        raise ConfigError(f"{file} lacks columns: {again}")
    allowed = get_args(Word)
    if unknown := [row["verdict"] for row in rows if row["verdict"] not in allowed]:
        raise ConfigError(f"{file} holds the verdict '{unknown[0]}' (allowed: {one_of(allowed)}): {again}")
    return rows


def judged(file: Path, resolved: Mapping[str, Any], values: TrialValues | None) -> tuple[Judged, ...]:
    """The verdicts of a verdicts.csv, with what stands behind them in the trials of the same run.

    ``resolved`` is the configuration as run.json holds it.

    ConfigError as of :func:`verdict_rows`, or if a number in it is none.
    """
    rows = verdict_rows(file)
    keys = [key_of(row) for row in rows]
    behind = [] if values is None else list(_behind(resolved, values))
    # They stand in the order in which the run judged them; anything else is not what it wrote.
    known = [key for key, *_ in behind] == keys
    try:
        return tuple(_judged(row, *(behind[i][1:] if known else (None, None))) for i, row in enumerate(rows))
    except ValueError as error:
        raise ConfigError(f"{file} cannot be read ({error}): run the configuration again") from None


def _judged(row: Mapping[str, str], series: SeriesKey | None, statistic: Statistic | None) -> Judged:
    word: Any = row["verdict"]
    printed = Printed(*key_of(row), row["printed"], "")
    float(printed.value)
    return Judged(
        printed=printed,
        ours=as_number(row["ours"]),
        low=as_number(row["low"]),
        high=as_number(row["high"]),
        word=word,
        reason=row["reason"],
        interval=row["interval"],
        p=as_number(row["p"]),
        flips=as_number(row["flips"]),
        excluded=int(row["excluded"]),
        alternatives=int(row["alternatives"]),
        mark=row["mark"],
        joint=as_number(row["joint_p"]),
        case=row.get(CASE) or "",
        series=series,
        statistic=statistic,
    )


def as_number(text: str) -> float:
    """A number of verdicts.csv; nan if it is none, as where there is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def _behind(resolved: Mapping[str, Any], values: TrialValues) -> Iterator[tuple[Key, SeriesKey, Statistic]]:
    """Each judged number's key, the series beside it and its statistic, in the order of judging."""
    for cell in (resolved.get("published") or {}).get("cells", ()):
        pairs = cell.get("quantities") or {cell.get("quantity"): cell.get("metric")}
        at = {axis: str(label) for axis, label in (cell.get("at") or {}).items()}
        for quantity, metric in pairs.items():
            for key in values.series:
                # An axis that does not touch it is empty there, and does not count.
                labels = {axis: label for axis, label in zip(values.axes, key, strict=False) if label}
                is_held = all(labels.get(axis, label) == label for axis, label in at.items())
                if is_held and key[-2:] == (cell["estimator"], metric):
                    row, name = (_filled(text, labels) for text in (cell["row"], quantity))
                    yield (cell["table"], row, name), key, cell.get("statistic", "mean")


def _filled(template: str, labels: Mapping[str, str]) -> str:
    return re.sub(r"{([^{}]*)}", lambda found: labels.get(found[1], found[0]), template)


def by_table(numbers: Iterable[Judged]) -> dict[str, list[Judged]]:
    """The numbers of each table of the paper, in their order."""
    found: dict[str, list[Judged]] = {}
    for one in numbers:
        found.setdefault(one.printed.table, []).append(one)
    return found


def by_reason(numbers: Sequence[Judged]) -> dict[str, list[Judged]]:
    """The numbers that differ, those of one reason together."""
    found: dict[str, list[Judged]] = {}
    for one in numbers:
        if one.word == "differs":
            found.setdefault(one.reason, []).append(one)
    return found
