"""What every estimator's spec answers."""

from __future__ import annotations

import numpy as np

from hident.config.spec import Component
from hident.records import Estimate, Record


class EstimatorSpec(Component):
    """Base of all estimators.

    ``fit`` raises :class:`hident.errors.EstimationError` when the estimate is singular or diverges.
    """

    def provides(self) -> frozenset[str]:
        """The parts of the estimate: ``nonlinearity``, ``linear`` and ``value NAME`` for each value."""
        raise NotImplementedError

    def fewest_samples(self) -> int:
        """The shortest record that the method accepts."""
        return 1

    def fit(self, record: Record, rng: np.random.Generator) -> Estimate:
        """Estimate from a record; ``rng`` is the estimator's own stream."""
        raise NotImplementedError
