"""Kernel regression of Mzyk 2009, (4) and (15)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, assert_never

import numpy as np
from pydantic import Field, field_validator

from hident.arrays import Array, Index
from hident.config.spec import Real, Spec, component
from hident.config.suggest import did_you_mean, one_of
from hident.errors import EstimationError
from hident.estimators.base import require_finite
from hident.estimators.nonparametric.bandwidths import RULES, KernelConstants
from hident.estimators.nonparametric.kernel_sums import (
    GaussianSums,
    PiecewiseKernel,
    PiecewiseSums,
    PrefixSums,
    Window,
    WindowSums,
)
from hident.estimators.nonparametric.prefilter import NonparametricSpec, Regression
from hident.numerics.choices import sorting
from hident.records import Record

KernelName = Literal["window_half", "window_unit", "triangular", "epanechnikov", "gaussian"]
Empty = Literal["nearest", "zero", "mean", "fail"]

_COMPACT: dict[str, Window | PiecewiseKernel] = {
    "window_half": Window(0.5, closed=True),
    "window_unit": Window(1.0, closed=False),
    "triangular": PiecewiseKernel((-1.0, 0.0, 1.0), ((1.0, 1.0), (1.0, -1.0))),
    "epanechnikov": PiecewiseKernel((-1.0, 1.0), ((0.75, 0.0, -0.75),)),
}
# Of the kernels over their integrals.
_CONSTANTS: dict[str, KernelConstants] = {
    "window_half": KernelConstants(1.0, 1.0 / 12.0),
    "window_unit": KernelConstants(1.0 / 2.0, 1.0 / 3.0),
    "triangular": KernelConstants(2.0 / 3.0, 1.0 / 6.0),
    "epanechnikov": KernelConstants(3.0 / 5.0, 1.0 / 5.0),
    "gaussian": KernelConstants(0.5 / math.sqrt(math.pi), 1.0),
}
_BLOCK = 2**15
# Where the other samples weigh less than this part of the own one, taking it off the sum would cost digits.
_FEW = 0.01


class KernelRegression:
    """The kernel estimate of the regression R, callable on points of shape (M,).

    The samples are sorted once, and shared by all evaluations.

    Parameters
    ----------
    u, y : arrays, shape (N,)
        Input and output, or filtered output.
    kernel : str
        With x = (u_k - u)/h: ``window_half``: 1 for abs(x) <= 0.5; ``window_unit``: 1 for abs(x) < 1;
        ``triangular``: 1 - abs(x) and ``epanechnikov``: 0.75 (1 - x^2), both for abs(x) <= 1; ``gaussian``:
        exp(-x^2/2)/sqrt(2 pi), at points within 8.5 bandwidths of a sample.
    bandwidth : float
        h > 0, in the unit of u.
    empty : str
        What a point without a sample gets: ``nearest`` y of the nearest sample (the mean over all samples
        that tie), ``zero``, ``mean`` of all y, or ``fail``.
    order : integer array, shape (N,), optional
        The order that sorts u, if known.

    Raises
    ------
    EstimationError
        If y is not finite; when called with ``empty="fail"``, if a point has no sample.

    Notes
    -----
    Mzyk 2009, eq. (4), and (15) for a filtered output; without the subtraction of R(0). The paper doesn't
    say what a point without a sample gets. Takes O((N + M) log N). The error against the direct sum, in
    units of max|y|, is below 1e-12, and below 1e-11 for the compact kernels where a window holds a sample or
    two of N = 1e5.
    """

    def __init__(
        self,
        u: Array,
        y: Array,
        *,
        kernel: KernelName,
        bandwidth: float,
        empty: Empty = "nearest",
        order: Index | None = None,
    ) -> None:
        require_finite(y)
        if order is None:
            order = sorting(u)
        self._order = order
        self._u, self._y = u[order], y[order]
        self._y_sums = PrefixSums(self._y)
        self.bandwidth = bandwidth
        self._empty = empty
        self._sums = self._kernel_sums(self._y, kernel)

    def _kernel_sums(self, y: Array, kernel: KernelName) -> GaussianSums | PiecewiseSums | WindowSums:
        if kernel == "gaussian":
            return GaussianSums(self._u, y, self.bandwidth)
        compact = _COMPACT[kernel]
        if isinstance(compact, Window):
            return WindowSums(self._u, self._y_sums, compact, self.bandwidth)
        return PiecewiseSums(self._u, y, self._y_sums, compact, self.bandwidth)

    def __call__(self, points: Array) -> Array:
        if np.all(points[:-1] <= points[1:]):
            return self._at_increasing(points)
        order = np.argsort(points)
        values = np.empty(len(points))
        values[order] = self._at_increasing(points[order])
        return values

    def _at_increasing(self, points: Array) -> Array:
        values = np.empty(len(points))
        # In blocks, whose samples stay in the cache.
        for first in range(0, len(points), _BLOCK):
            block = slice(first, first + _BLOCK)
            weighted, weight = self._sums(points[block])
            # Eq. (4), (15)
            values[block] = weighted / np.where(weight > 0.0, weight, np.nan)
        vacant = np.flatnonzero(np.isnan(values))
        if len(vacant):
            nobody = np.full(len(vacant), len(self._u) + 1)
            values[vacant] = self._without_samples(points[vacant], nobody, len(points))
        return values

    def left_out(self, samples: Index, points: Array) -> Array:
        """The estimates at ``points`` (M,), the m-th from all samples but ``samples[m]``.

        The bandwidth stays. The points must not decrease.

        Raises
        ------
        EstimationError
            With ``empty="fail"``, if a point has no other sample.
        """
        own = np.argsort(self._order)[samples]
        values = np.empty(len(points))
        for first in range(0, len(points), _BLOCK):
            block = slice(first, first + _BLOCK)
            values[block] = self._block_left_out(own[block], points[block])
        vacant = np.flatnonzero(np.isnan(values))
        if len(vacant):
            values[vacant] = self._without_samples(points[vacant], own[vacant], len(points))
        return values

    def _block_left_out(self, own: Index, points: Array) -> Array:
        """The estimates without the samples at the places ``own``, nan where no other one is in reach."""
        weighted, weight = self._sums(points)
        term = self._sums.weights(self._u[own], points)
        weighted -= term * self._y[own]
        weight -= term
        start = np.searchsorted(self._u, points - self._sums.reach)
        stop = np.searchsorted(self._u, points + self._sums.reach, "right")
        alone = stop - start == ((start <= own) & (own < stop))
        weight[alone] = 0.0
        for i in np.flatnonzero(~alone & (weight < _FEW * term)):
            weighted[i], weight[i] = self._others(float(points[i]), int(own[i]))
        return np.asarray(weighted / np.where(weight > 0.0, weight, np.nan))

    def _others(self, point: float, own: int) -> tuple[float, float]:
        """The sums at a point, directly, over all samples but one."""
        # Beyond twice the reach a Gaussian is nothing beside what it is within.
        start, stop = np.searchsorted(self._u, [point - 2 * self._sums.reach, point + 2 * self._sums.reach])
        near = np.arange(start, stop)
        near = near[near != own]
        weights = self._sums.weights(self._u[near], np.full(len(near), point))
        return float(weights @ self._y[near]), float(weights.sum())

    def _without_samples(self, points: Array, own: Index, total: int) -> Array | float:
        """What points with an empty window get; ``own`` is the sample that each is to do without."""
        match self._empty:
            case "nearest":
                return self._nearest(points, own)
            case "zero":
                return 0.0
            case "mean":
                return self._mean_without(np.zeros_like(own), np.full_like(own, len(self._u)), own)
            case "fail":
                raise EstimationError(
                    f"{len(points)} of {total} points have no sample within the kernel's window "
                    f"(bandwidth {self.bandwidth:.4g})"
                )
        assert_never(self._empty)

    def _nearest(self, points: Array, own: Index) -> Array:
        """The mean of y over all samples at the least distance, on both sides if they tie."""
        right = np.searchsorted(self._u, points)
        left = right - 1
        left -= left == own
        right += right == own
        below, above = self._u[np.maximum(left, 0)], self._u[np.minimum(right, len(self._u) - 1)]
        left_distance = np.where(left >= 0, points - below, np.inf)
        right_distance = np.where(right < len(self._u), above - points, np.inf)
        start = np.where(left_distance <= right_distance, np.searchsorted(self._u, below), right)
        stop = np.where(right_distance <= left_distance, np.searchsorted(self._u, above, "right"), right)
        return self._mean_without(start, stop, own)

    def _mean_without(self, start: Index, stop: Index, own: Index) -> Array:
        """The means of y[start:stop] without the sample ``own``; nan if that leaves none."""
        inside = (start <= own) & (own < stop)
        y = np.where(inside, self._y[np.minimum(own, len(self._u) - 1)], 0.0)
        with np.errstate(invalid="ignore"):
            return np.asarray((self._y_sums.between(start, stop) - y) / (stop - start - inside))


class Bandwidth(Spec):
    """h_N = h0 N^-alpha, where N is the number of samples used."""

    h0: Annotated[Real, Field(gt=0)]
    """Factor, in the unit of the input."""
    alpha: Annotated[Real, Field(ge=0, lt=1)]
    """Exponent of the number of samples; 0 keeps the bandwidth fixed."""

    def width(self, n: int) -> float:
        """h_N for ``n`` samples."""
        return self.h0 * math.pow(n, -self.alpha)


@component("estimator", "kernel", source="Mzyk 2009, eq. (4), (15)")
class Kernel(NonparametricSpec):
    """Characteristic by kernel regression, plain or with prefilter.

        R(u) = sum_k y_k K((u_k - u)/h) / sum_k K((u_k - u)/h)

    With a prefilter the filtered output, of which the linear block is undone, stands in the place of y_k.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Ar(a=[0.5]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> known = hi.KnownDynamics(a=[0.5])
    >>> kernel = hi.Kernel(kernel="gaussian", bandwidth={"h0": 0.5, "alpha": "1/5"}, prefilter=known)
    >>> hi.fit(kernel, record).nonlinearity(np.array([-0.5, 0.5])).round(1)
    array([0.5, 0.5])
    >>> later = hi.Hammerstein(nonlinearity="abs", linear=hi.Fir(b=[0, 0, 1]))
    >>> delayed = hi.simulate(later, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> searched = hi.Kernel(kernel="gaussian", bandwidth={"h0": 0.5, "alpha": "1/5"}, delay="search")
    >>> hi.fit(searched, delayed).values
    {'delay': 2.0}
    """

    kernel: KernelName
    """The kernel: window_half is 1 for |x| <= 0.5, window_unit for |x| < 1, with x = (u_k - u)/h."""
    bandwidth: Bandwidth | Literal["rule_of_thumb", "plug_in"]
    """The bandwidth, or a rule by which it follows from the data; the estimate then has the value bandwidth.

    rule_of_thumb: of Fan and Gijbels (1996, section 4.2), by one polynomial of degree four; plug_in: of
    Ruppert, Sheather and Wand (1995). Both are those of a local linear estimate, and take the kernel's own
    constants. The optimum of this local constant one is the same where the input's density has no slope.
    """
    empty: Empty = "nearest"
    """What a point without a sample in its window gets; fail: the estimate fails."""

    @field_validator("bandwidth", mode="before")
    @classmethod
    def _width_or_rule(cls, value: Any) -> Any:
        if isinstance(value, Mapping):
            return Bandwidth.model_validate(value)
        if isinstance(value, Bandwidth) or (isinstance(value, str) and value in RULES):
            return value
        near = did_you_mean(value, RULES) if isinstance(value, str) else ""
        raise ValueError(f"must be a mapping with 'h0' and 'alpha', or a rule: {one_of(RULES)}{near}")

    def names(self) -> Sequence[str]:
        return [*super().names(), *(["bandwidth"] if isinstance(self.bandwidth, str) else [])]

    def values_of(self, regression: Regression) -> dict[str, float]:
        assert isinstance(regression, KernelRegression)
        return {"bandwidth": regression.bandwidth} if isinstance(self.bandwidth, str) else {}

    def _width(self, samples: Record) -> float:
        if not isinstance(self.bandwidth, str):
            return self.bandwidth.width(len(samples))
        require_finite(samples.y)
        u, y = samples.u[samples.order], samples.y[samples.order]
        return RULES[self.bandwidth](u, y, _CONSTANTS[self.kernel])

    def regression(self, samples: Record) -> KernelRegression:
        return KernelRegression(
            samples.u,
            samples.y,
            kernel=self.kernel,
            bandwidth=self._width(samples),
            empty=self.empty,
            order=samples.order,
        )
