"""What every estimator's spec answers."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hident.config.spec import Component
from hident.errors import EstimationError
from hident.estimators.normalisation import Normalisation
from hident.records import Array, Estimate, Record


class EstimatorSpec(Component):
    """Base of all estimators.

    Of a continuous-time method, times are in the unit of ``dt``.

    ``fit`` raises :class:`hident.errors.EstimationError` when the estimate is singular or diverges.
    """

    identifies_dynamics: ClassVar[bool] = False
    """Whether the estimate always holds a discrete linear block, so that it can serve as a prefilter."""

    def provides(self) -> frozenset[str]:
        """The parts of the estimate: ``nonlinearity``, ``linear`` and ``value NAME`` for each value."""
        raise NotImplementedError

    def fewest_samples(self) -> int:
        """The shortest record that the method accepts."""
        return 1

    def draws(self) -> bool:
        """Whether ``fit`` draws from its stream; where it does not, the stream need not be seeded."""
        return True

    def needs_of_truth(self) -> frozenset[str]:
        """The parts it needs of the truth, as a bound or a reference does; none by default."""
        return frozenset()

    def normalisations(self) -> tuple[Normalisation, ...] | None:
        """How it fixes the factor between the blocks, which no data determine; None if it does not say.

        One rule for each set of parts; a part that none governs does not depend on the factor.
        """
        return None

    def discrete_step(self, dt: float | None) -> float:
        """The sampling interval of the estimate's discrete linear block, given that of the data."""
        return 1.0 if dt is None else dt

    def check(self, n: int, dt: float | None) -> None:
        """Raise ValueError if records of ``n`` samples every ``dt`` (None: discrete time) do not suit."""

    def check_record(self, record: Record) -> None:
        """Raise EstimationError if a record like this one, that of trial 0, is hopeless."""

    def fit(self, record: Record, rng: np.random.Generator) -> Estimate:
        """Estimate from a record; ``rng`` is the estimator's own stream."""
        raise NotImplementedError


def require_finite(y: Array) -> None:
    """Raise EstimationError if the output holds nan or infinity."""
    wrong = len(y) - np.count_nonzero(np.isfinite(y))
    if wrong:
        raise EstimationError(f"the output has {wrong} of {len(y)} samples that are not finite")
