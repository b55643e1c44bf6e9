"""Continuous-time Hammerstein systems by the iterative two-stage method over moving horizons.

Chen, Hwang and Chang 2009. Stage 1 finds the static function, stage 2 the linear block behind it.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Discriminator, Field

from hident.arrays import Array
from hident.config.spec import Count, Real, component
from hident.errors import EstimationError
from hident.estimators.base import FUNCTIONS, POWERS, offset
from hident.estimators.convergence import settle
from hident.estimators.moving_horizon.hammerstein.stage import (
    FirstStage,
    Polynomial,
    ThreeSegment,
    first_stage,
)
from hident.estimators.moving_horizon.hammerstein.static_functions import ThreeSegmentFunction
from hident.estimators.moving_horizon.iterative import IterativeSpec, known, padded
from hident.estimators.moving_horizon.partition import require_inside
from hident.estimators.moving_horizon.searches import StructureSearch, found_searches
from hident.estimators.moving_horizon.transform.linear_transform import (
    LinearFit,
    SecondStageSpec,
    StageSpec,
    responses_in,
)
from hident.estimators.moving_horizon.transform.sandwich import influence, standard_errors
from hident.estimators.normalisation import Normalisation, unit_static_gain
from hident.records import Estimate, Record

# Section 5: the polynomial that a first structure is found with.
_GUESS = Polynomial(kind="polynomial", degree=5)


@component("estimator", "iterative_hammerstein", source="Chen, Hwang, Chang 2009, eq. (22), (25), (27)")
class IterativeHammerstein(IterativeSpec):
    """Continuous-time Hammerstein system by the iterative two-stage algorithm.

        y + a_1 y^(1) + ... + a_n y^(n) = x(t-d) + b_1 x^(1)(t-d) + ... + b_m x^(m)(t-d)
        x = sum_j c_j f_j(u)

    Derivatives y^(l) are taken by the time-weighted integral transform over moving horizons.

    Examples
    --------
    >>> import hident as hi
    >>> quadratic = hi.Polynomial(coefficients=[0, 1, 0.5])
    >>> system = hi.Hammerstein(nonlinearity=quadratic, linear=hi.Continuous(a=[2.5, 1.5]))
    >>> record = hi.simulate(system, hi.Multistep(switching_time=1, std=1), 400, dt=0.1)
    >>> nonlinearity, first = {"kind": "polynomial", "degree": 2}, {"n": 2, "horizon": 8}
    >>> found = hi.fit(hi.IterativeHammerstein(nonlinearity=nonlinearity, first=first), record)
    >>> [round(a, 1) for a in found.continuous.a]
    [2.5, 1.5]
    """

    holds = ("nonlinearity", "continuous", "response")
    share: ClassVar[float] = 0.5
    guesses: ClassVar[bool] = True

    nonlinearity: Annotated[Polynomial | ThreeSegment, Discriminator("kind")]
    """The static function: {kind: polynomial, degree: 5} or {kind: three_segment, partition: search}."""
    tolerance: Annotated[Real, Field(gt=0)] = 1e-6
    """The iteration ends when the parameters change by less than this, relative to their norm."""
    max_iterations: Annotated[Count, Field(ge=1)] = 100
    """The most iterations."""

    def function_parameters(self) -> int:
        size = self.nonlinearity.size
        return max(size, _GUESS.size) if self.automatic else size

    def names(self) -> list[str]:
        coefficients = [f"c_{j}" for j in range(1, self.nonlinearity.size + 1)]
        points = ["u_-1", "u_1"] if isinstance(self.nonlinearity, ThreeSegment) else []
        ended = ["iterations", "converged"]
        found = [*self.stage_names(), *self.error_names(1), *coefficients, *ended, *points]
        return [*found, *self.constant_names()]

    def letters(self) -> Mapping[str, str]:
        return {
            **super().letters(),
            "c": FUNCTIONS if isinstance(self.nonlinearity, ThreeSegment) else POWERS,
        }

    def normalisations(self) -> tuple[Normalisation, ...]:
        return (unit_static_gain().beside(self.constant),)

    def check_record(self, record: Record) -> None:
        super().check_record(record)
        if isinstance(self.nonlinearity, ThreeSegment):
            require_inside(self.nonlinearity.partition, record.u, "input")

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        dt = self.sampling_interval(record)
        first, second, search = self.stages(
            partial(self._first, record, dt), partial(self._second, record, dt)
        )
        return self._estimate(record, dt, first, second, search)

    def _first(self, record: Record, dt: float, stage: StageSpec, delay: float, guess: bool) -> FirstStage:
        try:
            found = first_stage(
                record.u,
                record.y,
                dt,
                _GUESS if guess else self.nonlinearity,
                stage,
                delay=delay,
                start=self.start,
                tolerance=self.tolerance,
                max_iterations=self.max_iterations,
                constant=self.constant,
                parts=record.experiments,
            )
        except ValueError as error:
            raise EstimationError(str(error)) from None
        settle(bool(found.iteration.converged[0]), int(found.iteration.iterations[0]), self.unconverged)
        return found

    def _second(
        self, record: Record, dt: float, first: FirstStage, stage: SecondStageSpec, eta: float
    ) -> tuple[LinearFit, StructureSearch | None]:
        return stage.fit(
            record.y,
            first.function(record.u),
            dt,
            delay=first.block.delay,
            eta=eta,
            start=self.start,
            gain=1.0,
            constant=self.constant,
            parts=record.experiments,
        )

    def _estimate(
        self,
        record: Record,
        dt: float,
        first: FirstStage,
        second: LinearFit | None,
        search: StructureSearch | None,
    ) -> Estimate:
        block, constant = first.block, first.constant
        if second is not None:
            block, constant = second.block, second.constant
        function = first.function
        points = (function.lower, function.upper) if isinstance(function, ThreeSegmentFunction) else ()
        values = self.named(
            self.stage_values(first.block, first.regressors, first.horizons, second),
            self._errors(record, dt, first, second),
            function.c,
            first.iteration.iterations,
            first.iteration.converged,
            points,
            *known(constant),
        )
        return Estimate(
            nonlinearity=function,
            continuous=block,
            response=offset(lambda u, dt: block.respond(function(u), dt), constant),
            values=values,
            details={"history": first.history(), **found_searches(first.partition, search)},
        )

    def _errors(self, record: Record, dt: float, first: FirstStage, second: LinearFit | None) -> Array:
        """The sandwich standard errors of the block, zero where it has no parameter.

        The first stage solves phi' (z - phi theta) = 0, so that its parameters vary by
        (phi' jacobian)^-1 phi' times the equations' errors; to the second stage's own errors come those
        of the coefficients c_j.
        """
        bread = np.asarray(np.linalg.solve(first.phi.T @ first.jacobian, first.phi.T), dtype=float)
        derivative = influence(bread, first.horizons, first.knots, first.block.a)
        block, constant = first.block, first.constant
        if second is not None:
            block, constant = second.block, second.constant
            onto = np.asarray(np.linalg.pinv(second.phi), dtype=float)
            operator, levels = second.horizons.held_runs(record.u, block.delay, len(block.b))
            basis = second.horizons.transform(operator, first.function.basis(levels))
            by_c = onto @ np.einsum("mkp,m->kp", basis, np.array(block.b))
            own = influence(onto, second.horizons, second.knots, block.a)
            coefficients = len(first.block.a) + len(first.block.b) - 1
            size = len(first.function.c)
            derivative = own - by_c @ derivative[coefficients : coefficients + size]
        residual = record.y - responses_in(record.experiments, block, first.function(record.u), dt)
        residual = residual - (constant or 0.0)
        found = standard_errors(derivative, residual)
        n = len(block.a)
        return padded(found[:n], found[n : n + len(block.b) - 1], self.largest_n, 1)
