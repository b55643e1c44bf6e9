"""What every linear block answers, and the discrete ones; the continuous one is in ``continuous.py``.

Sign convention, as the papers write it (Mzyk 2009, A2):

    v_k = a_1 v_{k-1} + ... + a_p v_{k-p} + b_0 w_k + ... + b_m w_{k-m},

so the transfer function is B(q)/A(q) with A(q) = 1 - a_1 q^-1 - ... - a_p q^-p.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import PlainValidator, TypeAdapter, WithJsonSchema, field_validator, model_validator

from hident.config.spec import Component, Real, component
from hident.numerics.choices import ROUNDING
from hident.records import Array
from hident.systems.base import Coefficients, Numerator

if TYPE_CHECKING:
    from hident.systems.continuous import ContinuousTransferFunction

_NEGLIGIBLE = 1e-16
# A simple pole of this modulus is forgotten to 1e-16 after 3.7 million samples.
_SLOWEST = 0.99999


def _roots(polynomial: Array) -> NDArray[np.complex128]:
    return np.roots(polynomial).astype(np.complex128)


def _sum(terms: Array) -> float:
    """The sum of the terms, zero where it is no more than their rounding."""
    total = float(np.sum(terms))
    return total if abs(total) > ROUNDING * float(np.sum(np.abs(terms))) else 0.0


@dataclass(frozen=True)
class TransferFunction:
    """The discrete linear block with numerator ``b`` (b_0, ..., b_m) and feedback ``a`` (a_1, ..., a_p)."""

    b: tuple[float, ...] = (1.0,)
    a: tuple[float, ...] = ()

    @property
    def denominator(self) -> Array:
        """The coefficients of A in powers of q^-1: 1, -a_1, ..., -a_p."""
        return np.concatenate(([1.0], -np.asarray(self.a, dtype=float)))

    def poles(self) -> NDArray[np.complex128]:
        """The p poles in the z plane; the block is stable when all lie inside the unit circle."""
        return _roots(self.denominator)

    def zeros(self) -> NDArray[np.complex128]:
        """The zeros in the z plane; the inverse is stable when all lie inside the unit circle."""
        return _roots(np.asarray(self.b, dtype=float))

    def radius(self) -> float:
        """The largest modulus of the poles, 0 without feedback."""
        return float(np.max(np.abs(self.poles()), initial=0.0))

    def is_stable(self) -> bool:
        """Whether all poles lie inside the unit circle."""
        return self.radius() < 1.0

    def static_gain(self) -> float:
        """The gain at frequency zero: exactly zero where it is rounding, infinite for an integrator."""
        top, bottom = (_sum(np.asarray(c, dtype=float)) for c in (self.b, self.denominator))
        return top / bottom if bottom else math.inf

    def inverse(self) -> TransferFunction:
        """The block A/B that undoes this one.

        Raises
        ------
        ValueError
            If b_0 is zero: the block delays its input, and only the future would undo that.
        """
        b0 = self.b[0]
        if b0 == 0.0:
            raise ValueError("a block with b_0 = 0 delays its input and has no causal inverse")
        return TransferFunction(b=tuple(self.denominator / b0), a=tuple(-value / b0 for value in self.b[1:]))

    def filter(self, w: Array, initial: Array | None = None) -> Array:
        """The response to ``w`` (N,) from rest, or from the past outputs ``initial``.

        Parameters
        ----------
        w : array, shape (N,)
            The input; it is zero before its first sample.
        initial : array, shape (p,), optional
            v_{-1}, ..., v_{-p}, the latest first.

        Raises
        ------
        ValueError
            If ``initial`` has not p values.
        """
        # Imported here: scipy.signal alone takes longer to load than validating a configuration.
        from scipy.signal import lfilter, lfiltic

        b, denominator = np.asarray(self.b, dtype=float), self.denominator
        if initial is None:
            return np.asarray(lfilter(b, denominator, w))
        if len(initial) != len(self.a):
            raise ValueError(f"needs {len(self.a)} past outputs, not {len(initial)}")
        return np.asarray(lfilter(b, denominator, w, zi=lfiltic(b, denominator, initial))[0])

    def impulse_response(self, n: int) -> Array:
        """The first ``n`` values gamma_0, gamma_1, ... of the impulse response."""
        impulse = np.zeros(n)
        impulse[:1] = 1.0
        return self.filter(impulse)

    def memory(self) -> int:
        """Samples after which the impulse response stays below 1e-16 of its largest value.

        Without feedback this is the number of coefficients b_0, ..., b_m.

        Raises
        ------
        ValueError
            If a pole has a modulus above 0.99999, unstable blocks included.
        """
        if not self.a:
            return len(self.b)
        if (radius := self.radius()) > _SLOWEST:
            raise ValueError(
                f"a pole has modulus {radius:.8g}: the response lasts too long (at most {_SLOWEST})"
            )
        # Half of the window must be negligible, and that half must lie behind the last b.
        n = 64 + 2 * len(self.b)
        while True:
            response = np.abs(self.impulse_response(n))
            last = int(np.flatnonzero(response > _NEGLIGIBLE * response.max())[-1])
            if last < n // 2:
                return last + 1
            n *= 2

    def values(self) -> dict[str, float]:
        """The parameters by name: a_1, ..., a_p, b_0, ..., b_m."""
        named = {f"a_{i}": value for i, value in enumerate(self.a, start=1)}
        return named | {f"b_{i}": value for i, value in enumerate(self.b)}


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
        if not block.is_stable():
            raise ValueError(f"is unstable: poles {_unstable_poles(block)} lie on or outside the unit circle")
        if self.initial == "stationary" and (radius := block.radius()) > _SLOWEST:
            raise ValueError(
                f"has a pole of modulus {radius:.8g}, too slow for a stationary start (at most {_SLOWEST}): "
                "set 'initial' to zero or to the past outputs"
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
        f"{pole.real:.6g}"
        if pole.imag == 0
        else f"{pole.real:.6g}+-{pole.imag:.6g}j (modulus {abs(pole):.6g})"
        for pole in block.poles()
        if abs(pole) >= 1.0 and pole.imag >= 0
    )


class _WithNumerator(DiscreteSpec):
    b: Numerator
    """Numerator b_0, b_1, ...; leading zeros are a delay."""


@component("linear", "fir")
class Fir(_WithNumerator):
    """Finite impulse response: v_k = b_0 w_k + b_1 w_{k-1} + ..."""

    def transfer_function(self) -> TransferFunction:
        return TransferFunction(b=self.b)


@component("linear", "ar", source="Mzyk 2009, A2")
class Ar(DiscreteSpec):
    """Autoregression: v_k = a_1 v_{k-1} + ... + a_p v_{k-p} + b_0 w_k."""

    a: Coefficients
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
    """Rational block: v_k = a_1 v_{k-1} + ... + a_p v_{k-p} + b_0 w_k + ... + b_m w_{k-m}."""

    a: Coefficients
    """Feedback a_1, ..., a_p."""

    def transfer_function(self) -> TransferFunction:
        return TransferFunction(b=self.b, a=self.a)
