"""The state of the ledger: numbers judged, differences explained, and what verdicts can tell."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hident.config.spec import canonical
from hident.config.suggest import one_of
from hident.engine.experiment import load
from hident.engine.run_files import MUTATIONS, NUMBERS, POWER, RUN, VERDICTS
from hident.errors import ConfigError, NothingToCompare
from hident.ledger.joint import combined_p
from hident.ledger.judged import as_number, key_of, place_of, verdict_rows
from hident.ledger.power import VerdictPower, is_of
from hident.ledger.published import CASE, PUBLISHED, Key, Reason, read_published, read_reasons
from hident.ledger.verdicts import COUNTED, LEVEL
from hident.run_folder import RunFolder


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
    wide: int = 0
    """How many of those that agree have an interval wider than the printed number itself."""

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
    """Reasons that cover no difference, or a number that does not differ."""
    astray: tuple[str, ...]
    """Reasons of configurations that are not in the folder."""
    stale: tuple[str, ...]
    """Verdicts on other digits than are printed, and alternatives that were run for what is not there."""


def verify(
    folder: Path, experiments: Path, results: Path | None = None, configs: Path | None = None
) -> Verification:
    """Check the verdicts of all configurations in ``folder`` against today's printed numbers and reasons.

    What is known of alternatives is what is accepted in ``results``, by default the folder itself. With
    ``configs`` each run must be that of the file of its name there.

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
    used: dict[tuple[str, int], dict[tuple[str, Key], str]] = {}
    names: list[str] = []
    for run in found:
        of_run = verdicts_in(run, results or folder)
        config, paper = of_run.config, of_run.paper
        names.append(config)
        reasons = read_reasons(experiments / paper)
        printed = read_published(experiments / paper)
        said = [*of_run.stale]
        said += [] if configs is None else _outdated(configs / f"{config}.yaml", of_run.resolved)
        tables += of_run.tables
        for row in of_run.rows:
            key = key_of(row)
            judged.setdefault(paper, set()).add(key)
            if key not in printed or printed[key].printed != row["printed"]:
                said.append(
                    f"{' / '.join(key)}: {row['printed']} is not what is printed: hident run {config}"
                )
            covering = _covering(reasons, config, key)
            counts = row["mark"] in COUNTED
            if covering is not None and (counts or row["verdict"] == "differs"):
                words = used.setdefault((paper, covering), {})
                # Beside several of our numbers one that differs is enough.
                if words.get((config, key)) != "differs":
                    words[config, key] = row["verdict"]
            elif counts and row["verdict"] == "differs":
                case = f", {row[CASE]}" if row.get(CASE) else ""
                unexplained.append(
                    f"{config}: {' / '.join(key)}{case}: printed {row['printed']}, ours {row['ours']}"
                )
        stale += [f"{config}: {line}" for line in said]
    unjudged, idle, astray = [], [], []
    for paper in sorted({*judged, *_papers(experiments)}):
        missing = [key for key in read_published(experiments / paper) if key not in judged.get(paper, ())]
        unjudged += [f"{paper}: {' / '.join(key)}" for key in missing]
        for i, reason in enumerate(read_reasons(experiments / paper)):
            found_words = set(used.get((paper, i), {}).values())
            if not reason.is_of(names):
                astray.append(f"{paper}: {' or '.join(reason.config)}: {reason.reason}")
            elif found_words != {"differs"}:
                idle.append(f"{paper}: {reason.reason}{_of_what(found_words)}")
    return Verification(
        tuple(tables), tuple(unexplained), tuple(unjudged), tuple(idle), tuple(astray), tuple(stale)
    )


@dataclass(frozen=True)
class RunVerdicts:
    """The verdicts of one run."""

    config: str
    paper: str
    resolved: dict[str, Any]
    rows: tuple[dict[str, str], ...]
    """The rows of verdicts.csv."""
    power: VerdictPower | None
    """What is accepted of its alternatives; None if there are none, or they cannot be used."""
    tables: tuple[TableState, ...]
    stale: tuple[str, ...]
    """What is wrong with what is accepted of its alternatives."""


def verdicts_in(folder: Path, results: Path) -> RunVerdicts:
    """The verdicts of the run in ``folder``, and what ``results`` holds of its alternatives.

    ConfigError if the verdicts cannot be read, or are not as the run wrote them.
    """
    config, paper, resolved = _origin(folder)
    rows = _verdicts(folder)
    power, stale = _power(results, config, resolved, rows)
    return RunVerdicts(
        config, paper, resolved, tuple(rows), power, tuple(_tables(config, rows, power)), tuple(stale)
    )


def _outdated(path: Path, resolved: dict[str, Any]) -> list[str]:
    """What is wrong with a run whose configuration is not that of a file."""
    if not path.exists():
        return [f"{path} is gone"]
    today, then = dict(canonical(load(path).experiment)), dict(resolved)
    # What is judged says by how many trials it is.
    today.pop("trials"), then.pop("trials")
    return [] if today == then else [f"it was run for another configuration than {path}: hident run {path}"]


def _papers(experiments: Path) -> list[str]:
    return [path.parent.name for path in experiments.glob(f"*/{PUBLISHED}")]


def _of_what(words: Iterable[str]) -> str:
    others = sorted(set(words) - {"differs"})
    return f" (it covers others, too: {one_of(others)}; name the rows that differ)" if others else ""


def table_states(folder: Path, results: Path) -> list[TableState]:
    """The state of each table that a run was held against; ``results`` holds what is known of alternatives.

    ConfigError if its files cannot be read.
    """
    config, _, resolved = _origin(folder)
    rows = verdict_rows(folder / VERDICTS)
    return _tables(config, rows, _power(results, config, resolved, rows)[0])


def _tables(config: str, rows: Sequence[dict[str, str]], power: VerdictPower | None) -> list[TableState]:
    found = []
    for table in dict.fromkeys(row["table"] for row in rows):
        of_table = [row for row in rows if row["table"] == table]
        counted = [row for row in of_table if row["mark"] in COUNTED]
        groups = {row["group"]: as_number(row["joint_p"]) for row in of_table}
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
                sum(row["verdict"] == "agrees" and as_number(row["width"]) > 1.0 for row in counted),
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
        number = found.numbers.get(place_of(row))
        if number is not None and number.printed != row["printed"]:
            said.append(f"they were run for other printed numbers: {remedy}")
        elif number is not None and row["alternatives"] != str(len(number.excluded)):
            said.append(f"the run did not know them: hident run {config}")
    return found, list(dict.fromkeys(said))


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
    return verdict_rows(folder / VERDICTS)
