"""Tests of a model's residuals: what they still tell of themselves, of the input, of time.

=========  ==========================================================================================
e          residuals of one or several experiments, shape (N,); ``parts`` say where each stands
w          their innovations A(q) e, where A is an autoregression fitted to e (Burg, order by AIC)
x          a signal that is known without the noise, such as the input or a function of it
M          how many lags are looked at
=========  ==========================================================================================

No product of two samples reaches from one experiment into another.

Of coloured residuals a plain correlation test against x rejects a true model far too often. So the test is
that of w against the same filter's A(q) x at all lags together: by an F test of regression, which is the
Lagrange multiplier test of e = x theta + v with autoregressive v, given x. Lags reach as far as the output
remembers; where they are several samples apart, the means over these samples are tested. The single
correlations, which a figure shows, are those of e and x themselves, with bands by Bartlett's formula for two
independent series, N var r = sum_j rho_e(j) rho_x(j) (Box, Jenkins, Reinsel, Time Series Analysis, 4th ed.,
12.1.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from hident.arrays import Array
from hident.errors import EstimationError
from hident.numerics.autoregression import burg
from hident.numerics.choices import first_least
from hident.numerics.parts import Parts, following, in_each, longer_than, whole

FEWEST = 40
"""The fewest residuals that are judged."""
_MOST_LAGS = 20
_MOST_ORDER = 20
# How many times the correlation time of the output the lags reach.
_MEMORIES = 4
# Samples of the longest experiment for each lag.
_FOR_A_LAG = 10
# Directions of the lagged signals that are weaker than this, relative to the strongest, are left out.
_WEAK = 1e-10
# A function of the input that differs by less, relative to its size, from a line is one.
_LINE = 1e-6
_CHUNK = 4096


@dataclass(frozen=True)
class Tested:
    """The statistic of a test, and the chance of a larger one where there is nothing to be found."""

    statistic: float
    p_value: float


@dataclass(frozen=True, eq=False)
class Correlations:
    """Correlations (L,) of the residuals with a signal ``lags`` (L,) samples before, and their test.

    ``band`` (L,) is half the width around zero that one of them leaves with the probability of the level.
    """

    of: str
    lags: NDArray[np.int64]
    values: Array
    band: Array
    test: Tested

    @property
    def largest(self) -> int:
        """The place of the one that is largest relative to its band."""
        return int(np.argmax(np.abs(self.values) / self.band))


def count_of_lags(parts: Parts) -> int:
    """How many lags are looked at: 20, or a tenth of the longest experiment.

    Raises
    ------
    EstimationError
        If there are too few residuals.
    """
    lengths: list[int] = [part.stop - part.start for part in parts]
    if sum(lengths) < FEWEST or max(lengths) < 2 * _FOR_A_LAG:
        raise EstimationError(
            f"{sum(lengths)} residuals, at most {max(lengths)} in one experiment, are too few to be judged: "
            f"{FEWEST} are needed, and {2 * _FOR_A_LAG} in one experiment"
        )
    return min(_MOST_LAGS, max(lengths) // _FOR_A_LAG)


def whiteness(e: Array, parts: Parts | None = None, *, level: float = 0.01, fitted: int = 0) -> Correlations:
    """Autocorrelations of residuals (N,) at lags 1 to M, and the test of Ljung and Box over all of them.

    Parameters
    ----------
    fitted : int
        How many parameters of a noise model the residuals took, by which the degrees of freedom are fewer.

    Examples
    --------
    >>> e = np.random.default_rng(1).normal(size=1000)
    >>> round(whiteness(e).test.p_value, 2), whiteness(e[1:] + 0.5 * e[:-1]).values[:1].round(2)
    (0.37, array([0.38]))
    """
    from scipy.special import chdtrc

    parts = parts or whole(len(e))
    e, lags = e - np.mean(e), np.arange(1, count_of_lags(parts) + 1, dtype=np.int64)
    _require_power(power := float(e @ e))
    values = np.array([_product(e, e, k, parts) for k in lags.tolist()]) / power
    pairs = np.array([sum(max(part.stop - part.start - k, 0) for part in parts) for k in lags])
    statistic = len(e) * (len(e) + 2) * float(np.sum(values**2 / pairs))
    p_value = float(chdtrc(max(len(lags) - fitted, 1), statistic))
    band = _reach(level) * np.sqrt(pairs) / len(e)
    return Correlations("residuals", lags, values, band, Tested(statistic, p_value))


def _require_power(power: float) -> None:
    if not power > 0.0:
        raise EstimationError("residuals that are constant, or a line in time, are no noise to judge by")


def _product(e: Array, x: Array, k: int, parts: Parts) -> float:
    """The sum of e_t x_{t-k} over all t of which both stand in one experiment."""
    pieces = ((e[part], x[part]) for part in longer_than(parts, k))
    return float(sum(a[k:] @ b[: len(b) - k] for a, b in pieces))


def _reach(level: float) -> float:
    return NormalDist().inv_cdf(1.0 - level / 2.0)


@dataclass(frozen=True, eq=False)
class Innovations:
    """What makes residuals white: w_t = e_t - a_1 e_{t-1} - ... - a_p e_{t-p}, by ``a`` (p,).

    ``variance`` is that of w.
    """

    a: Array
    variance: float
    parts: Parts

    @classmethod
    def of(cls, e: Array, parts: Parts | None = None, highest: int | None = None) -> Innovations:
        """Those of residuals (N,) about their mean, of the order that Akaike's criterion chooses.

        Examples
        --------
        >>> e = np.random.default_rng(1).normal(size=5000)
        >>> Innovations.of(e[1:] + 0.9 * e[:-1]).a[:2].round(1)
        array([ 0.9, -0.8])
        """
        parts = parts or whole(len(e))
        order = min(_MOST_ORDER, count_of_lags(parts)) if highest is None else highest
        models = burg(e - np.mean(e), order, parts)
        _require_power(models[0].variance)
        with np.errstate(divide="ignore"):
            # What is predicted exactly has the logarithm -inf, and is no model of noise.
            criterion = [len(e) * np.log(model.variance) + 2.0 * p for p, model in enumerate(models)]
        chosen = models[first_least(criterion, scale=float(len(e)))]
        return cls(chosen.a, chosen.variance, parts)

    @classmethod
    def beyond(cls, e: Array, x: Array, parts: Parts, stride: int = 1) -> Innovations:
        """Those of what residuals (N,) hold beyond what depends linearly on past samples of ``x`` (N,).

        A filter that whitened what depends on x as well would colour the noise.
        """
        lags, plain = count_of_lags(parts), cls(np.empty(0), 1.0, parts)
        past = plain.filtered(x - np.mean(x), lags, stride)
        columns, now = np.column_stack([np.ones(len(past)), past]), plain.white(e, lags, stride)
        rest = now - columns @ np.linalg.lstsq(columns, now, rcond=None)[0]
        kept = following(parts, (lags + 1) * stride - 1)
        return replace(cls.of(rest, kept, min(_MOST_ORDER, lags)), parts=parts)

    def filtered(self, x: Array, lags: int = 0, stride: int = 1) -> Array:
        """A(q) x of a signal (N,) at ``lags`` + 1 lags, a column each, in the rows of :meth:`rows`.

        Of a ``stride`` of several samples, column j is the mean over the lags from j to j + 1 strides.
        """

        def lagged(x: Array) -> Array:
            means = np.convolve(self._known(x), np.full(stride, 1.0 / stride), "valid")
            return np.lib.stride_tricks.sliding_window_view(means, lags * stride + 1)[:, ::-stride]

        return in_each(self._long(lags, stride), lagged, x)

    def white(self, x: Array, lags: int = 0, stride: int = 1) -> Array:
        """A(q) x of a signal (N,) as it is, in the same rows."""
        lost = (lags + 1) * stride - 1
        return in_each(self._long(lags, stride), lambda x: self._known(x)[lost:], x)

    def rows(self, x: Array, lags: int = 0, stride: int = 1) -> Array:
        """The samples of a signal (N,) that have all of these lags, and those of the filter, before them."""
        lost = self._lost(lags, stride)
        return in_each(self._long(lags, stride), lambda x: x[lost:], x)

    def _known(self, x: Array) -> Array:
        return np.convolve(x, np.r_[1.0, -self.a], "valid")

    def _lost(self, lags: int, stride: int) -> int:
        return (lags + 1) * stride - 1 + len(self.a)

    def _long(self, lags: int, stride: int) -> Parts:
        return longer_than(self.parts, self._lost(lags, stride))

    def spectrum(self, n: int) -> Array:
        """The power of e relative to its variance at the n//2 + 1 frequencies of a real transform."""
        power = 1.0 / np.abs(np.fft.rfft(np.r_[1.0, -self.a], n)) ** 2
        return np.asarray(power / np.mean(np.r_[power, power[1 : (n + 1) // 2]]))


def dependence(
    of: str,
    e: Array,
    x: Array,
    innovations: Innovations,
    *,
    beside: tuple[Array, ...] = (),
    stride: int = 1,
    level: float = 0.01,
) -> Correlations:
    """Correlations of residuals with a signal 0 to M strides before, and the test over all of these lags.

    Parameters
    ----------
    of : str
        What the signal is called.
    e, x : arrays, shape (N,)
        Residuals, and a signal that does not depend on their noise.
    innovations : Innovations
        Those of ``e``.
    beside : tuple of arrays
        Signals whose own lags do not count: what of ``x`` they explain, is theirs.
    stride : int
        Samples from one lag to the next; :func:`lag_stride` gives one that reaches far enough. The test takes
        the means of the signal over each stride, the correlations are those with single samples.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> u, e = rng.normal(size=(2, 1000))
    >>> e[3:] += 0.3 * u[:-3]
    >>> found = dependence("u", e, u, Innovations.of(e))
    >>> int(found.lags[found.largest]), found.test.p_value < 1e-6
    (3, True)
    """
    parts, lags = innovations.parts, count_of_lags(innovations.parts)
    e, x = e - np.mean(e), x - np.mean(x)
    one = innovations.filtered(np.ones(len(e)), lags, stride)[:, :1]
    others = [innovations.filtered(other - np.mean(other), lags, stride) for other in beside]
    w = innovations.white(e, lags, stride)
    test = regression_test(w, innovations.filtered(x, lags, stride), [one, *others], len(innovations.a))
    size = float(np.sqrt((e @ e) * (x @ x)))
    at = stride * np.arange(lags + 1, dtype=np.int64)
    values = np.array([_product(e, x, k, parts) for k in at.tolist()]) / size
    band = _reach(level) * np.sqrt(_bartlett(x, innovations) / len(e))
    return Correlations(of, at, values, np.full(lags + 1, band), test)


def lag_stride(y: Array, parts: Parts | None = None) -> int:
    """Samples from one lag to the next with which M of them reach as far as the system remembers.

    M lags then take four times the samples after which the autocorrelation of the output (N,) has fallen to
    1/e, but no more than a quarter of the longest experiment: of a system that is sampled fast, 20 samples
    would not reach beyond its delay.

    Examples
    --------
    >>> slow = np.repeat(np.random.default_rng(1).normal(size=200), 20)
    >>> lag_stride(np.random.default_rng(1).normal(size=1000)), lag_stride(slow)
    (1, 2)
    """
    parts = parts or whole(len(y))
    pieces = [y[part] - np.mean(y) for part in parts]
    lags, longest = count_of_lags(parts), max(map(len, pieces))
    n = _padded(longest)
    products = np.fft.irfft(_power(pieces, n), n)[:longest]
    below = np.flatnonzero(products < products[0] / np.e)
    remembered = int(below[0]) if len(below) else longest
    return max(1, min(round(_MEMORIES * remembered / lags), longest // (4 * lags)))


def _bartlett(x: Array, innovations: Innovations) -> float:
    """sum_j rho_e(j) rho_x(j), with the autocorrelations of x inside each experiment."""
    pieces = [x[part] for part in innovations.parts]
    n = _padded(max(map(len, pieces)))
    both = _power(pieces, n) * innovations.spectrum(n)
    return float(np.mean(np.r_[both, both[1 : (n + 1) // 2]]) / (x @ x))


def _padded(longest: int) -> int:
    """A length at which transforms are quick and no product of two samples wraps around."""
    from scipy.fft import next_fast_len

    return int(next_fast_len(2 * longest, real=True))


def _power(pieces: Sequence[Array], n: int) -> Array:
    """The sum of the pieces' periodograms at the frequencies of a real transform of length ``n``."""
    return np.asarray(sum(np.abs(np.fft.rfft(piece, n)) ** 2 for piece in pieces))


def regression_test(w: Array, columns: Array, others: Sequence[Array] = (), spent: int = 0) -> Tested:
    """Whether ``columns`` (n, k) explain more of ``w`` (n,) than all ``others`` (n, l) do: an F test.

    ``spent`` is how many parameters ``w`` took before.

    Raises
    ------
    EstimationError
        If the rows are too few, or the columns say nothing that the others do not.
    """
    from scipy.special import fdtrc

    gram = _products([*others, columns, w[:, None]])
    left, known = _unexplained(gram, sum(other.shape[1] for other in others))
    less, rank = _unexplained(gram, len(gram) - 1)
    free = len(w) - rank - spent
    if free < 1:
        raise EstimationError(f"{len(w)} residuals are too few for {rank} regressors and {spent} before them")
    if rank == known:
        raise EstimationError("the signal is a sum of those that the residuals are tested beside")
    statistic = (max(left - less, 0.0) / (rank - known)) / (less / free)
    return Tested(float(statistic), float(fdtrc(rank - known, free, statistic)))


def _products(columns: Sequence[Array]) -> Array:
    """The products of all columns with each other, each column divided by its length."""
    # In chunks that stay in the cache.
    rows = range(0, len(columns[0]), _CHUNK)
    chunks = (np.hstack([some[i : i + _CHUNK] for some in columns]) for i in rows)
    gram = sum(chunk.T @ chunk for chunk in chunks)
    length = np.sqrt(np.diag(gram))
    length[length == 0.0] = 1.0
    return np.asarray(gram / np.outer(length, length))


def _unexplained(gram: Array, count: int) -> tuple[float, int]:
    """The share of the last column's square that the first ``count`` leave, and their rank."""
    if not count:
        return float(gram[-1, -1]), 0
    values, vectors = np.linalg.eigh(gram[:count, :count])
    strong = values > _WEAK * values[-1]
    along = vectors[:, strong].T @ gram[:count, -1]
    return float(gram[-1, -1] - np.sum(along**2 / values[strong])), int(np.count_nonzero(strong))


def nonlinear_functions(u: Array, y_hat: Array) -> dict[str, Array]:
    """Functions of the input and of the model's output, both (N,), by name, without what a line in u tells.

    The model's output stands for y, which holds the noise itself. Both are taken about their means. A
    function that is a line on these inputs, as u^2 is of a binary input, is left out.

    Examples
    --------
    >>> list(nonlinear_functions(np.array([1.0, -1.0, 1.0, 1.0]), np.array([1.0, 2.0, 4.0, 3.0])))
    ['u y', 'y^2']
    """
    u, y = _standardised(u), _standardised(y_hat)
    power = float(u @ u) or 1.0
    found = {}
    for name, x in (("u^2", u**2), ("u^3", u**3), ("|u|", np.abs(u)), ("u y", u * y), ("y^2", y**2)):
        rest = x - np.mean(x)
        rest = rest - u * (float(u @ rest) / power)
        if rest @ rest > _LINE**2 * (x @ x):
            found[name] = rest
    return found


def _standardised(x: Array) -> Array:
    deviation = float(np.std(x))
    return (x - np.mean(x)) / (deviation if deviation > 0.0 else 1.0)


@dataclass(frozen=True)
class Normality:
    """The shape of the innovations' distribution, and the test of D'Agostino and Pearson."""

    skewness: float
    excess_kurtosis: float
    test: Tested


def normality(w: Array) -> Normality:
    """Whether innovations (n,) are normal, by their skewness and kurtosis.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> normal, flat = normality(rng.normal(size=1000)), normality(rng.random(1000))
    >>> round(normal.test.p_value, 2), round(flat.excess_kurtosis, 1)
    (0.48, -1.2)
    """
    from scipy import stats

    statistic, p_value = stats.normaltest(w)
    test = Tested(float(statistic), float(p_value))
    return Normality(float(stats.skew(w)), float(stats.kurtosis(w)), test)


@dataclass(frozen=True)
class Drift:
    """How residuals change with time inside an experiment.

    ``change`` is that of their mean, and ``growth`` that of their variance relative to its mean, from the
    beginning to the end of the longest experiment.
    """

    change: float
    growth: float
    mean: Tested
    variance: Tested

    @property
    def test(self) -> Tested:
        """Both tests as one: the smaller p-value, doubled, and its statistic."""
        less = min(self.mean, self.variance, key=lambda test: test.p_value)
        return Tested(less.statistic, min(1.0, 2.0 * less.p_value))


def drift(e: Array, parts: Parts | None = None) -> Drift:
    """Whether residuals (N,) have a trend in their mean or in their variance, the same in all experiments.

    Examples
    --------
    >>> e = np.random.default_rng(1).normal(size=1000)
    >>> found = drift(e + np.linspace(0.0, 1.0, 1000))
    >>> round(found.change, 1), found.mean.p_value < 1e-6, found.variance.p_value > 0.01
    (1.0, True, True)
    """
    parts = parts or whole(len(e))
    longest = max(part.stop - part.start for part in parts)
    time = in_each(parts, lambda x: (np.arange(len(x)) - (len(x) - 1) / 2.0) / longest, e)
    e = e - np.mean(e)
    slope = float(time @ e / (time @ time))
    innovations = Innovations.of(e - slope * time, parts)
    one = np.ones(len(e))
    when, one = innovations.filtered(time), innovations.filtered(np.ones(len(e)))
    mean = regression_test(innovations.white(e), when, [one], len(innovations.a))
    power = innovations.white(e - slope * time) ** 2
    when = innovations.rows(time)[:, None]
    variance = regression_test(power, when, [np.ones_like(when)])
    about = when[:, 0] - np.mean(when)
    growth = float(about @ power / (about @ about) / np.mean(power))
    return Drift(slope, growth, mean, variance)


def offset(e: Array, innovations: Innovations) -> Tested:
    """Whether the mean of residuals (N,) is zero.

    Examples
    --------
    >>> e = np.random.default_rng(1).normal(size=1000)
    >>> offset(e, Innovations.of(e)).p_value > 0.01, offset(e + 0.5, Innovations.of(e)).p_value < 1e-6
    (True, True)
    """
    w, one = innovations.white(e), innovations.filtered(np.ones(len(e)))
    return regression_test(w, one, spent=len(innovations.a))


def uneven_spread(e: Array, y_hat: Array, innovations: Innovations) -> Tested:
    """Whether the variance of residuals (N,) depends on the model's output (N,) or on its square.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> y, e = rng.normal(size=(2, 1000))
    >>> relative = e * (1.0 + 0.5 * np.abs(y))
    >>> [uneven_spread(e, y, Innovations.of(e)).p_value < 0.01 for e in (e, relative)]
    [False, True]
    """
    w = innovations.white(e - np.mean(e))
    y = _standardised(innovations.rows(y_hat))
    return regression_test(w**2, np.column_stack([y, y**2]), [np.ones((len(w), 1))])
