"""A model for python-control: a system in discrete time, or a module that builds it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from hident.arrays import Array
from hident.fitted_model import FittedModel
from hident.linear_blocks import TransferFunction, python_control
from hident.models.plain_blocks import Filter, PlainBlock, as_filter, plain_blocks
from hident.models.python_source import CURVES, as_rows, call, curves, head, joined, numbers
from hident.models.source_text import added, kind_of

_SYSTEM = "system() is the model as a system of python-control."
_START = "control.input_output_response(system(), t, u, initial_state(u[0])) is its response."
_PRODUCT = '''\
def system():
    """The product of the linear blocks."""
    return (
        %s
    )
'''
_BLOCKS = '''\
def linear(name, b, a, state):
    """The filter sum_i a[i] y[k-i] = sum_i b[i] x[k-i], in direct form II transposed."""
    A, B = np.eye(len(state), k=1), np.subtract(b[1:], np.multiply(b[0], a[1:]))
    A[:, 0] -= a[1:]
    C = np.eye(1, len(state))
    return control.ss(A, B[:, None], C, b[0], DT, inputs=["u"], outputs=["y"], name=name)


def static(name, function):
    """A system without states."""
    return control.NonlinearIOSystem(
        None, lambda t, x, u, params: function(u), inputs=["u"], outputs=["y"], dt=DT, name=name
    )


def system():
    """The blocks one after the other, each a subsystem of its name."""
    names = list(BLOCKS)
    blocks = [(linear(name, **b) if isinstance(b, dict) else static(name, b)) for name, b in BLOCKS.items()]
    if len(blocks) == 1:
        return blocks[0]
    return control.interconnect(
        blocks,
        [[f"{after}.u", f"{before}.y"] for before, after in zip(names, names[1:])],
        inplist=[f"{names[0]}.u"],
        outlist=[f"{names[-1]}.y"],
        inputs=["u"],
        outputs=["y"],
    )


def initial_state(first):
    """The state at the first sample, to an input that begins with this value."""
    x, states = np.array([float(first)]), [np.zeros(0)]
    for block in BLOCKS.values():
        if isinstance(block, dict):
            states.append(np.multiply(block["state"], x))
            x = (block["b"][0] + block["state"][0]) * x
        else:
            x = block(x)
    return np.concatenate(states)
'''


def to_control(model: FittedModel) -> Any:
    """The model as a system of python-control, in discrete time.

    A chain of linear blocks is a :class:`control.TransferFunction`, any other a
    :class:`control.NonlinearIOSystem` whose subsystems are the blocks, by their names. So is a linear one
    whose model has offsets, which are subsystems of their own (``before`` and ``after``). How the model
    starts is no part of a system: ``X0=initial_state(model, u[0])`` tells ``control.input_output_response``.

    Raises
    ------
    ConfigError
        If python-control is not installed.

    Examples
    --------
    >>> import hident as hi
    >>> from hident.block_chain import BlockChain
    >>> block = hi.TransferFunction(b=(0.0, 0.5), a=(0.5,))
    >>> to_control(hi.FittedModel(BlockChain((block, block), dt=4.0))).poles().real
    array([0.5, 0.5])
    """
    control, chain = python_control(), model.chain
    dt: Any = True if chain.dt is None else chain.dt
    if _is_linear(model):
        system = control.TransferFunction([1.0], [1.0], dt)
        for block in chain.linear:
            system = system * block.to_control(dt)
        return system
    stages: dict[str, TransferFunction | Callable[[Array], Array]] = {
        **{name: partial(np.add, by) for name, by in _before(model).items()},
        **dict(zip(chain.names, chain.blocks, strict=True)),
        **{name: partial(np.add, by) for name, by in _after(model).items()},
    }
    blocks = [
        _state_space(as_filter(block, settled=False), dt, name)
        if isinstance(block, TransferFunction)
        else control.NonlinearIOSystem(
            None,
            lambda t, x, u, params, block=block: block(u),
            inputs=["u"],
            outputs=["y"],
            dt=dt,
            name=name,
        )
        for name, block in stages.items()
    ]
    if len(blocks) == 1:
        return blocks[0]
    names = list(stages)
    return control.interconnect(
        blocks,
        [[f"{after}.u", f"{before}.y"] for before, after in pairwise(names)],
        inplist=[f"{names[0]}.u"],
        outlist=[f"{names[-1]}.y"],
        inputs=["u"],
        outputs=["y"],
    )


def _is_linear(model: FittedModel) -> bool:
    return not (model.chain.static or any(model.offsets))


def _before(model: FittedModel) -> dict[str, float]:
    """What is added before the blocks, by the name of its subsystem; nothing without an offset."""
    return {"before": -model.offsets[0]} if model.offsets[0] else {}


def _after(model: FittedModel) -> dict[str, float]:
    return {"after": model.offsets[1]} if model.offsets[1] else {}


def initial_state(model: FittedModel, first: float) -> Array:
    """The state of :func:`to_control`'s system at the first sample, to an input that begins with ``first``.

    Examples
    --------
    >>> import hident as hi
    >>> from hident.block_chain import BlockChain
    >>> initial_state(hi.FittedModel(BlockChain((hi.TransferFunction(b=(0.0, 0.5), a=(0.5,)),))), 3.0)
    array([3.])
    """
    states, x = [np.zeros(0)], np.array([float(first)])
    for before, block in zip(model.signals(x)[:-1], model.chain.blocks, strict=True):
        if isinstance(block, TransferFunction):
            states.append(np.multiply(as_filter(block, settled=model.past == "settled").state, before[0]))
    return np.concatenate(states)


def control_source(model: FittedModel) -> str:
    """Source of a module with a function ``system()`` that builds the system of :func:`to_control`."""
    blocks, chain = plain_blocks(model), model.chain
    interval = f"DT = {True if chain.dt is None else float(chain.dt)!r}\n"
    if _is_linear(model):
        rows = [as_rows(block) for block in chain.linear]
        factors = [call("control.TransferFunction", (*row, "DT"), {}, " " * 8) for row in rows]
        product = "\n        * ".join(factors)
        return joined(
            f"{head(model, [_SYSTEM])}import control\n\n{interval}",
            _PRODUCT % product,
        )
    made = "".join(
        [
            *(f'    "{name}": lambda x: x{added(by)},\n' for name, by in _before(model).items()),
            *(
                f'    # {kind_of(block)}\n    "{name}": {_entry(plain)},\n'
                for name, block, plain in zip(chain.names, chain.blocks, blocks, strict=True)
            ),
            *(f'    "{name}": lambda x: x{added(by)},\n' for name, by in _after(model).items()),
        ]
    )
    return joined(
        f"{head(model, [_SYSTEM, _START])}import control\nimport numpy as np\n\n{interval}",
        *curves(blocks),
        f"BLOCKS = {{\n{made}}}\n",
        _BLOCKS,
    )


def _entry(plain: PlainBlock) -> str:
    if isinstance(plain, Filter):
        return call("dict", (), numbers(plain), "    ")
    return f"lambda x: {call(CURVES[type(plain)][0], ['x'], numbers(plain), '    ')}"


def _state_space(block: Filter, dt: Any, name: str) -> Any:
    """The filter in direct form II transposed, whose state is that of :class:`Filter`."""
    b, a = np.asarray(block.b), np.asarray(block.a)
    A = np.eye(len(block.state), k=1)
    A[:, 0] -= a[1:]
    B, C = (b[1:] - b[0] * a[1:])[:, None], np.eye(1, len(A))
    return python_control().ss(A, B, C, b[0], dt, inputs=["u"], outputs=["y"], name=name)
