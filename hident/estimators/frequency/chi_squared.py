"""The test of a fit by the sum of its squared residuals in standard errors."""

from __future__ import annotations

import math

TOLERATED = 1e-3
"""A misfit up to this is tolerated whatever the noise."""
EQUAL = 1e-3
"""Solutions whose chi^2 differ by less fit equally well."""
LIKELY = 0.05
"""A search ends where chi^2 is below what a right model exceeds so often."""


def limit(freedom: int, level: float) -> float:
    """The chi^2 that a right model exceeds with the probability ``level``; 0 without degrees of freedom."""
    from scipy.special import chdtri

    if level == 0.0:
        return math.inf
    return float(chdtri(freedom, level)) if freedom else 0.0


def fits(chi2: float, freedom: int, level: float) -> bool:
    """Whether chi^2 is below what a right model exceeds with the probability ``level``, or next to 0."""
    return chi2 <= max(limit(freedom, level), EQUAL)


def why_too_large(chi2: float, freedom: int, misfit: float, level: float) -> str:
    """What chi^2 and the largest ``misfit`` are, in words, if a right model has hardly any such; else empty.

    Without degrees of freedom there is nothing to test.
    """
    largest = limit(freedom, level)
    if chi2 <= largest or not freedom or misfit <= TOLERATED:
        return ""
    return (
        f"chi^2 is {chi2:.4g}, {largest:.4g} the limit for {freedom} degrees of freedom, and the largest "
        f"misfit is {misfit:.2g}"
    )
