"""The trials store: one SQLite file that keeps every score ever computed; or one in memory, for one use.

A row is a block (:mod:`hident.engine.blocks`): what one metric gave in some trials of one unit, keyed by
data, estimator and metric (see :meth:`hident.engine.expansion.Unit.keys`), or how many seconds its fits took.
One process writes, in transactions of one chunk each, so that a kill loses at most the chunks in flight. Each
block holds its checksum: a damaged one counts as not computed. Where the file itself is damaged, the next
writer saves the blocks that it still holds into a new one.
"""

from __future__ import annotations

import errno
import itertools
import json
import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

from filelock import FileLock, Timeout

from hident.engine.blocks import Block, blocks_in, blocks_of
from hident.engine.scores import SECONDS, Scores
from hident.errors import StoreBusy, StoreError

_FORMAT = 4
_READ = (3, _FORMAT)
"""The formats that can be read: blocks of the third have eight bytes for each value."""
# Blocks must fit into a page, so that each stands in one piece where pages of the file are damaged.
_SCHEMA = f"""
PRAGMA page_size = 65536;
PRAGMA journal_mode = WAL;
BEGIN;
CREATE TABLE units (key TEXT PRIMARY KEY, described TEXT NOT NULL);
CREATE TABLE blocks (
    key TEXT NOT NULL, first INTEGER NOT NULL, count INTEGER NOT NULL, failed INTEGER NOT NULL,
    data BLOB NOT NULL
);
CREATE INDEX places ON blocks (key, first, count, failed);
PRAGMA user_version = {_FORMAT};
COMMIT;
"""
_INSERT = "INSERT INTO blocks VALUES (?, ?, ?, ?, ?)"
_CORRUPT = {sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB}
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}


class Stored(Protocol):
    """What is needed to read a store."""

    def trials(self, key: str, below: int) -> Iterable[Scores]:
        """The stored scores of a key in trials with numbers under ``below``, in order."""


@runtime_checkable
class TrialStore(Stored, Protocol):
    """What a run needs of a store."""

    def add(self, units: Mapping[str, Any], scores: Iterable[tuple[str, Scores]]) -> None:
        """Keep scores by their keys, and what each key stands for."""


class MemoryStore:
    """A store in memory, which writes no file."""

    def __init__(self) -> None:
        self._scores: dict[str, list[Scores]] = {}

    def trials(self, key: str, below: int) -> list[Scores]:
        """The stored scores of a key in trials with numbers under ``below``, in order."""
        found = sorted(self._scores.get(key, ()), key=lambda scores: int(scores.trials[0]))
        return [scores.below(below) for scores in found if scores.trials[0] < below]

    def add(self, units: Mapping[str, Any], scores: Iterable[tuple[str, Scores]]) -> None:
        """Keep scores by their keys; what the keys stand for is not asked for again."""
        for key, found in scores:
            self._scores.setdefault(key, []).extend(found.runs())


