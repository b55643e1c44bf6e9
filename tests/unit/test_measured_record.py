"""The ``record:`` of a configuration: what its fields mean, and what they refuse."""

import hashlib

import numpy as np
import pytest

import hident as hi
from hident.config.spec import canonical
from hident.errors import ConfigError
from hident.measurements.columns import SPLIT
from hident.measurements.measured_record import MeasuredRecord
from tests.shared_data import measured

TABLE = np.round(np.random.default_rng(4).normal(size=(100, 5)), 4)
NAMES = ("t", "u1", "u2", "y1", "y2")


@pytest.fixture
def folder(tmp_path):
    table = TABLE.copy()
    table[:, 0] = np.arange(100) * 0.5
    for name, rows in (("valve", table), ("other", table[::-1] * [-1, 1, 1, 1, 1])):
        np.savetxt(
            tmp_path / f"{name}.csv", rows, delimiter=",", header=",".join(NAMES), comments="", fmt="%.9g"
        )
    return tmp_path


def spec(**fields):
    return MeasuredRecord(**{"file": "valve.csv", "input": "u1", "output": "y1"} | fields)


def column(name):
    return TABLE[:, NAMES.index(name)]


def refused(folder=None, **fields):
    with pytest.raises(ConfigError) as caught:
        spec(**fields).read(folder)
    return str(caught.value).removeprefix("MeasuredRecord: ").replace(f"{folder}/", "")


def test_the_columns_of_a_file_by_name_and_number(folder):
    record = spec(dt="1/2", units={"input": "V", "time": "s"}).read(folder)
    np.testing.assert_array_equal(record.u, column("u1"))
    np.testing.assert_array_equal(record.y, column("y1"))
    assert (record.dt, record.parts, record.validation) == (0.5, {}, None)
    assert (record.units, record.offsets) == ({"input": "V", "time": "s"}, {})
    by_number = spec(input=2, output=4, time=1).read(folder)
    assert (by_number.u.tobytes(), by_number.dt) == (record.u.tobytes(), 0.5)


def test_columns_are_experiments(folder):
    record = spec(input=["u1", "u2"], output=["y1", "y2"], estimation="11..20").read(folder)
    assert {name: part.samples for name, part in record.parts.items()} == {
        "y1": slice(0, 10),
        "y2": slice(10, 20),
    }
    np.testing.assert_array_equal(record.y[10:], column("y2")[10:20])
    assert list(spec(output=["y1", "y2"]).read(folder).parts) == ["y1", "y2"]


def test_files_are_experiments(folder):
    record = spec(file=["valve.csv", "other.csv"], time="t").read(folder)
    assert list(record.parts) == ["valve", "other"]
    np.testing.assert_array_equal(record.u[100:], column("u1")[::-1])
    assert [part.dt for part in record.parts.values()] == [0.5, 0.5]


def test_gaps_end_parts_when_asked(folder):
    (folder / "gap.csv").write_text("u1,y1\n1,2\n3,4\n,5\n6,7\n8,9\n")
    record = spec(file="gap.csv", gaps="split", input=[1], output=2).read(folder)
    assert {name: part.samples for name, part in record.parts.items()} == {
        "gap 1": slice(0, 2),
        "gap 2": slice(2, 4),
    }
    assert (
        refused(folder, file="gap.csv") == f"gap.csv:4: column 'u1': must be a finite number (got ''){SPLIT}"
    )
    (folder / "gap.csv").write_text("u1,y1\n1,\n")
    assert (
        refused(folder, file="gap.csv", gaps="split")
        == "gap.csv: holds no two samples without a gap between them"
    )


def test_codes_for_missing_samples_are_gaps(folder):
    (folder / "code.csv").write_text("u1,y1\n1,2\n3,4\n5,-9999\n6,7\n1e30,9\n10,11\n12,13\n")
    coded = {"file": "code.csv", "missing": [-9999, "1e30"]}
    record = spec(**coded, gaps="split").read(folder)
    assert (record.u.tolist(), record.y.tolist()) == ([1, 3, 10, 12], [2, 4, 11, 13])
    assert list(record.parts) == ["code 1", "code 2"]
    assert refused(folder, **coded) == (f"code.csv: column 'u1': sample 5 is missing (1e+30){SPLIT}")
    single = np.array([1, 2, 1e30, 3, 4], dtype=np.float32)
    np.savez(folder / "single.npz", u1=single, y1=single[::-1])
    assert len(spec(file="single.npz", missing=1e30, gaps="split").read(folder).parts) == 2
    # Times may come to any number.
    (folder / "times.csv").write_text("t,u1,y1\n9998,1,2\n9999,2,3\n10000,3,4\n")
    assert len(spec(file="times.csv", time="t", missing=9999, gaps="split").read(folder)) == 3


