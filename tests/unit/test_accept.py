"""Accepting results: an exact copy or none, at whatever moment it is interrupted."""

import json
import shutil
from pathlib import Path

import pytest

from hident.errors import ConfigError, NothingToCompare, StoreError
from hident.ledger.accept import Accepted, accept

TABLE = "estimator,metric,trials,mean\n(4),mise,100,0.5\n"


@pytest.fixture
def ours(tmp_path):
    folder = tmp_path / "out" / "x"
    folder.mkdir(parents=True)
    (folder / "table.csv").write_text(TABLE)
    (folder / "figure.bin").write_bytes(b"\x00\x01")
    (folder / "run.json").write_text(
        json.dumps({"files": ["table.csv", "figure.bin"], "provenance": {"n": 1}})
    )
    return folder


@pytest.fixture
def results(tmp_path):
    return tmp_path / "results"


def content(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


def provenance(folder, n):
    run = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps({**run, "provenance": {"n": n}}))


def test_new_results(ours, results):
    accepted = accept(ours, results)
    assert accepted == Accepted("x", "new")
    assert str(accepted) == "x: new"
    assert content(results) == {f"x/{name}": data for name, data in content(ours).items()}


def test_accepting_twice_changes_nothing(ours, results):
    accept(ours, results)
    accepted = accept(ours, results)
    assert accepted == Accepted("x", "unchanged")
    assert str(accepted) == "x: unchanged"
    assert content(results / "x") == content(ours)


def test_changed_results_replace_the_old_ones(ours, results):
    accept(ours, results)
    (results / "x/stale.csv").write_text("a\n1\n")
    (ours / "table.csv").write_text(TABLE.replace("0.5", "0.6"))
    accepted = accept(ours, results)
    assert accepted.change == "changed"
    assert accepted.differences == (
        "x/stale.csv: missing",
        "x/table.csv: estimator (4), metric mise: mean 0.6, reference 0.5, relative difference 1.7e-01",
    )
    assert str(accepted) == "x: changed, 2 differences"
    assert content(results) == {f"x/{name}": data for name, data in content(ours).items()}


def test_the_copy_is_exact_where_no_result_changed(ours, results):
    accept(ours, results)
    provenance(ours, 2)
    assert accept(ours, results).change == "unchanged"
    assert content(results / "x") == content(ours)


def test_only_listed_files_are_copied(ours, results):
    before = content(ours)
    (ours / "notes.txt").write_text("mine")
    (ours / ".hidden").write_text("mine")
    accept(ours, results)
    assert content(results / "x") == before


def test_other_configurations_stay(ours, results):
    accept(ours, results)
    shutil.copytree(results / "x", results / "y")
    accept(ours, results)
    assert sorted(path.name for path in results.iterdir()) == ["x", "y"]


def test_a_folder_without_run_json_is_refused(ours, results):
    (ours / "run.json").unlink()
    with pytest.raises(NothingToCompare) as caught:
        accept(ours, results)
    assert str(caught.value) == f"{ours} holds no finished run: hident run x"
    assert not results.exists()


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "{}", '{"files": "table.csv"}', '{"files": [1]}', "[" * 100_000]
)
def test_a_broken_run_json_is_refused(ours, results, text):
    (ours / "run.json").write_text(text)
    with pytest.raises(ConfigError) as caught:
        accept(ours, results)
    assert str(caught.value) == f"{ours / 'run.json'} does not list the files of a run: hident run x"


def test_a_missing_file_is_refused_and_the_old_results_stay(ours, results):
    accept(ours, results)
    before = content(results)
    (ours / "table.csv").unlink()
    with pytest.raises(ConfigError) as caught:
        accept(ours, results)
    assert str(caught.value) == f"{ours} lacks table.csv, which its run.json lists: hident run x"
    assert content(results) == before


@pytest.mark.parametrize("name", ["../secret", "/etc/hostname"])
def test_a_file_elsewhere_is_refused(ours, results, name):
    (ours.parent / "secret").write_text("s")
    (ours / "run.json").write_text(json.dumps({"files": [name]}))
    with pytest.raises(ConfigError) as caught:
        accept(ours, results)
    assert str(caught.value) == f"{ours / 'run.json'} lists {name}, which is not in its folder"


def test_results_that_cannot_be_written(ours, results):
    results.write_text("a file")
    with pytest.raises(StoreError) as caught:
        accept(ours, results)
    assert str(caught.value).startswith(f"{ours} cannot be accepted into {results}: [Errno 17] File exists")


def test_a_left_over_folder_that_cannot_be_removed_never_mixes_in(ours, results, monkeypatch):
    accept(ours, results)
    (results / ".x.new").mkdir()
    (results / ".x.new/stale.csv").write_text("a\n1\n")
    monkeypatch.setattr(shutil, "rmtree", lambda folder, ignore_errors: None)
    with pytest.raises(StoreError, match=r"cannot be accepted into .*: .*File exists: .*\.x\.new"):
        accept(ours, results)
    assert content(results / "x") == content(ours)


def test_a_full_disk_leaves_the_old_results(ours, results, monkeypatch):
    accept(ours, results)
    before = content(results)
    (ours / "table.csv").write_text(TABLE.replace("0.5", "0.6"))

    def full(source, target):
        Path(target).write_bytes(b"half")
        raise OSError(28, "No space left on device", str(target))

    monkeypatch.setattr(shutil, "copyfile", full)
    with pytest.raises(StoreError, match=r"cannot be accepted into .*: .*No space left on device"):
        accept(ours, results)
    assert content(results) == before


@pytest.mark.parametrize("error", [OSError("refused"), KeyboardInterrupt()])
@pytest.mark.parametrize("renames", [0, 1])
def test_a_failed_swap_leaves_the_old_results(ours, results, monkeypatch, error, renames):
    """The swap is two renames; the first or the second of them fails, and the later ones succeed."""
    accept(ours, results)
    before = content(results)
    (ours / "table.csv").write_text(TABLE.replace("0.5", "0.6"))
    rename, left = Path.rename, [renames]

    def failing(path, target):
        left[0] -= 1
        if left[0] == -1:
            raise error
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises(StoreError if isinstance(error, OSError) else KeyboardInterrupt):
        accept(ours, results)
    assert content(results) == before


@pytest.mark.parametrize("renames", [0, 1, 2])
def test_after_a_kill_the_old_or_the_new_results_are_there(ours, results, monkeypatch, renames):
    """A kill runs no clean-up: nothing on disk changes after ``renames`` renames."""
    accept(ours, results)
    old = content(results / "x")
    (ours / "table.csv").write_text(TABLE.replace("0.5", "0.6"))
    with monkeypatch.context() as patch:
        rename, left = Path.rename, [renames]

        class Killed(BaseException):
            pass

        def killing(path, target):
            if left[0] == 0:
                raise Killed
            left[0] -= 1
            return rename(path, target)

        def dead(*_, **__):
            if left[0] == 0:
                raise Killed

        patch.setattr(Path, "rename", killing)
        patch.setattr(shutil, "rmtree", dead)
        with pytest.raises(Killed):
            accept(ours, results)
    whole = {0: ("x", old), 1: (".x.old", old), 2: ("x", content(ours))}
    folder, expected = whole[renames]
    assert content(results / folder) == expected
    assert accept(ours, results).change == ("unchanged" if renames == 2 else "changed")
    assert content(results) == {f"x/{name}": data for name, data in content(ours).items()}
