"""A model that was found in a record less its means gives outputs as they were measured, wherever it runs."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import hident as hi
from hident.block_chain import BlockChain
from hident.fitted_model import FittedModel
from tests.forked import run_forked
from tests.octave import needs_octave
from tests.unit.test_simulink import octave

TANK = hi.Hammerstein(
    nonlinearity=hi.Polynomial(coefficients=[0, 1, 0.3]), linear=hi.Arma(a=[0.8], b=[0, 0.2])
)
IDENTIFY = "identify tank.csv --input u --output y --dt 4 --structure hammerstein"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A record far from zero, and what identify made of it less its means, and less its lines."""
    folder = tmp_path_factory.mktemp("offsets")
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(-1.5, 1.5, 80), 5)
    y = TANK.simulate(u) + 0.01 * rng.standard_normal(400)
    columns = np.column_stack([u + 20.0, y + 98.0])
    np.savetxt(folder / "tank.csv", columns, delimiter=",", header="u,y", comments="", fmt="%.17g")
    for trend in ("mean", "linear"):
        run(folder, f"{IDENTIFY} --detrend {trend} --out {trend}")
    return folder


def run(folder, command, code=0):
    done = run_forked(command.split(), folder)
    assert done.returncode == code, (command, done.stdout, done.stderr)
    return done


def simulated(folder, options):
    """The output, as it is written, and what is said."""
    done = run(folder, f"simulate {options} --dt 4 --out simulated.csv")
    return np.genfromtxt(folder / "simulated.csv", delimiter=",", names=True), done


@pytest.fixture
def expected(folder):
    """The record, and the output of the model that was fitted less the means."""
    columns, done = simulated(folder, "mean/model.json tank.csv --compare y --n-init 50")
    fit = float(done.stdout.splitlines()[-2].rpartition("fit ")[2].removesuffix(" %"))
    assert fit > 95
    return columns["u"], columns["simulated"]


def assert_same(found, expected):
    np.testing.assert_allclose(np.asarray(found), expected, rtol=0.0, atol=1e-9)


def test_the_model_has_the_means_of_its_record(folder, expected):
    u, y = expected
    model = hi.load_model(folder / "mean/model.json")
    record = hi.read(folder / "tank.csv", input="u", output="y", dt=4)
    assert_same(model.offsets, (np.mean(record.u), np.mean(record.y)))
    assert_same(model.simulate(record), y)
    assert_same(model.simulate(u), y)
    assert_same(model.predict(record), y)
    level = hi.read(folder / "tank.csv", input="u", output="y", dt=4, detrend="mean")
    assert_same(model.simulate(level) + level.offsets["output"], y)
    assert model.level(level) is level
    np.testing.assert_array_equal(model.level(record).u, level.u)


def test_a_fit_from_python_keeps_them_too(folder, tmp_path):
    level, record = (
        hi.read(folder / "tank.csv", input="u", output="y", dt=4, **prepared)
        for prepared in ({"detrend": "mean"}, {})
    )
    blocks = [hi.PolynomialBlock(degree=2), hi.LinearBlock(nb=1, nf=1, nk=1)]
    model = hi.fit(hi.PredictionError(blocks=blocks, start="estimated"), level).model
    assert isinstance(model, FittedModel)
    assert model.offsets == (level.offsets["input"], level.offsets["output"])
    np.testing.assert_array_equal(
        model.simulate(level),
        model.chain.response(level.u, "settled", tuple(map(np.array, model.begun[0].states))),
    )
    hi.write_model(model, tmp_path / "model.json")
    again = hi.load_model(tmp_path / "model.json").simulate(record)
    assert_same(again, model.simulate(level) + level.offsets["output"])


@pytest.mark.parametrize("to", ["python", "scipy"])
def test_a_python_function_applies_them(folder, expected, to):
    u, y = expected
    run(folder, f"convert mean/model.json --to {to} --out tank_{to}.py")
    names: dict[str, Any] = {}
    exec((folder / f"tank_{to}.py").read_text(), names)
    assert_same(names["response"](u), y)


@pytest.mark.parametrize("name", ["mean", "line"])
def test_a_system_of_control_applies_them(folder, name):
    control = pytest.importorskip("control")
    model = hi.load_model(folder / "mean/model.json")
    if name == "line":
        # A chain of linear blocks, which without offsets is a transfer function.
        model = replace(model, chain=BlockChain(model.chain.linear, 4.0), ranges=(), errors=())
        hi.write_model(model, folder / "line.json")
    file = "mean/model.json" if name == "mean" else "line.json"
    columns, _ = simulated(folder, f"{file} tank.csv --compare y")
    u = columns["u"]
    run(folder, f"convert {file} --to control --out {name}_control.py")
    made: dict[str, Any] = {}
    exec((folder / f"{name}_control.py").read_text(), made)
    for system, state in (
        (made["system"](), made["initial_state"](u[0])),
        (hi.to_control(model), hi.initial_state(model, u[0])),
    ):
        found = control.input_output_response(system, 4.0 * np.arange(len(u)), u, state).outputs
        assert_same(found, columns["simulated"])


