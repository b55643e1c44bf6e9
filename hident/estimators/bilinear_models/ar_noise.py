"""Autoregressive models of residuals, and the exact whitening that they give.

=========  ========================================================================
v          residuals, taken as v(t) = a_1 v(t-1) + ... + a_p v(t-p) + e(t)
V_p        variance of e that the model of order p leaves; V_0 that of v
N          number of residuals
=========  ========================================================================
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from hident.config.spec import Count, Real, Spec
from hident.errors import EstimationError
from hident.records import Array


@dataclass(frozen=True, eq=False)
class ArModel:
    """An autoregression with coefficients ``a`` (p,) and the ``variance`` of its innovation e."""

    a: Array
    variance: float = 1.0

    def whiten(self, rows: Array) -> Array:
        """Multiply ``rows`` (N,) or (N, K) by a root F of the inverse covariance: F'F = variance R^-1.

        R is the covariance of N stationary samples; it is never formed. N must be at least p.

        Raises
        ------
        EstimationError
            If the model is not stationary.
        """
        p = len(self.a)
        whitened = rows.astype(float)
        for k, a in enumerate(self.a, start=1):
            whitened[p:] -= a * rows[p - k : len(rows) - k]
        whitened[:p] = self._root_of_start @ rows[:p]
        return whitened

    @property
    def _root_of_start(self) -> Array:
        """A root of the inverse covariance (p, p) of the first p samples, for an innovation of variance 1."""
        p = len(self.a)
        coefficients = np.concatenate(([1.0], -self.a))
        lags = np.subtract.outer(np.arange(p), np.arange(p))
        # Gohberg and Semencul's formula for the inverse of a Toeplitz matrix; it is positive definite if
        # and only if the model is stationary.
        ahead = np.tril(coefficients[np.abs(lags)])
        behind = np.tril(coefficients[p - np.abs(lags)])
        try:
            return np.asarray(np.linalg.cholesky(ahead @ ahead.T - behind @ behind.T).T)
        except np.linalg.LinAlgError:
            raise EstimationError(
                "the noise model is not stationary: its coefficients "
                f"{', '.join(f'{a:.4g}' for a in self.a)} have a pole on or outside the unit circle"
            ) from None


def burg(v: Array, highest: int) -> list[ArModel]:
    """The models of orders 0, ..., ``highest`` of ``v`` (N,) by Burg's recursion; always stationary."""
    forward, backward = v[1:], v[:-1]
    models = [ArModel(np.empty(0), float(np.mean(v**2)))]
    for _ in range(highest):
        power = float(forward @ forward + backward @ backward)
        reflection = 2.0 * float(forward @ backward) / power if power > 0.0 else 0.0
        models.append(_higher(models[-1], reflection))
        forward, backward = (forward - reflection * backward)[1:], (backward - reflection * forward)[:-1]
    return models


def yule_walker(v: Array, highest: int) -> list[ArModel]:
    """The models of orders 0, ..., ``highest`` of ``v`` (N,) from its autocovariances; always stationary."""
    n = len(v)
    covariance = np.array([v[: n - k] @ v[k:] for k in range(highest + 1)]) / n
    models = [ArModel(np.empty(0), float(covariance[0]))]
    for p in range(highest):
        model = models[-1]
        ahead = covariance[p + 1] - model.a @ covariance[p:0:-1]
        models.append(_higher(model, ahead / model.variance if model.variance > 0.0 else 0.0))
    return models


def _higher(model: ArModel, reflection: float) -> ArModel:
    """The model of the next order (Levinson's recursion)."""
    a = np.append(model.a - reflection * model.a[::-1], reflection)
    return ArModel(a, float(model.variance * (1.0 - reflection**2)))


def least_squares(v: Array, highest: int) -> list[ArModel]:
    """The models of orders 0, ..., ``highest`` of ``v`` (N,) by least squares; may be unstable.

    The coefficients of order p are fitted on all t > p, but the variances on t > ``highest``: fits to
    different samples cannot be compared.
    """
    return [ArModel(_regressed(v, p, p)[0], _regressed(v, p, highest)[1]) for p in range(highest + 1)]


def _regressed(v: Array, p: int, first: int) -> tuple[Array, float]:
    """Coefficients (p,) and the mean squared error of the autoregression on t > ``first``."""
    rows = np.stack([v[first - k : len(v) - k] for k in range(p + 1)])
    a = np.linalg.lstsq(rows[1:].T, rows[0], rcond=None)[0]
    return a, float(np.mean((rows[0] - a @ rows[1:]) ** 2))


METHODS: dict[str, Callable[[Array, int], list[ArModel]]] = {
    "burg": burg,
    "yule_walker": yule_walker,
    "least_squares": least_squares,
}


def f_test(variances: Array, freedom: int, confidence: float = 0.95) -> int:
    """The lowest order that the next one does not improve significantly; the highest if all steps do.

    ``variances`` are V_0, ..., V_P. The step from p to p + 1 is judged by f (V_p - V_{p+1}) / V_{p+1}, which
    has the distribution F(1, f) if p is enough; f is ``freedom``, the number of residuals less that of the
    coefficients they took, minus p + 1.
    """
    from scipy.special import fdtri

    freedoms = freedom - np.arange(1.0, len(variances))
    return _first_enough(variances, freedoms, fdtri(1, freedoms, confidence))


def chi_squared(variances: Array, samples: int, confidence: float = 0.95) -> int:
    """As :func:`f_test` for very many samples: N (V_p - V_{p+1}) / V_{p+1} against 3.84 at 95 %."""
    threshold = NormalDist().inv_cdf(0.5 + confidence / 2.0) ** 2
    return _first_enough(variances, samples, threshold)


def _first_enough(variances: Array, factor: Array | int, threshold: Array | float) -> int:
    significant = factor * (variances[:-1] - variances[1:]) > threshold * variances[1:]
    return int(np.argmin(np.append(significant, False)))


def fpe(variances: Array, samples: int) -> int:
    """The order with the least final prediction error V_p (N + p)/(N - p)."""
    p = np.arange(len(variances))
    return int(np.argmin(variances * (samples + p) / (samples - p)))


class EstimatedAr(Spec):
    """Autoregressive noise whose model is estimated from the residuals, by turns with the parameters."""

    kind: Literal["estimated_ar"]
    """The kind."""
    method: Literal["burg", "yule_walker", "least_squares"] = "burg"
    """How the coefficients are estimated."""
    criterion: Literal["f_test", "chi_squared", "fpe"] = "f_test"
    """How the order is chosen: by tests of one order against the next, or final prediction error."""
    confidence: Annotated[Real, Field(gt=0, lt=1)] = 0.95
    """Confidence level of the tests."""
    max_order: Annotated[Count, Field(ge=1)] = 5
    """The highest order."""
    iterations: Annotated[Count, Field(ge=1)] = 3
    """How many times the noise and then the parameters are estimated."""

    def model(self, v: Array, coefficients: int = 0) -> ArModel:
        """The model of the residuals ``v`` (N,) of a regression with so many ``coefficients``."""
        models = METHODS[self.method](v, self.max_order)
        variances = np.array([model.variance for model in models])
        match self.criterion:
            case "f_test":
                return models[f_test(variances, len(v) - coefficients, self.confidence)]
            case "chi_squared":
                return models[chi_squared(variances, len(v), self.confidence)]
            case "fpe":
                return models[fpe(variances, len(v))]
