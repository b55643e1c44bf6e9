"""The two-stage algorithm for Hammerstein systems: a linear regression, then the nearest matrix of rank one.

Symbols are in :mod:`hident.estimators.bilinear_models.bilinear`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator

from hident.arrays import Array
from hident.config.spec import Real, Spec, component
from hident.config.suggest import did_you_mean, one_of
from hident.errors import EstimationError
from hident.estimators.base import with_errors
from hident.estimators.bilinear_models.ar_noise import EstimatedAr
from hident.estimators.bilinear_models.bilinear import (
    Regression,
    inverse_gram,
    loss,
    normalised,
)
from hident.estimators.bilinear_models.known_basis import BilinearSpec, LaggedSpec
from hident.linear_blocks import MOST_POLES, TransferFunction
from hident.numerics.autoregression import ArModel
from hident.numerics.choices import ROUNDING
from hident.numerics.parts import Parts
from hident.numerics.rounding import apart
from hident.records import Estimate, Record


@dataclass(frozen=True, eq=False)
class TwoStageFit:
    """Estimates b (..., n) and a (..., m), and the unconstrained ``theta`` (..., n, m)."""

    b: Array
    a: Array
    theta: Array


def leading(theta: Array) -> Array:
    """The left singular vectors (..., n) of ``theta`` (..., n, m) for the largest singular values.

    Two rows or columns take one Jacobi rotation, which works on all matrices at once; others are LAPACK's.
    """
    if theta.shape[-1] == 2 < theta.shape[-2]:
        b = (theta @ leading(theta.swapaxes(-1, -2))[..., None])[..., 0]
        return np.asarray(b / np.linalg.norm(b, axis=-1, keepdims=True))
    if theta.shape[-2] == 2:
        x, y = theta[..., 0, :], theta[..., 1, :]
        angle = 0.5 * np.arctan2(2.0 * np.sum(x * y, axis=-1), np.sum((x + y) * (x - y), axis=-1))
        return np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return np.asarray(np.linalg.svd(theta, full_matrices=False).U[..., 0])


def two_stage(regression: Regression, y: Array) -> TwoStageFit:
    """The two-stage algorithm.

    Parameters
    ----------
    regression : Regression
        The regressors with their weighting, factored; it serves any number of calls.
    y : array, shape (..., rows)
        The output of one trial, or of any number of trials with the same input.

    Returns
    -------
    TwoStageFit
        Its arrays begin with the axes of the trials; their bytes do not depend on how many there are.

    Raises
    ------
    EstimationError
        If the output of a trial does not depend on the input: Theta is zero.

    Notes
    -----
    Wang, Zhang, Ljung 2009, eq. (12)-(14) with assumption 1. Differs from the paper: (13) and (14) are
    printed with a and b exchanged; the left singular vector, of length n, is b.
    """
    theta = regression.theta(y)
    if not np.all(np.any(theta, axis=(-2, -1))):
        raise EstimationError("the output does not depend on the input: the estimate of b a' is zero")
    # Eq. (13), (14): s_1 sigma_1 v_1 is Theta' s_1 u_1
    b = leading(theta)
    b, a = normalised(b, (b[..., None, :] @ theta)[..., 0, :])
    return TwoStageFit(b, a, theta)


def estimate_noise(
    regression: Regression, y: Array, noise: EstimatedAr, parts: Parts | None = None
) -> tuple[Regression, ArModel]:
    """The regression weighted by the inverse of the estimated noise covariance, and the noise's model.

    ``regression`` is unweighted, ``y`` has shape (rows,); ``parts`` say where the rows of each experiment
    stand, one by default.

    Notes
    -----
    Wang, Zhang, Ljung 2009, section 3.3. The residuals are those of the unconstrained Theta.
    """
    weighted, constant = regression, regression.level is not None
    coefficients = regression.phi.shape[1] + constant
    for _ in range(noise.iterations):
        residuals = regression.residuals(y, weighted.theta(y))
        if np.linalg.norm(residuals) <= ROUNDING * np.linalg.norm(y):
            # Rounding has no model that another processor would find again.
            residuals = np.zeros_like(residuals)
        model = noise.model(residuals, coefficients, parts)
        root = partial(model.whiten, parts=parts)
        weighted = Regression.of(regression.phi, regression.n, root, constant=constant)
    return weighted, model


class KnownAr(Spec):
    """Autoregressive noise with known coefficients."""

    kind: Literal["ar"]
    """The kind."""
    a: Annotated[tuple[Real, ...], Field(min_length=1, max_length=MOST_POLES)]
    """Feedback coefficients a_1, ..., a_p of the noise."""

    @field_validator("a")
    @classmethod
    def _stationary(cls, a: tuple[float, ...]) -> tuple[float, ...]:
        if not (block := TransferFunction(a=a)).is_stable():
            raise ValueError(
                "the noise is unstable: poles must lie inside the unit circle, "
                f"not at modulus {apart(block.radius(), 1.0, 4)}"
            )
        return a


class InverseGram(Spec):
    """The weighting W-tilde, under which the two-stage estimate with another W is the optimum of (10)."""

    kind: Literal["inverse_gram"]
    """The kind."""
    of: KnownAr
    """The weighting W: the inverse of the covariance of autoregressive noise."""


_WEIGHTS: dict[str, type[KnownAr] | type[EstimatedAr] | type[InverseGram]] = {
    "ar": KnownAr,
    "estimated_ar": EstimatedAr,
    "inverse_gram": InverseGram,
}
_PLAIN = ("identity", "inverse_gram")


@dataclass(frozen=True, eq=False)
class Weighted:
    """A weighting applied to data.

    ``regression`` is weighted for the first stage, ``white`` by the inverse of the noise covariance that
    the standard errors and the output's constant assume; ``order`` is that of a noise model, one number if it
    was estimated.
    """

    regression: Regression
    white: Regression
    order: tuple[int, ...] = ()


class WeightedSpec(LaggedSpec):
    """Base of the estimators with a weighting matrix."""

    weight: Literal["identity", "inverse_gram"] | KnownAr | EstimatedAr | InverseGram = "identity"
    """W: identity, inverse_gram (17), or by the noise: {kind: ar, a: [...]} or {kind: estimated_ar}.

    {kind: inverse_gram, of: {kind: ar, a: [...]}} is that of theorem 3.
    """

    @field_validator("weight", mode="before")
    @classmethod
    def _choose_weight(cls, value: Any) -> Any:
        if isinstance(value, KnownAr | EstimatedAr | InverseGram) or (
            isinstance(value, str) and value in _PLAIN
        ):
            return value
        kind = value.get("kind") if isinstance(value, Mapping) else value
        if not isinstance(kind, str) or kind not in _WEIGHTS:
            raise ValueError(
                f"must be {one_of(_PLAIN)} or a mapping with 'kind: ar', 'kind: estimated_ar' or "
                f"'kind: inverse_gram'{did_you_mean(str(kind), (*_PLAIN, *_WEIGHTS))}"
            )
        return _WEIGHTS[kind].model_validate(value if isinstance(value, Mapping) else {"kind": kind})

    def fewest_samples(self) -> int:
        order = self.weight.max_order if isinstance(self.weight, EstimatedAr) else 0
        return super().fewest_samples() + 2 * order

    def weighted(self, phi: Array, y: Array, parts: Parts | None = None) -> Weighted:
        """The regressors ``phi`` (rows, n m) with the weighting; ``y`` (rows,) serves to estimate it.

        ``parts`` say where the rows of each experiment stand, one by default.
        """
        constant = self.constant
        plain = Regression.of(phi, self.lags, delay=self.delay, constant=constant)
        if self.weight == "identity":
            return Weighted(plain, plain)
        if self.weight == "inverse_gram":
            return Weighted(Regression.of(phi, self.lags, inverse_gram(plain)), plain)
        if isinstance(self.weight, KnownAr | InverseGram):
            noise = self.weight.of if isinstance(self.weight, InverseGram) else self.weight
            known = ArModel(np.array(noise.a))
            white = Regression.of(phi, self.lags, partial(known.whiten, parts=parts), constant=constant)
            if isinstance(self.weight, KnownAr):
                return Weighted(white, white)
            return Weighted(Regression.of(phi, self.lags, inverse_gram(white)), white)
        white, model = estimate_noise(plain, y, self.weight, parts)
        return Weighted(white, white, (len(model.a),))

    def noise_names(self) -> list[str]:
        """The name of the value that an estimated noise model adds."""
        return ["ar_order"] if isinstance(self.weight, EstimatedAr) else []


class WeightedBilinearSpec(WeightedSpec, BilinearSpec):
    """Base of the weighted estimators of a Hammerstein system with known basis functions."""

    holds = ("nonlinearity", "linear", "response")

    def names(self) -> list[str]:
        return [*with_errors(self.parameters()), "loss", *self.noise_names(), *self.constant_names()]

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        [found] = self.fit_many([record], None if rng is None else [rng])
        if isinstance(found, EstimationError):
            raise found
        return found

    def fit_many(
        self, records: Sequence[Record], rngs: Sequence[np.random.Generator] | None = None
    ) -> list[Estimate | EstimationError]:
        """Records of one input share the regressors and their weights, unless the output decides these."""
        first = records[0]
        apart = isinstance(self.weight, EstimatedAr) or any(
            record.u is not first.u
            or (record.parts is not first.parts and record.experiments != first.experiments)
            for record in records
        )
        if apart and len(records) > 1:
            own = [None] * len(records) if rngs is None else [[rng] for rng in rngs]
            pairs = zip(records, own, strict=True)
            return [found for record, of in pairs for found in self.fit_many([record], of)]
        y = self.all_outputs(records)
        phi, parts = self.design(first)
        return self.solved(self.weighted(phi, y[0], parts), y, first, rngs)

    def solved(
        self,
        weighted: Weighted,
        y: Array,
        record: Record,
        rngs: Sequence[np.random.Generator] | None = None,
    ) -> list[Estimate | EstimationError]:
        """The estimates from the outputs ``y`` (T, rows) of T trials with the input of ``record``.

        ``rngs`` are the streams of the trials, of an estimator that draws.
        """
        raise NotImplementedError

    def estimates(
        self,
        weighted: Weighted,
        dt: float | None,
        y: Array,
        parameters: tuple[Array, Array],
        errors: tuple[Array, Array],
        others: Sequence[tuple[float, ...]] = (),
        details: Sequence[Mapping[str, Any]] = (),
    ) -> list[Estimate]:
        """Those of b (T, n) and a (T, m), with standard ``errors``, from outputs ``y`` (T, rows) at ``dt``.

        ``others`` are the values of each trial that a subclass names after the common ones.
        """
        b, a = parameters
        least = loss(weighted.regression, y, b, a, weighted.regression.root)
        names, order = self.names(), tuple(map(float, weighted.order))
        rows = np.concatenate([b, a, *errors, least[:, None]], axis=1).tolist()
        constants: Sequence[tuple[float, ...]] = [()] * len(y)
        if self.constant:
            constants = [(constant,) for constant in weighted.white.constants(y, b, a).tolist()]
        each = zip(b, a, rows, constants, others or [()] * len(y), details or [{}] * len(y), strict=True)
        found = []
        for of_b, of_a, row, constant, of_trial, detail in each:
            nonlinearity, linear = self.nonlinearity(of_a), self.linear(of_b)
            values = dict(zip(names, (*row, *order, *constant, *of_trial), strict=True))
            response = self.response(nonlinearity, linear, dt, *constant)
            found.append(
                Estimate(nonlinearity, linear=linear, response=response, values=values, details=detail)
            )
        return found


@component("estimator", "two_stage", source="Wang, Zhang, Ljung 2009, eq. (12)-(14), (17), section 3.3")
class TwoStage(WeightedBilinearSpec):
    """Hammerstein system by linear least squares and a singular value decomposition.

        1.  (y - Phi theta)' W (y - Phi theta) least, where theta are the columns of Theta
        2.  the sum of squares of Theta - b a' least

    The regression takes all products b_i a_j as free; the nearest matrix of rank one gives b and a.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Fir(b=[0.6, -0.8]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> found = hi.fit(hi.TwoStage(lags=2, basis=["identity", "abs"], delay=0), record)
    >>> [round(found.values[name], 6) for name in ("a_2", "b_0", "b_1")]
    [1.0, 0.6, -0.8]
    """

    def solved(
        self,
        weighted: Weighted,
        y: Array,
        record: Record,
        rngs: Sequence[np.random.Generator] | None = None,
    ) -> list[Estimate | EstimationError]:
        found = two_stage(weighted.regression, y)
        variance = weighted.white.variance(y, weighted.white.theta(y))
        errors = weighted.white.standard_errors(found.b, found.a, variance)
        return [*self.estimates(weighted, record.dt, y, (found.b, found.a), errors)]
