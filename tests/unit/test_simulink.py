"""A model as a script that builds it in Simulink: its blocks, its numbers, and what they compute.

Simulink is not here. Octave runs the script with stand-ins for the functions of Simulink that it calls, which
note the blocks and lines; they are then computed as Simulink's documentation says that these blocks work.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import hident as hi
from hident.block_chain import BlockChain
from hident.errors import ConfigError
from hident.fitted_model import FittedModel
from hident.models.plain_blocks import Filter, FormulaSum, plain_blocks
from hident.static_functions import StaticFunction
from hident.systems.function_basis import Functions
from tests.octave import needs_octave, printed
from tests.unit.model_maker import GIVEN
from tests.unit.test_conversion import NUMBER, examples

OFFSETS = {"offsets": {"input": 20.5, "output": -98.25}}
WITH_FORMULAS = BlockChain(
    (
        StaticFunction(Functions(GIVEN, -1.0, 1.0), (0.3, -0.2, 0.5, 1 / 3, 0.7)),
        hi.TransferFunction(b=(0.0, 0.5)),
    ),
    dt=0.5,
)
STAND_INS = {
    "load_system": "function load_system(name)\nend\n",
    "new_system": "function new_system(name)\n  global BLOCKS LINES\n  BLOCKS = {}; LINES = {};\nend\n",
    "open_system": "function open_system(name)\nend\n",
    "set_param": """\
function set_param(name, varargin)
  global SETTINGS
  SETTINGS = struct(varargin{:});
end
""",
    "add_block": """\
function add_block(source, path, varargin)
  global BLOCKS
  BLOCKS{end + 1} = struct('source', source, 'name', path(find(path == '/', 1) + 1:end), ...
    'set', struct(varargin{:}));
end
""",
    "add_line": """\
function add_line(model, from, to)
  global LINES
  LINES{end + 1} = {from(1:end - 2), to(1:end - 2)};
end
""",
    "sfroot": "function root = sfroot\n  root = struct('find', @(varargin) Chart(varargin{4}));\nend\n",
    # What is given to the chart becomes a file, as a block of its own, which knows no other functions.
    "Chart": """\
classdef Chart < handle
  properties
    Path
    Script
  end
  methods
    function chart = Chart(path)
      chart.Path = path;
    end
    function set.Script(chart, text)
      name = chart.Path(find(chart.Path == '/', 1) + 1:end);
      file = fopen(['block_' name '.m'], 'w');
      fputs(file, text);
      fclose(file);
      clear('-function', ['block_' name]);
    end
  end
end
""",
    "simulated": """\
function y = simulated(u)
  global BLOCKS LINES
  names = cellfun(@(block) block.name, BLOCKS, 'UniformOutput', false);
  assert(strcmp(LINES{1}{1}, 'u') && strcmp(LINES{end}{2}, 'y'));
  for k = 2:numel(LINES)
    assert(strcmp(LINES{k - 1}{2}, LINES{k}{1}));
  end
  y = u;
  for k = 1:numel(LINES) - 1
    block = BLOCKS{strcmp(names, LINES{k}{2})};
    switch block.source
      case 'simulink/Math Operations/Bias'
        y = y + str2num(block.set.Bias);
      case 'simulink/Discrete/Discrete Filter'
        y = direct_form_ii(str2num(block.set.Numerator), str2num(block.set.Denominator), ...
          str2num(block.set.InitialStates), y);
      case 'simulink/User-Defined Functions/MATLAB Function'
        y = arrayfun(str2func(['block_' block.name]), y);
      otherwise
        error(block.source);
    end
  end
end

function y = direct_form_ii(b, a, state, x)
  w = state * ones(1, numel(a) - 1);
  for k = 1:numel(x)
    now = x(k) - a(2:end) * w';
    y(k) = b * [now, w]';
    w = [now, w(1:end - 1)];
  end
