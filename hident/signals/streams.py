"""Who may draw which random numbers.

Every trial has separate streams for the input, the noise and each estimator, so that the data
of a trial depend on the seed, the data-generating part of the case and the trial's number, and on nothing
else: not on the estimators, the order of the cases, the number of workers or the number of trials.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from hident.config.spec import Component, component

Role = Literal["input", "noise", "estimator"]
OfData = Literal["input", "noise"]
ROLES_OF_DATA: tuple[OfData, ...] = get_args(OfData)
# The numbers by which the streams are spawned: no other role may ever take one of them.
_NUMBERS: dict[Role, int] = {"input": 1, "noise": 2, "estimator": 3}


class StreamsSpec(Component):
    """Base of all sources of random numbers."""

    fixed: tuple[OfData, ...] = ()
    """Streams that start anew in every trial: the same draws in all trials (e.g. [input])."""
    share: tuple[OfData, ...] = ()
    """Streams that all cases share: the same draws in all cases, another for each trial (e.g. [noise])."""

    def is_fixed(self, role: Role) -> bool:
        """Whether the role draws the same numbers in all trials."""
        return role in self.fixed

    def generator(self, role: Role, seed: int, key: int, trial: int) -> np.random.Generator:
        """The generator of one role in one trial; ``key`` is the hash of what the stream belongs to."""
        raise NotImplementedError

    def generators(self, role: Role, seed: int, key: int, trials: Sequence[int]) -> list[np.random.Generator]:
        """The generators of several trials, which give the numbers that each gives by itself."""
        return [self.generator(role, seed, key, trial) for trial in trials]


@component("streams", "numpy")
class NumpyStreams(StreamsSpec):
    """NumPy's PCG64, seeded by SeedSequence with spawn keys.

    Examples
    --------
    >>> NumpyStreams().generator("input", seed=1, key=0, trial=0).random(2).round(3)
    array([0.583, 0.335])
    """

    def generator(self, role: Role, seed: int, key: int, trial: int) -> np.random.Generator:
        number = 0 if self.is_fixed(role) else trial + 1
        sequence = np.random.SeedSequence([seed, key], spawn_key=(_NUMBERS[role], number))
        return np.random.Generator(np.random.PCG64(sequence))
