"""What every metric owes: it scores by what it names, and leaves all as it is."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np

from hident.engine.expansion import not_given
from hident.metrics.base import MetricSpec
from hident.records import Estimate, Record, Truth
from hident.testing.base import Contract, must

Parts = TypeVar("Parts", Truth, Estimate)


@dataclass(frozen=True)
class MetricContract(Contract):
    """What a metric owes, tried on an estimate from a record."""

    component: MetricSpec
    estimate: Estimate
    record: Record

    def can_be_tried_on_these_data(self) -> None:
        truth = frozenset[str]() if self.record.truth is None else self.record.truth.provides()
        of = "give 'data' with a system that has it"
        for need in not_given(self.component.needs_of_truth(), truth):
            must(False, f"needs the {need} of the truth: {of}")
        for need in not_given(self.component.needs_of_estimate(), self.estimate.provides()):
            must(False, f"needs the {need} of the estimate: give an 'estimator' whose estimate has it")

    def gives_a_number_for_each_label(self) -> None:
        values, labels = self._score(self.estimate, self.record), self.component.labels("m")
        must(len(values) == len(labels), f"gives {len(values)} numbers, and has the labels {labels}")
        must(len({*labels}) == len(labels), f"the labels {labels} are not all different")
        must(np.isfinite(values).all(), f"the numbers {values} are not finite")

    def gives_the_same_numbers_again(self) -> None:
        once, again = (self._score(self.estimate, self.record) for _ in range(2))
        must(once == again, f"the same estimate scores {once} and then {again}")

    def leaves_the_record_as_it_is(self) -> None:
        record = replace(self.record, u=self.record.u.copy(), y=self.record.y.copy())
        self._score(self.estimate, record)
        for name in ("u", "y"):
            must(
                np.array_equal(getattr(record, name), getattr(self.record, name)),
                f"evaluate writes to record.{name}, which all metrics share: let it work on a copy",
            )

    def needs_no_more_than_it_says(self) -> None:
        whole = self._score(self.estimate, self.record)
        truth = self.record.truth
        record = replace(
            self.record,
            truth=None if truth is None else _only(truth, self.component.needs_of_truth()),
        )
        try:
            named = self._score(_only(self.estimate, self.component.needs_of_estimate()), record)
        except Exception as error:
            raise AssertionError(
                f"needs more than needs_of_truth() and needs_of_estimate() say: with those parts alone it "
                f"ends with {type(error).__name__}: {error}"
            ) from error
        must(named == whole, f"with the parts that it needs alone it gives {named}, not {whole}")

    def _score(self, estimate: Estimate, record: Record) -> tuple[float, ...]:
        with np.errstate(all="ignore"):
            return tuple(map(float, self.component.evaluate(estimate, record)))


def of_truth(truth: Truth | None) -> Estimate:
    """The estimate that knows the truth."""
    if truth is None:
        return Estimate()
    names = ("nonlinearity", "linear", "continuous", "response", "values")
    return Estimate(**{name: getattr(truth, name) for name in names})


def _only(parts: Parts, needs: frozenset[str]) -> Parts:
    """A truth or an estimate with the needed parts alone."""
    wanted = {word for need in needs for word in need.split(" or ")}
    values = {name: value for name, value in parts.values.items() if f"value {name}" in wanted}
    kept = {
        field.name: getattr(parts, field.name)
        for field in fields(parts)
        # What is no part of its own goes along with the parts.
        if field.name in wanted or field.name in ("breakpoints", "structure", "details")
    }
    return type(parts)(**{**kept, "values": values})
