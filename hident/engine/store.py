"""The trials store: one SQLite file that keeps every score ever computed; or one in memory for a single use.

A row is what one metric gave in one trial of one unit: keyed by data, estimator and metric (see
:meth:`hident.engine.expansion.Unit.keys`) and the trial's number. One process writes, in transactions of one
chunk each, so that a kill loses at most the chunks in flight. Each row holds a checksum: a damaged row
counts as not computed.
"""

from __future__ import annotations

import errno
import json
import sqlite3
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from filelock import FileLock, Timeout

from hident.arrays import Array
from hident.errors import StoreBusy, StoreError

_FORMAT = 2
_SCHEMA = f"""
BEGIN;
CREATE TABLE units (key TEXT PRIMARY KEY, described TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE trials (
    key TEXT NOT NULL, trial INTEGER NOT NULL, data BLOB NOT NULL, failure TEXT NOT NULL,
    checksum INTEGER NOT NULL, PRIMARY KEY (key, trial)
) WITHOUT ROWID;
PRAGMA user_version = {_FORMAT};
COMMIT;
"""
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}


@dataclass(frozen=True, eq=False)
class Trial:
    """A stored trial of a key: a value for each label of the metric, and why it failed, if it did."""

    trial: int
    values: Array
    failure: str = ""


@runtime_checkable
class TrialStore(Protocol):
    """What a run needs of a store."""

    def trials(self, key: str, below: int) -> Iterable[Trial]:
        """The stored trials of a key with numbers under ``below``, in order."""

    def add(self, units: Mapping[str, Any], trials: Iterable[tuple[str, Trial]]) -> None:
        """Keep trials by their keys, and what each key stands for."""


class MemoryStore:
    """A store in memory, which writes no file."""

    def __init__(self) -> None:
        self._trials: dict[str, dict[int, Trial]] = {}

    def trials(self, key: str, below: int) -> list[Trial]:
        """The stored trials of a key with numbers under ``below``, in order."""
        return [trial for number, trial in sorted(self._trials.get(key, {}).items()) if number < below]

    def add(self, units: Mapping[str, Any], trials: Iterable[tuple[str, Trial]]) -> None:
        """Keep trials by their keys; what the keys stand for is not asked for again."""
        for key, trial in trials:
            self._trials.setdefault(key, {})[trial.trial] = trial


def _checksum(key: str, trial: int, data: bytes, failure: str) -> int:
    return zlib.crc32(data, zlib.crc32(f"{key} {trial} {failure} ".encode()))


