"""Choices among candidates that a last bit cannot turn.

Another processor computes another last bit. Where two candidates are equal up to rounding, such a bit would
choose between them, and what follows (a refinement, an iteration) would go another way. So ties within
rounding are settled by a rule: the first of the nearly least counts. Candidates stand in the order of
preference, the simplest first.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hident.numerics.bootstrap import block_length
from hident.numerics.parts import whole

TIE = 1e-9
"""Two values this close, relative to the smaller one, are one."""
ROUNDING = 1e-13
"""A value this small, relative to the terms that it was computed from, is rounding."""
_FEWEST_BATCHES, _BATCHES = 4, 20


def nearly_least(values: ArrayLike, *, factor: float = 1.0, scale: float = 0.0) -> NDArray[np.bool_]:
    """Which values are at most ``factor`` times the least, up to rounding; the shape is that of ``values``.

    Parameters
    ----------
    values : array
        The criterion of each candidate, not negative if there is a ``factor``; nan and infinity never count.
    factor : float
        How far above the least a value may be; one for the least alone.
    scale : float
        The size of the terms that the values were computed from, such as the sum of the squared outputs of a
        sum of squared residuals: differences below 1e-13 of it are rounding.
    preferred : array of bool, the shape of ``values``
        The candidates that count before all others, such as those whose iteration converged.

    Raises
    ------
    ValueError
        If no value is finite.
    """
    values = np.asarray(values, dtype=float)
    finite = np.isfinite(values)
    if not finite.any():
        raise ValueError("no candidate has a finite value")
    bound = factor * float(values[finite].min())
    return np.asarray(finite & (values <= bound + TIE * abs(bound) + ROUNDING * scale))


def first_least(values: ArrayLike, *, scale: float = 0.0) -> int:
    """The index of the first value that is the least up to rounding, in the flattened ``values``.

    The parameters and the error are those of :func:`nearly_least`.

    Examples
    --------
    >>> first_least([0.3, 0.1 + 2e-16, 0.1])
    1
    """
    return int(np.flatnonzero(nearly_least(values, scale=scale))[0])


def simplest(values: ArrayLike, sizes: ArrayLike, *, factor: float, scale: float = 0.0) -> int:
    """The index of the simplest candidate whose value is within ``factor`` of the least.

    Parameters
    ----------
    values : array, shape (C,)
        The criterion of each candidate, as for :func:`nearly_least`.
    sizes : array, shape (C,)
        What makes a candidate simple, such as its number of parameters: the smallest is taken. Among equals
        the least value counts, and of those that tie, the first.
    factor, scale : float
        As for :func:`nearly_least`.

    Examples
    --------
    >>> simplest([0.9, 0.11, 0.12, 0.1], [1, 2, 2, 3], factor=1.25)
    1
    """
    values, sizes = np.asarray(values, dtype=float), np.asarray(sizes)
    near = np.flatnonzero(nearly_least(values, factor=factor, scale=scale))
    alike = near[sizes[near] == sizes[near].min()]
    return int(alike[first_least(values[alike], scale=scale)])


def standard_error(values: NDArray[np.float64]) -> float:
    """The standard error of the mean of values (N,), in the order of time, of which close ones are alike.

    From the means of 4 to 20 batches, which are longer than the values remember.
    """
    batches = min(max(len(values) // block_length(values, whole(len(values))), _FEWEST_BATCHES), _BATCHES)
    means = [batch.mean() for batch in np.array_split(values, min(batches, len(values)))]
    return float(np.std(means, ddof=1) / np.sqrt(len(means))) if len(means) > 1 else 0.0


def within_one_standard_error(squared: Sequence[NDArray[np.float64]]) -> NDArray[np.bool_]:
    """Which candidates (C,) have a mean squared error within one standard error of the least.

    Where that is so, the data do not tell them apart, and the simplest will do (Breiman, Friedman, Olshen,
    Stone 1984, section 3.4.3). The standard error is that of the difference from the best candidate, sample
    by sample.

    Parameters
    ----------
    squared : sequence of C arrays, shape (N,)
        The squared errors of each candidate at the same samples, in the order of time.

    Examples
    --------
    >>> noise = np.random.default_rng(0).chisquare(1, 1000)
    >>> within_one_standard_error([noise, noise + 1e-12, 1.5 * noise])
    array([ True,  True, False])
    """
    best = squared[int(np.argmin([np.mean(one) for one in squared]))]
    slack = TIE * float(np.mean(best))
    return np.array([float(np.mean(one - best)) <= standard_error(one - best) + slack for one in squared])


def sorting(values: NDArray[np.float64]) -> NDArray[np.intp]:
    """An order that sorts ``values`` (N,); those that are equal keep theirs.

    A sort that is not stable is faster, and its order of equal values depends on the processor.
    """
    order = np.argsort(values)
    ordered = values[order]
    return np.argsort(values, kind="stable") if np.any(ordered[1:] == ordered[:-1]) else order
