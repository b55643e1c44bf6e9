"""The command line through a real process: verbs, exit codes, what is printed and what is written."""

from __future__ import annotations

import itertools
import json
import os
import pty
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest
import yaml
from typer.testing import CliRunner

import hident
from hident import plugins
from hident.cli import Listed, app
from hident.config.spec import PLURALS, components
from hident.progress import Lines
from tests.forked import Forked

if TYPE_CHECKING:
    from tests.conftest import Lab

plugins.load()
_VERBS = (
    "list",
    "validate",
    "run",
    "power",
    "status",
    "compare",
    "accept",
    "verify",
    "report",
    "schema",
    "export",
    "show",
    "identify",
    "simulate",
    "convert",
    "new",
    "doctor",
)
_PUBLISHED = {
    "paper_trials": "unknown",
    "cells": [
        {"table": "T", "row": "N={samples}", "quantity": "a", "estimator": "iv", "metric": "a a_1"},
    ],
}


def _ran(lab: Lab) -> Lab:
    """A run whose paper printed one number that comes out and one that does not."""
    paper = lab.folder / "experiments/paper"
    paper.mkdir(parents=True)
    (paper / "published.csv").write_text("table,row,quantity,printed,note\nT,N=50,a,0.0,\nT,N=80,a,9.9,\n")
    (paper / "reasons.yaml").write_text('reasons:\n  - {row: N=80, reason: "a slip of the pen"}\n')
    lab.configure(paper="paper", published=_PUBLISHED)
    quiet = lab.hident("run", "tiny.yaml", "--jobs", "1", "--quiet")
    assert (quiet.stdout, quiet.stderr) == ("", "")
    return lab


