"""What every linear block answers, and the discrete ones; the continuous one is in ``continuous.py``."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import PlainValidator, TypeAdapter, WithJsonSchema, field_validator, model_validator

from hident.arrays import Array
from hident.config.spec import Component, Real, component
from hident.linear_blocks import SLOWEST, ContinuousTransferFunction, TransferFunction
from hident.numerics.rounding import apart
from hident.systems.base import Feedback, Numerator

_PAST_OUTPUTS: TypeAdapter[tuple[float, ...]] = TypeAdapter(tuple[Real, ...])


def _as_initial(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return _PAST_OUTPUTS.validate_python(value)
    if value not in ("stationary", "zero"):
        raise ValueError(
            f"must be 'stationary', 'zero' or the list of past outputs v_-1, ..., v_-p, not {value!r}"
        )
    return value


class LinearSpec(Component):
    """Base of all linear blocks."""

    def transfer_function(self) -> TransferFunction | ContinuousTransferFunction:
        """The block as numbers."""
        raise NotImplementedError

    def check(self, dt: float | None) -> None:
        """Raise ValueError if the block cannot work at sampling interval ``dt`` (None: discrete time)."""

    def burn_in(self) -> int:
        """Samples before the record after which the start no longer matters; 0 for a given start."""
        return 0

    def simulate(self, w: Array, dt: float) -> Array:
        """The response v (N,) to ``w`` (N,), sampled every ``dt``, from its start."""
        raise NotImplementedError


class DiscreteSpec(LinearSpec):
    """Base of all discrete linear blocks."""

    initial: Annotated[
        Literal["stationary", "zero"] | tuple[float, ...],
        PlainValidator(_as_initial),
        WithJsonSchema(
            {
                "anyOf": [
                    {"enum": ["stationary", "zero"]},
                    {"type": "array", "items": {"anyOf": [{"type": "number"}, {"type": "string"}]}},
                ]
            }
        ),
    ] = "stationary"
    """Start: stationary (after a burn-in), zero, or the outputs v_-1, ..., v_-p before the record."""

    def transfer_function(self) -> TransferFunction:
        """The block as numbers."""
        raise NotImplementedError

    @model_validator(mode="after")
    def _check_poles_and_start(self) -> Self:
        block = self.transfer_function()
        if not block.is_stable(integrators=True):
            raise ValueError(f"is unstable: poles {_unstable_poles(block)} lie on or outside the unit circle")
        if self.initial == "stationary" and block.integrators():
            raise ValueError(
                "has a pole at 1, an integrator, which has no stationary start: "
                "set 'initial: zero', or give the past outputs"
            )
        if self.initial == "stationary" and (radius := block.radius()) > SLOWEST:
            raise ValueError(
                f"has a pole of modulus {apart(radius, SLOWEST, 8)}, too slow for a stationary start "
                f"(at most {SLOWEST}): set 'initial' to zero or to the past outputs"
            )
        if not isinstance(self.initial, str) and len(self.initial) != len(block.a):
            raise ValueError(
                f"'initial' must have as many past outputs as there are coefficients a ({len(block.a)}), "
                f"not {len(self.initial)}"
            )
        return self

    def burn_in(self) -> int:
        return self._memory if self.initial == "stationary" else 0

    @cached_property
    def _memory(self) -> int:
        return self.transfer_function().memory()

    def simulate(self, w: Array, dt: float = 1.0) -> Array:
        """The response v (N,) to ``w`` (N,) from the given start, or from rest before a burn-in."""
        past = None if isinstance(self.initial, str) else np.array(self.initial)
        return self.transfer_function().filter(w, past)


def _unstable_poles(block: TransferFunction) -> str:
    """The poles on or outside the unit circle, a conjugate pair once, with its modulus."""
    return ", ".join(
        apart(pole.real, 1.0, 6)
        if pole.imag == 0
        else f"{pole.real:.6g}+-{pole.imag:.6g}j (modulus {apart(abs(pole), 1.0, 6)})"
        for pole in block.poles()
        if abs(pole) >= 1.0 and pole.imag >= 0
    )


class _WithNumerator(DiscreteSpec):
    b: Numerator
    """Numerator b_0, b_1, ...; leading zeros are a delay."""


@component("linear", "fir")
class Fir(_WithNumerator):
    """Finite impulse response: v_k = b_0 w_k + b_1 w_{k-1} + ...

    Examples
    --------
    >>> Fir(b=[0, 0.5]).simulate(np.array([1.0, 2.0, 3.0]))
    array([0. , 0.5, 1. ])
    """

    def transfer_function(self) -> TransferFunction:
        return TransferFunction(b=self.b)


@component("linear", "ar", source="Mzyk 2009, A2")
class Ar(DiscreteSpec):
    """Autoregression: v_k = a_1 v_{k-1} + ... + a_p v_{k-p} + b_0 w_k.

    Examples
    --------
    >>> Ar(a=[0.5]).simulate(np.array([1.0, 0.0, 0.0]))
    array([1.  , 0.5 , 0.25])
    """

    a: Feedback
    """Feedback a_1, ..., a_p."""
    b0: Real = 1.0
    """Gain b_0 of the input."""

    @field_validator("b0")
    @classmethod
    def _check_b0(cls, b0: float) -> float:
        if b0 == 0.0:
            raise ValueError("must not be zero")
        return b0

    def transfer_function(self) -> TransferFunction:
        return TransferFunction(b=(self.b0,), a=self.a)


@component("linear", "arma")
class Arma(_WithNumerator):
    """Rational block: v_k = a_1 v_{k-1} + ... + a_p v_{k-p} + b_0 w_k + ... + b_m w_{k-m}.

    Examples
    --------
    >>> Arma(a=[0.5], b=[1, 2]).simulate(np.array([1.0, 0.0, 0.0]))
    array([1.  , 2.5 , 1.25])
    """

    a: Feedback
    """Feedback a_1, ..., a_p."""

    def transfer_function(self) -> TransferFunction:
        return TransferFunction(b=self.b, a=self.a)
