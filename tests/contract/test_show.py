"""hident show: what is printed and written of a measured record, and what is said of bad input."""

import re
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.signal import lfilter

from hident.measurements.measured_record import MeasuredRecord
from tests.documented import ROOT
from tests.forked import run_forked
from tests.shared_data import measured

U = np.random.default_rng(7).normal(size=1000)
Y = lfilter([0, 0, 1], [1, -0.6], U)


@pytest.fixture
def folder(tmp_path):
    rows = np.column_stack([0.5 * np.arange(1000), U, Y, U[::-1], Y[::-1]])
    for name in ("valve", "again"):
        np.savetxt(tmp_path / f"{name}.csv", rows, delimiter=",", header="t,u,y,v,w", comments="")
    return tmp_path


def show(folder, *arguments):
    return run_forked(("show", *arguments), folder)


def test_a_record_is_described(folder):
    ended = show(folder, "valve.csv", "--input", "u", "--output", "y", "--time", "t")
    assert (ended.returncode, ended.stderr) == (0, "")
    lines = ended.stdout.splitlines()
    assert lines[0] == "valve.csv: 1000 samples every 0.5"
    assert lines[2].split() == [
        "input",
        f"{U.min():g}",
        "..",
        f"{U.max():g}",
        f"{U.mean():.4g}",
        f"{U.std():.4g}",
        "1000",
        "different",
    ]
    assert lines[4].startswith(
        "delay: 2 samples (1), by the cross-correlation with the input, prewhitened by "
    )
    assert lines[6].split() == [
        "degree",
        "1",
        "lag",
        *(word for lags in ["2", "5", "10", "20"] for word in (lags, "lags")),
    ]
    assert lines[-1] == "nothing looks wrong"


def test_experiments_validation_and_figures(folder):
    ended = show(
        folder,
        "valve.csv",
        "--input",
        "u,2",
        "--output",
        "y,w",
        "--dt",
        "1/2",
        "--estimate",
        "1..900",
        "--validate",
        "901..",
        "--detrend",
        "mean",
        "--out",
        "figures",
    )
    assert (ended.returncode, ended.stderr) == (0, "")
    assert "valve.csv: 1800 samples every 0.5 in 2 experiments\n" in ended.stdout
    assert "\nfor validation: 200 samples every 0.5 in 2 experiments\n" in ended.stdout
    written = sorted(path.name for path in (folder / "figures").iterdir())
    assert written == ["correlation.png", "histogram.png", "signals.png", "spectrum.png"]
    again = show(folder, "valve.csv", "again.csv", "--input", "u", "--output", "y", "--validate", "v,w")
    assert "valve.csv, again.csv: 2000 samples in 2 experiments" in again.stdout


def test_units_are_said(folder):
    ended = show(folder, "valve.csv", "--input", "u", "--output", "y", "--dt", "2", "--units", "V, degC,s")
    assert "valve.csv: 1000 samples every 2 s\n" in ended.stdout
    assert " V  " in ended.stdout and " degC  " in ended.stdout
    some = show(folder, "valve.csv", "--input", "u", "--output", "y", "--dt", "2", "--units", ",degC")
    assert " V  " not in some.stdout and " degC  " in some.stdout
    assert "every 2\n" in some.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("valve.csv", "--input is required: the column of the input, by its name or its number from 1"),
        (
            "valve.csv --input u",
            "--output is required: the column of the output, by its name or its number from 1",
        ),
        (
            "valve.csv --input uu --output y",
            "valve.csv: there is no column 'uu'; did you mean 'u'? (the file has: t, u, y, v, w)",
        ),
        (
            "valve.csv --input u --output y --units V,V,s,Hz",
            "--units: must be at most three, those of the input, the output and time (got 'V,V,s,Hz')",
        ),
        ("valve.csv --input u --output y --dt 0", "--dt: must be greater than 0 (got '0')"),
        ("valve.csv --input u --output y --dt 1 --time t", "--time: give --dt or --time, not both (got 't')"),
        (
            "valve.csv --input u --output y --validate 9..",
            "--validate: is a range of the samples to estimate from: "
            "give --estimate, a range, too (got '9..')",
        ),
        (
            "valve.csv --input u --output y --resample 1",
            "--resample: needs the column of the sampling times: give --time (got '1')",
        ),
        ("valve.csv --input u --output y --detrend no", "--detrend: must be 'mean' or 'linear' (got 'no')"),
        ("none.csv --input u --output y", "none.csv: no such file"),
        (". --input u --output y", ".: is a folder; name a file"),
        (
            "valve.xls --input u --output y",
            "valve.xls: cannot be shown: "
            "the name must end in .csv, .tsv, .txt, .dat, .parquet, .mat, .npz, .h5, .hdf5",
        ),
        ("valve.csv --input u --output y --out valve.csv", "valve.csv cannot be written: file exists"),
    ],
)
def test_bad_input_is_said_in_one_line(folder, arguments, message):
    ended = show(folder, *arguments.split())
    assert (ended.returncode, ended.stderr) == (2, f"error: {message}\n")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\n\n",
        b"u,y\n",
        b"u,y\n1,nan\n",
        b"u,y\n1+2j,3\n",
        b"u,y\nhello,3\n",
        b"u,y\nu,y\n1,2\n",
        b"u,u,y\n1,2,3\n",
        b"u,y\n\xff,1\n",
        "u,y\n1,2\n".encode("utf-16")[:-1],
        np.random.default_rng(0).bytes(4000),
        b"u,y\n" + b"9" * 200_000,
    ],
)
def test_broken_files_end_with_one_line_too(folder, content):
    (folder / "bad.csv").write_bytes(content)
    ended = show(folder, "bad.csv", "--input", "u", "--output", "y")
    assert ended.returncode == 2
    assert ended.stderr.startswith("error: bad.csv")
    assert ended.stderr.count("\n") == 1
    assert len(ended.stderr) < 200