end
""",
}


def octave(folder, program):
    """What Octave prints of a program, with the stand-ins at hand."""
    for name, text in STAND_INS.items():
        (folder / f"{name}.m").write_text(text)
    return printed(folder, program)


def cases():
    for model in (*examples(), FittedModel(WITH_FORMULAS), FittedModel(WITH_FORMULAS, start="rest")):
        yield model
        yield replace(model, about=OFFSETS)


@needs_octave
def test_the_blocks_give_the_response_of_the_model(tmp_path):
    u = np.random.default_rng(2).normal(size=40) + 20.0
    made = list(cases())
    lines = ["global SETTINGS", f"u = [{', '.join(map(repr, u.tolist()))}];"]
    for i, model in enumerate(made):
        (tmp_path / f"m{i}.m").write_text(hi.convert(model, "simulink", f"m{i}"))
        lines += [f"m{i}({'u(1)' if model.start == 'settled' else ''}); printf('%.17g ', simulated(u));"]
        lines += ["printf('\\n%s\\n', SETTINGS.FixedStep);"]
    found = octave(tmp_path, "\n".join(lines))
    assert len(found) == 2 * len(made)
    for model, line, step in zip(made, found[::2], found[1::2], strict=True):
        scale = max(1.0, *(float(np.max(np.abs(signal))) for signal in model.signals(u)))
        np.testing.assert_allclose(
            list(map(float, line.split())), model.simulate(u), rtol=0.0, atol=1e-11 * scale
        )
        assert float(step) == 0.5


@needs_octave
def test_without_a_first_input_it_begins_at_its_offset(tmp_path):
    model = replace(next(examples()), start="settled", about=OFFSETS)
    (tmp_path / "tank.m").write_text(hi.convert(model, "simulink", "tank"))
    [line] = octave(tmp_path, "tank(); printf('%.17g ', simulated([20.5, 21]));")
    np.testing.assert_allclose(
        list(map(float, line.split())), model.simulate(np.array([20.5, 21.0])), atol=1e-12
    )


@pytest.mark.parametrize("model", list(cases()))
def test_each_block_is_there_with_its_numbers_to_the_last_bit(model):
    source = hi.convert(model, "simulink", "tank")
    held = set(map(float, NUMBER.findall(source)))
    for name, block in zip(model.chain.names, plain_blocks(model), strict=True):
        if isinstance(block, Filter):
            assert re.search(rf"linear_block\(model, \d, '{name}', b, a, x\);", source)
            numbers = [block.b, block.a]
        else:
            assert re.search(rf"static_block\(model, \d, '{name}'\);", source)
            assert f"function y = {name}(u)" in source
            numbers = [block.coefficients] if isinstance(block, FormulaSum) else list(vars(block).values())
        assert set(np.hstack([np.ravel(row) for row in numbers]).tolist()) <= held
    for name, value in (("before", -model.offsets[0]), ("after", model.offsets[1])):
        assert (f"'{name}', 'Math Operations/Bias', 'Bias', '{value!r}'" in source) == bool(value)
    assert max(map(len, source.splitlines())) <= 110


def test_names_are_those_that_matlab_allows():
    model = next(examples())
    hi.convert(model, "simulink", "x" * 57)
    with pytest.raises(ConfigError, match="begin with a letter, and have at most 57 of them"):
        hi.convert(model, "simulink", "x" * 58)
    with pytest.raises(ConfigError, match="'2nd' cannot be the name of a MATLAB function"):
        hi.convert(model, "simulink", "2nd")


def test_no_text_of_a_model_ends_a_comment():
    about = {"input": "u\nsystem('ls')", "output": "y\r%% static functions", "units": {"time": "s\n"}}
    model = replace(next(examples()), about=about)
    source = hi.convert(model, "simulink", "tank")
    head = (
        source.partition("  if nargin")[0] if model.start == "settled" else source.partition("  model =")[0]
    )
    assert all(line.startswith("  %") for line in head.splitlines()[1:])