class Count(NamedTuple):
    """How many trials of a key are stored, and how many of them failed."""

    trials: int
    failed: int


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
        self._lock = folder / "lock"

    @contextmanager
    def writing(self, wait: float = 0.0) -> Iterator[Writer]:
        """Hold the store for writing, after waiting at most ``wait`` seconds for another run.

        A damaged file is mended first: :attr:`Writer.mended` then says what was saved.

        Raises
        ------
        StoreBusy
            If another run still holds it.
        """
        with self._locked(wait):
            with self.guarding():
                mended = self._mended()
                left = [*blocks_in(self._beside("-wal"))]
            with self._connected(self.path, "rwc") as connection:
                writer = Writer(connection, self, self.path, mended)
                # Of a log with a damaged part, the library reads what stands before it alone.
                writer.save(left)
                yield writer

    @contextmanager
    def reading(self) -> Iterator[Reader]:
        """Look into the store, while another may write; one that is not there is empty."""
        self._check_files()
        if not self.path.exists():
            yield Reader(None, self)
            return
        with self._connected(self.path, "rw") as connection:
            # Where its making ended early, there is a file without anything in it.
            yield Reader(connection if _is_made(connection) else None, self)

    def check(self) -> None:
        """Look for damage, and change nothing.

        Raises
        ------
        StoreError
            If there is some.
        """
        with self._locked(0.0), self.guarding():
            fault = self._fault()
        if fault:
            raise self._damaged(fault)

    def _check_files(self) -> None:
        for path in (self.path, self._lock, *(self._beside(suffix) for suffix in ("-wal", "-shm"))):
            # A link may lead nowhere, or in a circle.
            if os.path.lexists(path) and not path.is_file():
                raise StoreError(
                    f"{path} is no file, as the trials store needs: move it aside, or name another store "
                    "with --store"
                )

    @contextmanager
    def guarding(self) -> Iterator[None]:
        """Turn an error inside, which must be one of the store's own, into a message that says what to do."""
        try:
            yield
        except (sqlite3.Error, OSError) as error:
            raise self._unusable(error) from None

    @contextmanager
    def _locked(self, wait: float) -> Iterator[None]:
        self._check_files()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            lock = FileLock(self._lock, timeout=wait)
            lock.acquire()
        except Timeout:
            raise StoreBusy(
                f"another run holds the trials store {self.path}; try again when it has ended, "
                "or wait for it with --wait SECONDS"
            ) from None
        except (OSError, NotImplementedError) as error:
            raise self._unusable(error) from None
        try:
            yield
        finally:
            lock.release()

    @contextmanager
    def _connected(self, path: Path, mode: str) -> Iterator[sqlite3.Connection]:
        """A connection; errors of what is done while it is open are left as they are."""
        with self.guarding():
            connection = sqlite3.connect(f"{path.resolve().as_uri()}?mode={mode}", uri=True, timeout=10.0)
        try:
            with self.guarding():
                # Texts stay bytes, as a damaged one may not be UTF-8.
                connection.text_factory = bytes
                written = connection.execute("PRAGMA user_version").fetchone()[0]
                if written == 0 and mode == "rwc":
                    connection.executescript(_SCHEMA)
                elif written not in (0, *_READ):
                    raise StoreError(
                        f"the trials store {self.path} has format {written}, and this hident uses format "
                        f"{_FORMAT}: move it aside, or name another with --store"
                    )
                elif written not in (0, _FORMAT) and mode == "rwc":
                    connection.execute(f"PRAGMA user_version = {_FORMAT}")
                connection.execute("PRAGMA synchronous = NORMAL")
                connection.execute("PRAGMA wal_autocheckpoint = 1000")
            yield connection
        finally:
            with self.guarding():
                connection.close()

    def _beside(self, suffix: str) -> Path:
        return self.folder / f"{self.path.name}{suffix}"

    def _fault(self) -> str:
        """What is wrong with the file; empty if nothing is."""
        log = self._beside("-wal")
        if not _has_content(self.path):
            return "its file is gone, and its log is there" if next(blocks_in(log), None) else ""
        try:
            # Who only reads leaves a log as it is, which may be another file's; who writes leaves none.
            with self._connected(self.path, "ro" if _has_content(log) else "rw") as connection:
                names = {name.decode() for (name,) in connection.execute("SELECT name FROM sqlite_master")}
                if not _is_made(connection):
                    return "its header is damaged" if names else ""
                if not {"units", "blocks", "places"} <= names:
                    return "its tables are those of something else"
                found = connection.execute("PRAGMA integrity_check(1)").fetchone()[0].decode()
                reader = Reader(connection, self)
                if _has_content(log) and not all(map(reader.has, blocks_in(self.path))):
                    return "its log is another store's"
        except StoreError as error:
            if isinstance(error, _Damaged):
                return error.fault
            if next(blocks_in(self.path), None):
                return "its header is of another format"
            raise
        except sqlite3.DatabaseError as error:
            if _code(error) not in _CORRUPT:
                raise
            return str(error)
        return "" if found == "ok" else found.splitlines()[-1]

    def _mended(self) -> str:
        """Save what a damaged file holds into a new one, and say so; empty if it is sound.

        Killed at any moment, it goes on from there the next time.
        """
        part, whole = self._beside(".part"), self._beside(".salvaged")
        said = ""
        if not whole.exists() and (fault := self._fault()):
            for suffix in ("", "-wal", "-shm"):
                self._beside(f".part{suffix}").unlink(missing_ok=True)
            with self._connected(part, "rwc") as connection:
                writer = Writer(connection, self, part)
                for path in (self.path, self._beside("-wal")):
                    writer.save(blocks_in(path))
                saved = writer.count()
            part.replace(whole)
            said = f"the trials store {self.path} was damaged ({fault}): {saved} scores are saved"
        if not whole.exists():
            return ""
        aside = next(path for i in itertools.count(1) if not (path := self._beside(f".damaged-{i}")).exists())
        # The log first: beside the new file it would be taken for that one's.
        for path, to in ((self._beside("-wal"), aside.with_name(f"{aside.name}-wal")), (self.path, aside)):
            if path.exists():
                path.replace(to)
        self._beside("-shm").unlink(missing_ok=True)
        whole.replace(self.path)
        return (
            f"{said or f'the trials store {self.path} was damaged'}, and the damaged file is kept as {aside}"
        )

    def _unusable(self, error: Exception) -> StoreError:
        code = _code(error)
        number = error.errno if isinstance(error, OSError) else None
        text = (isinstance(error, OSError) and error.strerror) or str(error)
        if code in _CORRUPT:
            return self._damaged(text)
        if code in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR) or number in _FULL:
            remedy = "the disk is full or failing. All stored trials are kept: free space, run again"
        elif code == sqlite3.SQLITE_BUSY:
            remedy = "another program has it open"
        else:
            remedy = "its folder must be writable; --store names another"
        return StoreError(f"the trials store {self.path} cannot be used ({text.lower()}): {remedy}")

    def _damaged(self, fault: str) -> StoreError:
        return _Damaged(
            f"the trials store {self.path} is damaged ({fault}). The next hident run saves what can be read "
            "into a new one, and keeps the damaged file",
            fault,
        )


