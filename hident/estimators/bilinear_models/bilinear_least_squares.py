"""The weighted nonlinear least squares problem of a Hammerstein system with bilinear parameters.

Symbols are in :mod:`hident.estimators.bilinear_models.bilinear`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import repeat
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.spec import Count, Flag, Real, Spec, component
from hident.errors import EstimationError
from hident.estimators.bilinear_models.bilinear import Regression, loss, normalised
from hident.estimators.bilinear_models.two_stage import Weighted, WeightedBilinearSpec, two_stage
from hident.estimators.convergence import Unconverged, settle
from hident.numerics.gauss_newton import gauss_newton
from hident.numerics.least_squares import Factorisation
from hident.records import Estimate, Record


@dataclass(frozen=True, eq=False)
class Solution:
    """b (n,), a (m,), the iterations made, and whether the last one was below the tolerance."""

    b: Array
    a: Array
    iterations: int
    converged: bool


def jacobian(r: Array, b: Array, a: Array) -> Array:
    """The derivative (rows, n + m) of r vec(b a') by b (n,) and a (m,), for ``r`` (rows, n m)."""
    blocks = r.reshape(len(r), len(a), len(b))
    return np.hstack([np.einsum("kji,j->ki", blocks, a), np.einsum("kji,i->kj", blocks, b)])


def complement(vector: Array) -> Array:
    """An orthonormal basis (k, k - 1) of what is orthogonal to ``vector`` (k,)."""
    return np.linalg.qr(vector[:, None], mode="complete").Q[:, 1:]


def covariance_root(regression: Regression, b: Array, a: Array) -> Array:
    """A root (n + m, n + m - 1) of the Cramer-Rao bound of (b, a) with b of length one.

    The noise is Gaussian with covariance W^-1; the bound is the root times its transpose. It is also the
    asymptotic covariance of the weighted nonlinear least squares estimate.
    """
    tangent = complement(np.concatenate([b, np.zeros_like(a)]))
    derivative = jacobian(regression.r, b, a) @ tangent
    return np.asarray(tangent @ Factorisation.of(derivative).inverse_root)


def bilinear_least_squares(
    regression: Regression,
    y: Array,
    b: Array,
    a: Array,
    *,
    tolerance: float = 1e-12,
    max_iterations: int = 200,
    normalise: bool = True,
) -> Solution:
    """Minimise (Phi vec(b a') - y)'W(Phi vec(b a') - y) by Gauss and Newton's method with step halving.

    Parameters
    ----------
    regression : Regression
        The regressors with their weighting.
    y : array, shape (rows,)
        The output.
    b, a : arrays, shapes (n,), (m,)
        Where to start.
    tolerance : float
        Stop when a full step changes the model's output by less than this, relative to that output.
    max_iterations : int
        Stop after so many steps.
    normalise : bool
        Keep b at length one. If not, every step is the shortest in all n + m coordinates, so that the
        common factor of b and 1/a stays where the start and the steps leave it.

    Returns
    -------
    Solution

    Notes
    -----
    Wang, Zhang, Ljung 2009, eq. (10). The data enter as R and Q'F y only, so a step takes (n m)^2
    operations whatever the number of samples. The criterion has local minima, and no test tells one: of 150
    random systems (n = 6, m = 3, 60 or 200 samples of white noise) the minimum found from the two-stage
    estimate was never one where signal and noise have equal power, and 8 times where the noise has ten times
    that of the signal.
    """
    r, z = regression.r, regression.projected(y)

    def at(b: Array, a: Array) -> _Point:
        # The direction that leaves b a' as it is (b grows, a shrinks), or assumption 1's normal.
        tangent = complement(np.concatenate([b, np.zeros_like(a) if normalise else -a]))
        return _Point(b, a, z - r @ np.outer(a, b).ravel(), jacobian(r, b, a) @ tangent, tangent)

    def moved(point: _Point, step: Array) -> _Point:
        by_b, by_a = np.split(point.tangent @ step, [len(b)])
        new = point.b + by_b, point.a + by_a
        return at(*(normalised(*new) if normalise else new))

    found = gauss_newton(
        at(b, a),
        moved,
        lambda point, length: length <= tolerance * float(np.linalg.norm(z - point.residuals)),
        max_iterations=max_iterations,
        # Losses closer than this differ by rounding only.
        slack=1e-14 * float(z @ z),
        step_at_rest=True,
    )
    return Solution(found.point.b, found.point.a, found.iterations, found.status == "converged")


@dataclass(frozen=True, eq=False)
class _Point:
    b: Array
    a: Array
    residuals: Array
    jacobian: Array
    tangent: Array

    @property
    def loss(self) -> float:
        return float(self.residuals @ self.residuals)


class Stop(Spec):
    """When to stop short of convergence."""

    tolerance: Annotated[Real, Field(gt=0)] = 1e-6
    """Relative change of the model's output by a step, below which to stop."""
    max_iterations: Annotated[Count, Field(ge=1)] = 400
    """Most steps."""


@component("estimator", "bilinear_least_squares", source="Wang, Zhang, Ljung 2009, eq. (10)")
class BilinearLeastSquares(WeightedBilinearSpec):
    """Hammerstein system by weighted nonlinear least squares, from the two-stage estimate.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Fir(b=[0.6, -0.8]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> found = hi.fit(hi.BilinearLeastSquares(lags=2, basis=["identity", "abs"], delay=0), record)
    >>> [round(found.values[name], 6) for name in ("a_2", "b_0", "b_1")]
    [1.0, 0.6, -0.8]
    """

    start: Literal["two_stage", "truth"] = "two_stage"
    """Where the iterations start."""
    stop: Stop | None = None
    """Stop early, by another tolerance than that of a minimum found to 12 digits."""
    unconverged: Unconverged = "fail"
    """Whether iterations that have not converged by then count as failed, or are kept as they are."""
    normalise: Flag = True
    """Keep b at length one; false leaves the common factor of b and 1/a where the iterations drift."""

    def names(self) -> list[str]:
        return [*super().names(), "iterations", "converged"]

    def needs_of_truth(self) -> frozenset[str]:
        return frozenset({"nonlinearity", "linear"} if self.start == "truth" else ())

    def solved(self, weighted: Weighted, y: Array, record: Record) -> list[Estimate | EstimationError]:
        first = two_stage(weighted.regression, y)
        starts: Iterable[tuple[Array, Array]] = zip(first.b, first.a, strict=True)
        if self.start == "truth":
            starts = repeat(self.true_parameters(record), len(y))
        return [self._solved(weighted, *of) for of in zip(y, starts, strict=True)]

    def _solved(self, weighted: Weighted, y: Array, start: tuple[Array, Array]) -> Estimate | EstimationError:
        """The estimate from the output ``y`` (rows,) of one trial."""
        stop = {} if self.stop is None else self.stop.model_dump()
        found = bilinear_least_squares(weighted.regression, y, *start, normalise=self.normalise, **stop)
        try:
            settle(found.converged, found.iterations, self.unconverged)
        except EstimationError as error:
            return error
        errors = self._standard_errors(weighted, y, *normalised(found.b, found.a))
        [estimate] = self.estimates(
            weighted,
            y[None],
            (found.b[None], found.a[None]),
            (errors[0][None], errors[1][None]),
            (float(found.iterations), float(found.converged)),
        )
        return estimate

    def _standard_errors(self, weighted: Weighted, y: Array, b: Array, a: Array) -> tuple[Array, Array]:
        """Those of the normalised parameters; they assume white noise unless its covariance is the weight."""
        white = weighted.white
        if self.weight == "inverse_gram":
            # Theorem 2: the solution is the unweighted two-stage estimate.
            return white.standard_errors(b, a, white.variance(y, white.theta(y)))
        spare = len(y) - len(b) - len(a) + 1
        std = np.sqrt(loss(white, y, b, a, white.root) / spare)
        errors = std * np.linalg.norm(covariance_root(white, b, a), axis=1)
        return errors[: len(b)], errors[len(b) :]
