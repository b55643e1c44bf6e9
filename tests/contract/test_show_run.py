"""hident show for folders of results: what is printed of a run, and of many."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hident.commands import shown_run
from hident.commands.results_folders import list_runs
from hident.commands.shown_run import show_results
from hident.commands.sparkline import BARS, MARK, sparkline
from hident.engine.run_files import PAGE, RUN, TRIALS, VERDICTS
from hident.errors import NothingToCompare
from hident.ledger.judged import verdict_rows
from tests.accepted import RESULTS, ROOT
from tests.forked import run_forked

RUNS = sorted(path.parent.name for path in RESULTS.glob(f"*/{RUN}"))
ESCAPE = "\x1b["


@pytest.fixture(autouse=True)
def _no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("FORCE_COLOR", "NO_COLOR", "TTY_COMPATIBLE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("COLUMNS", "100")


def _shown(capsys: pytest.CaptureFixture[str], path: Path) -> str:
    show_results(path, RESULTS)
    return capsys.readouterr().out


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A copy of an accepted run."""
    return Path(shutil.copytree(RESULTS / "mzyk_table1", tmp_path / "results/mzyk_table1"))


def _changed(run: Path, **changes: Any) -> None:
    content = json.loads((run / RUN).read_text())
    content["experiment"] |= changes
    (run / RUN).write_text(json.dumps(content))


# A run


