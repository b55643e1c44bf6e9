"""The ledger's files: printed numbers and reasons."""

from pathlib import Path

import pytest

from hident.engine.experiment import PublishedCells
from hident.errors import ConfigError
from hident.ledger.published import (
    Printed,
    Reason,
    check_published,
    printed_beside,
    read_published,
    read_reasons,
)
from tests.unit.results_maker import made

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
        (HEADER + "T,r,q,1,,,\n", r":2: has 7 cells, not 5$"),
        (HEADER + "\nT,r,q\n", r":3: has 3 cells, not 5$"),
    ],
)
def test_a_faulty_ledger_is_named(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        read_published(written(tmp_path, text))


def test_a_missing_ledger_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"published\.csv: no such file$"):
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


@pytest.mark.parametrize("text", ["", "  ", "\\t\\n", "."])
def test_a_reason_says_something(tmp_path, text):
    paper = written(tmp_path, f'reasons:\n- reason: "{text}"\n  config: a\n', "reasons.yaml")
    with pytest.raises(
        ConfigError, match=r"reasons.yaml:2: reasons\[0\].reason: must say why, in words \(got "
    ):
        read_reasons(paper)


@pytest.mark.parametrize(
    ("row", "labels", "key"),
    [
        ("N={samples}", {"samples": 50}, "N=50"),
        ("r={noise.nsr}, {x}", {"noise.nsr": 0.1, "x": "{noise.nsr}"}, "r=0.1, {noise.nsr}"),
        ("N={", {"samples": 50}, "N={"),
    ],
)
def test_only_axes_in_braces_are_replaced(row, labels, key):
    cell = PublishedCells(table="T", row=row, quantity="q", estimator="k", metric="m")
    printed = Printed("T", key, "q", "1", "")
    assert printed_beside(cell, "q", labels, {printed.key: printed}) is printed
    with pytest.raises(ConfigError, match=r"^published.csv has no number for T / .* / q$"):
        printed_beside(cell, "q", labels, {})


def test_cells_are_checked_against_the_printed_numbers(tmp_path):
    cells = """\
published:
  paper_trials: 1
  cells:
    - {table: T, row: "N={samples}", quantity: error, estimator: one, metric: mise}
    - {table: T, row: "N={", quantity: error, estimator: one, metric: mise}
    - {table: T, row: "{width}", quantity: error, estimator: two, metric: mise}
    - {table: T, row: "N={samples}", quantity: error, estimator: two, metric: "a a_1"}
    - {table: T, row: "N={samples}", quantity: error, estimator: one, metric: mise, at: {samples: 10}}
"""
    axes = "  width: {a: {estimators.one.bandwidth.h0: 1}}"
    metric = "  a: {kind: error, of: [a_1], estimators: [three]}\n"
    three = "  three: {kind: instrumental_variables, order: 1, instrument: identity}"
    printed = "T,N=10,error,1,\nT,N=100,error,1,\n"
    plan = made(tmp_path, {}, rest=metric + cells, axes=axes, estimators=three, printed=printed).plan
    with pytest.raises(ConfigError) as caught:
        check_published(plan)
    lines = str(caught.value).replace(f"{plan.path}:", "").splitlines()
    assert [line.partition(": ")[2] for line in lines] == [
        "published.cells[0]: published.csv has no number for T / N=1000 / error; "
        "did you mean 'T / N=100 / error'?",
        "published.cells[1]: published.csv has no number for T / N={ / error; "
        "did you mean 'T / N=10 / error'?",
        "published.cells[2]: the axis 'width' does not touch the estimator 'two'",
        "published.cells[3]: no estimate of 'two' has the metric 'a a_1' at these labels",
    ]
    assert len({line.partition(":")[0] for line in lines}) == 4


def test_several_quantities_of_a_row_stand_in_one_cell():
    cell = PublishedCells(table="T", row="r", estimator="k", quantities={"a": "m a_1", "b": "m b_1"})
    assert cell.pairs() == (("a", "m a_1"), ("b", "m b_1"))
    for wrong in ({}, {"quantity": "q"}, {"metric": "m"}, {"quantity": "q", "quantities": {"a": "b"}}):
        with pytest.raises(ConfigError, match="give 'quantity' and 'metric', or 'quantities' instead"):
            PublishedCells(table="T", row="r", estimator="k", **wrong)
