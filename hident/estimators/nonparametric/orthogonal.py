"""Orthogonal series estimates of Mzyk 2009, (7) and (16).

=====  ====================================================================
g      R f, the regression times the input's density; alpha its coefficients
f      the input's density; beta its coefficients
q      cutoff level of the series
=====  ====================================================================
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from hident.arrays import Array, Index
from hident.config.spec import Of, Real, Spec, component
from hident.errors import EstimationError
from hident.estimators.base import require_finite
from hident.estimators.nonparametric.bases import BasisSpec
from hident.estimators.nonparametric.prefilter import NonparametricSpec
from hident.numerics.whole import whole_part
from hident.records import Record

Density = Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class OrthogonalSeries:
    """A fitted ratio of series, callable on arrays of shape (M,).

    ``u`` and ``y`` (N,) are the samples and ``q`` the cutoff level; ``coefficients`` holds the rows alpha
    and, unless the ``density`` is known, beta.

    Raises
    ------
    EstimationError
        When called at points outside the basis's domain, where the series says nothing.
    """

    basis: BasisSpec
    q: int
    u: Array
    y: Array
    coefficients: Array
    density: Density | None = None

    def __call__(self, points: Array) -> Array:
        return self._ratio(self._series(points), points)

    def left_out(self, samples: Index, points: Array) -> Array:
        """The estimates at ``points`` (M,), the m-th from all samples but ``samples[m]``.

        The cutoff level stays. The samples must lie in the basis's domain.
        """
        n = len(self.u)
        products = self.basis.products(self.u[samples], points, self.q)
        own = _weights(self.y[samples], self.density) * products / n
        return self._ratio((self._series(points) - own) * (n / (n - 1)), points)

    def _series(self, points: Array) -> Array:
        low, high = self.basis.domain()
        outside = len(points) - np.count_nonzero((points >= low) & (points <= high))
        if outside:
            raise EstimationError(
                f"{outside} of {len(points)} points lie outside the domain [{low:g}, {high:g}] of the "
                f"{self.basis.kind} basis"
            )
        return self.basis.series(points, self.coefficients)

    def _ratio(self, series: Array, points: Array) -> Array:
        denominator = series[1] if self.density is None else self.density(points)
        # An estimated density can vanish, and a known one is zero outside its support.
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return np.asarray(series[0] / denominator)


def fit_orthogonal_series(
    u: Array, y: Array, basis: BasisSpec, q: int, density: Density | None = None
) -> OrthogonalSeries:
    """The orthogonal series estimate of the regression R.

    Parameters
    ----------
    u, y : arrays, shape (N,)
        Input and output, or filtered output.
    basis : BasisSpec
        The orthonormal functions.
    q : int
        Cutoff level; the trigonometric basis has 2q + 1 functions up to it, the others q + 1.
    density : callable, optional
        The input's density f, if known; it then replaces its estimate in the denominator.

    Raises
    ------
    EstimationError
        If y is not finite.

    Notes
    -----
    Mzyk 2009, eq. (7), and (16) for a filtered output; without the subtraction of R(0). Samples outside
    the domain belong to no function of the basis: they are left out of the sums but counted in 1/N.
    """
    require_finite(y)
    low, high = basis.domain()
    inside = (u >= low) & (u <= high)
    # Mzyk 2009, section III-B: alpha_i = 1/N sum y_k phi_i(u_k), beta_i = 1/N sum phi_i(u_k)
    sums = basis.sums(u[inside], _weights(y[inside], density), q)
    return OrthogonalSeries(basis, q, u, y, sums / len(u), density)


def _weights(y: Array, density: Density | None) -> Array:
    """What multiplies phi_i(u_k) in the sums: y_k, and 1 where the density is estimated."""
    return y[None] if density is not None else np.stack([y, np.ones_like(y)])


class Terms(Spec):
    """q(N) = floor(q0 N^alpha), where N is the number of samples used."""

    q0: Annotated[Real, Field(gt=0)]
    """Factor."""
    alpha: Annotated[Real, Field(ge=0, lt=1)]
    """Exponent of the number of samples; 0 keeps the level fixed."""

    def level(self, n: int) -> int:
        """q(N) for ``n`` samples."""
        # An exact power such as 243^(1/5) = 3 must not round down for its last bit.
        return int(whole_part(self.q0 * math.pow(n, self.alpha)))


class UniformDensity(Spec):
    """The uniform density on [low, high]."""

    distribution: Literal["uniform"]
    """The distribution's name."""
    low: Real
    """Lower end."""
    high: Real
    """Upper end."""

    @model_validator(mode="after")
    def _increasing(self) -> Self:
        if not self.low < self.high:
            raise ValueError("'low' must be less than 'high'")
        return self

    def __call__(self, x: Array) -> Array:
        return np.where((x >= self.low) & (x <= self.high), 1.0 / (self.high - self.low), 0.0)


class GaussianDensity(Spec):
    """The Gaussian density."""

    distribution: Literal["gaussian"]
    """The distribution's name."""
    mean: Real
    """Mean."""
    std: Annotated[Real, Field(gt=0)]
    """Standard deviation."""

    def __call__(self, x: Array) -> Array:
        return np.exp(-0.5 * ((x - self.mean) / self.std) ** 2) / (self.std * math.sqrt(2.0 * math.pi))


_DENSITIES: dict[str, type[UniformDensity] | type[GaussianDensity]] = {
    "uniform": UniformDensity,
    "gaussian": GaussianDensity,
}


@component("estimator", "orthogonal", source="Mzyk 2009, eq. (7), (16)")
class Orthogonal(NonparametricSpec):
    """Characteristic by a ratio of orthogonal series, plain or with prefilter.

        R(u) = sum_i alpha_i phi_i(u) / sum_i beta_i phi_i(u)

    Here alpha_i is the mean of y_k phi_i(u_k) over the samples, and beta_i that of phi_i(u_k). With a
    prefilter the filtered output, of which the linear block is undone, stands in the place of y_k.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Ar(a=[0.5]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 5000)
    >>> basis, known = hi.Trigonometric(interval=[-1, 1]), hi.KnownDynamics(a=[0.5])
    >>> series = hi.Orthogonal(basis=basis, terms={"q0": 1, "alpha": "1/5"}, prefilter=known)
    >>> hi.fit(series, record).nonlinearity(np.array([-0.5, 0.5])).round(1)
    array([0.5, 0.5])
    """

    basis: Annotated[BasisSpec, Of("basis")]
    """The orthonormal functions."""
    terms: Terms
    """The cutoff level of the series."""
    density: Literal["estimated"] | UniformDensity | GaussianDensity = "estimated"
    """The input's density: estimated by the same series, or known (distribution: uniform or gaussian)."""

    @field_validator("density", mode="before")
    @classmethod
    def _choose_density(cls, value: Any) -> Any:
        if value == "estimated" or isinstance(value, Spec):
            return value
        distribution = value.get("distribution") if isinstance(value, Mapping) else None
        if not isinstance(distribution, str) or distribution not in _DENSITIES:
            raise ValueError("must be 'estimated' or a mapping with 'distribution: uniform' or 'gaussian'")
        return _DENSITIES[distribution].model_validate(value)

    def regression(self, samples: Record) -> OrthogonalSeries:
        q = self.terms.level(len(samples))
        density = None if self.density == "estimated" else self.density
        return fit_orthogonal_series(samples.u, samples.y, self.basis, q, density)
