"""A run seen from another terminal: ``hident status --watch`` counts what is stored, again and again."""

from __future__ import annotations

import math
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from hident.config.suggest import counted
from hident.engine.chunks import in_common
from hident.engine.experiment import Plan, Unit
from hident.engine.runner import reached
from hident.engine.store import Count, Store
from hident.progress import duration, rate_of

if TYPE_CHECKING:
    from rich.console import Group

_WINDOW_SECONDS, _WINDOW_TRIALS = 30.0, 10
"""The rate is that of the last so many seconds, and of so many trials at least."""
_LATE_SECONDS = 10.0
"""A case at which nothing came for so long, while something came at another, is not at work."""
_HEAD = ("configuration", "case", "stored", "of", "failed", "rate", "left")


@dataclass
class Row:
    """How far a case is, or, with an empty ``case``, a whole configuration."""

    config: str
    case: str
    units: list[tuple[Unit, Mapping[str, str]]]
    of: int
    stored: int = 0
    failed: int = 0
    last: float = -math.inf
    """When trials were last seen to come."""
    at_work: bool = False
    """Whether trials come now: of a case, whether no other case's came clearly later."""
    _seen: deque[tuple[float, int]] = field(default_factory=deque)
    _now: float = 0.0

    def take(self, found: Mapping[str, Count], now: float) -> None:
        """Take what is counted now."""
        of_units = [[found[key] for key in keys.values()] for _, keys in self.units]
        self.stored = sum(min(one.trials for one in of_metrics) for of_metrics in of_units)
        self.failed = sum(max(one.failed for one in of_metrics) for of_metrics in of_units)
        self._now = now
        if not self._seen or self.stored != self._seen[-1][1]:
            self.last = now if self._seen else -math.inf
            self._seen.append((now, self.stored))
        while len(self._seen) > 2 and self._is_enough(*self._seen[1]):
            self._seen.popleft()

    def _is_enough(self, then: float, stored: int) -> bool:
        return self._now - then >= _WINDOW_SECONDS and self.stored - stored >= _WINDOW_TRIALS

    @property
    def rate(self) -> str:
        """The rate of late; empty if none come."""
        return rate_of(self._gained, self._seconds) if self.at_work else ""

    @property
    def left(self) -> str:
        """How long the rest takes at this rate; empty if that cannot be known."""
        if self.stored == self.of:
            return "done"
        return duration((self.of - self.stored) * self._seconds / self._gained) if self.at_work else ""

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
        return f"{named}: {self.stored}/{counted(self.of, 'trial')}" + "".join(f", {part}" for part in rest)

    @property
    def _gained(self) -> int:
        return self.stored - self._seen[0][1]

    @property
    def _seconds(self) -> float:
        return self._now - self._seen[0][0]

    def judge(self, latest: float) -> None:
        """Settle whether it is at work, by when trials of its configuration last came."""
        self.at_work = self._gained > 0 and self.last >= latest - _LATE_SECONDS


class View:
    """How far the runs of plans are: a row for each, and one for each of its cases if there are several."""

    def __init__(
        self, plans: Sequence[Plan], store: Store, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._store, self._clock = store, clock
        self._of_plans = [(plan, [*_rows(plan)]) for plan in plans]
        self.rows = [row for _, rows in self._of_plans for row in rows]

    def look(self) -> None:
        """Count again."""
        for plan, rows in self._of_plans:
            keys = {key for keys in plan.keys for key in keys.values()}
            with self._store.reading() as reader:
                trials = reached(plan, reader).trials
                found = {key: reader.counted(key, trials) for key in keys}
            for row in rows:
                row.of = len(row.units) * trials
            now = self._clock()
            for row in rows:
                row.take(found, now)
            for row in rows:
                row.judge(rows[0].last)

    @property
    def complete(self) -> bool:
        """Whether all trials are stored."""
        return all(row.stored == row.of for row in self.rows)

    def shown(self, height: int) -> Group:
        """The rows as a table of at most this height; cases that have nothing to say give way."""
        from rich.console import Group
        from rich.table import Table
        from rich.text import Text

        table = Table(box=None, pad_edge=False)
        for name in _HEAD:
            table.add_column(name, justify="right" if name in _HEAD[2:] else "left", no_wrap=True)
        fits = len(self.rows) < height
        # Without the heading, and a line on those that are left out.
        room = {*sorted(range(len(self.rows)), key=self._rank)[: len(self.rows) if fits else height - 2]}
        left_out = [row for i, row in enumerate(self.rows) if i not in room]
        for i in sorted(room):
            table.add_row(*self.rows[i].cells)
        done = sum(row.stored == row.of for row in left_out)
        note = f"and {len(left_out)} cases more, of which {done} are done"
        return Group(table, Text(note, overflow="ellipsis", no_wrap=True)) if left_out else Group(table)

    def _rank(self, i: int) -> tuple[bool, bool, bool, float]:
        """What comes first where not all rows can be shown."""
        row = self.rows[i]
        return bool(row.case), not row.at_work, row.stored == row.of, -row.last if row.at_work else i


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
