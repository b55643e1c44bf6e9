"""The best linear approximation of a nonlinear system, with the noise and the nonlinearity told apart."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from hident.arrays import Array, Complex, Index
from hident.config.spec import Count, component
from hident.errors import EstimationError
from hident.estimators.base import EstimatorSpec, Experiments, require_finite, require_varying
from hident.estimators.frequency.harmonics import samples_per_period
from hident.estimators.normalisation import Normalisation
from hident.records import Estimate, Periodic, Record


@dataclass(frozen=True, eq=False)
class BestLinearApproximation:
    """The response ``gain`` (F,) at the harmonics of the period, and variances of its complex mean.

    ``noise_variance`` (F,) is due to noise alone, ``total_variance`` (F,) to noise and stochastic nonlinear
    distortions; both belong to the mean over all R realisations. ``distortion_variance`` (F,) is that of the
    distortions in a single realisation, zero where it is hidden by noise.
    """

    gain: Complex
    noise_variance: Array
    total_variance: Array
    distortion_variance: Array


def best_linear_approximation(u: Array, y: Array, harmonics: Index) -> BestLinearApproximation:
    """The best linear approximation from random-phase multisines.

    Parameters
    ----------
    u, y : array, shape (R, P, n)
        Input and output in steady state: R realisations of the phases, P periods, n samples in each.
    harmonics : array of int, shape (F,)
        Excited harmonics: those with more than a millionth of the strongest input.

    Raises
    ------
    EstimationError
        If there are fewer than two realisations or two periods, or a harmonic is not excited.

    Notes
    -----
    Pintelon and Schoukens 2012, section 4.3.1 (the robust method). The input is taken as free of noise.
    """
    realisations, periods, n = y.shape
    if realisations < 2 or periods < 2:
        raise EstimationError(
            "the two variances need at least two realisations and two periods, "
            f"not {realisations} and {periods}"
        )
    inputs = np.fft.rfft(u.mean(axis=1)) / n
    size = np.min(np.abs(inputs), axis=0)
    excited = size > 1e-6 * np.max(size[1:])
    if np.max(harmonics) >= len(size) or not np.all(excited[harmonics]):
        silent = [k for k in harmonics if k >= len(size) or not excited[k]]
        raise EstimationError(f"the harmonic {silent[0]} is not excited in every realisation")
    gains = np.fft.rfft(y)[..., harmonics] / (n * inputs[:, None, harmonics])
    each = gains.mean(axis=1)
    noise = np.sum(np.abs(gains - each[:, None]) ** 2, axis=1) / (periods * (periods - 1))
    gain = each.mean(axis=0)
    total = np.sum(np.abs(each - gain) ** 2, axis=0) / (realisations * (realisations - 1))
    noise_variance = noise.mean(axis=0) / realisations
    distortion = np.maximum(realisations * (total - noise_variance), 0.0)
    return BestLinearApproximation(gain, noise_variance, total, distortion)


@component("estimator", "best_linear_approximation", source="Pintelon and Schoukens 2012, section 4.3.1")
class BestLinear(EstimatorSpec):
    """Best linear approximation from several random-phase multisines, with its two variances.

        G(j w_K) = mean over the realisations of Y_K / U_K, their coefficients at the harmonic K

    Each experiment of the record is one realisation of the phases. Values, for each harmonic K of the period:
    gain_K and phase_K (radians), noise_K and total_K, the standard deviations of the complex gain by noise
    and by noise with nonlinear distortions, and distortion_K, that of the distortions in one realisation.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Wiener(linear=hi.Continuous(a=[0.5]), nonlinearity="identity")
    >>> multisine = {"excitation": hi.Multisine(period=32, rms=1), "periods": 3, "repetitions": 2}
    >>> excitation = hi.Experiments(parts=[{"name": "multisine", **multisine}])
    >>> record = hi.simulate(system, excitation, 192, dt=0.1)
    >>> round(hi.fit(hi.BestLinear(harmonics=[1], transient=1), record).values["gain_1"], 2)
    0.71
    """

    harmonics: Annotated[tuple[Annotated[Count, Field(ge=1)], ...], Field(min_length=1)]
    """Harmonics of the multisines' period at which the values are reported, e.g. [1, 3, 5]."""
    transient: Annotated[Count, Field(ge=0)] = 0
    """Periods left out at the start of each experiment."""

    def takes_experiments(self) -> Experiments:
        return "any"

    def draws(self) -> bool:
        return False

    def names(self) -> list[str]:
        quantities = ("gain", "phase", "noise", "total", "distortion")
        return [f"{quantity}_{k}" for quantity in quantities for k in self.harmonics]

    def normalisations(self) -> tuple[Normalisation, ...]:
        # It knows both blocks' gains together only.
        return ()

    def check_record(self, record: Record) -> None:
        self._periods(record)

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        require_finite(record.y)
        require_varying(record.y, "output")
        u, y = self._periods(record)
        found = best_linear_approximation(u, y, np.array(self.harmonics))
        variances = found.noise_variance, found.total_variance, found.distortion_variance
        deviations = np.sqrt(variances).ravel()
        return Estimate(values=self.named(np.abs(found.gain), np.angle(found.gain), deviations))

    def _periods(self, record: Record) -> tuple[Array, Array]:
        """Input and output, each of shape (realisations, periods, samples per period)."""
        shapes, inputs, outputs = set(), [], []
        for name, part in record.parts.items():
            if not isinstance(part.waveform, Periodic) or len(part.waveform.harmonics) < 2:
                continue
            n = samples_per_period(2.0 * math.pi / part.waveform.period, part.dt)
            if n is None or len(part) % n:
                raise EstimationError(
                    f"the experiment '{name}' is not made of whole periods of whole samples"
                )
            shapes.add((len(part) // n, n))
            inputs.append(record.u[part.samples].reshape(-1, n)[self.transient :])
            outputs.append(record.y[part.samples].reshape(-1, n)[self.transient :])
        if len(shapes) != 1:
            raise EstimationError(
                f"the experiments with multisines have {len(shapes)} different shapes (periods, "
                "samples): give all realisations the same"
            )
        return np.stack(inputs), np.stack(outputs)
