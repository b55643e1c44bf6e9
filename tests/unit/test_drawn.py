"""The numbers that a figure draws, as a file beside it."""

import json
import lzma

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from hident.ledger.compare import compare
from hident.reports.drawn import COLUMNS, drawn
from hident.reports.output import Outputs
from hident.reports.style import LINES, draw_band
from hident.run_folder import RunFolder
from tests.unit.results_maker import made

CURVE = """
figures:
  f: {kind: curve, x: samples, metric: mise, x_label: samples N, y_label: error}
"""


def rows(frame, *columns):
    return [tuple(row) for row in frame[list(columns)].itertuples(index=False)]


def panel():
    figure = Figure()
    return figure, figure.subplots()


def test_lines_and_points_of_each_panel():
    figure = Figure()
    one, two = figure.subplots(1, 2)
    one.set(title="first", xlabel="u", ylabel="mu(u)")
    one.plot([1, 2], [3, np.nan], label="true")
    two.plot([5], [6], "o", linestyle="none", label="ours\nof two lines")
    found = drawn(figure)
    assert tuple(found.columns) == COLUMNS
    assert rows(found.iloc[:2], "panel", "title", "x_label", "y_label", "curve", "shape") == 2 * [
        (1, "first", "u", "mu(u)", "true", "line")
    ]
    np.testing.assert_array_equal(found["y"], [3.0, np.nan, 6.0])
    assert rows(found.iloc[2:], "panel", "curve", "shape", "x", "y") == [
        (2, "ours of two lines", "points", 5.0, 6.0)
    ]


def test_a_band_has_two_ends_and_its_edges_are_not_told_again():
    figure, axes = panel()
    curves = np.array([[0.0, 1.0, 2.0], [4.0, 5.0, 6.0], [2.0, 3.0, 4.0]])
    draw_band(axes, np.array([1.0, 2.0, 3.0]), curves, LINES[0], "ours", 1.0)
    found = drawn(figure)
    assert rows(found, "curve", "shape", "x", "y", "y_to") == [
        ("ours, central 100 %", "band", x, low, high) for x, low, high in [(1, 0, 4), (2, 1, 5), (3, 2, 6)]
    ]


def test_error_bars_are_points_with_bars():
    figure, axes = panel()
    axes.errorbar([1.0, 2.0], [5.0, 6.0], [0.5, 0.25], label="ours", linestyle="none", capsize=3)
    found = drawn(figure)
    points, bars = found[found["shape"] == "points"], found[found["shape"] == "bar"]
    assert rows(points, "curve", "x", "y") == [("ours", 1.0, 5.0), ("ours", 2.0, 6.0)]
    assert rows(bars, "curve", "x", "y", "y_to") == [("ours", 1.0, 4.5, 5.5), ("ours", 2.0, 5.75, 6.25)]
    assert len(found) == 4


def test_what_reaches_across_a_panel_is_one_number():
    figure, axes = panel()
    axes.axhline(2.5, label="level")
    axes.axvline(7.0, label="step")
    found = drawn(figure)
    np.testing.assert_array_equal(found[["x", "y"]], [[np.nan, 2.5], [7.0, np.nan]])


def test_a_curve_without_a_label_has_that_of_the_one_that_looks_the_same():
    figure = Figure()
    one, two = figure.subplots(2)
    one.plot([0, 1], [0, 1], label="ours", **LINES[0])
    one.plot([0, 1], [0, 1], label="theirs", **LINES[1])
    two.plot([0, 1], [1, 1], **LINES[1])
    two.vlines([3.0], [0.0], [1.0], color=LINES[0]["color"])
    two.plot([0, 1], [2, 2], color="#123456")
    found = drawn(figure)
    found = found[found["panel"] == 2].drop_duplicates(["curve", "shape"])
    assert rows(found, "curve", "shape") == [("theirs", "line"), ("", "line"), ("ours", "bar")]


def test_contours_have_their_levels():
    figure, axes = panel()
    x = np.linspace(-2.0, 2.0, 41)
    axes.contour(x, x, x[:, None] ** 2 + x**2, [1.0])
    axes.contourf(x, x, x[:, None] ** 2 + x**2, [0.0, 1.0])
    found = drawn(figure)
    assert {*found["curve"]} == {"level 1"}
    np.testing.assert_allclose(np.hypot(found["x"], found["y"]), 1.0, atol=2e-3)


def test_a_label_at_the_edge_is_that_of_all_panels_of_its_column_or_row():
    figure = Figure()
    grid = figure.subplots(2, 2)
    for one in grid.flat:
        one.plot([1.0], [2.0])
    grid[1, 0].set_xlabel("N")
    grid[1, 1].set_xlabel("time")
    grid[0, 0].set_ylabel("gain")
    grid[1, 0].set_ylabel("phase")
    assert rows(drawn(figure), "panel", "x_label", "y_label") == [
        (1, "N", "gain"),
        (2, "time", "gain"),
        (3, "N", "phase"),
        (4, "time", "phase"),
    ]


def test_ticks_that_are_words_stand_beside_their_points_and_numbers_do_not():
    figure = Figure()
    one, two = figure.subplots(1, 2)
    one.plot([0.0, 0.3, 1.1], [1.0, 2.0, 3.0], label="_in no legend")
    one.set_xticks([0, 1], ["a_1", "a_2"])
    two.plot([10, 20], [1, 2], "s", color="#123456")
    two.set_xticks([10, 20], ["10", "20"])
    assert rows(drawn(figure), "curve", "at") == [
        ("in no legend", "a_1"),
        ("in no legend", "a_1"),
        ("in no legend", "a_2"),
        ("", ""),
        ("", ""),
    ]


