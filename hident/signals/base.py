"""What every excitation and every noise spec answers."""

from __future__ import annotations

import numpy as np

from hident.config.spec import Component
from hident.records import Array


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


class NoiseSpec(Component):
    """Base of all that happens between the true output and the measured one."""

    def measure(self, output: Array, rng: np.random.Generator) -> Array:
        """The measured output, a new array of the shape of ``output`` (N,)."""
        raise NotImplementedError