class _Damaged(StoreError):
    """The file is no sound database."""

    def __init__(self, text: str, fault: str) -> None:
        super().__init__(text)
        self.fault = fault


def _is_made(connection: sqlite3.Connection) -> bool:
    return bool(connection.execute("PRAGMA user_version").fetchone()[0])


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _has_content(path: Path) -> bool:
    return path.exists() and path.stat().st_size > 0


def _code(error: Exception) -> int:
    return getattr(error, "sqlite_errorcode", 0) & 0xFF  # the higher bits are details


class Reader:
    """What is stored."""

    def __init__(self, connection: sqlite3.Connection | None, store: Store) -> None:
        self._connection, self._store = connection, store
        self._damaged: list[tuple[int]] = []
        """The rows that were met and hold no block of their key."""

    def _rows(self, query: str, *values: Any) -> Iterator[tuple[Any, ...]]:
        if self._connection is None:
            return
        rows = self._connection.cursor()
        with self._store.guarding():
            rows.execute(query, values)
        while True:
            with self._store.guarding():
                row = rows.fetchone()
            if row is None:
                return
            yield row

    def trials(self, key: str, below: int) -> Iterator[Scores]:
        """The stored scores of a key in trials with numbers under ``below``, in order and each trial once."""
        query = "SELECT rowid, data FROM blocks WHERE key = ? AND first < ? ORDER BY first"
        end = 0
        for row, data in self._rows(query, key, below):
            block = Block.decoded(data)
            if block is None or block.key != key:
                self._damaged.append((row,))
                continue
            # Equal estimators whose trials went into other chunks leave blocks that overlap.
            scores = block.scores.below(below)
            if (scores := scores.where(scores.trials >= end)).trials.size:
                end = int(scores.trials[-1]) + 1
                yield scores

    def counted(self, key: str, below: int) -> Count:
        """How many trials with numbers under ``below`` are stored, by what is said of blocks: none is read.

        Of a block that goes beyond ``below`` all failures count, as far as there are so many trials.
        """
        query = "SELECT TOTAL(MIN(count, ? - first)), TOTAL(failed) FROM blocks WHERE key = ? AND first < ?"
        for trials, failed in self._rows(query, below, key, below):
            return Count(int(trials), int(min(failed, trials)))
        return Count(0, 0)

    def count(self) -> int:
        """How many scores there are: one for each trial and metric."""
        query = "SELECT TOTAL(count) FROM blocks WHERE key NOT GLOB ?"
        return sum(int(count) for (count,) in self._rows(query, f"{SECONDS}*"))

    def has(self, block: Block) -> bool:
        """Whether a block of the same place is there."""
        key, first, count, _ = block.place
        found = self._rows(
            "SELECT 1 FROM blocks WHERE key = ? AND first = ? AND count = ?", key, first, count
        )
        return next(found, None) is not None


class Writer(Reader):
    """The one writer of a file: a :class:`TrialStore`."""

    def __init__(self, connection: sqlite3.Connection, store: Store, path: Path, mended: str = "") -> None:
        super().__init__(connection, store)
        self._connection: sqlite3.Connection
        # An estimator may go to another folder.
        self._path, self._is = path.absolute(), _identity(path)
        self.mended = mended
        """What was saved of a damaged file; empty if it was sound."""

    def add(self, units: Mapping[str, Any], scores: Iterable[tuple[str, Scores]]) -> None:
        """Write a chunk of scores, and what their keys stand for, in one transaction."""
        # Equal estimators under two names have one key, and each is computed.
        rows = {block.place: data for key, found in scores for block, data in blocks_of(key, found)}
        described = [(key, json.dumps(unit, sort_keys=True)) for key, unit in units.items()]
        # The system goes on writing a file that has no name any more.
        if _identity(self._path) != self._is:
            raise StoreError(
                f"the trials store {self._path} was removed or replaced while the run was writing it: run "
                "again"
            )
        with self._store.guarding(), self._connection:
            self._connection.executemany("INSERT OR IGNORE INTO units VALUES (?, ?)", described)
            self._connection.executemany("DELETE FROM blocks WHERE rowid = ?", self._damaged)
            self._damaged.clear()
            self._connection.executemany(
                "DELETE FROM blocks WHERE key = ? AND first >= ? AND first + count <= ?",
                [(key, first, first + count) for key, first, count, _ in rows],
            )
            self._connection.executemany(_INSERT, [(*place, data) for place, data in rows.items()])

    def save(self, blocks: Iterable[Block]) -> None:
        """Write the blocks that are not there, in one transaction."""
        with self._store.guarding(), self._connection:
            for block in blocks:
                if not self.has(block):
                    self._connection.execute(_INSERT, (*block.place, block.encoded()))
