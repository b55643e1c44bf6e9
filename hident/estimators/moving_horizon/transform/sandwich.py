"""Standard errors of least squares over moving horizons: the sandwich formula.

The horizons overlap, so the equations' errors are correlated; but each is a known linear function of the
output's samples, whose noise is taken to be independent from sample to sample, of any variance. That the same
noise is in the regressors is left out: its bias, small for horizons of several time constants, shows as a
coverage below the nominal one when the noise is strong. What a search finds, such as partition points, counts
as given, and a static function that cannot meet the true one biases the parameters: both lower the coverage.
"""

from __future__ import annotations

import numpy as np

from hident.arrays import Array
from hident.estimators.moving_horizon.transform.time_weighted import Horizons, Knots


def influence(onto: Array, horizons: Horizons, knots: Knots, a: tuple[float, ...]) -> Array:
    """The derivative of parameters with respect to the output's samples, shape (P, samples).

    ``onto`` (P, N) maps the equations' errors to the parameters; noise on the output enters the
    equations by way of y + a_1 y^(1) + ... + a_n y^(n).
    """
    operator = horizons.sampled(knots)
    stacked = np.concatenate([weight * onto for weight in (1.0, *a)], axis=-1)
    return np.asarray((operator.T @ stacked.T).T)


def standard_errors(derivative: Array, residual: Array) -> Array:
    """The standard errors (P,) of parameters with the ``derivative`` (P, samples) by the output's samples.

    ``residual`` (samples,) is the error of the simulated output.
    """
    return np.asarray(np.linalg.norm(derivative * residual, axis=-1))
