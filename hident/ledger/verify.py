"""The state of the ledger: every printed number judged, and every difference explained."""

from __future__ import annotations

import csv
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from hident.config.suggest import one_of
from hident.engine.run_files import RUN, VERDICTS
from hident.errors import ConfigError, NothingToCompare
from hident.ledger.published import Key, Reason, read_published, read_reasons
from hident.ledger.verdicts import Word
from hident.run_folder import RunFolder

_COLUMNS = ("table", "row", "quantity", "printed", "ours", "verdict")


@dataclass(frozen=True)
class Verification:
    """What the verdicts in a folder of results amount to."""

    counts: dict[str, dict[str, int]]
    """For each configuration, how many printed numbers came out how."""
    unexplained: tuple[str, ...]
    """Differences that no reason covers."""
    unjudged: tuple[str, ...]
    """Printed numbers of the papers that no configuration's verdicts hold."""
    idle: tuple[str, ...]
    """Reasons that cover no difference."""


def verify(folder: Path, experiments: Path) -> Verification:
    """Check the verdicts of all configurations in ``folder`` against today's reasons.

    NothingToCompare if the folder holds no verdicts. ConfigError if a file of the ledger cannot be read, or
    the verdicts of a run are gone or not as it wrote them.
    """
    found = list(filter(_is_judged, sorted(folder.glob("*")))) or list(filter(_is_judged, [folder]))
    if not found:
        raise NothingToCompare(f"{folder} holds no verdicts.csv: run a configuration with 'published:' first")
    counts: dict[str, dict[str, int]] = {}
    unexplained: list[str] = []
    judged: dict[str, set[Key]] = {}
    used: set[tuple[str, int]] = set()
    for results in found:
        config, paper = _origin(results)
        reasons = read_reasons(experiments / paper)
        rows = _verdicts(results)
        counts[config] = dict(Counter(row["verdict"] for row in rows))
        for row in rows:
            key = (row["table"], row["row"], row["quantity"])
            judged.setdefault(paper, set()).add(key)
            if row["verdict"] == "differs":
                covering = _covering(reasons, config, key)
                if covering is None:
                    unexplained.append(
                        f"{config}: {' / '.join(key)}: printed {row['printed']}, ours {row['ours']}"
                    )
                else:
                    used.add((paper, covering))
    unjudged, idle = [], []
    for paper, keys in judged.items():
        missing = [key for key in read_published(experiments / paper) if key not in keys]
        unjudged += [f"{paper}: {' / '.join(key)}" for key in missing]
        for i, reason in enumerate(read_reasons(experiments / paper)):
            if (paper, i) not in used and (reason.config == "*" or reason.config in counts):
                idle.append(f"{paper}: {reason.reason}")
    return Verification(counts, tuple(unexplained), tuple(unjudged), tuple(idle))


def _covering(reasons: tuple[Reason, ...], config: str, key: Key) -> int | None:
    return next((i for i, reason in enumerate(reasons) if reason.covers(config, key)), None)


def _is_judged(folder: Path) -> bool:
    """Whether the folder holds verdicts, or its run.json does not rule out that it should."""
    results = RunFolder(folder)
    if (folder / VERDICTS).exists() or VERDICTS in results.files():
        return True
    match run := results.run():
        case {"experiment": {"resolved": {"published": _}}}:
            return True
    return run is None and results.finished


def _origin(folder: Path) -> tuple[str, str]:
    match RunFolder(folder).run():
        case {"experiment": {"config": config, "resolved": {"paper": paper}}}:
            return str(config), str(paper)
    raise ConfigError(f"{folder / RUN} is not that of a run for a paper: run the configuration again")


def _verdicts(folder: Path) -> list[dict[str, str]]:
    for name in RunFolder(folder).altered():
        if name in (RUN, VERDICTS):
            raise ConfigError(f"{folder / name} was altered since the run: run the configuration again")
    path = folder / VERDICTS
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path} cannot be read ({error}): run the configuration again") from None
    if not rows:
        raise ConfigError(f"{path} holds no verdict: run the configuration again")
    if any(row.get(name) is None for row in rows for name in _COLUMNS):
        raise ConfigError(f"{path} lacks columns: run the configuration again")
    allowed = get_args(Word)
    if unknown := [row["verdict"] for row in rows if row["verdict"] not in allowed]:
        said = f"'{unknown[0]}' (allowed: {one_of(allowed)})"
        raise ConfigError(f"{path} holds the verdict {said}: run the configuration again")
    return rows
