"""A model in words: what the formulas say is what the blocks compute."""

import numpy as np
import pytest
from hypothesis import given

import hident as hi
from hident.block_chain import BlockChain
from hident.fitted_model import FittedModel, NoiseModel
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction
from hident.sampled_blocks import SampledTransferFunction
from hident.static_functions import (
    Chebyshev,
    CubicSpline,
    DeadZone,
    PiecewiseLinear,
    Saturation,
    StaticFunction,
)
from tests.unit.model_maker import models


def lines_of(block, errors=None, **about):
    """What is said of a block alone."""
    model = FittedModel(BlockChain((block,), dt=about.pop("dt", None)), errors=errors or (), **about)
    return hi.formulas(model).split("\n\n")[1].splitlines()


def test_a_model_is_described_by_what_is_known_of_it():
    about = {
        "input": "valve",
        "output": "level",
        "units": {"output": "m", "time": "min"},
        "method": "prediction_error",
        "hident": "0.1.0",
        "command": "hident identify tanks.csv",
        "data": {"tanks.csv": "0123456789abcdef"},
    }
    blocks = (StaticFunction(Saturation(0.0, 1.0), (0.0, 2.0)), TransferFunction(b=(0.0, 0.5), a=(0.5,)))
    model = FittedModel(
        BlockChain(blocks, dt=0.5),
        start="rest",
        noise=NoiseModel(ar=(0.9,), ma=(-0.2,), variance=0.04),
        ranges=((-1.0, 3.0), (0.0, 2.0)),
        about=about,
    )
    assert hi.formulas(model) == (
        """\
N-L: from 'valve' to 'level' (m), sampling interval 0.5 min, at rest before the first sample
made by prediction_error, with hident 0.1.0, from tanks.csv (SHA-256 0123456789ab)
command: hident identify tanks.csv

N: saturation, fitted to inputs from -1 to 3
  f(x) = 2 min(max(x, low), high)
  with low = 0 and high = 1

L: linear, fitted to inputs from 0 to 2
  y_k = 0.5 y_{k-1} + 0.5 x_{k-1}
  static gain 1
  pole 0.5 (time constant 0.7213 min)

noise:
  v_k = 0.9 v_{k-1} + e_k - 0.2 e_{k-1}
  standard deviation of e_k 0.2"""
    )


@pytest.mark.parametrize(
    ("value", "error", "written"),
    [
        (0.512, 0.013, "0.512(13)"),
        (-12.3456, 0.5, "-12.35(50)"),
        (0.3, 1.3, "0.3(1.3)"),
        (1234.0, 99.9, "1234(100)"),
        (1.234e-7, 1.1e-9, "1.234(11)e-07"),
        (1.234e8, 2e6, "1.234(20)e+08"),
        (2.0, 0.0, "2"),
        (123456.7, None, "1.2346e+05"),
    ],
)
def test_a_standard_error_stands_in_units_of_the_last_digits(value, error, written):
    block = TransferFunction(b=(0.0, 1.0), a=(value,))
    errors = () if error is None else ({"a_1": error},)
    assert lines_of(block, errors)[1] == f"  y_k = {written} y_{{k-1}} + x_{{k-1}}"


def test_poles_are_told_by_their_times():
    block = TransferFunction(b=(1.0,), a=(2 * 0.5 * np.cos(0.1), -0.25))
    assert lines_of(block, dt=2.0, about={"units": {"time": "s"}})[-1] == (
        "  pole 0.4975 +- 0.049917i (time constant 2.885 s, period 125.7 s)"
    )
    assert lines_of(TransferFunction(b=(1.0,), a=(1.0,)), start="rest")[2:] == [
        "  static gain inf",
        "  pole 1",
    ]


