"""The verbs simulate, show and convert: what they print and write, and what they refuse."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import hident as hi
from hident.block_chain import BlockChain
from hident.fitted_model import FittedModel, NoiseModel
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction
from hident.sampled_blocks import SampledTransferFunction
from hident.static_functions import DeadZone, PiecewiseLinear, StaticFunction
from tests.forked import run_forked

VALVE = StaticFunction(PiecewiseLinear((1.0, 2.0, 4.0)), (0.0, 1.2, 2.4))
TANK = TransferFunction(b=(0.0, 0.2), a=(0.8,))
MODEL = FittedModel(
    BlockChain((VALVE, TANK), dt=4.0),
    start="settled",
    noise=NoiseModel(ar=(0.9,), variance=0.01),
    ranges=((1.2, 3.9), (0.2, 2.4)),
    about={"input": "u", "units": {"input": "V", "output": "m", "time": "s"}},
)
U = np.repeat(np.random.default_rng(1).uniform(1.3, 3.8, 12), 5)
Y = MODEL.simulate(U) + 0.1 * np.sin(np.arange(len(U)))


@pytest.fixture
def folder(tmp_path):
    hi.write_model(MODEL, tmp_path / "tank.json")
    save(tmp_path / "tank.csv", t=4.0 * np.arange(len(U)), u=U, y=Y)
    return tmp_path


def save(path, **columns):
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))


def said(folder, command, code=0):
    """What a command printed: standard output if it is fine, or else what it said of the fault."""
    done = run_forked(command.split(), folder)
    assert done.returncode == code, (done.stdout, done.stderr)
    return done.stderr if code else done.stdout


def test_a_simulation_is_told_and_written(folder):
    shown = said(folder, "simulate tank.json tank.csv --compare y --time t --out sim.csv --plot sim.png")
    residual = Y - MODEL.simulate(U)
    rmse = np.sqrt(np.mean(residual**2))
    nrmse = rmse / np.std(Y)
    simulated = MODEL.simulate(U)
    assert shown.splitlines() == [
        "tank.csv: 60 samples of 'u', simulation by N-L",
        f"output from {simulated.min():.5g} to {simulated.max():.5g} m, mean {simulated.mean():.5g}",
        f"against 'y' (simulation): RMSE {rmse:.5g} m, NRMSE {nrmse:.4g}, fit {100 * (1 - nrmse):.2f} %",
        "written: sim.csv",
        "written: sim.png",
    ]
    columns = np.genfromtxt(folder / "sim.csv", delimiter=",", names=True)
    assert columns.dtype.names == ("time", "u", "simulated", "y", "residual")
    for name, expected in zip(
        columns.dtype.names, (4.0 * np.arange(60), U, simulated, Y, residual), strict=True
    ):
        assert columns[name].tobytes() == expected.tobytes()
    with Image.open(folder / "sim.png") as picture:
        assert picture.size[0] > 600


def test_what_was_taken_off_before_the_fit_is_taken_off_and_added(folder):
    hi.write_model(
        replace(MODEL, about={**MODEL.about, "offsets": {"input": 20.0, "output": 98.0}}), folder / "off.json"
    )
    save(folder / "off.csv", t=4.0 * np.arange(len(U)), u=U + 20.0, y=Y + 98.0)
    level = said(folder, "simulate tank.json tank.csv --compare y --time t").splitlines()
    shown = said(folder, "simulate off.json off.csv --compare y --time t").splitlines()
    assert shown[-1] == level[-1]
    assert "20 is taken off the input, and 98 added to the output" in shown
    assert shown[-2].startswith(f"output from {MODEL.simulate(U).min() + 98.0:.5g} to ")
    assert shown[-2] != level[-2]
    assert "20 is taken off the input" in said(folder, "show off.json")
    done = run_forked(["convert", "off.json", "--to", "python"], folder)
    assert "98 added to the output." in done.stdout
    assert done.stderr == ""


def test_without_a_measured_output_there_is_nothing_to_compare(folder):
    shown = said(folder, "simulate tank.json tank.csv --out sim.csv")
    assert "against" not in shown
    assert (folder / "sim.csv").read_text().startswith("time,u,simulated\n")


def test_a_prediction_uses_the_noise_model_and_leaves_samples_out(folder):
    shown = said(folder, "simulate tank.json tank.csv --compare y --k-step 2 --n-init 10 --out sim.csv")
    predicted = MODEL.predict(hi.Record(U, Y), 2)
    rmse = np.sqrt(np.mean((Y - predicted)[10:] ** 2))
    assert f"against 'y' (2-step prediction, without the first 10 samples): RMSE {rmse:.5g} m" in shown
    assert (folder / "sim.csv").read_text().startswith("time,u,predicted,y,residual\n")


def test_an_input_beyond_the_range_of_the_fit_is_warned_of(folder):
    save(folder / "wide.csv", u=np.array([1.0, 2.0, 5.0, 3.0]))
    done = run_forked(["simulate", "tank.json", "wide.csv"], folder)
    assert done.returncode == 0
    assert done.stderr == (
        "warning: 2 of 4 samples (50.0 %) of the input of N lie beyond 1.2 to 3.9, where it was fitted "
        "(here 1 to 5): no measurement supports the model there\n"
    )


@pytest.mark.parametrize(
    "command", ["show wild.json", "convert wild.json --to python", "simulate wild.json tank.csv"]
)
def test_an_unstable_block_is_warned_of(folder, command):
    wild = TransferFunction(b=(1.0,), a=(-1.01,))
    hi.write_model(
        replace(MODEL, chain=BlockChain((VALVE, wild), dt=4.0), start="rest"), folder / "wild.json"
    )
    done = run_forked(command.split(), folder)
    assert (done.returncode, done.stderr) == (
        0,
        "warning: L is unstable, as it has a pole of modulus 1.01: what it gives never settles\n",
    )
    # An integrator only goes on.
    level = replace(
        MODEL, chain=BlockChain((VALVE, TransferFunction(b=(1.0,), a=(1.0,))), dt=4.0), start="rest"
    )
    hi.write_model(level, folder / "wild.json")
    assert run_forked(command.split(), folder).stderr == ""


def test_the_range_of_the_fit_is_in_the_unit_of_the_record_whatever_its_first_sample(folder):
    hi.write_model(replace(MODEL, about={**MODEL.about, "offsets": {"input": 20.0}}), folder / "off.json")
    save(folder / "wide.csv", u=np.array([1e20, 22.0, 23.0, 25.0]))
    done = run_forked(["simulate", "off.json", "wide.csv"], folder)
    assert "2 of 4 samples (50.0 %) of the input of N lie beyond 21.2 to 23.9, where it was" in done.stderr


def test_without_known_ranges_the_span_of_the_basis_counts(folder):
    block = StaticFunction(DeadZone(-1.0, 1.0), (0.0, 1.0, 1.0))
    hi.write_model(FittedModel(BlockChain((VALVE, block, TANK))), folder / "tank.json")
    save(folder / "wide.csv", valve=np.array([1.0, 2.0, 5.0, 4.0]))
    done = run_forked(["simulate", "tank.json", "wide.csv", "--input", "valve"], folder)
    assert done.stderr.startswith("warning: 1 of 4 samples (25.0 %) of the input of N1 lie beyond 1 to 4,")
    assert done.stderr.count("warning") == 1


def prepared(folder, **options):
    """The record and its simulation, as a program reads and makes them."""
    record = hi.read(folder / "rough.csv", input="u", output="y", **options)
    return record, MODEL.simulate(record)


READ = [
    ("--dt 4 --gaps split", {"dt": 4, "gaps": "split"}),
    ("--dt 4 --samples 31..", {"dt": 4, "estimation": "31.."}),
    ("--time uneven --resample 4 --samples 31..", {"time": "uneven", "resample": 4, "estimation": "31.."}),
    ("--dt 2 --decimate 2 --samples 11..", {"dt": 2, "decimate": 2, "estimation": "11.."}),
]


@pytest.mark.parametrize(("command", "options"), READ)
def test_a_record_is_read_as_for_a_fit(folder, command, options):
    rough = Y.copy()
    if "gaps" in options:
        rough[[7, 8]] = np.nan
    save(folder / "rough.csv", uneven=4.0 * np.arange(60) + np.sin(np.arange(60)), u=U, y=rough)
    record, simulated = prepared(folder, **options)
    assert len(simulated) < len(U)
    assert ("gaps" in options) == (len(record.experiments) == 2)
    said(folder, f"simulate tank.json rough.csv --compare y {command} --out sim.csv")
    columns = np.genfromtxt(folder / "sim.csv", delimiter=",", names=True)
    for name, expected in (("u", record.u), ("y", record.y), ("simulated", simulated)):
        assert columns[name].tobytes() == expected.tobytes()
    # Without a measured output the input alone says where gaps are.
    save(folder / "rough.csv", uneven=4.0 * np.arange(60) + np.sin(np.arange(60)), u=U, y=U)
    _, simulated = prepared(folder, **options)
    said(folder, f"simulate tank.json rough.csv {command} --out sim.csv")
    columns = np.genfromtxt(folder / "sim.csv", delimiter=",", names=True)
    assert columns["simulated"].tobytes() == simulated.tobytes()


def test_codes_for_missing_samples_and_decimal_commas_are_read_as_for_a_fit(folder):
    rough = Y.copy()
    rough[[7, 8]] = -999.5
    written = (f"{u:.17g};{y:.17g}".replace(".", ",") for u, y in zip(U, rough, strict=True))
    (folder / "rough.csv").write_text("\n".join(("u;y", *written)), encoding="utf-8")
    record, simulated = prepared(folder, dt=4, gaps="split", missing=[-999.5], decimal=",")
    assert len(record.experiments) == 2
    said(
        folder,
        "simulate tank.json rough.csv --compare y --dt 4 --gaps split --missing -999.5 --decimal , "
        "--out sim.csv",
    )
    columns = np.genfromtxt(folder / "sim.csv", delimiter=",", names=True)
    for name, expected in (("u", record.u), ("y", record.y), ("simulated", simulated)):
        assert columns[name].tobytes() == expected.tobytes()
    shown = said(folder, "simulate tank.json rough.csv --compare y --dt 4 --missing -999.5", 2)
    assert "column 'y': sample 8 is missing (-999.5)" in shown


def test_states_at_the_first_sample_are_found_if_asked_for(folder):
    moving = MODEL.chain.response(U, "settled", (np.array([3.0]),))
    save(folder / "moving.csv", u=U, y=moving)
    command = "simulate tank.json moving.csv --compare y --out sim.csv"
    for start, first in (("settled", MODEL.simulate(U)[0]), ("rest", 0.0), ("estimated", moving[0])):
        shown = said(folder, f"{command} --start {start}")
        columns = np.genfromtxt(folder / "sim.csv", delimiter=",", names=True)
        assert columns["simulated"][0] == pytest.approx(first, abs=1e-9)
        assert ("begun with the states with which the first 32 samples are met best" in shown) == (
            start == "estimated"
        )
    np.testing.assert_allclose(columns["simulated"], moving, rtol=0.0, atol=1e-9)


def test_a_prediction_begins_with_states_that_were_found(folder):
    moving = MODEL.chain.response(U, "settled", (np.array([3.0]),))
    save(folder / "moving.csv", u=U, y=moving)
    shown = said(folder, "simulate tank.json moving.csv --compare y --k-step 1 --start estimated")
    assert shown.endswith("fit 100.00 %\n")


def test_another_sampling_interval_is_an_error_unless_asked_for(folder):
    assert said(folder, "simulate tank.json tank.csv --dt 2", 2) == (
        "error: tank.csv is sampled every 2, and the model was fitted to samples every 4: resample "
        "the input, or ask for it as it stands by --any-dt\n"
    )
    assert "60 samples" in said(folder, "simulate tank.json tank.csv --dt 2 --any-dt")
    assert "60 samples" in said(folder, "simulate tank.json tank.csv --dt 4.0001")


CONTINUOUS = replace(
    MODEL,
    chain=BlockChain(
        (VALVE, SampledTransferFunction(ContinuousTransferFunction((1.0,), (18.0,), 2.0), 4.0)), 4.0
    ),
)


def test_continuous_blocks_are_sampled_anew_at_another_interval(folder):
    hi.write_model(CONTINUOUS, folder / "tank.json")
    done = run_forked(["simulate", "tank.json", "tank.csv", "--dt", "2", "--out", "sim.csv"], folder)
    assert done.returncode == 0
    assert done.stderr == (
        "note: tank.csv is sampled every 2, and the model was fitted to samples every 4: its linear blocks "
        "are continuous, and sampled anew\n"
    )
    columns = np.genfromtxt(folder / "sim.csv", delimiter=",", names=True)
    expected = CONTINUOUS.chain.every(2.0).response(U, "settled")
    assert columns["simulated"].tobytes() == expected.tobytes()
    # A time of 2 s is one sample, or half of one.
    assert np.argmax(expected != expected[0]) == 5 + 2
    assert "60 samples" in said(folder, "simulate tank.json tank.csv --dt 4")


def test_noise_has_its_own_interval(folder):
    hi.write_model(CONTINUOUS, folder / "tank.json")
    assert said(folder, "simulate tank.json tank.csv --dt 2 --compare y --k-step 1", 2) == (
        "error: tank.csv is sampled every 2, and the model was fitted to samples every 4, as its noise is: "
        "leave out --k-step, or resample the record\n"
    )


REFUSED = [
    (
        "simulate tank.json tank.csv --k-step 1",
        "--k-step predicts from measured outputs: name their column by --compare",
    ),
    (
        "simulate tank.json tank.csv --n-init 60 --compare y",
        "--n-init 60 leaves no sample to compare (of 60)",
    ),
    ("simulate tank.json tank.csv --out sim.txt", "sim.txt: the name must end in .csv"),
    ("simulate tank.json tank.csv --plot sim.pdf", "sim.pdf: the name must end in .png"),
    ("simulate tank.json tank.csv --out none/sim.csv", "none/sim.csv cannot be written: no such file"),
    ("simulate tank.json tank.csv --input v", "there is no column 'v'"),
    ("simulate tank.json none.csv", "none.csv: no such file"),
    ("simulate tnk.json tank.csv", "tnk.json: no such file; did you mean 'tank.json'?"),
    ("simulate tank.json tank.csv --n-init -1", "Invalid value for '--n-init'"),
    (
        "simulate nameless.json tank.csv",
        "nameless.json does not say which column its input is: name it by --input",
    ),
    ("simulate unstable.json long.csv --input u", "output to this input is not finite from sample"),
    (
        "simulate tank.json tank.csv --start estimated",
        "--start estimated takes the states from measured outputs: name their column by --compare",
    ),
    (
        "simulate tank.json tank.csv --start setled",
        "--start: must be settled, rest, estimated, not 'setled'; did you mean 'settled'?",
    ),
    (
        "simulate integrator.json tank.csv --compare y --input u --start estimated",
        "--start estimated: L: a block with a pole at z = 1 settles nowhere: start it from rest",
    ),
    ("simulate tank.json tank.csv --samples 0..4", "--samples: must be a range FIRST..LAST with 1 <= FIRST"),
    ("simulate tank.json tank.csv --samples 1..400", "has 60 samples, fewer than 1..400 needs"),
    (
        "simulate tank.json tank.csv --gaps spilt",
        "--gaps: must be 'error' or 'split'; did you mean 'split'? (got 'spilt')",
    ),
    ("simulate tank.json tank.csv --resample 4", "--resample: needs the column of the sampling times: give"),
    ("simulate tank.json tank.csv --compare=", "--compare: must be the name of a column or its number"),
    ("simulate tank.json tank.csv --compare u", "the input and the output are one column, 'u'"),
    ("show tank.json --out tank.csv", "tank.csv cannot be made: file exists"),
    (
        "convert tank.json --to mathlab",
        "there is no target 'mathlab'; did you mean 'matlab'? (there are: python",
    ),
    ("convert tank.json", "Missing option '--to'"),
    ("convert tank.json --to python --out tank.m", "tank.m: the name must end in .py (--to python)"),
    ("convert tank.json --to matlab --out 2nd.m", "'2nd' cannot be the name of a MATLAB function"),
    ("convert broken.json --to python", "broken.json:1: cannot be read: it is no JSON"),
]


@pytest.mark.parametrize(("command", "message"), REFUSED)
def test_bad_usage_is_told(folder, command, message):
    (folder / "broken.json").write_text("{")
    hi.write_model(FittedModel(BlockChain((TANK,))), folder / "nameless.json")
    unstable = TransferFunction(b=(1.0,), a=(2.0,))
    hi.write_model(FittedModel(BlockChain((unstable,)), start="rest"), folder / "unstable.json")
    save(folder / "long.csv", u=np.ones(1200))
    integrator = TransferFunction(b=(1.0,), a=(1.0,))
    hi.write_model(FittedModel(BlockChain((integrator,)), start="rest"), folder / "integrator.json")
    found = said(folder, command, 2)
    assert message in found
    assert not list(folder.glob(".part*"))


def test_a_model_is_shown_in_words_and_pictures(folder):
    shown = said(folder, "show tank.json --out page")
    assert shown.startswith(hi.formulas(MODEL))
    names = ["static_functions.png", "bode.png", "step_responses.png", "poles_zeros.png"]
    assert shown.splitlines()[-1] == f"page: {', '.join(names)}"
    assert sorted(path.name for path in (folder / "page").iterdir()) == sorted(names)


def test_a_model_is_converted_to_a_file_or_to_standard_output(folder):
    assert said(folder, "convert tank.json --to matlab --out my_tank.m") == (
        "my_tank.m: a MATLAB function, which Octave runs too\n"
    )
    assert (folder / "my_tank.m").read_text() == hi.convert(MODEL, "matlab", "my_tank")
    assert said(folder, "convert tank.json --to python") == hi.convert(MODEL, "python")


def test_what_cannot_be_drawn_is_said(folder):
    block = StaticFunction(PiecewiseLinear((-1e308, 1e308)), (-1e308, 1e308))
    hi.write_model(FittedModel(BlockChain((block,))), folder / "tank.json")
    found = said(folder, "show tank.json --out page", 2)
    assert found.startswith("error: page/static_functions.png cannot be drawn: numbers are too large (")
    assert list((folder / "page").iterdir()) == []
