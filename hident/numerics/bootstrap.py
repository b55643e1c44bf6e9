"""Residuals drawn again in blocks, for what a model's estimates would have been on another record."""

from __future__ import annotations

import math

import numpy as np

from hident.arrays import Array
from hident.numerics.parts import Parts, longer_than

# The correlogram has ended where so many autocorrelations in a row are below this bound.
_FEWEST_BELOW, _BOUND = 5, 2.0


def resampled(residuals: Array, length: int, rng: np.random.Generator) -> Array:
    """Circular blocks of so many residuals, drawn with replacement, one after the other: shape (N,).

    Politis, Romano 1992: a block that reaches the end goes on at the beginning, so that each residual is as
    likely as any other. They keep their mean: what the model misses throughout is missed again.
    """
    n = len(residuals)
    starts = rng.integers(0, n, -(-n // length))
    places = (starts[:, np.newaxis] + np.arange(length)) % n
    return np.asarray(residuals[places.ravel()[:n]])


def block_length(residuals: Array, parts: Parts) -> int:
    """The length of circular blocks that suits how long residuals (N,) remember.

    The optimal one for the mean (Politis, White 2004, Econometric Reviews 23, 53; corrected by Patton,
    Politis, White 2009, ibid. 28, 372): b = (2 G^2/D)^(1/3) N^(1/3) with G = sum_k lambda(k/M) |k| R(k) and
    D = 4/3 (sum_k lambda(k/M) R(k))^2, where R are the autocovariances, lambda is flat up to a half and falls
    to 0 at 1, and M is twice the lag after which the correlogram has ended.

    Examples
    --------
    >>> from hident.numerics.parts import whole
    >>> e = np.random.default_rng(0).standard_normal(2000)
    >>> slow = np.convolve(e, np.ones(20), "valid")
    >>> block_length(e, whole(2000)) < 10 < block_length(slow, whole(len(slow)))
    True
    """
    n = len(residuals)
    shortest = min(part.stop - part.start for part in parts)
    most: int = max(1, math.ceil(min(3.0 * math.sqrt(n), shortest / 3.0)))
    if n < 2 or not np.std(residuals) > 0.0:
        return 1
    below = max(_FEWEST_BELOW, math.ceil(math.sqrt(math.log10(n))))
    lags: int = min(math.ceil(math.sqrt(n)) + below, shortest - 1)
    covariances = _autocovariances(residuals - np.mean(residuals), parts, lags)
    small = np.abs(covariances[1:] / covariances[0]) < _BOUND * math.sqrt(math.log10(n) / n)
    ends = (m for m in range(len(small)) if np.all(small[m : m + below]))
    window = min(2 * next(ends, lags), lags)
    if not window:
        return 1
    k = np.arange(1, window + 1)
    weighted = np.minimum(1.0, 2.0 * (1.0 - k / window)) * covariances[1 : window + 1]
    total = covariances[0] + 2.0 * float(np.sum(weighted))
    if not total:
        return most
    ratio = 2.0 * float(np.sum(weighted * k)) / total
    return min(max(math.ceil(math.cbrt(1.5 * ratio**2 * n)), 1), most)


def _autocovariances(e: Array, parts: Parts, lags: int) -> Array:
    """R(0), ..., R(lags) (lags + 1,), no product of two samples reaching from one part into another."""
    from scipy.signal import correlate

    found = np.zeros(lags + 1)
    for part in longer_than(parts, 0):
        piece = e[part]
        count = min(len(piece), lags + 1)
        found[:count] += correlate(piece, piece, "full", "fft")[len(piece) - 1 :][:count]
    return found / len(e)
