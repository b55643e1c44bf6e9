"""README.md and docs/python.md: their code, configurations and commands run, and their tables are true."""

import re
import shlex
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

import hident as hi
from hident.block_chain import BlockChain
from tests.documented import ROOT, blocks, commands
from tests.forked import run_forked

# What is in use where the tests run is not the matter here.
pytestmark = pytest.mark.filterwarnings("ignore:the arithmetic in use")

FIRST, AXES, CONTINUOUS = blocks("README.md", "yaml")
RUN, ESTIMATOR = blocks("README.md", "python")
(PRINTED,) = (one for one in blocks("docs/configuration.md", "yaml") if "alternatives:" in one)
README = (ROOT / "README.md").read_text(encoding="utf-8")
# What the test adds: few trials, and files where a page names the verb alone.
ADDED = {
    "hident run configs/mzyk_table1.yaml": "--trials 1 --jobs 1",
    "hident compare out results": "--partial",
    "hident validate my.yaml": "",
    "hident run my.yaml": "--trials 2 --jobs 1 --out mine",
    "hident list": "",
    "hident list estimators kernel": "",
    "hident schema": "",
    "hident doctor": "",
    "hident identify experiments/data_example/record.csv --input u --output y --dt 0.5": (
        "--structure hammerstein --out identified"
    ),
    "hident validate": "my.yaml",
    "hident run": "my.yaml --set excitation.high=2*pi --trials 20 --jobs 1 --out overridden",
    "hident status": "my.yaml --trials 2 --out mine",
    "hident status --watch": "my.yaml --trials 2",
    "hident run --log run.log": "my.yaml --trials 2 --jobs 1 --out logged",
    "hident run --trial-timeout 60": "my.yaml --trials 2 --jobs 1 --out limited",
    "hident compare": "mine mine",
    "hident verify": "results",
    "hident report": "mine --out pages",
    "hident export": "my.yaml trials.csv --trials 2",
    "hident identify": (
        "experiments/data_example/record.csv --input u --output y --structure linear --out linear"
    ),
    "hident simulate": "model.json valve.csv --input u",
    "hident show": "model.json",
    "hident show mzyk_table1 --trial 17": "--out shown",
    "hident convert": "model.json --to python",
    "hident new": "study tank",
    "hident new study valve": "",
    "hident new plugin my_method": "",
}
# A decision about results/, which has its own tests, and what takes a shell.
NOT_RUN = {"hident power", "hident accept", "hident accept <config>", "hident list | head -1"}


