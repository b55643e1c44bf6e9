"""A static nonlinearity from the levels at which the output settles under a staircase."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hident.arrays import Array, Index
from hident.errors import EstimationError

# A time this close below a switching instant, relative to the time, is at it.
_AT_THE_SWITCH = 1e-12
_FEWEST = 8


@dataclass(frozen=True, eq=False)
class Levels:
    """The averaged outputs ``values`` (n,) with standard errors ``errors`` (n,).

    ``noise`` is the standard deviation of the noise, from the second half of each level. ``drift`` (n,) is
    the change of the output between the third and the last quarter of each level, ``drift_error`` (n,) its
    standard error.
    """

    values: Array
    errors: Array
    noise: float
    drift: Array
    drift_error: Array

    def unsettled(self, threshold: float, tolerance: float) -> Index:
        """The levels whose drift is beyond ``threshold`` standard errors and ``tolerance`` of the range."""
        limit = np.maximum(threshold * self.drift_error, tolerance * np.ptp(self.values))
        return np.flatnonzero(np.abs(self.drift) > limit)


@dataclass(frozen=True, eq=False)
class PolynomialFit:
    """Coefficients c_0, ..., c_d and their ``covariance`` (d + 1, d + 1)."""

    coefficients: Array
    covariance: Array

    @property
    def errors(self) -> Array:
        """The standard errors of the coefficients."""
        return np.sqrt(np.diag(self.covariance))


def level_bounds(times: Array, n: int, dt: float) -> Index:
    """The first samples of levels that begin at ``times`` (L,), and the end ``n``, shape (L + 1,)."""
    first = np.ceil(times / dt * (1.0 - _AT_THE_SWITCH)).astype(np.intp)
    return np.append(first, n)


def settled_levels(y: Array, bounds: Index, discard: float = 0.5) -> Levels:
    """The mean output of each level of a staircase.

    Parameters
    ----------
    y : array, shape (N,)
        The output.
    bounds : array of int, shape (L + 1,)
        The first samples of the L levels, and the end of the last.
    discard : float
        The part of each level that is left out as transient, 0 to below 1.

    Raises
    ------
    EstimationError
        If a level has fewer than 8 samples.

    Notes
    -----
    Brouri, Table I, eq. (10). Differs from the paper: averaged over the whole level, as printed
    (``discard=0``), the transient is a bias of the order 1/N; by default its first half is left out.
    """
    lengths = np.diff(bounds)
    if np.min(lengths) < _FEWEST:
        j = int(np.argmin(lengths))
        raise EstimationError(
            f"level {j + 1} of {len(lengths)} has {max(lengths[j], 0)} samples: at least {_FEWEST} are needed"
        )
    ends = bounds[1:]
    begin, half, last = ((bounds[:-1] + part * lengths).astype(np.intp) for part in (discard, 0.5, 0.75))
    third, fourth = _means(y, half, last), _means(y, last, ends)
    squares = _squares(y, half, last, third) + _squares(y, last, ends, fourth)
    noise = math.sqrt(squares / float(np.sum(ends - half) - 2 * len(ends)))
    return Levels(
        _means(y, begin, ends),
        noise / np.sqrt(ends - begin),
        noise,
        fourth - third,
        noise * np.sqrt(1.0 / (last - half) + 1.0 / (ends - last)),
    )


def _means(y: Array, starts: Index, ends: Index) -> Array:
    return np.array([np.mean(y[a:b]) for a, b in zip(starts, ends, strict=True)])


def _squares(y: Array, starts: Index, ends: Index, means: Array) -> float:
    return sum(float(np.sum((y[a:b] - mean) ** 2)) for a, b, mean in zip(starts, ends, means, strict=True))


def rise_time(y: Array, dt: float, before: float, after: float, fraction: float = 0.9) -> float:
    """The time in which a step response first covers ``fraction`` of the way from ``before`` to ``after``.

    Parameters
    ----------
    y : array, shape (N,)
        The output from the step on; noise is smoothed by a moving mean over a hundredth of it.
    dt : float
        Sampling interval.
    before, after : float
        The settled outputs before and after the step.

    Raises
    ------
    EstimationError
        If the two are equal, or the response never gets there.

    Notes
    -----
    Brouri, after eq. (6).
    """
    if before == after:
        raise EstimationError("a step between equal outputs has no rise time: the static gain is zero")
    width = max(len(y) // 100, 1)
    sums = np.cumsum(np.concatenate(([0.0], y - before)))
    way = (sums[width:] - sums[:-width]) / (width * (after - before))
    beyond = np.flatnonzero(way >= fraction)
    if len(beyond) == 0:
        raise EstimationError(f"the step response does not reach {fraction:.0%} of its final value")
    first = int(beyond[0])
    part = 1.0 if first == 0 else (fraction - way[first - 1]) / (way[first] - way[first - 1])
    return float(dt * max(first - 1 + part + 0.5 * (width - 1), 0.0))


def fit_polynomial(x: Array, values: Array, errors: Array, degree: int) -> PolynomialFit:
    """The polynomial of ``degree`` through the points (V_j, W_j), by weighted least squares.

    ``x``, ``values`` and ``errors`` (n,) hold V_j, W_j and the standard errors of W_j. The covariance is that
    of the averaged noise, so that as many points as coefficients have standard errors too.

    Raises
    ------
    EstimationError
        If there are fewer distinct levels than coefficients.
    """
    distinct = len(np.unique(x))
    if distinct <= degree:
        raise EstimationError(
            f"{distinct} distinct levels do not determine the {degree + 1} coefficients of degree {degree}"
        )
    scale = float(np.max(np.abs(x))) or 1.0
    weights = _relative(errors)
    basis = np.vander(x / scale, degree + 1, increasing=True) / weights[:, None]
    q, r = np.linalg.qr(basis)
    root = np.linalg.inv(r) / scale ** np.arange(degree + 1)[:, None]
    size = errors[0] / weights[0]
    return PolynomialFit(root @ (q.T @ (values / weights)), size**2 * root @ root.T)


def _relative(errors: Array) -> Array:
    """The errors relative to the largest: weights that exist without noise too."""
    largest = float(np.max(errors))
    return errors / largest if largest > 0.0 else np.ones_like(errors)
