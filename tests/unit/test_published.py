"""The ledger's files: printed numbers and reasons."""

from pathlib import Path

import pytest

from hident.errors import ConfigError
from hident.ledger.published import Printed, Reason, read_published, read_reasons

HEADER = "table,row,quantity,printed,note\n"


def written(folder: Path, text: str, name: str = "published.csv") -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder


def test_printed_digits_are_kept(tmp_path):
    paper = written(tmp_path, HEADER + "Table I,N=50,MISE,2.20,\nTable I,N=50,count,94,\nT,r,q,-0.8944,n\n")
    found = read_published(paper)
    assert found["Table I", "N=50", "MISE"].half_unit == pytest.approx(0.005)
    assert found["Table I", "N=50", "count"].half_unit == 0.5
    assert found["T", "r", "q"] == Printed("T", "r", "q", "-0.8944", "n")
    assert found["T", "r", "q"].value == -0.8944


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("table,row,printed\n", r":1: the columns must be table,row,quantity,printed,note"),
        (HEADER + "T,r,q,abc,\n", r":2: 'abc' is not a number"),
        (HEADER + "T,r,q,nan,\n", r":2: 'nan' is not a number"),
        (HEADER + "T,r,q,1,\nT,r,q,2,\n", r":3: T / r / q stands twice"),
        (HEADER + "T,r,q,1,,,\n", r"cannot be read"),
    ],
)
def test_a_faulty_ledger_is_named(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        read_published(written(tmp_path, text))


def test_a_missing_ledger_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"published\.csv: cannot be read"):
        read_published(tmp_path)


def test_reasons_cover_by_patterns_and_the_first_counts(tmp_path):
    text = "reasons:\n- {reason: one, config: a, quantity: 'MISE (4)*'}\n- {reason: two, row: 'N=5?'}\n"
    one, two = read_reasons(written(tmp_path, text, "reasons.yaml"))
    assert one.covers("a", ("T", "N=50", "MISE (4), mean"))
    assert not one.covers("b", ("T", "N=50", "MISE (4), mean"))
    assert two.covers("b", ("T", "N=50", "x"))
    assert not two.covers("b", ("T", "N=500", "x"))


def test_brackets_in_names_are_no_patterns():
    reason = Reason(reason="r", quantity="L[b,a]")
    assert reason.covers("c", ("T", "r", "L[b,a]"))
    assert not reason.covers("c", ("T", "r", "Lb"))


def test_no_file_is_no_reasons(tmp_path):
    assert read_reasons(tmp_path) == ()


def test_a_faulty_reason_is_named_with_its_line(tmp_path):
    paper = written(tmp_path, "reasons:\n- reason: x\n  colour: red\n", "reasons.yaml")
    with pytest.raises(ConfigError, match=r"reasons.yaml:3: reasons\[0\].colour: unknown key"):
        read_reasons(paper)
