"""What is no more than rounding, and numbers in as many digits as tell them from a limit."""

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


def apart(value: complex, limit: float, digits: int) -> str:
    """A number in so many significant digits, or as many more as tell its modulus from a limit.

    Examples
    --------
    >>> apart(1.25, 1.0, 4), apart(1.0, 1.0, 4), apart(1.0000001, 1.0, 4)
    ('1.25', '1', '1.0000001')
    """
    texts = [f"{value:.{n}g}" for n in range(digits, 18)]
    side = np.sign(abs(value) - limit)
    return next((text for text in texts if np.sign(abs(complex(text)) - limit) == side), texts[-1])
