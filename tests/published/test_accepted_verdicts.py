"""The accepted verdicts are those that the accepted trials give today."""

import csv
import io
import math

import pytest

from hident.ledger.verdicts import frame
from tests.accepted import RESULTS, accepted_verdicts

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
