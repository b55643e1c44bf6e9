"""The block-oriented systems: nonlinearities, static or with memory, and linear blocks in series."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Self

import numpy as np
from pydantic import model_validator

from hident.arrays import Array, Characteristic
from hident.config.spec import Of, component
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction
from hident.records import Held, Truth, Waveform
from hident.systems.base import MemorySpec, NonlinearitySpec, SystemSpec
from hident.systems.continuous import ContinuousSpec
from hident.systems.continuous_wiener_hammerstein import respond
from hident.systems.linear import DiscreteSpec, LinearSpec


@dataclass(frozen=True)
class Rescaled:
    """outside f(inside x), a characteristic between blocks that have given it their factors."""

    function: Characteristic
    inside: float = 1.0
    outside: float = 1.0

    def __call__(self, x: Array) -> Array:
        return np.asarray(self.outside * self.function(self.inside * x))


def _rescaled(truth: Truth, inside: float = 1.0, outside: float = 1.0) -> Truth:
    """The truth with factors before and after its nonlinearity; its linear blocks stay."""
    if truth.nonlinearity is None:
        return truth
    points = truth.breakpoints if inside == 1.0 else tuple(sorted(x / inside for x in truth.breakpoints))
    return replace(truth, nonlinearity=Rescaled(truth.nonlinearity, inside, outside), breakpoints=points)


def _holding(truth: Truth, block: TransferFunction | ContinuousTransferFunction) -> Truth:
    """The truth with its one linear block."""
    if isinstance(block, ContinuousTransferFunction):
        return replace(truth, continuous=block)
    return replace(truth, linear=block)


def _moved(factors: Mapping[str, float]) -> float:
    """What the linear block is divided by, and the nonlinearity takes."""
    return factors["linear"] if "linear" in factors else 1.0 / factors["nonlinearity"]


def _why_no_function(part: str, nonlinearity: NonlinearitySpec) -> str:
    """Why a truth holds no ``nonlinearity``, if that is the ``part`` that it lacks."""
    has_memory = part == "nonlinearity" and nonlinearity.characteristic() is None
    return f"{nonlinearity.kind} has memory and is no function of its input" if has_memory else ""


class _OneLinearBlock(SystemSpec):
    nonlinearity: Annotated[NonlinearitySpec, Of("nonlinearity")]
    """The nonlinearity; one with memory sees the samples, and begins anew in every experiment."""
    linear: Annotated[LinearSpec, Of("linear")]
    """The linear block."""

    def check(self, dt: float | None) -> None:
        self.linear.check(dt)

    def burn_in(self) -> int:
        return self.linear.burn_in()

    def lacks(self, part: str) -> str:
        return _why_no_function(part, self.nonlinearity)

    def truth(self) -> Truth:
        block = self.linear.transfer_function()
        truth = Truth(
            nonlinearity=self.nonlinearity.characteristic(),
            response=self.simulate,
            values=block.values(),
            breakpoints=self.nonlinearity.break_points(),
        )
        return _holding(truth, block)

    def _divided(self, factor: float) -> Truth:
        """The truth with the linear block divided by a factor."""
        truth = self.truth()
        block = self.linear.transfer_function().scaled(1.0 / factor)
        return _holding(replace(truth, values={**truth.values, **block.values()}), block)


@component("system", "hammerstein")
class Hammerstein(_OneLinearBlock):
    """A nonlinearity, then a linear block.

        y = G x,    x = f(u)

    Examples
    --------
    >>> import hident as hi
    >>> hi.Hammerstein(nonlinearity="abs", linear=hi.Fir(b=[1, 0.5])).simulate(np.array([-1.0, 2.0, 0.0]))
    array([1. , 2.5, 1. ])
    """

    def check_before(self, level: float) -> None:
        # The linear block, which is at rest, sees the nonlinearity's output.
        super().check_before(float(self.nonlinearity.simulate(np.array([level]))[0]))

    def simulate(self, u: Array, dt: float = 1.0) -> Array:
        return self.linear.simulate(self.nonlinearity.simulate(u), dt)

    def truth(self) -> Truth:
        """The parts of the system, the coefficients of a polynomial among the values.

        They are named a_j before a block without feedback, as Wang, Zhang and Ljung write them, and c_j
        where a_1, ..., a_p are the feedback.
        """
        truth = super().truth()
        letter = "c" if self.linear.transfer_function().a else "a"
        named = {f"{letter}_{j}": c for j, c in self.nonlinearity.coefficients_by_power().items()}
        values = {**truth.values, **named}
        return replace(truth, values=values, structure="N-L", rescaled=self._rescaled)

    def _rescaled(self, factors: Mapping[str, float]) -> Truth:
        moved = _moved(factors)
        truth = _rescaled(self._divided(moved), outside=moved)
        block = self.linear.transfer_function().values()
        values = {name: c if name in block else moved * c for name, c in truth.values.items()}
        return replace(truth, values=values)


@component("system", "wiener")
class Wiener(_OneLinearBlock):
    """A linear block, then a nonlinearity.

        y = f(x),    x = G u

    Examples
    --------
    >>> import hident as hi
    >>> hi.Wiener(linear=hi.Fir(b=[1, 0.5]), nonlinearity="abs").simulate(np.array([-1.0, 2.0, 0.0]))
    array([1. , 1.5, 1. ])
    """

    def simulate(self, u: Array, dt: float = 1.0) -> Array:
        return self.nonlinearity.simulate(self.linear.simulate(u, dt))

    def truth(self) -> Truth:
        return replace(super().truth(), structure="L-N", rescaled=self._rescaled)

    def _rescaled(self, factors: Mapping[str, float]) -> Truth:
        moved = _moved(factors)
        return _rescaled(self._divided(moved), inside=moved)


@component("system", "hammerstein_wiener")
class HammersteinWiener(SystemSpec):
    """A linear block between two nonlinearities.

    Examples
    --------
    >>> import hident as hi
    >>> block = hi.Fir(b=[1, 0.5])
    >>> system = hi.HammersteinWiener(input_nonlinearity="abs", linear=block, output_nonlinearity="sign")
    >>> system.simulate(np.array([-1.0, 2.0, 0.0]))
    array([1., 1., 1.])
    """

    input_nonlinearity: Annotated[NonlinearitySpec, Of("nonlinearity")]
    """The nonlinearity at the input."""
    linear: Annotated[LinearSpec, Of("linear")]
    """The linear block."""
    output_nonlinearity: Annotated[NonlinearitySpec, Of("nonlinearity")]
    """The nonlinearity at the output."""

    def check(self, dt: float | None) -> None:
        self.linear.check(dt)

    def burn_in(self) -> int:
        return self.linear.burn_in()

    def check_before(self, level: float) -> None:
        # The linear block, which is at rest, sees the output of the first nonlinearity.
        super().check_before(float(self.input_nonlinearity.simulate(np.array([level]))[0]))

    def simulate(self, u: Array, dt: float = 1.0) -> Array:
        x = self.linear.simulate(self.input_nonlinearity.simulate(u), dt)
        return self.output_nonlinearity.simulate(x)

    def lacks(self, part: str) -> str:
        return "it has two nonlinearities" if part == "nonlinearity" else ""

    def truth(self) -> Truth:
        block = self.linear.transfer_function()
        truth = Truth(response=self.simulate, values=block.values(), rescaled=self._rescaled)
        return _holding(truth, block)

    def _rescaled(self, factors: Mapping[str, float]) -> Truth:
        block = self.linear.transfer_function().scaled(1.0 / factors["linear"])
        return _holding(replace(self.truth(), values=block.values()), block)


def _start(initial: str | tuple[float, ...]) -> str:
    return initial if isinstance(initial, str) else str(list(initial))


@component("system", "wiener_hammerstein")
class WienerHammerstein(SystemSpec):
    """A nonlinearity between two linear blocks, both discrete or both continuous.

        y = Go f(Gi u)

    Continuous blocks are driven by the signal itself, not by its samples held: a sine is one between the
    samples too, from its periodic steady state; other signals find the system in equilibrium.

    Examples
    --------
    >>> import hident as hi
    >>> block = hi.Fir(b=[1, 0.5])
    >>> system = hi.WienerHammerstein(input_linear=block, nonlinearity="abs", output_linear=block)
    >>> system.simulate(np.array([-1.0, 2.0, 0.0]))
    array([1.  , 2.  , 1.75])
    """

    input_linear: Annotated[LinearSpec, Of("linear")]
    """The linear block before the nonlinearity."""
    nonlinearity: Annotated[NonlinearitySpec, Of("nonlinearity")]
    """The nonlinearity; between continuous blocks it has no memory."""
    output_linear: Annotated[LinearSpec, Of("linear")]
    """The linear block after the nonlinearity."""

    @model_validator(mode="after")
    def _check_blocks(self) -> Self:
        match self.input_linear, self.output_linear:
            case DiscreteSpec(initial=first), DiscreteSpec(initial=second):
                if (first == "stationary") != (second == "stationary"):
                    raise ValueError(
                        "both linear blocks must start stationary, or both from a given state, "
                        f"not {_start(first)} and {_start(second)}: "
                        "a burn-in would move the given state before the record"
                    )
            case ContinuousSpec() as first, ContinuousSpec() as second:
                if first.transfer_function().integrators or second.transfer_function().integrators:
                    raise ValueError(
                        "continuous blocks around a nonlinearity start from the equilibrium, which an "
                        "integrator does not have: take blocks without 'integrators', or discrete ones with "
                        "a pole at 1 and 'initial: zero'"
                    )
                if isinstance(self.nonlinearity, MemorySpec):
                    raise ValueError(
                        f"between continuous blocks a nonlinearity must have no memory, and "
                        f"{self.nonlinearity.kind} has: take discrete blocks"
                    )
            case first, second:
                raise ValueError(
                    "both linear blocks must be discrete, or both continuous, "
                    f"not {first.kind} and {second.kind}"
                )
        return self

    def check(self, dt: float | None) -> None:
        self.input_linear.check(dt)
        self.output_linear.check(dt)

    def burn_in(self) -> int:
        return self.input_linear.burn_in() + self.output_linear.burn_in()

    def follows_waveforms(self) -> bool:
        return isinstance(self.input_linear, ContinuousSpec)

    def respond(self, waveform: Waveform, n: int, dt: float) -> Array:
        blocks = self._continuous_blocks()
        return respond(blocks["input"], self.nonlinearity, blocks["output"], waveform, n, dt)

    def simulate(self, u: Array, dt: float = 1.0) -> Array:
        if self.follows_waveforms():
            return self.respond(Held(np.arange(float(len(u))) * dt, u), len(u), dt)
        x = self.nonlinearity.simulate(self.input_linear.simulate(u, dt))
        return self.output_linear.simulate(x, dt)

    def lacks(self, part: str) -> str:
        return _why_no_function(part, self.nonlinearity)

    def truth(self) -> Truth:
        values = {
            f"{side}_{name}": value
            for side, linear in (("input", self.input_linear), ("output", self.output_linear))
            for name, value in linear.transfer_function().values().items()
        }
        return Truth(
            nonlinearity=self.nonlinearity.characteristic(),
            response=self.simulate,
            blocks=self._continuous_blocks(),
            values=values,
            breakpoints=self.nonlinearity.break_points(),
            discrete_blocks=self._discrete_blocks(),
            structure="L-N-L",
            rescaled=self._rescaled,
        )

    def _rescaled(self, factors: Mapping[str, float]) -> Truth:
        truth = self.truth()
        sides = {side: factors.get(side, 1.0) for side in ("input", "output")}
        if "nonlinearity" in factors:
            # What stands behind takes it.
            sides["output"] /= factors["nonlinearity"]
        return replace(
            _rescaled(truth, sides["input"], sides["output"]),
            blocks={side: block.scaled(1.0 / sides[side]) for side, block in truth.blocks.items()},
            discrete_blocks={
                side: block.scaled(1.0 / sides[side]) for side, block in truth.discrete_blocks.items()
            },
            values={
                name: value / sides[side] if letter.startswith("b") else value
                for name, value in truth.values.items()
                for side, _, letter in [name.partition("_")]
            },
        )

    def _discrete_blocks(self) -> dict[str, TransferFunction]:
        """The blocks as numbers by their place; empty in continuous time."""
        sides = {"input": self.input_linear, "output": self.output_linear}
        blocks = {side: linear.transfer_function() for side, linear in sides.items()}
        return {side: block for side, block in blocks.items() if isinstance(block, TransferFunction)}

    def _continuous_blocks(self) -> dict[str, ContinuousTransferFunction]:
        """The blocks as numbers by their place; empty in discrete time."""
        sides = {"input": self.input_linear, "output": self.output_linear}
        return {side: b.transfer_function() for side, b in sides.items() if isinstance(b, ContinuousSpec)}
