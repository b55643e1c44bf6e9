"""Every difference that a comparison of results must see, and those that it must not."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread, imsave

from hident.errors import ConfigError, NothingToCompare, StoreError
from hident.ledger.compare import compare

TABLE = """\
samples,estimator,metric,trials,failed,mean,std
50,(4),mise,100,0,0.123456789,0.01
50,(4),gain,100,2,1.5,nan
50,kernel,mise,100,0,0.25,0.02
200,(4),mise,100,0,0.0625,0.0
"""
VERDICTS = """\
table,row,quantity,printed,ours,low,high,verdict,reason,interval
I,50,mise,0.12,0.123,0.11,0.13,exact,,mean
I,200,mise,0.07,0.0625,0.06,0.065,differs,"Another seed, says the paper",mean
"""
CURVES = "u,(4)\n0.1,1.0\n0.2,2.0\n0.30000000000000004,3.0\n"
REPORT = "# Table I\n\n| N | (4) |\n|---|---|\n| 50 | **0.1235** |\n"
RUN = {
    "experiment": {"config": "x", "seed": 10_000_019, "cases": [{"noise": 0.5, "on": True, "law": "u**2"}]},
    "files": ["table.csv"],
    "provenance": {"git": "abc", "seconds": 1.5},
}


def curve(path, gain=1.0):
    figure = Figure(figsize=(4, 3))
    u = np.linspace(-1, 1, 50)
    FigureCanvasAgg(figure)
    figure.subplots().plot(u, gain * u**3 + u)
    figure.savefig(path)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pictures")
    curve(folder / "figure.png")
    curve(folder / "other.png", gain=1.2)
    return folder


def write(folder, pictures):
    folder.mkdir(parents=True)
    (folder / "table.csv").write_text(TABLE)
    (folder / "verdicts.csv").write_text(VERDICTS)
    (folder / "curves.csv").write_text(CURVES)
    (folder / "table.md").write_text(REPORT)
    (folder / "run.json").write_text(json.dumps(RUN))
    (folder / "data.bin").write_bytes(b"\x00\xff")
    shutil.copy(pictures / "figure.png", folder)


@pytest.fixture
def pair(tmp_path, pictures):
    """Two folders with the same results of the configuration x."""
    for side in ("out", "results"):
        write(tmp_path / side / "x", pictures)
    return tmp_path / "out", tmp_path / "results"


def edit(pair, name, old, new):
    """Replace the only occurrence of a text on our side."""
    path = pair[0] / "x" / name
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))


def differences(pair, **options):
    return list(compare(*pair, **options).differences)


def test_equal_results_have_no_difference(pair):
    found = compare(*pair)
    assert (found.differences, found.compared, found.absent) == ((), 1, ())


def test_a_cell_is_held_against_the_relative_tolerance(pair):
    edit(pair, "table.csv", "0.123456789", repr(0.123456789 * (1 + 1e-9)))
    assert differences(pair) == []
    assert len(differences(pair, rtol=1e-10)) == 1
    (pair[0] / "x/table.csv").write_text(TABLE.replace("0.123456789", "0.123458024"))
    assert differences(pair) == [
        "x/table.csv: samples 50, estimator (4), metric mise: "
        "mean 0.123458024, reference 0.123456789, relative difference 1.0e-05"
    ]


@pytest.mark.parametrize(
    ("name", "old", "new", "said"),
    [
        (
            "table.csv",
            "(4),gain,100,2",
            "(4),gain,101,2",
            "samples 50, estimator (4), metric gain: trials 101, reference 100, relative difference 9.9e-03",
        ),
        (
            "table.csv",
            "(4),gain,100,2",
            "(4),gain,100,0",
            "samples 50, estimator (4), metric gain: failed 0, reference 2, relative difference 1.0e+00",
        ),
        ("table.csv", "1.5,nan", "1.5,0.3", "samples 50, estimator (4), metric gain: std 0.3, reference nan"),
        (
            "table.csv",
            "0.0625,0.0",
            "0.0625,1e-300",
            "samples 200, estimator (4), metric mise: std 1e-300, reference 0.0, relative difference 1.0e+00",
        ),
        (
            "table.csv",
            "0.25,0.02",
            "inf,0.02",
            "samples 50, estimator kernel, metric mise: mean inf, reference 0.25",
        ),
        (
            "table.csv",
            "50,(4),gain,100,2,1.5,nan\n",
            "",
            "samples 50, estimator (4), metric gain: row is missing",
        ),
        (
            "table.csv",
            "200,(4),mise",
            "100,(4),mise,100,0,1.0,1.0\n200,(4),mise",
            "samples 100, estimator (4), metric mise: row is extra",
        ),
        (
            "table.csv",
            "200,(4),mise",
            "50,kernel,mise,100,0,0.25,0.02\n200,(4),mise",
            "samples 50, estimator kernel, metric mise: row is extra",
        ),
        (
            "verdicts.csv",
            "exact",
            "agrees",
            "table I, row 50, quantity mise: verdict agrees, reference exact",
        ),
        (
            "verdicts.csv",
            "exact,,",
            "exact,why,",
            "table I, row 50, quantity mise: reason why, reference empty",
        ),
        ("curves.csv", "0.2,2.0", "0.2,2.1", "u 0.2: (4) 2.1, reference 2.0, relative difference 4.8e-02"),
        (
            "run.json",
            "10000019",
            "10000020",
            "experiment.seed 10000020, reference 10000019, relative difference 1.0e-07",
        ),
        (
            "run.json",
            "0.5",
            "0.6",
            "experiment.cases[0].noise 0.6, reference 0.5, relative difference 1.7e-01",
        ),
        ("run.json", "true", "1", "experiment.cases[0].on 1, reference true"),
        ("run.json", "u**2", "u**3", 'experiment.cases[0].law "u**3", reference "u**2"'),
        ("run.json", '"seed": 10000019, ', "", "experiment.seed is missing"),
        ("run.json", '["table.csv"]', '["table.csv", "new.csv"]', "files[1] is extra"),
        (
            "table.md",
            "0.1235",
            "0.1236",
            "line 5: '| 50 | **0.1236** |', reference '| 50 | **0.1235** |'",
        ),
        ("table.md", "| N |", "| n |", "line 3: '| n | (4) |', reference '| N | (4) |'"),
        ("table.md", "| 50 | **0.1235** |\n", "", "4 lines, reference 5"),
    ],
)
def test_one_change_is_one_difference(pair, name, old, new, said):
    edit(pair, name, old, new)
    assert differences(pair) == [f"x/{name}: {said}"]


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("table.csv", "0.0625,0.0", "0.0625,0"),
        ("table.csv", "0.0625,0.0", "0.0625,-0.0"),
        ("table.csv", "kernel,mise,100,0", "kernel,mise,100,-0"),
        ("table.csv", "1.5,nan", "1.5,"),
        ("table.csv", "1.5,nan", "1.5,NaN"),
        ("curves.csv", "0.30000000000000004", "0.3"),
        ("run.json", "abc", "def"),
        ("run.json", '"seconds": 1.5', '"days": 2'),
        ("run.json", "0.5", "0.50000001"),
        ("table.md", "0.1235", "0.12350000001"),
        ("table.md", "| 50 |", "|  50 |"),
    ],
)
def test_what_does_not_count(pair, name, old, new):
    edit(pair, name, old, new)
    assert differences(pair) == []


def test_the_order_of_rows_and_columns_does_not_count(pair):
    rows = [line.split(",") for line in TABLE.splitlines()]
    turned = [[row[i] for i in (0, 1, 2, 6, 5, 4, 3)] for row in [rows[0], *reversed(rows[1:])]]
    (pair[0] / "x/table.csv").write_text("\n".join(",".join(row) for row in turned) + "\n")
    assert differences(pair) == []


def test_rows_are_found_by_their_key_when_another_is_missing(pair):
    (pair[0] / "x/curves.csv").write_text("u,(4)\n0.3,3.1\n0.1,1.0\n")
    assert differences(pair) == [
        "x/curves.csv: u 0.2: row is missing",
        "x/curves.csv: u 0.30000000000000004: (4) 3.1, reference 3.0, relative difference 3.2e-02",
    ]


def test_a_column_is_named(pair):
    (pair[0] / "x/curves.csv").write_text("u,(5)\n0.1,1.0\n0.2,2.0\n0.3,3.0\n")
    assert differences(pair) == ["x/curves.csv: column (4) is missing", "x/curves.csv: column (5) is extra"]


def test_a_file_is_named(pair):
    (pair[0] / "x/table.md").unlink()
    (pair[0] / "x/notes.txt").write_text("new")
    assert differences(pair) == ["x/notes.txt: extra, the reference lacks it", "x/table.md: missing"]


def test_hidden_and_temporary_files_do_not_count(pair):
    ours, reference = pair
    (ours / "x/.table.csv.part").write_text("half")
    (ours / "x/table.tmp").write_text("half")
    (reference / ".x.old").mkdir()
    (reference / ".x.old/run.json").write_text("{}")
    (ours / "logs").mkdir()
    assert differences(pair) == []


def test_other_files_are_compared_by_their_bytes(pair):
    (pair[0] / "x/data.bin").write_bytes(b"\x00\xfe\x01")
    assert differences(pair) == ["x/data.bin: other bytes: 3, reference 2"]


def test_another_curve_is_a_difference(pair, pictures):
    shutil.copy(pictures / "other.png", pair[0] / "x/figure.png")
    (line,) = differences(pair)
    assert line.startswith("x/figure.png: another picture: root mean square of the difference 0.")
    assert line.endswith(", allowed 0.0078")


def test_the_last_bits_of_a_picture_are_not(pair, pictures):
    pixels = imread(pictures / "figure.png")
    shift = np.random.default_rng(0).integers(-1, 2, pixels.shape) / 255
    imsave(pair[0] / "x/figure.png", np.clip(pixels + shift, 0, 1))
    assert (imread(pair[0] / "x/figure.png") != pixels).any()
    assert differences(pair) == []


def test_a_picture_of_another_size_is_a_difference(pair):
    imsave(pair[0] / "x/figure.png", np.zeros((5, 7, 4)))
    assert differences(pair) == ["x/figure.png: 5 x 7 x 4 pixels, reference 300 x 400 x 4"]


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("table.csv", b"", "it has no header"),
        ("table.csv", TABLE[: TABLE.rindex(",")].encode(), "line 5 has 6 cells, not 7"),
        ("verdicts.csv", VERDICTS[:-20].encode(), "unexpected end of data"),
        ("curves.csv", b"u,u\n1,2\n", "column u stands twice"),
        ("curves.csv", b"\xff\xfe\x00", "'utf-8' codec can't decode"),
        ("table.md", b"\xff\xfe\x00", "'utf-8' codec can't decode"),
        ("run.json", json.dumps(RUN)[:-1].encode(), "Expecting"),
        ("run.json", b"[" * 100_000, ""),
        ("figure.png", b"", ""),
        ("figure.png", b"\x89PNG\r\n\x1a\n" + b"\x00" * 40, ""),
    ],
)
def test_an_unreadable_file_is_a_difference_on_either_side(pair, name, content, said):
    ours, reference = pair
    (ours / "x" / name).write_bytes(content)
    (line,) = compare(ours, reference).differences
    assert line.startswith(f"x/{name}: cannot be read: {said}")
    (line,) = compare(reference, ours).differences
    assert line.startswith(f"x/{name}: the reference cannot be read: {said}")


def test_a_truncated_picture_is_a_difference(pair):
    path = pair[0] / "x/figure.png"
    path.write_bytes(path.read_bytes()[:1000])
    (line,) = differences(pair)
    assert line.startswith("x/figure.png: cannot be read: ")


def refuse(name):
    """A stand-in for a method of Path that has no permission for files of this name."""
    method = {"out": Path.iterdir}.get(name, Path.read_bytes)

    def refused(path):
        if path.name == name:
            raise PermissionError(13, "Permission denied", str(path))
        return method(path)

    return refused


def test_a_file_without_permission_is_a_difference(pair, monkeypatch):
    monkeypatch.setattr(Path, "read_bytes", refuse("table.csv"))
    assert differences(pair) == ["x/table.csv: cannot be read: permission denied"]


def test_a_folder_without_permission_is_an_error(pair, monkeypatch):
    monkeypatch.setattr(Path, "iterdir", refuse("out"))
    ours, reference = pair
    with pytest.raises(StoreError) as caught:
        compare(ours, reference)
    assert str(caught.value) == (
        f"{ours} and {reference} cannot be compared: [Errno 13] Permission denied: '{ours}'"
    )


def test_two_result_folders(pair):
    edit(pair, "table.md", "| N |", "| n |")
    found = compare(pair[0] / "x", pair[1] / "x")
    assert found.compared == 1
    assert found.differences == ("x/table.md: line 3: '| n | (4) |', reference '| N | (4) |'",)


def test_a_result_folder_may_lack_run_json(pair):
    (pair[0] / "x/run.json").unlink()
    assert differences(pair) == ["x/run.json: missing"]
    assert compare(pair[0] / "x", pair[1] / "x").differences == ("x/run.json: missing",)


def test_a_gutted_folder_is_not_absent(pair, pictures):
    write(pair[0] / "y", pictures)
    for name in ("run.json", "table.csv"):
        (pair[0] / "x" / name).unlink()
    shutil.copytree(pair[0] / "y", pair[1] / "y")
    found = compare(*pair)
    assert found.differences == ("x/run.json: missing", "x/table.csv: missing")
    assert (found.compared, found.absent) == (2, ())


def test_a_configuration_that_was_not_run_is_absent(pair, pictures):
    write(pair[1] / "y", pictures)
    found = compare(*pair)
    assert (found.differences, found.compared, found.absent) == ((), 1, ("y",))
    found = compare(*pair, complete=True)
    assert (found.differences, found.compared, found.absent) == (("y: not run; hident run y",), 1, ("y",))


def test_a_configuration_that_was_not_accepted_is_a_difference(pair, pictures):
    write(pair[0] / "y", pictures)
    assert differences(pair) == ["y: not accepted yet; hident accept y"]


def test_nothing_to_compare(pair, tmp_path):
    ours, reference = pair
    empty = tmp_path / "empty"
    nowhere = tmp_path / "nowhere"
    empty.mkdir()
    run = "hident run <config> makes them"
    accept = "hident accept <config> makes run results the accepted ones"
    for folders, message in (
        ((nowhere, reference), f"there is no folder {nowhere}: {run}"),
        ((empty, reference), f"{empty} holds no results: {run}"),
        ((ours, nowhere), f"there is no folder {nowhere}: {accept}"),
        ((ours, empty), f"{empty} holds no results: {accept}"),
        ((ours, reference / "x/table.csv"), f"there is no folder {reference / 'x/table.csv'}: {accept}"),
    ):
        with pytest.raises(NothingToCompare) as caught:
            compare(*folders)
        assert str(caught.value) == message


def test_the_two_folders_are_of_a_kind(pair):
    ours, reference = pair
    for one, other in ((ours / "x", reference), (reference, ours / "x")):
        with pytest.raises(ConfigError) as caught:
            compare(one, other)
        assert str(caught.value) == (
            f"{ours / 'x'} is one result folder and {reference} a folder of them: name two of a kind"
        )


CELLS = st.one_of(
    st.floats().map(str),
    st.integers(-(10**30), 10**30).map(str),
    st.text(st.characters(codec="utf-8", exclude_characters="\r\n\x00"), max_size=5),
    st.sampled_from(["", "nan", "0", "-0", "007", "1e999", "9" * 5000]),
)
GRIDS = st.integers(1, 4).flatmap(
    lambda width: st.lists(st.lists(CELLS, min_size=width, max_size=width), min_size=1, max_size=6)
)


def put(folder, grid):
    """The grid as a table with the columns c0, c1, ..."""
    folder.mkdir(exist_ok=True)
    with (folder / "table.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, quoting=csv.QUOTE_ALL).writerows([[f"c{i}" for i in range(len(grid[0]))], *grid])


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    folder = tmp_path_factory.mktemp("grids")
    return folder / "a", folder / "b"


@settings(deadline=None, derandomize=True, max_examples=100)
@given(grid=GRIDS, turn=st.randoms(use_true_random=False))
@example(grid=[["1", "a"], ["1", "a"]], turn=None)
def test_a_table_equals_itself_in_any_order(folders, grid, turn):
    shuffled = list(grid)
    if turn:
        turn.shuffle(shuffled)
    put(folders[0], grid)
    put(folders[1], shuffled)
    assert compare(*folders).differences == ()


@settings(deadline=None, derandomize=True, max_examples=200)
@given(grid=GRIDS, data=st.data())
def test_the_change_of_a_cell_is_seen_alike_from_both_sides(folders, grid, data):
    row = data.draw(st.integers(0, len(grid) - 1))
    column = data.draw(st.integers(0, len(grid[0]) - 1))
    changed = [list(cells) for cells in grid]
    changed[row][column] = data.draw(st.sampled_from(["changed, surely", "12345.678"]))
    put(folders[0], grid)
    put(folders[1], changed)
    here, there = compare(*folders).differences, compare(*folders[::-1]).differences
    assert here
    assert len(here) == len(there)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(value=st.floats(1e-300, 1e300), change=st.sampled_from([1e-12, 1e-9, 1e-5, 1e-2, 1.0]))
def test_the_tolerance_is_relative_at_any_size(folders, value, change):
    put(folders[0], [["a", repr(value)]])
    put(folders[1], [["a", repr(value * (1 + change))]])
    assert len(compare(*folders).differences) == (change > 1e-6)


def test_files_outside_of_results_are_differences_too(pair):
    ours, reference = pair
    (ours / "y").mkdir()
    (ours / "y/crashes.txt").write_text("")
    (ours / "notes.txt").write_text("mine")
    (reference / "notes.txt").write_text("theirs")
    (reference / "z").mkdir()
    (reference / "z/table.md").write_text("")
    assert differences(pair) == [
        "notes.txt: line 1: 'mine', reference 'theirs'",
        "y/crashes.txt: extra, the reference lacks it",
        "z/table.md: missing",
    ]


@pytest.mark.parametrize(("header", "missing"), [("u,(5)", ["(4)"]), ("v,w", ["u", "(4)"])])
def test_of_other_columns_nothing_else_is_said(pair, header, missing):
    (pair[0] / "x/curves.csv").write_text(f"{header}\n7,7\n")
    extra = [name for name in header.split(",") if name != "u"]
    assert differences(pair) == [
        *(f"x/curves.csv: column {name} is missing" for name in missing),
        *(f"x/curves.csv: column {name} is extra" for name in extra),
    ]
