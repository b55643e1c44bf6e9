"""A converted model has the same response, to 1e-12 of what its signals reach, wherever it runs."""

import re
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hident as hi
from hident.block_chain import Block, BlockChain
from hident.errors import ConfigError
from hident.fitted_model import FittedModel
from hident.linear_blocks import TransferFunction
from hident.models.plain_blocks import Filter, plain_blocks
from hident.static_functions import (
    Chebyshev,
    CubicSpline,
    DeadZone,
    PiecewiseLinear,
    Saturation,
    StaticFunction,
)
from hident.systems.function_basis import Functions
from tests.octave import needs_octave, printed
from tests.unit.model_maker import GIVEN, ORDERS, models

# Knots of the random functions lie within some 10 of zero: a part of the input is beyond them.
INPUTS = st.integers(0, 2**32).map(lambda seed: np.random.default_rng(seed).normal(scale=4.0, size=50))
STATIC = {
    "polynomial": StaticFunction(Chebyshev(4, -1.0, 1.5), (0.1, 1.0, -0.3, 0.2, 1 / 3)),
    "piecewise_linear": StaticFunction(PiecewiseLinear((-1.0, 0.1, 0.4)), (1.0, -1.0, 2 / 3)),
    "cubic_spline": StaticFunction(CubicSpline((-1.0, 0.0, 0.3, 1.0)), (1.0, -1.0, 0.5, 2.0, 0.1, 1 / 3)),
    "saturation": StaticFunction(Saturation(-0.5, 1.0), (0.1, 2.0)),
    "dead_zone": StaticFunction(DeadZone(-0.5, 1.0), (0.1, 2.0, 1 / 3)),
}
LINEAR = {
    "delayed": TransferFunction(b=(0.0, 0.0, 0.5, 0.2), a=(1.2, -0.5)),
    "finite": TransferFunction(b=(0.2, 0.3, -0.1)),
    "gain": TransferFunction(b=(1.5,)),
    "long feedback": TransferFunction(b=(0.4,), a=(0.3, 0.0, -0.2)),
}


def assert_same(found, model, u):
    """The response, within 1e-12 of the largest signal of the chain."""
    signals = model.chain.signals(u, model.start)
    size = max(1.0, *(float(np.max(np.abs(signal), initial=0.0)) for signal in signals))
    found = np.asarray(found)
    assert found.shape == signals[-1].shape
    assert np.max(np.abs(found - signals[-1]), initial=0.0) <= 1e-12 * size


def module(model, to):
    """What the source of a Python module defines."""
    source = hi.convert(model, to)
    assert "hident" not in "".join(line for line in source.splitlines() if "import" in line)
    assert max(map(len, source.splitlines())) <= 110
    names: dict[str, Any] = {}
    exec(compile(source, f"<{to}>", "exec"), names)
    return names


@pytest.mark.parametrize("to", ["python", "scipy"])
@given(model=models(), u=INPUTS)
@settings(deadline=None)
def test_a_python_function_has_the_same_response(to, model, u):
    response = module(model, to)["response"]
    for samples in (50, 1, 0):
        assert_same(response(u[:samples]), model, u[:samples])


@pytest.mark.parametrize("to", ["python", "scipy"])
@pytest.mark.parametrize("shape", [(5, 1), (1, 5), (5, 2), (1, 1), ()])
def test_an_input_of_another_shape_is_refused(to, shape):
    model = next(examples())
    for simulate in (module(model, to)["response"], model.simulate):
        with pytest.raises(ValueError, match=re.escape(f"input must be of shape (N,), not {shape}")):
            simulate(np.ones(shape))


@given(model=models(), u=INPUTS)
@settings(deadline=None, max_examples=30)
def test_a_system_of_control_has_the_same_response(model, u):
    control = pytest.importorskip("control")
    times = np.arange(len(u)) * (model.chain.dt or 1.0)
    made = module(model, "control")
    if not model.chain.static:
        for system in (hi.to_control(model), made["system"]()):
            assert isinstance(system, control.TransferFunction)
            found = control.forced_response(system, times, u).outputs
            assert_same(found, replace(model, start="rest"), u)
        return
    for system, state in (
        (hi.to_control(model), hi.initial_state(model, u[0])),
        (made["system"](), made["initial_state"](u[0])),
    ):
        assert isinstance(system, control.NonlinearIOSystem)
        found = control.input_output_response(system, times, u, state).outputs
        assert_same(np.atleast_1d(found), model, u)


@pytest.mark.parametrize("dt", [None, 0.1])
@pytest.mark.parametrize("name", LINEAR)
def test_the_linear_blocks_of_scipy_are_systems(name, dt):
    block = LINEAR[name]
    model = FittedModel(BlockChain((block, STATIC["saturation"]), dt))
    system = module(model, "scipy")["LINEAR"]["L"]
    assert system.dt == (dt or 1.0)
    u = np.random.default_rng(1).normal(size=40)
    np.testing.assert_allclose(system.output(u, None)[1][:, 0], block.filter(u), rtol=0, atol=1e-12)


def test_the_blocks_of_a_system_of_control_have_names():
    pytest.importorskip("control")
    model = FittedModel(BlockChain((STATIC["dead_zone"], LINEAR["gain"], STATIC["saturation"]), dt=0.1))
    system = hi.to_control(model)
    assert [block.name for block in system.syslist] == ["N1", "L", "N2"]
    assert system.dt == 0.1


def examples():
    """Models of every order, basis and kind of linear block, with both starts."""
    static, linear = list(STATIC.values()), list(LINEAR.values())
    for i, order in enumerate((*ORDERS, *(["N"] * len(static)), *(["L-N"] * len(linear)))):
        blocks = tuple(
            (linear if kind == "L" else static)[(i + j) % (4 if kind == "L" else 5)]
            for j, kind in enumerate(order.split("-"))
        )
        for start in ("rest", "settled"):
            yield FittedModel(BlockChain(blocks, dt=0.5), start=start)


