"""What becomes of chunks whose workers died: the same by every executor.

Who else was at work when a worker died is under suspicion too, so that a suspect is sent again alone, then in
its smallest parts, one estimator in one trial. A part that kills its worker again is what killed the others.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace

from hident.engine.chunks import Chunk

_MOST = 3
"""So many workers may die with a chunk."""


@dataclass
class Attempt:
    """A chunk, and how many workers died with it or with a chunk that it is part of."""

    chunk: Chunk
    deaths: int = 0
    alone: bool = False
    """Whether nothing else was under way."""

    def parts(self) -> list[Chunk]:
        """Each estimator in each trial."""
        case, tasks = self.chunk.case, self.chunk.tasks
        single = [(task, trial) for task in tasks for trial in task.trials]
        return [Chunk(case, [trial], [replace(task, trials=[trial])]) for task, trial in single]


class Queue:
    """The chunks in the order in which they are sent."""

    def __init__(self, chunks: Iterator[Chunk]) -> None:
        self._chunks = chunks
        self._suspects: deque[Attempt] = deque()
        self._next: Chunk | None = None

    def __bool__(self) -> bool:
        self._next = self._next or next(self._chunks, None)
        return bool(self._suspects) or self._next is not None

    def take(self, under_way: int) -> Attempt | None:
        """What may be sent now, while so many others are under way."""
        if self._suspects:
            return None if under_way else self._suspects.popleft()
        # A chunk is made as late as can be: its size follows from those that are finished.
        chunk, self._next = self._next or next(self._chunks, None), None
        return None if chunk is None else Attempt(chunk)

    def back(self, attempt: Attempt) -> None:
        """What was taken could not be sent."""
        self._suspects.appendleft(attempt)

    def died(self, attempt: Attempt, deaths: int) -> bool:
        """So many workers died with it: whether it is sent again, or has killed all that it may."""
        attempt.deaths += deaths
        parts = attempt.parts()
        if len(parts) > 1 and attempt.deaths >= _MOST - 1:
            self._suspects += [Attempt(part, _MOST - 1, alone=True) for part in parts]
        elif attempt.alone and attempt.deaths >= _MOST:
            return False
        else:
            attempt.alone = True
            self._suspects.append(attempt)
        return True
