"""The state of the ledger."""

import json

import pytest

from hident.errors import ConfigError, NothingToCompare
from hident.ledger.verify import verify
from hident.run_folder import RunFolder


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


def sealed(folder, **run):
    """Give the folder a run.json with the hashes of its files."""
    experiment = {"config": "c", "resolved": {"paper": "p", "published": {}}}
    run = {"experiment": experiment, "files": ["verdicts.csv"], "provenance": {"key": "k"}, **run}
    RunFolder(folder).seal(run)


HEADER = "table,row,quantity,printed,ours,low,high,verdict,reason,interval\n"


@pytest.mark.parametrize("text", [HEADER + "T,a,q,1,3,2,4,agrees,,i\n", HEADER, "", None])
def test_verdicts_that_were_altered_since_the_run_are_refused(folders, text):
    file = folders / "out" / "c" / "verdicts.csv"
    sealed(file.parent)
    assert verify(folders / "out", folders / "experiments").counts == {"c": {"differs": 1}}
    if text is None:
        file.unlink()
    else:
        file.write_text(text)
    for folder in (folders / "out", file.parent):
        with pytest.raises(ConfigError) as caught:
            verify(folder, folders / "experiments")
        assert str(caught.value) == f"{file} was altered since the run: run the configuration again"


def test_a_run_json_that_was_altered_since_the_run_is_refused(folders):
    file = folders / "out" / "c" / "run.json"
    sealed(file.parent)
    file.write_text(file.read_text().replace('"config": "c"', '"config": "d"'))
    with pytest.raises(ConfigError, match=r"run.json was altered since the run"):
        verify(folders / "out", folders / "experiments")


@pytest.mark.parametrize(
    "said", [{"files": ["verdicts.csv"]}, {"experiment": {"config": "d", "resolved": {"published": {}}}}, []]
)
def test_a_configuration_whose_verdicts_are_missing_is_refused_beside_others(folders, said):
    other = folders / "out" / "d"
    other.mkdir()
    (other / "run.json").write_text(json.dumps({"experiment": {"config": "d", "resolved": {}}}))
    assert verify(folders / "out", folders / "experiments").counts == {"c": {"differs": 1}}
    (other / "run.json").write_text(json.dumps(said))
    with pytest.raises(ConfigError, match=r"out/d/.*: run the configuration again"):
        verify(folders / "out", folders / "experiments")


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("T,a,q,1,3,2,4,bogus,,i\n", "holds the verdict 'bogus' (allowed: exact, agrees, differs)"),
        ("T,a,q,1,3,2,4,agr", "holds the verdict 'agr' (allowed: exact, agrees, differs)"),
        ("T,a,q,1,3", "lacks columns"),
        ("", "holds no verdict"),
    ],
)
def test_what_is_no_verdict_is_refused(folders, row, said):
    file = folders / "out" / "c" / "verdicts.csv"
    file.write_text(HEADER + row)
    with pytest.raises(ConfigError) as caught:
        verify(folders / "out", folders / "experiments")
    assert str(caught.value) == f"{file} {said}: run the configuration again"


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
