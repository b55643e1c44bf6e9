"""A linear model of the whole system by the time-weighted transform: what ignoring the nonlinearity gives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar

import numpy as np
from pydantic import model_validator

from hident.config.spec import component
from hident.estimators.base import offset
from hident.estimators.moving_horizon.iterative import (
    MovingHorizonSpec,
    known,
    regression_names,
    regression_values,
    structure_of,
    under,
)
from hident.estimators.moving_horizon.searches import found_searches
from hident.estimators.moving_horizon.transform.linear_transform import SecondStageSpec
from hident.estimators.normalisation import Normalisation, known_function
from hident.numerics.parts import Parts
from hident.records import Estimate, Record


@component("estimator", "linear_model", source="Hwang and Lin 2003; Chen, Hwang, Chang 2009, examples 5, 6")
class LinearModel(MovingHorizonSpec):
    """Continuous-time linear model by least squares over moving horizons.

        y + a_1 y^(1) + ... + a_n y^(n) = b_0 u(t-d) + ... + b_m u^(m)(t-d)

    Derivatives y^(l) are taken by the time-weighted integral transform over moving horizons.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="identity", linear=hi.Continuous(a=[2.5, 1.5]))
    >>> record = hi.simulate(system, hi.Multistep(switching_time=1, std=1), 400, dt=0.1)
    >>> found = hi.fit(hi.LinearModel(block={"n": 2, "horizon": 8}), record)
    >>> [round(a, 1) for a in found.continuous.a]
    [2.5, 1.5]
    """

    holds = ("continuous", "response")
    instead: ClassVar[Mapping[str, str]] = {
        "delay": "'block: {structure: search, delays: [...]}' searches among several"
    }

    block: SecondStageSpec
    """Structure and horizons of the model; the horizon's length is required here."""

    @model_validator(mode="after")
    def _with_horizon(self) -> LinearModel:
        if self.block.horizon is None:
            raise ValueError("block.horizon is required: the length eta of the horizons")
        return self

    def tried_delays(self) -> Iterator[tuple[float, str]]:
        yield from ((delay, "block.delays") for delay in self.block.delays)

    def check_horizons(self, parts: Parts, dt: float) -> None:
        with under("block"):
            self.block.check(parts[-1].stop, dt, self.start, gain=True, constant=self.constant, parts=parts)

    def normalisations(self) -> tuple[Normalisation, ...]:
        rule = known_function("the nonlinearity is u", np.positive, constant=self.constant)
        return (rule.beside(self.constant),)

    def names(self) -> list[str]:
        found = ["n", "m", "delay", "settling_time", "horizons"]
        return [*regression_names(self.block.most), *found, *self.constant_names()]

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        dt, eta = self.sampling_interval(record), self.block.horizon
        assert eta is not None
        found, search = self.block.fit(
            record.y,
            record.u,
            dt,
            delay=self.delay,
            eta=eta,
            start=self.start,
            gain=None,
            constant=self.constant,
            parts=record.experiments,
        )
        block = found.block
        values = regression_values(block, found.regressors, self.block.most)
        ended = block.settling_time(), found.horizons.count
        return Estimate(
            continuous=block,
            response=offset(block.respond, found.constant),
            values=self.named(values, *structure_of(block), *ended, *known(found.constant)),
            details=found_searches(None, search),
        )
