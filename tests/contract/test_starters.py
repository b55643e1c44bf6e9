"""hident new: each starter runs as it is written, by the commands that it names; nothing is overwritten."""

from __future__ import annotations

import csv
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from hident.commands.starting import STARTERS, start
from hident.errors import ConfigError
from tests.forked import GUARD_SECONDS, ROOT, run_forked

PACKAGE = ROOT / "hident"


def hident(folder: Path, command: str, code: int = 0) -> str:
    """Run a command as it is written, with one worker, and return what it prints."""
    _, verb, *options = shlex.split(command)
    jobs = ("--jobs", "1") if verb in ("run", "power", "accept") and "--power" not in options else ()
    ended = run_forked((verb, *options, *jobs), folder)
    assert ended.returncode == code, (command, ended.stdout, ended.stderr)
    return ended.stdout if code == 0 else ended.stderr


@pytest.fixture
def begun(tmp_path: Path) -> Callable[[str], list[Path]]:
    """Begins what the arguments of `hident new` say, and gives the files that it says it wrote."""

    def begun(arguments: str) -> list[Path]:
        what, name = arguments.split()
        lines = list(start(what, name, tmp_path))
        return [Path(line.removeprefix("wrote ")) for line in lines if line.startswith("wrote ")]

    return begun


def test_a_study_runs(tmp_path: Path) -> None:
    said = hident(tmp_path, "hident new study valve")
    assert said == "wrote valve/valve.yaml\nnext: hident run valve/valve.yaml\n"
    text = (tmp_path / "valve/valve.yaml").read_text(encoding="utf-8")
    assert "starter" not in text.lower()
    commands = list(dict.fromkeys(re.findall(r"`(hident [^`]+)`", text)))
    assert len(commands) > 5
    for command in commands:
        hident(tmp_path, command)
    out = tmp_path / "out/valve"
    assert {path.name for path in out.iterdir()} >= {"table.md", "mise.png", "realisation.png"}
    with (out / "table.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {row["failed"] for row in rows} == {"0"}
    assert {row["estimator"] for row in rows} == {"kernel", "polynomial"}


def test_a_paper_goes_from_its_first_run_to_a_sound_ledger(tmp_path: Path) -> None:
    hident(tmp_path, "hident new paper smith2001")
    page = (tmp_path / "experiments/smith2001/README.md").read_text(encoding="utf-8")
    verdicts = []
    for command in re.findall(r"^    (hident .*)$", page, re.MULTILINE):
        said = hident(tmp_path, command)
        if command.startswith("hident run"):
            with (tmp_path / "out/smith2001_table1/verdicts.csv").open(encoding="utf-8") as file:
                [row] = csv.DictReader(file)
            verdicts.append((row["verdict"], row["excluded"], row["alternatives"]))
    assert verdicts == [("untestable", "0", "0"), ("agrees", "1", "2")]
    assert "Table 1" in said
    assert (tmp_path / "results/smith2001_table1/run.json").is_file()


def test_a_plugin_runs_and_its_tests_pass(tmp_path: Path) -> None:
    said = hident(tmp_path, "hident new plugin my_method --into methods")
    assert said.splitlines()[-2:] == [
        "next: hident run methods/my_method/my_method.yaml",
        "next: python -m pytest methods/my_method",
    ]
    hident(tmp_path, "hident run methods/my_method/my_method.yaml --trials 3")
    page = (tmp_path / "out/my_method/table.md").read_text(encoding="utf-8")
    assert "Largest error of the nonlinearity" in page
    ended = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-q", "methods/my_method"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=GUARD_SECONDS,
        check=False,
    )
    assert ended.returncode == 0, ended.stdout
    assert int(re.findall(r"(\d+) passed", ended.stdout)[0]) > 50


@pytest.mark.parametrize("what", STARTERS)
def test_what_is_there_is_left_as_it_is(
    what: str, tmp_path: Path, begun: Callable[[str], list[Path]]
) -> None:
    *others, last = begun(f"{what} mine")
    last.write_text("mine", encoding="utf-8")
    for path in others:
        path.unlink()
    with pytest.raises(ConfigError) as caught:
        begun(f"{what} mine")
    assert str(caught.value) == (
        f"{last}: there already, and nothing is overwritten: take another name, or another folder with --into"
    )
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [last]
    assert last.read_text(encoding="utf-8") == "mine"


def test_what_cannot_be_begun_ends_with_exit_code_2(tmp_path: Path) -> None:
    said = "'stuyd' cannot be begun; did you mean 'study'? (there are: study, paper, plugin)"
    assert hident(tmp_path, "hident new stuyd valve", code=2) == f"error: {said}\n"


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    said = hident(tmp_path, "hident new study valve --into file", code=2)
    assert said == "error: file/valve cannot be made: not a directory\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            "study 2-Tanks",
            "'2-Tanks' cannot be a name: take small letters, digits and _, a letter first; "
            "did you mean 'tanks'?",
        ),
        ("study ..", "'..' cannot be a name: take small letters, digits and _, a letter first"),
        (f"study {'a' * 300}", f"'{'a' * 300}' cannot be a name: take at most 60 letters, not 300"),
        ("study power", "'power' cannot be a name: it is the folder of what hident power writes"),
        ("paper null", "'null' cannot be a name: it means something to YAML; take my_null"),
        (
            "plugin kernel",
            "'kernel' cannot be a plugin's name: there is the estimator 'kernel' already; take my_kernel",
        ),
        *(
            (
                f"plugin {name}",
                f"'{name}' cannot be a plugin's name: it means something to Python, or in its files; "
                f"take my_{name}",
            )
            for name in ("queue", "class", "record", "transfer_function", "np", "hident")
        ),
        *(
            (
                f"plugin {name}",
                f"'{name}' cannot be a plugin's name: a module that can be imported has it; take my_{name}",
            )
            for name in ("numpy", "scipy", "yaml", "matplotlib")
        ),
        *(
            (
                f"plugin {name}",
                f"'{name}' cannot be a plugin's name: pytest would take its files for tests; take {other}",
            )
            for name, other in (
                ("test_x", "my_x"),
                ("x_test", "my_x"),
                ("test_", "my_method"),
                ("conftest", "my_conftest"),
            )
        ),
    ],
)
def test_names_that_cannot_be(
    arguments: str, said: str, tmp_path: Path, begun: Callable[[str], list[Path]]
) -> None:
    with pytest.raises(ConfigError) as caught:
        begun(arguments)
    assert str(caught.value) == said
    assert not list(tmp_path.iterdir())


def test_the_wheel_holds_them_all() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    patterns = settings["tool"]["setuptools"]["package-data"]["hident"]
    packed = {path for pattern in patterns for path in PACKAGE.glob(pattern)}
    files = {path for path in (PACKAGE / "starters").rglob("*") if path.is_file()}
    assert len(files) > 8
    assert files <= packed
