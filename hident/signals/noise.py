"""Noise: what happens between the true output of a simulated system and the measured one."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from hident.arrays import Array
from hident.config.spec import Real, component
from hident.config.suggest import one_of
from hident.linear_blocks import MOST_POLES, TransferFunction
from hident.numerics.rounding import apart
from hident.signals.base import NoiseSpec

Level = Annotated[Real, Field(ge=0)]


class _Additive(NoiseSpec):
    """Base of the zero-mean stationary noises that are added to the output, with their level."""

    distribution: Literal["gaussian", "uniform"] = "gaussian"
    """Distribution of the independent values that the noise is made of."""
    std: Level | None = None
    """Level: standard deviation, in the unit of the output."""
    variance: Level | None = None
    """Level: variance, in the squared unit of the output."""
    nsr: Annotated[Real, Field(ge=0, lt=1)] | None = None
    """Level: standard deviation of the noise over that of the measured output (0.05 for 5 %)."""

    levels: ClassVar[tuple[str, ...]] = ("std", "variance", "nsr")

    @model_validator(mode="after")
    def _one_level(self) -> Self:
        given = [name for name in self.levels if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"give exactly one of {one_of(self.levels)} ({one_of(given) or 'none'} found)")
        return self

    def measure(self, output: Array, rng: np.random.Generator) -> Array:
        return output + self._std(output) * self._unit(len(output), rng)

    def _std(self, output: Array) -> float:
        """The standard deviation that the level stands for."""
        if self.std is not None:
            return self.std
        if self.variance is not None:
            return math.sqrt(self.variance)
        assert self.nsr is not None  # by validation
        # var(measured) = var(output) + var(noise), and std(noise) = nsr std(measured).
        return self.nsr * float(np.std(output)) / math.sqrt(1 - self.nsr**2)

    def _unit(self, n: int, rng: np.random.Generator) -> Array:
        """The noise (n,) that the level multiplies."""
        return self._white(n, rng)

    def _white(self, n: int, rng: np.random.Generator) -> Array:
        """Independent values of mean 0 and variance 1, shape (n,)."""
        if self.distribution == "gaussian":
            return rng.standard_normal(n)
        return math.sqrt(3) * (2 * rng.random(n) - 1)


@component("noise", "white", source="Chen, Hwang, Chang 2009, simulated examples (nsr)")
class White(_Additive):
    """White noise: independent, identically distributed values of mean zero.

    Examples
    --------
    >>> noise = White(std=0.5).measure(np.zeros(10_000), np.random.default_rng(1))
    >>> round(float(np.std(noise)), 1)
    0.5
    """

    half_width: Level | None = None
    """Level: the noise is uniform on [-half_width, half_width] (uniform only)."""

    levels: ClassVar[tuple[str, ...]] = (*_Additive.levels, "half_width")

    @model_validator(mode="after")
    def _half_width_is_of_uniform_noise(self) -> Self:
        if self.half_width is not None and self.distribution != "uniform":
            raise ValueError(f"half_width needs the distribution uniform, not {self.distribution}")
        return self

    def _std(self, output: Array) -> float:
        return super()._std(output) if self.half_width is None else self.half_width / math.sqrt(3)


@component("noise", "ar", source="Wang, Zhang, Ljung 2009, example 2; Chen, Hwang, Chang 2009 (nsr)")
class Autoregressive(_Additive):
    """Autoregressive noise: white noise through 1/(1 - a_1 q^-1 - ... - a_p q^-p).

    Examples
    --------
    >>> noise = Autoregressive(a=[0.9], std=0.5).measure(np.zeros(10_000), np.random.default_rng(1))
    >>> round(float(np.corrcoef(noise[1:], noise[:-1])[0, 1]), 1)
    0.9
    """

    a: Annotated[tuple[Real, ...], Field(min_length=1, max_length=MOST_POLES)]
    """Feedback coefficients a_1, ..., a_p."""
    of: Literal["noise", "innovation"] = "noise"
    """What the level is of: the noise itself (once stationary), or the white noise that drives it."""
    initial: Literal["stationary", "zero"] = "stationary"
    """Start: in the stationary state, or at rest."""

    @field_validator("a")
    @classmethod
    def _stable(cls, a: tuple[float, ...]) -> tuple[float, ...]:
        outside = [pole for pole in TransferFunction(a=a).poles() if abs(pole) >= 1]
        if outside:
            named = one_of(apart(pole if pole.imag else pole.real, 1.0, 4) for pole in outside)
            raise ValueError(f"the noise is unstable: poles must lie inside the unit circle, not at {named}")
        return a

    @model_validator(mode="after")
    def _nsr_is_of_the_noise(self) -> Self:
        if self.nsr is not None and self.of == "innovation":
            raise ValueError("nsr is a level of the noise, not of the innovation")
        return self

    def _unit(self, n: int, rng: np.random.Generator) -> Array:
        colouring = TransferFunction(a=self.a)
        memory = colouring.memory()
        before = memory if self.initial == "stationary" else 0
        noise = colouring.filter(self._white(before + n, rng))[before:]
        if self.of == "innovation":
            return noise
        # White noise of variance 1 comes out with the variance sum gamma_k^2.
        return noise / np.linalg.norm(colouring.impulse_response(memory))


@component("noise", "rounding", source="Chen, Hwang, Chang 2009, example 2, cases F and G")
class Rounding(NoiseSpec):
    """Rounding of the output to multiples of a step (halves to the even multiple).

    Examples
    --------
    >>> Rounding(step=0.5).measure(np.array([0.2, 0.3]), np.random.default_rng(1))
    array([0. , 0.5])
    """

    step: Annotated[Real, Field(gt=0)]
    """Distance of the values that the instrument shows, in the unit of the output."""

    def measure(self, output: Array, rng: np.random.Generator) -> Array:
        return np.rint(output / self.step) * self.step
