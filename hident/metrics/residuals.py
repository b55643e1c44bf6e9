"""Tests of the residuals as scores, so that tables show how often a model is blamed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from hident.config.spec import Real, component
from hident.errors import EstimationError
from hident.fitted_model import FittedModel
from hident.metrics.base import Scored
from hident.metrics.outputs import Compared, OutputMetric
from hident.numerics.judgement import LEVEL, Residuals, judgement
from hident.numerics.parts import joined
from hident.numerics.residuals import Tested, count_of_lags
from hident.records import Estimate, Record

_SAID = {
    "whiteness": "whiteness by Ljung and Box",
    "input": "independence of the input",
    "nonlinear_input": "independence of nonlinear functions of the input and the model's output",
    "normality": "normality by D'Agostino and Pearson",
    "drift": "no trend in mean or variance",
}


def judged(held: Compared, estimate: Estimate, by: Literal["simulation", "prediction"]) -> Residuals:
    """What the residuals of an estimate say, by what was held against each other.

    Raises
    ------
    EstimationError
        If there are too few residuals.
    """
    model = estimate.model
    noise = model.noise if by == "prediction" and isinstance(model, FittedModel) else None
    fitted = len(noise.ar) + len(noise.ma) if noise else 0
    return judgement(held.u, held.y, held.y_hat, held.experiments, by=by, fitted=fitted)


@component("metric", "residual_test")
class ResidualTest(OutputMetric):
    """A test of the model's residuals: its p-value, its statistic, or whether it blames the model.

    Whiteness is that of the residuals up to lag 20. The tests against the input take 21 lags together, which
    reach four times as far as the output is correlated with itself, and allow for coloured noise. Those
    against nonlinear functions are one test for each of them, and the p-value is the least times their
    number, with its statistic; so it is with the trends in mean and in variance.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="identity", linear=hi.Fir(b=[0.5, 0.5]))
    >>> excitation = hi.Iid(distribution="uniform", low=-1, high=1)
    >>> record = hi.simulate(system, excitation, 500, noise=hi.White(std=0.1))
    >>> models = {"right": system.simulate, "late": lambda u, dt: system.simulate(0.0 * u)}
    >>> for name, model in models.items():
    ...     found = hi.score(hi.Estimate(response=model), record, p=hi.ResidualTest(of="input"))
    ...     print(name, found["p"] > 0.01)
    right True
    late False
    """

    of: Literal["whiteness", "input", "nonlinear_input", "normality", "drift"]
    """What is tested."""
    gives: Literal["p_value", "statistic", "rejected"] = "p_value"
    """The number; ``rejected`` is 100 where p is below the level, else 0: its mean is a percentage."""
    level: Annotated[Real, Field(gt=0, lt=1)] = LEVEL
    """The level of ``rejected``."""

    @model_validator(mode="after")
    def _of_one_step(self) -> Self:
        if self.of == "whiteness" and self.steps > 1:
            raise ValueError(
                f"the errors of a prediction {self.steps} steps ahead are not white under any model: "
                "test 'steps: 1'"
            )
        return self

    def says(self, dt: float | None) -> str:
        number = {
            "p_value": "p-value",
            "statistic": "statistic",
            "rejected": f"rejections at {self.level:g} in %",
        }
        return f"{number[self.gives]} of the test of {_SAID[self.of]}, {super().says(dt)}"

    def check(self, scored: Scored) -> None:
        super().check(scored)
        if self.on == "estimation":
            lengths = (stretch.samples - self.n_init for stretch in scored.stretches())
            try:
                count_of_lags(joined(length for length in lengths if length > 0))
            except EstimationError as error:
                raise ValueError(f"cannot judge this: {error}") from None

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        test = self._test(judged(self.compared(estimate, record), estimate, self.by))
        match self.gives:
            case "p_value":
                return (test.p_value,)
            case "statistic":
                return (test.statistic,)
            case "rejected":
                return (100.0 * (test.p_value < self.level),)

    def _test(self, residuals: Residuals) -> Tested:
        if residuals.vanish:
            raise EstimationError("the residuals are no more than rounding: there is nothing to test")
        match self.of:
            case "whiteness":
                found: Tested | None = residuals.whiteness.test
            case "input":
                found = None if residuals.input is None else residuals.input.test
            case "nonlinear_input":
                found = residuals.nonlinearity
            case "normality":
                found = residuals.normality.test
            case "drift":
                found = residuals.drift.test
        if found is None:
            raise EstimationError(
                "the input is constant: the residuals cannot depend on it"
                if self.of == "input"
                else "on this input every nonlinear function is a line: none can be tested"
            )
        return found
