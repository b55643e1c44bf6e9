"""What no data determine of blocks in series, and how near one signal comes to another if that is chosen.

=========  =====================================================================================
gain       a positive factor between two blocks: one is multiplied by it, the other divided
sign       the sign of that factor
delay      a delay that moves from one linear block of a Wiener-Hammerstein system to the other
constant   an additive constant of a nonlinearity
=========  =====================================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Literal, get_args

import numpy as np

from hident.arrays import Array, Characteristic, Complex

Freedom = Literal["gain", "sign", "delay", "constant"]
FREEDOMS: tuple[Freedom, ...] = get_args(Freedom)

# Factors of an argument that are tried first: its unit may be any. How many of the best are refined.
_FACTORS = np.geomspace(1e-15, 1e15, 601)
_REFINED = 3
_COARSE = 256
_PROPORTIONAL = 1e-9


def factor(
    found: Array | Complex, true: Array | Complex, weights: Array | float, free: Collection[Freedom]
) -> float:
    """The real factor that brings ``found`` (M,) nearest to ``true`` (M,), of those that are free.

    With ``gain`` a factor of at least zero, with ``sign`` 1 or -1, with both any; 1 with neither.
    """
    product = float(np.sum(weights * (np.conj(found) * true).real))
    if "gain" not in free:
        return -1.0 if "sign" in free and product < 0.0 else 1.0
    size = float(np.sum(weights * np.abs(found) ** 2))
    best = product / size if size else 0.0
    return best if "sign" in free else max(best, 0.0)


def multiple(one: Array, other: Array) -> float | None:
    """The number by which ``other`` (K,) must be multiplied to give ``one`` (K,); None if there is none.

    What is not finite in one of them does not count.

    Examples
    --------
    >>> multiple(np.array([2.0, 0.0, -6.0]), np.array([1.0, 0.0, -3.0]))
    2.0
    """
    both = np.isfinite(one) & np.isfinite(other)
    one, other = one[both], other[both]
    if np.array_equal(one, other):
        return 1.0
    used = (one != 0.0) | (other != 0.0)
    with np.errstate(all="ignore"):
        ratios = one[used] / other[used]
    if not np.all(np.isfinite(ratios)) or not np.all(ratios):
        return None
    ratio = float(np.median(ratios))
    return ratio if np.all(np.abs(ratios - ratio) <= _PROPORTIONAL * abs(ratio)) else None


def nearest(found: Array, true: Array, weights: Array, free: Collection[Freedom]) -> Array:
    """``found`` (M,) with the factor and the constant that are free, nearest to ``true`` (M,).

    Nearest in the sum of squares with the ``weights`` (M,).

    Examples
    --------
    >>> found, true = np.array([0.0, 1.0, 2.0]), np.array([1.0, 3.0, 5.0])
    >>> nearest(found, true, np.ones(3), ("gain", "constant"))
    array([1., 3., 5.])
    >>> nearest(found, true, np.ones(3), ("constant",))
    array([2., 3., 4.])
    """
    if not free:
        return found
    if "constant" not in free:
        return factor(found, true, weights, free) * found
    total = float(np.sum(weights))
    middle, level = float(weights @ found) / total, float(weights @ true) / total
    return factor(found - middle, true - level, weights, free) * (found - middle) + level


def nearest_argument(
    function: Characteristic,
    x: Array,
    true: Array,
    weights: Array,
    free: Collection[Freedom],
    outside: Collection[Freedom] = (),
) -> Array:
    """f(k x) with the factor k of its argument that is free, nearest to ``true`` (M,) at ``x`` (M,).

    What is free of the values besides, such as a constant, is ``outside``. Where f is not finite at a k x,
    that k is none.

    Examples
    --------
    >>> x = np.linspace(0.0, 1.0, 50)
    >>> found = nearest_argument(np.sin, x, np.sin(2.5 * x), np.ones(50), ("gain",))
    >>> bool(np.allclose(found, np.sin(2.5 * x), atol=1e-7))
    True
    """
    from scipy.optimize import minimize_scalar

    def values(k: float, at: slice) -> Array:
        return nearest(function(k * x[at]), true[at], weights[at], outside)

    def distance(k: float, at: slice) -> float:
        with np.errstate(all="ignore"):
            error = values(k, at) - true[at]
            total = float(weights[at] @ error**2)
        return total if np.isfinite(total) else np.inf

    every, some = slice(None), slice(None, None, max(len(x) // _COARSE, 1))
    signs = (1.0, -1.0) if "sign" in free else (1.0,)
    if "gain" not in free:
        return values(min(signs, key=lambda k: distance(k, every)), every)
    candidates: list[tuple[float, float]] = [(distance(1.0, every), 1.0)]
    for sign in signs:
        tried = np.array([distance(sign * k, some) for k in _FACTORS])
        for place in _lowest(tried):
            low, high = _FACTORS[max(place - 1, 0)], _FACTORS[min(place + 1, len(_FACTORS) - 1)]
            found = minimize_scalar(
                _at(distance, sign, every),
                bounds=(np.log(low), np.log(high)),
                method="bounded",
                options={"xatol": 1e-10},
            )
            candidates.append((float(found.fun), sign * float(np.exp(found.x))))
    return values(min(candidates)[1], every)


def _at(distance: Callable[[float, slice], float], sign: float, every: slice) -> Callable[[float], float]:
    # A bounded search needs numbers: beyond the function's domain is merely far away.
    return lambda log_k: min(distance(sign * float(np.exp(log_k)), every), np.finfo(float).max)


def _lowest(tried: Array) -> list[int]:
    """The places of the lowest few local minima."""
    padded = np.concatenate(([np.inf], tried, [np.inf]))
    local = np.flatnonzero(np.isfinite(tried) & (tried <= padded[:-2]) & (tried <= padded[2:]))
    return sorted(local.tolist(), key=lambda place: float(tried[place]))[:_REFINED]


def in_words(free: Collection[Freedom]) -> str:
    """What is chosen for the least error, in words; empty if nothing is."""
    factors = {"gain", "sign"} & set(free)
    words = []
    if factors == {"gain", "sign"}:
        words.append("a factor of either sign")
    elif factors:
        words.append("a positive factor" if "gain" in factors else "the sign")
    words += [word for name, word in (("delay", "a delay"), ("constant", "a constant")) if name in free]
    return " and ".join(words)
