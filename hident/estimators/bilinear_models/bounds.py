"""What no unbiased estimator can beat, and the reference that knows half of the answer."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Annotated

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.spec import Real, component
from hident.estimators.base import IMPULSE_RESPONSE, with_errors
from hident.estimators.bilinear_models.bilinear import Regression, identity
from hident.estimators.bilinear_models.bilinear_least_squares import covariance_root
from hident.estimators.bilinear_models.known_basis import BilinearSpec
from hident.estimators.bilinear_models.two_stage import KnownAr, WeightedSpec
from hident.estimators.normalisation import Normalisation, known_function
from hident.numerics.autoregression import ArModel
from hident.records import Estimate, Record
from hident.systems.base import NonlinearitySpec, OfStatic


def cramer_rao(regression: Regression, b: Array, a: Array, variance: float) -> tuple[Array, Array]:
    """The Cramer-Rao bounds, as standard deviations, of b (n,) and a (m,) with b of length one.

    The noise is Gaussian with covariance ``variance`` times the inverse of the regression's weighting W.
    """
    std = np.sqrt(variance) * np.linalg.norm(covariance_root(regression, b, a), axis=1)
    return std[: len(b)], std[len(b) :]


@component("estimator", "cramer_rao")
class CramerRao(BilinearSpec):
    """Least standard deviations of b_i and a_j, as se_b_i and se_a_j, from the truth: Cramer-Rao bound.

        cov(b, a) >= variance (J' W J)^-1

    Here J is the derivative of Phi theta by a and by the directions in which b keeps the length one.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Fir(b=[0.6, -0.8]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> bound = hi.fit(hi.CramerRao(lags=2, basis=["abs"], delay=0, variance=0.01), record)
    >>> round(bound.values["se_b_1"], 4)
    0.0037
    """

    variance: Annotated[Real, Field(gt=0)]
    """Variance of the Gaussian white noise, or of the innovation of the autoregressive one."""
    noise: KnownAr | None = None
    """Autoregressive noise {kind: ar, a: [...]}; white if left out."""

    def names(self) -> list[str]:
        return [f"se_{name}" for name in self.parameters()]

    def needs_of_truth(self) -> frozenset[str]:
        return frozenset({"nonlinearity", "linear"})

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        phi, parts = self.design(record)
        root = partial(ArModel(np.array(self.noise.a)).whiten, parts=parts) if self.noise else identity
        regression = Regression.of(phi, self.lags, root, self.delay, constant=self.constant)
        bounds = cramer_rao(regression, *self.true_parameters(record), self.variance)
        return Estimate(values=self.named(*bounds))


@component("estimator", "known_nonlinearity")
class KnownNonlinearity(WeightedSpec):
    """Finite impulse response by linear least squares when the nonlinearity is known.

        y(t) = sum_i b_i x(t-i) + v(t),    x = f(u)

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Fir(b=[0.6, -0.8]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> found = hi.fit(hi.KnownNonlinearity(lags=2, delay=0, nonlinearity="abs"), record)
    >>> [round(found.values[name], 6) for name in ("b_0", "b_1")]
    [0.6, -0.8]
    """

    holds = ("nonlinearity", "linear", "response")

    nonlinearity: Annotated[NonlinearitySpec, OfStatic()]
    """The known nonlinearity, with its scale: b is not normalised."""

    def functions(self) -> tuple[NonlinearitySpec, ...]:
        return (self.nonlinearity,)

    def letters(self) -> Mapping[str, str]:
        return {"b": IMPULSE_RESPONSE}

    def normalisations(self) -> tuple[Normalisation, ...]:
        rule = known_function("the nonlinearity is the given one", self.nonlinearity, constant=self.constant)
        return (self.beside_constant(rule),)

    def names(self) -> list[str]:
        return [*with_errors(self.b_names()), *self.noise_names(), *self.constant_names()]

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        phi, y, parts = self.data(record)
        weighted = self.weighted(phi, y, parts)
        theta = weighted.regression.theta(y)
        white = weighted.white
        errors = np.sqrt(white.variance(y, white.theta(y))) * np.linalg.norm(white.g, axis=1)
        b = theta[:, 0]
        constants = [white.constants(y, b, np.ones(1))] if self.constant else []
        estimate = Estimate(
            nonlinearity=self.nonlinearity,
            linear=self.linear(b),
            values=self.named(b, errors, weighted.order, constants),
        )
        return self.responding(estimate, record.dt)
