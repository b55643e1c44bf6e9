"""Trials that failed, by reason, as a run's folder knows them."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hident.engine.run_files import TABLE
from hident.ledger.judged import as_number
from hident.run_folder import RunFolder

UNKNOWN = "The files do not hold why"
"""Stands for the reason in the folders of runs that kept none."""


@dataclass(frozen=True)
class Failed:
    """Trials of one estimator and case that failed for one kind of reason."""

    estimator: str
    case: str
    trials: int
    of: int
    metrics: tuple[str, ...]
    """The metrics that failed; none where the estimate did."""


@dataclass(frozen=True)
class Failures:
    """What a run says of trials that failed."""

    known: bool
    """Whether the folder says which trials failed."""
    by_reason: Mapping[str, Sequence[Failed]]
    """The most frequent reason first."""

    def cut(self, most: int) -> Iterator[tuple[str, int, Sequence[Failed], int]]:
        """Of each reason the text, how often it is given, and so many rows at most; how many are left out."""
        for reason, rows in self.by_reason.items():
            shown = rows[: max(most, 0)]
            most -= len(shown)
            yield reason, sum(row.trials for row in rows), shown, len(rows) - len(shown)


def failures_of(folder: RunFolder) -> Failures:
    """The failures of a run by reason; without the reasons where an older hident wrote its run.json."""
    listed = (folder.run() or {}).get("failures")
    if isinstance(listed, list):
        found = [pair for entry in listed for pair in _listed(entry)]
        return Failures(True, _by_reason(found))
    rows = records(folder.path / TABLE)
    counts = [as_number(row.get("failed", "")) for row in rows]
    known = bool(counts) and not any(map(math.isnan, counts))
    return Failures(known, _by_reason([(UNKNOWN, one) for one in _counted(rows)]))


def records(file: Path) -> list[dict[str, str]]:
    """The rows of a CSV by the names of its columns; none if it cannot be read."""
    try:
        with file.open(newline="", encoding="utf-8") as lines:
            return [
                {name: value or "" for name, value in row.items() if name} for row in csv.DictReader(lines)
            ]
    except (OSError, ValueError, csv.Error):
        return []


def _by_reason(found: Sequence[tuple[str, Failed]]) -> dict[str, list[Failed]]:
    reasons: dict[str, list[Failed]] = {}
    for reason, one in found:
        reasons.setdefault(reason, []).append(one)
    return dict(sorted(reasons.items(), key=lambda item: -sum(one.trials for one in item[1])))


def _listed(entry: Any) -> Iterator[tuple[str, Failed]]:
    """What an entry of run.json says; nothing where it was damaged."""
    match entry:
        case {"estimator": str(name), "at": {**labels}, "trials": int(trials), "reasons": [*reasons]}:
            case = ", ".join(f"{axis} {label}" for axis, label in labels.items())
            metrics = entry.get("metrics", ())
            metrics = tuple(map(str, metrics)) if isinstance(metrics, list) else ()
            for one in reasons:
                match one:
                    case {"reason": str(reason), "trials": int(failed)}:
                        yield reason, Failed(name, case, failed, trials, metrics)


def _counted(rows: Sequence[Mapping[str, str]]) -> Iterator[Failed]:
    """What table.csv counts: alike for metrics of which equally many failed."""
    found: dict[tuple[str, ...], list[str]] = {}
    for row in rows:
        if as_number(row.get("failed", "")) > 0:
            axes = [f"{name} {row[name]}" for name in _axes(row) if row[name]]
            key = (row.get("estimator", ""), ", ".join(axes), row["failed"], row.get("trials", ""))
            found.setdefault(key, []).append(row.get("metric", ""))
    for (estimator, case, failed, trials), metrics in found.items():
        of = as_number(trials)
        yield Failed(
            estimator, case, int(as_number(failed)), 0 if math.isnan(of) else int(of), tuple(metrics)
        )


def _axes(row: Mapping[str, str]) -> list[str]:
    names = list(row)
    return names[: names.index("estimator")] if "estimator" in names else []
