"""Autoregressive models of residuals: how they are estimated, and how their order is chosen.

=========  ========================================================================
v          residuals, taken as v(t) = a_1 v(t-1) + ... + a_p v(t-p) + e(t)
V_p        variance of e that the model of order p leaves; V_0 that of v
N          number of residuals
=========  ========================================================================

``parts`` say where the residuals of each experiment stand; nothing reaches from one into another. They are
one experiment by default.
"""

from __future__ import annotations

from collections.abc import Callable
from statistics import NormalDist
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.spec import Count, Real, Spec
from hident.errors import EstimationError
from hident.numerics.autoregression import ArModel, burg, yule_walker
from hident.numerics.choices import TIE, first_least
from hident.numerics.parts import Parts, in_each, longer_than, whole


def least_squares(v: Array, highest: int, parts: Parts | None = None) -> list[ArModel]:
    """The models of orders 0, ..., ``highest`` of ``v`` (N,) by least squares; may be unstable.

    The coefficients of order p are fitted on all t > p, but the variances on t > ``highest``: fits to
    different samples cannot be compared.

    Raises
    ------
    EstimationError
        If no experiment holds more than ``highest`` samples.
    """
    if not longer_than(parts := parts or whole(len(v)), highest):
        raise EstimationError(
            f"no experiment holds more than {highest} residuals, and so far back the noise model looks"
        )
    return [
        ArModel(_regressed(v, p, p, parts)[0], _regressed(v, p, highest, parts)[1])
        for p in range(highest + 1)
    ]


def _regressed(v: Array, p: int, first: int, parts: Parts) -> tuple[Array, float]:
    """Coefficients (p,) and the mean squared error of the autoregression on t > ``first``."""

    def lagged(v: Array) -> Array:
        return np.stack([v[first - k : len(v) - k] for k in range(p + 1)])

    rows = in_each(longer_than(parts, first), lagged, v, axis=1)
    a = np.linalg.lstsq(rows[1:].T, rows[0], rcond=None)[0]
    return a, float(np.mean((rows[0] - a @ rows[1:]) ** 2))


METHODS: dict[str, Callable[..., list[ArModel]]] = {
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
    # A step that is significant by less than rounding is not: the lower order stays.
    significant = factor * (variances[:-1] - variances[1:]) > threshold * variances[1:] * (1.0 + TIE)
    return int(np.argmin(np.append(significant, False)))


def fpe(variances: Array, samples: int) -> int:
    """The order with the least final prediction error V_p (N + p)/(N - p), the lowest if several tie."""
    p = np.arange(len(variances))
    return first_least(variances * (samples + p) / (samples - p))


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

    def model(self, v: Array, coefficients: int = 0, parts: Parts | None = None) -> ArModel:
        """The model of the residuals ``v`` (N,) of a regression with so many ``coefficients``."""
        models = METHODS[self.method](v, self.max_order, parts)
        variances = np.array([model.variance for model in models])
        match self.criterion:
            case "f_test":
                return models[f_test(variances, len(v) - coefficients, self.confidence)]
            case "chi_squared":
                return models[chi_squared(variances, len(v), self.confidence)]
            case "fpe":
                return models[fpe(variances, len(v))]
