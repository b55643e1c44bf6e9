"""Faults of the trials store and of the output folder: told in one message, and nothing computed is lost."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.conftest import Lab

_DAMAGED = (
    "Nothing was changed. Move it aside (mv .hident/trials.sqlite .hident/trials.sqlite.damaged) and run "
    "again: what it held is computed anew"
)


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
    for verb in (["run", "tiny.yaml", "-j1"], ["status", "tiny.yaml"], ["export", "tiny.yaml", "x.csv"]):
        said = lab.hident(*verb, code=2).stderr
        assert said == (
            f"error: the trials store .hident/trials.sqlite is damaged (file is not a database). {_DAMAGED}\n"
        )
    assert lab.store.read_bytes() == b"garbage " * 1000
    assert not (lab.folder / "x.csv").exists()


def test_damaged_pages_and_a_truncated_file(filled: Lab) -> None:
    whole = filled.store.read_bytes()
    assert len(whole) > 5 * 4096
    for damage in ("page", "end"):
        if damage == "page":
            content = _damage(filled.store, b"\xff" * 64, 4 * 4096)
        else:
            content = whole[: 3 * 4096 + 100]
            filled.store.write_bytes(content)
        said = filled.run(code=2)
        assert said.startswith("error: the trials store .hident/trials.sqlite is damaged (")
        assert _DAMAGED in said
        assert filled.store.read_bytes() == content
    filled.store.write_bytes(whole)
    assert "all 600 trials are stored" in filled.run()


def test_a_flipped_bit_in_a_value_recomputes_that_trial(filled: Lab) -> None:
    before = filled.trials()
    value = before["probe", "{'samples': 50}", 3]
    content = filled.store.read_bytes()
    assert content.count(value) == 1
    _damage(filled.store, bytes([value[0] ^ 1]), content.index(value))
    assert "600 trials, 599 of them stored" in filled.run()
    assert filled.trials() == before


def test_rows_of_wrong_types_are_recomputed(filled: Lab) -> None:
    before = filled.trials()
    with closing(sqlite3.connect(filled.store)) as connection, connection:
        for trial, column, value in (
            (1, "data", "text"),
            (2, "data", 5),
            (3, "data", b"odd"),
            (4, "failure", b"\xff\xfe"),
            (5, "checksum", "x"),
        ):
            connection.execute(f"UPDATE trials SET {column} = ? WHERE trial = ?", (value, trial))
    assert "600 trials, 580 of them stored" in filled.run()
    assert filled.trials() == before


def test_store_of_a_newer_format(filled: Lab) -> None:
    with closing(sqlite3.connect(filled.store)) as connection:
        connection.execute("PRAGMA user_version = 3")
    for verb in (["run", "tiny.yaml", "-j1"], ["status", "tiny.yaml"]):
        assert filled.hident(*verb, code=2).stderr == (
            "error: the trials store .hident/trials.sqlite has format 3, and this hident uses format 2: move "
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
    said = lab.run("--jobs", "2", code=2, preexec_fn=lambda: _limit_files(60_000))
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
