"""The weighted nonlinear least squares problem of a Hammerstein system with bilinear parameters.

Symbols are in :mod:`hident.estimators.bilinear_models.bilinear`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from hident.arrays import Array, Flags
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
from hident.numerics.gauss_newton import Minima, gauss_newton_stack
from hident.numerics.least_squares import Factorisation
from hident.numerics.stacks import applied, dots
from hident.numerics.subspace_trust_region import Reached, subspace_trust_region
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
    """The derivatives (..., rows, n + m) of r vec(b a') by b (..., n) and a (..., m); r has (rows, n m)."""
    blocks = r.reshape(len(r), a.shape[-1], b.shape[-1])
    by_b, by_a = np.einsum("kji,...j->...ki", blocks, a), np.einsum("kji,...i->...kj", blocks, b)
    return np.concatenate([by_b, by_a], axis=-1)


def complement(vector: Array) -> Array:
    """An orthonormal basis (..., k, k - 1) of what is orthogonal to ``vector`` (..., k)."""
    return np.linalg.qr(vector[..., None], mode="complete").Q[..., 1:]


def covariance_root(regression: Regression, b: Array, a: Array) -> Array:
    """A root (..., n + m, n + m - 1) of the Cramer-Rao bound of (b, a) with b (..., n) of length one.

    The noise is Gaussian with covariance W^-1; the bound is the root times its transpose. It is also the
    asymptotic covariance of the weighted nonlinear least squares estimate.
    """
    tangent = complement(np.concatenate([b, np.zeros_like(a)], axis=-1))
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
    [found] = gauss_newton_solutions(
        regression,
        y[None],
        b[None],
        a[None],
        tolerance=tolerance,
        max_iterations=max_iterations,
        normalise=normalise,
    )
    return found


def gauss_newton_solutions(
    regression: Regression,
    y: Array,
    b: Array,
    a: Array,
    *,
    tolerance: float = 1e-12,
    max_iterations: int = 200,
    normalise: bool = True,
) -> list[Solution]:
    """:func:`bilinear_least_squares` for T outputs ``y`` (T, rows), from ``b`` (T, n) and ``a`` (T, m)."""
    problem = _Problem(regression.r, normalise, _shortest)
    start = problem.at(regression.projected(y), b, a)

    def rests(points: _Points, change: Array) -> Flags:
        model = points.z - points.residuals
        return np.asarray(change <= tolerance * np.sqrt(dots(model, model)))

    # Losses closer than this differ by rounding only.
    slack = 1e-14 * dots(start.z, start.z)
    found = gauss_newton_stack(start, problem.moved, rests, max_iterations=max_iterations, slack=slack)
    return _solutions(found)


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
    [found] = trust_region_solutions(
        regression,
        y[None],
        b[None],
        a[None],
        tolerance=tolerance,
        max_iterations=max_iterations,
        normalise=normalise,
    )
    return found


def trust_region_solutions(
    regression: Regression,
    y: Array,
    b: Array,
    a: Array,
    *,
    tolerance: float = 1e-6,
    max_iterations: int = 400,
    normalise: bool = True,
) -> list[Solution]:
    """:func:`bilinear_trust_region` for T outputs ``y`` (T, rows), from ``b`` (T, n) and ``a`` (T, m)."""
    problem = _Problem(regression.r, normalise)
    start = problem.at(regression.projected(y), b, a)
    return _solutions(
        subspace_trust_region(start, problem.moved, tolerance=tolerance, max_iterations=max_iterations)
    )


def _solutions(found: Minima[_Points] | Reached[_Points]) -> list[Solution]:
    ends = zip(found.point.b, found.point.a, found.iterations.tolist(), found.status, strict=True)
    return [Solution(*end) for end in ends]


def excess(regression: Regression, y: Array, found: Solution, least: Solution) -> float:
    """The loss of ``found`` over that of the minimum ``least``, less one.

    It is zero where the two outputs are one to 10 digits.

    Raises
    ------
    EstimationError
        If the iterations that gave ``least`` have not converged.
    """
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
    """The directions (T, n + m, n + m - 1) across the one that leaves b a' as it is: b grows, a shrinks."""
    return complement(np.concatenate([b, -a], axis=-1))


@dataclass(frozen=True, eq=False)
class _Problem:
    """The residuals z - r vec(b a'); ``free`` gives the directions where b is not held, None for all."""

    r: Array
    normalise: bool
    free: Callable[[Array, Array], Array] | None = None

    def at(self, z: Array, b: Array, a: Array) -> _Points:
        derivative, tangent = jacobian(self.r, b, a), np.empty((len(b), 0, 0))
        if self.normalise:
            # Held, b moves across assumption 1's normal.
            tangent = complement(np.concatenate([b, np.zeros_like(a)], axis=-1))
        elif self.free is not None:
            tangent = self.free(b, a)
        product = (a[:, :, None] * b[:, None, :]).reshape(len(b), -1)
        along = derivative @ tangent if tangent.size else derivative
        return _Points(z, b, a, z - applied(self.r, product), along, tangent)

    def moved(self, points: _Points, step: Array) -> _Points:
        n = points.b.shape[-1]
        change = applied(points.tangent, step) if points.tangent.size else step
        new = points.b + change[:, :n], points.a + change[:, n:]
        return self.at(points.z, *(normalised(*new) if self.normalise else new))


@dataclass(frozen=True, eq=False)
class _Points:
    """Models of T outputs; each array begins with the axis of these. No ``tangent``: all directions."""

    z: Array
    b: Array
    a: Array
    residuals: Array
    jacobian: Array
    tangent: Array

    @property
    def loss(self) -> Array:
        return dots(self.residuals, self.residuals)


class Stop(Spec):
    """When to stop short of convergence."""

    tolerance: Annotated[Real, Field(gt=0)] = 1e-6
    """Stop where a step promises less change of the output, relative to it; of the loss in a trust region."""
    max_iterations: Annotated[Count, Field(ge=1)] = 400
    """Most steps."""


@component("estimator", "bilinear_least_squares", source="Wang, Zhang, Ljung 2009, eq. (10)")
class BilinearLeastSquares(WeightedBilinearSpec):
    """Hammerstein system by weighted nonlinear least squares, from the two-stage estimate.

        (y - Phi theta)' W (y - Phi theta) least over b and a, where theta are the columns of b a'

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
        self,
        weighted: Weighted,
        y: Array,
        record: Record,
        rngs: Sequence[np.random.Generator] | None = None,
    ) -> list[Estimate | EstimationError]:
        first = two_stage(weighted.regression, y)
        b, a = first.b, first.a
        if self.start == "truth":
            true_b, true_a = self.true_parameters(record)
            b, a = np.tile(true_b, (len(y), 1)), np.tile(true_a, (len(y), 1))
        elif self.start == "random":
            assert rngs is not None  # as it draws
            b, a = map(np.stack, zip(*map(self._drawn, rngs), strict=True))
        stop = {} if self.stop is None else self.stop.model_dump()
        solve = gauss_newton_solutions if self.solver == "gauss_newton" else trust_region_solutions
        solutions = solve(weighted.regression, y, b, a, normalise=self.normalise, **stop)
        found: dict[int, Estimate | EstimationError] = {}
        for i, one in enumerate(solutions):
            try:
                settle(one.converged, one.iterations, self.unconverged)
            except EstimationError as error:
                found[i] = error
        left = [i for i in range(len(y)) if i not in found]
        others: dict[int, tuple[float, ...]] = {
            i: (float(solutions[i].iterations), float(solutions[i].converged)) for i in left
        }
        if self.excess and left:
            minima = gauss_newton_solutions(weighted.regression, y[left], first.b[left], first.a[left])
            for i, least in zip(left, minima, strict=True):
                try:
                    others[i] += (excess(weighted.regression, y[i], solutions[i], least),)
                except EstimationError as error:
                    found[i] = error
            left = [i for i in left if i not in found]
        if left:
            kept = [solutions[i] for i in left]
            b, a = np.stack([one.b for one in kept]), np.stack([one.a for one in kept])
            errors = self._standard_errors(weighted, y[left], *normalised(b, a))
            more, details = [others[i] for i in left], [{"status": one.status} for one in kept]
            estimates = self.estimates(weighted, record.dt, y[left], (b, a), errors, more, details)
            found |= dict(zip(left, estimates, strict=True))
        return [found[i] for i in range(len(y))]

    def _drawn(self, rng: np.random.Generator) -> tuple[Array, Array]:
        b, a = rng.standard_normal(self.lags), rng.standard_normal(len(self.functions()))
        return normalised(b, a) if self.normalise else (b, a)

    def _standard_errors(self, weighted: Weighted, y: Array, b: Array, a: Array) -> tuple[Array, Array]:
        """Those of the normalised parameters; they assume white noise unless its covariance is the weight."""
        white = weighted.white
        if self.weight == "inverse_gram" or isinstance(self.weight, InverseGram):
            # Theorems 2 and 3: the solution is the two-stage estimate without that weighting.
            return white.standard_errors(b, a, white.variance(y, white.theta(y)))
        n, spare = b.shape[-1], y.shape[-1] - b.shape[-1] - a.shape[-1] + 1 - self.constant
        std = np.sqrt(loss(white, y, b, a, white.root) / spare)[:, None]
        errors = std * np.linalg.norm(covariance_root(white, b, a), axis=-1)
        return errors[:, :n], errors[:, n:]
