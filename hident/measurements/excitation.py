"""Which nonlinearities the input of a record can excite."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hident.arrays import Array
from hident.numerics.parts import Parts, longer_than

DEGREES = (1, 2, 3, 5)
LAGS = (1, 2, 5, 10, 20)
CONDITION = 1e3
"""Regressors of a larger condition number tell their coefficients apart badly."""

# Products of columns that depend on each other have eigenvalues of this size by rounding.
_ROUNDING = 1e-13
_ROWS = 10_000


@dataclass(frozen=True, eq=False)
class Excitation:
    """The condition numbers of the regressors P_i(u(t - k)), i = 1..degree, k = 0..lags - 1.

    P_i are Legendre's polynomials over the range of the input; the columns have the mean zero and the length
    one. ``condition[i, j]`` is that of the i-th degree and the j-th number of lags; infinite where the
    regressors depend on each other.
    """

    degrees: tuple[int, ...]
    lags: tuple[int, ...]
    condition: Array


def excitation(u: Array, parts: Parts) -> Excitation:
    """What the input excites, given between -1 and 1."""
    from numpy.polynomial.legendre import legvander

    condition = np.full((len(DEGREES), len(LAGS)), math.inf)
    basis = np.asarray(legvander(u, max(DEGREES))[:, 1:], dtype=float)
    for j, lags in enumerate(LAGS):
        rows = _lagged(basis, longer_than(parts, lags), lags)
        if not len(rows):
            continue
        columns = rows.reshape(len(rows), -1) - rows.mean(axis=0).reshape(-1)
        products = (columns.T @ columns / len(rows)).reshape((lags, max(DEGREES)) * 2)
        for i, degree in enumerate(DEGREES):
            if len(rows) > degree * lags:
                chosen = products[:, :degree, :, :degree].reshape(degree * lags, degree * lags)
                condition[i, j] = _condition(chosen)
    return Excitation(DEGREES, LAGS, condition)


def _lagged(basis: Array, parts: Parts, lags: int) -> Array:
    """The basis at t - k, shape (rows, lags, functions); of long records an even share of the rows."""
    t = np.concatenate([np.zeros(0, int), *(np.arange(part.start + lags - 1, part.stop) for part in parts)])
    t = t[:: max(1, -(-len(t) // _ROWS))]
    return basis[t[:, None] - np.arange(lags)]


def _condition(products: Array) -> float:
    """The condition number of columns of length one, from their mean products (K, K)."""
    lengths = np.sqrt(np.diag(products))
    # A function that is the same at all levels has no column.
    if not (lengths > 1e-9).all():
        return math.inf
    squares = np.linalg.eigvalsh(products / np.outer(lengths, lengths))
    return math.sqrt(squares[-1] / squares[0]) if squares[0] > _ROUNDING * squares[-1] else math.inf
