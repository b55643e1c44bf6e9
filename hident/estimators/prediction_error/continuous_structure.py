"""Continuous linear blocks in a chain: their numbers, and the one that is nearest to a discrete block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hident.arrays import Array, Complex
from hident.estimators.prediction_error.parameters import LinearStructure
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction
from hident.numerics.whole import split
from hident.sampled_blocks import Intersample, SampledTransferFunction

# A discrete pole nearer to zero than this has gone within a sample, at whatever rate.
_GONE = 0.02
# Where the frequency responses of two blocks are brought together, relative to the highest that samples show.
_FREQUENCIES = np.concatenate(([0.0], np.geomspace(1e-4, 0.9, 80)))


@dataclass(frozen=True)
class ContinuousStructure(LinearStructure):
    """(b_0 + ... + b_m s^m) e^(-delay s)/(1 + a_1 s + ... + a_n s^n) with b and a to be found.

    ``nb``, ``nf`` and ``nk`` are the orders of the discrete block that it is for its samples.

    Examples
    --------
    >>> ContinuousStructure.of(n=2, m=1, delay=1.0, dt=0.5)
    ContinuousStructure(nb=2, nf=2, nk=3, m=1, delay=1.0, dt=0.5, intersample='held')
    """

    m: int = 0
    delay: float = 0.0
    dt: float = 1.0
    intersample: Intersample = "held"

    @classmethod
    def of(
        cls, n: int, m: int, delay: float = 0.0, dt: float = 1.0, intersample: Intersample = "held"
    ) -> ContinuousStructure:
        """The structure of these orders, for samples every ``dt``."""
        samples, fraction = split(delay / dt)
        held = intersample == "held"
        return cls(n + (not held) + bool(fraction), n, samples + held, m, delay, dt, intersample)

    @property
    def size(self) -> int:
        return self.m + 1 + self.nf

    def made(self, numbers: Array) -> TransferFunction:
        """The block of the numbers b, a; ValueError where there is none."""
        b, a = numbers[: self.m + 1].tolist(), numbers[self.m + 1 :].tolist()
        block = ContinuousTransferFunction(tuple(b), tuple(a), self.delay)
        return SampledTransferFunction(block, self.dt, self.intersample)

    def numbers(self, block: TransferFunction) -> Array:
        assert isinstance(block, SampledTransferFunction)
        b = np.zeros(self.m + 1)
        b[: len(block.continuous.b)] = block.continuous.b
        return np.concatenate((b, block.continuous.a))

    def names(self) -> list[str]:
        return [*(f"b_{i}" for i in range(self.m + 1)), *(f"a_{i}" for i in range(1, self.nf + 1))]

    def values(self, numbers: Array) -> Array:
        return numbers

    def scales(self, numbers: Array) -> Array:
        b, a = numbers[: self.m + 1], numbers[self.m + 1 :]
        unit = float(abs(a[-1])) ** (1.0 / len(a))
        of_b, of_a = unit ** np.arange(len(b)), unit ** np.arange(1, len(a) + 1)
        return np.concatenate((of_b * np.max(np.abs(b) / of_b), np.maximum(np.abs(a), of_a)))

    def derivatives(self, block: TransferFunction) -> Array:
        """Of the nb + nf numbers of the discrete block by b, a: of shape (size, nb + nf)."""
        assert isinstance(block, SampledTransferFunction)
        return block.derivatives(self.m + 1)

    def nearest(self, block: TransferFunction) -> TransferFunction:
        """The continuous block whose samples respond as a discrete block does, as nearly as it can.

        Its poles are the logarithms of the discrete ones, its numerator is fitted to the frequency response
        by least squares. What no continuous pole gives, such as a negative one, is replaced: the fit that
        begins there finds what there is.
        """
        if isinstance(block, SampledTransferFunction):
            return block
        poles = self._poles(block.poles())
        a = np.atleast_1d(np.poly(poles)).real[::-1]
        feedback = tuple((a[1:] / a[0]).tolist())
        omega = _FREQUENCIES * np.pi
        wanted = block.frequency_response(omega)
        columns = []
        for i in range(self.m + 1):
            one = ContinuousTransferFunction((*(0.0,) * i, 1.0), feedback, self.delay)
            columns.append(SampledTransferFunction(one, self.dt, self.intersample).frequency_response(omega))
        matrix = np.vstack((np.real(columns).T, np.imag(columns).T))
        lengths = np.linalg.norm(matrix, axis=0)
        b = np.linalg.lstsq(matrix / lengths, np.concatenate((wanted.real, wanted.imag)), rcond=None)[0]
        return self.made(np.concatenate((b / lengths, feedback)))

    def _poles(self, discrete: Complex) -> Sequence[complex]:
        """n continuous poles for up to n discrete ones."""
        found: list[complex] = []
        for z in discrete:
            if abs(z) < _GONE:
                continue
            # A negative pole swings from sample to sample, which takes a pair: its decay alone is kept.
            real = abs(z.imag) <= 1e-9 * abs(z)
            found.append(complex(np.log(abs(z)) if real else np.log(z)) / self.dt)
        fast = np.log(_GONE) / self.dt
        missing = self.nf - len(found)
        return [*found, *(fast / (1.0 + 0.5 * k) for k in range(missing))]
