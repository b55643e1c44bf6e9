"""Scores of named values: parameters such as a_1 or b_0."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import Annotated, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from hident.config.spec import Real, component
from hident.metrics.base import ONE_UNIT, Comparing, MetricSpec, Scored
from hident.numerics.freedoms import multiple
from hident.records import Estimate, Record, Truth, needed


class _OfValues(MetricSpec):
    of: tuple[str, ...]
    """Names of the values, e.g. [a_1, a_2]."""

    @field_validator("of")
    @classmethod
    def _some(cls, of: tuple[str, ...]) -> tuple[str, ...]:
        if not of:
            raise ValueError("must name at least one value, e.g. [a_1]")
        return of

    def needs_of_estimate(self) -> frozenset[str]:
        return frozenset(f"value {name}" for name in self.of)


class _EachValue(_OfValues):
    def labels(self, name: str) -> tuple[str, ...]:
        return tuple(f"{name} {value}" for value in self.of)


class _AgainstTruth(_OfValues):
    def needs_of_truth(self) -> frozenset[str]:
        return frozenset(f"value {name}" for name in self.of)

    def errors(self, estimate: Estimate, record: Record) -> list[float]:
        truth = needed(record.truth)
        return [estimate.values[name] - truth.values[name] for name in self.of]


@component("metric", "value")
class Value(_EachValue):
    """The estimated values themselves.

    Examples
    --------
    >>> import hident as hi
    >>> hi.score(hi.Estimate(values={"a_1": 0.75}), hi.Record([0], [0]), a=hi.Value(of=["a_1"]))
    {'a a_1': 0.75}
    """

    prefix: str = ""
    """What stands before every name in the estimate, such as first_ for a first stage."""

    def needs_of_estimate(self) -> frozenset[str]:
        return frozenset(f"value {self.prefix}{name}" for name in self.of)

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        return [estimate.values[self.prefix + name] for name in self.of]


@component("metric", "error")
class Error(_EachValue, _AgainstTruth, Comparing):
    """Estimate minus truth: its mean over trials is the bias, its std the standard deviation.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Ar(a=[0.5]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> hi.score(hi.Estimate(values={"a_1": 0.75}), record, a=hi.Error(of=["a_1"]))
    {'a a_1': 0.25}
    """

    best = "zero"

    def in_one_unit(self, one: Truth, other: Truth) -> tuple[bool, ...]:
        pairs = ((abs(one.values[name]), abs(other.values[name])) for name in self.of)
        return tuple(math.isclose(*pair, rel_tol=ONE_UNIT) for pair in pairs)

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        return self.errors(estimate, record)


@component("metric", "true_value")
class TrueValue(_EachValue, _AgainstTruth):
    """The true values themselves, such as a steady state that the paper prints.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Ar(a=[0.5]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> hi.score(hi.Estimate(), record, true=hi.TrueValue(of=["a_1"]))
    {'true a_1': 0.5}
    """

    def needs_of_estimate(self) -> frozenset[str]:
        return frozenset()

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        return [needed(record.truth).values[name] for name in self.of]


@component("metric", "share")
class Share(_EachValue):
    """100 where the values equal a given number, or are at most that, else 0: its mean is the percentage.

    Examples
    --------
    >>> import hident as hi
    >>> estimate = hi.Estimate(values={"n": 2.0})
    >>> hi.score(estimate, hi.Record([0], [0]), second_order=hi.Share(of=["n"], equals=2))
    {'second_order n': 100.0}
    """

    equals: Real | None = None
    """The number; give this or 'at_most'."""
    at_most: Real | None = None
    """The largest number that counts."""

    @model_validator(mode="after")
    def _one_rule(self) -> Self:
        if (self.equals is None) == (self.at_most is None):
            raise ValueError("give either 'equals' or 'at_most'")
        return self

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        values = [estimate.values[name] for name in self.of]
        if self.at_most is not None:
            return [100.0 * (value <= self.at_most) for value in values]
        return [100.0 * (value == self.equals) for value in values]


@component("metric", "coverage")
class Coverage(_EachValue, _AgainstTruth, Comparing):
    """100 where the interval by the estimate's own standard error holds the truth, else 0.

        |estimate - truth| <= z se, where z is the normal quantile of the confidence, 1.96 for 0.95

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Ar(a=[0.5]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> estimate = hi.Estimate(values={"a_1": 0.75, "se_a_1": 0.2})
    >>> hi.score(estimate, record, held=hi.Coverage(of=["a_1"]))
    {'held a_1': 100.0}
    """

    confidence: Annotated[Real, Field(gt=0, lt=1)] = 0.95
    """Confidence level of the interval, by the normal distribution."""

    def needs_of_estimate(self) -> frozenset[str]:
        return super().needs_of_estimate() | {f"value se_{name}" for name in self.of}

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        reach = NormalDist().inv_cdf(0.5 + self.confidence / 2.0)
        errors = self.errors(estimate, record)
        within = [reach * estimate.values[f"se_{name}"] for name in self.of]
        return [100.0 * (abs(error) <= limit) for error, limit in zip(errors, within, strict=True)]


@component("metric", "percent_error", source="Chen, Hwang, Chang 2009, section 6, example 1")
class PercentError(_AgainstTruth, Comparing):
    """Sum of absolute errors of the values in percent of the sum of their absolute truths.

        100 sum_i |estimate_i - truth_i| / sum_i |truth_i|

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Ar(a=[0.5]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> hi.score(hi.Estimate(values={"a_1": 0.75}), record, a=hi.PercentError(of=["a_1"]))
    {'a': 50.0}
    """

    best = "lowest"

    def in_one_unit(self, one: Truth, other: Truth) -> tuple[bool, ...]:
        # The sums weigh values by their sizes.
        ours, theirs = (np.array([truth.values[name] for name in self.of]) for truth in (one, other))
        return (multiple(np.abs(ours), np.abs(theirs)) is not None,)

    def check(self, scored: Scored) -> None:
        values = scored.truth.values
        if not any(values[name] for name in self.of):
            raise ValueError("is in percent of the true values, which are all zero: take the kind error")

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        size = sum(abs(needed(record.truth).values[name]) for name in self.of)
        error = sum(abs(value) for value in self.errors(estimate, record))
        return (100.0 * error / size if size else float("nan"),)