@pytest.fixture(scope="module")
def one_run(make_lab: Callable[[Path], Lab], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _ran(make_lab(tmp_path_factory.mktemp("one"))).folder


@pytest.fixture
def done(lab: Lab, one_run: Path) -> Lab:
    """A laboratory after a run."""
    shutil.copytree(one_run, lab.folder, dirs_exist_ok=True)
    return lab


# Listing and validating


def test_list_of_everything_has_every_family_and_one_line_for_each_component(lab: Lab) -> None:
    lines = lab.hident("list").stdout.splitlines()
    assert [line for line in lines if not line.startswith(" ")] == [f"{listed.value}:" for listed in Listed]
    assert "  iid " in "\n".join(lines)
    assert {listed.value for listed in Listed} == {*PLURALS, "configs"}


@pytest.mark.parametrize("family", [listed.value for listed in Listed if listed.value != "configs"])
def test_list_of_a_family(family: str) -> None:
    lines = CliRunner().invoke(app, ["list", family]).output.splitlines()
    assert lines
    assert all(len(line.split(maxsplit=1)) == 2 and not line.startswith(" ") for line in lines)


def test_list_of_configs(lab: Lab) -> None:
    (lab.folder / "configs").mkdir()
    (lab.folder / "tiny.yaml").rename(lab.folder / "configs/tiny.yaml")
    assert lab.hident("list", "configs").stdout.split() == ["tiny", "Tiny"]
    wide = {**os.environ, "COLUMNS": "200"}
    assert lab.hident("list", "configs", "tiny", env=wide).stdout.splitlines() == [
        "tiny: Tiny",
        "configs/tiny.yaml: fine: 2 cases, 4 estimates of 6 trials",
        "",
        "case     labels",
        "samples  50, 80",
        "",
        "estimator  what it is",
        f"known      {components('estimator')['known_dynamics'].summary()}",
        f"iv         {components('estimator')['instrumental_variables'].summary()}",
    ]
    # Found by its name alone.
    assert lab.hident("validate", "tiny").stdout.startswith("configs/tiny.yaml: fine: 2 cases, 4 estimates")


def test_list_of_a_component_has_its_fields_and_its_source(lab: Lab) -> None:
    said = lab.hident("list", "estimators", "kernel").stdout
    assert said.startswith("kernel: ")
    assert "\nsource: Mzyk 2009" in said
    assert "\nbandwidth" in said
    said = lab.hident("list", "estimators", "kernal", code=2).stderr
    assert said.startswith("error: no estimator is named 'kernal'")
    assert "kernel" in said


def test_validate_several_files_shows_all_errors_of_all(lab: Lab) -> None:
    fine = lab.hident("validate", "tiny.yaml").stdout
    assert fine == "tiny.yaml: fine: 2 cases, 4 estimates of 6 trials\n"
    lab.configure("one", trials=0, seed="x")
    lab.configure("two", trials=6, seed=1, title=None)
    said = lab.hident("validate", "tiny.yaml", "one.yaml", "two.yaml", "three.yaml", code=2)
    assert said.stdout == ""
    for text in ("one.yaml:", "trials", "seed", "two.yaml:", "title", "three.yaml"):
        assert text in said.stderr


def test_validate_looks_up_the_printed_numbers(done: Lab) -> None:
    printed = done.folder / "experiments/paper/published.csv"
    printed.write_text(printed.read_text().replace("N=80", "N=90"))
    assert done.hident("validate", "tiny.yaml", code=2).stderr == (
        "error: tiny.yaml:51: published.cells[0]: published.csv has no number for T / N=80 / a; "
        "did you mean 'T / N=90 / a'?\n"
    )
    printed.unlink()
    said = done.hident("validate", "tiny.yaml", code=2).stderr
    assert said.endswith("experiments/paper/published.csv: no such file\n")


def test_two_files_of_one_name_would_share_a_folder(lab: Lab) -> None:
    (lab.folder / "sub").mkdir()
    shutil.copy(lab.folder / "tiny.yaml", lab.folder / "sub")
    said = lab.hident("validate", "tiny.yaml", "sub/tiny.yaml", code=2).stderr
    assert "two files are named tiny, and the name is that of the output folder" in said


def test_schema_is_json(lab: Lab) -> None:
    schema = json.loads(lab.hident("schema").stdout)
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert "trials" in schema["properties"]


# Running


def test_what_a_run_writes(done: Lab) -> None:
    folder = done.folder / "out/tiny"
    assert sorted(path.name for path in folder.iterdir()) == [
        "run.json", "table.csv", "table.md", "timing.csv", "trials.csv.xz", "verdicts.csv"
    ]  # fmt: skip
    table = pd.read_csv(folder / "table.csv")
    assert ",".join(table.columns) == (
        "samples,estimator,metric,trials,failed,mean,std,se,median,q05,q25,q75,q95"
    )
    assert table["trials"].tolist() == [6] * 4
    run = json.loads((folder / "run.json").read_text())
    experiment, provenance = run["experiment"], run["provenance"]
    assert (experiment["config"], experiment["seed"], experiment["trials"]) == ("tiny", 7, 6)
    assert experiment["resolved"]["title"] == "Tiny"
    assert len(experiment["hash"]) == 32
    assert run["files"] == ["table.csv", "table.md", "trials.csv.xz", "verdicts.csv"]
    trials = pd.read_csv(folder / "trials.csv.xz")
    assert trials[["samples", "estimator", "metric"]].equals(table[["samples", "estimator", "metric"]])
    np.testing.assert_allclose(trials.iloc[:, 3:].mean(axis=1), table["mean"], rtol=1e-14, atol=1e-16)
    assert provenance["libraries"]["numpy"] == np.__version__
    assert {
        "hident",
        "python",
        "git_commit",
        "git_dirty",
        "cpu",
        "arithmetic",
        "platform",
    } <= provenance.keys()
    assert provenance["workers"] == 1
    # Outside of a repository there is no commit to name.
    assert provenance["git_commit"] is None


def _tick() -> None:
    """Turn the clock by a second whenever it is read."""
    time.perf_counter = map(float, itertools.count()).__next__


def test_the_seconds_of_each_phase_are_in_run_json(done: Lab) -> None:
    done.forget()
    done.run("-q", preexec_fn=_tick)
    provenance = json.loads((done.folder / "out/tiny/run.json").read_text())["provenance"]
    # As a trial takes more than a quarter of a second, each is a chunk; the clock is read before and after
    # it, and before and after each of its two fits.
    phases = {"records checked": 1, "trials": (2 + 2 * 2) * 12 + 1, "tables": 1, "figures": 1}
    assert provenance["seconds"] == phases


def test_rerun_does_nothing_and_a_title_rewrites_without_a_trial(done: Lab) -> None:
    trials = done.trials()
    before = {path for path in done.folder.rglob("*") if path.is_file()}
    for path in before:
        # A clock may stand for longer than a run takes.
        os.utime(path, (0, 0))
    rerun = done.hident("run", "tiny.yaml", "--jobs", "1")
    assert rerun.stderr == "tiny: out/tiny is up to date\n"
    assert rerun.stdout == (done.folder / "out/tiny/table.md").read_text() + "\n"
    after = {path: path.stat().st_mtime for path in done.folder.rglob("*") if path.is_file()}
    assert after == dict.fromkeys(before, 0.0)

    done.configure(title="Another title", tables={})
    said = done.run()
    assert said.splitlines() == ["tiny: all 24 trials are stored", "tiny: wrote out/tiny"]
    assert "# Another title" in (done.folder / "out/tiny/table.md").read_text()
    assert done.trials() == trials


def test_one_trial_is_no_trials_in_any_output(lab: Lab) -> None:
    lab.configure(trials=1, cases={}, samples=50, formats=["png", "tex"], tables={}, figures={})
    spare = yaml.safe_load((lab.folder / "tiny.yaml").read_text())
    only = f"--set=estimators.{next(iter(spare['estimators']))}=null"
    said = ""
    for verb in (
        ["validate", "tiny.yaml"],
        ["run", "tiny.yaml", "--jobs", "1", "--log", "log.jsonl"],
        ["run", "tiny.yaml", "--jobs", "1", "--out", "again"],
        ["status", "tiny.yaml"],
        ["show", "out/tiny"],
        ["show", "out"],
        ["export", "tiny.yaml", "a.csv"],
        ["validate", "tiny.yaml", only],
    ):
        done = lab.hident(*verb)
        said += done.stdout + done.stderr
    written = [*(lab.folder / "out/tiny").glob("*.md"), *(lab.folder / "out/tiny").glob("*.tex")]
    said += "".join(path.read_text() for path in [*written, lab.folder / "log.jsonl"])
    assert "1 trial" in said
    assert not re.findall(r"(?<![\d.,/])1 (?:trials|cases|estimates|rows|runs|samples)\b.*", said)


def test_an_altered_or_missing_output_is_written_again(done: Lab) -> None:
    before = done.table
    (done.folder / "out/tiny/table.csv").write_bytes(before + b"\n")
    (done.folder / "out/tiny/table.md").unlink()
    assert "altered" in done.hident("status", "tiny.yaml").stdout
    assert "all 24 trials are stored" in done.run()
    assert done.table == before


@pytest.mark.parametrize(
    ("old", "new"), [('"title": "Tiny"', '"title": "Big"'), ('"workers": 1', '"workers": 9')]
)
def test_an_altered_run_json_is_written_again(done: Lab, old: str, new: str) -> None:
    file = done.folder / "out/tiny/run.json"
    before = file.read_text()
    assert old in before
    file.write_text(before.replace(old, new))
    assert "altered" in done.hident("status", "tiny.yaml").stdout
    assert "wrote out/tiny" in done.run()
    assert old in file.read_text()


def test_files_of_an_earlier_run_are_removed_and_others_are_not(done: Lab) -> None:
    folder = done.folder / "out/tiny"
    (folder / "crashes.txt").touch()
    (folder / "mine.txt").touch()
    done.configure(tables={})
    done.run("-q")
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["mine.txt", "run.json", "table.csv", "table.md", "timing.csv", "trials.csv.xz"]


def test_failed_estimates_are_counted_shown_and_left_out_of_the_mean(lab: Lab) -> None:
    lab.probe("""
        value = 2.0
        if record.u[0] > 3:
            raise EstimationError("diverged")
        if record.u[0] > 1:
            np.linalg.inv(np.zeros((2, 2)))
        if record.u[0] > 0:
            value = np.nan
    """)
    column = {"estimator": "probe", "metric": "a a_1"}
    lab.configure(
        trials=20, tables={"a": {"kind": "grid", "title": "A", "rows": "samples", "columns": [column]}}
    )
    lab.run()
    probe = pd.read_csv(lab.folder / "out/tiny/table.csv").query("estimator == 'probe'")
    assert probe["failed"].between(4, 16).all()
    assert (probe["mean"] == 2.0).all()
    text = (lab.folder / "out/tiny/table.md").read_text()
    for samples, failed in zip(probe["samples"], probe["failed"], strict=True):
        assert f"{failed} of 20 trials of estimator 'probe' at samples {samples} failed" in text
    lab.hident("export", "tiny.yaml", "trials.csv")
    trials = pd.read_csv(lab.folder / "trials.csv").query("estimator == 'probe'")
    assert set(trials["failure"].dropna()) == {"diverged", "Singular matrix"}
    assert trials["value"].isna().sum() == probe["failed"].sum()
    (lab.folder / "out/tiny/run.json").unlink()
    assert "all 80 trials are stored" in lab.run()


def test_means_that_hang_on_a_trial_are_said_in_the_table_too(lab: Lab) -> None:
    lab.probe("value = 1.0 + 1e-3 * record.u[0]")
    lab.configure(trials=25)
    assert "hang" not in lab.run()
    calm = (lab.folder / "out/tiny/table.md").read_text()
    lab.probe("value = float(np.exp(30.0 * record.u[0]))")
    lab.configure(trials=25)
    said = lab.run()
    assert "means hang on a single trial each (the first: a a_1 of estimator 'probe' at samples" in said
    assert "% of the sum of squares); table.csv has the medians" in said
    assert "hang" not in calm
    assert "means hang on a single trial each" in (lab.folder / "out/tiny/table.md").read_text()
    lab.probe("value = float(np.exp(31.0 * record.u[0]))")
    lab.configure(trials=25)
    assert lab.run("-q") == ""


def test_a_changed_estimator_reruns_itself_and_nothing_else(lab: Lab) -> None:
    system = lab.config["system"]
    lab.probe("value *= 2  # twice")
    # Not the plugin's own system, which would change with it.
    lab.configure(system=system)
    lab.run("-q")
    lab.probe("value *= 2  # a comment")
    lab.configure(system=system)
    assert "is up to date" in lab.run()
    lab.probe("value *= 3  # a comment")
    lab.configure(system=system)
    assert "24 trials, 12 of them stored" in lab.run()


def test_options_override_the_file(lab: Lab) -> None:
    places = ("--out", "o", "--store", "s")
    lines = lab.run("--trials", "2", "--seed", "9", "--set", "cases.samples=[60]", *places).splitlines()
    assert lines[0] == "tiny: 4 trials"
    assert lines[1].startswith("tiny: 4/4 trials done, ")
    assert lines[2:] == ["tiny: wrote o/tiny"]
    run = json.loads((lab.folder / "o/tiny/run.json").read_text())
    assert (run["experiment"]["seed"], run["experiment"]["trials"]) == (9, 2)
    assert pd.read_csv(lab.folder / "o/tiny/table.csv")["samples"].tolist() == [60, 60]
    assert (lab.folder / "s/trials.sqlite").exists()


def test_a_terminal_has_a_bar(done: Lab) -> None:
    done.forget()
    mine, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    with Path(os.devnull).open("wb") as nowhere, os.fdopen(theirs, "wb") as terminal:
        process = Forked(["run", "tiny.yaml", "-j1"], done.folder, nowhere, terminal, environment)
    shown = b""
    while True:
        try:
            shown += os.read(mine, 4096)
        except OSError:
            break
    os.close(mine)
    assert process.wait() == 0
    for text in (b"tiny: 24 trials", b"24/24", b"trials/s", b"tiny: wrote out/tiny"):
        assert text in shown


def test_lines_in_a_log_have_the_rate_and_the_time_left(capsys: pytest.CaptureFixture[str]) -> None:
    now = 0.0
    lines = Lines("tiny", clock=lambda: now)
    lines.start(100, 20)
    now = 1.0
    lines.advance(0)  # all of a chunk crashed
    lines.advance(2)
    now = 11.0
    lines.advance(20)
    now = 12.0
    lines.advance(8)
    lines.finish()
    assert capsys.readouterr().err.splitlines() == [
        "tiny: 100 trials, 20 of them stored",
        "tiny: 42/100 trials, 2 trials/s, 29 s left",
        "tiny: 50/100 trials done, 12.0 s",
    ]


def test_a_figure_that_cannot_be_drawn_withholds_nothing_else(lab: Lab) -> None:
    curve = {
        **{"kind": "curve", "x": "samples", "metric": "a a_1", "y_label": "e", "panels": [["iv"]]},
        "x_label": r"$\foo$",
    }
    lab.configure(figures={"f": curve})
    for _ in range(2):
        said = lab.run("--quiet", code=1)
        assert said.startswith("error: tiny.yaml: figures.f: cannot be drawn (")
        assert said.endswith("); all other outputs are written\n")
    assert {path.name for path in (lab.folder / "out/tiny").iterdir()} == {
        *("run.json", "table.csv", "table.md", "timing.csv", "trials.csv.xz")
    }
    assert "incomplete" in lab.hident("status", "tiny.yaml").stdout
    refused = lab.hident("accept", "tiny", code=2).stderr
    assert refused == "error: out/tiny lacks f.png, which could not be drawn: hident run tiny\n"
    lab.configure(figures={"f": {**curve, "x_label": "N"}})
    lab.run("--quiet")
    assert (lab.folder / "out/tiny/f.png").exists()


# What is stored


def test_status(done: Lab) -> None:
    done.configure("other", trials=8)
    done.configure("third", trials=6, title="Another")
    shutil.copytree(done.folder / "out/tiny", done.folder / "out/third")
    lines = done.hident("status", "tiny.yaml", "other.yaml", "third.yaml").stdout.splitlines()
    assert [line.split(maxsplit=3) for line in lines[1:4]] == [
        ["tiny", "24", "24", "up to date"],
        ["other", "24", "32", "none"],
        ["third", "24", "24", "old"],
    ]
    assert lines[4] == ".hident/trials.sqlite: 24 scores in all"
    assert "there is no configuration under configs/ here" in done.hident("status", code=2).stderr


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_exported_trials_have_the_means_of_the_table(done: Lab, suffix: str) -> None:
    said = done.hident("export", "tiny.yaml", f"trials.{suffix}").stdout
    assert said == f"trials.{suffix}: 24 rows of 24 trials\n"
    file = done.folder / f"trials.{suffix}"
    trials = pd.read_csv(file) if suffix == "csv" else pd.read_parquet(file)
    assert list(trials.columns) == ["samples", "estimator", "trial", "metric", "value", "failure"]
    means = trials.astype({"samples": int}).groupby(["samples", "estimator"])["value"].mean()
    table = pd.read_csv(done.folder / "out/tiny/table.csv").set_index(["samples", "estimator"])["mean"]
    np.testing.assert_allclose(means.loc[table.index], table, rtol=1e-14, atol=1e-16)


def test_export_of_an_unknown_kind_and_of_a_part(done: Lab) -> None:
    said = done.hident("export", "tiny.yaml", "trials.xls", code=2).stderr
    assert said == "error: trials.xls: the name must end in .csv or .parquet\n"
    said = done.hident("export", "tiny.yaml", "none/trials.csv", code=2).stderr
    assert said.startswith("error: none/trials.csv cannot be written: ")
    said = done.hident("export", "tiny.yaml", "trials.csv", "--trials", "8").stdout
    assert said == "trials.csv: 24 rows of 24 trials; 8 trials are not computed yet (hident run)\n"


# Results and the ledger


def test_only_accept_changes_results_and_compare_finds_any_change(done: Lab) -> None:
    results = done.folder / "results"
    assert "there is no folder results" in done.hident("compare", code=4).stderr
    first = done.hident("accept", "tiny", "-j1")
    assert first.stdout == "tiny: new\n"
    assert "tiny, perturbation 1 of 2: 24 trials\n" in first.stderr
    assert "tiny, perturbation 2 of 2: 24/24 trials done" in first.stderr
    accepted = {path.name: path.read_bytes() for path in (results / "tiny").iterdir()}
    out = done.folder / "out/tiny"
    copied = {path.name: path.read_bytes() for path in out.iterdir()}
    assert {*accepted} == {*copied, "sensitivity.csv"}
    assert all(accepted[name] == copied[name] for name in copied if name != "run.json")
    sensitivity = pd.read_csv(results / "tiny/sensitivity.csv")
    assert list(sensitivity.columns) == ["samples", "estimator", "trials", "perturbed", "moved"]
    assert sensitivity["perturbed"].tolist() == [12] * 4

    assert done.hident("compare").stdout == "out against results: 1 configuration, no differences\n"
    table = (out / "table.csv").read_text()
    *rows, last = table.splitlines(keepends=True)
    for changed in (table.replace(last, last.replace(",6,0,", ",6,1,")), "".join(rows)):
        assert changed != table
        (out / "table.csv").write_text(changed)
        assert "tiny/table.csv: altered since it was written" in done.hident("compare", code=1).stdout
    (out / "table.csv").write_text(table)
    (out / "table.md").rename(out / "extra.md")
    assert "3 differences\n" in done.hident("compare", code=1).stdout
    refused = done.hident("accept", "tiny", code=2).stderr
    assert refused.startswith("error: out/tiny lacks table.md, which its run.json lists: hident run tiny")

    done.run("-q", "--trials", "3")
    assert {path.name: path.read_bytes() for path in (results / "tiny").iterdir()} == accepted
    assert "tiny: 3 trials, reference 6: --partial compares those of both" in (
        done.hident("compare", code=1).stdout
    )
    assert done.hident("compare", "--partial").stdout.endswith("no differences\n")
    refused = done.hident("accept", "tiny", code=2).stderr
    assert refused == (
        "error: out/tiny is not what tiny.yaml gives now: hident run tiny, or repeat here the --set, "
        "--trials, --seed and --format of that run\n"
    )
    # The perturbed trials are stored.
    second = done.hident("accept", "tiny", "--trials", "3")
    assert second.stdout.startswith("tiny: changed, ")
    assert "tiny, perturbation 2 of 2: all 12 trials are stored" in second.stderr
    assert done.hident("accept", "none", code=4).stderr.startswith("error: out/none holds no finished run")


def test_verify_wants_a_reason_for_every_difference(done: Lab) -> None:
    assert "every difference has its reason" in done.hident("verify").stdout
    (done.folder / "experiments/paper/reasons.yaml").unlink()
    said = done.hident("verify", code=1).stdout
    assert "differs without a reason: tiny: T / N=80 / a: printed 9.9, ours " in said
    shutil.rmtree(done.folder / "out")
    assert "holds no verdicts.csv" in done.hident("verify", code=4).stderr


# The program itself


@pytest.mark.parametrize("verb", _VERBS)
def test_help_of_every_verb(verb: str) -> None:
    shown = CliRunner().invoke(app, [verb, "--help"])
    assert shown.exit_code == 0
    assert shown.output.startswith("Usage: ")


def test_version() -> None:
    shown = CliRunner().invoke(app, ["--version"])
    assert (shown.exit_code, shown.output) == (0, f"hident {hident.__version__}\n")


def test_help_has_a_short_name() -> None:
    long, short = (CliRunner().invoke(app, ["run", name]) for name in ("--help", "-h"))
    assert short.output == long.output


def test_help_names_the_verbs_in_full_and_the_exit_codes(lab: Lab) -> None:
    shown = lab.hident("--help").stdout
    verbs = shown.split("Commands:\n")[1].split("\n\n")[0].splitlines()
    assert [line.split()[0] for line in verbs] == list(_VERBS)
    assert all(line.endswith(".") and not line.endswith("...") for line in verbs)
    assert "130" in shown


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "Usage: "),
        (("frobnicate",), "No such command 'frobnicate'"),
        (("list", "unicorns"), "'what': 'unicorns' cannot be listed (there are: estimators, systems, "),
        (("list", "estimator"), "'estimator' cannot be listed; did you mean 'estimators'? (there are: "),
        (("list", "configs", "none"), "error: none: no such file"),
        (("run", "tiny.yaml", "--store", "tiny.yaml"), "error: tiny.yaml is not a folder"),
        (("run", "tiny.yaml", "--jobs", "0"), "Invalid value for '--jobs'"),
        (("run",), "Missing argument"),
        (("run", "tiny.yaml", "--seed", "-1"), "seed"),
        (("run", "tiny.yaml", "--plugin", "none.py"), "none.py"),
    ],
)
def test_wrong_arguments(lab: Lab, arguments: tuple[str, ...], said: str) -> None:
    done = lab.hident(*arguments, code=2)
    assert said in done.stdout + done.stderr


