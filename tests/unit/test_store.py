"""The trials store: what is written comes back to the last bit; one writer; a chunk whole or not at all."""

from __future__ import annotations

import errno
import os
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hident.arrays import Array
from hident.engine.store import Store, Trial
from hident.errors import StoreBusy, StoreError

_VALUES = np.array([0.1, -0.0, np.inf, np.nan, 5e-324])


def _values(trial: int) -> Array:
    return np.append(_VALUES, float(trial))


def _filled(folder: Path, trials: int = 3) -> Store:
    store = Store(folder)
    with store.writing() as writer:
        writer.add(
            {"k": {"estimator": "e"}}, [("k", Trial(i, _values(i), f"why {i}")) for i in range(trials)]
        )
    return store


def test_values_come_back_to_the_last_bit(tmp_path: Path) -> None:
    found = _filled(tmp_path).read(["k", "unknown"], below=10)
    assert [(t.trial, t.failure) for t in found["k"]] == [(0, "why 0"), (1, "why 1"), (2, "why 2")]
    assert [t.values.tobytes() for t in found["k"]] == [_values(i).tobytes() for i in range(3)]
    assert found["unknown"] == []


def test_only_trials_below_the_wanted_number_are_read_and_in_order(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with store.writing() as writer:
        for i in (4, 0, 2):
            writer.add({}, [("k", Trial(i, _VALUES))])
        assert [t.trial for t in writer.trials("k", 4)] == [0, 2]
    assert [t.trial for t in store.read(["k"], 5)["k"]] == [0, 2, 4]


def test_a_trial_written_again_replaces_the_first(tmp_path: Path) -> None:
    store = _filled(tmp_path, 1)
    with store.writing() as writer:
        writer.add({}, [("k", Trial(0, np.ones(1)))])
    assert store.count() == 1
    assert store.read(["k"], 1)["k"][0].values.tolist() == [1.0]


def test_a_store_that_does_not_exist_is_empty_and_is_not_made_by_reading(tmp_path: Path) -> None:
    store = Store(tmp_path / "none")
    assert store.count() == 0
    assert store.read(["k"], 10) == {"k": []}
    assert not (tmp_path / "none").exists()


def test_opening_a_store_changes_no_byte_of_it(tmp_path: Path) -> None:
    store = _filled(tmp_path)
    before = store.path.read_bytes()
    # The clock may stand for longer than this takes.
    os.utime(store.path, (0, 0))
    with store.writing() as writer:
        list(writer.trials("k", 10))
    store.read(["k"], 10)
    assert (store.path.read_bytes(), store.path.stat().st_mtime) == (before, 0.0)


def test_a_chunk_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    def chunk() -> Iterator[tuple[str, Trial]]:
        yield "k", Trial(5, _VALUES)
        raise KeyboardInterrupt

    store = _filled(tmp_path)
    with pytest.raises(KeyboardInterrupt), store.writing() as writer:
        writer.add({}, chunk())
    assert store.count() == 3


def test_one_writer_at_a_time(tmp_path: Path) -> None:
    store = _filled(tmp_path)
    busy = pytest.raises(StoreBusy, match="another run holds the trials store")
    with store.writing(), busy, Store(tmp_path).writing():
        pytest.fail("there are two writers")
    with store.writing(wait=1.0):
        pass


def test_reading_goes_on_while_another_writes(tmp_path: Path) -> None:
    store = _filled(tmp_path)
    with store.writing() as writer:
        writer.add({}, [("k", Trial(7, _VALUES))])
        assert len(Store(tmp_path).read(["k"], 10)["k"]) == 4


def test_another_program_that_holds_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = _filled(tmp_path)
    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda *args, **kw: connect(*args, **{**kw, "timeout": 0.0}))
    other = connect(store.path)
    other.execute("BEGIN IMMEDIATE")
    locked = pytest.raises(StoreError, match=r"\(database is locked\): another program has it open")
    with locked, store.writing() as writer:
        writer.add({}, [("k", Trial(9, _VALUES))])
    other.close()


def test_key_trial_and_reason_are_part_of_the_checksum(tmp_path: Path) -> None:
    for change in ("key = 'l'", "trial = 9", "failure = 'other'"):
        store = _filled(tmp_path / change[:3], 1)
        connection = sqlite3.connect(store.path)
        with connection:
            connection.execute(f"UPDATE trials SET {change}")
        connection.close()
        assert store.count() == 1
        assert store.read(["k", "l"], 10) == {"k": [], "l": []}


def test_full_disk_under_the_lock_is_told_by_its_number_and_not_by_its_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(number: int) -> None:
        def mkdir(*args: object, **kw: object) -> None:
            raise OSError(number, os.strerror(number), "a folder called full")

        monkeypatch.setattr(Path, "mkdir", mkdir)
        with Store(tmp_path / "x").writing():
            pytest.fail("the store was made")

    with pytest.raises(StoreError, match=r"no space left on device.*: the disk is full or failing"):
        fail(errno.ENOSPC)
    with pytest.raises(StoreError, match=r"permission denied.*: its folder must be writable"):
        fail(errno.EACCES)


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "a.yaml").touch()
    with pytest.raises(StoreError, match=r"a.yaml is not a folder, as the trials store needs: --store names"):
        Store(tmp_path / "a.yaml")


def test_errors_of_what_is_done_while_the_store_is_held_are_left_as_they_are(tmp_path: Path) -> None:
    store = _filled(tmp_path)
    with pytest.raises(OSError, match="AF_UNIX") as caught, store.writing():
        raise OSError(errno.ENAMETOOLONG, "AF_UNIX path too long")
    assert caught.type is OSError
    with pytest.raises(sqlite3.OperationalError, match="of another file"), store.writing():
        raise sqlite3.OperationalError("of another file")
    with store.writing():
        pass


def test_a_damaged_key_is_seen_before_anything_is_written(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with store.writing() as writer:
        writer.add({}, [(f"key {i}", Trial(0, _VALUES)) for i in range(9)])
    content = store.path.read_bytes()
    assert content.count(b"key 4") == 1
    store.path.write_bytes(content.replace(b"key 4", b"key 8"))
    damaged = pytest.raises(StoreError, match=r"is damaged \(.*\)\. Nothing was changed\. Move it aside")
    with damaged, store.writing():
        pytest.fail("it was opened")


def test_a_store_of_the_first_format_is_refused_with_the_remedy(tmp_path: Path) -> None:
    store = _filled(tmp_path)
    connection = sqlite3.connect(store.path)
    connection.execute("PRAGMA user_version = 1")
    connection.close()
    old = pytest.raises(StoreError, match=r"has format 1, and this hident uses format 2: move it aside")
    with old, store.writing():
        pytest.fail("it was opened")
