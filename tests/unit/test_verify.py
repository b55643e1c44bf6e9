"""The state of the ledger."""

import json

import pytest

from hident.errors import ConfigError, NothingToCompare
from hident.ledger.joint import combined_p
from hident.ledger.power import Mutation, NumberPower, VerdictPower, without_reports
from hident.ledger.verdicts import COLUMNS
from hident.ledger.verify import verify
from hident.run_folder import RunFolder

HEADER = ",".join(COLUMNS) + "\n"


def row(verdict, *, number="a", mark="", group=0, p="", tried=1):
    """A line of verdicts.csv."""
    cells = dict.fromkeys(COLUMNS, "") | {
        "table": "T",
        "row": number,
        "quantity": "q",
        "printed": "1",
        "ours": "3",
        "verdict": verdict,
        "alternatives": str(tried),
        "mark": mark,
        "group": str(group),
        "joint_p": str(p),
    }
    return ",".join(cells.values()) + "\n"


def counts(found):
    return {table.config: table.counts for table in found.tables}


@pytest.fixture
def folders(tmp_path):
    """A ledger of two printed numbers, and results that judge one of them."""
    paper = tmp_path / "experiments" / "p"
    paper.mkdir(parents=True)
    (paper / "published.csv").write_text("table,row,quantity,printed,note\nT,a,q,1,\nT,b,q,2,\n")
    results = tmp_path / "out" / "c"
    results.mkdir(parents=True)
    (results / "run.json").write_text(json.dumps({"experiment": {"config": "c", "resolved": {"paper": "p"}}}))
    (results / "verdicts.csv").write_text(HEADER + row("differs"))
    return tmp_path


def test_a_difference_needs_a_reason_and_every_number_a_verdict(folders):
    found = verify(folders / "out", folders / "experiments")
    assert counts(found) == {"c": {"differs": 1}}
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
    assert counts(verify(folders / "out" / "c", folders / "experiments")) == {"c": {"differs": 1}}


def sealed(folder, **run):
    """Give the folder a run.json with the hashes of its files."""
    experiment = {"config": "c", "resolved": {"paper": "p", "published": {}}}
    run = {"experiment": experiment, "files": ["verdicts.csv"], "provenance": {"key": "k"}, **run}
    RunFolder(folder).seal(run)


@pytest.mark.parametrize("text", [HEADER + row("agrees"), HEADER, "", None])
def test_verdicts_that_were_altered_since_the_run_are_refused(folders, text):
    file = folders / "out" / "c" / "verdicts.csv"
    sealed(file.parent)
    assert counts(verify(folders / "out", folders / "experiments")) == {"c": {"differs": 1}}
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
    assert counts(verify(folders / "out", folders / "experiments")) == {"c": {"differs": 1}}
    (other / "run.json").write_text(json.dumps(said))
    with pytest.raises(ConfigError, match=r"out/d/.*: run the configuration again"):
        verify(folders / "out", folders / "experiments")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (row("bogus"), "holds the verdict 'bogus' (allowed: exact, agrees, untestable, differs)"),
        (row("agr"), "holds the verdict 'agr' (allowed: exact, agrees, untestable, differs)"),
        ("T,a,q,1,3", "lacks columns"),
        ("", "holds no verdict"),
    ],
)
def test_what_is_no_verdict_is_refused(folders, line, said):
    file = folders / "out" / "c" / "verdicts.csv"
    file.write_text(HEADER + line)
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


def test_a_table_has_its_p_and_what_does_not_count_is_left_out(folders):
    lines = [
        row("exact", mark="structural"),
        row("agrees", p=0.01),
        row("untestable", p=0.01),
        row("differs", mark="multiplicity", group=1, p=0.5),
    ]
    (folders / "out" / "c" / "verdicts.csv").write_text(HEADER + "".join(lines))
    (table,) = verify(folders / "out", folders / "experiments").tables
    assert (table.counts, table.uncounted) == (
        {"agrees": 1, "untestable": 1, "differs": 1},
        {"structural": 1},
    )
    assert table.joint_p == pytest.approx(combined_p([0.01, 0.5]))
    assert (table.rejected, table.tried) == (0, 0)


def powered(folder, resolved, *, alternatives=("x", "y")):
    """A folder of the alternatives of configuration c, as `hident power` writes it."""
    mutations = [Mutation("T", name, 1, 0, 0.5, name == "x") for name in alternatives]
    power = VerdictPower({("T", "a", "q", ""): NumberPower("1", {"x": True})}, tuple(mutations))
    folder = folder / "power" / "c"
    folder.mkdir(parents=True)
    for name, text in power.files().items():
        (folder / name).write_text(text)
    experiment = {"config": "c", "hash": without_reports(resolved)}
    RunFolder(folder).seal({"experiment": experiment, "files": [*power.files()], "provenance": {}})


def test_the_mutation_score_is_that_of_the_accepted_alternatives_of_the_same_configuration(folders):
    resolved = {"paper": "p", "alternatives": {"x": {}, "y": {}}, "title": "a"}
    run = folders / "out" / "c" / "run.json"
    run.write_text(json.dumps({"experiment": {"config": "c", "resolved": resolved}}))

    def found():
        return verify(folders / "out", folders / "experiments", folders / "results")

    assert found().stale == ("c: none are accepted: hident power c, then hident accept --power c",)
    powered(folders / "results", {**resolved, "title": "b"})
    (table,) = found().tables
    assert (found().stale, table.rejected, table.tried, table.survivors) == ((), 1, 2, ("y",))
    verdicts = folders / "out" / "c" / "verdicts.csv"
    known = verdicts.read_text()
    verdicts.write_text(known.replace("T,a,q,1,", "T,a,q,1.0,"))
    assert "c: they were run for other printed numbers: " in found().stale[0]
    verdicts.write_text(HEADER + row("differs", tried=0))
    assert found().stale == ("c: the run did not know them: hident run c",)
    verdicts.write_text(known)
    run.write_text(json.dumps({"experiment": {"config": "c", "resolved": {**resolved, "seed": 2}}}))
    assert found().stale == (
        "c: they were run for another configuration: hident power c, then hident accept --power c",
    )
    (folders / "results" / "power" / "c" / "mutations.csv").write_text("")
    assert "was altered since it was written: hident power c" in found().stale[0]
