"""Autoregressive models of signals, and the exact whitening that they give.

=========  ========================================================================
v          signal, taken as v(t) = a_1 v(t-1) + ... + a_p v(t-p) + e(t)
V_p        variance of e that the model of order p leaves; V_0 that of v
N          number of samples
=========  ========================================================================

``parts`` say where the samples of each experiment stand; no product of two samples, no prediction and no
whitening reaches from one into another. They are one experiment by default.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hident.arrays import Array
from hident.errors import EstimationError
from hident.numerics.parts import Parts, whole
from hident.numerics.stacks import times


@dataclass(frozen=True, eq=False)
class ArModel:
    """An autoregression with coefficients ``a`` (p,) and the ``variance`` of its innovation e."""

    a: Array
    variance: float = 1.0

    def whiten(self, signals: Array, parts: Parts | None = None) -> Array:
        """Multiply ``signals`` (..., N) by a root F of the inverse covariance: F'F = variance R^-1.

        R is the covariance of N stationary samples, those of different experiments uncorrelated; it is never
        formed.

        Raises
        ------
        EstimationError
            If the model is not stationary.
        """
        root = self._root_of_start()
        parts = parts or whole(signals.shape[-1])
        return np.concatenate([self._whitened(signals[..., part], root) for part in parts], axis=-1)

    def _whitened(self, signals: Array, root: Array) -> Array:
        p, n = len(self.a), signals.shape[-1]
        if n < p:
            return times(signals, _root_of_first(root, n).T)
        whitened = signals.astype(float)
        for k, a in enumerate(self.a, start=1):
            whitened[..., p:] -= a * signals[..., p - k : n - k]
        whitened[..., :p] = times(signals[..., :p], root.T)
        return whitened

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


def _root_of_first(root: Array, count: int) -> Array:
    """A root of the inverse covariance of the first ``count`` of p samples, from that of all p."""
    covariance = np.linalg.inv(root.T @ root)[:count, :count]
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


def _total(products: Iterable[Any]) -> float:
    return float(sum(products))


def burg(v: Array, highest: int, parts: Parts | None = None) -> list[ArModel]:
    """The models of orders 0, ..., ``highest`` of ``v`` (N,) by Burg's recursion; always stationary."""
    models = [ArModel(np.empty(0), float(np.mean(v**2)))]
    errors = [(v[part][1:], v[part][:-1]) for part in parts or whole(len(v))]
    for _ in range(highest):
        power = _total(forward @ forward + backward @ backward for forward, backward in errors)
        both = _total(forward @ backward for forward, backward in errors)
        reflection = 2.0 * both / power if power > 0.0 else 0.0
        models.append(_higher(models[-1], reflection))
        errors = [
            ((forward - reflection * backward)[1:], (backward - reflection * forward)[:-1])
            for forward, backward in errors
        ]
    return models


def yule_walker(v: Array, highest: int, parts: Parts | None = None) -> list[ArModel]:
    """The models of orders 0, ..., ``highest`` of ``v`` (N,) from its autocovariances; always stationary."""
    pieces = [v[part] for part in parts or whole(len(v))]
    lags = range(highest + 1)
    products = [_total(one[: max(len(one) - k, 0)] @ one[k:] for one in pieces) for k in lags]
    covariance = np.array(products) / len(v)
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