def test_a_polynomial_is_written_in_both_ways():
    # With t = (x - 2)/2: 1 + 2 t - (4 t^3 - 3 t)/2 = 1 + 3.5 t - 2 t^3.
    function = StaticFunction(Chebyshev(3, 0.0, 4.0), (1.0, 2.0, 0.0, -0.5))
    assert lines_of(function, ({"c_2": 0.1},)) == [
        "N: polynomial, fitted to inputs from 0 to 4",
        "  f(x) = 1 + 2.00(10) t - 0.5 T_3(t)",
        "  with t = (x - 2)/2 and the Chebyshev polynomials T_2(t) = 2 t^2 - 1, T_k = 2 t T_{k-1} - T_{k-2}",
        "       = -0.5 - 1.25 x + 1.5 x^2 - 0.25 x^3",
        "  a line beyond 0 and 4",
    ]


def test_points_and_pieces_stand_in_tables():
    line = StaticFunction(PiecewiseLinear((0.0, 1.5, 10.0)), (0.0, -1.0, 2.0))
    assert lines_of(line, ({"c_2": 0.2},))[1:] == [
        "  straight lines between",
        "      x       f(x)",
        "      0          0",
        "    1.5  -1.00(20)",
        "     10          2",
        "  which go on beyond 0 and 10",
    ]
    spline = StaticFunction(CubicSpline((0.0, 1.0)), (0.0, 1 / 3, 2 / 3, 1.0))
    said = lines_of(spline, ({"c_4": 0.1},))
    assert said[1].split() == [
        "from",
        "f",
        "=",
        "1",
        "+",
        "s",
        "+",
        "s^2",
        "+",
        "s^3",
        "with",
        "s",
        "=",
        "x",
        "-",
        "from",
    ]
    assert said[2].split()[:3] == ["0", "0", "1"]
    assert said[-2:] == ["  coefficients of the B-splines:", "    0, 0.33333, 0.66667, 1.00(10)"]


def test_a_dead_zone_and_a_function_that_is_nothing():
    zone = StaticFunction(DeadZone(-0.5, 0.7), (0.0, 1.0, -2.0))
    assert lines_of(zone, ({"low": 0.01},))[1:] == [
        "  f(x) = min(x - low, 0) - 2 max(x - high, 0)",
        "  with low = -0.500(10) and high = 0.7",
    ]
    assert lines_of(StaticFunction(Saturation(0.0, 1.0), (0.0, 0.0)))[1] == "  f(x) = 0"


@given(model=models())
def test_every_model_can_be_told_in_plain_letters(model):
    said = hi.formulas(model)
    assert said.isascii()
    assert all(f"\n{name}: " in said for name in model.chain.names)


@pytest.mark.parametrize(
    ("value", "error", "written"),
    [
        (5e-324, 1e-300, "0.0(1.0)e-300 x_k"),
        (1e308, 1e307, "1.00(10)e+308 x_k"),
        (np.float64(2.5), np.float64(0.1), "2.50(10) x_k"),
        (1.0, 1e-300, "x_k"),
        (1e300, 1.0, "1e+300 x_k"),
    ],
)
def test_numbers_of_any_size_are_written(value, error, written):
    assert lines_of(TransferFunction(b=(value,)), ({"b_0": error},))[1] == f"  y_k = {written}"


def test_what_overflows_is_told_without_a_warning():
    spline = StaticFunction(CubicSpline((0.0, 1e-300)), (0.0, 1e300, -1e300, 0.0))
    assert "nan" in "".join(lines_of(spline)) or "inf" in "".join(lines_of(spline))


def test_a_continuous_block_is_written_in_s():
    block = SampledTransferFunction(ContinuousTransferFunction((1.0, -0.5), (2.0, 4.0), 0.25), 0.1, "linear")
    errors = ({"b_0": 0.0, "b_1": 0.012, "a_1": 0.03},)
    assert lines_of(block, errors, dt=0.1, about={"units": {"time": "min"}}) == [
        "L: linear, continuous",
        "  Y(s) = exp(-0.25 s) B(s)/A(s) X(s)",
        "  B(s) = 1 - 0.500(12) s",
        "  A(s) = 1 + 2.000(30) s + 4 s^2",
        "  between samples its input is along straight lines",
        "  static gain 1",
        "  pole -0.25 +- 0.43301i (time constant 4 min, period 14.51 min)",
    ]
