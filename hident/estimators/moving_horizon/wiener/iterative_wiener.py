"""Continuous-time Wiener systems by the iterative two-stage method over moving horizons.

Chen, Hwang and Chang 2009. Stage 1 finds the nonlinearity, stage 2 the linear block before it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Discriminator, Field

from hident.arrays import Array, Characteristic
from hident.config.spec import Count, Real, component
from hident.errors import EstimationError
from hident.estimators.base import offset
from hident.estimators.convergence import settle
from hident.estimators.moving_horizon.iterative import IterativeSpec, known, padded
from hident.estimators.moving_horizon.partition import require_inside
from hident.estimators.moving_horizon.searches import StructureSearch, found_searches
from hident.estimators.moving_horizon.transform.linear_transform import (
    LinearFit,
    Measured,
    SecondStageSpec,
    StageSpec,
    responses_in,
)
from hident.estimators.moving_horizon.wiener.iteration import Rule, Wiener
from hident.estimators.moving_horizon.wiener.stage import (
    FourSegmentSpec,
    PolynomialSpec,
    WienerStage,
    first_stage,
)
from hident.estimators.moving_horizon.wiener.standard_errors import wiener_errors
from hident.estimators.normalisation import Normalisation, unit_slope, unit_static_gain
from hident.linear_blocks import ContinuousTransferFunction
from hident.records import Estimate, Record
from hident.systems.nonlinearity import PiecewiseLinear

_CLUSTERS = 20


@dataclass(frozen=True)
class WienerResponse:
    """The response of a nonlinearity after a linear block, from rest."""

    block: ContinuousTransferFunction
    nonlinearity: Characteristic

    def __call__(self, u: Array, dt: float) -> Array:
        return self.nonlinearity(self.block.respond(u, dt))


def smoothed(v: Array, y: Array, clusters: int) -> Array:
    """The means of ``v`` and ``y``, both (N,), over neighbouring clusters of equal size, shape (2, clusters).

    Chen, Hwang and Chang 2009, example 3. Clusters with the same mean of v are one.
    """
    order = np.argsort(v, kind="stable")
    parts = np.array_split(order, min(clusters, len(v)))
    means = np.array([[signal[part].mean() for part in parts] for signal in (v, y)])
    _, first = np.unique(means[0], return_index=True)
    return np.asarray(means[:, first])


@component(
    "estimator",
    "iterative_wiener",
    source="Chen, Hwang, Chang 2009, eq. (12)-(17), (23), (26), (28), (29), (31), (32), sections 4, 5",
)
class IterativeWiener(IterativeSpec):
    """Continuous-time Wiener system by the iterative two-stage algorithm.

        x + a_1 x^(1) + ... + a_n x^(n) = b_0 u(t-d) + ... + b_m u^(m)(t-d)
        x = y - sum_i c_i g_i(y)

    Derivatives x^(l) are taken by the time-weighted integral transform over moving horizons.

    Differs from the paper: poles of an iterate in the right half plane are reflected into the left one, and
    an iteration that ends badly, or does not converge, starts again from the linear model's output.

    Examples
    --------
    >>> import hident as hi
    >>> quadratic = hi.Polynomial(coefficients=[0, 1, 0.5])
    >>> system = hi.Wiener(nonlinearity=quadratic, linear=hi.Continuous(a=[2.5, 1.5]))
    >>> record = hi.simulate(system, hi.Multistep(switching_time=1, std=0.5, limits=[-1, 1]), 600, dt=0.1)
    >>> nonlinearity, first = {"kind": "polynomial", "degree": 2}, {"n": 2, "horizon": 8}
    >>> found = hi.fit(hi.IterativeWiener(nonlinearity=nonlinearity, first=first), record)
    >>> [round(a, 1) for a in found.continuous.a]
    [2.5, 1.5]
    """

    holds = ("nonlinearity", "continuous", "response")
    share: ClassVar[float] = 1.0

    nonlinearity: Annotated[FourSegmentSpec | PolynomialSpec, Discriminator("kind")]
    """The nonlinearity: {kind: four_segment, partition: search} or {kind: polynomial, degree: 4}."""
    weight: Annotated[Real, Field(ge=0, le=1)] = 0.5
    """Weight of the linear block's output in the internal variable (29)."""
    tolerance: Annotated[Real, Field(gt=0)] = 1e-3
    """The iteration ends when the parameters change by less than this, relative to their norm."""
    max_iterations: Annotated[Count, Field(ge=1)] = 60
    """The most iterations."""
    smooth: Annotated[Count, Field(ge=2)] | None = None
    """Estimate the nonlinearity by straight lines through the means of this many clusters (example 3)."""

    def function_parameters(self) -> int:
        return len(self.nonlinearity.coefficients()) + 1

    def names(self) -> list[str]:
        errors = self.error_names(0) if isinstance(self.nonlinearity, FourSegmentSpec) else []
        ended = ["iterations", "converged"]
        return [*self.stage_names(), *self.nonlinearity.names(), *errors, *ended, *self.constant_names()]

    def letters(self) -> Mapping[str, str]:
        return {**super().letters(), **self.nonlinearity.letters()}

    def normalisations(self) -> tuple[Normalisation, ...]:
        # The values are those of the iteration, which holds the inverse's slope e_1.
        return (unit_static_gain(values="").beside(self.constant), unit_slope("e_1 = 1", "b e"))

    def check_record(self, record: Record) -> None:
        super().check_record(record)
        if isinstance(self.nonlinearity, FourSegmentSpec):
            require_inside(self.nonlinearity.partition, record.y, "output")

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        dt = self.sampling_interval(record)
        self.check_record(record)
        first, second, search = self.stages(
            partial(self._first, record, dt), partial(self._second, record, dt)
        )
        return self._estimate(record, dt, first, second, search)

    def _first(self, record: Record, dt: float, stage: StageSpec, delay: float, guess: bool) -> WienerStage:
        try:
            parameters = self.first_parameters(stage)
            horizons = stage.horizons(len(record), dt, self.start, parameters, record.experiments)
        except ValueError as error:
            raise EstimationError(str(error)) from None
        wiener = Wiener.of(
            record.u, record.y, dt, m=stage.m, delay=delay, horizons=horizons, constant=self.constant
        )
        rule = Rule(self.weight, self.tolerance, self.max_iterations)
        found = first_stage(wiener, self.nonlinearity, rule, self.start)
        settle(found.history.converged, found.iterations, self.unconverged)
        if found.block.static_gain() == 0.0:
            raise EstimationError("the first stage's linear block has no static gain: its b_0 is zero")
        return found

    def _second(
        self, record: Record, dt: float, first: WienerStage, stage: SecondStageSpec, eta: float
    ) -> tuple[LinearFit, StructureSearch | None]:
        gain, nonlinearity, constant = first.block.b[0], first.nonlinearity, first.constant or 0.0
        # The output of the linear block is now known, (28b), and so is its static gain.
        return stage.fit(
            first.x,
            record.u,
            dt,
            delay=first.block.delay,
            eta=eta,
            start=self.start,
            gain=gain,
            measured=Measured(record.y, lambda x: nonlinearity(x / gain) + constant, record.experiments),
            parts=record.experiments,
        )

    def _estimate(
        self,
        record: Record,
        dt: float,
        first: WienerStage,
        second: LinearFit | None,
        search: StructureSearch | None,
    ) -> Estimate:
        block = first.block if second is None else second.block
        unit = block.scaled(1.0 / block.b[0])
        v = responses_in(record.experiments, unit, record.u, dt)
        y = record.y - (first.constant or 0.0)
        clusters = smoothed(v, y, self.smooth or _CLUSTERS)
        nonlinearity = first.nonlinearity if self.smooth is None else _through(clusters)
        values = self.named(
            self.stage_values(first.block, first.regressors, first.wiener.horizons, second),
            first.parameters,
            self._errors(first, second),
            first.iterations,
            first.history.converged,
            *known(first.constant),
        )
        details = {
            "history": first.history,
            "internal_variable": np.array([v, y]),
            "smoothed": clusters,
            **found_searches(first.partition, search),
        }
        return Estimate(
            nonlinearity=nonlinearity,
            continuous=unit,
            response=offset(WienerResponse(unit, nonlinearity), first.constant),
            values=values,
            details=details,
        )

    def _errors(self, first: WienerStage, second: LinearFit | None) -> Array:
        """The standard errors of the block, zero where it has no parameter; none for a polynomial."""
        if not isinstance(self.nonlinearity, FourSegmentSpec):
            return np.empty(0)
        *e, lower, upper = first.parameters
        points = lower, upper
        found = wiener_errors(
            first.wiener, first.phi, first.block, np.array(e), points, self.weight, second, first.constant
        )
        return padded(*found, self.largest_n)


def _through(points: Array) -> PiecewiseLinear:
    """Straight lines through the ``points`` (2, K)."""
    if points.shape[1] < 2:
        raise EstimationError("the linear block's output does not vary: there is nothing to smooth")
    return PiecewiseLinear(points=tuple(map(tuple, points.T.tolist())))
