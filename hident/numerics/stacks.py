"""Many signals or problems at once, with the same numbers to the last bit as each by itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar, cast

import numpy as np

from hident.arrays import Array, Flags, Index

S = TypeVar("S")


def times(signals: Array, matrix: Array) -> Array:
    """Each signal (..., N) times the matrix (N, K), shape (..., K).

    A plain product may sum in another order when there are more signals.

    Examples
    --------
    >>> times(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[1.0], [10.0]])).tolist()
    [[21.0], [43.0]]
    """
    return np.asarray(np.matmul(signals[..., None, :], matrix)[..., 0, :])


def applied(matrices: Array, vectors: Array) -> Array:
    """Each matrix (..., N, K) times its vector (..., K), shape (..., N).

    Examples
    --------
    >>> applied(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[1.0, 0.0], [0.0, 1.0]])).tolist()
    [[1.0, 3.0], [2.0, 4.0]]
    """
    product: Array = np.matmul(matrices, vectors[..., None])[..., 0]
    return product


def dots(vectors: Array, others: Array) -> Array:
    """The product (...) of each vector (..., N) with another.

    Examples
    --------
    >>> dots(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[1.0, 1.0], [0.0, 2.0]])).tolist()
    [3.0, 8.0]
    """
    product: Array = np.matmul(vectors[..., None, :], others[..., None])[..., 0, 0]
    return product


def chosen(stack: S, which: Flags | Index | slice) -> S:
    """Those of a stack of T objects: a dataclass whose fields are arrays (T, ...)."""
    return _each(stack, lambda array: array[which])


def copied(stack: S) -> S:
    """A stack with arrays of its own."""
    return _each(stack, np.array)


def put(stack: S, at: Flags | Index, others: S) -> None:
    """Let the ``others`` take the places ``at`` of a stack, whose arrays are written to."""
    for name in vars(stack):
        getattr(stack, name)[at] = getattr(others, name)


def _each(stack: S, make: Callable[[Any], Any]) -> S:
    made: S = replace(cast(Any, stack), **{name: make(array) for name, array in vars(stack).items()})
    return made
