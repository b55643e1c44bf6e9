"""Faults of the trials store and of the output folder: told in one message, and nothing computed is lost."""

from __future__ import annotations

import os
import re
import resource
import shutil
import signal
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from hident.engine.blocks import blocks_in

if TYPE_CHECKING:
    from tests.conftest import Lab


@pytest.fixture(scope="module")
def full_store(make_lab: Callable[[Path], Lab], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a store that holds all trials."""
    lab = make_lab(tmp_path_factory.mktemp("full"))
    lab.probe()
    lab.configure(trials=150)
    lab.run("-q")
    return lab.store.parent


@pytest.fixture
def filled(lab: Lab, full_store: Path) -> Lab:
    """A laboratory whose store holds all trials, and which has no outputs."""
    lab.probe()
    lab.configure(trials=150)
    shutil.copytree(full_store, lab.store.parent)
    return lab


def _damage(store: Path, change: bytes, at: int) -> bytes:
    content = bytearray(store.read_bytes())
    content[at : at + len(change)] = change
    store.write_bytes(content)
    return bytes(content)


def test_not_a_store(lab: Lab) -> None:
    lab.store.parent.mkdir()
    lab.store.write_bytes(b"garbage " * 1000)
    for verb in (["status", "tiny.yaml"], ["export", "tiny.yaml", "x.csv"]):
        assert lab.hident(*verb, code=2).stderr == (
            "error: the trials store .hident/trials.sqlite is damaged (file is not a database). The next "
            "hident run saves what can be read into a new one, and keeps the damaged file\n"
        )
    assert lab.store.read_bytes() == b"garbage " * 1000
    assert not (lab.folder / "x.csv").exists()
    said = lab.run()
    assert (
        "warning: the trials store .hident/trials.sqlite was damaged (file is not a database): 0 scores are "
        "saved, and the damaged file is kept as .hident/trials.sqlite.damaged-1; 0 of the 24 trials of tiny "
        "are saved\n"
    ) in said
    assert (lab.folder / ".hident/trials.sqlite.damaged-1").read_bytes() == b"garbage " * 1000
    assert "is up to date" in lab.run()


@pytest.mark.parametrize("damage", ["page", "end", "key"])
def test_a_damaged_file_is_mended_by_the_run_and_what_is_lost_is_computed_again(
    filled: Lab, damage: str
) -> None:
    before, content = filled.trials(), filled.store.read_bytes()
    places = [found.start() for found in re.finditer(rb"\x93hident", content)]
    some = places[len(places) // 2] + 50
    if damage == "page":
        start = some // 65536 * 65536
        _damage(filled.store, bytes(some - start), start)
    elif damage == "key":
        key = next(block.key for block in blocks_in(filled.store)).encode()
        _damage(filled.store, bytes([key[0] ^ 1]), content.index(key))
    else:
        filled.store.write_bytes(content[:some])
    said = filled.run()
    assert "warning: the trials store .hident/trials.sqlite was damaged (" in said
    [saved] = re.findall(r"; (\d+) of the 600 trials of tiny are saved\n", said)
    # The key's first place is in the index, from which nothing is saved.
    assert (0 < int(saved) < 600) == (damage != "key")
    assert f"600 trials, {saved} of them stored\n" in said or "all 600 trials are stored\n" in said
    assert filled.trials() == before
    assert "is up to date" in filled.run()


def test_accept_tells_of_a_damaged_store_too(lab: Lab) -> None:
    lab.run("-q")
    lab.store.write_bytes(b"garbage " * 1000)
    said = lab.hident("accept", "tiny", "-q", "-j1").stderr
    assert (
        "warning: the trials store .hident/trials.sqlite was damaged (file is not a database): 0 sc" in said
    )
    assert "; 0 of the 24 trials of tiny are saved\n" in said


def test_flipped_bits_in_values_cost_their_blocks(filled: Lab) -> None:
    before = filled.trials()
    value = before["probe", "{'samples': 50}", 3]
    content = filled.store.read_bytes()
    assert content.count(value) == 1
    _damage(filled.store, bytes([value[0] ^ 1]), content.index(value))
    said = filled.run()
    assert "600 trials, " in said
    assert "of them stored" in said
    assert "warning" not in said
    assert filled.trials() == before


def test_rows_of_wrong_types_are_recomputed(filled: Lab) -> None:
    before = filled.trials()
    with closing(sqlite3.connect(filled.store)) as connection, connection:
        rows = [row for (row,) in connection.execute("SELECT rowid FROM blocks ORDER BY rowid")]
        for row, value in zip(rows, ("text", 5, b"odd", b""), strict=False):
            connection.execute("UPDATE blocks SET data = ? WHERE rowid = ?", (value, row))
    filled.run()
    assert filled.trials() == before


def test_store_of_a_newer_format(filled: Lab) -> None:
    with closing(sqlite3.connect(filled.store)) as connection:
        connection.execute("PRAGMA user_version = 5")
        connection.execute("DELETE FROM blocks")
        connection.commit()
        connection.execute("VACUUM")
    for verb in (["run", "tiny.yaml", "-j1"], ["status", "tiny.yaml"]):
        assert filled.hident(*verb, code=2).stderr == (
            "error: the trials store .hident/trials.sqlite has format 5, and this hident uses format 4: move "
            "it aside, or name another with --store\n"
        )


def test_store_folder_that_cannot_be_used(lab: Lab) -> None:
    (lab.folder / "file").touch()
    assert lab.run("--store", "file", code=2) == (
        "error: file is not a folder, as the trials store needs: --store names one\n"
    )
    for folder, reason in (
        ("file/inner", "not a directory"),
        ("/proc/x", "no such"),
    ):
        said = lab.run("--store", folder, code=2)
        assert said.startswith(f"error: the trials store {folder}/trials.sqlite cannot be used ({reason}")
        assert said.endswith("its folder must be writable; --store names another\n")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_read_only_folders(lab: Lab) -> None:
    (lab.folder / "fixed").mkdir(mode=0o555)
    assert "permission denied" in lab.run("--store", "fixed/store", code=2)
    assert "permission denied" in lab.run("--out", "fixed/out", code=2)


def _limit_files(size: int) -> None:
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def test_full_disk_under_the_store(lab: Lab) -> None:
    lab.probe()
    lab.configure(trials=1000)
    said = lab.run("--jobs", "2", code=2, preexec_fn=lambda: _limit_files(600_000))
    assert "cannot be used (disk i/o error): the disk is full or failing. All stored trials are kept" in said
    lab.await_alone()
    kept = len(lab.trials())
    assert 0 < kept < 4000
    assert f"4000 trials, {kept} of them stored" in lab.run()


def test_full_disk_under_the_outputs(filled: Lab) -> None:
    # The title makes table.md long: a store that is only read needs 32 KiB for its index.
    filled.configure(title="Tiny" * 10_000)
    said = filled.run(code=2, preexec_fn=lambda: _limit_files(35_000))
    assert said.endswith(
        "error: out/tiny cannot be written (file too large). All trials are kept: make room for the outputs, "
        "or name another folder with --out, and run again\n"
    )
    assert not list((filled.folder / "out/tiny").iterdir())
    filled.configure(title="Tiny")
    assert "all 600 trials are stored" in filled.run()


def test_full_disk_under_an_export(filled: Lab) -> None:
    filled.configure(estimators={"long" * 50: {"kind": "known_dynamics", "a": [0.8]}, "probe": "probe"})
    limited = filled.hident("export", "tiny.yaml", "x.csv", code=2, preexec_fn=lambda: _limit_files(35_000))
    said = limited.stderr
    assert said == "error: x.csv cannot be written: file too large\n"
    assert not list(filled.folder.glob("*.part")) + list(filled.folder.glob("*.csv"))


def test_files_where_folders_should_be_and_folders_where_files_should_be(filled: Lab) -> None:
    (filled.folder / "file").touch()
    said = filled.run("--out", "file", code=2)
    assert "error: file/tiny cannot be written (not a directory). All trials are kept" in said
    (filled.folder / "out/tiny/table.csv").mkdir(parents=True)
    said = filled.run(code=2)
    assert "error: out/tiny/table.csv cannot be written (is a directory). All trials" in said
    assert [path.name for path in (filled.folder / "out/tiny").iterdir()] == ["table.csv"]