def test_a_figure_without_curves_has_no_rows():
    assert rows(drawn(panel()[0]), *COLUMNS) == []


def write(folder, gain=1.0, out="out"):
    values = {("one", str(n)): [gain * n, 2.0 * gain * n] for n in (10, 100, 1000)}
    results = made(folder, values, rest=CURVE)
    assert Outputs(results.plan, folder / out).write(results, {}) == ()
    return folder / out


def test_a_run_writes_what_its_figures_draw(tmp_path):
    out = write(tmp_path)
    found = pd.read_csv(out / "f.data.csv.xz")
    line = found[(found["curve"] == "one") & (found["shape"] == "line")]
    assert rows(line, "x", "y") == [(10.0, 15.0), (100.0, 150.0), (1000.0, 1500.0)]
    table = pd.read_csv(out / "table.csv").query("estimator == 'one'")
    band = found[(found["curve"] == "one") & (found["shape"] == "band")]
    np.testing.assert_allclose(band[["y", "y_to"]], table[["q05", "q95"]], rtol=1e-6)
    assert "f.data.csv.xz" in RunFolder(out).files()
    assert RunFolder(out).altered() == []


def forget(folder, file):
    """Make the files those of a version that wrote none of this kind."""
    (folder / file).unlink()
    reseal(folder, lambda run: run["files"].remove(file))


def reseal(folder, change):
    run = json.loads((folder / "run.json").read_text())
    change(run)
    run["provenance"].pop("sha256")
    RunFolder(folder).seal(run)


def change_drawn(folder):
    file = folder / "f.data.csv.xz"
    text = lzma.decompress(file.read_bytes()).decode()
    assert text.count(",150,") == 1
    file.write_bytes(lzma.compress(text.replace(",150,", ",151,").encode()))
    reseal(folder, lambda run: None)


@pytest.mark.parametrize("file", ["f.data.csv.xz", "f.svg.xz"])
@pytest.mark.parametrize("older", ["out", "accepted"])
def test_results_of_a_version_that_wrote_none_do_not_differ(tmp_path, older, file):
    write(tmp_path), write(tmp_path, out="accepted")
    forget(tmp_path / older, file)
    assert compare(tmp_path / "out", tmp_path / "accepted").differences == ()


def test_another_number_differs_between_equal_arithmetics(tmp_path):
    write(tmp_path), write(tmp_path, out="accepted")
    assert compare(tmp_path / "out", tmp_path / "accepted").differences == ()
    change_drawn(tmp_path / "out")
    [said] = compare(tmp_path / "out", tmp_path / "accepted").differences
    assert said.startswith("accepted/f.data.csv.xz: panel 1, ")
    assert "y 151, reference 150" in said


def test_between_different_arithmetics_the_picture_is_compared_alone(tmp_path):
    write(tmp_path), write(tmp_path, out="accepted")
    change_drawn(tmp_path / "out")
    reseal(tmp_path / "accepted", lambda run: run["provenance"]["arithmetic"].update(identity="another"))
    assert compare(tmp_path / "out", tmp_path / "accepted").differences == ()
    (tmp_path / "out" / "f.png").unlink()
    assert any("f.png" in said for said in compare(tmp_path / "out", tmp_path / "accepted").differences)


@pytest.mark.parametrize("file", ["f.data.csv.xz", "f.svg.xz"])
def test_one_that_is_gone_differs(tmp_path, file):
    write(tmp_path), write(tmp_path, out="accepted")
    (tmp_path / "out" / file).unlink()
    said = compare(tmp_path / "out", tmp_path / "accepted").differences
    assert f"accepted/{file}: missing" in said


def change_vector(folder):
    file = folder / "f.svg.xz"
    text = lzma.decompress(file.read_bytes())
    assert b"#1b4f8a" in text
    file.write_bytes(lzma.compress(text.replace(b"#1b4f8a", b"#1b4f8b")))
    reseal(folder, lambda run: None)


def test_the_packed_drawing_is_that_of_a_run_that_is_asked_for_it(tmp_path):
    values = {("one", str(n)): [1.0 * n, 2.0 * n] for n in (10, 100, 1000)}
    results = made(tmp_path, values, rest=f"{CURVE}formats: [svg]\n")
    assert Outputs(results.plan, tmp_path / "asked").write(results, {}) == ()
    alone = write(tmp_path)
    text = lzma.decompress((alone / "f.svg.xz").read_bytes())
    assert text == (tmp_path / "asked" / "f.svg").read_bytes()
    # It says neither when nor by what it was made, and names no font.
    assert not any(word in text for word in (b"<dc:date>", b"<dc:creator>", b"font-family"))
    assert "f.svg.xz" in RunFolder(alone).files()


def test_another_drawing_differs_between_equal_arithmetics_alone(tmp_path):
    write(tmp_path), write(tmp_path, out="accepted")
    change_vector(tmp_path / "out")
    [said] = compare(tmp_path / "out", tmp_path / "accepted").differences
    assert said.startswith("accepted/f.svg.xz: another drawing: ")
    reseal(tmp_path / "accepted", lambda run: run["provenance"]["arithmetic"].update(identity="another"))
    assert compare(tmp_path / "out", tmp_path / "accepted").differences == ()
