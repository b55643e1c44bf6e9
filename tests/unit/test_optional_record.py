"""A configuration whose record may be absent: left out with a line where it is, run where it is not."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import numpy as np
import pytest

import hident as hi
from hident.errors import ConfigError, RecordAbsent
from tests.forked import run_forked
from tests.unit.plans import planned, refusals

if TYPE_CHECKING:
    from pathlib import Path

CONFIG = """\
version: 1
title: A tank
record: {file: ../data/tank.csv, input: u, output: y, optional: true, source: a benchmark}
trials: 1
estimators:
  two-stage: {kind: two_stage, lags: 3, degree: 2}
metrics:
  b: {kind: value, of: [b_1, b_2]}
"""
REQUIRED = CONFIG.replace(", optional: true, source: a benchmark", "")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A project with a configuration that can go without its record, and one that needs none."""
    rng = np.random.default_rng(3)
    u = rng.uniform(-1, 1, 60)
    (tmp_path / "data").mkdir()
    columns = np.c_[u, np.convolve(u + u**2, [0.0, 1.0, 0.5])[:60]]
    np.savetxt(tmp_path / "data/tank.csv", columns, delimiter=",", header="u,y", comments="")
    for name in ("configs", "experiments"):
        (tmp_path / name).mkdir()
    (tmp_path / "configs/tank.yaml").write_text(CONFIG, encoding="utf-8")
    (tmp_path / "configs/other.yaml").write_text(REQUIRED.replace("../data/tank", "own"), encoding="utf-8")
    shutil.copy(tmp_path / "data/tank.csv", tmp_path / "configs/own.csv")
    return tmp_path


@pytest.fixture
def without(folder: Path) -> Path:
    """The project after the accepted results were made, on a machine without the record."""
    for config in ("tank", "other"):
        ended = run_forked(("run", config, "--jobs", "1", "--quiet"), folder)
        assert ended.returncode == 0, ended.stderr
    (folder / "out").rename(folder / "results")
    (folder / "data/tank.csv").unlink()
    return folder


def _said(folder: Path) -> str:
    where = folder / "data/tank.csv"
    return f"left out: configs/tank.yaml: its record is not here: there is no {where} (a benchmark)\n"


def test_the_others_are_run_and_compared(without: Path) -> None:
    ended = run_forked(("run", "tank", "other", "--jobs", "1", "--quiet"), without)
    assert (ended.returncode, ended.stderr) == (0, _said(without))
    assert [path.name for path in (without / "out").iterdir()] == ["other"]
    ended = run_forked(("compare", "out", "results", "--complete"), without)
    assert (ended.returncode, ended.stdout) == (
        0,
        "left out: tank: its record is not here (../data/tank.csv)\n"
        "out against results: 1 configuration, no differences\n",
    )


def test_accepted_results_must_be_made_again_where_the_record_is(without: Path) -> None:
    shutil.copy(without / "configs/own.csv", without / "data/tank.csv")
    run_forked(("run", "other", "--jobs", "1", "--quiet"), without)
    ended = run_forked(("compare", "out", "results", "--complete"), without)
    assert ended.returncode == 1
    assert ended.stdout.startswith("tank: not run; hident run tank\nnot run here: tank\n")


@pytest.mark.parametrize("verb", [("run", "--jobs", "1"), ("validate",), ("status",), ("status", "--watch")])
def test_a_configuration_alone_is_left_out(without: Path, verb: tuple[str, ...]) -> None:
    ended = run_forked((verb[0], "tank", *verb[1:]), without)
    assert (ended.returncode, ended.stderr) == (0, _said(without))


def test_accept_leaves_it_out(without: Path) -> None:
    shutil.copytree(without / "results", without / "out")
    before = (without / "results/tank/run.json").read_bytes()
    ended = run_forked(("accept", "tank", "--jobs", "1", "--quiet"), without)
    assert (ended.returncode, ended.stderr, ended.stdout) == (0, _said(without), "")
    assert (without / "results/tank/run.json").read_bytes() == before


def test_what_is_for_one_configuration_cannot_go_without(
    without: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended = run_forked(("export", "tank", "trials.csv"), without)
    assert (ended.returncode, ended.stderr) == (2, _said(without).replace("left out", "error"))
    monkeypatch.chdir(without)
    with pytest.raises(ConfigError, match="its record is not here"):
        hi.run("tank")


def test_what_else_is_wrong_is_said_first(folder: Path) -> None:
    (folder / "data/tank.csv").unlink()
    (wrong,) = refusals(folder / "configs", CONFIG.replace("degree: 2", "degree: 0"))
    assert "estimators.two-stage.degree: must be greater" in wrong


def test_a_record_that_is_not_optional_must_be_there(without: Path) -> None:
    (without / "configs/tank.yaml").write_text(REQUIRED, encoding="utf-8")
    ended = run_forked(("validate", "tank"), without)
    assert ended.returncode == 2
    assert "cannot be read: no such file or directory" in ended.stderr


def test_one_absent_file_leaves_all_cases_out(folder: Path) -> None:
    text = CONFIG.replace("../data/tank.csv", "$file") + "cases:\n  file: [own.csv, other.csv]\n"
    with pytest.raises(RecordAbsent, match=r"there is no .*other\.csv \(a benchmark\)$"):
        planned(folder / "configs", text)


def test_the_data_are_the_same_with_and_without_the_word(folder: Path) -> None:
    keys = [planned(folder / "configs", text).keys for text in (CONFIG, REQUIRED)]
    assert keys[0] == keys[1]
