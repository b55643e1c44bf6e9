"""Printed numbers against the joint distribution of our trials, on arrays.

If what we run is what the paper ran, a printed row is one more draw from the distribution of ours. Then all
orders of the rows are equally likely, whatever that distribution is, and the place of the printed one among
all, by any distance that treats them alike, is a p-value, exact for any number of trials: a permutation test.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from hident.arrays import Array
from hident.numerics.choices import ROUNDING
from hident.numerics.rounding import is_constant

REPLICATES = 999
"""How many means of several runs stand for their distribution."""
_AT_ONCE = 2_000_000
_MOST_RUNS = 20_000
Statistic = Callable[[Array], Array]


@np.errstate(all="ignore")
def joint_p(rows: Array, printed: Array, half_unit: Array, blocks: Sequence[object] = ()) -> float:
    """The p-value of a printed row among our rows, by Mahalanobis distances of normal scores of ranks.

    Parameters
    ----------
    rows : (n, k) array
        Our rows, all finite.
    printed : (k,) array
        The printed row.
    half_unit : (k,) array
        Half a unit of the last printed digit, to which our numbers are rounded too; 0 for none.
    blocks : sequence of k labels, optional
        Numbers of one label are taken together, and the distances of all blocks are added; one block by
        default. Few trials know the correlations within a short row, and not those of a whole table.

    Returns
    -------
    float
        The share of rows, the printed one among them, that lie as far out as it: at least 1 / (n + 1). 0 if
        a number does not vary with us and is another in print, 1 if none varies and all are the same.

    Notes
    -----
    Ranks are taken of all n + 1 rows together, so no row is treated in another way than the others. The
    correlations of k numbers are drawn to zero by the weight k / (n + 1 + k), so that no direction decides
    that the trials do not know.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.random.default_rng(1).normal(size=(199, 1))
    >>> rows = np.hstack([x, -x])
    >>> joint_p(rows, np.array([1.0, 1.0]), np.zeros(2))
    0.005
    """
    fixed = np.array([is_constant(column) for column in rows.T])
    slack = half_unit * (1.0 + 1e-9) + ROUNDING * np.abs(printed)
    if np.any(fixed & (np.abs(rows[0] - printed) > slack)):
        return 0.0
    pool = _on_a_grid(np.vstack([rows, printed]), half_unit)
    varies = ~fixed & np.any(pool != pool[-1], axis=0)
    labels = np.array([str(label) for label in blocks] or ["one"] * len(printed))
    distances = sum(
        (_distances(pool[:, varies & (labels == label)]) for label in dict.fromkeys(labels[varies])),
        start=np.zeros(len(pool)),
    )
    return float(np.mean(distances >= distances[-1] * (1.0 - 1e-9)))


def _distances(pool: Array) -> Array:
    """The squared Mahalanobis distance of each row."""
    from scipy.special import ndtri
    from scipy.stats import rankdata

    n, k = pool.shape
    scores = ndtri((rankdata(pool, axis=0) - 0.5) / n)
    scores -= scores.mean(axis=0)
    scores /= np.sqrt(np.mean(scores**2, axis=0))
    weight = k / (n + k)
    correlations = (1.0 - weight) * (scores.T @ scores) / n + weight * np.eye(k)
    return np.asarray(np.einsum("ij,ij->i", scores, np.linalg.solve(correlations, scores.T).T))


@np.errstate(all="ignore")
def adjusted_p(rows: Array, printed: Array, half_unit: Array) -> Array:
    """For each printed number how likely some number of the row lies as far out: p-values for many at once.

    The single-step adjustment by the largest distance in a row, of which the pool of all rows gives the
    distribution, so that correlated numbers cost less than independent ones. A distance is that from the
    median, in units of that of the 2.5 % quantile on the same side. Parameters as of :func:`joint_p`.

    Returns
    -------
    (k,) array

    References
    ----------
    P. H. Westfall and S. S. Young, Resampling-Based Multiple Testing, Wiley 1993, section 2.3.

    Examples
    --------
    >>> import numpy as np
    >>> rows = np.random.default_rng(1).normal(size=(399, 20))
    >>> bool(adjusted_p(rows, np.array([2.2] + 19 * [0.0]), np.zeros(20))[0] > 0.2)
    True
    >>> bool(adjusted_p(rows[:, :1], np.array([2.2]), np.zeros(1))[0] < 0.05)
    True
    """
    pool = _on_a_grid(np.vstack([rows, printed]), half_unit)
    low, median, high = np.quantile(pool, [0.025, 0.5, 0.975], axis=0)
    away = np.where(pool > median, (pool - median) / (high - median), (median - pool) / (median - low))
    away[pool == median] = 0.0
    return np.asarray(np.mean(away.max(axis=1)[:, None] >= away[-1] * (1.0 - 1e-9), axis=0))


def _on_a_grid(values: Array, half_unit: Array) -> Array:
    """The values rounded to whole units, so that ties are those of printed digits."""
    return np.where(half_unit > 0.0, np.rint(values / (2.0 * half_unit)), values)


def combined_p(values: Iterable[float]) -> float:
    """Fisher's combination of p-values of independent data; nan if there is none.

    References
    ----------
    R. A. Fisher, Statistical Methods for Research Workers, 4th ed., 1932, section 21.1.

    Examples
    --------
    >>> round(combined_p([0.05, 0.05]), 4)
    0.0175
    """
    from scipy.special import gammaincc

    found = [value for value in values if not math.isnan(value)]
    if 0.0 in found:
        return 0.0
    return float(gammaincc(len(found), -np.log(found).sum())) if found else float("nan")


def replicates(rows: Array, statistics: Iterable[Statistic], runs: int | None) -> Array:
    """Rows of statistics as a paper of so many runs might have printed them, given ours.

    Each is drawn by the bootstrap: the statistics of ``runs`` trials, less those of as many trials as ours,
    plus ours, since ours have an error too. ``runs`` None stands for a formula: ours alone have one.

    Parameters
    ----------
    rows : (n, k) array
        Our trials, all finite.
    statistics : k functions
        Of an (m, r) array along its last axis.
    runs : int or None
        How many runs the paper averages.

    Returns
    -------
    (REPLICATES, k) array

    Examples
    --------
    >>> import numpy as np
    >>> x = np.random.default_rng(1).normal(size=(400, 1))
    >>> found = replicates(x, [lambda values: values.mean(axis=-1)], 100)
    >>> bool(abs(found.std() / x.std() / (1 / 100 + 1 / 400) ** 0.5 - 1) < 0.1)
    True
    """
    # Of more runs the errors are none beside ours.
    runs = None if runs is not None and runs > _MOST_RUNS else runs
    rng = np.random.default_rng(0)
    n, every = len(rows), list(statistics)
    columns = np.ascontiguousarray(rows.T)
    ours = [float(statistic(column[None])[0]) for statistic, column in zip(every, columns, strict=True)]
    found = np.empty((REPLICATES, len(every)))
    step = max(1, _AT_ONCE // max(n, runs or 1))
    for start in range(0, REPLICATES, step):
        drawn = slice(start, min(start + step, REPLICATES))
        count = drawn.stop - start
        again = rng.integers(n, size=(count, n))
        theirs = None if runs is None else rng.integers(n, size=(count, runs))
        for j, (statistic, column) in enumerate(zip(every, columns, strict=True)):
            printed = ours[j] if theirs is None else statistic(column.take(theirs))
            found[drawn, j] = printed - statistic(column.take(again)) + ours[j]
    return found
