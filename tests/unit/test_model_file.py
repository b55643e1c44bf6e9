"""model.json: every bit comes back, and whatever is wrong with a file is said with its key path."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hident as hi
from hident.block_chain import BlockChain
from hident.errors import ConfigError, StoreError
from hident.fitted_model import FittedModel, NoiseModel
from hident.linear_blocks import TransferFunction
from hident.static_functions import Chebyshev, CubicSpline, PiecewiseLinear, Saturation, StaticFunction
from tests.unit.model_maker import models

VALVE = StaticFunction(Saturation(low=-1.0, high=2.0), (0.1, 1.0))
TANK = TransferFunction(b=(0.0, 0.5), a=(0.5,))
MODEL = FittedModel(
    BlockChain((VALVE, TANK), dt=4.0),
    start="settled",
    noise=NoiseModel(ar=(0.9,), variance=0.01),
    errors=({"c_2": 0.01, "low": 0.5}, {"b_1": 0.02, "a_1": 1 / 3}),
    ranges=((-3.0, 2.5), (-0.9, 2.1)),
    about={
        "input": "valve",
        "units": {"input": "%", "output": "m", "time": "s"},
        "data": {"tanks.csv": "9f86d0"},
        "command": "hident identify tanks.csv",
        "rate": [1, 2.5, None, True, {"more": "\udc80 é"}],
    },
)
TEXT = """\
{
  "hident_model": 1,
  "structure": "N-L",
  "dt": 4.0,
  "start": "settled",
  "blocks": [
    {
      "name": "N",
      "kind": "saturation",
      "low": -1.0,
      "high": 2.0,
      "coefficients": [0.1, 1.0],
      "errors": {
        "c_2": 0.01,
        "low": 0.5
      },
      "fitted_on": [-3.0, 2.5]
    },
    {
      "name": "L",
      "kind": "transfer_function",
      "b": [0.0, 0.5],
      "a": [0.5],
      "errors": {
        "b_1": 0.02,
        "a_1": 0.3333333333333333
      },
      "fitted_on": [-0.9, 2.1]
    }
  ],
  "noise": {
    "ar": [0.9],
    "ma": [],
    "variance": 0.01
  },
  "about": {}
}
"""


def test_a_file_is_for_people(tmp_path):
    hi.write_model(replace(MODEL, about={}), tmp_path / "model.json")
    assert (tmp_path / "model.json").read_text(encoding="utf-8") == TEXT
    assert [path.name for path in tmp_path.iterdir()] == ["model.json"]


def test_every_bit_of_a_model_comes_back(tmp_path):
    hi.write_model(MODEL, tmp_path / "model.json")
    assert hi.load_model(tmp_path / "model.json") == MODEL


@given(model=models())
def test_every_bit_of_any_model_comes_back(tmp_path_factory, model):
    path = tmp_path_factory.getbasetemp() / "any.json"
    hi.write_model(model, path)
    assert hi.load_model(path) == model


@given(
    knots=st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=2, unique=True), data=st.data()
)
def test_numbers_of_any_size_come_back(tmp_path_factory, knots, data):
    path = tmp_path_factory.getbasetemp() / "sizes.json"
    basis = data.draw(st.sampled_from([PiecewiseLinear, CubicSpline]))(tuple(sorted(knots)))
    finite = st.floats(allow_nan=False, allow_infinity=False)
    values = tuple(data.draw(st.lists(finite, min_size=basis.size, max_size=basis.size)))
    model = FittedModel(BlockChain((StaticFunction(basis, values),)), start="rest")
    hi.write_model(model, path)
    assert repr(hi.load_model(path)) == repr(model)


def test_what_numpy_made_is_written_as_numbers(tmp_path):
    block = TransferFunction(b=tuple(np.array([0.1, 0.2])), a=(np.float64(0.5),))
    model = FittedModel(BlockChain((block,)), about={"samples": np.int64(3), "levels": np.array([1.0])})
    hi.write_model(model, tmp_path / "model.json")
    read = hi.load_model(tmp_path / "model.json")
    assert read.chain == model.chain
    assert read.about == {"samples": 3, "levels": [1.0]}


def test_standard_errors_that_are_not_known_are_left_out(tmp_path):
    model = replace(MODEL, errors=({"c_1": np.nan, "c_2": 0.1}, {"a_1": np.inf}))
    hi.write_model(model, tmp_path / "model.json")
    assert hi.load_model(tmp_path / "model.json").errors == ({"c_2": 0.1}, {})


def test_what_cannot_be_read_is_not_written(tmp_path):
    block = TransferFunction(b=(np.nan,))
    with pytest.raises(ConfigError, match=re.escape("blocks[0].b[0]: must be a finite number")):
        hi.write_model(FittedModel(BlockChain((block,))), tmp_path / "model.json")
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_not_there_is_said(tmp_path):
    with pytest.raises(StoreError, match="cannot be written: no such file or directory"):
        hi.write_model(MODEL, tmp_path / "none" / "model.json")


def changed(path, value):
    """The file's text with the value at a key path replaced; ``...`` takes the key away."""
    data = json.loads(TEXT)
    *way, last = path
    at = data
    for key in way:
        at = at[key]
    if value is ...:
        del at[last]
    else:
        at[last] = value
    return json.dumps(data)


