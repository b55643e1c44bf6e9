"""The printed numbers of Mzyk 2009, judged from the accepted trials."""

import pytest

from hident.ledger.verify import verify
from tests.accepted import ROOT, accepted_verdicts


@pytest.fixture(scope="module")
def table_1():
    return {(v.printed.row, v.printed.quantity): v for v in accepted_verdicts("mzyk_table1")}


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


def test_the_variances_of_section_iv_c():
    twenty, twenty_one = sorted(accepted_verdicts("mzyk_variance"), key=lambda v: v.printed.quantity)
    error = twenty.series.standard_error("mean")
    assert twenty.ours == pytest.approx(1 + 100 * 0.64 / 0.36, abs=4 * error)
    assert error < 1
    assert (twenty.printed.printed, twenty.word) == ("401", "differs")
    assert "178.78" in twenty.reason
    assert twenty_one.word == "exact"


def test_every_printed_number_is_judged_in_the_accepted_results():
    found = verify(ROOT / "results", ROOT / "experiments")
    assert (found.unexplained, found.unjudged, found.idle) == ((), (), ())
    numbers = {table.config: sum(table.counts.values()) for table in found.tables}
    assert (numbers["mzyk_table1"], numbers["mzyk_variance"]) == (24, 2)