def test_a_reader_that_goes_away_is_no_error(lab: Lab) -> None:
    command = f"set -o pipefail; {sys.executable} -m hident schema | head -n 1"
    done = subprocess.run(
        ["bash", "-c", command], cwd=lab.folder, capture_output=True, text=True, check=False
    )
    assert (done.stdout, done.stderr) == ("{\n", "")
    # The code says what was found, whoever reads it.
    assert done.returncode == 0


# Alternatives


def test_alternatives_are_run_accepted_and_change_the_verdicts(done: Lab) -> None:
    """A number agrees once some alternative is known that would not give it."""
    paper = done.folder / "experiments/paper"
    alternatives = {"far": {"metrics.a.kind": "value"}, "near": {"statistic": "median"}}
    done.configure(paper="paper", published=_PUBLISHED, alternatives=alternatives)
    table = pd.read_csv(done.folder / "out/tiny/table.csv").set_index(["samples", "estimator"])
    near = f"{float(table['mean'].loc[80, 'iv']) * 1.0001:.6f}"
    (paper / "published.csv").write_text(
        f"table,row,quantity,printed,note\nT,N=50,a,0.0,\nT,N=80,a,{near},\n"
    )

    def verdicts() -> list[tuple[str, int, int]]:
        rows = pd.read_csv(done.folder / "out/tiny/verdicts.csv")
        return [*rows[["verdict", "excluded", "alternatives"]].itertuples(index=False, name=None)]

    (paper / "reasons.yaml").write_text("reasons: []\n")
    done.run()
    assert verdicts()[1] == ("untestable", 0, 0)
    owed = done.hident("verify", code=1).stdout
    assert (
        "not up to date: tiny: none are accepted: hident power tiny, then hident accept --power tiny" in owed
    )
    shown = done.hident("power", "tiny.yaml", "--jobs", "1", "--trials", "5").stdout
    assert "## T: mutation score" in shown
    assert "| far " in shown
    done.configure(title="Other")
    nothing = done.hident("accept", "--power", "tiny.yaml", "--out", "nowhere", code=4).stderr
    assert "hident power tiny" in nothing
    done.configure(title="Tiny", seed=3)
    assert "is not of tiny.yaml as it is now" in done.hident("accept", "--power", "tiny.yaml", code=2).stderr
    done.configure(seed=7)
    assert done.hident("accept", "--power", "tiny.yaml").stdout == "tiny: new\n"
    assert "the run did not know them: hident run tiny" in done.hident("verify", code=1).stdout
    assert "no difference" in done.hident("compare", "out/power", "results/power").stdout
    done.run()
    assert verdicts()[1] == ("agrees", 1, 2)
    state = json.loads(done.hident("verify", "--json").stdout)
    (table,) = state["tables"]
    assert (table["tried"], table["counts"]) == (2, {"agrees": 2})
    assert state["not up to date"] == []
    # What was run for another configuration says nothing of this one.
    done.configure(seed=5)
    done.run()
    assert verdicts()[1][1:] == (0, 0)
    assert "were run for another configuration" in done.hident("verify", code=1).stdout


