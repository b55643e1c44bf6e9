"""What an estimate makes of a record, beside the output that was measured."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from hident.arrays import Array
from hident.config.spec import Count, Spec
from hident.errors import EstimationError
from hident.metrics.base import MetricSpec, Scored
from hident.model_output import finite_output, simulated
from hident.numerics.parts import Parts, following, in_each, longer_than
from hident.records import Estimate, Record, needed


@dataclass(frozen=True, eq=False)
class Compared:
    """Input, measured output and the model's, all of shape (N,), and where each experiment stands."""

    u: Array
    y: Array
    y_hat: Array
    experiments: Parts

    @property
    def residuals(self) -> Array:
        """What was measured less what the model gives, (N,)."""
        return self.y - self.y_hat


class OnOutput(Spec):
    """How a model's output is held against the measured one: what metrics and figures of it share."""

    on: Literal["estimation", "validation"] = "estimation"
    """The record: the one that was fitted, or its validation part."""
    by: Literal["simulation", "prediction"] = "simulation"
    """From the input alone, or from what was measured up to ``steps`` samples before, too."""
    steps: Annotated[Count, Field(ge=1)] = 1
    """How many samples ahead the output is predicted."""
    n_init: Annotated[Count, Field(ge=0)] = 0
    """The first samples of each experiment that are left out (state_initialization_window_length)."""

    @model_validator(mode="after")
    def _steps_of_a_prediction(self) -> Self:
        if self.by == "simulation" and "steps" in self.model_fields_set:
            raise ValueError("'steps' is of a prediction: set 'by: prediction', or leave it out")
        return self

    def needed_part(self) -> str:
        """The part of an estimate that gives the output."""
        return "model" if self.by == "prediction" else "model or response"

    def described(self) -> str:
        """It in words."""
        which = "on the validation record" if self.on == "validation" else "on the record that was fitted"
        how = "by simulation" if self.by == "simulation" else f"by {self.steps}-step prediction"
        left_out = f", without the first {self.n_init} samples of each experiment" if self.n_init else ""
        return f"{which}, {how}{left_out}"

    def check_lengths(self, lengths: Iterable[int], validated: bool) -> None:
        """Raise ValueError unless experiments of such lengths, with a validation record or not, will do."""
        if self.on == "validation":
            if not validated:
                raise ValueError(
                    "is on a validation record, and this record has none, as no simulated one has: score "
                    "'on: estimation', or the response to another input by kind validation_error"
                )
        elif (longest := max(lengths)) <= self.n_init:
            raise ValueError(
                f"leaves the first {self.n_init} samples of each experiment out, and none has more "
                f"(the longest: {longest}): set a smaller 'n_init'"
            )

    def compared(self, estimate: Estimate, record: Record) -> Compared:
        """What is held against each other.

        Raises
        ------
        EstimationError
            If there is no validation record, no sample is left, or the model's output is not finite.
        """
        if self.on == "validation":
            if record.validation is None:
                raise EstimationError("the record has no validation part to score the model on")
            record = record.validation
        return compared(
            estimate, record, steps=self.steps if self.by == "prediction" else 0, n_init=self.n_init
        )


class OutputMetric(OnOutput, MetricSpec):
    """Base of the metrics that hold the model's output against the measured one."""

    def needs_of_estimate(self) -> frozenset[str]:
        return frozenset({self.needed_part()})

    def says(self, dt: float | None) -> str:
        return self.described()

    def check(self, scored: Scored) -> None:
        self.check_lengths((stretch.samples for stretch in scored.stretches()), scored.validated)


def compared(estimate: Estimate, record: Record, *, steps: int = 0, n_init: int = 0) -> Compared:
    """An estimate's output beside the measured one, without the first ``n_init`` samples of each experiment.

    ``steps`` is how many samples ahead the output is predicted; zero simulates it.

    Raises
    ------
    EstimationError
        If no sample is left, or the model's output is not finite.
    """
    if steps:
        y_hat = finite_output(needed(estimate.model).predict(record, steps), "predicted")
    else:
        y_hat = simulated(estimate, record)
    parts = longer_than(record.experiments, n_init)
    if not parts:
        raise EstimationError(f"no experiment has more than the {n_init} samples that are left out")
    u, y, y_hat = (
        in_each(parts, lambda signal: signal[n_init:], signal) for signal in (record.u, record.y, y_hat)
    )
    return Compared(u, y, y_hat, following(parts, n_init))
