"""The harmonics of several experiments with sines, arranged by frequency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hident.arrays import Array, Complex, Index
from hident.errors import EstimationError
from hident.estimators.frequency.gauge import FrequencyGrid
from hident.estimators.frequency.harmonic_map import quadrature
from hident.estimators.frequency.harmonics import Harmonics

# Errors of rounding, relative to the root mean square: no harmonic is known better.
_ROUNDING = 1e-12
# Frequencies this close, relative to their size, are one.
_SAME = 1e-9


def match_frequencies(omega: Array, amplitude: Array, frequencies: Array) -> Index:
    """Which of the increasing ``frequencies`` (n,) each sine of frequency ``omega`` (E,) has, shape (E,).

    Raises
    ------
    EstimationError
        If an amplitude is zero, or a frequency is not among the given ones or has no sine.
    """
    if not np.all(amplitude):
        raise EstimationError("the amplitude V of a sine is zero: it excites no harmonic")
    m = np.asarray(np.argmin(np.abs(np.log(omega[:, None] / frequencies)), axis=1))
    strange = ~np.isclose(omega, frequencies[m], rtol=_SAME, atol=0.0)
    if strange.any():
        raise EstimationError(
            f"a sine has the frequency {omega[strange][0]:g}, which is not among the given ones"
        )
    missing = np.setdiff1d(np.arange(len(frequencies)), m)
    if len(missing):
        raise EstimationError(f"no sine has the frequency {frequencies[missing[0]]:g}")
    return m


@dataclass(frozen=True, eq=False)
class SineResponses:
    """The harmonics of E experiments with sines: what the gains are estimated from.

    ``m`` (E,) tells the frequency in ``grid``; ``amplitude`` V and ``offset`` x_0 (E,) tell the input.
    ``mean`` (E,) is s_0, ``values`` (E, p) are Y_k e^(j (k - 1) pi/2); ``mean_error`` (E,) and ``error``
    (E, p) are their standard errors, the latter of the real and the imaginary part.
    """

    grid: FrequencyGrid
    m: Index
    amplitude: Array
    offset: Array
    mean: Array
    values: Complex
    mean_error: Array
    error: Array

    @classmethod
    def of(
        cls, frequencies: Array, found: Sequence[Harmonics], amplitude: Array, offset: Array, order: int
    ) -> SineResponses:
        """From the first ``order`` harmonics of each experiment, at some of the increasing ``frequencies``.

        Raises
        ------
        EstimationError
            As :func:`match_frequencies`.
        """
        m = match_frequencies(np.array([one.omega for one in found]), amplitude, frequencies)
        floor = _ROUNDING * np.sqrt([one.power for one in found])
        return cls(
            FrequencyGrid.of(frequencies, [order] * len(frequencies)),
            m,
            np.asarray(amplitude, dtype=float),
            np.asarray(offset, dtype=float),
            np.array([one.mean for one in found]),
            np.array([one.values[:order] for one in found]) / quadrature(order),
            np.maximum([one.mean_error for one in found], floor),
            np.repeat(np.maximum([one.error for one in found], floor)[:, None], order, axis=1),
        )

    @property
    def order(self) -> int:
        """The number p of harmonics."""
        return int(self.values.shape[1])

    @cached_property
    def output(self) -> Index:
        """The index of k w among the frequencies of G_o, shape (E, p)."""
        return self.grid.o.reshape(-1, self.order)[self.m]

    def summed(self, terms: NDArray[Any]) -> NDArray[Any]:
        """The sum of ``terms`` (E, ...) over the experiments at each frequency, shape (n, ...)."""
        total = np.zeros((len(self.grid.inputs), *terms.shape[1:]), dtype=terms.dtype)
        np.add.at(total, self.m, terms)
        return total
