"""How tables write numbers, and what their notes say."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from hident.config.suggest import counted, one_of
from hident.engine.results import Series
from hident.ledger.verdicts import Verdict, Word

SIGNS: dict[Word, str] = {"exact": "=", "agrees": "~", "untestable": "?", "differs": "!"}
"""What stands behind a printed number, by the word of its verdict."""
LEGEND = "Beside ours, the printed number: "
"""How the note begins that says what the signs mean."""
_LEGEND = (
    f"{LEGEND}`=` ours rounds to it, `~` it lies in the interval that the trials "
    "give and not in that of every alternative, `?` it lies in all of them, `!` it differs."
)


def written(value: float, digits: int = 3) -> str:
    """A number with ``digits`` significant digits, and at least its integer part in full."""
    if not math.isfinite(value):
        return "-"
    if value and not 1e-4 <= abs(value) < 10.0 ** max(5, digits):
        return f"{value:.{digits - 1}e}"
    return f"{value:.{decimals_of(value, digits)}f}"


def decimals_of(value: float, digits: int) -> int:
    """The decimals that show ``digits`` significant digits of a value."""
    rounded = float(f"{value:.{digits - 1}e}")
    return max(0, digits - 1 - math.floor(math.log10(abs(rounded)))) if value else 0


def judged(verdict: Verdict | None) -> str:
    """The printed number with the sign of its verdict; nothing where nothing is printed."""
    return f"{verdict.printed.printed} {SIGNS[verdict.word]}" if verdict else ""


def legend(verdicts: Iterable[Verdict]) -> list[str]:
    """What the signs and the intervals of the verdicts mean, for the notes of a table."""
    return [_LEGEND, *(f"Interval: {text}." for text in dict.fromkeys(v.interval for v in verdicts))]


@dataclass(frozen=True)
class Failure:
    """Trials of one unit that failed alike."""

    series: tuple[Series, ...]
    """What they have no values of."""
    of_metrics: bool
    """Whether it was not the estimate that failed, so that other metrics of the unit may be there."""
    reasons: tuple[tuple[str, int], ...]
    """The kinds of reasons with their counts, the most frequent first."""

    @property
    def failed(self) -> int:
        """How many they are."""
        return int(self.series[0].statistics["failed"])

    @property
    def trials(self) -> int:
        """Of how many."""
        return int(self.series[0].statistics["trials"])

    @property
    def metrics(self) -> tuple[str, ...]:
        """The metrics without values, each once."""
        return tuple(dict.fromkeys(one.metric for one in self.series))


def failing(series: Iterable[Series]) -> Iterator[Failure]:
    """What failed and why, once for all metrics of a unit that failed alike."""
    alike: dict[tuple[Any, ...], list[Series]] = {}
    for one in series:
        if one.statistics["failed"]:
            own = f"{one.metric}: "
            reasons = tuple((text.removeprefix(own), count) for text, count in one.reasons)
            of_metric = any(text.startswith(own) for text, _ in one.reasons)
            key = id(one.unit), one.statistics["failed"], reasons, of_metric
            alike.setdefault(key, []).append(one)
    for (_, _, reasons, of_metric), found in alike.items():
        yield Failure(tuple(found), of_metric, reasons)


def failures(series: Iterable[Series]) -> Iterator[str]:
    """What failed and why, for the notes of a table.

    Where not only the estimate failed, the metrics are named: the others of the unit are there.
    """
    for one in failing(series):
        metrics = f" for {one_of(one.metrics)}" if one.of_metrics else ""
        whose = "its" if metrics else "the"
        yield (
            f"{one.failed} of {counted(one.trials, 'trial')} of {one.series[0].unit.described()} "
            f"failed{metrics}{_why(one.reasons)} and are left out of {whose} statistics."
        )


def _why(reasons: Sequence[tuple[str, int]]) -> str:
    if not reasons:
        return ""
    if len(reasons) == 1:
        return f" ({reasons[0][0]})"
    return f" ({'; '.join(f'{count} times: {text}' for text, count in reasons)})"
