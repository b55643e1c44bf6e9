"""Records from files: what is read to the last bit, and what is said of the rest."""

import numpy as np
import pytest

import hident as hi
from hident.errors import ConfigError
from hident.measurements.columns import SPLIT

U, Y = np.random.default_rng(5).normal(size=(2, 40))


def written(folder, text, name="valve.csv", encoding="utf-8"):
    path = folder / name
    path.write_text(text, encoding=encoding)
    return path


def said(path, **columns):
    with pytest.raises(ConfigError) as caught:
        hi.read(path, **({"input": "u", "output": "y"} | columns))
    return str(caught.value).removeprefix(f"{path}")


@pytest.mark.parametrize("separator", [",", ";", "\t", ", "])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_a_csv_file_is_read_to_the_last_bit(tmp_path, separator, encoding):
    lines = [
        separator.join(("u", "note", "y")),
        *(f"{u!r}{separator}x{separator}{y!r}" for u, y in zip(U.tolist(), Y.tolist(), strict=True)),
    ]
    record = hi.read(
        written(tmp_path, "\n".join([*lines, "", ""]), encoding=encoding), input="u", output="y", dt=0.1
    )
    assert record.u.tobytes() == U.tobytes()
    assert record.y.tobytes() == Y.tobytes()
    assert record.dt == 0.1
    assert record.truth is None


def test_an_npz_file_is_read_to_the_last_bit(tmp_path):
    path = tmp_path / "valve.npz"
    np.savez(path, u=U, y=Y, t=np.arange(40) * 0.5, count=np.arange(40))
    record = hi.read(str(path), input="u", output="y", time="t")
    assert (record.u.tobytes(), record.y.tobytes(), record.dt) == (U.tobytes(), Y.tobytes(), 0.5)
    assert hi.read(path, input="count", output="y").u.dtype == np.float64


def test_times_give_the_interval_or_are_refused(tmp_path):
    path = written(tmp_path, "t,u,y\n0,1,2\n0.1,1,2\n0.2,1,2\n")
    assert hi.read(path, input="u", output="y", time="t").dt == pytest.approx(0.1, rel=1e-12)
    path = written(tmp_path, "t,u,y\n0,1,2\n0.1,1,2\n0.3,1,2\n")
    assert said(path, time="t").startswith(": column 't': the times are uneven: 0.1 follows 0 (sample 2), ")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("u,out\n1,2\n", ": there is no column 'y' (the file has: u, out)"),
        ("U,y\n1,2\n", ": there is no column 'u'; did you mean 'U'? (the file has: U, y)"),
        ("u,y,u\n1,2,3\n", ": there is more than one column 'u' (the file has: u, y, u)"),
        ("", ": there is no column 'u' (the file has: )"),
        ("u,y\n", ": holds no samples"),
        ("u,y\n1,2\n3\n", ":3: has 1 columns, where the first line names 2"),
        ("u,y\n1,2\n\n3,x1\n", ":4: column 'y': must be a finite number (got 'x1')"),
        ("u,y\n1,2\n3,\n", f":3: column 'y': must be a finite number (got ''){SPLIT}"),
        ("u,y\n1,nan\n", f":2: column 'y': must be a finite number (got 'nan'){SPLIT}"),
        ("u,y\n1,1_0\n", ":2: column 'y': must be a finite number (got '1_0')"),
    ],
)
def test_what_is_wrong_with_a_csv_file(tmp_path, text, message):
    assert said(written(tmp_path, text)) == message


def test_what_is_wrong_with_the_columns_of_an_npz_file(tmp_path):
    path = tmp_path / "valve.npz"
    flawed = np.where(np.arange(40) == 7, np.inf, Y)
    np.savez(path, u=U, y=Y, short=Y[:3], table=np.ones((2, 2)), flawed=flawed, things=np.array([{}, 1]))
    assert (
        said(path, output="z")
        == ": there is no column 'z' (the file has: u, y, short, table, flawed, things)"
    )
    assert said(path, output="short") == ": column 'short': has 3 samples, where 'u' has 40"
    assert said(path, output="flawed") == ": column 'flawed': sample 8: must be a finite number (got inf)"
    assert said(path, output="things") == ": holds what is no array of numbers"
    assert said(path, output="table") == (
        ": column 'table': must be an array of numbers of shape (N,), not float64 of (2, 2)"
    )


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("valve.npz", b"no archive", ": cannot be read: it is no NPZ file"),
        ("valve.csv", b"u,y\n\x81,1\n", ": cannot be read: it is no CSV file"),
        ("valve.csv", b"u,y\n\xff,1\n", ":2: column 'u': must be a finite number (got 'ÿ')"),
        (
            "valve.xlsx",
            b"",
            ": the name must end in .csv, .tsv, .txt, .dat, .parquet, .mat, .npz, .h5 or .hdf5",
        ),
    ],
)
def test_what_is_no_such_file(tmp_path, name, content, message):
    path = tmp_path / name
    path.write_bytes(content)
    assert said(path) == message
    path.unlink()
    if name != "valve.xlsx":
        assert said(path) == ": no such file"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"dt": 0.1, "time": "t"}, "give 'dt' or 'time', not both"),
        ({"dt": 0}, "dt must be a number > 0 (got 0)"),
        ({"dt": float("nan")}, "dt must be a number > 0 (got nan)"),
    ],
)
def test_what_is_wrong_with_the_interval(given, message):
    assert said("valve.csv", **given) == message
