"""The trials store: what is written comes back to the last bit; one writer; a chunk whole or not at all."""

from __future__ import annotations

import errno
import os
import re
import shutil
import sqlite3
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from hident.engine.blocks import _BEGIN, _MARK, _SIZES, LARGEST, Block, blocks_in, blocks_of
from hident.engine.scores import Scores
from hident.engine.store import Count, Store
from hident.errors import StoreBusy, StoreError

_VALUES = np.array([0.1, -0.0, np.inf, np.nan, 5e-324])


def _scores(*trials: int, failing: bool = False) -> Scores:
    """Five odd values and the number of the trial."""
    values = np.array([np.append(_VALUES, trial) for trial in trials])
    return Scores(np.array(trials), values, {trial: f"why {trial % 2}" for trial in trials if failing})


def _filled(folder: Path, trials: int = 3) -> Store:
    store = Store(folder)
    with store.writing() as writer:
        writer.add({"k": {"estimator": "e"}}, [("k", _scores(*range(trials), failing=True))])
    return store


def _read(store: Store, key: str = "k", below: int = 10) -> list[tuple[int, bytes, str]]:
    with store.reading() as reader:
        return [
            (trial, values.tobytes(), scores.failures.get(trial, ""))
            for scores in reader.trials(key, below)
            for trial, values in zip(scores.trials.tolist(), scores.values, strict=True)
        ]


def _trials(store: Store, key: str = "k", below: int = 10) -> list[int]:
    return [trial for trial, *_ in _read(store, key, below)]


def _count(store: Store) -> int:
    with store.reading() as reader:
        return reader.count()


def test_values_come_back_to_the_last_bit(tmp_path: Path) -> None:
    store = _filled(tmp_path)
    expected = [(i, np.append(_VALUES, i).tobytes(), f"why {i % 2}") for i in range(3)]
    assert _read(store) == expected
    assert _read(store, "unknown") == []


def test_values_that_four_bytes_hold_take_four(tmp_path: Path) -> None:
    exact = np.array([[1.5, -0.0, np.inf, np.nan, 2.0**-149, 2.0**127]])
    for values, size in (
        (exact, 4),
        (np.where(exact == 1.5, 1.5 + 2**-30, exact), 8),
        (np.where(exact == 1.5, 1e300, exact), 8),
    ):
        [(_, data)] = blocks_of("k", Scores(np.array([7]), values))
        assert len(data) - len(next(blocks_of("k", Scores(np.array([7]), values[:, :0])))[1]) == size * 6
        found = Block.decoded(data)
        assert found is not None
        assert found.scores.values.dtype == np.float64
        assert found.scores.values.tobytes() == values.tobytes()


def test_a_store_of_the_format_before_is_read_and_goes_on(tmp_path: Path) -> None:
    store = _filled(tmp_path)
    whole = Scores(np.arange(5), np.arange(5.0)[:, np.newaxis])
    key, text = b"w", b""
    rest = _SIZES.pack(len(key), len(text), 0, 5, 1) + key + text + whole.values.tobytes()
    data = _BEGIN.pack(_MARK, zlib.crc32(rest), _BEGIN.size + len(rest)) + rest
    before = _read(store)
    with closing(sqlite3.connect(store.path)) as connection, connection:
        connection.execute("PRAGMA user_version = 3")
        connection.execute("INSERT INTO blocks VALUES ('w', 0, 5, 0, ?)", (data,))
    assert _trials(store, "w") == [0, 1, 2, 3, 4]
    with store.writing() as writer:
        assert writer.mended == ""
        writer.add({}, [("k", _scores(8))])
    assert _read(store)[:3] == before
    assert _trials(store) == [0, 1, 2, 8]
    assert [float(np.frombuffer(values)[0]) for _, values, _ in _read(store, "w")] == [0, 1, 2, 3, 4]
    with closing(sqlite3.connect(store.path)) as connection:
        assert connection.execute("PRAGMA user_version").fetchone() == (4,)