def test_alternatives_that_cannot_be_run_are_refused_before_anything_is_run(done: Lab) -> None:
    alternatives = {"far": {"system.linear.b": [0.9]}, "nowhere": {"estimators.*.lag": 3}}
    done.configure(paper="paper", published=_PUBLISHED, alternatives=alternatives)
    said = done.hident("validate", "tiny.yaml", code=2).stderr
    assert "alternatives.nowhere.estimators.*.lag: leads nowhere" in said
    assert "unknown key" in said
    assert said == done.hident("power", "tiny.yaml", code=2).stderr
    done.configure(alternatives={})
    assert "has 'alternatives'" in done.hident("power", "tiny.yaml", code=4).stderr


def test_at_most_so_many_trials_of_each_configuration(lab: Lab) -> None:
    lab.configure("more", trials=9)
    lab.configure("fewer", trials=2)
    lab.hident("run", "more.yaml", "fewer.yaml", "--at-most", "4", "--jobs", "1", "--quiet")
    found = {
        name: json.loads((lab.folder / f"out/{name}/run.json").read_text()) for name in ("more", "fewer")
    }
    assert {name: run["experiment"]["trials"] for name, run in found.items()} == {"more": 4, "fewer": 2}
    assert lab.hident("run", "more.yaml", "--at-most", "0", code=2).returncode == 2
