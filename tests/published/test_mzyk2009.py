"""The printed numbers of Mzyk 2009, judged from trials computed here."""

from pathlib import Path

import pytest

from hident import plugins
from hident.engine.executors import SerialExecutor
from hident.engine.experiment import load
from hident.engine.runner import run
from hident.engine.store import Store
from hident.ledger.verdicts import judge
from hident.ledger.verify import verify

ROOT = Path(__file__).resolve().parents[2]


def verdicts(name, tmp_path, *, trials, assignments=()):
    plugins.load()
    plan = load(ROOT / "configs" / f"{name}.yaml", assignments)
    seed = plan.experiment.seed
    with Store(tmp_path).writing() as writer:
        return judge(run(plan, writer, SerialExecutor(), 1, trials=trials, seed=seed))


@pytest.fixture(scope="module")
def table_1(tmp_path_factory):
    found = verdicts("mzyk_table1", tmp_path_factory.mktemp("table1"), trials=100)
    return {(v.printed.row, v.printed.quantity): v for v in found}


def test_table_1_comes_out_but_for_its_three_slow_cells(table_1):
    assert len(table_1) == 24
    differing = {key for key, v in table_1.items() if v.word == "differs"}
    assert differing == {
        ("N=3000", "MISE kernel (4)"),
        ("N=1000", "MISE orthogonal (7)"),
        ("N=3000", "MISE orthogonal (7)"),
    }
    assert all(v.reason for v in table_1.values() if v.word == "differs")


def test_filtering_reduces_the_error_as_the_paper_says(table_1):
    found = {key: v.ours for key, v in table_1.items()}
    for n in (50, 100, 300, 500, 1000):
        assert found[f"N={n}", "MISE kernel (4)"] > 8 * found[f"N={n}", "MISE kernel, filtered (15)"]
        plain, filtered = "MISE orthogonal (7)", "MISE orthogonal, filtered (16)"
        assert found[f"N={n}", plain] > 2 * found[f"N={n}", filtered]


def test_the_variances_of_section_iv_c(tmp_path):
    printed = verdicts("mzyk_variance", tmp_path, trials=20)
    twenty, twenty_one = sorted(printed, key=lambda v: v.printed.quantity)
    error = twenty.series.standard_error("mean")
    assert twenty.ours == pytest.approx(1 + 100 * 0.64 / 0.36, abs=4 * error)
    assert error < 1
    assert (twenty.printed.printed, twenty.word) == ("401", "differs")
    assert "178.78" in twenty.reason
    assert twenty_one.word in ("exact", "agrees")


def test_every_printed_number_is_judged_in_the_accepted_results():
    found = verify(ROOT / "results", ROOT / "experiments")
    assert (found.unexplained, found.unjudged, found.idle) == ((), (), ())
    assert sum(found.counts["mzyk_table1"].values()) == 24
    assert sum(found.counts["mzyk_variance"].values()) == 2
