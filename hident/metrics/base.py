"""What every metric spec answers."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass
from typing import ClassVar, Literal

from pydantic import field_validator

from hident.config.references import EstimatorName
from hident.config.spec import Component
from hident.config.suggest import one_of
from hident.numerics.freedoms import FREEDOMS, Freedom, in_words
from hident.records import Estimate, Record, Truth
from hident.signals.base import ExcitationSpec, Stretch
from hident.systems.base import SystemSpec

Best = Literal["lowest", "highest", "zero"]
"""Which values are good: low ones, high ones, or those near zero, whatever their sign."""


ONE_UNIT = 1e-3
"""Forms whose factors differ by less give scores in one unit: rules are kept to four digits."""


@dataclass(frozen=True)
class Scored:
    """What a metric is to score: the data of a case, and what an estimator makes of them.

    ``truth`` is the system's in the form in which the metric is given it. ``dt`` is the sampling interval
    (None: discrete time), ``provides`` the parts of the estimate, ``step`` the sampling interval of its
    discrete linear block, and ``validated`` whether the record has a validation part.
    """

    samples: int
    dt: float | None
    system: SystemSpec
    truth: Truth
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

    def completed(self, left: Set[Freedom], step: float) -> MetricSpec:
        """The metric as it scores the estimates of one method: what is not written follows from that.

        ``left`` is what the method leaves open of the parts that are compared, ``step`` the sampling interval
        of its discrete linear block.
        """
        return self

    def says(self, dt: float | None) -> str:
        """What a table says of how it scores at sampling interval ``dt``; nothing by default."""
        return ""

    def in_one_unit(self, one: Truth, other: Truth) -> tuple[bool, ...]:
        """For each of its numbers, whether scores against two forms of one system's truth are in one unit.

        By default all are. One that has the unit of a part that the forms scale says where they do.
        """
        return (True,) * len(self.labels(""))

    def check(self, scored: Scored) -> None:
        """Raise ValueError if it cannot score this, though every part that it needs is there."""

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        """One number for each label; a number that is not finite counts as a failed trial."""
        raise NotImplementedError


class Comparing(MetricSpec):
    """Base of the metrics that compare values with the truth's, of which no data determine some."""

    choices: ClassVar[tuple[Freedom, ...]] = ()
    """What it can choose for the least error; where nothing is written, what the method leaves open of it."""
    how: ClassVar[str] = "chosen for the least error"
    """How it does so, in words."""

    up_to: tuple[Freedom, ...] | None = None
    """What no data determine and is chosen for the least error: gain, sign, delay, constant; []: nothing, the
    values as they are written. Left out, what the method leaves open, such as a constant. Left out or without
    gain, the truth is brought to the estimator's form; with gain and without sign, to its sign."""

    @field_validator("up_to")
    @classmethod
    def _can_choose(cls, up_to: tuple[Freedom, ...] | None) -> tuple[Freedom, ...] | None:
        if up_to is None:
            return None
        if strange := [name for name in FREEDOMS if name in up_to and name not in cls.choices]:
            allowed = one_of(cls.choices) if cls.choices else "[], the values as they are written"
            raise ValueError(f"this metric can choose no {' or '.join(strange)} (allowed: {allowed})")
        return tuple(name for name in FREEDOMS if name in up_to)

    def completed(self, left: Set[Freedom], step: float) -> MetricSpec:
        if self.up_to is not None:
            return self
        return self.model_copy(update={"up_to": tuple(n for n in self.choices if n in left)})

    def left_in_words(self) -> str:
        """What a table says of what is chosen because the method leaves it open; empty if nothing is."""
        return f"up to {in_words(self.up_to)}, which the method leaves open" if self.up_to else ""

    def says(self, dt: float | None) -> str:
        if self.up_to is None:
            return ""
        return f"up to {in_words(self.up_to)}, whichever fits the truth best" if self.up_to else "as written"
