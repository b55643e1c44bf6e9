"""The formats of the files of a run, and what compare makes of them."""

import json
import re

import pytest

from hident.ledger.compare import compare
from hident.ledger.contents import content_differences
from hident.reports.base import FigureSpec
from hident.reports.output import Outputs
from hident.reports.style import printed, style
from tests.unit.plans import refusals
from tests.unit.results_maker import CONFIG, made

CURVE = """
figures:
  f: {kind: curve, x: samples, metric: mise, x_label: samples N, y_label: error}
"""
PLAIN = CONFIG.format(trials=2, rest="", axes="", estimators="").replace("paper: someone2001\n", "")


def write(folder, formats, gain=1.0, out="out"):
    values = {("one", str(n)): [gain, 2.0 * gain] for n in (10, 100, 1000)}
    results = made(folder, values, rest=f"{CURVE}formats: {formats}\n")
    outputs = Outputs(results.plan, folder / out)
    assert outputs.write(results, {}) == ()
    return {path.name for path in (folder / out).iterdir()} - {"timing.csv"}


BASE = {"run.json", "table.csv", "table.md", "trials.csv.xz", "f.data.csv.xz", "f.svg.xz"}


@pytest.mark.parametrize(
    ("formats", "files"),
    [
        ("[png]", {"f.png"}),
        ("[pdf, svg]", {"f.pdf", "f.svg"}),
        ("[tex]", {"f.png", "table.tex"}),
        ("[tex, pdf]", {"f.pdf", "table.tex"}),
        ("svg,png", {"f.png", "f.svg"}),
    ],
)
def test_the_files_are_those_that_were_asked_for(tmp_path, formats, files):
    assert write(tmp_path, formats) == BASE | files
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    assert {*run["files"]} == BASE - {"run.json"} | files
    assert "formats" not in run["experiment"]["resolved"]


def test_the_default_is_not_written_down(tmp_path):
    write(tmp_path, "[png]")
    assert "formats" not in json.loads((tmp_path / "out" / "run.json").read_text())


def test_another_format_is_another_output_and_the_files_of_an_earlier_one_go(tmp_path):
    write(tmp_path, "[png]")
    results = made(tmp_path, {}, rest=f"{CURVE}formats: [pdf]\n")
    assert Outputs(results.plan, tmp_path / "out").state() == "old"
    assert write(tmp_path, "[pdf]") == BASE | {"f.pdf"}


@pytest.mark.parametrize(
    ("formats", "said"),
    [
        ("[pfd]", "must be 'png', 'pdf', 'svg' or 'tex'; did you mean 'pdf'? (got 'pfd')"),
        ("png,pfd", "must be 'png', 'pdf', 'svg' or 'tex'; did you mean 'pdf'? (got 'pfd')"),
        ("[]", "must be a list of at least 1"),
        ("3", "must be a list (got 3)"),
    ],
)
def test_an_unknown_format_is_refused(tmp_path, formats, said):
    [line] = refusals(tmp_path, PLAIN + f"formats: {formats}\n")
    assert "formats" in line
    assert said in line


def test_the_option_is_named_by_its_name(tmp_path):
    [line] = refusals(tmp_path, PLAIN, formats="pgn")
    assert line.startswith("--format pgn: formats: must be 'png'")


def test_a_pdf_embeds_its_fonts_and_neither_file_knows_the_time(tmp_path):
    write(tmp_path, "[pdf, svg]")
    pdf, svg = ((tmp_path / "out" / f"f.{kind}").read_bytes() for kind in ("pdf", "svg"))
    assert b"/FontFile2" in pdf  # TrueType, as type 42 is.
    assert b"/Type3" not in pdf
    assert not re.search(rb"CreationDate|Matplotlib", pdf)
    assert not re.search(rb"<dc:date>|Matplotlib v|<text", svg)


@pytest.mark.parametrize("kinds", [("pdf", "svg"), ("png", "pdf", "svg"), ("svg", "pdf")])
def test_the_bytes_depend_on_what_is_shown_alone(tmp_path, kinds):
    write(tmp_path, "[png, pdf, svg]")
    results = made(tmp_path, {("one", str(n)): [1.0, 2.0] for n in (10, 100, 1000)}, rest=CURVE)
    with style():
        spec = results.plan.experiment.figures["f"]
        assert isinstance(spec, FigureSpec)
        figure = spec.drawn(results, ())
        found = printed(figure, kinds)
    for kind in kinds:
        assert found[kind] == (tmp_path / "out" / f"f.{kind}").read_bytes()


def differences(folder):
    found = compare(folder / "out", folder / "accepted")
    assert not found.allowed
    return [*found.differences], [*found.left_out]


def test_files_that_one_side_was_not_asked_for_are_no_difference(tmp_path):
    write(tmp_path, "[png, pdf, tex]")
    write(tmp_path, "[png]", out="accepted")
    assert differences(tmp_path) == ([], [])
    (tmp_path / "out" / "f.png").unlink()
    assert "accepted/f.png: missing" in differences(tmp_path)[0]


def test_a_figure_in_no_format_of_both_is_named(tmp_path):
    write(tmp_path, "[svg]")
    write(tmp_path, "[png]", out="accepted")
    assert differences(tmp_path) == (
        [],
        ["accepted: f, in no format that both sides have"],
    )


def test_a_stray_file_in_a_known_format_is_extra(tmp_path):
    write(tmp_path, "[png]")
    write(tmp_path, "[png]", out="accepted")
    (tmp_path / "out" / "f.pdf").write_bytes(b"%PDF")
    assert differences(tmp_path)[0] == ["accepted/f.pdf: extra, the reference lacks it"]


@pytest.mark.parametrize("kind", ["pdf", "svg"])
def test_another_curve_is_another_drawing_and_a_last_bit_is_not(tmp_path, kind):
    for name, gain in (("a", 1.0), ("near", 1.0 + 1e-9), ("far", 1.1)):
        write(tmp_path, f"[{kind}]", gain, out=name)

    files = {name: tmp_path / name / f"f.{kind}" for name in ("a", "near", "far")}
    assert list(content_differences(files["near"], files["a"], 1e-6)) == []
    [said] = content_differences(files["far"], files["a"], 1e-6)
    assert said.startswith("another drawing: ")


@pytest.mark.parametrize("kind", ["pdf", "svg"])
def test_a_broken_drawing_is_a_difference(tmp_path, kind):
    write(tmp_path, f"[{kind}]")
    broken = tmp_path / f"broken.{kind}"
    broken.write_bytes(b"nothing")
    [said] = content_differences(broken, tmp_path / "out" / f"f.{kind}", 1e-6)
    assert said.startswith("cannot be read: it is no ")


@pytest.mark.parametrize("kind", ["pdf", "svg"])
def test_another_letter_is_another_drawing_though_its_number_is_near(tmp_path, kind):
    for label in ("a 0.11", "a 0.12"):
        rest = CURVE.replace("y_label: error", f"y_label: {label}") + f"formats: {kind}\n"
        results = made(tmp_path, {}, rest=rest)
        Outputs(results.plan, tmp_path / label).write(results, {})
    one, other = (tmp_path / label / f"f.{kind}" for label in ("a 0.11", "a 0.12"))
    assert [*content_differences(one, other, 1e-6)]