N, L = ("blocks", 0), ("blocks", 1)
KINDS = (
    "transfer_function, continuous_transfer_function, polynomial, piecewise_linear, cubic_spline, "
    "saturation, dead_zone, expansion, series"
)
SPLINE = {"name": "N", "kind": "cubic_spline", "knots": [0, 2, 1], "coefficients": [1, 2, 3, 4, 5]}
WRONG = [
    (("hident_model",), ..., ": hident_model: is required: The version of the format"),
    (
        ("hident_model",),
        2,
        ": hident_model: was written by a later hident, as version 2 of the format; this one reads 1 (got 2)",
    ),
    (("hident_model",), "1", ": hident_model: must be the number of a version of the format: 1 (got '1')"),
    (("dt",), ..., ": dt: is required"),
    (("dt",), 0, ": dt: must be greater than 0 (got 0)"),
    (("dt",), "1/5", ": dt: must be a number (got '1/5')"),
    (
        ("start",),
        "sett1ed",
        ": start: must be 'rest', 'settled' or 'estimated'; did you mean 'settled'? (got 'sett1ed')",
    ),
    (
        ("strat",),
        "rest",
        ": strat: unknown key; did you mean 'start'? "
        "(allowed: hident_model, structure, dt, start, begun, blocks, noise, about)",
    ),
    (("structure",), "L-N", ": structure: must be 'N-L', as the blocks are (got 'L-N')"),
    (("blocks",), [], ": blocks: must be a list of at least 1 (got [])"),
    (("blocks",), {}, ": blocks: must be a list (got a mapping)"),
    (N, 3, ": blocks[0]: must be a mapping of keys to values (got 3)"),
    ((*N, "kind"), ..., f": blocks[0]: must have a kind (allowed: {KINDS})"),
    (
        (*N, "kind"),
        "saturated",
        f": blocks[0]: has the unknown kind 'saturated'; did you mean 'saturation'? (allowed: {KINDS})",
    ),
    ((*N, "name"), "valve", ": blocks[0].name: must be 'N' in this place (got 'valve')"),
    ((*N, "low"), 2.0, ": blocks[0]: low must be below high, not 2 and 2"),
    ((*N, "low"), ..., ": blocks[0].low: is required"),
    ((*N, "low"), True, ": blocks[0].low: must be a number (got true)"),
    ((*N, "low"), 10**400, ": blocks[0].low: must be a finite number (got 1000"),
    ((*N, "low"), float("nan"), ": blocks[0].low: must be a finite number (got .nan)"),
    ((*N, "low"), float("inf"), ": blocks[0].low: must be a finite number (got .inf)"),
    (
        (*N, "coefficients"),
        [1.0, 2.0, 3.0],
        ": blocks[0]: coefficients must be 2 numbers for this basis, not 3",
    ),
    ((*N, "coefficients"), 1.0, ": blocks[0].coefficients: must be a list (got 1.0)"),
    ((*N, "coefficients", 1), None, ": blocks[0].coefficients[1]: must be a number (got null)"),
    (
        (*N, "coefficients", 1),
        float("nan"),
        ": blocks[0].coefficients[1]: must be a finite number (got .nan)",
    ),
    (
        (*N, "errors", "c_3"),
        0.1,
        ": blocks[0].errors.c_3: unknown key; did you mean 'c_2'? (allowed: low, high, c_1, c_2)",
    ),
    ((*N, "errors", "c_1"), -0.1, ": blocks[0].errors.c_1: must be greater than or equal to 0 (got -0.1)"),
    ((*N, "fitted_on"), [1, 0], ": blocks[0].fitted_on: must be [low, high] with low <= high (got [1, 0])"),
    ((*N, "fitted_on"), [1], ": blocks[0].fitted_on: must be a list of at least 2 (got [1])"),
    ((*N, "fitted_on"), ..., ": blocks[0].fitted_on: is required: other blocks have it"),
    (N, SPLINE, ": blocks[0].knots: must be in increasing order, and 1 stands behind 2 (got [0, 2, 1])"),
    (N, SPLINE | {"knots": [1]}, ": blocks[0].knots: must be a list of at least 2 (got [1])"),
    (
        N,
        SPLINE | {"knots": [0, 1]},
        ": blocks[0]: coefficients must be 4 numbers for this basis, not 5",
    ),
    (
        N,
        {"name": "N", "kind": "polynomial", "degree": -1, "low": 0, "high": 1, "coefficients": []},
        ": blocks[0].degree: must be greater than or equal to 0 (got -1)",
    ),
    ((*L, "b"), [], ": blocks[1].b: must be a list of at least 1 (got [])"),
    (
        (*L, "a"),
        [1.0],
        ': blocks[1]: a block with a pole at z = 1 settles nowhere: start it from rest ("start"',
    ),
    ((*L, "delay"), 1, ": blocks[1].delay: unknown key (allowed: name, errors, fitted_on, b, a)"),
    (("noise", "variance"), -1.0, ": noise.variance: must be greater than or equal to 0 (got -1.0)"),
    (("noise",), None, ": noise: must be a mapping of keys to values (got null)"),
    (("about", "units"), {"inputs": "V"}, ": about.units.inputs: unknown key; did you mean 'input'?"),
    (("about", "input"), 3, ": about.input: must be text (got 3)"),
    (("about", "note"), [float("inf")], ": about.note[0]: must be a finite number (got .inf)"),
]


