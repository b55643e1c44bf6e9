"""The autoregressive block of a Hammerstein system by ordinary least squares.

The reference that the instrumental variables of Mzyk 2009 are to be compared with.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.spec import Count, component
from hident.errors import EstimationError
from hident.estimators.base import DISCRETE, AtOneInterval, require_finite
from hident.estimators.normalisation import Normalisation, first_coefficient
from hident.linear_blocks import TransferFunction
from hident.numerics.least_squares import Factorisation
from hident.numerics.parts import Parts, following, in_each, longer_than, whole
from hident.records import Estimate, Record

# A residual this small, relative to the output, is rounding.
_ROUNDING = 1e-12


def lagged(x: Array, lags: range, start: int, parts: Parts | None = None) -> Array:
    """The rows x_{k-lag} for each lag, at k = start, ..., N-1 of each experiment, then the constants.

    These are a row of ones for each experiment, zero in the others, whose levels may be others. ``x`` has
    shape (N,), the result (len(lags) + 1, N - start) for one experiment.

    Raises
    ------
    EstimationError
        If no experiment holds more than ``start`` samples.
    """

    def rows_of(x: Array) -> Array:
        n = len(x) - start
        rows = np.ones((len(lags) + 1, n))
        for row, lag in zip(rows, lags, strict=False):
            row[:] = x[start - lag : start - lag + n]
        return rows

    if not (long := longer_than(parts or whole(len(x)), start)):
        raise EstimationError(
            f"no experiment holds more than {start} samples, and so far back the order looks"
        )
    rows = in_each(long, rows_of, x, axis=1)
    if len(long) == 1:
        return rows
    own = np.zeros((len(long), rows.shape[1]))
    for row, part in zip(own, following(long, start), strict=True):
        row[part] = 1.0
    return np.vstack([rows[:-1], own])


def dynamics(a: Array, b: Array, c: float) -> Estimate:
    """The estimate of a block with numerator ``b`` (b_0 = 1, b_1, ...) and feedback ``a`` (a_1, ..., a_p)."""
    linear = TransferFunction(b=tuple(b.tolist()), a=tuple(a.tolist()))
    values = {name: value for name, value in linear.values().items() if name != "b_0"}
    return Estimate(linear=linear, values={**values, "c": c})


class DynamicsSpec(AtOneInterval):
    """Base of the estimators of a linear block by equations with its past outputs.

    They refuse an input that follows from its own past as the output does.
    """

    identifies_dynamics: ClassVar[bool] = True
    holds = ("linear",)

    order: Annotated[Count, Field(ge=1)]
    """Order p of the autoregression."""

    def letters(self) -> Mapping[str, str]:
        return DISCRETE

    def normalisations(self) -> tuple[Normalisation, ...]:
        return (first_coefficient(),)

    def numerator_order(self) -> int:
        """The order q of the numerator."""
        return 0

    def names(self) -> list[str]:
        zero = np.zeros(self.order)
        return [*dynamics(zero, np.ones(1 + self.numerator_order()), 0.0).values]

    def fewest_samples(self) -> int:
        # One equation more than unknowns: else any input would seem to follow from its past.
        return 2 * self.order + self.numerator_order() + 2

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        self.require_experiments(record)
        require_finite(record.y)
        require_irregular(record.u, self.order, record.experiments)
        return self.identify(record)

    def identify(self, record: Record) -> Estimate:
        """The estimate from a record that suits."""
        raise NotImplementedError


def require_irregular(u: Array, p: int, parts: Parts | None = None) -> None:
    """Raise EstimationError if the input ``u`` (N,) follows from its last ``p`` values, as periodic ones do.

    The output then follows from its own past in the same way, whatever the feedback of the block.
    """
    rows = lagged(u, range(p + 1), p, parts)
    now, past = rows[0], rows[1:]
    left = now - past.T @ np.linalg.lstsq(past.T, now, rcond=None)[0]
    if np.linalg.norm(left) <= _ROUNDING * np.linalg.norm(now):
        raise EstimationError(
            f"the input follows from its last {p} value{'s' if p > 1 else ''}, so that the feedback of the "
            "block cannot be told from the input's own: use an input that varies irregularly from sample to "
            "sample, or a longer record"
        )


def least_squares(y: Array, p: int, parts: Parts | None = None) -> Estimate:
    """Fit y_k = a_1 y_{k-1} + ... + a_p y_{k-p} + c by least squares, with a constant for each experiment.

    Parameters
    ----------
    y : array, shape (N,)
        The output; the N - p equations k = p, ..., N-1 of each experiment are used.
    p : int
        Order of the autoregression, at least 1.
    parts : sequence of slices, optional
        Where the experiments stand; one by default.

    Returns
    -------
    Estimate
        The linear block with b = (1,), the values ``a_1``, ..., ``a_p`` and ``c``, the mean of the
        constants over the samples.

    Raises
    ------
    EstimationError
        If the past outputs are linearly dependent.

    Notes
    -----
    Biased, and not consistent, when the output is measured with noise: the noise of the past outputs is
    correlated with d_k in Mzyk 2009, eq. (10). The bias is small when the noise is.
    """
    require_finite(y)
    # Mzyk 2009, eq. (9), (11)
    rows = lagged(y, range(p + 1), p, parts)
    now, phi = rows[0], rows[1:]
    regression = Factorisation.of(phi.T)
    if phi.shape[1] < len(phi) or regression.is_dependent:
        raise EstimationError(
            "the past outputs are linearly dependent: the output hardly varies, the record is too short, "
            f"or the order {p} is too high"
        )
    theta = regression.solution(now)
    return dynamics(theta[:p], np.ones(1), float(theta[p:] @ phi[p:].mean(axis=1)))


@component("estimator", "least_squares")
class LeastSquares(DynamicsSpec):
    """Autoregressive block by least squares; consistent only without output noise, good when it is small.

        y_k = a_1 y_{k-1} + ... + a_p y_{k-p} + c + e_k,    sum_k e_k^2 least

    The first ``order`` samples of each experiment serve as past outputs only.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Ar(a=[0.5]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> round(hi.fit(hi.LeastSquares(order=1), record).values["a_1"], 1)
    0.5
    """

    def identify(self, record: Record) -> Estimate:
        return least_squares(record.y, self.order, record.experiments)