class Store:
    """The store in ``folder``; :meth:`writing` gives the one writer its turn.

    Raises
    ------
    StoreError
        From every method, if the file cannot be read or written; the message says what to do.
    """

    def __init__(self, folder: Path) -> None:
        if folder.exists() and not folder.is_dir():
            raise StoreError(f"{folder} is not a folder, as the trials store needs: --store names one")
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
        except (OSError, NotImplementedError) as error:
            raise self._unusable(error) from None
        try:
            with self._connected(create=True) as connection:
                with self.guarding():
                    # Writing into a damaged tree would damage it further.
                    fault = connection.execute("PRAGMA integrity_check(1)").fetchone()[0].decode()
                if fault != "ok":
                    raise self._damaged(fault.splitlines()[-1])
                yield Writer(connection, self)
        finally:
            lock.release()

    def read(self, keys: Iterable[str], below: int) -> dict[str, list[Trial]]:
        """The stored trials of each key with numbers under ``below``, in order."""
        if not self.path.exists():
            return {key: [] for key in keys}
        with self._connected(create=False) as connection, self.guarding():
            return {key: list(_trials(connection, key, below)) for key in keys}

    def count(self) -> int:
        """How many rows the store holds."""
        if not self.path.exists():
            return 0
        with self._connected(create=False) as connection, self.guarding():
            return int(connection.execute("SELECT COUNT(*) FROM trials").fetchone()[0])

    @contextmanager
    def guarding(self) -> Iterator[None]:
        """Turn an error inside, which must be one of the store's own, into a message that says what to do."""
        try:
            yield
        except (sqlite3.Error, OSError) as error:
            raise self._unusable(error) from None

    @contextmanager
    def _connected(self, *, create: bool) -> Iterator[sqlite3.Connection]:
        """A connection; errors of what is done while it is open are left as they are."""
        with self.guarding():
            address = f"{self.path.resolve().as_uri()}?mode={'rwc' if create else 'rw'}"
            connection = sqlite3.connect(address, uri=True, timeout=10.0)
        try:
            with self.guarding():
                # Texts stay bytes, as a damaged one may not be UTF-8.
                connection.text_factory = bytes
                self._prepare(connection)
            yield connection
        finally:
            with self.guarding():
                connection.close()

    def _prepare(self, connection: sqlite3.Connection) -> None:
        written = connection.execute("PRAGMA user_version").fetchone()[0]
        if written == 0:
            connection.execute("PRAGMA journal_mode = WAL")
            connection.executescript(_SCHEMA)
        elif written != _FORMAT:
            raise StoreError(
                f"the trials store {self.path} has format {written}, and this hident uses format "
                f"{_FORMAT}: move it aside, or name another with --store"
            )
        connection.execute("PRAGMA synchronous = NORMAL")

    def _unusable(self, error: Exception) -> StoreError:
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF  # the higher bits are details
        number = error.errno if isinstance(error, OSError) else None
        text = (isinstance(error, OSError) and error.strerror) or str(error)
        if code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB):
            return self._damaged(text)
        if code in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR) or number in _FULL:
            remedy = "the disk is full or failing. All stored trials are kept: free space, run again"
        elif code == sqlite3.SQLITE_BUSY:
            remedy = "another program has it open"
        else:
            remedy = "its folder must be writable; --store names another"
        return StoreError(f"the trials store {self.path} cannot be used ({text.lower()}): {remedy}")

    def _damaged(self, text: str) -> StoreError:
        return StoreError(
            f"the trials store {self.path} is damaged ({text}). Nothing was changed. Move it aside "
            f"(mv {self.path} {self.path}.damaged) and run again: what it held is computed anew"
        )


class Writer:
    """The one writer of a file: a :class:`TrialStore`."""

    def __init__(self, connection: sqlite3.Connection, store: Store) -> None:
        self._connection, self._store = connection, store

    def trials(self, key: str, below: int) -> list[Trial]:
        """The stored trials of a key with numbers under ``below``, in order."""
        with self._store.guarding():
            return list(_trials(self._connection, key, below))

    def add(self, units: Mapping[str, Any], trials: Iterable[tuple[str, Trial]]) -> None:
        """Write a chunk of trials, and what their keys stand for, in one transaction."""
        rows = []
        for key, t in trials:
            data = t.values.astype("<f8").tobytes()
            rows.append((key, t.trial, data, t.failure, _checksum(key, t.trial, data, t.failure)))
        with self._store.guarding(), self._connection:
            self._connection.executemany(
                "INSERT OR IGNORE INTO units VALUES (?, ?)",
                [(key, json.dumps(described, sort_keys=True)) for key, described in units.items()],
            )
            self._connection.executemany("INSERT OR REPLACE INTO trials VALUES (?, ?, ?, ?, ?)", rows)


def _trials(connection: sqlite3.Connection, key: str, below: int) -> Iterator[Trial]:
    query = "SELECT trial, data, failure, checksum FROM trials WHERE key = ? AND trial < ? ORDER BY trial"
    for row in connection.execute(query, (key, below)):
        if trial := _undamaged(key, *row):
            yield trial


def _undamaged(key: str, number: Any, data: Any, failure: Any, checksum: Any) -> Trial | None:
    """The trial of a row; None if the row is damaged, as a damaged one may hold any type."""
    if not (isinstance(data, bytes) and isinstance(failure, bytes)):
        return None
    text = failure.decode(errors="replace")
    if _checksum(key, number, data, text) != checksum:
        return None
    return Trial(number, np.frombuffer(data, dtype="<f8"), text)
