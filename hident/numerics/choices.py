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


def first_least(values: ArrayLike, *, scale: float = 0.0) -> int:
    """The index of the first value that is the least up to rounding, in the flattened ``values``.

    Parameters
    ----------
    values : array
        The criterion of each candidate; nan and infinity are never chosen.
    scale : float
        The size of the terms that the values were computed from, such as the sum of the squared outputs of a
        sum of squared residuals: differences below 1e-13 of it are rounding.

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
    finite = np.isfinite(flat)
    if not finite.any():
        raise ValueError("no candidate has a finite value")
    least = float(flat[finite].min())
    near = flat <= least + TIE * abs(least) + ROUNDING * scale
    return int(np.flatnonzero(finite & near)[0])