@needs_octave
def test_octave_gives_the_same_response(tmp_path):
    u = np.random.default_rng(2).normal(size=60)
    formulas = (*GIVEN, hi.Expression(expression="where(1 > 0, u, -u)"))
    own = StaticFunction(Functions(formulas, -1.0, 1.0), (0.3, -0.2, 0.5, 1 / 3, 0.7, 0.9))
    made = [*examples(), FittedModel(BlockChain((LINEAR["gain"], own, LINEAR["delayed"])))]
    lines = [f"u = [{', '.join(map(repr, u.tolist()))}];"]
    for i, model in enumerate(made):
        (tmp_path / f"model_{i}.m").write_text(hi.convert(model, "matlab", f"model_{i}"))
        lines += [f"printf('%.17g ', model_{i}(u)); printf('\\n');"]
    lines += ["try, model_0(ones(2)), catch refused, disp(refused.message), end"]
    # A column stays a column, one sample is a signal, and none is none.
    lines += ["disp([size(model_0(u')), size(model_0(1)), size(model_0([])), size(model_1(single(u)))]);"]
    *responses, refused, sizes = printed(tmp_path, "\n".join(lines))
    assert len(responses) == len(made)
    for model, line in zip(made, responses, strict=True):
        assert_same(list(map(float, line.split())), model, u)
    assert refused == "model_0: the input must be a vector"
    assert sizes.split() == ["60", "1", "1", "1", "0", "0", "1", "60"]


NUMBER = re.compile(r"(?<![\w(.])-?\d+\.?\d*(?:e[-+]?\d+)?(?![\w(])")


@pytest.mark.parametrize("model", list(examples()))
def test_a_matlab_function_holds_every_number_to_the_last_bit(model):
    source = hi.convert(model, "matlab").partition("\nend\n")[0]
    held = set(map(float, NUMBER.findall(source)))
    for block in plain_blocks(model):
        rows = [block.b, block.a, block.state] if isinstance(block, Filter) else vars(block).values()
        assert set(np.hstack([np.ravel(row) for row in rows]).tolist()) <= held


@pytest.mark.parametrize("name", ["2nd", "my-model", "end", "x" * 64, "", "modèle", "a\n"])
def test_a_name_that_matlab_does_not_allow_is_refused(name):
    with pytest.raises(ConfigError) as caught:
        hi.convert(next(examples()), "matlab", name)
    assert str(caught.value) == (
        f"'{name}' cannot be the name of a MATLAB function: it must be letters, digits and underscores, "
        "begin with a letter, and have at most 63 of them"
    )


def test_an_unknown_target_is_refused_with_the_nearest():
    with pytest.raises(ConfigError) as caught:
        hi.convert(next(examples()), "mathlab")
    assert str(caught.value) == (
        "there is no target 'mathlab'; did you mean 'matlab'? (there are: python, scipy, control, matlab, "
        "simulink)"
    )


@pytest.mark.parametrize("to", ["python", "scipy", "control"])
def test_no_text_of_a_model_ends_a_docstring(to):
    evil = 'a"""\nimport os\\'
    about = {"input": evil, "output": "\0\u2028x", "data": {evil: "\udc80"}, "units": {"time": evil}}
    model = FittedModel(BlockChain((STATIC["saturation"], LINEAR["finite"]), dt=0.5), about=about)
    names = module(model, to)
    assert "os" not in names
    assert "from 'a''' import os/' to '?" in names["__doc__"]


def test_no_text_of_a_model_ends_a_comment():
    model = FittedModel(
        BlockChain((LINEAR["gain"],)), about={"input": "u\nsystem('ls')", "output": "y\rx", "method": "m"}
    )
    head = hi.convert(model, "matlab").partition("  if ~(isvector")[0]
    assert all(line.startswith("  %") for line in head.splitlines()[1:])


def test_a_block_that_cannot_start_settled_is_refused():
    model = FittedModel(BlockChain((TransferFunction(b=(1.0,), a=(1.0,)),)), start="settled")
    with pytest.raises(ConfigError, match="a block with a pole at z = 1 settles nowhere: start it from rest"):
        hi.convert(model, "python")
    hi.convert(replace(model, start="rest"), "python")


def test_without_control_the_message_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(ConfigError, match=re.escape("pip install 'hident[control]'")):
        hi.to_control(next(examples()))


def test_numbers_that_overflow_are_refused_without_a_warning():
    block = StaticFunction(PiecewiseLinear((0.0, 1e-300)), (-1e300, 1e300))
    with pytest.raises(ConfigError) as caught:
        hi.convert(FittedModel(BlockChain((block,))), "python")
    assert str(caught.value) == "the numbers of N are too large to be converted: a slope or state overflows"


@pytest.mark.parametrize("to", ["python", "scipy", "control", "matlab"])
def test_numbers_of_numpy_are_written_as_numbers(to):
    blocks: tuple[Block, ...] = (
        *(
            StaticFunction(function.basis, tuple(np.array(function.coefficients)))
            for function in STATIC.values()
        ),
        StaticFunction(PiecewiseLinear(tuple(np.array([0.0, 1.0]))), (1.0, 2.0)),
        StaticFunction(Saturation(np.float64(0.0), np.float64(1.0)), (1.0, 2.0)),
        TransferFunction(b=tuple(np.array([0.0, 1.0])), a=(np.float64(0.5),)),
    )
    source = hi.convert(FittedModel(BlockChain(blocks, dt=np.float64(0.5))), to)
    assert "float64" not in source
