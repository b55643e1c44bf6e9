"""Continuous linear blocks, with a delay that need not be a multiple of the sampling interval."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from hident.arrays import Array
from hident.config.spec import Real, component
from hident.linear_blocks import ContinuousTransferFunction
from hident.systems.base import Feedback, Numerator
from hident.systems.linear import LinearSpec


@component("linear", "continuous", source="Chen, Hwang, Chang 2009, eq. (1), (9)")
class Continuous(LinearSpec):
    """Continuous block (b_0 + ... + b_m s^m) e^(-delay s) / (1 + a_1 s + ... + a_n s^n), from rest.

    Its input is held from sample to sample (zero-order hold), and it is simulated exactly.

    Examples
    --------
    >>> [round(a, 3) for a in Continuous(a=[2]).transfer_function().sampled(dt=1.0).a]
    [0.607]
    """

    a: Feedback
    """Coefficients a_1, ..., a_n of the output's derivatives, in powers of the unit of time."""
    b: Numerator = (1.0,)
    """Coefficients b_0, ..., b_m of the input and its derivatives, m < n."""
    delay: Annotated[Real, Field(ge=0)] = 0.0
    """Delay d, in the unit of dt; need not be a multiple of dt."""

    @model_validator(mode="after")
    def _check_block(self) -> Self:
        block = self.transfer_function()
        if not block.is_stable():
            outside = ", ".join(
                f"{abs(p.real):.6g}" if p.imag == 0 else f"{abs(p.real):.6g}+-{p.imag:.6g}j"
                for p in block.poles()
                if p.real >= 0.0 and p.imag >= 0.0
            )
            raise ValueError(f"is unstable: the poles {outside} do not lie in the left half plane")
        return self

    def transfer_function(self) -> ContinuousTransferFunction:
        return ContinuousTransferFunction(self.b, self.a, self.delay)

    def simulate(self, w: Array, dt: float) -> Array:
        return self.transfer_function().respond(w, dt)

    def check(self, dt: float | None) -> None:
        if dt is None:
            raise ValueError("a continuous block needs the sampling interval 'dt' of the data")