@pytest.mark.parametrize(
    ("validation", "u"),
    [
        ("61..100", column("u1")[60:]),
        ("u2,y2", column("u2")),
        (["u2", 5], column("u2")),
        ("other.csv", column("u1")[::-1]),
        ({"file": "other.csv", "samples": "..30"}, column("u1")[:-31:-1]),
        ({"input": "u2", "output": "y2", "samples": "5..8"}, column("u2")[4:8]),
    ],
)
def test_what_is_for_validation(folder, validation, u):
    record = spec(estimation="1..60", validation=validation, dt=2).read(folder)
    np.testing.assert_array_equal(record.u, column("u1")[:60])
    np.testing.assert_array_equal(record.validation.u, u)
    assert record.validation.dt == 2


def test_the_mean_of_the_estimation_samples_is_taken_off_both(folder):
    record = spec(estimation="1..60", validation="61..", detrend="mean").read(folder)
    mean = column("y1")[:60].mean()
    assert record.offsets["output"] == pytest.approx(mean, rel=1e-12)
    np.testing.assert_allclose(record.y, column("y1")[:60] - mean, atol=1e-15)
    np.testing.assert_allclose(record.validation.y, column("y1")[60:] - mean, atol=1e-15)
    assert record.validation.offsets == record.offsets


def test_an_offset_a_line_and_decimation(folder):
    shifted = spec(offset={"output": 2}).read(folder)
    np.testing.assert_array_equal(shifted.y, column("y1") - 2)
    assert shifted.offsets == {"input": 0, "output": 2}
    assert abs(spec(detrend="linear").read(folder).y.mean()) < 1e-14
    slow = spec(dt=0.5, decimate=4).read(folder)
    assert (len(slow), slow.dt) == (25, 2.0)
    assert refused(folder, decimate=5) == "valve.csv: decimation by 5 needs more than 101 samples, not 100"


def test_uneven_times_are_interpolated_only_when_asked(folder):
    (folder / "uneven.csv").write_text("t,u1,y1\n0,0,5\n1,1,5\n3,3,5\n4,4,5\n")
    assert refused(folder, file="uneven.csv", time="t").startswith(
        "uneven.csv: column 't': the times are 1 apart and have a hole: 3 follows 1 (sample 3); 'gaps: split'"
    )
    record = spec(file="uneven.csv", time="t", resample=0.5).read(folder)
    assert (record.dt, record.u.tolist()) == (0.5, [0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5, 4])


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"input": 0}, "input: must be a column's number from 1, or its name (got 0)"),
        ({"input": []}, "input: must be a list of at least 1 (got [])"),
        ({"time": ["t"]}, "time: must be the name of a column or its number (got ['t'])"),
        ({"dt": 1, "time": "t"}, "time: give 'dt' or 'time', not both (got 't')"),
        ({"resample": 1}, "resample: needs the column of the sampling times: give 'time' (got 1)"),
        ({"detrend": "mean", "offset": {}}, "offset: give 'detrend' or 'offset', not both"),
        (
            {"estimation": "5..1"},
            "estimation: must be a range FIRST..LAST with 1 <= FIRST <= LAST (got '5..1')",
        ),
        ({"estimation": "1..200"}, "valve.csv: has 100 samples, fewer than 1..200 needs"),
        (
            {"validation": "61..100"},
            "validation: is a range of the samples to estimate from: "
            "give 'estimation', a range, too (got '61..100')",
        ),
        (
            {"validation": "61..100", "estimation": "1.."},
            "validation: shares samples with 'estimation' (1..) (got '61..100')",
        ),
        (
            {"validation": "u2"},
            "validation: must be a range of samples such as 801..1000, two columns "
            "such as 'uVal,yVal', a file, also with its columns as 'other.csv,u,y', or a mapping of "
            "'file', 'input', 'output' and 'samples' (got 'u2')",
        ),
        (
            {"validation": "100..61", "estimation": "1..60"},
            "validation: must be a range FIRST..LAST with 1 <= FIRST <= LAST (got '100..61')",
        ),
        (
            {"validation": "other.csv,u1,x"},
            "other.csv: there is no column 'x' (the file has: t, u1, u2, y1, y2)",
        ),
        ({"validation": {}}, "validation: must name a file, columns or a range of samples"),
        ({"validation": "u2,y3"}, "valve.csv: there is no column 'y3' (the file has: t, u1, u2, y1, y2)"),
        (
            {"input": ["u1", "u2"], "output": ["y1", "y2", "t"]},
            "'input' lists 2 (u1, u2) and 'output' 3: one is for all experiments, or one for each",
        ),
        ({"input": "y1"}, "the input and the output are one column, 'y1'"),
        (
            {"input": ["u1", "u2"], "output": "y1"},
            "valve.csv: the output 'y1' has two inputs, 'u1' and 'u2': a list is one of "
            "experiments, each with an output of its own, and a model has one input",
        ),
        ({"gaps": "skip"}, "gaps: must be 'error' or 'split' (got 'skip')"),
    ],
)
def test_what_is_refused(folder, fields, message):
    assert refused(folder, **fields) == message


