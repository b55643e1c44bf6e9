"""What is no more than rounding."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hident.numerics.choices import ROUNDING


def is_constant(values: ArrayLike) -> bool:
    """Whether all values are one number up to rounding: they differ by at most 1e-13 of the largest modulus.

    Examples
    --------
    >>> is_constant([0.1 + 0.2, 0.3])
    True
    >>> is_constant([1.0, 1.0 + 1e-9])
    False
    """
    flat = np.ravel(np.asarray(values, dtype=float))
    return bool(np.ptp(flat) <= ROUNDING * np.max(np.abs(flat))) if len(flat) else True
