"""How tables write numbers, and what their notes say."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from hident.config.suggest import one_of
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


def failures(series: Iterable[Series]) -> Iterator[str]:
    """What failed and why, for the notes of a table; once for all metrics of a unit that failed alike.

    Where not only the estimate failed, the metrics are named: the others of the unit are there.
    """
    alike: dict[tuple[Any, ...], list[Series]] = {}
    for one in series:
        if one.statistics["failed"]:
            own = f"{one.metric}: "
            why = _why([(text.removeprefix(own), count) for text, count in one.reasons])
            of_metric = any(text.startswith(own) for text, _ in one.reasons)
            key = id(one.unit), one.statistics["failed"], why, of_metric
            alike.setdefault(key, []).append(one)
    for (_, failed, why, of_metric), found in alike.items():
        metrics = f" for {one_of(dict.fromkeys(one.metric for one in found))}" if of_metric else ""
        yield (
            f"{failed:.0f} of {found[0].statistics['trials']:.0f} trials of {found[0].unit.described()} "
            f"failed{metrics}{why} and are left out of {'its' if metrics else 'the'} statistics."
        )


def _why(reasons: Sequence[tuple[str, int]]) -> str:
    if not reasons:
        return ""
    if len(reasons) == 1:
        return f" ({reasons[0][0]})"
    return f" ({'; '.join(f'{count} times: {text}' for text, count in reasons)})"
