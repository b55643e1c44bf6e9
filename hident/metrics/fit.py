"""How far the model's output is from the measured one, as the nonlinear benchmarks measure it.

The names and definitions are those of the Python package nonlinear_benchmarks (error_metrics.py), for y the
measured output and y_hat the model's:

    RMSE = sqrt(mean((y - y_hat)^2))        NRMSE = RMSE / std(y)        fit_index = 100 (1 - NRMSE)
    MAE = mean(|y - y_hat|)                 R_squared = 1 - NRMSE^2

Means and the standard deviation run over all samples of all experiments that are not left out, together.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hident.arrays import Array
from hident.config.spec import component
from hident.errors import EstimationError
from hident.metrics.base import Best
from hident.metrics.outputs import OutputMetric
from hident.numerics.rounding import is_constant
from hident.records import Estimate, Record

_SOURCE = "nonlinear_benchmarks, error_metrics.py"


def rmse(y: Array, y_hat: Array) -> float:
    """Root mean square error of two outputs (N,), in the unit of y."""
    return float(np.sqrt(np.mean((y_hat - y) ** 2)))


def nrmse(y: Array, y_hat: Array) -> float:
    """Root mean square error of two outputs (N,), relative to the standard deviation of ``y``.

    Raises
    ------
    EstimationError
        If ``y`` does not vary.
    """
    if is_constant(y):
        raise EstimationError(f"the output is {y[0]:g} throughout: no error is relative to how it varies")
    return rmse(y, y_hat) / float(np.std(y))


class _OfError(OutputMetric):
    best: ClassVar[Best | None] = "lowest"

    def of_outputs(self, y: Array, y_hat: Array) -> float:
        """The score of two outputs (N,)."""
        raise NotImplementedError

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        held = self.compared(estimate, record)
        return (self.of_outputs(held.y, held.y_hat),)


@component("metric", "rmse", source=_SOURCE)
class Rmse(_OfError):
    """Root mean square error of the model's output (RMSE), in the unit of the output.

    Examples
    --------
    >>> import hident as hi
    >>> record = hi.Record([1.0, 2.0, 3.0, 4.0], [1.1, 1.9, 3.1, 3.9])
    >>> estimate = hi.Estimate(response=lambda u, dt: u)
    >>> round(hi.score(estimate, record, error=hi.Rmse())["error"], 3)
    0.1
    """

    def of_outputs(self, y: Array, y_hat: Array) -> float:
        return rmse(y, y_hat)


@component("metric", "nrmse", source=_SOURCE)
class Nrmse(_OfError):
    """Root mean square error of the model's output over the output's standard deviation (NRMSE).

    Examples
    --------
    >>> import hident as hi
    >>> record = hi.Record([1.0, 2.0, 3.0, 4.0], [1.1, 1.9, 3.1, 3.9])
    >>> estimate = hi.Estimate(response=lambda u, dt: u)
    >>> round(hi.score(estimate, record, error=hi.Nrmse())["error"], 3)
    0.093
    """

    def of_outputs(self, y: Array, y_hat: Array) -> float:
        return nrmse(y, y_hat)


@component("metric", "r_squared", source=_SOURCE)
class RSquared(_OfError):
    """Coefficient of determination of the model's output, 1 - NRMSE^2 (R_squared).

    Examples
    --------
    >>> import hident as hi
    >>> record = hi.Record([1.0, 2.0, 3.0, 4.0], [1.1, 1.9, 3.1, 3.9])
    >>> estimate = hi.Estimate(response=lambda u, dt: u)
    >>> round(hi.score(estimate, record, determined=hi.RSquared())["determined"], 4)
    0.9914
    """

    best: ClassVar[Best | None] = "highest"

    def of_outputs(self, y: Array, y_hat: Array) -> float:
        return 1.0 - nrmse(y, y_hat) ** 2


@component("metric", "mae", source=_SOURCE)
class Mae(_OfError):
    """Mean absolute error of the model's output (MAE), in the unit of the output.

    Examples
    --------
    >>> import hident as hi
    >>> record = hi.Record([1.0, 2.0, 3.0, 4.0], [1.1, 1.9, 3.1, 4.1])
    >>> estimate = hi.Estimate(response=lambda u, dt: u)
    >>> round(hi.score(estimate, record, error=hi.Mae(n_init=1))["error"], 3)
    0.1
    """

    def of_outputs(self, y: Array, y_hat: Array) -> float:
        return float(np.mean(np.abs(y - y_hat)))


@component("metric", "fit_index", source=_SOURCE)
class FitIndex(_OfError):
    """Fit of the model's output in percent, 100 (1 - NRMSE) (fit_index; MATLAB's compare).

    Examples
    --------
    >>> import hident as hi
    >>> record = hi.Record([1.0, 2.0, 3.0, 4.0], [1.1, 1.9, 3.1, 3.9])
    >>> estimate = hi.Estimate(response=lambda u, dt: u)
    >>> round(hi.score(estimate, record, fit=hi.FitIndex())["fit"], 1)
    90.7
    """

    best: ClassVar[Best | None] = "highest"

    def of_outputs(self, y: Array, y_hat: Array) -> float:
        return 100.0 * (1.0 - nrmse(y, y_hat))
