"""The reference that knows the linear block."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from hident.config.spec import component
from hident.estimators.base import DISCRETE, AtOneInterval
from hident.estimators.normalisation import Normalisation, first_coefficient
from hident.linear_blocks import TransferFunction, significant
from hident.records import Estimate, Record
from hident.systems.base import Feedback, Numerator


@component("estimator", "known_dynamics")
class KnownDynamics(AtOneInterval):
    """The given linear block, whatever the data: the reference that knows it.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Ar(a=[0.5]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> hi.fit(hi.KnownDynamics(a=[0.5]), record).linear
    TransferFunction(b=(1.0,), a=(0.5,))
    """

    # At one interval: the block is a discrete one, and those who use it work at its interval.
    identifies_dynamics: ClassVar[bool] = True
    holds = ("linear",)

    a: Feedback = ()
    """Feedback a_1, ..., a_p: v_k = a_1 v_{k-1} + ... + b_0 w_k + ..."""
    b: Numerator = (1.0,)
    """Numerator b_0, b_1, ..."""

    def names(self) -> list[str]:
        return [*self._block().values()]

    def fewest_samples(self) -> int:
        return len(self.a) + 1

    def letters(self) -> Mapping[str, str]:
        return DISCRETE

    def normalisations(self) -> tuple[Normalisation, ...]:
        lag = int(np.flatnonzero(significant(self.b))[0])
        return (first_coefficient(lag, self.b[lag]),)

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        self.require_experiments(record)
        block = self._block()
        return Estimate(linear=block, values=block.values())

    def _block(self) -> TransferFunction:
        return TransferFunction(b=self.b, a=self.a)