@pytest.mark.parametrize("name", RUNS)
def test_every_accepted_run_is_shown_as_wide_as_the_terminal(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    wide = _shown(capsys, RESULTS / name)
    monkeypatch.setenv("COLUMNS", "60")
    narrow = _shown(capsys, RESULTS / name)
    for width, text in ((100, wide), (60, narrow)):
        assert max(map(len, text.splitlines())) <= width
        assert ESCAPE not in text
        assert f"{RESULTS / name}: fine" in text.replace("\n", "")
    assert wide.startswith(f"{name}: ")
    assert f"\n  hident run {name}\n" in wide
    file, lines = RESULTS / name / VERDICTS, wide.splitlines()
    for row in verdict_rows(file) if file.exists() else ():
        found = [
            # Where a line is too short, the number stands on the next one.
            f"{line} {after}"
            for line, after in pairwise(lines)
            if line.startswith(f"{row['row']} / {row['quantity']} ")
        ]
        assert any(f" {row['printed']} " in line and f" {row['verdict']} " in line for line in found)


def test_a_printed_number_stands_beside_ours_with_its_trials(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    lines = _shown(capsys, RESULTS / "mzyk_table1").splitlines()
    place = lines.index("Table I: joint p 0.035; alternatives rejected: 8 of 18, and ours")
    found = next(line for line in lines[place:] if line.startswith("N=3000 / MISE kernel (4) "))
    assert re.split(r"\s{2,}", found)[1:5] == ["4.42", "! differs", "2.807 [2.245, 3.528]", "0 of 13"]
    # It lies beyond all trials.
    assert found.endswith(f" {MARK}") and set(found.split("%  ")[1]) <= {*BARS, " ", MARK}
    within = next(line for line in lines if line.startswith("N=50 / MISE kernel (4) "))
    assert within.split("%  ")[1].strip(MARK) and MARK in within.split("%  ")[1][1:-1]
    text = "\n".join(lines)
    assert "Differs: The printed column falls more slowly than h ~ N^-1/5 allows" in text
    assert "figures in" in text and "mise.png, realisation.png" in text
    assert text.endswith(
        "  hident run mzyk_table1\n  hident show mzyk_table1 --trial 0\n  hident power mzyk_table1"
    )


def test_tables_are_those_of_the_page(capsys: pytest.CaptureFixture[str]) -> None:
    lines = [
        re.split(r"\s{2,}", line.strip()) for line in _shown(capsys, RESULTS / "mzyk_table1").splitlines()
    ]
    assert ["3000", "2.81", "4.42 !", "0.269", "0.22 ?", "2.69", "4.87 !", "1.34", "1.25 ~"] in lines
    # A note is not said again.
    said = [line for line in lines if line[0].startswith("Beside ours, the printed number")]
    assert len(said) == 1


def test_failures_are_shown_with_their_reasons(capsys: pytest.CaptureFixture[str]) -> None:
    text = " ".join(_shown(capsys, RESULTS / "chen_example4").split())
    assert (
        "3 of 120 trials of estimator 'Wiener' at q_b 13.5 failed (no pair of partition points gives a "
        "stable linear block and rising segments)"
    ) in text


def test_failures_stand_by_their_reasons_with_their_cases(
    run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "failures" not in [line.strip() for line in _shown(capsys, run).splitlines()]
    content = json.loads((run / RUN).read_text())
    no_root = {"reason": "no root", "trials": 1}
    of: dict[str, Any] = {"estimator": "kernel (4)", "failed": 3, "trials": 200, "reasons": [no_root]}
    content["failures"] = [
        {**of, "at": {"samples": str(n)}, "reasons": [{"reason": "singular", "trials": 2}, no_root]}
        for n in range(12)
    ]
    content["failures"].append({**of, "at": {}, "metrics": ["mise", "error"]})
    (run / RUN).write_text(json.dumps(content))
    lines = _shown(capsys, run).splitlines()
    said = lines[lines.index("failures") :]
    # The most frequent reason stands first.
    assert said[1] == "24 times: singular"
    assert said[2] == "  2 of 200, estimator kernel (4), samples 0"
    assert said[12] == "  and 2 more cases: run.json has all"
    assert said[13] == "13 times: no root"
    monkeypatch.setattr(shown_run, "_MOST_REASONS", 1)
    monkeypatch.setattr(shown_run, "_MOST_CASES", 20)
    said = _shown(capsys, run).splitlines()
    assert "and 1 more reasons: run.json has all" in said
    monkeypatch.setattr(shown_run, "_MOST_REASONS", 2)
    assert "  1 of 200, estimator kernel (4): mise, error" in _shown(capsys, run).splitlines()


def test_verdicts_have_colours_in_a_terminal_and_none_where_these_are_not_wanted(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = _shown(capsys, RESULTS / "mzyk_table1")
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    coloured = _shown(capsys, RESULTS / "mzyk_table1")
    assert "4.42 \x1b[1;31m!\x1b[0m" in coloured and "37.37 \x1b[36m~\x1b[0m" in coloured
    monkeypatch.setenv("NO_COLOR", "1")
    without = _shown(capsys, RESULTS / "mzyk_table1")
    assert not re.search(r"\x1b\[[\d;]*3[1-7]", without)
    for text in (coloured, without):
        assert re.sub(r"\x1b\[[\d;]*m", "", text) == plain


def test_letters_that_the_stream_does_not_have_are_not_used() -> None:
    ended = subprocess.run(
        [sys.executable, "-m", "hident", "show", "results/mzyk_table1"],
        cwd=ROOT,
        env={**os.environ, "PYTHONIOENCODING": "ascii", "COLUMNS": "100"},
        capture_output=True,
        check=True,
    )
    text = ended.stdout.decode("ascii")
    found = next(line for line in text.splitlines() if line.startswith("N=3000 / MISE kernel (4) "))
    assert found.endswith(" |") and "\\u" not in found


def test_what_would_steer_a_terminal_is_only_text(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (run / PAGE).read_text()
    title = "[red]\x1b[2J<script>\\u{} C:\\new 'quoted'"
    (run / PAGE).write_text(text.replace("The same trials:", title))
    said = _shown(capsys, run)
    assert "[red]?[2J<script>\\u{} C:\\new 'quoted'" in said and ESCAPE not in said


def test_of_a_long_table_the_first_rows_are_printed(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    row = "| 3000 | 2.81 |  4.42 ! | 0.269 |  0.22 ? | 2.69 |  4.87 ! | 1.34 |  1.25 ~ |\n"
    text = (run / PAGE).read_text()
    assert row in text
    (run / PAGE).write_text(text.replace(row, 10_000 * row, 1))
    lines = _shown(capsys, run).splitlines()
    assert "and 9505 more rows: table.md has all" in lines
    assert sum(line.startswith("3000 ") for line in lines) < 600


def test_the_same_run_again_names_what_it_ran(
    run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    _changed(run, trials=12, seed=3)
    assert "\n  hident run mzyk_table1 --trials 12 --seed 3\n" in _shown(capsys, run)


# The state of a run


def test_what_is_not_as_it_was_written_is_said(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (run / VERDICTS).write_text((run / VERDICTS).read_text().replace("37.37", "31.37"))
    assert f"altered: {VERDICTS}" in _shown(capsys, run).replace("\n", "")
    (run / TRIALS).unlink()
    said = _shown(capsys, run)
    # Nothing stands behind the numbers any more, and they are shown.
    assert MARK not in said.replace(f"{MARK} stands", "") and "N=3000 / MISE kernel (4)" in said


@pytest.mark.parametrize(
    ("write", "state"),
    [
        ({RUN: "{"}, f"{RUN} is broken"),
        ({RUN: None}, "not finished"),
        ({RUN: None, "crashes.txt": "Traceback"}, "crashed"),
    ],
)
def test_a_run_that_is_not_whole_is_named_so(
    run: Path, capsys: pytest.CaptureFixture[str], write: dict[str, str | None], state: str
) -> None:
    for name, text in write.items():
        (run / name).unlink(missing_ok=True)
        if text is not None:
            (run / name).write_text(text)
    assert state in " ".join(_shown(capsys, run).split())
    list_runs([run.parent])
    row = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("mzyk_table1 "))
    assert state in row


# Many runs


def test_runs_of_several_folders_are_listed_once(
    tmp_path: Path, run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("mzyk_table1", "wang_table1"):
        shutil.copytree(RESULTS / name, tmp_path / "out" / name)
    shutil.copytree(RESULTS / "power", tmp_path / "out/power")
    list_runs([Path("out"), Path("results")])
    lines = capsys.readouterr().out.splitlines()
    header, first, second, last = (re.split(r"\s{2,}", line.strip()) for line in lines)
    assert header == ["run", "trials", "printed numbers", "out", "results", "trials alike"]
    made = json.loads((run / RUN).read_text())["provenance"]["finished"][:10]
    assert first == ["mzyk_table1", "200", "15 ~, 6 ?, 3 !", f"fine {made}", f"fine {made}", "yes"]
    assert second[:3] == ["wang_table1", "100", "45 ="] and second[4:] == ["-", "-"]
    assert last == [
        "2 runs. = exact, ~ agrees, ? untestable, ! differs. One of them: hident show out/mzyk_table1"
    ]


def test_no_run_at_all_is_nothing(tmp_path: Path) -> None:
    with pytest.raises(NothingToCompare, match=r"there is no run in .*: hident run CONFIG"):
        list_runs([tmp_path / "out", tmp_path])


# Arguments


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (
            ("results/mzyk_tabel1",),
            2,
            "results/mzyk_tabel1: there is no such run; did you mean 'mzyk_table1'? (hident show results "
            "lists them)",
        ),
        (
            ("results/mzyk_table1", "--trial", "3"),
            2,
            "results/mzyk_table1 is a folder of results, and --trial is for configurations and measured "
            "records",
        ),
        (
            ("--worst", "mise"),
            2,
            "no file is named, and --worst is for configurations and measured records",
        ),
        (("empty",), 4, "there is no run in empty: hident run CONFIG"),
    ],
)
def test_arguments(tmp_path: Path, run: Path, arguments: tuple[str, ...], code: int, said: str) -> None:
    (tmp_path / "empty").mkdir()
    ended = run_forked(("show", *arguments), tmp_path)
    assert (ended.returncode, ended.stdout, ended.stderr) == (code, "", f"error: {said}\n")


def test_without_an_argument_the_runs_are_listed(tmp_path: Path, run: Path) -> None:
    ended = run_forked(("show",), tmp_path)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert ended.stdout.splitlines()[1].split()[:2] == ["mzyk_table1", "200"]


# Histograms


def test_a_histogram_counts_every_trial() -> None:
    values = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 2.0, np.nan])
    assert sparkline(values, 3) == ("█▂▄  ", "", "")
    assert sparkline(values, 3, -1.0) == ("", MARK, " █▂▄")
    assert sparkline(np.append(values, 1e9), 3)[0].startswith("█")
    assert sparkline(np.full(3, np.nan), 4) == ("      ", "", "")


@pytest.mark.parametrize(("printed", "parts"), [(7.01, (" █", MARK, "  ")), (7.1, (" █  ", MARK, ""))])
def test_of_equal_values_the_printed_number_is_at_or_beside_them(
    printed: float, parts: tuple[str, str, str]
) -> None:
    assert sparkline(np.full(5, 7.0), 3, printed, slack=0.05) == parts
