"""What every metric spec answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

from hident.config.references import EstimatorName
from hident.config.spec import Component
from hident.records import Estimate, Record
from hident.signals.base import ExcitationSpec, Stretch
from hident.systems.base import SystemSpec

Best = Literal["lowest", "highest", "zero"]
"""Which values are good: low ones, high ones, or those near zero, whatever their sign."""


@dataclass(frozen=True)
class Scored:
    """What a metric is to score: the data of a case, and what an estimator makes of them.

    ``dt`` is the sampling interval (None: discrete time), ``provides`` the parts of the estimate, ``step``
    the sampling interval of its discrete linear block, and ``validated`` whether the record has a validation
    part.
    """

    samples: int
    dt: float | None
    system: SystemSpec
    excitation: ExcitationSpec
    provides: frozenset[str]
    step: float
    validated: bool = False

    def stretches(self) -> tuple[Stretch, ...]:
        """The experiments of the record."""
        return self.excitation.stretches(self.samples, self.dt or 1.0)


class MetricSpec(Component):
    """Base of all metrics."""

    best: ClassVar[Best | None] = None
    """Which of its values are good, for comparisons of methods; None: it is no score."""

    estimators: tuple[EstimatorName, ...] | None = None
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

    def compares(self) -> frozenset[str]:
        """The parts whose absolute values it compares with the truth's.

        By default all that it needs of both. A metric that does not depend on the factor between the blocks,
        which no data determine, gives none.
        """
        return self.needs_of_truth() & self.needs_of_estimate()

    def says(self, dt: float | None) -> str:
        """What a table says of how it scores at sampling interval ``dt``; nothing by default."""
        return ""

    def check(self, scored: Scored) -> None:
        """Raise ValueError if it cannot score this, though every part that it needs is there."""

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        """One number for each label; a number that is not finite counts as a failed trial."""
        raise NotImplementedError
