"""Least squares with columns scaled to length one, so that no unit decides what is singular."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from hident.arrays import Array, Flags

ILL_CONDITIONED = 1e12
"""Condition number, of columns scaled to length one, from which they count as linearly dependent."""
# What may be left of a sum, relative to it.
_SUM = 1e-9


def lengths(columns: Array) -> Array:
    """The lengths (..., P) of the columns (..., N, P); 1 for a column of zeros, which stays so."""
    found = np.sqrt(np.einsum("...ij,...ij->...j", columns, columns))
    return np.where(found == 0.0, 1.0, found)


def is_sum_of(rows: Array, values: Array) -> bool:
    """Whether ``values`` (N,) are a sum of the ``rows`` (K, N), each with a factor, up to rounding.

    What is not finite in one of them does not count.

    Examples
    --------
    >>> u = np.linspace(-3.0, 3.0, 50)
    >>> is_sum_of(np.array([u, np.cos(u) ** 2, np.sin(u) ** 2]), np.ones(50))
    True
    >>> is_sum_of(np.array([u, np.cos(u)]), np.ones(50))
    False
    """
    finite = np.isfinite(values) & np.all(np.isfinite(rows), axis=0)
    columns, values = rows[:, finite].T, values[finite]
    columns = columns / lengths(columns)
    error = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    return bool(np.linalg.norm(error) <= _SUM * np.linalg.norm(values))


@dataclass(frozen=True, eq=False)
class Factorisation:
    """The columns X (N, P) = Q R diag(length), factored once for any number of outputs.

    ``q`` has the shape (N, P), ``r`` (P, P) is upper triangular, ``length`` (P,) are the columns' lengths. Of
    a stack of matrices, with more axes before these, :attr:`inverse_root` and :attr:`dependent` are stacks.

    Examples
    --------
    >>> import numpy as np
    >>> line = Factorisation.of(np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]]))
    >>> line.solution(np.array([1.0, 3.0, 5.0])).round(12).tolist()
    [1.0, 2.0]
    """

    q: Array
    r: Array
    length: Array

    @classmethod
    def of(cls, columns: Array) -> Self:
        """Factor the columns (..., N, P)."""
        length = lengths(columns)
        return cls(*np.linalg.qr(columns / length[..., None, :]), length)

    @cached_property
    def _singular(self) -> tuple[Array, Array]:
        _, values, right = np.linalg.svd(self.r)
        return values, right

    @property
    def null(self) -> Array:
        """An orthonormal basis (K, P) of the combinations of scaled columns that vanish; K = 0 for none."""
        values, right = self._singular
        vanish = np.ones(len(right), dtype=bool)
        vanish[: len(values)] = values * ILL_CONDITIONED <= values[0]
        return right[vanish]

    @property
    def dependent(self) -> Flags:
        """Whether (...) some column is a combination of others; so it is with fewer rows than columns."""
        values, right = self._singular
        few = values.shape[-1] < right.shape[-1]
        return np.asarray(few | np.any(values * ILL_CONDITIONED <= values[..., :1], axis=-1))

    @property
    def is_dependent(self) -> bool:
        """:attr:`dependent` of one matrix."""
        return bool(self.dependent)

    def solution(self, y: Array) -> Array:
        """The parameters (P,) or (P, T) for the outputs ``y`` (N,) or (N, T)."""
        found = np.linalg.solve(self.r, self.q.T @ y)
        return (found.T / self.length).T

    @cached_property
    def inverse_root(self) -> Array:
        """The matrix G (..., P, P) with (X'X)^-1 = G G'."""
        return np.asarray(np.linalg.solve(self.r, np.eye(self.r.shape[-1])) / self.length[..., None])
