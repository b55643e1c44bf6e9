"""Two methods on the same trials: paired differences, their interval, a test, and what failures count as.

A trial in which one method alone fails is a loss of that method by more than any other; one in which both
fail is a tie, and so is one in which both give the same value.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hident.arrays import Array
from hident.numerics.choices import TIE
from hident.numerics.rounding import is_constant

LEVEL = 0.05
"""Level of the tests; the intervals hold 1 - LEVEL."""
# The counts of so many signs are whole numbers below 2^53.
_MOST_EXACT = 50


class Interval(NamedTuple):
    """A statistic and its 95 % interval, whose ends are nan where there is none."""

    estimate: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Pair:
    """Two methods over n trials.

    ``differences`` (n,) are the first method's value less the second's, or the logarithm of their ratio:
    infinite where one method alone failed, zero in a tie, nan where a ratio has no logarithm. ``outcomes``
    (n,) are 1 where the first method wins, 0 in a tie and -1 where it loses; ``worked`` (n,) says where
    neither failed, and ``failed`` how often each did.
    """

    differences: Array
    outcomes: NDArray[np.int64]
    worked: NDArray[np.bool_]
    failed: tuple[int, int]

    @property
    def wins(self) -> int:
        """In how many trials the first method is better."""
        return int(np.sum(self.outcomes > 0))

    @property
    def losses(self) -> int:
        """In how many trials it is worse."""
        return int(np.sum(self.outcomes < 0))

    @property
    def ties(self) -> int:
        """In how many trials neither is better."""
        return len(self.outcomes) - self.wins - self.losses

    @property
    def win_rate(self) -> float:
        """The share of the trials in which the first method wins, a tie counting half."""
        return (self.wins + 0.5 * self.ties) / len(self.outcomes)

    @property
    def both_failed(self) -> int:
        """In how many trials both failed."""
        return sum(self.failed) - int(np.sum(~self.worked))

    @property
    def undefined(self) -> int:
        """In how many trials the ratio of the values has no logarithm."""
        return int(np.sum(np.isnan(self.differences)))

    def interval(self, statistic: Literal["mean", "median"] = "mean") -> Interval:
        """The mean or the median of the differences with its interval; nan where one is undefined.

        The mean is that of the trials in which neither failed. The median is that of all trials, so that it
        may be infinite.
        """
        if self.undefined:
            return Interval(*3 * [float("nan")])
        if statistic == "mean":
            return mean_interval(self.differences[self.worked])
        return median_interval(self.differences)

    @cached_property
    def p(self) -> float:
        """The two-sided p-value of Wilcoxon's signed-rank test; nan where a difference is undefined."""
        return float("nan") if self.undefined else signed_rank_p(self.differences)

    @cached_property
    def side(self) -> int:
        """Which method the ranks of the differences favour: 1 the first, -1 the second, 0 neither."""
        from scipy.stats import rankdata

        sizes = np.abs(np.where(np.isnan(self.differences), 0.0, self.differences))
        return int(np.sign(self.outcomes @ rankdata(sizes)))


def paired(
    first: ArrayLike,
    second: ArrayLike,
    *,
    best: Literal["lowest", "highest", "zero"] = "lowest",
    log: bool = False,
    equal: float = TIE,
) -> Pair:
    """The pair of two methods, from the value of each in the same trials.

    Parameters
    ----------
    first, second : arrays (n,)
        The values; what is not finite is a failed trial.
    best : {"lowest", "highest", "zero"}
        Which values are good; for "zero", all values are replaced by their moduli.
    log : bool
        Whether differences are the logarithms of ratios.
    equal : float
        Two values are equal that differ by at most so much of the larger modulus.

    Examples
    --------
    >>> import numpy as np
    >>> pair = paired([1.0, 2.0, np.nan, np.nan], [1.5, 2.0, 3.0, np.nan])
    >>> pair.differences
    array([-0.5,  0. ,  inf,  0. ])
    >>> pair.wins, pair.ties, pair.losses, pair.failed, pair.both_failed
    (1, 2, 1, (2, 1), 1)
    """
    a, b = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    good = np.isfinite(a), np.isfinite(b)
    worked = good[0] & good[1]
    failed = int(np.sum(~good[0])), int(np.sum(~good[1]))
    a, b = (np.where(worked, values, 0.0) for values in (a, b))
    if best == "zero":
        a, b = np.abs(a), np.abs(b)
    worse = -1 if best == "highest" else 1
    same = np.abs(a - b) <= equal * np.maximum(np.abs(a), np.abs(b))
    if log:
        with np.errstate(divide="ignore", invalid="ignore"):
            differences = np.where((a > 0.0) & (b > 0.0), np.log(a) - np.log(b), np.nan)
        # Nothing but two zeros are as good as each other without a logarithm.
        differences = np.where(same & (a == 0.0), 0.0, differences)
    else:
        differences = a - b
    differences = np.where(same & ~np.isnan(differences), 0.0, differences)
    outcomes = np.where(same, 0, np.sign(b - a) * worse).astype(np.int64)
    for lost, side in ((good[1] & ~good[0], -1), (good[0] & ~good[1], 1)):
        differences[lost], outcomes[lost] = -side * worse * np.inf, side
    return Pair(differences, outcomes, worked, failed)


