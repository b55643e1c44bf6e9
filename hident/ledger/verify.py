"""The state of the ledger: every printed number judged, and every difference explained."""

from __future__ import annotations

import csv
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from hident.engine.run_files import RUN
from hident.errors import ConfigError, NothingToCompare
from hident.ledger.published import Key, Reason, read_published, read_reasons
from hident.run_folder import RunFolder


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

    Raises
    ------
    NothingToCompare
        If the folder holds no verdicts.
    ConfigError
        If a file of the ledger cannot be read.
    """
    found = sorted(folder.glob("*/verdicts.csv")) or sorted(folder.glob("verdicts.csv"))
    if not found:
        raise NothingToCompare(f"{folder} holds no verdicts.csv: run a configuration with 'published:' first")
    counts: dict[str, dict[str, int]] = {}
    unexplained: list[str] = []
    judged: dict[str, set[Key]] = {}
    used: set[tuple[str, int]] = set()
    for path in found:
        config, paper = _origin(path.parent)
        reasons = read_reasons(experiments / paper)
        rows = _verdicts(path)
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


def _origin(folder: Path) -> tuple[str, str]:
    match RunFolder(folder).run():
        case {"experiment": {"config": config, "resolved": {"paper": paper}}}:
            return str(config), str(paper)
    raise ConfigError(f"{folder / RUN} is not that of a run for a paper: run the configuration again")


def _verdicts(path: Path) -> list[dict[str, str]]:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path} cannot be read ({error}): run the configuration again") from None
    if any(not {"table", "row", "quantity", "printed", "ours", "verdict"} <= row.keys() for row in rows):
        raise ConfigError(f"{path} lacks columns: run the configuration again")
    return rows