@pytest.mark.parametrize(
    ("numbers", "code"), [("1e307,-1e308", 1), ("1e-320,1e-310", 0), ("5,5", 0), ("0,0", 0)]
)
def test_extreme_numbers_are_shown_and_drawn_if_they_can_be(folder, numbers, code):
    lines = [f"{sign}{numbers}" for sign in ("", "-", "") * 10]
    (folder / "extreme.csv").write_text("\n".join(["u,y", *lines]))
    ended = show(folder, "extreme.csv", "--input", "u", "--output", "y", "--out", "figures")
    assert ended.returncode == code
    assert bool(code) == ("warning: figures/signals.png cannot be drawn (" in ended.stderr)
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize(
    "command",
    [
        "cascaded_tanks/dataBenchmark.csv --input uEst --output yEst --dt 4 --validate uVal,yVal",
        "coupled_drives/estimation.csv --input u11,u12 --output z11,z12 --dt .02",
        "daisy_heating_system/heating_system.dat --input 2 --output 3 --time 1",
        "daisy_exchanger/exchanger.dat --input 2 --output 3 --time 1",
        "wiener_hammerstein_2009/estimation.csv --input uBenchMark --output yBenchMark --dt 1/51200",
    ],
)
def test_public_records_take_one_command(tmp_path, command):
    file, *options = command.split()
    ended = show(tmp_path, str(measured(file)), *options)
    assert (ended.returncode, ended.stderr) == (0, "")


def test_the_documented_section_runs(tmp_path, monkeypatch):
    """docs/measurements.md, Reading a record: its commands, its code and its configuration."""
    page = (ROOT / "docs/measurements.md").read_text(encoding="utf-8")
    section = re.search(r"## Reading a record\n(.*?)(?=\n## |\Z)", page, re.DOTALL)
    assert section
    code = dict(re.findall(r"```(sh|python|yaml)\n(.*?)```", section[1], re.DOTALL))
    monkeypatch.chdir(tmp_path)
    rows = np.column_stack([0.5 * np.arange(1000), U, Y, U[::-1], Y[::-1]])
    np.savetxt("tanks.csv", rows, delimiter=",", header="t,uEst,yEst,uVal,yVal", comments="")
    np.savetxt("heating.dat", rows[:, :3])
    for command in code["sh"].splitlines():
        ended = run_forked(command.split()[1:], tmp_path)
        assert (ended.returncode, ended.stderr) == (0, "")
    space: dict[str, Any] = {}
    exec(code["python"], space)
    record = MeasuredRecord(**yaml.safe_load(code["yaml"])["record"]).read(tmp_path)
    np.testing.assert_array_equal(record.y, space["record"].y - record.offsets["output"])


def test_a_spreadsheet_with_decimal_commas_codes_and_gaps_is_read_step_by_step(tmp_path):
    """Each message names the option that leads on."""
    u, y = U[:300], Y[:300].copy()
    y[[50, 51, 200]] = -9999.0
    rows = (f"{a:.3f};{b:.3f}".replace(".", ",") for a, b in zip(u, y, strict=True))
    (tmp_path / "ofen.csv").write_text("\r\n".join(["u;y", *rows]), encoding="utf-8")
    columns = ("ofen.csv", "--input", "u", "--output", "y")
    said = " ".join(show(tmp_path, *columns).stdout.split())
    assert "-9999 in 3 samples" in said
    assert "(--missing -9999 --gaps split)" in said
    refused = show(tmp_path, *columns, "--missing", "-9999")
    assert refused.stderr == (
        "error: ofen.csv: column 'y': sample 51 is missing (-9999); "
        "'gaps: split' (--gaps split) ends a part at a missing sample\n"
    )
    ended = show(tmp_path, *columns, "--missing", "-9999,-999", "--gaps", "split", "--decimal", ",")
    assert ended.stdout.startswith("ofen.csv: 297 samples in 3 experiments\n")
    assert "missing samples" not in ended.stdout
    refused = show(tmp_path, *columns, "--decimal", "x")
    assert refused.stderr == "error: --decimal: must be '.' or ',' (got 'x')\n"
    refused = show(tmp_path, *columns, "--missing", "none")
    assert refused.stderr.startswith("error: --missing: must be a number")
