"""Folders of results, as far as they are there: what a run of any state left, and many runs in a list."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hident.commands.terminal import WORDS, signed, terminal, text_of
from hident.config.suggest import counted, one_of
from hident.engine.run_files import CRASHES, OWN, PAGE, RUN, TRIALS, VERDICTS
from hident.errors import ConfigError, Exit, NothingToCompare
from hident.ledger.judged import Judged, judged, verdict_rows
from hident.ledger.trial_values import TrialValues
from hident.reports.page import Page
from hident.reports.tables.writing import SIGNS
from hident.run_folder import RunFolder

if TYPE_CHECKING:
    from rich.text import Text

_LEGEND = ", ".join(f"{SIGNS[word]} {word}" for word in WORDS)


@dataclass(frozen=True)
class FoundRun:
    """The folder of a run, each of its files read once."""

    folder: RunFolder

    @cached_property
    def content(self) -> Mapping[str, Any]:
        return self.folder.run() or {}

    @property
    def experiment(self) -> Mapping[str, Any]:
        found = self.content.get("experiment")
        return found if isinstance(found, dict) else {}

    @property
    def resolved(self) -> Mapping[str, Any]:
        """The configuration as run.json holds it; empty in the folder of alternatives."""
        found = self.experiment.get("resolved")
        return found if isinstance(found, dict) else {}

    @property
    def name(self) -> str:
        return str(self.experiment.get("config", self.folder.path.resolve().name))

    @cached_property
    def page(self) -> Page | None:
        try:
            return Page.read((self.folder.path / PAGE).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError):
            return None

    @cached_property
    def values(self) -> TrialValues | None:
        try:
            return TrialValues.decoded((self.folder.path / TRIALS).read_bytes())
        except (OSError, ValueError, EOFError):
            return None

    @cached_property
    def numbers(self) -> tuple[Judged, ...]:
        file = self.folder.path / VERDICTS
        return judged(file, self.resolved, self.values) if file.exists() else ()

    @property
    def counted(self) -> str:
        """How the printed numbers came out: '15 ~, 6 ?, 3 !'."""
        file = self.folder.path / VERDICTS
        words = Counter(row["verdict"] for row in verdict_rows(file)) if file.exists() else Counter[str]()
        return ", ".join(f"{words[word]} {SIGNS[word]}" for word in WORDS if words[word])

    @cached_property
    def state(self) -> str:
        """What is to be known of the files: 'fine', or what is not."""
        if not self.folder.finished:
            return "crashed" if (self.folder.path / CRASHES).is_file() else "not finished"
        if self.folder.run() is None:
            return f"{RUN} is broken"
        if altered := self.folder.altered():
            return f"altered: {one_of(altered)}"
        said = []
        if undrawn := self.folder.undrawn():
            said.append(f"not drawn: {one_of(undrawn)}")
        if count := self.folder.timed_out():
            said.append(f"{counted(count, 'trial')} timed out")
        return "; ".join(said) or "fine"


def is_run(folder: Path) -> bool:
    """Whether a folder is that of a run."""
    return folder.is_dir() and any((folder / name).is_file() for name in OWN)


def runs_in(folder: Path) -> list[Path]:
    """The folders of the runs in a folder of results."""
    return [path for path in sorted(folder.glob("[!.]*")) if is_run(path)]


def is_results(path: Path) -> bool:
    """Whether a run or a folder of runs is meant, by what is there or, of what is not, by its name."""
    if path.is_dir():
        return is_run(path) or bool(runs_in(path)) or not any(path.iterdir())
    return not path.suffix and not path.exists() and len(path.parts) > 1 and bool(runs_in(path.parent))


def list_runs(folders: Sequence[Path]) -> Exit:
    """List the runs of folders of results, and the state of each.

    NothingToCompare if there is none.
    """
    from rich.table import Table as Shown

    found: dict[str, dict[Path, FoundRun]] = {}
    for folder in folders:
        for path in runs_in(folder):
            found.setdefault(path.name, {})[folder] = FoundRun(RunFolder(path))
    if not found:
        raise NothingToCompare(f"there is no run in {one_of(map(str, folders))}: hident run CONFIG")
    several = len(folders) > 1
    shown = Shown(box=None, pad_edge=False)
    shown.add_column("run", no_wrap=True)
    shown.add_column("trials", justify="right", no_wrap=True)
    shown.add_column("printed numbers")
    for folder in folders:
        shown.add_column(str(folder))
    if several:
        shown.add_column("trials alike")
    for name, runs in sorted(found.items()):
        first = next(iter(runs.values()))
        cells = [text_of(name), text_of(str(first.experiment.get("trials", "-"))), signed(_counted(first))]
        cells += [_state(runs.get(folder)) for folder in folders]
        shown.add_row(*cells, *([text_of(_alike([*runs.values()]))] if several else []))
    console = terminal()
    console.print(shown)
    count = len(found)
    console.print(
        text_of(
            f"{counted(count, 'run')}. {_LEGEND}. One of them: hident show "
            f"{shlex.quote(str(next(iter(next(iter(found.values())).values())).folder.path))}"
        )
    )
    return Exit.FINE


def _counted(run: FoundRun) -> str:
    try:
        return run.counted
    except ConfigError:
        return f"{VERDICTS} is broken"


def _state(run: FoundRun | None) -> Text:
    if run is None:
        return text_of("-")
    made = str((run.content.get("provenance") or {}).get("finished", ""))[:10]
    return text_of(f"{run.state} {made}".strip(), "" if run.state == "fine" else "bold red")


def _alike(runs: Sequence[FoundRun]) -> str:
    """Whether the trials of runs are the same bytes."""
    found = {((run.content.get("provenance") or {}).get("sha256") or {}).get(TRIALS) for run in runs}
    if len(runs) < 2 or None in found:
        return "-"
    return "yes" if len(found) == 1 else "no"