def test_numbers_too_large_to_be_prepared_are_refused(folder):
    (folder / "large.csv").write_text("u1,y1\n1,1e308\n2,1e308\n3,-1e308\n")
    assert (
        refused(folder, file="large.csv", detrend="mean")
        == "large.csv: the numbers are too large to be prepared"
    )
    assert spec(file="large.csv").read(folder).y[2] == -1e308


def test_the_digest_is_that_of_the_bytes(folder):
    def sha256(content):
        return hashlib.sha256(content).hexdigest()

    one, other = (sha256((folder / f"{name}.csv").read_bytes()) for name in ("valve", "other"))
    assert spec().digest(folder) == spec(validation="u2,y2").digest(folder) == one
    both = sha256(f"{one}{other}".encode())
    assert spec(file=["valve.csv", "other.csv"]).digest(folder) == both
    assert spec(validation="other.csv").digest(folder) == both
    assert spec(validation="other.csv, u2, y2") == spec(
        validation={"file": "other.csv", "input": "u2", "output": "y2"}
    )
    with pytest.raises(ConfigError, match=r"none\.csv: cannot be read: no such file or directory"):
        spec(file="none.csv").digest(folder)


def test_a_record_is_written_in_one_way(folder):
    assert canonical(spec(validation="u2,y2", units={})) == canonical(
        spec(file=["valve.csv"], validation={"input": ["u2"], "output": ["y2"]})
    )


def test_read_takes_what_a_configuration_says(folder):
    record = hi.read(
        folder / "valve.csv",
        input="u1",
        output="y1",
        dt=1,
        estimation="1..50",
        validation="51..",
        units={"input": "V"},
    )
    assert record.validation is not None
    assert (len(record), len(record.validation), record.units) == (50, 50, {"input": "V"})
    assert len(hi.read([folder / "valve.csv", folder / "other.csv"], input="u1", output="y1").parts) == 2


@pytest.mark.parametrize(
    ("file", "fields", "samples"),
    [
        (
            "cascaded_tanks/dataBenchmark.csv",
            {"input": "uEst", "output": "yEst", "dt": 4, "validation": "uVal,yVal"},
            (1024, 1024),
        ),
        (
            "coupled_drives/estimation.csv",
            {
                "input": ["u11", "u12"],
                "output": ["z11", "z12"],
                "dt": 0.02,
                "estimation": "1..300",
                "validation": "301..",
            },
            (600, 200),
        ),
        ("daisy_heating_system/heating_system.dat", {"input": 2, "output": 3, "time": 1}, (801, 0)),
        ("daisy_exchanger/exchanger.dat", {"input": 2, "output": 3, "time": 1}, (4000, 0)),
        (
            "wiener_hammerstein_2009/estimation.csv",
            {
                "input": "uBenchMark",
                "output": "yBenchMark",
                "dt": "1/51200",
                "estimation": "1..80000",
                "validation": "80001..",
            },
            (80000, 20000),
        ),
    ],
)
def test_public_records_are_read(file, fields, samples):
    path = measured(file)
    record = MeasuredRecord(file=path.name, **fields).read(path.parent)
    assert (len(record), len(record.validation or ())) == samples
