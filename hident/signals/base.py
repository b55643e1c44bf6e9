"""What every excitation and every noise spec answers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hident.arrays import Array
from hident.config.spec import Component
from hident.records import Held, Periodic, Waveform

MOST_SAMPLES = 100_000_000
"""Of a record: a signal of more takes gigabytes, and what asks for it was mistyped."""


@dataclass(frozen=True)
class Stretch:
    """One experiment of a record: an excitation applied for ``samples`` samples at ``dt``.

    A periodic signal has been applied ever since if ``settled``, else from the first sample on.
    """

    name: str
    excitation: ExcitationSpec
    samples: int
    dt: float
    settled: bool = True

    def waveform(self, rng: np.random.Generator) -> Waveform:
        """The signal between the samples, from a generator equal to that of the samples."""
        waveform = self.excitation.waveform(self.samples, self.dt, rng)
        return replace(waveform, settled=self.settled) if isinstance(waveform, Periodic) else waveform


class ExcitationSpec(Component):
    """Base of all excitations; times are in the unit of ``dt`` (1 in discrete time)."""

    def check(self, n: int, dt: float) -> None:
        """Raise ValueError if a record of ``n`` samples at ``dt`` cannot hold this signal."""

    def sample(self, n: int, dt: float, rng: np.random.Generator, burn_in: int = 0) -> Array:
        """``burn_in`` samples from before the record, then the record's ``n``: shape (burn_in + n,).

        Sample ``burn_in`` is at time 0. Periodic signals extend to negative times by periodicity, a
        staircase by its first level. Given the generator, the record does not depend on ``burn_in``.
        """
        raise NotImplementedError

    def waveform(self, n: int, dt: float, rng: np.random.Generator) -> Waveform:
        """The signal whose samples :meth:`sample` gives from an equal generator without burn-in.

        Unless an excitation knows better, it is held from sample to sample, and zero before the record.
        """
        return Held(np.arange(float(n)) * dt, self.sample(n, dt, rng))

    def period_at(self, dt: float) -> float | None:
        """The period of a signal made of harmonics, in time; None for any other."""
        return None

    def stretches(self, n: int, dt: float) -> tuple[Stretch, ...]:
        """The experiments that a record of ``n`` samples consists of, one after the other.

        Raises
        ------
        ValueError
            If they cannot be made with that ``dt``.
        """
        return (Stretch("record", self, n, dt),)

    def before(self) -> float | None:
        """The level that it says was applied before the record; None if it does not say."""
        return None

    def chooses_start(self) -> bool:
        """Whether it says how an experiment starts, which not every system can follow."""
        return False


class NoiseSpec(Component):
    """Base of all that happens between the true output and the measured one."""

    def measure(self, output: Array, rng: np.random.Generator) -> Array:
        """The measured output, a new array of the shape of ``output`` (N,)."""
        raise NotImplementedError
