"""``hident doctor``: what it says, and what it calls unsound."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from hident import arithmetic
from hident.cli import app
from hident.engine.scores import Scores
from hident.engine.store import Store


def _doctor(*arguments: str) -> Result:
    return CliRunner().invoke(app, ["doctor", *arguments], env={"COLUMNS": "1000"})


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_sound_installation(here: Path) -> None:
    found = _doctor()
    assert found.exit_code == 0
    lines = {line.split("  ")[0]: line for line in found.output.splitlines()}
    for topic in ("hident", "python", "platform", "libraries", "threads", "cores", "plugins", "matplotlib"):
        assert topic in lines
    assert arithmetic.identity() in lines["arithmetic"]
    assert lines["store"].endswith(f"none yet at {Path('.hident/trials.sqlite')}")
    assert found.output.endswith("nothing is unsound\n")
    assert not (here / ".hident").exists()


def _stored(folder: Path, trials: int) -> None:
    import numpy as np

    with Store(folder).writing() as writer:
        writer.add({"k": {}}, [("k", Scores(np.arange(trials), np.ones((trials, 200))))])


def test_a_store_is_counted_and_a_damaged_one_is_unsound(here: Path) -> None:
    _stored(here / "s", 50)
    assert "50 scores" in _doctor("--store", "s").output
    file = here / "s/trials.sqlite"
    with sqlite3.connect(file) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    data = bytearray(file.read_bytes())
    data[len(data) // 2 :] = bytes(len(data) - len(data) // 2)
    file.write_bytes(data)
    found = _doctor("--store", "s")
    assert found.exit_code == 1
    assert "unsound: store: the trials store" in found.output
    assert "is damaged" in found.output


def test_a_store_in_use_is_no_fault(here: Path) -> None:
    with Store(here / "s").writing():
        found = _doctor("--store", "s")
    assert found.exit_code == 0
    assert "warning: store: s/trials.sqlite: in use by another run" in found.output


def test_a_plugin_that_does_not_load_is_unsound(here: Path) -> None:
    (here / "p.py").write_text("import nonsense_that_is_not_there\n")
    found = _doctor("--plugin", "p.py")
    assert found.exit_code == 1
    assert "unsound: plugins: plugin p.py cannot be loaded: ModuleNotFoundError" in found.output


def test_arithmetic_that_is_not_to_be_had_is_a_warning(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use = arithmetic.in_use() | {"asked": "pinned", "simd": ["X86_V3", "X86_V4"]}
    monkeypatch.setattr(arithmetic, "in_use", lambda: use)
    found = _doctor()
    assert found.exit_code == 0
    assert "warning: arithmetic: the arithmetic in use is not the pinned one" in found.output
