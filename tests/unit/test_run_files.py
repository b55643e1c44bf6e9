"""A table or a figure cannot take the name of a file that a run writes itself, nor share one."""

import pytest

from hident.engine.run_files import OWN
from hident.reports.output import Outputs
from tests.unit.plans import planned, refusals

CONFIG = """\
version: 1
title: Names
trials: 2
system: {kind: hammerstein, nonlinearity: identity, linear: {kind: ar, a: [0.5]}}
excitation: {kind: iid, distribution: uniform, low: -1, high: 1}
cases: {samples: [60, 120]}
estimators: {k: {kind: kernel, kernel: gaussian, bandwidth: {h0: 0.2, alpha: 1/5}}}
metrics: {mise: {kind: mise, interval: [-1, 1]}}
"""
RATE = "{kind: rate, title: Slopes, axis: samples, metric: mise, estimators: [k]}"
CURVE = "{kind: curve, x: samples, metric: mise, x_label: N, y_label: MISE}"


def config(tables=(), figures=()):
    text = CONFIG
    for section, names, spec in (("tables", tables, RATE), ("figures", figures, CURVE)):
        if names:
            text += f"{section}:\n" + "".join(f"  {name}: {spec}\n" for name in names)
    return text


def refused(folder, **names):
    return refusals(folder, config(**names))


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("table", "table.csv"),
        ("Table", "table.csv"),
        ("verdicts", "verdicts.csv"),
        ("run", "run.json"),
        ("crashes", "crashes.txt"),
        ("trials", "trials.csv.xz"),
    ],
)
def test_a_table_named_as_a_file_of_every_run_is_refused(tmp_path, name, file):
    assert refused(tmp_path, tables=[name]) == [
        f"a.yaml:10: tables.{name}: the name '{name}' is kept for {file}, which a run writes itself"
    ]


def test_a_table_named_as_the_file_that_accept_writes_beside_those_of_a_run_is_refused(tmp_path):
    assert refused(tmp_path, tables=["sensitivity"]) == [
        "a.yaml:10: tables.sensitivity: the name 'sensitivity' is kept for sensitivity.csv, which accept "
        "writes itself"
    ]


@pytest.mark.parametrize("section", ["tables", "figures"])
@pytest.mark.parametrize("name", ["con", "NUL", "aux", "prn", "com1", "LPT9"])
def test_a_device_of_windows_is_refused(tmp_path, section, name):
    assert refused(tmp_path, **{section: [name]}) == [
        f"a.yaml:10: {section}.{name}: the name '{name}' is that of a device under Windows: take another"
    ]


@pytest.mark.parametrize("section", ["tables", "figures"])
def test_names_that_differ_in_capitals_only_are_one_file(tmp_path, section):
    assert refused(tmp_path, **{section: ["Errors", "errors"]}) == [
        f"a.yaml:11: {section}.errors: would be written to the file of {section}.Errors: take another name"
    ]


def test_a_name_that_is_too_long_for_a_file_is_refused(tmp_path):
    [line] = refused(tmp_path, figures=["x" * 300])
    assert line.endswith("a name has at most 100 characters, not 300")


def test_names_of_a_table_and_a_figure_may_be_one_as_their_files_are_two(tmp_path):
    figures = ["errors", "trials", "table", "sensitivity"]
    plan = planned(tmp_path, config(tables=["errors", "console"], figures=figures))
    assert list(plan.experiment.figures) == figures


def test_the_names_are_those_that_a_run_writes(lab):
    lab.run()
    files = {path.name for path in (lab.folder / "out" / "tiny").iterdir()}
    assert {"run.json", "table.csv", "table.md"} <= files <= {*OWN}


@pytest.mark.parametrize("text", ["", "{", "[]", "[" * 100_000, '{"provenance": 3}'])
def test_a_run_json_that_cannot_be_read_is_altered(tmp_path, text):
    (tmp_path / "run.json").write_text(text)
    assert Outputs(planned(tmp_path, config()), tmp_path).state() == "altered"
