"""The weighted nonlinear least squares problem of a Hammerstein system with bilinear parameters.

Symbols are in :mod:`hident.estimators.bilinear_models.bilinear`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import repeat
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.spec import Count, Flag, Real, Spec, component
from hident.errors import EstimationError
from hident.estimators.bilinear_models.bilinear import Regression, loss, normalised
from hident.estimators.bilinear_models.two_stage import (
    InverseGram,
    Weighted,
    WeightedBilinearSpec,
    two_stage,
)
from hident.estimators.convergence import Unconverged, settle
from hident.numerics.gauss_newton import gauss_newton
from hident.numerics.least_squares import Factorisation
from hident.numerics.subspace_trust_region import subspace_trust_region
from hident.records import Estimate, Record

_SAME = 1e-10
"""Outputs that differ by less than this part of the output are one: a minimum is found to 12 digits."""

Status = Literal["converged", "stalled", "exhausted", "singular"]
"""How it ended: at rest, no step lowers the loss, no iteration is left, the Jacobian is singular."""


@dataclass(frozen=True, eq=False)
class Solution:
    """b (n,), a (m,), the iterations made, and how they ended."""

    b: Array
    a: Array
    iterations: int
    status: Status

    @property
    def converged(self) -> bool:
        """Whether the last iteration was below the tolerance."""
        return self.status == "converged"


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
    problem = _Problem(regression.r, regression.projected(y), normalise, _shortest)
    found = gauss_newton(
        problem.at(b, a),
        problem.moved,
        lambda point, length: length <= tolerance * float(np.linalg.norm(problem.z - point.residuals)),
        max_iterations=max_iterations,
        # Losses closer than this differ by rounding only.
        slack=1e-14 * float(problem.z @ problem.z),
        step_at_rest=True,
    )
    return Solution(found.point.b, found.point.a, found.iterations, found.status)


def bilinear_trust_region(
    regression: Regression,
    y: Array,
    b: Array,
    a: Array,
    *,
    tolerance: float = 1e-6,
    max_iterations: int = 400,
    normalise: bool = True,
) -> Solution:
    """As :func:`bilinear_least_squares`, by :func:`~hident.numerics.subspace_trust_region`.

    Its tolerance is of the change of the loss. With ``normalise`` the steps are those of b on the unit
    sphere; without, of all n + m coordinates, one of which says nothing.

    Notes
    -----
    With ``normalise=False`` and the defaults (those of MATLAB 7's large-scale ``lsqnonlin``: TolFun 1e-6,
    MaxIter 400, TolPCG 0.1, MaxPCGIter max(1, floor((n + m)/2)), PrecondBandWidth 0) it makes the steps of
    that function, to the digits that Wang, Zhang, Ljung 2009 print in Table 1, column 3.
    """
    problem = _Problem(regression.r, regression.projected(y), normalise, _all)
    found = subspace_trust_region(
        problem.at(b, a), problem.moved, tolerance=tolerance, max_iterations=max_iterations
    )
    return Solution(found.point.b, found.point.a, found.iterations, found.status)


def excess(regression: Regression, y: Array, found: Solution, first: tuple[Array, Array]) -> float:
    """The loss of ``found`` over that of the minimum found from b and a of ``first``, less one.

    It is zero where the two outputs are one to 10 digits.

    Raises
    ------
    EstimationError
        If the iterations from ``first`` do not converge.
    """
    least = bilinear_least_squares(regression, y, *first)
    settle(least.converged, least.iterations, "fail")
    r, z = regression.r, regression.projected(y)
    product = np.outer(least.a, least.b).ravel()
    apart = r @ (np.outer(found.a, found.b).ravel() - product)
    if np.linalg.norm(apart) <= _SAME * np.linalg.norm(z):
        return 0.0
    # The difference of two losses has no digits of its own next to the minimum.
    more = float(apart @ (apart - 2.0 * (z - r @ product)))
    return more / float(loss(regression, y, least.b, least.a, regression.root))


def _shortest(b: Array, a: Array) -> Array:
    """The directions (n + m, n + m - 1) across the one that leaves b a' as it is: b grows, a shrinks."""
    return complement(np.concatenate([b, -a]))


def _all(b: Array, a: Array) -> Array:
    return np.eye(len(b) + len(a))