@pytest.mark.parametrize(("path", "value", "message"), WRONG)
def test_what_is_wrong_is_said_with_its_key_path(tmp_path, path, value, message):
    file = tmp_path / "model.json"
    file.write_text(changed(path, value), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        hi.load_model(file)
    assert str(caught.value).startswith(f"{file}{message}")


def test_all_that_is_wrong_is_said_at_once(tmp_path):
    file = tmp_path / "model.json"
    file.write_text(changed((*N, "low"), "x").replace('"variance": 0.01', '"variance": -1'), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        hi.load_model(file)
    assert [line.split(": ")[1] for line in str(caught.value).splitlines()] == [
        "blocks[0].low",
        "noise.variance",
    ]


UNREADABLE = [
    (b"", ":1: cannot be read: it is no JSON (expecting value at column 1)"),
    (b'{"hident_model": 1,\n}', ":2: cannot be read: it is no JSON ("),
    (b"\xff\xfe", ": cannot be read: it is not UTF-8 text"),
    (b"[" * 200_000, ": cannot be read: lists and mappings stand too deep in each other"),
    (b"[1]", ": must be a mapping of keys to values, with 'hident_model': 1"),
    (b'{"dt": 1, "dt": 2}', ": cannot be read: the key 'dt' stands twice"),
    (b'{"hident_model": ' + b"1" * 10_000 + b"}", ": cannot be read: "),
    (b" " * (2**22 + 1), ": cannot be read: it is larger than 4096 kB, the most that a model may have"),
    (
        TEXT.replace('"about": {}', '"about": {"a": ' + "[" * 500 + "]" * 500 + "}").encode(),
        ": about: must have no more than 20 lists and mappings in each other",
    ),
]


@pytest.mark.parametrize(("content", "message"), UNREADABLE)
def test_what_is_no_model_is_said(tmp_path, content, message):
    file = tmp_path / "model.json"
    file.write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        hi.load_model(file)
    assert str(caught.value).startswith(f"{file}{message}")


def test_a_file_that_is_not_there_is_said_with_the_nearest(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    hi.write_model(MODEL, "tanks.json")
    with pytest.raises(ConfigError, match=re.escape("tank.json: no such file; did you mean 'tanks.json'?")):
        hi.load_model("tank.json")
    with pytest.raises(ConfigError, match="cannot be read: is a directory"):
        hi.load_model(tmp_path)


def test_a_mark_that_editors_put_first_is_no_part_of_a_file(tmp_path):
    (tmp_path / "model.json").write_text(TEXT, encoding="utf-8-sig")
    assert hi.load_model(tmp_path / "model.json") == replace(MODEL, about={})


@pytest.mark.parametrize("degree", [0, 3])
def test_a_polynomial_is_written_with_its_range(tmp_path, degree):
    block = StaticFunction(Chebyshev(degree, 0.0, 2.0), (1.0,) * (degree + 1))
    model = FittedModel(BlockChain((block,)))
    hi.write_model(model, tmp_path / "model.json")
    assert hi.load_model(tmp_path / "model.json") == model
