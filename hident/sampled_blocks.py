"""Continuous linear blocks as their samples see them, with derivatives by their coefficients.

With dz/dt = A z + B x and y = C z for B(s)/A(s), and x known between its samples, the samples obey

    z_{k+1} = Phi z_k + Gamma x_k + Delta x_{k+1},      Phi = exp(A dt),

exactly: Delta = 0 where x is held, and where it goes along straight lines both follow from the exponential of
one larger matrix (Franklin, Powell and Workman, Digital Control of Dynamic Systems, 3rd ed., 6.3). A delay
that is no whole number of intervals is the output at a time between two samples. The polynomials in q^-1
follow by Leverrier and Faddeev's recursion, which divides by no difference of poles: all of it is analytic in
the coefficients, so that steps along the imaginary axis give derivatives to the last digits (Squire and Trapp
1998, SIAM Review 40, 110).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from hident.arrays import Array
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction
from hident.numerics.whole import split

Intersample = Literal["held", "linear"]
"""What a signal is between its samples: the last one, or a straight line to the next."""

_STEP = 1e-30
_LONGEST = 1_000_000
# The static gain of the sampled block may be this far off, relative to it.
_ACCURACY = 1e-5


@dataclass(frozen=True)
class SampledTransferFunction(TransferFunction):
    """The discrete block that a continuous one is for samples every ``dt``, whatever its delay.

    It is exact for an input that is held between the samples, or goes along straight lines, as
    ``intersample`` says.

    Raises
    ------
    ValueError
        If the samples come so fast that the discrete coefficients do not hold the block.

    Examples
    --------
    >>> lag = ContinuousTransferFunction(b=(2.0,), a=(1.0,), delay=0.5)
    >>> block = SampledTransferFunction(lag, dt=0.5)
    >>> [round(b, 3) for b in block.b], [round(a, 3) for a in block.a]
    ([0.0, 0.0, 0.787], [0.607])
    >>> [round(b, 3) for b in SampledTransferFunction(lag, dt=0.5, intersample="linear").b]
    [0.0, 0.426, 0.361]
    """

    b: tuple[float, ...] = field(init=False, repr=False)
    a: tuple[float, ...] = field(init=False, repr=False)
    continuous: ContinuousTransferFunction
    dt: float
    intersample: Intersample = "held"

    def __post_init__(self) -> None:
        if not self.continuous.delay <= _LONGEST * self.dt:
            raise ValueError(f"the delay {self.continuous.delay:g} is longer than {_LONGEST} samples")
        if self.continuous.integrators:
            raise ValueError("a block with a pole at zero cannot be sampled here")
        lag, top, bottom = self._polynomials(np.asarray(self.continuous.b), np.asarray(self.continuous.a))
        rounding = float(np.finfo(float).eps) * float(np.sum(np.abs(bottom)))
        if not rounding < _ACCURACY * abs(float(np.sum(bottom))):
            raise ValueError(
                f"sampled every {self.dt:g}, a continuous block whose poles are so slow is lost in rounding: "
                "take every second sample, or fewer"
            )
        object.__setattr__(self, "b", (*(0.0,) * lag, *top.tolist()))
        object.__setattr__(self, "a", tuple((-bottom[1:]).tolist()))

    def _polynomials(self, b: Any, a: Any) -> tuple[int, Any, Any]:
        """Leading zeros of the numerator, the rest of it, and the denominator, of real or complex b and a."""
        from scipy.linalg import expm

        n = len(a)
        # A unit of time in which the poles are near one.
        unit = float(abs(a[-1])) ** (1.0 / n)
        h = self.dt / unit
        powers = unit ** np.arange(n + 1.0)
        scaled = np.concatenate(([1.0], a)) / powers
        output = np.zeros(n, dtype=scaled.dtype)
        output[: len(b)] = b / powers[: len(b)] / scaled[-1]
        whole = np.eye(n + 2, k=1, dtype=scaled.dtype)
        whole[n - 1, :n] = -scaled[:-1] / scaled[-1]
        samples, fraction = split(self.continuous.delay / self.dt)

        def after(share: float) -> tuple[Any, Any, Any]:
            """Phi, Gamma and Delta from a sample to this share of the interval behind it."""
            found = expm(whole * (share * h))[:n]
            held, ramp = found[:, n], found[:, n + 1] / h
            if self.intersample == "held":
                return found[:, :n], held, np.zeros_like(ramp)
            return found[:, :n], held - ramp, ramp

        phi, gamma, delta = after(1.0)
        bottom, numerators = np.ones(n + 1, dtype=scaled.dtype), np.zeros((n + 1, n), dtype=scaled.dtype)
        adjoint = np.eye(n, dtype=scaled.dtype)
        for k in range(n):
            numerators[k] += adjoint @ delta
            numerators[k + 1] += adjoint @ gamma
            product = phi @ adjoint
            bottom[k + 1] = -np.trace(product) / (k + 1)
            adjoint = product + bottom[k + 1] * np.eye(n)
        if fraction:
            phi, gamma, delta = after(1.0 - fraction)
            top = np.concatenate(([0.0], numerators @ (output @ phi)))
            top[1:] += (output @ gamma) * bottom
            top[:-1] += (output @ delta) * bottom
        else:
            top = numerators @ output
        first = int(self.intersample == "held")
        return samples + first, top[first:], bottom

    def derivatives(self, numerator: int) -> Array:
        """The derivatives of the discrete coefficients by the continuous ones.

        Parameters
        ----------
        numerator : int
            How many b_0, b_1, ... there are; those that the block has not are zero.

        Returns
        -------
        array, shape (numerator + n, L + n)
            A row for each of b_0, b_1, ..., a_1, ..., a_n; columns for the L discrete b from the delay on,
            and for the denominator's coefficients behind the 1.
        """
        b = np.zeros(numerator)
        b[: len(self.continuous.b)] = self.continuous.b
        numbers = np.concatenate((b, self.continuous.a))
        rows = []
        for k in range(len(numbers)):
            # In the number's own unit: a step of nothing beside it.
            step = _STEP * (float(abs(numbers[k])) or float(np.max(np.abs(numbers))))
            moved = numbers + 0j
            moved[k] += 1j * step
            _, top, bottom = self._polynomials(moved[:numerator], moved[numerator:])
            rows.append(np.concatenate((top, bottom[1:])).imag / step)
        return np.array(rows)

    def is_stable(self, *, integrators: bool = False) -> bool:
        """Whether all poles of the continuous block lie in the left half plane."""
        return self.continuous.is_stable()

    def static_gain(self) -> float:
        """The gain at frequency zero."""
        return self.continuous.static_gain()

    def scaled(self, gain: float) -> SampledTransferFunction:
        """The block with its output multiplied by ``gain``."""
        return SampledTransferFunction(self.continuous.scaled(gain), self.dt, self.intersample)

    def divided(self, gain: float) -> SampledTransferFunction:
        """The block with its output divided by ``gain``."""
        b = tuple(value / gain for value in self.continuous.b)
        block = ContinuousTransferFunction(b, self.continuous.a, self.continuous.delay)
        return SampledTransferFunction(block, self.dt, self.intersample)

    def every(self, dt: float) -> SampledTransferFunction:
        """The same continuous block at another sampling interval."""
        return SampledTransferFunction(self.continuous, dt, self.intersample)

    def values(self) -> dict[str, float]:
        """The parameters of the continuous block by name: a_1, ..., a_n, b_0, ..., b_m."""
        return self.continuous.values()
