"""Damage to the store and its write-ahead log: the next run ends with the undisturbed outputs by itself."""

from __future__ import annotations

import random
import re
import signal
import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from tests.torture.victim import Lost, Tally, Victim, filled_store, new_victim

COUNT = 50
_TRIALS = 2000
_PAGE = 4096


def torture(tally: Tally, rng: random.Random, count: int) -> None:
    """Damage the store ``count`` times in each way, and its write-ahead log a fifth as often."""
    with new_victim(_TRIALS) as victim:
        restore = filled_store(victim)
        again: list[int] = []
        for way, damage in _DAMAGES.items():
            for _ in range(count):
                restore()
                with tally.fault(f"store: {way}", rng.getstate()[1][-1]):
                    damage(victim.store, rng)
                    _mend(victim, again, way)
        _foreign(tally, victim, restore, again)
        tally.notes.append(_summary(again, victim.units))
    _log(tally, rng, max(1, count // 5))


def _summary(again: list[int], units: int) -> str:
    median = sorted(again)[len(again) // 2]
    return (
        f"after damage to the store, of {units} trials {median} (median) to {max(again)} were computed again"
    )


def _mend(victim: Victim, again: list[int], way: str) -> None:
    made = victim.check_ending(damaged=True)
    again.append(made)
    _check_told(victim, made)
    # One bad page must not cost everything; what a truncation or a foreign file left out is gone.
    if made == victim.units and "truncated" not in way and "foreign" not in way:
        raise Lost("all trials were computed again")
    # Nothing of the damage is left for the run after.
    victim.fits()
    assert "is up to date" in victim.run()


def _check_told(victim: Victim, made: int) -> None:
    """Where a damaged file is kept, the run says how many trials it saved: all others were computed."""
    kept = any(".damaged-" in path.name for path in victim.store.parent.iterdir())
    told = re.findall(rf"; (\d+) of the {victim.units} trials of tiny are saved\n", victim.said)
    assert [int(saved) for saved in told] == [victim.units - made] * kept, victim.said


def _flip(path: Path, rng: random.Random) -> None:
    content = bytearray(path.read_bytes())
    content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    path.write_bytes(content)


def _truncate(path: Path, rng: random.Random) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: rng.randrange(len(content))])


def _zero(path: Path, rng: random.Random) -> None:
    content = bytearray(path.read_bytes())
    start = rng.randrange(0, len(content), _PAGE)
    content[start : start + _PAGE] = bytes(len(content[start : start + _PAGE]))
    path.write_bytes(content)


def _swap(path: Path, rng: random.Random) -> None:
    content = path.read_bytes()
    pages = [content[i : i + _PAGE] for i in range(0, len(content), _PAGE)]
    i, j = rng.choice(range(len(pages))), rng.choice(range(len(pages)))
    pages[i], pages[j] = pages[j], pages[i]
    path.write_bytes(b"".join(pages))


_DAMAGES: dict[str, Callable[[Path, random.Random], None]] = {
    "a byte flipped": _flip,
    "truncated": _truncate,
    "a page zeroed": _zero,
    "two pages swapped": _swap,
}


def _log_of(path: Path) -> Path:
    return path.with_name(f"{path.name}-wal")


def _foreign(tally: Tally, victim: Victim, restore: Callable[[], None], again: list[int]) -> None:
    """A log or an index of another file beside the store, or another file in its place."""
    other = victim.folder / "other"
    other.mkdir()
    connection = sqlite3.connect(other / "x.sqlite")
    with closing(connection):
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("CREATE TABLE t (x)")
        connection.commit()
        log, index = ((other / f"x.sqlite-{end}").read_bytes() for end in ("wal", "shm"))
    for name, contents in {
        "foreign log": {"-wal": log},
        "foreign index": {"-shm": index},
        "foreign log and index": {"-wal": log, "-shm": index},
        "foreign database": {"": (other / "x.sqlite").read_bytes()},
        "foreign text": {"": b"text\n" * 5000, "-wal": b"text\n" * 5000},
        "foreign empty file": {"": b""},
    }.items():
        restore()
        with tally.fault(f"store: {name}", name):
            for end, content in contents.items():
                victim.store.with_name(f"{victim.store.name}{end}").write_bytes(content)
            _mend(victim, again, name)


def _log(tally: Tally, rng: random.Random, count: int) -> None:
    """Kill a run that has a log beside its store, and damage the log."""
    with new_victim(100) as victim:
        for way, damage in _DAMAGES.items():
            for _ in range(count):
                victim.forget()
                with tally.fault(f"log: {way}", way):
                    process = victim.started_run("--jobs", "1", seconds=0.004)
                    log = _log_of(victim.store)
                    while process.poll() is None and not (log.exists() and log.stat().st_size > 5 * _PAGE):
                        time.sleep(0.005)
                    process.kill()
                    assert process.wait() == -signal.SIGKILL, victim.log
                    damage(log, rng)
                    _mend_log(victim)


def _mend_log(victim: Victim) -> None:
    _check_told(victim, victim.check_ending(damaged=True))
    assert "is up to date" in victim.run()