def test_only_trials_below_the_wanted_number_are_read_and_in_order(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with store.writing() as writer:
        for trials in ((4, 5, 8), (0,), (2, 3)):
            writer.add({}, [("k", _scores(*trials, failing=True))])
        assert [trial for scores in writer.trials("k", 5) for trial in scores.trials] == [0, 2, 3, 4]
        assert [dict(scores.failures) for scores in writer.trials("k", 5)][-1] == {4: "why 0"}
        assert writer.counted("k", 10) == Count(6, 6)
        assert writer.counted("unknown", 10) == Count(0, 0)
    assert _trials(store, below=6) == [0, 2, 3, 4, 5]


def test_many_trials_are_blocks_of_which_each_fits_into_a_page(tmp_path: Path) -> None:
    numbers, reasons = np.arange(5000), {trial: "long" * 40 + str(trial) for trial in range(0, 5000, 7)}
    many = Scores(numbers, np.random.default_rng(1).normal(size=(5000, 3)), reasons)
    blocks = list(blocks_of("k", many))
    assert max(len(data) for _, data in blocks) <= LARGEST
    assert np.array_equal(np.concatenate([block.scores.trials for block, _ in blocks]), numbers)
    store = Store(tmp_path)
    with store.writing() as writer:
        writer.add({}, [("k", many)])
    expected = [(trial, row.tobytes(), reasons.get(trial, "")) for trial, row in enumerate(many.values)]
    assert _read(store, below=5000) == expected
    # At most twice the numbers themselves, besides the reasons and some pages that every store has.
    assert store.path.stat().st_size < 2 * many.values.nbytes + sum(map(len, reasons.values())) + 8 * 65536
    one = Scores(np.array([3]), np.ones((1, 9000)), {})
    assert [len(block.scores.trials) for block, _ in blocks_of("k", one)] == [1]


def test_a_block_that_is_changed_anywhere_is_none(tmp_path: Path) -> None:
    [(_, data)] = blocks_of("key", _scores(4, 5, failing=True))
    whole = Block.decoded(data)
    assert whole is not None
    assert (whole.key, whole.scores.failures) == ("key", {4: "why 0", 5: "why 1"})
    for place in range(len(data)):
        changed = bytearray(data)
        changed[place] ^= 1
        assert Block.decoded(bytes(changed)) is None
        assert Block.decoded(data[:place]) is None
    for odd in ("text", 5, None, b"", b"\x93hident\x03" * 5):
        assert Block.decoded(odd) is None


def test_a_store_that_does_not_exist_is_empty_and_is_not_made_by_reading(tmp_path: Path) -> None:
    store = Store(tmp_path / "none")
    assert (_count(store), _read(store)) == (0, [])
    assert not (tmp_path / "none").exists()


def test_opening_a_store_changes_no_byte_of_it(tmp_path: Path) -> None:
    store = _filled(tmp_path)
    before = store.path.read_bytes()
    # The clock may stand for longer than this takes.
    os.utime(store.path, (0, 0))
    with store.writing() as writer:
        list(writer.trials("k", 10))
        assert writer.mended == ""
    _read(store)
    store.check()
    assert (store.path.read_bytes(), store.path.stat().st_mtime) == (before, 0.0)
    assert {path.name for path in tmp_path.iterdir()} == {"trials.sqlite", "lock"}


def test_a_chunk_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    def chunk() -> Iterator[tuple[str, Scores]]:
        yield "k", _scores(5)
        raise KeyboardInterrupt

    store = _filled(tmp_path)
    with pytest.raises(KeyboardInterrupt), store.writing() as writer:
        writer.add({}, chunk())
    assert _count(store) == 3


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
        writer.add({}, [("k", _scores(7))])
        assert _trials(Store(tmp_path)) == [0, 1, 2, 7]


def test_another_program_that_holds_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = _filled(tmp_path)
    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda *args, **kw: connect(*args, **{**kw, "timeout": 0.0}))
    other = connect(store.path)
    other.execute("BEGIN IMMEDIATE")
    locked = pytest.raises(StoreError, match=r"\(database is locked\): another program has it open")
    with locked, store.writing() as writer:
        writer.add({}, [("k", _scores(9))])
    other.close()


