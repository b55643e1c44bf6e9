"""A method of your own: its plain function first, and the component that configurations name below it."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.spec import Count, component
from hident.errors import EstimationError
from hident.estimators.base import FEEDBACK, POWERS, AtOneInterval, require_usable
from hident.estimators.normalisation import Normalisation, first_coefficient
from hident.linear_blocks import TransferFunction
from hident.numerics.least_squares import Factorisation
from hident.numerics.parts import Parts, in_each, longer_than
from hident.records import Estimate, Record


def starter(u: Array, y: Array, degree: int, parts: Parts) -> tuple[float, Array]:
    """a_1 and c (degree,) of y_t = a_1 y_(t-1) + c_1 u_t + ... + c_d u_t^d, by least squares.

    Raises
    ------
    EstimationError
        If no experiment has two samples, or the input does not tell the powers apart.
    """
    # An equation looks one sample back, and never from one experiment into another.
    if not (long := longer_than(parts, 1)):
        raise EstimationError("no experiment holds the 2 samples that an equation needs")

    def rows_of(u: Array, y: Array) -> Array:
        return np.column_stack([y[:-1], u[1:, None] ** np.arange(1, degree + 1)])

    regression = Factorisation.of(in_each(long, rows_of, u, y))
    if regression.is_dependent:
        raise EstimationError(f"the input does not tell {degree} powers and the last output apart")
    a, *c = regression.solution(in_each(long, lambda y: y[1:], y))
    return float(a), np.array(c)


@component("estimator", "starter", source="Author year, eq. (1)")
class Starter(AtOneInterval):
    """First-order feedback and a polynomial without constant, by least squares."""

    # The parts of the estimate; its numbers are in names().
    holds = ("nonlinearity", "linear")

    # Each field is a key of the configuration, and the text under it what `hident list` says.
    degree: Annotated[Count, Field(ge=1)] = 3
    """Degree of the polynomial."""

    def names(self) -> list[str]:
        return ["a_1", *(f"c_{j}" for j in range(1, self.degree + 1))]

    def fewest_samples(self) -> int:
        return self.degree + 2

    def letters(self) -> dict[str, str]:
        # What a_1 and c_1, c_2, ... are, so that none is compared with another quantity of its name.
        return {"a": FEEDBACK, "c": POWERS}

    def normalisations(self) -> tuple[Normalisation, ...]:
        # No data determine the factor between the blocks: here b_0 = 1.
        return (first_coefficient(),)

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        self.require_experiments(record)
        require_usable(record)
        a, c = starter(record.u, record.y, self.degree, record.experiments)
        return Estimate(
            nonlinearity=np.polynomial.Polynomial([0.0, *c]),
            linear=TransferFunction(a=(a,)),
            values=self.named(a, c),
        )
