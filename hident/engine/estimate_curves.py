"""What an estimate says in numbers: its parameters, and its blocks as curves, beside the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hident.arrays import Array
from hident.engine.replay import Realised
from hident.fitted_model import FittedModel
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction
from hident.records import Record, needed
from hident.static_functions import StaticFunction
from hident.systems.blocks import Wiener

POINTS = 201
"""The points of every curve."""
_OMEGA = np.geomspace(1e-3, 1.0, POINTS) * np.pi
"""Angular frequencies of a discrete block, in radians per sample."""
_BEYOND = 30.0
"""How far beyond its slowest and its fastest pole a continuous block's frequencies reach."""
_SETTLED = 0.001
_FAST, _SLOW = 0.5, 0.99
"""Moduli of the dominant pole beyond which a step response is shown no shorter and no longer."""

Linear = TransferFunction | ContinuousTransferFunction


@dataclass(frozen=True, eq=False)
class Curve:
    """One part of an estimate at the points ``x`` (n,), and what is true there (nan: not known).

    ``part`` is nonlinearity, step_response, gain or phase. Abscissas are inputs, times or angular
    frequencies, in the units of the data; phases are in radians.
    """

    part: str
    x: Array
    values: Array
    true: Array


def parameters(realised: Realised) -> Iterator[tuple[str, float, float]]:
    """The values of an estimate that there is: name, value and truth in its form (nan: not known)."""
    truth = realised.truth
    for name, value in needed(realised.found).values.items():
        yield name, float(value), float(truth.values.get(name, np.nan))


@np.errstate(all="ignore")
def curves(realised: Realised) -> Iterator[Curve]:
    """The curves of an estimate that there is: of its nonlinearity, and of its linear block."""
    found, truth = needed(realised.found), realised.truth
    if found.nonlinearity is not None:
        x = np.linspace(*_range(realised), POINTS)
        yield Curve("nonlinearity", x, _at(found.nonlinearity, x), _at(truth.nonlinearity, x))
    block = found.linear or found.continuous
    if block is not None:
        dt = 1.0 if needed(realised.record).dt is None else float(needed(realised.record).dt or 1.0)
        yield from _of_linear(block, truth.linear or truth.continuous, dt)


def _at(function: Callable[[Array], Array] | None, x: Array) -> Array:
    return np.full(len(x), np.nan) if function is None else np.asarray(function(x), dtype=float)


def _range(realised: Realised) -> tuple[float, float]:
    """Where a nonlinearity is shown: where a metric scores it, or else where its input was."""
    scored = (getattr(metric, "interval", None) for metric in realised.unit.metrics.values())
    if (interval := next(filter(None, scored), None)) is not None:
        return float(interval[0]), float(interval[1])
    x = _input_of_nonlinearity(realised)
    x = x[np.isfinite(x)]
    low, high = (float(np.min(x)), float(np.max(x))) if len(x) else (-1.0, 1.0)
    return (low, high) if low < high else (low - 1.0, high + 1.0)


def _input_of_nonlinearity(realised: Realised) -> Array:
    found, record = needed(realised.found), needed(realised.record)
    if "internal_variable" in found.details:
        return np.asarray(found.details["internal_variable"][0])
    if isinstance(found.model, FittedModel):
        blocks = found.model.chain.blocks
        place = next(i for i, block in enumerate(blocks) if isinstance(block, StaticFunction))
        if (fitted := found.model.range_of(place)) is not None:
            return np.array(fitted)
    if isinstance(realised.unit.data.system, Wiener) and (block := found.linear or found.continuous):
        return _filtered(block, record)
    return record.u


def _filtered(block: Linear, record: Record) -> Array:
    if isinstance(block, TransferFunction):
        return block.filter(record.u)
    return block.respond(record.u, 1.0 if record.dt is None else record.dt)


def _of_linear(block: Linear, true: Linear | None, dt: float) -> Iterator[Curve]:
    """Step response, gain and phase; a true block in continuous time is seen as held inputs see it."""
    other: Linear | None
    t: Array
    if isinstance(block, TransferFunction):
        discrete = true.sampled(dt) if isinstance(true, ContinuousTransferFunction) else true
        other, omega = discrete, _OMEGA / dt
        t = dt * np.arange(float(max(_samples(one) for one in (block, discrete or block))))
    else:
        continuous = true if isinstance(true, ContinuousTransferFunction) else None
        other, omega = continuous, _frequencies(block)
        longest = max(_duration(one, dt) for one in (block, continuous or block))
        t = np.linspace(0.0, longest, POINTS).astype(float)
    nothing = np.full(len(omega), np.nan)
    yield Curve(
        "step_response",
        t,
        _step_response(block, t),
        np.full(len(t), np.nan) if other is None else _step_response(other, t),
    )
    response = _response(block, omega, dt)
    true_response = None if other is None else _response(other, omega, dt)
    for part, of in (("gain", np.abs), ("phase", lambda values: np.unwrap(np.angle(values)))):
        yield Curve(part, omega, of(response), nothing if true_response is None else of(true_response))


def _samples(block: TransferFunction) -> int:
    """The samples in which a step response settles, within reason."""
    radius = float(np.clip(block.radius(), _FAST, _SLOW))
    return int(np.ceil(np.log(_SETTLED) / np.log(radius))) + len(block.b)


def _duration(block: ContinuousTransferFunction, dt: float) -> float:
    slowest = -float(np.max(block.poles().real))
    return block.delay + (-np.log(_SETTLED) / slowest if slowest > 0.0 else POINTS * dt)


def _frequencies(block: ContinuousTransferFunction) -> Array:
    sizes = np.abs(block.poles())
    return np.geomspace(np.min(sizes) / _BEYOND, np.max(sizes) * _BEYOND, POINTS)


def _step_response(block: Linear, t: Array) -> Array:
    step = np.ones(len(t))
    return block.filter(step) if isinstance(block, TransferFunction) else block.respond(step, float(t[1]))


def _response(block: Linear, omega: Array, dt: float) -> NDArray[np.complex128]:
    if isinstance(block, ContinuousTransferFunction):
        return block.frequency_response(omega)
    q = np.exp(-1j * omega * dt)
    ratio = np.polyval(block.b[::-1], q) / np.polyval(block.denominator[::-1], q)
    return np.asarray(ratio, dtype=np.complex128)