def test_a_block_under_another_key_is_none(tmp_path: Path) -> None:
    store = _filled(tmp_path, 1)
    with closing(sqlite3.connect(store.path)) as connection, connection:
        connection.execute("UPDATE blocks SET key = 'l'")
    assert _read(store, "k") == _read(store, "l") == []


@pytest.mark.parametrize("parts", [((0, 1), (2, 3, 4)), ((3, 4), (0, 1, 2)), ((0, 1, 2, 3, 4),)])
def test_what_is_computed_again_takes_the_place_of_damaged_blocks(
    tmp_path: Path, parts: tuple[tuple[int, ...], ...]
) -> None:
    store = _filled(tmp_path, 5)
    with closing(sqlite3.connect(store.path)) as connection, connection:
        connection.execute("UPDATE blocks SET data = x'00'")
    with store.writing() as writer:
        assert list(writer.trials("k", 5)) == []
        for trials in parts:
            writer.add({}, [("k", _scores(*trials))])
    assert _trials(store) == [0, 1, 2, 3, 4]
    assert _count(store) == 5


def test_a_part_of_a_block_that_is_added_again_takes_nothing_away(tmp_path: Path) -> None:
    store = _filled(tmp_path, 5)
    with store.writing() as writer:
        writer.add({}, [("k", _scores(0)), ("k", _scores(2))])
    assert {*_trials(store)} == {0, 1, 2, 3, 4}


