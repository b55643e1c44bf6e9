"""What every metric spec answers."""

from __future__ import annotations

from collections.abc import Sequence

from hident.config.spec import Component
from hident.records import Estimate, Record


class MetricSpec(Component):
    """Base of all metrics."""

    estimators: tuple[str, ...] | None = None
    """Names of the estimators that it scores; all of them by default."""

    def labels(self, name: str) -> tuple[str, ...]:
        """The names of its numbers, given its own name in the configuration."""
        return (name,)

    def needs_of_truth(self) -> frozenset[str]:
        """The parts it needs of the truth, spelled as in :meth:`SystemSpec.provides`."""
        return frozenset()

    def needs_of_estimate(self) -> frozenset[str]:
        """The parts it needs of the estimate, spelled as in :meth:`EstimatorSpec.provides`."""
        return frozenset()

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        """One number for each label; a number that is not finite counts as a failed trial."""
        raise NotImplementedError
