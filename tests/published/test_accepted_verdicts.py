"""The accepted verdicts are those that the accepted trials give today."""

import csv
import io
import math

import pytest

from hident.config.expression import number
from hident.ledger.published import read_published, read_reasons
from hident.ledger.verdicts import frame
from tests.accepted import RESULTS, ROOT, accepted_verdicts

JUDGED = sorted(path.parent.name for path in RESULTS.glob("*/verdicts.csv"))


def same(one, other):
    """Whether two cells say the same: texts, or numbers to nine digits."""
    try:
        return math.isclose(float(one), float(other), rel_tol=1e-9, abs_tol=1e-12)
    except ValueError:
        return one == other


@pytest.mark.parametrize("config", JUDGED)
def test_the_accepted_verdicts_are_those_of_the_accepted_trials(config):
    now = frame(accepted_verdicts(config)).to_csv(index=False, lineterminator="\n")
    rows = list(csv.reader(io.StringIO(now, newline="")))
    with (RESULTS / config / "verdicts.csv").open(newline="", encoding="utf-8") as file:
        accepted = list(csv.reader(file))
    assert len(rows) == len(accepted)
    for ours, theirs in zip(rows, accepted, strict=True):
        wrong = [pair for pair in zip(ours, theirs, strict=True) if not same(*pair)]
        assert not wrong, ours[:3]


def accepted(config):
    with (RESULTS / config / "verdicts.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("config", JUDGED)
def test_every_row_says_which_number_it_is_on(config):
    rows = [(row["table"], row["row"], row["quantity"], row.get("case")) for row in accepted(config)]
    assert len({*rows}) == len(rows)


# By their papers alone: a formula of eq. (20), and a largest number below the mean of the same numbers.
MISPRINTS = {
    "chen_table1": [("type I, case C, stage 2", "max VIF", "1.08")],
    "chen_vif": [("type I, case C, stage 2", "max VIF", "1.08")],
    "mzyk_variance": [("sigma_z^2=1 sigma_w^2=100 p=1 a_1=0.8", "var delta_k, eq (20)", "401")],
}


def test_no_other_number_is_left_out_of_a_joint_test_as_a_misprint():
    found = {
        config: [
            (row["row"], row["quantity"], row["printed"])
            for row in accepted(config)
            if row["mark"] == "misprint"
        ]
        for config in JUDGED
    }
    assert {config: rows for config, rows in found.items() if rows} == MISPRINTS


def test_what_a_formula_gives_for_a_misprint_is_what_we_get():
    (reason,) = [one for one in read_reasons(ROOT / "experiments" / "mzyk2009") if one.misprint]
    assert reason.misprint is not None and reason.misprint.formula is not None
    value = number(reason.misprint.formula)
    (row,) = [row for row in accepted("mzyk_variance") if row["mark"] == "misprint"]
    assert float(row["low"]) < value < float(row["high"])
    # What the formula gives with the square left out.
    assert number(reason.misprint.formula.replace("**2", "")) == pytest.approx(float(row["printed"]))


def test_the_largest_of_the_misprinted_factors_is_printed_below_their_mean():
    printed = read_published(ROOT / "experiments" / "chen2009")
    row = ("Table 1", "type I, case C, stage 2")
    assert printed[*row, "max VIF"].value < printed[*row, "mean VIF"].value
