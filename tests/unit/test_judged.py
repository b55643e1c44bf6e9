"""The verdicts in a folder of results, and the trials that stand behind each."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from hident.engine.results import statistics
from hident.engine.run_files import TRIALS, VERDICTS
from hident.errors import ConfigError
from hident.ledger.judged import Judged, by_table, judged
from hident.ledger.trial_values import TrialValues
from tests.accepted import RESULTS

JUDGED = sorted(path.parent.name for path in RESULTS.glob(f"*/{VERDICTS}"))


def _read(folder: Path) -> tuple[tuple[Judged, ...], TrialValues]:
    values = TrialValues.decoded((folder / TRIALS).read_bytes())
    resolved = json.loads((folder / "run.json").read_bytes())["experiment"]["resolved"]
    return judged(folder / VERDICTS, resolved, values), values


@pytest.mark.parametrize("config", JUDGED)
def test_behind_each_accepted_number_stand_the_trials_whose_statistic_it_is(config: str) -> None:
    found, values = _read(RESULTS / config)
    for one in found:
        assert one.series is not None and one.statistic is not None
        assert statistics(values.series[one.series])[one.statistic] == pytest.approx(one.ours, rel=1e-15)
    with (RESULTS / config / VERDICTS).open(newline="") as file:
        rows = [*csv.DictReader(file)]
    assert [one.key for one in found] == [(row["table"], row["row"], row["quantity"]) for row in rows]
    assert [(one.word, one.reason) for one in found] == [(row["verdict"], row["reason"]) for row in rows]
    assert sum(map(len, by_table(found).values())) == len(rows)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in (VERDICTS, TRIALS, "run.json"):
        shutil.copy(RESULTS / "mzyk_table1" / name, tmp_path)
    return tmp_path


def _write(folder: Path, lines: list[str]) -> None:
    (folder / VERDICTS).write_text("\n".join(lines) + "\n")


def test_of_rows_in_another_order_nothing_is_said_to_stand_behind_any(folder: Path) -> None:
    header, first, second, *rest = (folder / VERDICTS).read_text().splitlines()
    _write(folder, [header, second, first, *rest])
    found, _ = _read(folder)
    assert {one.series for one in found} == {None}
    assert [one.printed.row for one in found][:2] == ["N=100", "N=50"]


def test_without_the_trials_the_verdicts_are_read_all_the_same(folder: Path) -> None:
    found = judged(folder / VERDICTS, {}, None)
    assert (len(found), {one.series for one in found}) == (24, {None})
    assert found[5].word == "differs" and np.isnan(judged(folder / VERDICTS, {}, None)[0].joint) == 0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("agrees", "agree"), "holds the verdict 'agree' (allowed: exact, agrees, untestable, differs)"),
        (("flips", "flip"), "lacks columns"),
        ((",2,13,1 10,", ",two,13,1 10,"), "cannot be read (invalid literal for int()"),
        ((",37.37,", ",some,"), "cannot be read (could not convert string to float: 'some'"),
    ],
)
def test_what_is_no_verdict_is_refused(folder: Path, change: tuple[str, str], said: str) -> None:
    text = (folder / VERDICTS).read_text()
    assert change[0] in text
    (folder / VERDICTS).write_text(text.replace(*change, 1))
    with pytest.raises(ConfigError) as error:
        _read(folder)
    assert str(error.value).startswith(f"{folder / VERDICTS} {said}")
    assert str(error.value).endswith("run the configuration again")


def test_an_axis_that_does_not_touch_what_stands_beside_a_number_does_not_count(folder: Path) -> None:
    header, first, *_ = (folder / VERDICTS).read_text().splitlines()
    _write(folder, [header, first])
    values = TrialValues(("samples", "noise"), {("50", "", "iv", "a"): np.zeros(3)})
    cell = {
        "table": "Table I",
        "row": "N={samples}",
        "quantities": {"MISE kernel (4)": "a"},
        "estimator": "iv",
        "at": {"samples": 50, "noise": 0.1},
    }
    [found] = judged(folder / VERDICTS, {"published": {"cells": [cell]}}, values)
    assert (found.series, found.statistic) == (("50", "", "iv", "a"), "mean")
    [none] = judged(folder / VERDICTS, {"published": {"cells": [{**cell, "at": {"samples": 80}}]}}, values)
    assert none.series is None
