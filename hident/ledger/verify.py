"""The state of the ledger: numbers judged, differences explained, and what verdicts can tell."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from hident.config.suggest import one_of
from hident.engine.run_files import MUTATIONS, NUMBERS, POWER, RUN, VERDICTS
from hident.errors import ConfigError, NothingToCompare
from hident.ledger.joint import combined_p
from hident.ledger.power import VerdictPower, is_of
from hident.ledger.published import Key, Reason, read_published, read_reasons
from hident.ledger.verdicts import COLUMNS, LEVEL, Word
from hident.run_folder import RunFolder

_COUNTED = ("", "multiplicity")


@dataclass(frozen=True)
class TableState:
    """What the verdicts on one table of a paper amount to, in one configuration."""

    config: str
    table: str
    counts: dict[str, int]
    """How many of its printed numbers came out how; those that do not count are left out."""
    uncounted: dict[str, int]
    """How many do not count, and why."""
    joint_p: float
    """How likely a paper of the same experiment prints numbers as far out together; nan: not known."""
    rejected: int
    tried: int
    """The mutation score: how many alternatives the table rejects, and how many were tried."""
    survivors: tuple[str, ...]
    """The alternatives that it does not reject."""

    @property
    def score(self) -> str:
        """The mutation score in words; that of a table that rejects our own reading too says little."""
        if not self.tried:
            return "-"
        return f"{self.rejected} of {self.tried}{', and ours' if self.joint_p < LEVEL else ''}"

    def plain(self) -> dict[str, Any]:
        """As data for JSON."""
        return {**vars(self), "joint_p": None if math.isnan(self.joint_p) else self.joint_p}


@dataclass(frozen=True)
class Verification:
    """What the verdicts in a folder of results amount to."""

    tables: tuple[TableState, ...]
    """The tables of all configurations."""
    unexplained: tuple[str, ...]
    """Differences that no reason covers."""
    unjudged: tuple[str, ...]
    """Printed numbers of the papers that no configuration's verdicts hold."""
    idle: tuple[str, ...]
    """Reasons that cover no difference."""
    stale: tuple[str, ...]
    """Configurations whose alternatives were run for what is not there any more."""


def verify(folder: Path, experiments: Path, results: Path | None = None) -> Verification:
    """Check the verdicts of all configurations in ``folder`` against today's reasons.

    What is known of alternatives is what is accepted in ``results``, by default the folder itself.

    NothingToCompare if the folder holds no verdicts. ConfigError if a file of the ledger cannot be read, or
    the verdicts of a run are gone or not as it wrote them.
    """
    found = list(filter(_is_judged, sorted(folder.glob("*")))) or list(filter(_is_judged, [folder]))
    if not found:
        raise NothingToCompare(f"{folder} holds no verdicts.csv: run a configuration with 'published:' first")
    tables: list[TableState] = []
    unexplained: list[str] = []
    stale: list[str] = []
    judged: dict[str, set[Key]] = {}
    used: set[tuple[str, int]] = set()
    configs: list[str] = []
    for run in found:
        config, paper, resolved = _origin(run)
        configs.append(config)
        reasons = read_reasons(experiments / paper)
        rows = _verdicts(run)
        power, said = _power(results or folder, config, resolved, rows)
        stale += [f"{config}: {line}" for line in said]
        tables += _tables(config, rows, power)
        for row in rows:
            key = (row["table"], row["row"], row["quantity"])
            judged.setdefault(paper, set()).add(key)
            if row["verdict"] == "differs":
                covering = _covering(reasons, config, key)
                if covering is None and row["mark"] in _COUNTED:
                    unexplained.append(
                        f"{config}: {' / '.join(key)}: printed {row['printed']}, ours {row['ours']}"
                    )
                elif covering is not None:
                    used.add((paper, covering))
    unjudged, idle = [], []
    for paper, keys in judged.items():
        missing = [key for key in read_published(experiments / paper) if key not in keys]
        unjudged += [f"{paper}: {' / '.join(key)}" for key in missing]
        for i, reason in enumerate(read_reasons(experiments / paper)):
            if (paper, i) not in used and (reason.config == "*" or reason.config in configs):
                idle.append(f"{paper}: {reason.reason}")
    return Verification(tuple(tables), tuple(unexplained), tuple(unjudged), tuple(idle), tuple(stale))


def _tables(config: str, rows: Sequence[dict[str, str]], power: VerdictPower | None) -> list[TableState]:
    found = []
    for table in dict.fromkeys(row["table"] for row in rows):
        of_table = [row for row in rows if row["table"] == table]
        counted = [row for row in of_table if row["mark"] in _COUNTED]
        groups = {row["group"]: _number(row["joint_p"]) for row in of_table}
        rejected, tried = power.score(table) if power else (0, 0)
        survivors = [one.alternative for one in power.of_table(table) if not one.rejected] if power else []
        found.append(
            TableState(
                config,
                table,
                dict(Counter(row["verdict"] for row in counted)),
                dict(Counter(row["mark"] for row in of_table if row not in counted)),
                combined_p(groups.values()),
                rejected,
                tried,
                tuple(survivors),
            )
        )
    return found


def _power(
    results: Path, config: str, resolved: Any, rows: Sequence[dict[str, str]]
) -> tuple[VerdictPower | None, list[str]]:
    """What is accepted of a configuration's alternatives, and what is wrong with it."""
    if not resolved.get("alternatives"):
        return None, []
    folder = RunFolder(results / POWER / config)
    remedy = f"hident power {config}, then hident accept --power {config}"
    if not folder.finished:
        return None, [f"none are accepted: {remedy}"]
    if folder.altered():
        return None, [f"{folder.path} was altered since it was written: {remedy}"]
    try:
        found = VerdictPower.decoded(*((folder.path / name).read_bytes() for name in (NUMBERS, MUTATIONS)))
    except (OSError, ValueError) as error:
        return None, [f"{folder.path} cannot be read ({error}): {remedy}"]
    if not is_of((folder.path / RUN).read_bytes(), resolved):
        return None, [f"they were run for another configuration: {remedy}"]
    said = []
    for row in rows:
        number = found.numbers.get((row["table"], row["row"], row["quantity"]))
        if number is not None and number.printed != row["printed"]:
            said.append(f"they were run for other printed numbers: {remedy}")
        elif number is not None and row["alternatives"] != str(len(number.excluded)):
            said.append(f"the run did not know them: hident run {config}")
    return found, list(dict.fromkeys(said))


def _number(text: str) -> float:
    """A number of verdicts.csv; nan if it is none, as where there is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


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


def _origin(folder: Path) -> tuple[str, str, dict[str, Any]]:
    """The configuration of a run, its paper, and the configuration as run.json holds it."""
    match RunFolder(folder).run():
        case {"experiment": {"config": config, "resolved": {"paper": paper} as resolved}}:
            return str(config), str(paper), dict(resolved)
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
    if any(row.get(name) is None for row in rows for name in COLUMNS):
        raise ConfigError(f"{path} lacks columns: run the configuration again")
    allowed = get_args(Word)
    if unknown := [row["verdict"] for row in rows if row["verdict"] not in allowed]:
        said = f"'{unknown[0]}' (allowed: {one_of(allowed)})"
        raise ConfigError(f"{path} holds the verdict {said}: run the configuration again")
    return rows