def mean_interval(values: Array) -> Interval:
    """The mean of independent values (n,) with its 95 % interval by Student's t.

    Examples
    --------
    >>> import numpy as np
    >>> [round(x, 3) for x in mean_interval(np.array([1.0, 2.0, 3.0]))]
    [2.0, -0.484, 4.484]
    """
    from scipy.stats import t

    n, nan = len(values), float("nan")
    if not n:
        return Interval(nan, nan, nan)
    if is_constant(values):
        first = float(values[0])
        return Interval(first, first, first) if n > 1 else Interval(first, nan, nan)
    mean = float(np.mean(values))
    reach = float(t.ppf(1.0 - LEVEL / 2.0, n - 1)) * float(np.std(values, ddof=1)) / n**0.5
    return Interval(mean, mean - reach, mean + reach)


def median_interval(values: Array) -> Interval:
    """The median of independent values (n,) with an interval of at least 95 % between two of them.

    Values may be infinite. Fewer than six have no such interval.

    Examples
    --------
    >>> import numpy as np
    >>> median_interval(np.array([3.0, 1.0, 2.0, np.inf, 5.0, 4.0, 6.0]))
    Interval(estimate=4.0, low=1.0, high=inf)
    """
    from scipy.stats import quantile_test

    nan = float("nan")
    if not len(values):
        return Interval(nan, nan, nan)
    # Half way between two infinities of one sign is that infinity, and between two of both signs nowhere.
    middle = np.sort(values)[[(len(values) - 1) // 2, len(values) // 2]]
    with np.errstate(invalid="ignore"):
        estimate = float(middle[0] if middle[0] == middle[1] else np.mean(middle))
    found = quantile_test(values, p=0.5).confidence_interval(1.0 - LEVEL)
    return Interval(estimate, float(found.low), float(found.high))


def signed_rank_p(differences: Array) -> float:
    """The two-sided p-value of Wilcoxon's signed-rank test of differences (n,), some of them infinite.

    The null hypothesis is that they lie symmetrically around zero, as they do where the methods can be
    exchanged. Zeros are ranked and then left out (Pratt). The distribution is exact given the ranks for up to
    50 differences, and normal for more, with a correction for continuity.

    Notes
    -----
    scipy's test is exact without ties and zeros only, or by all 2^n permutations, which take a thousand times
    as long.

    References
    ----------
    J. W. Pratt, Remarks on zeros and ties in the Wilcoxon signed rank procedures, JASA 54 (1959).

    Examples
    --------
    >>> import numpy as np
    >>> signed_rank_p(np.array([1.0, 2.0, 3.0, 4.0, 5.0, np.inf]))
    0.03125
    """
    from scipy.stats import rankdata, wilcoxon

    if not np.any(differences):
        return 1.0
    if len(differences) > _MOST_EXACT:
        finite = np.abs(differences[np.isfinite(differences)])
        beyond = 2.0 * float(np.max(finite, initial=0.0)) + 1.0
        ranked = np.where(np.isfinite(differences), differences, np.sign(differences) * beyond)
        return float(wilcoxon(ranked, zero_method="pratt", correction=True, method="asymptotic").pvalue)
    # Twice the ranks, which ties may share, are whole numbers.
    sizes = np.rint(2.0 * rankdata(np.abs(differences))).astype(int)
    counts = np.zeros(int(sizes.sum()) + 1)
    counts[0] = 1.0
    for size in sizes[differences != 0.0]:
        counts[size:] = counts[size:] + counts[:-size]
    positive = int(sizes[differences > 0.0].sum())
    tail = min(counts[: positive + 1].sum(), counts[positive:].sum()) / counts.sum()
    return min(1.0, 2.0 * float(tail))


def holm(p: ArrayLike) -> Array:
    """The p-values (m,) adjusted so that all of them below a level are wrong at most at that rate; nan stays.

    References
    ----------
    S. Holm, A simple sequentially rejective multiple test procedure, Scand. J. Statist. 6 (1979).

    Examples
    --------
    >>> holm([0.01, 0.04, 0.03])
    array([0.03, 0.06, 0.06])
    """
    p = np.asarray(p, dtype=float)
    known = np.flatnonzero(~np.isnan(p))
    order = known[np.argsort(p[known], kind="stable")]
    adjusted = np.full(len(p), np.nan)
    stepped = np.maximum.accumulate((len(order) - np.arange(len(order))) * p[order])
    adjusted[order] = np.minimum(stepped, 1.0)
    return adjusted


def trials_to_tell(tests: int) -> int:
    """The least number of trials in which one of so many tests can be significant at all.

    Of n differences without a zero, the least p-value is 2^(1 - n), and the first step of Holm's adjustment
    multiplies it by the number of tests.

    Examples
    --------
    >>> trials_to_tell(1), trials_to_tell(28)
    (6, 11)
    """
    return 1 + math.ceil(math.log2(max(tests, 1) / LEVEL))


def critical_difference(methods: int, cases: int) -> float:
    """The critical difference of average ranks of so many methods over so many cases, at 5 % (Nemenyi).

    References
    ----------
    J. Demsar, Statistical comparisons of classifiers over multiple data sets, JMLR 7 (2006), section 3.2.2.

    Examples
    --------
    >>> round(critical_difference(4, 14), 2)
    1.25
    """
    from scipy.stats import studentized_range

    q = float(studentized_range.ppf(1.0 - LEVEL, methods, np.inf)) / math.sqrt(2.0)
    return q * math.sqrt(methods * (methods + 1) / (6.0 * cases))


def shared_ranks(values: ArrayLike, equal: float = TIE) -> Array:
    """The ranks of values (m,), the lowest 1; equal ones, as in :func:`paired`, share the mean of theirs.

    Examples
    --------
    >>> shared_ranks([0.3, 0.1 + 0.2, 5.0, 0.1])
    array([2.5, 2.5, 4. , 1. ])
    """
    from scipy.stats import rankdata

    values = np.asarray(values, dtype=float)
    order = np.argsort(values, kind="stable")
    ordered = values[order]
    with np.errstate(invalid="ignore"):
        apart = np.diff(ordered) > equal * np.maximum(np.abs(ordered[1:]), np.abs(ordered[:-1]))
        apart |= np.isinf(ordered[1:]) & ~np.isinf(ordered[:-1])
    levels = np.empty(len(values))
    levels[order] = np.concatenate(([0], np.cumsum(apart)))
    return np.asarray(rankdata(levels))


def friedman_p(scores: Array) -> float:
    """The p-value of Friedman's test of scores (cases, methods), at least three; 1 where all always tie."""
    from scipy.stats import friedmanchisquare

    if np.all(scores == scores[:, :1]):
        return 1.0
    return float(friedmanchisquare(*scores.T).pvalue)


def groups_within(ranks: Sequence[float], reach: float) -> list[tuple[int, int]]:
    """The longest runs of increasing average ranks that span at most ``reach``, as first and last place.

    Examples
    --------
    >>> groups_within([1.0, 1.5, 2.2, 4.0], 1.0)
    [(0, 1), (1, 2)]
    """
    found: list[tuple[int, int]] = []
    for first, rank in enumerate(ranks):
        last = max(i for i, other in enumerate(ranks) if other - rank <= reach)
        if last > first and not (found and found[-1][1] >= last):
            found.append((first, last))
    return found
