"""Many signals at once, with the same numbers to the last bit as each by itself."""

from __future__ import annotations

import numpy as np

from hident.arrays import Array


def times(signals: Array, matrix: Array) -> Array:
    """Each signal (..., N) times the matrix (N, K), shape (..., K).

    A plain product may sum in another order when there are more signals.

    Examples
    --------
    >>> times(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[1.0], [10.0]])).tolist()
    [[21.0], [43.0]]
    """
    return np.asarray(np.matmul(signals[..., None, :], matrix)[..., 0, :])
