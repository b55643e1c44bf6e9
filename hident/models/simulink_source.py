"""A model as a MATLAB function that builds it in Simulink.

A linear block becomes a Discrete Filter, a static one a MATLAB Function block, and an offset a Bias. A
Discrete Filter works in direct form II, whose states all have one value once it has settled to a constant
input x: x/(a_0 + ... + a_n).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from hident.fitted_model import FittedModel
from hident.models.formula_source import MATLAB
from hident.models.matlab_source import called, functions, require_name, written
from hident.models.plain_blocks import Filter, FormulaSum, PlainBlock, plain_blocks
from hident.models.python_source import dt
from hident.models.source_text import added, facts, kind_of, one_line, title

_SUFFIX = "_model"
_EXPRESSION = replace(MATLAB, function="{}")
"""A formula by itself: MATLAB Function blocks become code, which functions in lists cannot."""
_LINEAR = """\
function linear_block(model, place, name, b, a, x)
  % a Discrete Filter that has settled to the input x
  add(model, place, name, 'Discrete/Discrete Filter', 'Numerator', mat2str(b, 17), ...
    'Denominator', mat2str(a, 17), 'InitialStates', sprintf('%.17g', x / sum(a)), 'SampleTime', '-1');
end
"""
_STATIC = """\
function static_block(model, place, name)
  % a MATLAB Function block, of the code from 'static functions' on
  add(model, place, name, 'User-Defined Functions/MATLAB Function');
  text = fileread([mfilename('fullpath') '.m']);
  code = text(strfind(text, ['%% static' ' functions']):end);
  root = sfroot;
  chart = root.find('-isa', 'Stateflow.EMChart', 'Path', [model '/' name]);
  chart.Script = sprintf('function y = block_%s(u)\\n  y = %s(u);\\nend\\n\\n%s', name, name, code);
end
"""
_ADD = """\
function add(model, place, name, block, varargin)
  % a block of Simulink's library, at its place in a row
  left = 30 + 130 * place;
  add_block(['simulink/' block], [model '/' name], 'Position', [left, 40, left + 80, 80], varargin{:});
end
"""


def simulink_source(model: FittedModel, name: str = "response") -> str:
    """Source of the file ``name.m``: a function that builds the Simulink model ``name_model``.

    Raises
    ------
    ConfigError
        If MATLAB allows no function or model of that name.

    Examples
    --------
    >>> import hident as hi
    >>> from hident.block_chain import BlockChain
    >>> block = hi.TransferFunction(b=(0.0, 0.5), a=(0.5,))
    >>> source = simulink_source(hi.FittedModel(BlockChain((block,), dt=4.0)), "tank")
    >>> print(*[line for line in source.splitlines() if "_block(model" in line][:1])
      linear_block(model, 1, 'L', b, a, x);
    """
    require_name(name, len(_SUFFIX))
    chain, blocks = model.chain, plain_blocks(model)
    named = list(zip(chain.names, chain.blocks, blocks, strict=True))
    settled = model.past == "settled"
    before, after = model.offsets
    begins = f"It begins settled to an input of {before!r}, by {name}(first) to one that is given."
    stages = ["u", *["before"] * bool(before), *chain.names, *["after"] * bool(after), "y"]
    places = {stage: place for place, stage in enumerate(stages)}
    listed = ", ".join(f"'{stage}'" for stage in stages)
    lines = [
        f"function {name}({'first' if settled else ''})",
        f"  % {one_line(title(model))}",
        f"  % {name} builds the Simulink model {name}{_SUFFIX} of it, from the input u to the output y.",
        *(f"  % {one_line(fact)}" for fact in facts(model, begins)),
        *(["  if nargin < 1", f"    first = {before!r};", "  end"] * settled),
        f"  model = '{name}{_SUFFIX}';",
        "  load_system('simulink');",
        "  new_system(model);",
        "  set_param(model, 'SolverType', 'Fixed-step', 'Solver', 'FixedStepDiscrete', ...",
        f"    'FixedStep', '{dt(model)!r}', 'SaveOutput', 'on', 'SaveFormat', 'Array');",
        f"  add(model, 0, 'u', 'Sources/In1', 'SampleTime', '{dt(model)!r}');",
        "  % x is what a block has settled to at its input",
        f"  x = {'first' if settled else '0'}{added(-before) if settled else ''};",
    ]
    lines += [_bias(places["before"], "before", -before)] if before else []
    for label, block, plain in named:
        lines += [f"  % {label}: {kind_of(block)}", *_built(places[label], label, plain, settled)]
    lines += [_bias(places["after"], "after", after)] if after else []
    lines += [
        f"  add(model, {places['y']}, 'y', 'Sinks/Out1');",
        f"  names = {{{listed}}};",
        "  for k = 2:numel(names)",
        "    add_line(model, [names{k - 1} '/1'], [names{k} '/1']);",
        "  end",
        "  open_system(model);",
        "end",
        "",
    ]
    static = {label: plain for label, _, plain in named if not isinstance(plain, Filter)}
    parts = ["\n".join(lines), _ADD]
    parts += [_LINEAR] if len(static) < len(named) else []
    if static:
        own = [_function(label, plain) for label, plain in static.items()]
        parts += [_STATIC, "%% static functions\n", *own, *functions(static.values(), own)]
    return "\n".join(parts)


def _bias(place: int, name: str, by: float) -> str:
    return f"  add(model, {place}, '{name}', 'Math Operations/Bias', 'Bias', '{by!r}');"


def _built(place: int, name: str, plain: PlainBlock, settled: bool) -> Iterator[str]:
    """What adds a block, and takes what it is settled to on to the next one."""
    if not isinstance(plain, Filter):
        yield f"  static_block(model, {place}, '{name}');"
        if settled:
            yield f"  x = {name}(x);"
        return
    yield f"  b = {written(plain.b)};"
    yield f"  a = {written(plain.a)};"
    yield f"  linear_block(model, {place}, '{name}', b, a, x);"
    if settled:
        yield "  x = x * sum(b) / sum(a);"


def _function(name: str, plain: PlainBlock) -> str:
    """A static block as a function of a number."""
    if isinstance(plain, FormulaSum):
        terms = zip(plain.coefficients, map(_EXPRESSION.written, plain.functions), strict=True)
        body = " ...\n    + ".join(f"{c!r} * {text}" for c, text in terms)
    else:
        body = called(plain, "u")
    return f"function y = {name}(u)\n  y = {body};\nend\n"
