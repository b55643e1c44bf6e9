"""Columns of files: every format is read to the last bit, and what is wrong with a file is said."""

import random

import numpy as np
import pytest
from scipy.io import savemat

from hident.errors import ConfigError
from hident.measurements.columns import SPLIT
from hident.measurements.files import SUFFIXES, read_columns

U, Y = np.random.default_rng(8).normal(size=(2, 50))
NO_NUMBER = ": column 'u': must be a finite number"
BY_NUMBER = ": the file does not name its columns, so they go by number, 1 to 2"


def written(folder, content, name="valve.csv"):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def said(path, wanted=("u", "y"), **options):
    with pytest.raises(ConfigError) as caught:
        read_columns(path, list(wanted), **options)
    return str(caught.value).removeprefix(f"{path}")


def columns(path, *wanted, **options):
    return [column.tolist() for column in read_columns(path, list(wanted), **options)]


def assert_read(path, *wanted):
    u, y = read_columns(path, list(wanted))
    assert (u.tobytes(), y.tobytes()) == (U.tobytes(), Y.tobytes())
    assert u.dtype == y.dtype == np.float64


@pytest.mark.parametrize("separator", [",", ";", "\t", " ", "   ", " \t "])
@pytest.mark.parametrize("trailing", [False, True])
@pytest.mark.parametrize("names", [True, False])
@pytest.mark.parametrize("suffix", [".csv", ".txt", ".dat", ".tsv"])
def test_text_is_read_to_the_last_bit(tmp_path, separator, trailing, names, suffix):
    rows = [
        [repr(0.1 * k), repr(u), repr(y)] for k, (u, y) in enumerate(zip(U.tolist(), Y.tolist(), strict=True))
    ]
    lines = [separator.join(row) + separator * trailing for row in ([["t", "u", "y"]] * names + rows)]
    path = written(tmp_path, "\r\n".join([*lines, ""]), f"valve{suffix}")
    assert_read(path, 2, 3)
    assert_read(path, "2", "3")
    if names:
        assert_read(path, "u", "y")


def test_a_name_goes_before_a_number_in_a_text(tmp_path):
    path = written(tmp_path, "u,1\n5,6\n7,8\n")
    assert columns(path, "1", "u") == [[6.0, 8.0], [5.0, 7.0]]
    assert said(path, [2]) == ":1: holds numbers ('1') as well as what is none ('u')"


def test_what_is_not_asked_for_may_be_missing(tmp_path):
    path = written(tmp_path, '"u","y","Ts",\n1,2,4,\n3,4,,\n5,6,,\n')
    assert columns(path, "u", "y") == [[1.0, 3.0, 5.0], [2.0, 4.0, 6.0]]
    assert said(path, ["Ts", "y"]) == f":3: column 'Ts': must be a finite number (got ''){SPLIT}"


def test_names_may_hold_separators_and_letters_of_old_programs(tmp_path):
    path = written(tmp_path, '"flow, l/min";"T in °C"\n1;2\n3;4\n'.encode("latin-1"))
    assert columns(path, "flow, l/min", "T in °C") == [[1.0, 3.0], [2.0, 4.0]]


@pytest.mark.parametrize("encoding", ["cp1252", "utf-8", "utf-8-sig", "utf-16"])
def test_what_spreadsheets_write_is_read(tmp_path, encoding):
    lines = ["sep=;", "Füllstand [cm];Öffnung;Bemerkung", "1,5;2;läuft, gut", "2,5;3;", ""]
    path = written(tmp_path, "\r\n".join(lines).encode(encoding))
    assert columns(path, "Füllstand [cm]", "Öffnung") == [[1.5, 2.5], [2.0, 3.0]]
    flawed = written(tmp_path, "\r\n".join([*lines[:3], "x;3;"]).encode(encoding), "flawed.csv")
    assert said(flawed, ["Füllstand [cm]"]).startswith(":4: column 'Füllstand [cm]': must be a finite number")


