"""What the accepted verdicts can tell: the table in README.md, and that no score has fallen unseen."""

import csv
import math
import re
from pathlib import Path

import pytest

from hident import plugins
from hident.engine.alternatives import alternative_plans
from hident.engine.experiment import load
from hident.ledger.verdicts import LEVEL
from hident.ledger.verify import verify
from tests.accepted import ROOT

CONFIGS = sorted(
    path
    for path in (ROOT / "configs").glob("*.yaml")
    if re.search(r"^published:", path.read_text(encoding="utf-8"), re.MULTILINE)
)
COLUMNS = ("numbers", "exact", "agrees", "wide", "untestable", "differs", "joint p", "mutation score")
RIGHT = " | ".join(["---:"] * len(COLUMNS))
HEADER = f"| table | configuration | {' | '.join(COLUMNS)} |\n| --- | --- | {RIGHT} |\n"
PAPERS = {"mzyk": "Mzyk", "wang": "Wang", "chen": "Chen", "brouri": "Brouri"}
WORDS = ("exact", "agrees", "untestable", "differs")


@pytest.fixture(scope="module")
def state():
    return verify(ROOT / "results", ROOT / "experiments")


def shown(table):
    counts = [table.counts.get(word, 0) for word in WORDS]
    numbers = sum(counts)
    counts.insert(2, table.wide)
    p = "-" if math.isnan(table.joint_p) else f"{table.joint_p:.2g}"
    paper = PAPERS[table.config.partition("_")[0]]
    cells = (f"{paper}, {table.table}", f"`{table.config}`", numbers, *counts, p)
    return f"| {' | '.join(map(str, cells))} | {table.score} |\n"


def _power(table):
    """What its score is worth: nothing where the table rejects our own reading too."""
    return -1.0 if table.joint_p < LEVEL else table.rejected / max(table.tried, 1)


def ledger(tables):
    """The table of README.md: the weakest first."""
    counting = [one for one in tables if one.counts]
    rows = sorted(counting, key=lambda one: (_power(one), one.config, one.table))
    return HEADER + "".join(map(shown, rows))


def test_readme_shows_every_table_with_its_score_the_weak_ones_first(state):
    assert ledger(state.tables) in (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_accepted_alternatives_are_those_of_the_configurations(state):
    assert state.stale == ()
    assert {table.config for table in state.tables} == {path.stem for path in CONFIGS}
    assert {table.config for table in state.tables if not table.tried} <= {"chen_example6"}


def test_every_table_is_held_against_at_least_eight_alternatives(state):
    assert {
        (table.config, table.table) for table in state.tables if table.tried < 8 and table.counts
    } == set()


def test_no_table_rejects_fewer_alternatives_than_it_once_did(state):
    """A score that falls is a verdict that has become weaker: raise the least where one rises."""
    with (Path(__file__).parent / "least_scores.csv").open(newline="", encoding="utf-8") as file:
        least = {(row["configuration"], row["table"]): int(row["rejected"]) for row in csv.DictReader(file)}
    found = {(table.config, table.table): table.rejected for table in state.tables}
    assert least.keys() <= found.keys()
    assert {key: found[key] for key in least if found[key] < least[key]} == {}


@pytest.mark.parametrize("config", CONFIGS, ids=lambda path: path.stem)
def test_every_alternative_can_be_run(config):
    plugins.load()
    plan = load(config)
    assert alternative_plans(plan).keys() == plan.experiment.alternatives.keys()


def test_the_joint_test_finds_what_the_numbers_do_not():
    """As docs/verdicts.md says of Table 1 of Chen, Hwang and Chang."""
    text = (ROOT / "results/power/chen_table1/table.md").read_text(encoding="utf-8")
    rows = {row.split("|")[1].strip(): row for row in text.splitlines() if row.count("|") == 5}
    assert "7 of 74" in rows["a_3 20 % larger"]
    assert "0.0050 | rejected" in rows["a_3 20 % larger"]
    assert all("survives" in rows[f"noise {much} as strong"] for much in ("twice", "half"))
