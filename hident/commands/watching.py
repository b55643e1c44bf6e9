"""A run seen from another terminal: ``hident status --watch`` counts what is stored, again and again."""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from hident.engine.chunks import in_common
from hident.engine.experiment import Plan, Unit
from hident.engine.store import Store
from hident.progress import duration, rate_of

if TYPE_CHECKING:
    from rich.console import Group

_WINDOW_SECONDS = 30.0
"""The rate is that of the last so many seconds."""
_HEAD = ("configuration", "case", "stored", "of", "failed", "rate", "left")


@dataclass(frozen=True)
class Counts:
    """How many trials of a key are stored, and how many of them failed."""

    trials: int
    failed: int


def counts(store: Store, keys: Iterable[str], below: int) -> dict[str, Counts]:
    """The counts of each key's trials with numbers under ``below``."""
    return {
        key: Counts(len(trials), sum(bool(trial.failure) for trial in trials))
        for key, trials in store.read(keys, below).items()
    }


@dataclass
class Row:
    """How far a case is, or, with an empty ``case``, a whole configuration."""

    config: str
    case: str
    units: list[tuple[Unit, Mapping[str, str]]]
    of: int
    stored: int = 0
    failed: int = 0
    _seen: deque[tuple[float, int]] = field(default_factory=deque)

    def take(self, found: Mapping[str, Counts], now: float) -> None:
        """Take what is counted now."""
        of_units = [[found[key] for key in keys.values()] for _, keys in self.units]
        self.stored = sum(min(one.trials for one in of_metrics) for of_metrics in of_units)
        self.failed = sum(max(one.failed for one in of_metrics) for of_metrics in of_units)
        self._seen.append((now, self.stored))
        while len(self._seen) > 2 and self._seen[1][0] <= now - _WINDOW_SECONDS:
            self._seen.popleft()

    @property
    def gained(self) -> int:
        """How many trials came within the window."""
        return self._seen[-1][1] - self._seen[0][1]

    @property
    def rate(self) -> str:
        """The rate within the window; empty if nothing came."""
        return rate_of(self.gained, self._seconds) if self.gained > 0 else ""

    @property
    def left(self) -> str:
        """How long the rest takes at this rate; empty if that cannot be known."""
        if self.stored == self.of:
            return "done"
        return duration((self.of - self.stored) * self._seconds / self.gained) if self.gained > 0 else ""

    @property
    def cells(self) -> tuple[str, ...]:
        """A cell for each column."""
        numbers = (self.stored, self.of, self.failed)
        return (self.config, self.case, *map(str, numbers), self.rate, self.left)

    @property
    def said(self) -> str:
        """The row as a line."""
        rest = [f"{self.failed} failed"] if self.failed else []
        if self.rate:
            rest.append(self.rate)
        if self.left:
            rest.append("done" if self.left == "done" else f"{self.left} left")
        named = f"{self.config}, {self.case}" if self.case else self.config
        return f"{named}: {self.stored}/{self.of} trials" + "".join(f", {part}" for part in rest)

    @property
    def _seconds(self) -> float:
        return self._seen[-1][0] - self._seen[0][0]


class View:
    """How far the runs of plans are: a row for each, and one for each of its cases if there are several."""

    def __init__(
        self, plans: Sequence[Plan], store: Store, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._plans, self._store, self._clock = plans, store, clock
        self.rows = [row for plan in plans for row in _rows(plan)]

    def look(self) -> None:
        """Count again."""
        for plan in self._plans:
            keys = {key for keys in plan.keys for key in keys.values()}
            found = counts(self._store, keys, plan.trials)
            for row in self.rows:
                if row.config == plan.name:
                    row.take(found, self._clock())

    @property
    def complete(self) -> bool:
        """Whether all trials are stored."""
        return all(row.stored == row.of for row in self.rows)

    def shown(self, height: int) -> Group:
        """The rows as a table of at most this height; cases at which nothing happens give way."""
        from rich.console import Group
        from rich.table import Table
        from rich.text import Text

        table = Table(box=None, pad_edge=False)
        for name in _HEAD:
            table.add_column(name, justify="right" if name in _HEAD[2:] else "left", no_wrap=True)
        still = [i for i, row in enumerate(self.rows) if row.case and not row.gained]
        # Those that are done first, then the last ones.
        still.sort(key=lambda i: (self.rows[i].stored < self.rows[i].of, -i))
        spare = len(self.rows) + 1 - height
        # One more, for the line that says so.
        hidden = {*still[: spare + 1]} if spare > 0 else set[int]()
        for i, row in enumerate(self.rows):
            if i not in hidden:
                table.add_row(*row.cells)
        done = sum(self.rows[i].stored == self.rows[i].of for i in hidden)
        note = f"not shown: cases that are done ({done}), and at which nothing happens ({len(hidden) - done})"
        return Group(table, Text(note, overflow="ellipsis", no_wrap=True)) if hidden else Group(table)


def _rows(plan: Plan) -> Iterator[Row]:
    cases: dict[int, list[tuple[Unit, Mapping[str, str]]]] = {}
    for unit, keys in zip(plan.units, plan.keys, strict=True):
        cases.setdefault(unit.data.key, []).append((unit, keys))
    yield Row(plan.name, "", [*zip(plan.units, plan.keys, strict=True)], len(plan.units) * plan.trials)
    if len(cases) > 1:
        for units in cases.values():
            labels = in_common(unit.labels for unit, _ in units)
            case = ", ".join(f"{axis} {label}" for axis, label in labels.items())
            yield Row(plan.name, case, units, len(units) * plan.trials)


def watch(plans: Sequence[Plan], folder: Path, interval: float) -> None:
    """Show how far the runs of plans are, again and again, until all is stored or Ctrl-C is pressed."""
    view = View(plans, Store(folder))
    show = _on_terminal if sys.stdout.isatty() else _in_lines
    show(view, interval)


def _on_terminal(view: View, interval: float) -> None:
    from rich.console import Console
    from rich.live import Live

    console = Console()
    view.look()
    with Live(view.shown(console.height), console=console, auto_refresh=False) as live:
        while not view.complete:
            time.sleep(interval)
            view.look()
            live.update(view.shown(console.height), refresh=True)


def _in_lines(view: View, interval: float) -> None:
    """A line for each row, and one again when it has changed."""
    said: dict[int, int] = {}
    while True:
        view.look()
        for i, row in enumerate(view.rows):
            if said.get(i) != row.stored:
                print(row.said, flush=True)
                said[i] = row.stored
        if view.complete:
            return
        time.sleep(interval)
