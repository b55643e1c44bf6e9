"""Where a run says that its files come from."""

import subprocess

import pytest

from hident.reports import output


@pytest.fixture
def checkout(tmp_path):
    for name in ("configs/a.yaml", "results/a/table.csv", "hident/code.py"):
        path = tmp_path / name
        path.parent.mkdir(parents=True)
        path.write_text("1\n")
    who = ["-c", "user.name=a", "-c", "user.email=a@example.org"]
    for arguments in (["init", "-q"], ["add", "-A"], [*who, "commit", "-q", "-m", "one"]):
        subprocess.run(["git", "-C", tmp_path, *arguments], check=True)
    return tmp_path


def test_what_was_accepted_since_the_commit_is_no_change_of_the_code(checkout):
    assert output._git(checkout)["git_dirty"] is False
    (checkout / "results/a/table.csv").write_text("2\n")
    assert output._git(checkout)["git_dirty"] is False
    (checkout / "hident/code.py").write_text("2\n")
    assert output._git(checkout)["git_dirty"] is True


def test_a_change_beside_the_folder_of_the_configurations_counts(checkout):
    (checkout / "hident/code.py").write_text("2\n")
    assert output._git(checkout / "configs")["git_dirty"] is True


def test_without_a_repository_nothing_is_known(tmp_path, monkeypatch):
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert output._git(tmp_path) == {"git_commit": None, "git_dirty": None}
