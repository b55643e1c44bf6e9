"""The state of the ledger."""

import json

import pytest

from hident.errors import ConfigError, NothingToCompare
from hident.ledger.verify import verify


@pytest.fixture
def folders(tmp_path):
    """A ledger of two printed numbers, and results that judge one of them."""
    paper = tmp_path / "experiments" / "p"
    paper.mkdir(parents=True)
    (paper / "published.csv").write_text("table,row,quantity,printed,note\nT,a,q,1,\nT,b,q,2,\n")
    results = tmp_path / "out" / "c"
    results.mkdir(parents=True)
    (results / "run.json").write_text(json.dumps({"experiment": {"config": "c", "resolved": {"paper": "p"}}}))
    header = "table,row,quantity,printed,ours,low,high,verdict,reason,interval\n"
    (results / "verdicts.csv").write_text(header + "T,a,q,1,3,2,4,differs,,i\n")
    return tmp_path


def test_a_difference_needs_a_reason_and_every_number_a_verdict(folders):
    found = verify(folders / "out", folders / "experiments")
    assert found.counts == {"c": {"differs": 1}}
    assert found.unexplained == ("c: T / a / q: printed 1, ours 3",)
    assert found.unjudged == ("p: T / b / q",)
    assert found.idle == ()


def test_todays_reasons_count(folders):
    reasons = "reasons:\n- {reason: because, row: a}\n- {reason: idle, row: b}\n"
    (folders / "experiments" / "p" / "reasons.yaml").write_text(reasons)
    found = verify(folders / "out", folders / "experiments")
    assert found.unexplained == ()
    assert found.idle == ("p: idle",)


def test_one_configuration_alone_can_be_verified(folders):
    assert verify(folders / "out" / "c", folders / "experiments").counts == {"c": {"differs": 1}}


def test_nothing_to_verify(tmp_path):
    with pytest.raises(NothingToCompare, match=r"holds no verdicts.csv: run a configuration"):
        verify(tmp_path, tmp_path)


@pytest.mark.parametrize(
    ("name", "text"), [("run.json", "{"), ("run.json", "[" * 100_000), ("verdicts.csv", "a,b\n1,2\n")]
)
def test_unreadable_files_are_named(folders, name, text):
    (folders / "out" / "c" / name).write_text(text)
    with pytest.raises(ConfigError, match=rf"{name} .*: run the configuration again"):
        verify(folders / "out", folders / "experiments")