def test_a_line_that_names_the_separator_is_believed(tmp_path):
    path = written(tmp_path, "SEP=,\nu,y;z\n1,2;3\n")
    assert columns(path, "u") == [[1.0]]


@pytest.mark.parametrize(
    "error", ["#DIV/0!", "#WERT!", "#VALUE!", "#NUM!", "#ZAHL!", "#REF!", "#NAME?", "#NV", "#N/A"]
)
def test_what_a_spreadsheet_could_not_compute_is_missing(tmp_path, error):
    path = written(tmp_path, f"u,y\n1,2\n{error},3\n4,5\n")
    np.testing.assert_array_equal(read_columns(path, ["u"], blanks=True)[0], [1.0, np.nan, 4.0])
    assert said(path) == f":3{NO_NUMBER} (got '{error}'){SPLIT}"


def test_numbers_in_quotation_marks_and_comments_before_the_first_line(tmp_path):
    path = written(tmp_path, '# made by a logger\n%\n\n"u","y"\n"1","2"\n\n"3","4"\n')
    assert columns(path, "u", "y") == [[1.0, 3.0], [2.0, 4.0]]


def test_missing_values_are_nan_where_they_may_be(tmp_path):
    path = written(tmp_path, "u,y\n1,2\n,NA\nnan,3\n4,5\n")
    u, y = read_columns(path, ["u", "y"], blanks=True)
    np.testing.assert_array_equal(u, [1, np.nan, np.nan, 4])
    np.testing.assert_array_equal(y, [2, np.nan, 3, 5])
    assert said(written(tmp_path, "u,y\n1,x\n"), blanks=True).endswith("(got 'x')")
    assert said(written(tmp_path, "u,y\n1,inf\n"), blanks=True).endswith("(got 'inf')")


def test_the_quick_reader_finds_what_the_careful_pass_finds(tmp_path):
    """Random damage: with and without a quoted cell, for which only the careful pass goes, all is alike."""
    draw = random.Random(3)
    cells = ["1", "-2.5e-3", " 7 ", "", "nan", "1_0", "0x10", "1,5", "1e400", "x", "1+2j", "infinity", "1d5"]
    for _ in range(100):
        rows = [
            [draw.choice(cells[: draw.choice([3, 13])]) for _ in range(draw.choice([3, 3, 3, 3, 2, 4]))]
            for _ in "ab"
        ]
        text = "\n".join(map(";".join, rows))
        blanks = draw.random() < 0.5
        found = []
        for first in ("a;b;c", '"a";b;c'):
            for mark in ("", '\n"1";2;3'):
                path = written(tmp_path, f"{first}\n{text}{mark}\n")
                try:
                    read = read_columns(path, ["a", "c"], blanks=blanks)
                    found.append(repr([column.tolist()[:2] for column in read]))
                except ConfigError as error:
                    found.append(str(error))
        assert len(set(found)) == 1, (text, found)


def test_arrays_are_read_to_the_last_bit(tmp_path):
    np.savez(tmp_path / "valve.npz", u=U, y=Y[:, None])
    assert_read(tmp_path / "valve.npz", "u", "y")
    assert_read(tmp_path / "valve.npz", 1, 2)
    np.savez(tmp_path / "table.npz", np.column_stack([U, Y]))
    assert_read(tmp_path / "table.npz", 1, 2)
    assert said(tmp_path / "table.npz", ["u", 2]) == (f": there is no column 'u'{BY_NUMBER}")


@pytest.mark.parametrize("oned_as", ["row", "column"])
def test_a_mat_file_is_read_to_the_last_bit_with_its_structures(tmp_path, oned_as):
    path = tmp_path / "valve.mat"
    savemat(path, {"u": U, "data": {"y": Y, "name": "valve", "more": {"t": U}}}, oned_as=oned_as)
    assert_read(path, "u", "data.y")
    assert_read(path, "data.more.t", "data.y")
    assert said(path, ["u", "data.z"]) == (
        ": there is no column 'data.z'; did you mean 'data.y'? "
        "(the file has: u, data.y, data.name, data.more.t)"
    )
    assert "must be an array of numbers" in said(path, ["u", "data.name"])


