"""Times taken in turns, tables of them, and the figures that the next run is held against."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

T = TypeVar("T")
_GROUPS = 3


@dataclass(frozen=True)
class Figure:
    """One number that was measured, with the least and the greatest of its repetitions."""

    what: str
    value: float
    low: float
    high: float
    aim: str = ""


FIGURES: list[Figure] = []
"""What the benchmarks of this process have measured."""


def figure(what: str, values: Sequence[float], aim: str = "") -> None:
    """Keep the median of repeated measurements for the table at the end."""
    FIGURES.append(Figure(what, statistics.median(values), min(values), max(values), aim))


class Turns(dict[str, float]):
    """The seconds of each action over all rounds; :meth:`ratios` compares two."""

    def __init__(self, taken: Mapping[str, list[float]], of: Callable[[list[float]], float]) -> None:
        super().__init__({name: of(times) for name, times in taken.items()})
        self._groups = {
            name: [of(times[i::_GROUPS]) for i in range(_GROUPS)] for name, times in taken.items()
        }

    def joined(self, other: Turns) -> Turns:
        """These actions and others."""
        joined = Turns({}, min)
        joined.update({**self, **other})
        joined._groups = {**self._groups, **other._groups}
        return joined

    def ratios(self, of: str, to: str) -> list[float]:
        """The seconds of one action over those of another, in each third of the rounds."""
        return [a / b for a, b in zip(self._groups[of], self._groups[to], strict=True)]


def seconds(action: Callable[[], object]) -> float:
    """How long one call takes."""
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def processor_seconds(action: Callable[[], object]) -> float:
    """How much of this process's time one call takes: a busy machine hides it least."""
    start = time.process_time()
    action()
    return time.process_time() - start


def interleaved(actions: Mapping[str, Callable[[], object]], rounds: int) -> Turns:
    """The median seconds of each action, called in turns."""
    return _timed(actions, rounds, seconds, statistics.median)


def least(actions: Mapping[str, Callable[[], object]], rounds: int) -> Turns:
    """The least processor seconds of each action, called in turns."""
    return _timed(actions, rounds, processor_seconds, min)


def _timed(
    actions: Mapping[str, Callable[[], object]],
    rounds: int,
    clock: Callable[[Callable[[], object]], float],
    of: Callable[[list[float]], float],
) -> Turns:
    clocked = {name: partial(clock, action) for name, action in actions.items()}
    return Turns(in_turns(clocked, max(rounds, _GROUPS)), of)


def in_turns(actions: Mapping[str, Callable[[], T]], rounds: int) -> dict[str, list[T]]:
    """What each action gives, called in turns: A B C, A B C, ..."""
    given: dict[str, list[T]] = {name: [] for name in actions}
    for _ in range(rounds):
        for name, action in actions.items():
            given[name].append(action())
    return given


def show(title: str, header: Sequence[str], rows: Sequence[Sequence[str]], aims: Sequence[str]) -> None:
    """Print a table and what it is to be held against."""
    lines = [list(header), *map(list, rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(header))]
    print(f"\n{title}", flush=True)
    for line in lines:
        print("  " + "  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)))
    for aim in aims:
        print(f"  {aim}", flush=True)