def test_a_key_that_stands_twice_in_a_chunk_is_written_once(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with store.writing() as writer:
        writer.add({}, [("k", _scores(0, 1, failing=True)), ("k", _scores(0, 1, failing=True))])
    with store.reading() as reader:
        assert reader.counted("k", 10) == Count(2, 2)
    assert _trials(store) == [0, 1]


def test_a_trial_that_stands_in_two_blocks_is_read_once(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with store.writing() as writer:
        writer.add({}, [("k", _scores(0, 1, 2))])
        writer.add({}, [("k", _scores(1, 2, 3, 4))])
        writer.add({}, [("k", _scores(2, 3))])
        writer.save([Block("k", _scores(0, 1, 2, 3))])
    assert _trials(store) == [0, 1, 2, 3, 4]
    assert _trials(store, below=3) == [0, 1, 2]


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


def _large(folder: Path) -> tuple[Store, list[tuple[int, bytes, str]]]:
    """A store of 4000 trials in many blocks, and what it holds."""
    store = Store(folder)
    with store.writing() as writer:
        for first in range(0, 4000, 500):
            writer.add({"k": {"estimator": "e"}}, [("k", _scores(*range(first, first + 500), failing=True))])
    return store, _read(store, below=4000)


def _flip(key: bytes) -> Callable[[bytearray], None]:
    def damage(content: bytearray) -> None:
        place = content.index(key)
        content[place : place + len(key)] = bytes(byte ^ 1 for byte in key)

    return damage


def _zero(first: int, count: int) -> Callable[[bytearray], None]:
    def damage(content: bytearray) -> None:
        content[first * 65536 : (first + count) * 65536] = bytes(count * 65536)

    return damage


def _swap(content: bytearray) -> None:
    one, other = content[2 * 65536 : 3 * 65536], content[4 * 65536 : 5 * 65536]
    content[2 * 65536 : 3 * 65536], content[4 * 65536 : 5 * 65536] = other, one


def _version(number: int) -> Callable[[bytearray], None]:
    def damage(content: bytearray) -> None:
        content[60:64] = number.to_bytes(4, "big")

    return damage


@pytest.mark.parametrize(
    ("damage", "least"),
    [
        (_flip(b"CREATE TABLE blocks"), 4000),
        (_zero(0, 1), 4000),
        (_zero(1, 1), 3300),
        (_zero(5, 1), 2500),
        (_swap, 4000),
        (_version(0), 4000),
        (_version(7), 4000),
        (lambda content: content.__delitem__(slice(6 * 65536, None)), 500),
        (lambda content: content.__delitem__(slice(6 * 65536 + 100, None)), 500),
        (lambda content: content.__setitem__(slice(0, 100), b"garbage " * 12 + b"\0" * 4), 4000),
    ],
)
def test_what_a_damaged_file_still_holds_is_saved_and_the_file_is_kept(
    tmp_path: Path, damage: Callable[[bytearray], None], least: int
) -> None:
    store, before = _large(tmp_path / "s")
    content = bytearray(store.path.read_bytes())
    damage(content)
    store.path.write_bytes(content)
    with pytest.raises(StoreError, match=r"is damaged \(.*\)\. The next hident run saves what can be read"):
        store.check()
    assert store.path.read_bytes() == content
    with store.writing() as writer:
        said = writer.mended
    after = _read(store, below=4000)
    assert least <= len(after) <= 4000
    assert set(after) <= set(before)
    assert f"): {len(after)} scores are saved, and the damaged file is kept as {store.path}.damaged-1" in said
    assert Path(f"{store.path}.damaged-1").read_bytes() == content
    store.check()
    with store.writing() as writer:
        assert writer.mended == ""
    assert {path.name for path in store.folder.iterdir()} == {
        "trials.sqlite",
        "trials.sqlite.damaged-1",
        "lock",
    }


def _unfinished(folder: Path) -> tuple[Store, list[tuple[int, bytes, str]]]:
    """A store whose last trials stand in the log alone, as after a kill."""
    store, before = _large(folder / "of a run")
    with store.writing() as writer:
        for first in range(4000, 5000, 500):
            writer.add({}, [("k", _scores(*range(first, first + 500), failing=True))])
        killed = Store(folder / "killed")
        shutil.copytree(store.folder, killed.folder)
    (killed.folder / "trials.sqlite-shm").unlink()
    before = _read(store, below=5000)
    assert len(before) == 5000
    return killed, before


def test_a_log_is_read_beyond_its_damage(tmp_path: Path) -> None:
    store, before = _unfinished(tmp_path)
    log = store.folder / "trials.sqlite-wal"
    content = bytearray(log.read_bytes())
    content[40] ^= 1  # in the header of its first frame
    log.write_bytes(content)
    with store.writing() as writer:
        assert writer.mended == ""
    assert _read(store, below=5000) == before


def test_of_a_file_that_is_gone_the_log_is_saved(tmp_path: Path) -> None:
    store, before = _unfinished(tmp_path)
    in_log = {block.place for block in blocks_in(store.folder / "trials.sqlite-wal")}
    assert in_log
    for gone in (True, False):
        folder = Store(tmp_path / f"without {gone}")
        shutil.copytree(store.folder, folder.folder)
        folder.path.unlink() if gone else folder.path.write_bytes(b"")
        with folder.writing() as writer:
            assert "its file is gone, and its log is there" in writer.mended
        assert len(_read(folder, below=5000)) == sum(count for _, _, count, _ in in_log)
        assert set(_read(folder, below=5000)) <= set(before)


def test_the_log_of_another_store_takes_nothing_away(tmp_path: Path) -> None:
    store, before = _large(tmp_path / "mine")
    other = Store(tmp_path / "other")
    with other.writing() as writer:
        writer.add({}, [("l", _scores(*range(3000)))])
        shutil.copy(other.folder / "trials.sqlite-wal", store.folder)
    with store.writing():
        pass
    assert _read(store, below=4000) == before


def test_mending_goes_on_where_it_was_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    steps = 0

    class Killed(BaseException):
        pass

    replace = Path.replace
    for killed_at in range(9):
        store, before = _unfinished(tmp_path / str(killed_at))
        with closing(sqlite3.connect(f"file:{store.path}?immutable=1", uri=True)) as connection:
            query = "SELECT rootpage FROM sqlite_master WHERE name = 'sqlite_autoindex_units_1'"
            page = connection.execute(query).fetchone()[0]
        content = bytearray(store.path.read_bytes())
        _zero(page - 1, 1)(content)
        store.path.write_bytes(content)
        steps = 0

        def counted(path: Path, target: Path, last: int = killed_at) -> Path:
            nonlocal steps
            steps += 1
            if steps > last:
                raise Killed
            return replace(path, target)

        monkeypatch.setattr(Path, "replace", counted)
        try:
            with store.writing():
                break
        except Killed:
            pass
        finally:
            monkeypatch.setattr(Path, "replace", replace)
        with store.writing() as writer:
            assert "was damaged" in writer.mended
        assert _read(store, below=5000) == before
        left = {path.name.removeprefix("trials.sqlite") for path in store.folder.iterdir()}
        assert not left & {".part", ".salvaged", "-wal", "-shm"}
    assert steps >= 4


def test_a_store_of_an_earlier_format_is_refused_with_the_remedy(tmp_path: Path) -> None:
    store = Store(tmp_path)
    for number in (1, 2, 5):
        with closing(sqlite3.connect(store.path)) as connection:
            connection.execute(f"PRAGMA user_version = {number}")
        old = pytest.raises(StoreError, match=rf"has format {number}, and this hident uses format 4: move it")
        with old, store.writing():
            pytest.fail("it was opened")
        with old, store.reading():
            pytest.fail("it was opened")


def test_a_file_whose_making_ended_early_is_an_empty_store(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with closing(sqlite3.connect(store.path)) as connection:
        connection.execute("PRAGMA page_size = 65536")
        connection.execute("PRAGMA journal_mode = WAL")
    assert store.path.stat().st_size > 0
    assert (_count(store), _read(store)) == (0, [])
    store.check()
    with store.writing() as writer:
        writer.add({}, [("k", _scores(1))])
        assert writer.mended == ""
    assert _trials(store) == [1]


@pytest.mark.parametrize("name", ["trials.sqlite", "trials.sqlite-wal", "trials.sqlite-shm", "lock"])
@pytest.mark.parametrize(
    "make",
    [Path.mkdir, os.mkfifo, lambda path: path.symlink_to(path), lambda path: path.symlink_to("nowhere")],
    ids=["folder", "fifo", "circle", "dangling"],
)
def test_what_stands_in_the_place_of_a_file_is_named(
    tmp_path: Path, name: str, make: Callable[[Path], None]
) -> None:
    make(tmp_path / name)
    store = Store(tmp_path)
    for use in (store.writing, store.reading):
        with pytest.raises(StoreError, match=f"{re.escape(name)} is no file, as"), use():
            pass
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_database_of_something_else_is_set_aside(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / "trials.sqlite")) as other:
        other.executescript("PRAGMA user_version = 3; CREATE TABLE units (a); CREATE TABLE trials (a)")
    with Store(tmp_path).writing() as writer:
        assert "(its tables are those of something else): 0 scores are saved" in writer.mended
    assert (tmp_path / "trials.sqlite.damaged-1").exists()


@pytest.mark.parametrize("put", [None, b"other"], ids=["removed", "replaced"])
def test_a_file_that_vanishes_while_it_is_written_is_noticed(tmp_path: Path, put: bytes | None) -> None:
    store = Store(tmp_path)
    with store.writing() as writer:
        writer.add({}, [("key", _scores(0))])
        store.path.unlink()
        if put is not None:
            store.path.write_bytes(put)
        with pytest.raises(StoreError, match="was removed or replaced while the run was"):
            writer.add({}, [("key", _scores(0))])
