"""Discrete linear blocks.

Sign convention, as the papers write it (Mzyk 2009, A2):

    v_k = a_1 v_{k-1} + ... + a_p v_{k-p} + b_0 w_k + ... + b_m w_{k-m},

so the transfer function is B(q)/A(q) with A(q) = 1 - a_1 q^-1 - ... - a_p q^-p.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hident.records import Array

_NEGLIGIBLE = 1e-16
_LONGEST_BURN_IN = 10_000_000


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
        return np.roots(self.denominator)

    def zeros(self) -> NDArray[np.complex128]:
        """The zeros in the z plane; the inverse is stable when all lie inside the unit circle."""
        return np.roots(np.asarray(self.b, dtype=float))

    def is_stable(self) -> bool:
        return bool(np.all(np.abs(self.poles()) < 1.0))

    def inverse(self) -> TransferFunction:
        """The block A/B that undoes this one; b_0 must not be zero."""
        b0 = self.b[0]
        return TransferFunction(b=tuple(self.denominator / b0), a=tuple(-value / b0 for value in self.b[1:]))

    def filter(self, w: Array, initial: Array | None = None) -> Array:
        """The response to ``w`` (N,) from the past outputs ``initial`` (v_{-1}, ..., v_{-p}) or rest."""
        # Imported here: scipy.signal alone takes longer to load than validating a configuration.
        from scipy.signal import lfilter, lfiltic

        b, denominator = np.asarray(self.b, dtype=float), self.denominator
        if initial is None:
            return np.asarray(lfilter(b, denominator, w))
        return np.asarray(lfilter(b, denominator, w, zi=lfiltic(b, denominator, initial))[0])

    def impulse_response(self, n: int) -> Array:
        """The first ``n`` values gamma_0, gamma_1, ... of the impulse response."""
        impulse = np.zeros(n)
        impulse[0] = 1.0
        return self.filter(impulse)

    def memory(self) -> int:
        """Samples after which the impulse response of a stable block stays below 1e-16 of its largest."""
        n = 64
        while n < _LONGEST_BURN_IN:
            response = np.abs(self.impulse_response(n))
            above = np.flatnonzero(response > _NEGLIGIBLE * response.max())
            if above[-1] < n // 2:
                return int(above[-1]) + 1
            n *= 2
        return _LONGEST_BURN_IN

    def values(self) -> dict[str, float]:
        """The parameters by name: a_1, ..., a_p, b_0, ..., b_m."""
        named = {f"a_{i}": value for i, value in enumerate(self.a, start=1)}
        return named | {f"b_{i}": value for i, value in enumerate(self.b)}