@dataclass(frozen=True, eq=False)
class _Problem:
    """The residuals z - r vec(b a'); ``free`` gives the directions of the steps where b is not held."""

    r: Array
    z: Array
    normalise: bool
    free: Callable[[Array, Array], Array]

    def at(self, b: Array, a: Array) -> _Point:
        # Held, b moves across assumption 1's normal.
        tangent = complement(np.append(b, np.zeros_like(a))) if self.normalise else self.free(b, a)
        residuals = self.z - self.r @ np.outer(a, b).ravel()
        return _Point(b, a, residuals, jacobian(self.r, b, a) @ tangent, tangent)

    def moved(self, point: _Point, step: Array) -> _Point:
        by_b, by_a = np.split(point.tangent @ step, [len(point.b)])
        new = point.b + by_b, point.a + by_a
        return self.at(*(normalised(*new) if self.normalise else new))


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
    """Stop where a step promises less change of the output, relative to it; of the loss in a trust region."""
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

    start: Literal["two_stage", "truth", "random"] = "two_stage"
    """Where the iterations start; at random: b_i and a_j independent, standard normal."""
    solver: Literal["gauss_newton", "subspace_trust_region"] = "gauss_newton"
    """Gauss and Newton's steps, halved until the loss falls, or the steps of a trust region in a plane."""
    stop: Stop | None = None
    """Stop by another tolerance: 1e-12 (a minimum found to 12 digits), 1e-6 in a trust region, without it."""
    unconverged: Unconverged = "fail"
    """Whether iterations that have not converged by then count as failed, or are kept as they are."""
    normalise: Flag = True
    """Keep b at length one; false leaves the common factor of b and 1/a where the iterations drift."""
    excess: Flag = False
    """Add the value excess: the loss over that of the minimum found from the two-stage estimate, less one."""

    def names(self) -> list[str]:
        return [*super().names(), "iterations", "converged", *(["excess"] if self.excess else [])]

    def draws(self) -> bool:
        return self.start == "random"

    def needs_of_truth(self) -> frozenset[str]:
        return frozenset({"nonlinearity", "linear"} if self.start == "truth" else ())

    def solved(
        self, weighted: Weighted, y: Array, record: Record, rng: np.random.Generator | None = None
    ) -> list[Estimate | EstimationError]:
        first = two_stage(weighted.regression, y)
        two_stages = [*zip(first.b, first.a, strict=True)]
        starts: Iterable[tuple[Array, Array]] = two_stages
        if self.start == "truth":
            starts = repeat(self.true_parameters(record), len(y))
        elif self.start == "random":
            starts = [self._drawn(rng) for _ in y]
        return [self._solved(weighted, *of) for of in zip(y, starts, two_stages, strict=True)]

    def _drawn(self, rng: np.random.Generator | None) -> tuple[Array, Array]:
        assert rng is not None  # as it draws
        b, a = rng.standard_normal(self.lags), rng.standard_normal(len(self.functions()))
        return normalised(b, a) if self.normalise else (b, a)

    def _solved(
        self, weighted: Weighted, y: Array, start: tuple[Array, Array], first: tuple[Array, Array]
    ) -> Estimate | EstimationError:
        """The estimate from the output ``y`` (rows,) of one trial, whose two-stage estimate is ``first``."""
        stop = {} if self.stop is None else self.stop.model_dump()
        solve = bilinear_least_squares if self.solver == "gauss_newton" else bilinear_trust_region
        try:
            found = solve(weighted.regression, y, *start, normalise=self.normalise, **stop)
            settle(found.converged, found.iterations, self.unconverged)
            others: list[float] = [found.iterations, found.converged]
            if self.excess:
                others.append(excess(weighted.regression, y, found, first))
        except EstimationError as error:
            return error
        errors = self._standard_errors(weighted, y, *normalised(found.b, found.a))
        [estimate] = self.estimates(
            weighted,
            y[None],
            (found.b[None], found.a[None]),
            (errors[0][None], errors[1][None]),
            tuple(map(float, others)),
        )
        return replace(estimate, details={"status": found.status})

    def _standard_errors(self, weighted: Weighted, y: Array, b: Array, a: Array) -> tuple[Array, Array]:
        """Those of the normalised parameters; they assume white noise unless its covariance is the weight."""
        white = weighted.white
        if self.weight == "inverse_gram" or isinstance(self.weight, InverseGram):
            # Theorems 2 and 3: the solution is the two-stage estimate without that weighting.
            return white.standard_errors(b, a, white.variance(y, white.theta(y)))
        spare = len(y) - len(b) - len(a) + 1
        std = np.sqrt(loss(white, y, b, a, white.root) / spare)
        errors = std * np.linalg.norm(covariance_root(white, b, a), axis=1)
        return errors[: len(b)], errors[len(b) :]