def test_a_parquet_file_is_read_to_the_last_bit(tmp_path):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "valve.parquet"
    texts, on = ["x"] * 50, [None, *[True, False] * 24, True]
    pq.write_table(pa.table({"u": U, "y": Y, "text": texts, "on": on, "n": [*range(49), None]}), path)
    assert_read(path, "u", "y")
    assert_read(path, 1, 2)
    assert said(path, ["u", "text"]) == ": column 'text': must hold numbers, not string"
    assert "must be a finite number (got nan)" in said(path, ["u", "n"])
    assert np.isnan(read_columns(path, ["n"], blanks=True)[0][49])
    assert said(path, ["u", "Y"]).startswith(": there is no column 'Y'; did you mean 'y'?")


def test_an_hdf5_file_is_read_to_the_last_bit(tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "valve.h5"
    with h5py.File(path, "w") as file:
        file["u"], file["run/y"] = U, Y[:, None]
    assert_read(path, "u", "run/y")
    assert said(path, ["u", "run/z"]).startswith(": there is no column 'run/z'; did you mean 'run/y'?")


def test_a_mat_file_of_version_7_3_is_read_as_hdf5(tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "valve.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["u"], file["y"] = U[None], Y[None]
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    assert_read(path, "u", "y")


def test_without_h5py_a_message_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    assert said(written(tmp_path, head.ljust(600), "valve.mat")) == (
        ": a MAT file of version 7.3 is HDF5: reading it needs h5py: pip install 'hident[hdf5]', or save it "
        "in MATLAB with '-v7'"
    )
    assert said(written(tmp_path, b"", "valve.h5")) == ": reading HDF5 needs h5py: pip install 'hident[hdf5]'"


def test_without_pyarrow_a_message_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    assert said(written(tmp_path, b"", "valve.parquet")) == (
        ": reading Parquet needs pyarrow: pip install 'hident[parquet]'"
    )


@pytest.mark.parametrize(
    ("text", "wanted", "message"),
    [
        ("1,2\n3,4\n", ["u", 2], f": there is no column 'u'{BY_NUMBER}"),
        ("1,2\n3,4\n", [1, 3], ": there is no column 3 (the file has 2)"),
        ("u,y\n3,4\n", [0, 1], ": there is no column 0 (the file has 2: u, y)"),
        ("1,2\n3,4,5\n", [1, 2], ":2: has 3 columns, where the first line has 2"),
        ("1,2\n3,x\n", [1, 2], ":2: column 2: must be a finite number (got 'x')"),
        ("1,x\n3,4\n", [1, 2], ":1: holds numbers ('1') as well as what is none ('x')"),
        (
            "u,y\nu,y\n1,2\n",
            ["u", "y"],
            f":2{NO_NUMBER} (got 'u'); the names of the columns stand here once more",
        ),
        ("u,y\n[V],[m]\n1,2\n", ["u", "y"], ":2: column 'u': must be a finite number (got '[V]')"),
        ("u,y\n1e400,2\n", ["u", "y"], ":2: column 'u': must be a finite number (got '1e400')"),
        ("u,y\n1+2j,2\n", ["u", "y"], ":2: column 'u': must be a finite number (got '1+2j')"),
    ],
)
def test_what_is_wrong_with_text(tmp_path, text, wanted, message):
    assert said(written(tmp_path, text), wanted) == message


@pytest.mark.parametrize(
    "text",
    [
        "u;y\n1,5;2,3\n-0,25;1e1\n3;,5\n",
        "u\ty\n1,5\t2,3\n-0,25\t1e1\n3\t,5\n",
        "u y\n1,5 2,3\n-0,25 1e1\n3,0 ,5\n",
        'u,y\n"1,5","2,3"\n"-0,25","1e1"\n"3",",5"\n',
        "1,5;2,3\n-0,25;1e1\n3,0;0,5\n",
        "\ufeffu;y;Datum\r\n1,5;2,3;01.02.2024 10:00\r\n-0,25;10;x.y\r\n3;0,5;\r\n",
    ],
)
def test_decimal_commas_are_read_where_they_cannot_be_anything_else(tmp_path, text):
    path = written(tmp_path, text)
    expected = [[1.5, -0.25, 3.0], [2.3, 10.0, 0.5]]
    assert columns(path, 1, 2) == expected
    assert columns(path, 1, 2, decimal=",") == expected


def test_a_german_table_has_the_values_of_the_english_one(tmp_path):
    rows = [(repr(u), repr(y)) for u, y in zip(U.tolist(), Y.tolist(), strict=True)]
    lines = ["Ventil [%];Temperatur [°C]", *(f"{u};{y}".replace(".", ",") for u, y in rows)]
    path = written(tmp_path, "\r\n".join([*lines, ""]).encode("cp1252"))
    assert_read(path, "Ventil [%]", "Temperatur [°C]")
    gap = written(tmp_path, "u;y\n1,5;2,3\n#NV;1,0\n", "gap.csv")
    np.testing.assert_array_equal(read_columns(gap, ["u"], blanks=True)[0], [1.5, np.nan])


def test_a_comma_that_may_be_one_of_thousands_is_asked_about(tmp_path):
    path = written(tmp_path, "u;y\n98,628;7\n99,123;8\n")
    assert said(path) == (
        ":2: '98,628' may be 98.628 or 98628: if the comma stands before decimals, "
        "say so by 'decimal: \",\"' (--decimal ,)"
    )
    assert columns(path, "u", "y", decimal=",") == [[98.628, 99.123], [7.0, 8.0]]
    assert said(path, decimal=".") == (
        f":2{NO_NUMBER} (got '98,628'); by 'decimal', numbers are written with a decimal point"
    )
    # One number tells.
    assert columns(written(tmp_path, "u;y\n98,628;7\n0,123;8\n"), "u") == [[98.628, 0.123]]


@pytest.mark.parametrize("number", ["1.5", "1.234,5"])
def test_points_and_commas_together_are_refused(tmp_path, number):
    path = written(tmp_path, f"u;y\n1,5;2,3\n{number};1,0\n")
    assert said(path) == f":3{NO_NUMBER} (got '{number}'); numbers are written with a decimal comma here"


def test_of_many_columns_a_message_names_some(tmp_path):
    path = written(tmp_path, ",".join(f"c{k}" for k in range(1000)) + "\n")
    assert said(path).endswith("c38, c39, and 960 more)")


def test_complex_numbers_are_refused(tmp_path):
    np.savez(tmp_path / "valve.npz", u=U + 1j, y=Y)
    assert said(tmp_path / "valve.npz") == (
        ": column 'u': must be an array of numbers of shape (N,), not complex128 of (50,)"
    )


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_junk_is_no_file_of_any_kind(tmp_path, suffix):
    if suffix in (".h5", ".hdf5"):
        pytest.importorskip("h5py")
    for seed in range(20):
        junk = written(tmp_path, np.random.default_rng(seed).bytes(3000), f"valve{suffix}")
        assert said(junk) == f": cannot be read: it is no {suffix[1:].upper()} file"


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_an_empty_file_a_folder_and_none(tmp_path, suffix):
    if suffix in (".h5", ".hdf5"):
        pytest.importorskip("h5py")
    path = tmp_path / f"valve{suffix}"
    assert said(path) == ": no such file"
    path.mkdir()
    assert said(path) == ": is a folder; name a file"
    path.rmdir()
    assert said(written(tmp_path, b"", path.name)).startswith((": cannot be read: it is no", ": there is no"))


def test_a_broken_archive_is_refused_wherever_it_is_broken(tmp_path):
    np.savez_compressed(tmp_path / "whole.npz", u=U, y=Y)
    savemat(tmp_path / "whole.mat", {"u": U, "y": Y}, do_compression=True)
    draw = random.Random(1)
    for name in ("whole.npz", "whole.mat"):
        content = (tmp_path / name).read_bytes()
        for _ in range(150):
            place = draw.randrange(len(content))
            damaged = bytearray(content)
            damaged[place] ^= 1 << draw.randrange(8)
            cut = content[:place]
            for broken in (bytes(damaged), cut):
                path = written(tmp_path, broken, f"broken{name[-4:]}")
                try:
                    read_columns(path, ["u", "y"])
                except ConfigError as error:
                    assert str(error).startswith(f"{path}: ")


@pytest.mark.parametrize(
    "dates",
    [
        ["2024-02-29T23:59:59.5", "2024-03-01T00:00:00", "2024-03-01T00:00:00.500"],
        ["2024-02-29 23:59:59,5", "2024-03-01 00:00:00", "2024-03-01 00:00:00,5"],
        ["2024-02-29T23:59:59.5Z", "2024-03-01T01:00:00+01:00", "2024-03-01T00:00:00.5Z"],
        ["29.02.2024 23:59:59,5", "1.3.2024 0:00:00", "01.03.2024 00:00:00,5"],
    ],
)
@pytest.mark.parametrize("names", ["t;u\n", ""])
def test_dates_are_seconds_since_the_first_one(tmp_path, dates, names):
    path = written(tmp_path, names + "".join(f"{date};{k},25\n" for k, date in enumerate(dates)))
    expected = [[0.0, 0.5, 1.0], [0.25, 1.25, 2.25]]
    assert [c.tolist() for c in read_columns(path, [1, 2], times=1)] == expected
    # A date is no value of a signal.
    assert "must be a finite number (got '" in said(path, [1, 2])


def test_a_date_that_is_missing_or_none_is_said(tmp_path):
    path = written(tmp_path, "t,u\n2024-03-01,1\n,2\n2024-03-02,3\n")
    t, _ = read_columns(path, ["t", "u"], times="t", blanks=True)
    np.testing.assert_array_equal(t, [0.0, np.nan, 86400.0])
    assert said(path, ["t"], times="t") == f":3: column 't': must be a finite number (got ''){SPLIT}"
    asked = "the times must be numbers, or dates such as 2024-03-01 12:00:00.5 or 01.03.2024 12:00"
    for before, text in (("", "12:00:00"), ("", "03/01/2024 12:00"), ("2024-03-01,1\n", "7")):
        path = written(tmp_path, f"t,u\n{before}{text},1\n")
        line = 2 + before.count("\n")
        assert said(path, ["t"], times="t") == f":{line}: {asked} (got '{text}')"
    path = written(tmp_path, "t,u\n2024-03-01T12:00,1\n2024-03-01T12:01Z,2\n")
    assert said(path, ["t"], times="t") == (
        ":3: all times must have an offset from UTC, or none (got '2024-03-01T12:01Z')"
    )


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
@pytest.mark.parametrize("zone", [None, "Europe/Berlin"])
def test_dates_in_parquet_are_seconds_too(tmp_path, unit, zone):
    pa = pytest.importorskip("pyarrow")
    pq = pytest.importorskip("pyarrow.parquet")
    scale = {"ms": 1, "us": 1000, "ns": 10**6}[unit]
    t = pa.array([scale * (1_700_000_000_000 + k) for k in (0, 1, 2)], pa.timestamp(unit, zone))
    path = tmp_path / "valve.parquet"
    pq.write_table(pa.table({"t": t, "u": [1.0, 2.0, 3.0]}), path)
    assert [c.tolist() for c in read_columns(path, ["t", "u"], times="t")] == [[0, 0.001, 0.002], [1, 2, 3]]
    assert "column 't': must hold numbers, not timestamp" in said(path, ["t"])
    holed = pa.array([None, scale * 1000, scale * 3000], pa.timestamp(unit, zone))
    pq.write_table(pa.table({"t": holed}), path)
    np.testing.assert_array_equal(read_columns(path, ["t"], times="t", blanks=True)[0], [np.nan, 0, 2])
    assert said(path, ["t"], times="t").endswith(f"sample 1: must be a finite number (got nan){SPLIT}")
