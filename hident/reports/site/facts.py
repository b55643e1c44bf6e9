"""What the folder of a run says, whatever state it is in: nothing here fails, and what is wrong is told."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hident.config.suggest import counted
from hident.engine.run_files import CRASHES, POWER, RUN, VERDICTS
from hident.errors import ConfigError
from hident.ledger.verdicts import COUNTED, Word
from hident.ledger.verify import RunVerdicts, TableState, verdicts_in
from hident.run_folder import RunFolder

WORDS: tuple[Word, ...] = ("exact", "agrees", "untestable", "differs")
"""The verdicts, the surest first."""


@dataclass(frozen=True)
class Facts:
    """What a run was, as far as its folder says it."""

    config: str
    """The name of its configuration; that of the folder where nothing else is known."""
    title: str
    paper: str
    """The folder of its paper under experiments/; empty if it has none."""
    seed: int | None
    trials: int | None
    records: tuple[str, ...]
    """The measured records, in words."""
    resolved: Mapping[str, Any]
    """The configuration; empty where it is not known."""
    provenance: Mapping[str, Any]
    verdicts: RunVerdicts | None
    """The verdicts; None where there are none, or they cannot be read."""
    faults: tuple[str, ...]
    """What is wrong with the folder."""

    @property
    def tables(self) -> tuple[TableState, ...]:
        """What the verdicts on each table amount to."""
        return self.verdicts.tables if self.verdicts else ()

    @property
    def rows(self) -> tuple[dict[str, str], ...]:
        """The rows of verdicts.csv."""
        return self.verdicts.rows if self.verdicts else ()

    @property
    def counted(self) -> tuple[dict[str, str], ...]:
        """The rows of verdicts.csv that count."""
        return tuple(row for row in self.rows if row["mark"] in COUNTED)

    @property
    def counts(self) -> dict[str, int]:
        """How many printed numbers that count came out how."""
        return {word: sum(table.counts.get(word, 0) for table in self.tables) for word in WORDS}

    def kinds(self, section: str) -> tuple[str, ...]:
        """The kinds of the components of a section such as 'estimators', each once."""
        found = self.resolved.get(section)
        specs = found.values() if isinstance(found, Mapping) else ()
        return tuple(dict.fromkeys(str(spec["kind"]) for spec in specs if _is_component(spec)))

    @property
    def is_comparison(self) -> bool:
        """Whether it compares methods on the same trials."""
        return "comparison" in self.kinds("tables")

    @property
    def is_measured(self) -> bool:
        """Whether its data were measured."""
        return "record" in self.resolved or bool(self.records)

    @property
    def finished(self) -> str:
        """The day on which it was finished, as YYYY-MM-DD; empty if that is not known."""
        return str(self.provenance.get("finished", ""))[:10]


def facts_of(folder: RunFolder, name: str, results: Path) -> Facts:
    """What the folder of a run says; of alternatives, what ``results`` holds."""
    run = folder.run() or {}
    experiment = _mapping(run.get("experiment"))
    resolved = _mapping(experiment.get("resolved"))
    faults = list(_faults(folder))
    if run and not (resolved and _is_sound(resolved.get("published", {"cells": []}))):
        faults.append("run.json is not that of a run")
        resolved = {}
    verdicts = None
    if resolved and ((folder.path / VERDICTS).exists() or "published" in resolved):
        try:
            verdicts = verdicts_in(folder.path, results)
            faults += [
                f"{POWER}/{folder.path.name}/{name} is not as it was written"
                for name in RunFolder(results / POWER / verdicts.config).altered()
            ]
        except ConfigError as error:
            faults.append(str(error).replace(f"{folder.path}/", ""))
    return Facts(
        config=str(experiment.get("config", name)),
        title=str(resolved.get("title", name)),
        paper=str(resolved.get("paper") or ""),
        seed=_whole(experiment.get("seed")),
        trials=_whole(experiment.get("trials")),
        records=tuple(map(str, _list(experiment.get("records")))),
        resolved=resolved,
        provenance=_mapping(run.get("provenance")),
        verdicts=verdicts,
        faults=tuple(dict.fromkeys(faults)),
    )


def _faults(folder: RunFolder) -> Iterator[str]:
    if (folder.path / CRASHES).exists():
        yield "trials crashed: crashes.txt has the tracebacks"
    if not folder.finished:
        yield "run.json is missing: the run did not end"
        return
    if folder.run() is None:
        yield "run.json cannot be read"
        return
    if not folder.sealed:
        yield "run.json has no hashes, so nothing tells whether the files are as they were written"
    listed = folder.files()
    missing = [name for name in listed if not (folder.path / name).is_file()]
    yield from (f"{name} is missing" for name in missing)
    yield from (
        f"{name} is not as it was written"
        for name in folder.altered()
        if name not in missing and (name == RUN or (folder.path / name).is_file())
    )
    yield from (f"{name} could not be drawn" for name in folder.undrawn())
    if ended := folder.timed_out():
        verb = "counts" if ended == 1 else "count"
        yield f"{counted(ended, 'trial', 'were')} ended by the clock, and {verb} as failed"


def _is_sound(published: Any) -> bool:
    """Whether it says which of our numbers stand beside which printed ones."""
    match published:
        case {"cells": [*cells]}:
            return all(map(_is_cell, cells))
    return False


def _is_cell(cell: Any) -> bool:
    match cell:
        case {"table": str(), "row": str(), "estimator": str(), "quantity": str(), "metric": str()}:
            named = True
        case {"table": str(), "row": str(), "estimator": str(), "quantities": {**quantities}}:
            named = all(isinstance(metric, str) for metric in quantities.values())
        case _:
            return False
    return named and isinstance(cell.get("at", {}), Mapping) and isinstance(cell.get("statistic", ""), str)


def _is_component(spec: Any) -> bool:
    return isinstance(spec, Mapping) and isinstance(spec.get("kind"), str)


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _whole(value: Any) -> int | None:
    return value if isinstance(value, int) else None
