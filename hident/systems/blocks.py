"""The block-oriented systems: static nonlinearities and linear blocks in series."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Self

from pydantic import model_validator

from hident.config.spec import Of, component
from hident.records import Array, Truth
from hident.systems.base import NonlinearitySpec, SystemSpec
from hident.systems.continuous import ContinuousTransferFunction
from hident.systems.linear import DiscreteSpec, LinearSpec


class _OneLinearBlock(SystemSpec):
    nonlinearity: Annotated[NonlinearitySpec, Of("nonlinearity")]
    """The static nonlinearity."""
    linear: Annotated[LinearSpec, Of("linear")]
    """The linear block."""

    def check(self, dt: float | None) -> None:
        self.linear.check(dt)

    def burn_in(self) -> int:
        return self.linear.burn_in()

    def truth(self) -> Truth:
        block = self.linear.transfer_function()
        truth = Truth(
            nonlinearity=self.nonlinearity,
            values=block.values(),
            breakpoints=self.nonlinearity.break_points(),
        )
        if isinstance(block, ContinuousTransferFunction):
            return replace(truth, continuous=block)
        return replace(truth, linear=block)


@component("system", "hammerstein")
class Hammerstein(_OneLinearBlock):
    """A static nonlinearity, then a linear block."""

    def simulate(self, u: Array, dt: float = 1.0) -> Array:
        return self.linear.simulate(self.nonlinearity(u), dt)

    def truth(self) -> Truth:
        """The parts of the system, the coefficients of a polynomial among the values.

        They are named a_j before a block without feedback, as Wang, Zhang and Ljung write them, and c_j
        where a_1, ..., a_p are the feedback.
        """
        truth = super().truth()
        letter = "c" if self.linear.transfer_function().a else "a"
        named = {f"{letter}_{j}": c for j, c in self.nonlinearity.coefficients_by_power().items()}
        return replace(truth, values={**truth.values, **named})


@component("system", "wiener")
class Wiener(_OneLinearBlock):
    """A linear block, then a static nonlinearity."""

    def simulate(self, u: Array, dt: float = 1.0) -> Array:
        return self.nonlinearity(self.linear.simulate(u, dt))


def _start(initial: str | tuple[float, ...]) -> str:
    return initial if isinstance(initial, str) else str(list(initial))


@component("system", "wiener_hammerstein")
class WienerHammerstein(SystemSpec):
    """A static nonlinearity between two linear blocks."""

    input_linear: Annotated[LinearSpec, Of("linear")]
    """The linear block before the nonlinearity."""
    nonlinearity: Annotated[NonlinearitySpec, Of("nonlinearity")]
    """The static nonlinearity."""
    output_linear: Annotated[LinearSpec, Of("linear")]
    """The linear block after the nonlinearity."""

    @model_validator(mode="after")
    def _check_starts(self) -> Self:
        if not (isinstance(self.input_linear, DiscreteSpec) and isinstance(self.output_linear, DiscreteSpec)):
            raise ValueError("both linear blocks must be discrete")
        first, second = self.input_linear.initial, self.output_linear.initial
        if (first == "stationary") != (second == "stationary"):
            raise ValueError(
                "both linear blocks must start stationary, or both from a given state, "
                f"not {_start(first)} and {_start(second)}: "
                "a burn-in would move the given state before the record"
            )
        return self

    def burn_in(self) -> int:
        return self.input_linear.burn_in() + self.output_linear.burn_in()

    def simulate(self, u: Array, dt: float = 1.0) -> Array:
        return self.output_linear.simulate(self.nonlinearity(self.input_linear.simulate(u, dt)), dt)

    def truth(self) -> Truth:
        values = {
            f"{side}_{name}": value
            for side, linear in (("input", self.input_linear), ("output", self.output_linear))
            for name, value in linear.transfer_function().values().items()
        }
        return Truth(
            nonlinearity=self.nonlinearity,
            values=values,
            breakpoints=self.nonlinearity.break_points(),
        )
