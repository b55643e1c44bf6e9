"""Continuous linear blocks, with a delay that need not be a multiple of the sampling interval."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from hident.arrays import Array, Complex
from hident.config.spec import Count, Real, component
from hident.linear_blocks import ContinuousTransferFunction
from hident.systems.base import Feedback, Numerator
from hident.systems.linear import LinearSpec
from hident.systems.roots import Roots, roots

# The frequency response of the coefficients may be this far off, relative to its peak.
_ACCURACY = 1e-6


class ContinuousSpec(LinearSpec):
    """Base of all continuous linear blocks, from rest and exact for an input that is held between samples."""

    def transfer_function(self) -> ContinuousTransferFunction:
        """The block as numbers."""
        raise NotImplementedError

    def simulate(self, w: Array, dt: float) -> Array:
        return self.transfer_function().respond(w, dt)

    def check(self, dt: float | None) -> None:
        if dt is None:
            raise ValueError("a continuous block needs the sampling interval 'dt' of the data")


def _require_left(poles: Complex) -> None:
    """Raise ValueError if a pole lies neither in the left half plane nor at zero."""
    outside = ", ".join(
        f"{abs(p.real):.6g}" if p.imag == 0 else f"{abs(p.real):.6g}+-{p.imag:.6g}j"
        for p in poles
        if p.real >= 0.0 and p.imag >= 0.0 and p != 0.0
    )
    if outside:
        raise ValueError(f"is unstable: the poles {outside} do not lie in the left half plane")


@component("linear", "continuous", source="Chen, Hwang, Chang 2009, eq. (1), (9)")
class Continuous(ContinuousSpec):
    """Continuous block (b_0 + ... + b_m s^m) e^(-delay s) / (1 + a_1 s + ... + a_n s^n), from rest.

    Its input is held from sample to sample (zero-order hold), and it is simulated exactly. With k
    ``integrators`` the denominator is s^k (1 + a_1 s + ... + a_n s^n).

    Examples
    --------
    >>> [round(a, 3) for a in Continuous(a=[2]).transfer_function().sampled(dt=1.0).a]
    [0.607]
    >>> Continuous(b=[2], integrators=1).transfer_function().sampled(dt=0.5).a
    (1.0,)
    """

    a: Feedback = ()
    """Coefficients a_1, ..., a_n of the output's derivatives, in powers of the unit of time."""
    b: Numerator = (1.0,)
    """Coefficients b_0, ..., b_m of the input and its derivatives, m < n."""
    delay: Annotated[Real, Field(ge=0)] = 0.0
    """Delay d, in the unit of dt; need not be a multiple of dt."""
    integrators: Annotated[Count, Field(ge=0, le=4)] = 0
    """Poles at zero, besides those of a: the output of each is the integral of its input."""

    @model_validator(mode="after")
    def _check_block(self) -> Self:
        if not (self.a or self.integrators):
            raise ValueError("needs 'a', the coefficients a_1, ..., a_n of the denominator, or 'integrators'")
        _require_left(self.transfer_function().poles())
        return self

    def transfer_function(self) -> ContinuousTransferFunction:
        return ContinuousTransferFunction(self.b, self.a, self.delay, self.integrators)


@component("linear", "continuous_zpk", source="scipy.signal.ZerosPolesGain")
class ContinuousZpk(ContinuousSpec):
    """Zeros, poles and gain: gain (s - z_1)(s - z_2)... e^(-delay s) / ((s - p_1)(s - p_2)...), from rest.

    It is simulated exactly for a held input. A pole at 0 is an integrator.

    Examples
    --------
    >>> block = ContinuousZpk(poles=[-0.5, [-1, 2]], gain=5).transfer_function()
    >>> [round(a, 3) for a in block.a], round(block.static_gain(), 3)
    ([2.4, 1.0, 0.4], 2.0)
    """

    zeros: Roots = ()
    """Zeros in 1/time, each a number or [re, im] for the pair re +- im j; fewer than poles."""
    poles: Roots
    """Poles in 1/time, each a number or [re, im] for the pair re +- im j."""
    gain: Real = 1.0
    """Factor of the product; the static gain is another."""
    delay: Annotated[Real, Field(ge=0)] = 0.0
    """Delay, in the unit of dt; need not be a multiple of dt."""

    @field_validator("gain")
    @classmethod
    def _check_gain(cls, gain: float) -> float:
        if gain == 0.0:
            raise ValueError("must not be zero")
        return gain

    @model_validator(mode="after")
    def _check_block(self) -> Self:
        zeros, poles = roots(self.zeros), roots(self.poles)
        if len(zeros) >= len(poles):
            raise ValueError(
                f"the block is improper: {len(zeros)} zeros must be fewer than the {len(poles)} poles"
            )
        _require_left(poles)
        if (off := self._error_of_coefficients(zeros, poles)) > _ACCURACY:
            raise ValueError(
                f"has zeros and poles that its coefficients cannot hold: the frequency response is {off:.1g} "
                "off; take a lower order, or a discrete 'zpk', which is simulated in sections"
            )
        return self

    def transfer_function(self) -> ContinuousTransferFunction:
        poles = roots(self.poles)
        integrators = int(np.count_nonzero(poles == 0.0))
        bottom = np.atleast_1d(np.poly(poles[poles != 0.0])).real
        top = self.gain * np.atleast_1d(np.poly(roots(self.zeros))).real
        b, a = top[::-1] / bottom[-1], bottom[-2::-1] / bottom[-1]
        return ContinuousTransferFunction(tuple(b.tolist()), tuple(a.tolist()), self.delay, integrators)

    def _error_of_coefficients(self, zeros: Complex, poles: Complex) -> float:
        """How far the frequency response is off at the frequencies of the poles, relative to its peak."""
        poles = poles[poles != 0.0]
        omega = np.unique(np.abs(np.concatenate((poles, poles.imag))))
        omega = omega[omega > 0.0]
        if not len(omega):
            return 0.0
        s = 1j * omega[:, None]
        rest = s[:, 0] ** (len(roots(self.poles)) - len(poles))
        wanted = self.gain * np.prod(s - zeros, axis=1) / np.prod(s - poles, axis=1) / rest
        found = replace(self.transfer_function(), delay=0.0).frequency_response(omega)
        return float(np.max(np.abs(found - wanted)) / np.max(np.abs(wanted)))
