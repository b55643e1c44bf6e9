"""Trials until a statistic is precise: a rule in the place of their number."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from hident.config.references import MetricLabel
from hident.config.spec import Count, Real, Spec

Statistic = Literal["mean", "median", "std"]


def _some(value: Any) -> Any:
    if value == "all":
        return ()
    if isinstance(value, list | tuple) and not value:
        raise ValueError("must name a metric's label; leave it out for all of them")
    return value


class Until(Spec):
    """When there are enough trials.

    A run looks after ``least`` trials, twice as many, four times as many, and at last after ``most``. It ends
    at the first look at which the standard error of each statistic is at most ``relative_se`` of it. All
    estimates of the file have equally many trials.
    """

    relative_se: Annotated[Real, Field(gt=0, lt=1)]
    """The largest standard error, in units of the statistic's absolute value."""
    of: Annotated[tuple[MetricLabel, ...], BeforeValidator(_some)] = ()
    """Labels of the metrics that must be that precise, for each estimator and case; all by default."""
    statistic: Statistic = "mean"
    """The statistic."""
    least: Annotated[Count, Field(ge=2)] = 50
    """The trials before the first look: with few of them, a standard error is itself uncertain."""
    most: Annotated[Count, Field(ge=2)]
    """The trials at which a run ends in any case."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.most < self.least:
            raise ValueError(f"'most' must be at least 'least', {self.least}, not {self.most}")
        return self

    @property
    def decisions(self) -> tuple[int, ...]:
        """After how many trials a run looks.

        Examples
        --------
        >>> Until(relative_se=0.01, most=1000, least=200).decisions
        (200, 400, 800, 1000)
        """
        found = [self.least]
        while found[-1] < self.most:
            found.append(min(2 * found[-1], self.most))
        return tuple(found)


class Sequential(Spec):
    """A rule in the place of a number of trials."""

    until: Until
    """What ends a run."""


def _which(value: Any) -> str:
    return "rule" if isinstance(value, Mapping | Sequential) else "number"


Trials = Annotated[
    Annotated[Count, Field(ge=1), Tag("number")] | Annotated[Sequential, Tag("rule")], Discriminator(_which)
]
