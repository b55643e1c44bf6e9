"""The workflows and .ci/run: what they name is there, and they are what they are meant to be."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.accepted import ROOT

WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))


def _jobs(path: Path) -> dict[str, Any]:
    jobs = yaml.safe_load(path.read_text(encoding="utf-8"))["jobs"]
    assert isinstance(jobs, dict)
    return jobs


def _steps(path: Path) -> list[dict[str, Any]]:
    return [step for job in _jobs(path).values() for step in job["steps"]]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_actions_are_held_at_a_version_and_commands_are_there(path: Path) -> None:
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    for step in _steps(path):
        if "uses" in step:
            assert re.fullmatch(r"actions/[a-z-]+@v\d+", step["uses"])
            continue
        match step["run"].split():
            case ["make", target]:
                assert target in targets
            case ["bash", script]:
                assert (ROOT / script).is_file()
            case _:
                raise AssertionError(f"{step['run']} is neither a target nor a script")
    assert all("timeout-minutes" in job for job in _jobs(path).values())


def test_the_pages_are_those_that_make_site_writes() -> None:
    jobs = _jobs(ROOT / ".github/workflows/site.yml")
    *_, made, uploaded = jobs["build"]["steps"]
    assert made["run"] == "make site"
    assert uploaded["uses"].startswith("actions/upload-pages-artifact@")
    recipe = re.search(
        r"^site:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert recipe and "hident report results" in recipe[1] and "--out" not in recipe[1]
    # Without --out it is this folder.
    assert uploaded["with"]["path"] == "site"
    assert jobs["publish"]["needs"] == "build"
    assert jobs["publish"]["permissions"] == {"pages": "write", "id-token": "write"}


def test_pictures_of_pages_are_kept_where_the_tests_write_them() -> None:
    [run, kept] = _steps(ROOT / ".github/workflows/ci.yml")[-2:]
    assert kept["with"]["path"] == run["env"]["HIDENT_SCREENSHOTS"]
    assert kept["if"] == "always()"


def test_ci_is_a_sound_script() -> None:
    subprocess.run(["bash", "-n", ROOT / ".ci/run"], check=True)
