"""Nonlinearities with memory: backlash, and a relay with hysteresis.

Both begin every experiment at their ``initial`` state, at the first sample that they are given: that of the
burn-in where a linear block is stationary. What came before a record is forgotten once the input has passed
the gap, or a switching point, and not by a burn-in as such.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from hident.arrays import Array
from hident.config.spec import Real, component
from hident.systems.base import MemorySpec


@component("nonlinearity", "backlash", source="Tao, Kokotovic 1996, chapter 2")
class Backlash(MemorySpec):
    """Backlash (play): the output follows the input once that has crossed the gap.

    With x_k = min(max(x_{k-1}, u_k - width/2), u_k + width/2) the output is gain * x_k.

    Examples
    --------
    >>> Backlash(width=1).simulate(np.array([0.25, 1.0, 2.0, 1.5, 0.5, 0.0]))
    array([0. , 0.5, 1.5, 1.5, 1. , 0.5])
    """

    width: Annotated[Real, Field(ge=0)]
    """Width of the gap, in the unit of the input: how far it moves back before the output follows."""
    gain: Real = 1.0
    """Slope with which the output follows."""
    initial: Real = 0.0
    """Output before the first sample of each experiment."""

    @field_validator("gain")
    @classmethod
    def _check_gain(cls, gain: float) -> float:
        if gain == 0.0:
            raise ValueError("must not be zero")
        return gain

    def simulate(self, u: Array) -> Array:
        x, played = self.initial / self.gain, []
        half = 0.5 * self.width
        for low, high in zip((u - half).tolist(), (u + half).tolist(), strict=True):
            x = min(max(x, low), high)
            played.append(x)
        return self.gain * np.array(played)


@component("nonlinearity", "relay", source="Tao, Kokotovic 1996, chapter 2")
class Relay(MemorySpec):
    """Relay with hysteresis: it switches up at or above high, down at or below low.

    Examples
    --------
    >>> Relay(low=-1, high=1).simulate(np.array([0.0, 1.0, 0.0, -1.0, 0.5]))
    array([-1.,  1.,  1., -1., -1.])
    """

    low: Real
    """Input at or below which the output becomes the lower one."""
    high: Real
    """Input at or above which the output becomes the upper one."""
    outputs: tuple[Real, Real] = (-1.0, 1.0)
    """The lower and the upper output."""
    initial: Literal["lower", "upper"] = "lower"
    """Output before the first sample of each experiment."""

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.low >= self.high:
            raise ValueError(
                f"'low' must be below 'high', not {self.low:.10g} and {self.high:.10g}; "
                "without hysteresis it is a static nonlinearity, such as sign"
            )
        return self

    def simulate(self, u: Array) -> Array:
        switches = np.where(u >= self.high, 1, np.where(u <= self.low, 0, -1))
        # The last switching counts: its place, or none yet.
        last = np.maximum.accumulate(np.where(switches >= 0, np.arange(len(u)), -1))
        up = np.where(last >= 0, switches[last], int(self.initial == "upper"))
        return np.array(self.outputs)[up]