@needs_octave
def test_matlab_and_simulink_apply_them(folder, expected):
    _, y = expected
    for to in ("matlab", "simulink"):
        run(folder, f"convert mean/model.json --to {to} --out tank_{to}.m")
    program = [
        "data = dlmread('tank.csv', ',', 1, 0); u = data(:, 1);",
        "printf('%.17g ', tank_matlab(u)); printf('\\n');",
        "tank_simulink(u(1)); printf('%.17g ', simulated(u'));",
    ]
    for line in octave(folder, "\n".join(program)):
        assert_same(list(map(float, line.split())), y)


@pytest.mark.parametrize("to", ["python", "scipy", "control", "matlab", "simulink"])
def test_every_source_says_so(folder, to):
    model = replace(
        hi.load_model(folder / "mean/model.json"), about={"offsets": {"input": 20.0, "output": 98.5}}
    )
    said = hi.convert(model, to)
    assert "20 is taken off the input, and 98.5 added to the output." in said
    begins = "It begins settled to an input of 20.0" if to == "simulink" else "the input was its first value"
    assert begins in said
    said = hi.convert(replace(model, start="rest"), to)
    assert "Before the first sample the input was 20, and all states were zero." in said
    assert "20 is taken off the input, and 98.5 added to the output" in hi.formulas(model)


def test_a_range_is_told_as_it_is_measured(folder):
    np.savetxt(folder / "wide.csv", np.array([20.0, 25.0, 20.0]), header="u", comments="")
    done = run(folder, "simulate mean/model.json wide.csv")
    assert "1 of 3 samples (33.3 %) of the input of N lie beyond 18.5" in done.stderr
    assert "(here 20 to 25)" in done.stderr


def test_the_means_of_the_record_may_be_taken_off_as_well(folder, expected):
    columns, done = simulated(folder, "mean/model.json tank.csv --compare y --detrend mean")
    _, y = expected
    means = hi.load_model(folder / "mean/model.json").offsets
    assert_same(columns["simulated"] + means[1], y)
    assert "all numbers are less the means of this record" in done.stdout
    columns, _ = simulated(folder, "mean/model.json tank.csv --detrend mean")
    assert_same(columns["simulated"], y)


def test_lines_are_taken_off_by_who_compares(folder):
    model = hi.load_model(folder / "linear/model.json")
    refused = run(folder, "simulate linear/model.json tank.csv --compare y --dt 4", 2)
    assert refused.stderr == (
        "error: tank.csv: linear/model.json was fitted to signals less their straight lines, and there is "
        "nothing to compare in others: take those of this record off by --detrend linear\n"
    )
    run(folder, "simulate linear/model.json tank.csv --compare y --dt 4 --detrend mean", 2)
    columns, done = simulated(folder, "linear/model.json tank.csv --compare y --detrend linear --n-init 50")
    level = hi.read(folder / "tank.csv", input="u", output="y", dt=4, detrend="linear")
    assert_same(columns["simulated"], model.simulate(level))
    assert_same(columns["y"], level.y)
    assert "all numbers are less the straight lines of this record" in done.stdout
    assert float(done.stdout.splitlines()[-2].rpartition("fit ")[2].removesuffix(" %")) > 90
    raw = hi.read(folder / "tank.csv", input="u", output="y", dt=4)
    with pytest.raises(
        ValueError, match="straight lines, which this record still has: read it with detrend="
    ):
        model.simulate(raw)
    blocks = [hi.PolynomialBlock(degree=2), hi.LinearBlock(nb=1, nf=1, nk=1)]
    own = hi.fit(hi.PredictionError(blocks=blocks), level).model
    assert isinstance(own, FittedModel)
    assert own.is_detrended
    # What has no measured output is taken for what is left of a line, which is said.
    columns, done = simulated(folder, "linear/model.json tank.csv")
    assert_same(columns["simulated"], model.simulate(columns["u"]))
    assert done.stderr.partition("\n")[0] == (
        "warning: straight lines were taken off the input and the output before the fit: both are what is "
        "left of them; 'u' is taken as it stands"
    )
    refused = run(folder, "simulate mean/model.json tank.csv --compare y --detrend linear", 2)
    assert refused.stderr == (
        "error: tank.csv: mean/model.json was fitted to signals of which no straight lines were taken off: "
        "leave out --detrend linear\n"
    )


@pytest.mark.parametrize("to", ["python", "scipy", "control", "matlab", "simulink"])
def test_a_source_of_a_model_less_lines_says_so(folder, to):
    done = run(folder, f"convert linear/model.json --to {to}")
    assert "Straight lines were taken off the input and the output before the fit" in done.stdout
    assert "straight lines were taken off" in done.stderr
