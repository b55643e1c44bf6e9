"""The trials store: one SQLite file that keeps every trial ever computed.

Trials are keyed by their unit (see :func:`hident.engine.runner.unit_key`) and number, and written by one
process in transactions of one chunk each, so that a kill loses at most the chunks in flight. Each row holds
a checksum: a damaged row counts as not computed.
"""

from __future__ import annotations

import json
import sqlite3
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout

from hident.errors import StoreBusy, StoreError
from hident.records import Array

_FORMAT = 1
_SCHEMA = """
CREATE TABLE IF NOT EXISTS units (key TEXT PRIMARY KEY, described TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS trials (
    key TEXT NOT NULL, trial INTEGER NOT NULL, data BLOB NOT NULL, failure TEXT NOT NULL,
    checksum INTEGER NOT NULL, PRIMARY KEY (key, trial)
) WITHOUT ROWID;
"""


@dataclass(frozen=True, eq=False)
class Trial:
    """A stored trial: the values of all metric labels, and why the estimate failed, if it did."""

    trial: int
    values: Array
    failure: str = ""


def _checksum(key: str, trial: Trial) -> int:
    head = f"{key} {trial.trial} {trial.failure} ".encode()
    return zlib.crc32(trial.values.tobytes(), zlib.crc32(head))


class Store:
    """The store in ``folder``; :meth:`writing` gives the one writer its turn.

    Raises
    ------
    StoreError
        From every method, if the file cannot be read or written; the message says what to do.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.path = folder / "trials.sqlite"

    @contextmanager
    def writing(self, wait: float = 0.0) -> Iterator[Writer]:
        """Hold the store for writing, after waiting at most ``wait`` seconds for another run.

        Raises
        ------
        StoreBusy
            If another run still holds it.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            lock = FileLock(self.folder / "lock", timeout=wait)
            lock.acquire()
        except Timeout:
            raise StoreBusy(
                f"another run holds the trials store {self.path}; try again when it has ended, "
                "or wait for it with --wait SECONDS"
            ) from None
        except OSError as error:
            raise self._unusable(error) from None
        try:
            with self._connected(create=True) as connection:
                yield Writer(self, connection)
        finally:
            lock.release()

    def read(self, keys: Iterable[str], below: int) -> dict[str, list[Trial]]:
        """The stored trials of each key with numbers under ``below``, in order."""
        if not self.path.exists():
            return {key: [] for key in keys}
        with self._connected(create=False) as connection:
            return self.read_from(connection, keys, below)

    def read_from(
        self, connection: sqlite3.Connection, keys: Iterable[str], below: int
    ) -> dict[str, list[Trial]]:
        found: dict[str, list[Trial]] = {}
        query = "SELECT trial, data, failure, checksum FROM trials WHERE key = ? AND trial < ? ORDER BY trial"
        for key in keys:
            found[key] = []
            for number, data, failure, checksum in connection.execute(query, (key, below)):
                if len(data) % 8:
                    continue
                trial = Trial(number, np.frombuffer(data, dtype="<f8"), failure)
                if _checksum(key, trial) == checksum:
                    found[key].append(trial)
        return found

    def count(self) -> int:
        """How many trials the store holds."""
        if not self.path.exists():
            return 0
        with self._connected(create=False) as connection:
            return int(connection.execute("SELECT COUNT(*) FROM trials").fetchone()[0])

    @contextmanager
    def _connected(self, *, create: bool) -> Iterator[sqlite3.Connection]:
        connection = None
        try:
            mode = "rwc" if create else "rw"
            connection = sqlite3.connect(f"{self.path.resolve().as_uri()}?mode={mode}", uri=True)
            connection.execute("PRAGMA busy_timeout = 10000")
            if create:
                self._prepare(connection)
            yield connection
        except sqlite3.Error as error:
            raise self._unusable(error) from None
        finally:
            if connection is not None:
                connection.close()

    def _prepare(self, connection: sqlite3.Connection) -> None:
        written = connection.execute("PRAGMA user_version").fetchone()[0]
        if written not in (0, _FORMAT):
            raise StoreError(
                f"the trials store {self.path} has format {written}, and this hident writes "
                f"{_FORMAT}; move it aside and run again"
            )
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = NORMAL")
        connection.executescript(_SCHEMA)
        connection.execute(f"PRAGMA user_version = {_FORMAT}")

    def _unusable(self, error: Exception) -> StoreError:
        text = str(error)
        damaged = isinstance(error, sqlite3.DatabaseError) and (
            "not a database" in text or "malformed" in text or "corrupt" in text
        )
        if damaged:
            remedy = (
                f"it is damaged. Nothing was changed. Move it aside (mv {self.path} "
                f"{self.path}.damaged) and run again; 'sqlite3 {self.path}.damaged .recover' "
                "may save its trials"
            )
        elif "full" in text or "No space" in text or "disk I/O" in text or "too large" in text:
            remedy = "the disk is full or failing. All finished chunks are kept: free space, run again"
        elif isinstance(error, sqlite3.OperationalError | OSError):
            remedy = "its folder must be writable; --store names another"
        else:
            remedy = "run again"
        return StoreError(f"the trials store {self.path} cannot be used ({text}): {remedy}")


class Writer:
    """The one writer of a store."""

    def __init__(self, store: Store, connection: sqlite3.Connection) -> None:
        self._store, self._connection = store, connection

    def read(self, keys: Iterable[str], below: int) -> dict[str, list[Trial]]:
        """As :meth:`Store.read`."""
        return self._store.read_from(self._connection, keys, below)

    def add(self, units: Mapping[str, Any], trials: Iterable[tuple[str, Trial]]) -> None:
        """Write a chunk of trials, and what their units are, in one transaction."""
        rows = [
            (key, t.trial, t.values.astype("<f8").tobytes(), t.failure, _checksum(key, t))
            for key, t in trials
        ]
        with self._connection:
            self._connection.executemany(
                "INSERT OR IGNORE INTO units VALUES (?, ?)",
                [(key, json.dumps(described, sort_keys=True)) for key, described in units.items()],
            )
            self._connection.executemany("INSERT OR REPLACE INTO trials VALUES (?, ?, ?, ?, ?)", rows)