def hident(folder, *arguments):
    ended = run_forked(arguments, folder)
    assert ended.returncode == 0, (arguments, ended.stdout, ended.stderr)
    return ended.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder like the repository, with the files that README.md says to save."""
    folder = tmp_path_factory.mktemp("documented")
    for name in ("configs", "experiments", "results"):
        (folder / name).symlink_to(ROOT / name)
    (folder / "my.yaml").write_text(FIRST, encoding="utf-8")
    tank = hi.TransferFunction(b=(0.0, 0.5), a=(0.5,))
    hi.write_model(hi.FittedModel(BlockChain((tank,))), folder / "model.json")
    (folder / "valve.csv").write_text("u\n1\n2\n", encoding="utf-8")
    (folder / "my_estimators.py").write_text(ESTIMATOR, encoding="utf-8")
    (folder / "data.csv").write_text("u,y\n0,1\n1,2\n", encoding="utf-8")
    return folder


def test_the_commands_run(folder):
    pages = ("README.md", "docs/python.md", "docs/configuration.md")
    assert {command for page in pages for command in commands(page)} == ADDED.keys() | NOT_RUN
    said = {command: hident(folder, *command.split()[1:], *added.split()) for command, added in ADDED.items()}
    assert "--set excitation.high=2*pi --trials 20" in README
    assert "|    2000 |" in said["hident run my.yaml"]
    assert "up to date" in said["hident status"]
    assert said["hident status --watch"].startswith("my: 8/8 trials, done\n")
    assert 'pandas.read_json("run.log", lines=True)' in README
    assert pd.read_json(folder / "run.log", lines=True)["event"].tolist() == ["start", "end", "outputs"]


def test_the_commands_on_one_trial_run(folder):
    hident(folder, "run", "my.yaml", "--trials", "20", "--jobs", "1", "--out", "looked_at", "-q")
    _, text = blocks("docs/configuration.md", "bash")
    first, worst, failed, exported = (
        hident(folder, *shlex.split(line)[1:], "--trials", "20") for line in text.splitlines()
    )
    assert "my: trial 17 at samples 200, seed 1" in first
    assert "not stored" not in first + worst
    assert worst.startswith("mise is worst in trial ")
    assert failed == "my: none of the 20 stored trials failed\n"
    assert exported.endswith("rows of 20 trials, made again from their seeds\n")


def test_an_axis_is_a_variable_and_a_label_sets_several_values(folder):
    text = re.sub(r"cases:.*?\n(?=estimators)", AXES, FIRST, flags=re.DOTALL)
    for old, new in {"a: [0.5]": "a: [$a]", "rows: samples": "rows: a"}.items():
        text = text.replace(old, new)
    (folder / "axes.yaml").write_text(f"{text}samples: 200\n", encoding="utf-8")
    assert "4 cases, 6 estimates" in hident(folder, "validate", "axes.yaml", "--trials", "1")


def test_a_process_in_continuous_time(folder):
    (folder / "process.yaml").write_text(CONTINUOUS, encoding="utf-8")
    hident(folder, "run", "process.yaml", "--trials", "1", "--jobs", "1")


def test_an_estimator_in_a_file_of_its_own(folder):
    plugin = ("--plugin", "my_estimators.py")
    assert "Degree of the polynomial." in hident(folder, "list", "estimators", "polynomial_fit", *plugin)
    own = "estimators.wide={kind: polynomial_fit, degree: 5}"
    hident(folder, "run", "my.yaml", *plugin, "--set", own, "--trials", "2", "--jobs", "1", "--out", "own")


def test_the_tables_are_those_of_the_accepted_results():
    shown = [line for line in README.splitlines() if re.match(r"\| +(N|\d+) \|", line)]
    assert len(shown) == 14
    for rows, config in ((shown[:7], "mzyk_table1"), (shown[7:], "mzyk_left_out")):
        accepted = (ROOT / f"results/{config}/table.md").read_text(encoding="utf-8").splitlines()
        assert set(rows) <= set(accepted), config


def test_what_is_said_of_the_table_is_what_the_accepted_results_say():
    said = " ".join(README.split())
    readings = pd.read_csv(ROOT / "results/mzyk_reading/joint_free.csv")
    nearest = readings[(readings["h exponent"] == "1/5") & (readings["q exponent"] == "1/5")].iloc[0]
    assert f"{len(readings)} [readings](results/mzyk_reading/table.md)" in said
    assert tuple(nearest[["metric", "statistic", "h0", "q0", "density", "R(0) subtracted", "step 1"]]) == (
        "at the samples", "median", 0.2, 8, "estimated", "no", "psi = abs(u)"
    )  # fmt: skip
    printed = (ROOT / "results/mzyk_table1_as_printed/table.md").read_text(encoding="utf-8").splitlines()
    first, last = (next(row for row in printed if row.startswith(f"| {n:>4} |")) for n in (50, 3000))
    numbers = [row.split("|")[2:9:2] for row in (first, last)]
    spoken = [f"{a.strip()}, {b.strip()}, {c.strip()} and {d.strip()}" for a, b, c, d in numbers]
    assert f"[{spoken[0]}][printed 50] at N = 50, and [{spoken[1]}][printed 3000] at N = 3000" in said


def test_every_page_and_file_that_is_linked_is_there():
    for page in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")):
        links = re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8"))
        assert [link for link in links if "://" not in link and not (page.parent / link).exists()] == []


@pytest.fixture(scope="module")
def space(folder):
    """The names that the code of docs/python.md leaves behind, with one trial in place of twenty."""
    space: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.chdir(folder)
        for code in (*blocks("docs/python.md", "python"), RUN):
            exec(code.replace("trials=20", "trials=1"), space)
    return space


def test_the_code_runs(space):
    assert {"system", "record", "estimate", "results"} <= space.keys()
    assert len(space["results"].frame()) == 36


def test_what_is_said_of_calls_between_the_lines(space, folder, monkeypatch):
    monkeypatch.chdir(folder)
    page = (ROOT / "docs/python.md").read_text(encoding="utf-8")
    calls = re.findall(r"`((?:hi|results|estimator|estimate)\.[\w.]+\([^`.]*(?:\.csv[^`]*)?\))`", page)
    names = {
        "estimator": hi.Kernel(kernel="gaussian", bandwidth={"h0": 1, "alpha": "1/5"}),
        "model": hi.load_model("model.json"),
        "estimate": hi.Estimate(linear=hi.TransferFunction(a=(0.5,))),
        "experiment": {**yaml.safe_load(FIRST), "trials": 1},
        "reproduction": {**yaml.safe_load(PRINTED), "trials": 2},
        "folder": "written",
        "ours": "written",
        "reference": "written",
        "u": np.zeros(3),
        "y": np.zeros(3),
        "dt": 0.1,
    }
    assert len(set(calls)) == 21
    for call in dict.fromkeys(calls):
        # One structure, as all of them take too long.
        eval(call.replace("identify(record)", "identify(record, ['linear'])"), {**space, **names})
