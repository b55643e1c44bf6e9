"""Choices among candidates that a last bit cannot turn.

Another processor computes another last bit. Where two candidates are equal up to rounding, such a bit would
choose between them, and what follows (a refinement, an iteration) would go another way. So ties within
rounding are settled by a rule: the first of the nearly least counts. Candidates stand in the order of
preference, the simplest first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

TIE = 1e-9
"""Two values this close, relative to the smaller one, are one."""
ROUNDING = 1e-13
"""A value this small, relative to the terms that it was computed from, is rounding."""


def first_least(values: ArrayLike, *, scale: float = 0.0, preferred: ArrayLike | None = None) -> int:
    """The index of the first value that is the least up to rounding, in the flattened ``values``.

    Parameters
    ----------
    values : array
        The criterion of each candidate; nan and infinity are never chosen.
    scale : float
        The size of the terms that the values were computed from, such as the sum of the squared outputs of a
        sum of squared residuals: differences below 1e-13 of it are rounding.
    preferred : array of bool, the shape of ``values``
        The candidates that count before all others, such as those whose iteration converged.

    Raises
    ------
    ValueError
        If no value is finite.

    Examples
    --------
    >>> first_least([0.3, 0.1 + 2e-16, 0.1])
    1
    """
    flat = np.ravel(np.asarray(values, dtype=float))
    candidates = np.isfinite(flat)
    if not candidates.any():
        raise ValueError("no candidate has a finite value")
    if preferred is not None and np.any(first := candidates & np.ravel(np.asarray(preferred, dtype=bool))):
        candidates = first
    least = float(flat[candidates].min())
    near = flat <= least + TIE * abs(least) + ROUNDING * scale
    return int(np.flatnonzero(candidates & near)[0])


def simplest_nearly_least(errors: ArrayLike, sizes: ArrayLike, factor: float) -> int:
    """The index of the smallest of the candidates whose error is within ``factor`` of the least.

    Of several of that size the most accurate counts, and of equal ones the first.

    Parameters
    ----------
    errors : array, shape (S,)
        The criterion of each candidate, not negative; nan and infinity are never chosen.
    sizes : array, shape (S,)
        How many parameters each has.
    factor : float
        At least 1; an error that equals the limit up to rounding is within it.

    Raises
    ------
    ValueError
        If no error is finite.

    Examples
    --------
    >>> simplest_nearly_least([2.0, 1.1, 1.0], [1, 2, 3], 1.25)
    1
    """
    found = np.asarray(errors, dtype=float)
    limit = factor * found[first_least(found)] * (1.0 + TIE)
    near = np.isfinite(found) & (found <= limit)
    smallest = near & (np.asarray(sizes) == np.min(np.asarray(sizes)[near]))
    return first_least(np.where(smallest, found, np.nan))
