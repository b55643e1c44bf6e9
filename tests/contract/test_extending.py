"""docs/extending.md: its files, commands and script do what the page says."""

import csv
import lzma
import re
import shlex
import subprocess
import sys

import pytest

from hident.config.spec import PLURALS
from tests.documented import blocks
from tests.forked import GUARD_SECONDS, run_forked

PAGE = "docs/extending.md"
FILES = dict(block.removeprefix("# ").split("\n", 1) for block in blocks(PAGE, "python", "yaml"))
COMMANDS = [line for block in blocks(PAGE, "console") for line in block.splitlines()]


def done(command, folder):
    """The command, run to its end in the folder; hident's in a fork of this process."""
    program, *arguments = shlex.split(command)
    if program == "hident":
        ended = run_forked(arguments, folder)
    else:
        assert program == "python"
        ended = subprocess.run(
            [sys.executable, *arguments],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=GUARD_SECONDS,
            check=False,
        )
    assert ended.returncode == 0, (command, ended.stdout, ended.stderr)
    return ended.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("extending")
    for name, text in FILES.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def said(folder):
    """What each command prints, run one after the other."""
    return {command: done(command, folder) for command in COMMANDS}


def test_there_is_an_example_of_each():
    registered = {
        line for text in FILES.values() for line in text.splitlines() if line.startswith("@component")
    }
    families = {line.split('"')[1] for line in registered}
    assert families == set(PLURALS.values())
    assert {"json_lines.py", "timed.py"} <= set(FILES)


def test_every_file_is_used():
    used = "".join(FILES[name] for name in ("valve.yaml", "parts.yaml", "run_valve.py")) + " ".join(COMMANDS)
    assert [name for name in FILES if name.removesuffix(".py") not in used] == []


def test_the_commands_run(said, folder):
    assert said["hident list estimators fir_hammerstein --plugin fir_hammerstein.py"].startswith(
        "fir_hammerstein: Finite impulse response after a polynomial"
    )
    assert "## The worst trials" in (folder / "out/valve/table.md").read_text(encoding="utf-8")
    assert (folder / "out/valve/largest.png").stat().st_size > 0


def test_a_basis_and_a_chain_of_blocks_estimate(said, folder):
    with (folder / "out/parts/table.csv").open(encoding="utf-8") as file:
        rows = {row["metric"]: row for row in csv.DictReader(file)}
    assert {row["failed"] for row in rows.values()} == {"0"}
    assert float(rows["fit"]["mean"]) > 80
    assert float(rows["mise"]["median"]) < 0.03


def test_their_tests_pass(said):
    passed = int(re.findall(r"(\d+) passed", said["python -m pytest test_valve.py"])[0])
    assert passed > 20


def test_the_estimates_are_good(said, folder):
    with (folder / "out/valve/table.csv").open(encoding="utf-8") as file:
        without = {row["metric"]: row for row in csv.DictReader(file) if float(row["share"]) == 0}
    assert {row["failed"] for row in without.values()} == {"0"}
    assert float(without["largest"]["median"]) < 0.05
    assert abs(float(without["b b_1"]["mean"])) < 3 * float(without["b b_1"]["se"])


def test_another_store_and_executor_give_the_same_trials(said, folder):
    ran, scripted = (
        lzma.decompress((folder / path / "trials.csv.xz").read_bytes()) for path in ("out/valve", "written")
    )
    assert scripted == ran


def test_the_store_keeps_the_trials(said, folder):
    # Of two estimators the scores of two metrics, and how long their fits took.
    assert len(list((folder / "trials").iterdir())) == 2 * 2 + 2
    assert done("python run_valve.py", folder) == "0 chunks of trials in 0.00 s\n"
