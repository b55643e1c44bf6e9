"""The output-error refinement of a two-stage estimate as an estimator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import AfterValidator

from hident.config.spec import Of, component
from hident.estimators.base import AtOneInterval, EstimatorSpec, offset, with_errors
from hident.estimators.moving_horizon.hammerstein.iterative_hammerstein import IterativeHammerstein
from hident.estimators.moving_horizon.hammerstein.static_functions import (
    PolynomialFunction,
    ThreeSegmentFunction,
)
from hident.estimators.moving_horizon.iterative import IterativeSpec
from hident.estimators.moving_horizon.output_error import Refinement, refine_hammerstein, refine_wiener
from hident.estimators.moving_horizon.wiener.four_segment import FourSegment
from hident.estimators.moving_horizon.wiener.iterative_wiener import IterativeWiener, WienerResponse
from hident.estimators.moving_horizon.wiener.stage import FourSegmentSpec
from hident.estimators.normalisation import Normalisation
from hident.records import Estimate, Record


def _refinable(start: EstimatorSpec) -> EstimatorSpec:
    if isinstance(start, IterativeWiener):
        fits = isinstance(start.nonlinearity, FourSegmentSpec) and start.smooth is None
    else:
        fits = isinstance(start, IterativeHammerstein)
    if not fits:
        raise ValueError(
            "must be iterative_hammerstein, or iterative_wiener with four segments that are not smoothed"
        )
    assert isinstance(start, IterativeSpec)
    if start.second is not None and start.second.structure == "search":
        raise ValueError("must have a given structure: 'second.structure: search' leaves its parameters open")
    return start


def _last(found: Refinement, size: int) -> float | None:
    """The constant of the output, if it stands behind so many coefficients."""
    return next(iter(found.coefficients[size:].tolist()), None)


@component("estimator", "output_error")
class OutputError(AtOneInterval):
    """The two-stage estimate, refined to the least squared error of the simulated output.

        sum_k (y_k - y_k(theta))^2 least over theta, where y_k(theta) is simulated from the input

    Values besides the parameters and their se_: iterations; step_left, the length of the step that is left,
    in standard errors; converged, 0 where it is longer than 0.0001 because the minimum lies on a kink of
    the criterion (Wiener only: a sample on a bend of the nonlinearity). Such an estimate does not count as
    failed, since it is a minimum. An iteration that ends anywhere else fails.

    Examples
    --------
    >>> import hident as hi
    >>> quadratic = hi.Polynomial(coefficients=[0, 1, 0.5])
    >>> system = hi.Hammerstein(nonlinearity=quadratic, linear=hi.Continuous(a=[2.5, 1.5]))
    >>> steps, noise = hi.Multistep(switching_time=1, std=1), hi.White(nsr=0.01)
    >>> record = hi.simulate(system, steps, 400, noise=noise, dt=0.1)
    >>> nonlinearity, first = {"kind": "polynomial", "degree": 2}, {"n": 2, "horizon": 8}
    >>> start = hi.IterativeHammerstein(nonlinearity=nonlinearity, first=first)
    >>> found = hi.fit(hi.OutputError(start=start), record)
    >>> [round(a, 1) for a in found.continuous.a]
    [2.5, 1.5]
    """

    holds = ("nonlinearity", "continuous", "response")

    start: Annotated[IterativeSpec, Of("estimator"), AfterValidator(_refinable)]
    """The estimate to start from: iterative_hammerstein or iterative_wiener."""

    def fewest_samples(self) -> int:
        return self.start.fewest_samples()

    def check(self, n: int, dt: float | None) -> None:
        self.start.check(n, dt)

    def letters(self) -> Mapping[str, str]:
        return self.start.letters()

    def normalisations(self) -> tuple[Normalisation, ...] | None:
        return self.start.normalisations()

    def check_record(self, record: Record) -> None:
        self.start.check_record(record)

    def parameters(self) -> list[str]:
        """The names of the refined parameters, in their order."""
        start = self.start
        n, m = (start.first.n, start.first.m) if start.second is None else (start.second.most, start.second.m)
        a = [f"a_{i}" for i in range(1, n + 1)]
        if isinstance(start, IterativeHammerstein):
            b = [f"b_{i}" for i in range(1, m + 1)]
            own = [f"c_{j}" for j in range(1, start.nonlinearity.size + 1)]
        else:
            b, own = [f"b_{i}" for i in range(m + 1)], ["e_-2", "e_-1", "e_2"]
        return [*a, *b, *own, *start.constant_names()]

    def free_parameters(self) -> int:
        return len(self.parameters())

    def names(self) -> list[str]:
        return [*with_errors(self.parameters()), "iterations", "converged", "step_left"]

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        self.require_experiments(record)
        begun = self.start.fit(record, rng)
        block, function, dt = begun.continuous, begun.nonlinearity, record.dt
        assert block is not None
        assert dt is not None
        if isinstance(function, PolynomialFunction | ThreeSegmentFunction):
            found = refine_hammerstein(
                function.basis(record.u),
                record.y,
                block,
                dt,
                record.experiments,
                constant=self.start.constant,
            )
            size = len(function.c)
            refined = replace(function, c=tuple(found.coefficients[:size].tolist()))
            return Estimate(
                nonlinearity=refined,
                continuous=found.block,
                response=offset(lambda u, step: found.block.respond(refined(u), step), _last(found, size)),
                values=self._values(found, found.block.b[1:]),
            )
        assert isinstance(function, FourSegment)
        bent = replace(function, gain=1.0)
        start = block.scaled(function.gain)
        constant = begun.values.get("constant")
        found = refine_wiener(record.u, record.y, start, bent, dt, record.experiments, constant=constant)
        gain = found.block.b[0]
        e_far, e_near, e_2 = found.coefficients[:3].tolist()
        unit, curve = found.block.scaled(1.0 / gain), replace(function, e=(e_far, e_near, e_2), gain=gain)
        return Estimate(
            nonlinearity=curve,
            continuous=unit,
            response=offset(WienerResponse(unit, curve), _last(found, 3)),
            values=self._values(found, found.block.b),
        )

    def _values(self, found: Refinement, b: tuple[float, ...]) -> dict[str, float]:
        parameters = found.block.a, b, found.coefficients
        ended = found.iterations, not found.stalled, found.left
        return self.named(*parameters, found.standard_errors, *ended)
