"""Continuous linear blocks, with a delay that need not be a multiple of the sampling interval.

Symbols and signs as Chen, Hwang and Chang 2009 write them, eq. (1) and (9):

    a_n y^(n)(t) + ... + a_1 y^(1)(t) + y(t) = b_m x^(m)(t - d) + ... + b_1 x^(1)(t - d) + b_0 x(t - d),

so the static gain is b_0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from hident.config.spec import Real, component
from hident.numerics.whole import split
from hident.records import Array
from hident.systems.base import Coefficients, Numerator
from hident.systems.linear import LinearSpec, TransferFunction
from hident.systems.settling import settling_time

Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class ContinuousTransferFunction:
    """(b_0 + b_1 s + ... + b_m s^m) e^(-delay s) / (1 + a_1 s + ... + a_n s^n) with m < n."""

    b: tuple[float, ...]
    a: tuple[float, ...]
    delay: float = 0.0

    def __post_init__(self) -> None:
        if not self.a or self.a[-1] == 0.0:
            raise ValueError("the highest coefficient a_n must not be zero, and there must be one")
        if len(self.b) > len(self.a):
            raise ValueError(
                f"the block is improper: the order m = {len(self.b) - 1} of the numerator must be "
                f"below the order n = {len(self.a)} of the denominator"
            )
        if self.delay < 0.0:
            raise ValueError(f"the delay must not be negative, not {self.delay:g}")

    @property
    def denominator(self) -> Array:
        """The denominator's coefficients by falling power of s: a_n, ..., a_1, 1."""
        return np.array([*reversed(self.a), 1.0])

    def poles(self) -> Complex:
        """The n poles, in 1/time; the block is stable when all lie in the left half plane."""
        return np.roots(self.denominator).astype(np.complex128)

    def zeros(self) -> Complex:
        """The zeros, in 1/time."""
        return np.roots(self.b[::-1]).astype(np.complex128)

    def is_stable(self) -> bool:
        """Whether all poles lie in the left half plane."""
        return bool(np.all(self.poles().real < 0.0))

    def static_gain(self) -> float:
        """The gain at frequency zero."""
        return self.b[0]

    def values(self) -> dict[str, float]:
        """The parameters by name: a_1, ..., a_n, b_0, ..., b_m."""
        named = {f"a_{i}": value for i, value in enumerate(self.a, start=1)}
        return named | {f"b_{i}": value for i, value in enumerate(self.b)}

    def scaled(self, gain: float) -> ContinuousTransferFunction:
        """The block with its output multiplied by ``gain``."""
        return ContinuousTransferFunction(tuple(gain * b for b in self.b), self.a, self.delay)

    def frequency_response(self, omega: Array) -> Complex:
        """The complex gain at angular frequencies ``omega`` (any shape), radians per unit of time."""
        s = 1j * np.asarray(omega, dtype=float)
        ratio = np.polyval(self.b[::-1], s) / np.polyval(self.denominator, s)
        return np.asarray(ratio * np.exp(-self.delay * s))

    @cached_property
    def _unit(self) -> float:
        """A unit of time in which the poles have a geometric mean of one, for good conditioning."""
        return float(abs(self.a[-1]) ** (1.0 / len(self.a)))

    @cached_property
    def _modes(self) -> tuple[Complex, Complex, Complex]:
        """(T, B, C) with dz/dt = T z + B x, y = C z; T is upper triangular, time in :attr:`_unit`."""
        from scipy.linalg import schur

        n, unit = len(self.a), self._unit
        leading = self.a[-1] / unit**n
        companion = np.eye(n, k=1)
        scaled = np.array([1.0, *(a / unit**i for i, a in enumerate(self.a[:-1], start=1))])
        companion[-1] = -scaled / leading
        output = np.zeros(n)
        output[: len(self.b)] = [b / unit**i / leading for i, b in enumerate(self.b)]
        triangular, basis = schur(companion, output="complex")
        return triangular, basis[-1].conj(), output @ basis

    def _held(self, dt: float) -> tuple[Complex, Complex]:
        """exp(T dt) and its integral from 0 to dt times B."""
        from scipy.linalg import expm

        triangular, into, _ = self._modes
        n = len(into)
        block = np.zeros((n + 1, n + 1), dtype=complex)
        block[:n, :n], block[:n, n] = triangular, into
        both = expm(block * (dt / self._unit))
        return both[:n, :n], both[:n, n]

    def _steps(self, dt: float) -> tuple[Complex, Complex, Complex, int]:
        """(Phi, Gamma_0, Gamma_1, D) with z_{k+1} = Phi z_k + Gamma_0 x_{k-D} + Gamma_1 x_{k-D-1}."""
        whole, fraction = split(self.delay / dt)
        rest = fraction * dt
        phi, gamma = self._held(dt)
        if rest == 0.0:
            return phi, gamma, np.zeros_like(gamma), whole
        after, recent = self._held(dt - rest)
        return phi, recent, after @ self._held(rest)[1], whole

    def respond(self, x: Array, dt: float) -> Array:
        """The response at the times k dt to an input held at ``x[k]`` from k dt on, from rest.

        Parameters
        ----------
        x : array, shape (N,)
            The held input; it is zero before its first sample.
        dt : float
            Sampling interval.

        Returns
        -------
        array, shape (N,)
            Exact for this input (zero-order hold), whatever the delay.
        """
        from scipy.signal import lfilter

        phi, recent, older, whole = self._steps(dt)
        delayed = np.concatenate((np.zeros(min(whole, len(x))), x[: max(len(x) - whole, 0)]))
        earlier = np.concatenate(([0.0], delayed[:-1]))
        output = self._modes[2]
        z = np.empty((len(phi), len(x)), dtype=complex)
        for i in reversed(range(len(phi))):
            driven = recent[i] * delayed + older[i] * earlier + phi[i, i + 1 :] @ z[i + 1 :]
            z[i] = lfilter([0.0, 1.0], [1.0, -phi[i, i]], driven)
        return np.ascontiguousarray((output @ z).real)

    def sampled(self, dt: float) -> TransferFunction:
        """The discrete block that relates held input and sampled output, its delay as leading zeros."""
        phi, recent, older, whole = self._steps(dt)
        output = self._modes[2]
        denominator = np.poly(np.diag(phi)).real
        markov = np.zeros(len(phi) + 2)
        state = recent
        for k in range(1, len(markov)):
            markov[k] = (output @ state).real
            state = phi @ state + (older if k == 1 else 0.0)
        numerator = np.convolve(denominator, markov)[: len(markov)]
        if not np.any(older):
            numerator = numerator[:-1]
        return TransferFunction(
            b=tuple(map(float, (*np.zeros(whole), *numerator))), a=tuple(map(float, -denominator[1:]))
        )

    def settling_time(self, band: float = 0.05) -> float:
        """The time after which the step response stays within ``band`` of its final value.

        The delay does not count. Infinite for an unstable block or one without static gain.
        """
        if not self.is_stable() or self.b[0] == 0.0:
            return math.inf
        return settling_time(self.b, self.a, band)


@component("linear", "continuous", source="Chen, Hwang, Chang 2009, eq. (1), (9)")
class Continuous(LinearSpec):
    """Continuous block (b_0 + ... + b_m s^m) e^(-delay s) / (1 + a_1 s + ... + a_n s^n), from rest.

    Its input is held from sample to sample (zero-order hold), and it is simulated exactly.
    """

    a: Coefficients
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
