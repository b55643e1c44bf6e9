"""The delay of a linear block that a regression on the newest input does not see, given or searched for.

Behind a block that delays its input by d samples, y_k depends on u_{k-d} and on what was before, so that the
regression of y_k on u_k is a constant. All that is needed is other pairs: u_{k-d} with y_k.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import PlainValidator, WithJsonSchema

from hident.arrays import Array, Flags, Index
from hident.errors import EstimationError
from hident.numerics.choices import first_least
from hident.numerics.parts import Parts, in_each, joined, longer_than
from hident.records import Record

FEWEST_PAIRS = 4
"""Pairs with which delays can be compared: two bins of two."""
# How rare a dependence would be by chance: on the newest input, if there is one; on an earlier one, if there
# clearly is. One on the newest counts for nothing beside what is as much rarer as this root says.
_UNLIKELY, _CERTAIN = 0.01, 1e-8
_NEVER, _LEAST = 1e-9, 1e-300
_BESIDE = 1 / 40
# Where inputs beside each other are alike, what depends on one seems to depend on another, even more.
_ALIKE = 0.5
# In how many records without any dependence a search may take a delay, and with how many shifts of the input
# it learns what chance makes of signals with a memory: the share that this part of them stays below.
_FALSE, _SHIFTS, _UPPER = 0.01, 19, 0.9
_GOLDEN = 0.6180339887498949


def _as_delay(value: Any) -> Any:
    if value == "search":
        return value
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**63:
        raise ValueError(f"must be a whole number of samples, 0 or more, or 'search', not {value!r}")
    return value


Delay = Annotated[
    Literal["search"] | int,
    PlainValidator(_as_delay),
    WithJsonSchema({"anyOf": [{"const": "search"}, {"type": "integer", "minimum": 0}]}),
]
"""A whole number of samples, or ``search``."""


@dataclass(frozen=True, eq=False)
class SomeSamples(Record):
    """The outputs of ``whole`` that are ``kept``, as they are or filtered, and an input for each.

    ``kept`` (N of ``whole``,) tells of each output whether it is.
    """

    whole: Record | None = None
    kept: Flags | None = None


def delayed(record: Record, delay: int, first: int | None = None) -> SomeSamples:
    """The pairs (u_{k-delay}, y_k) of each experiment, from k = ``first`` on (default: ``delay``).

    Experiments without such a pair are left out.

    Raises
    ------
    EstimationError
        If no experiment has one.

    Examples
    --------
    >>> later = delayed(Record(np.arange(4.0), np.arange(4.0)), 1)
    >>> later.u, later.y
    (array([0., 1., 2.]), array([1., 2., 3.]))
    """
    first = delay if first is None else first
    long = longer_than(record.experiments, first)
    u, y = _pairs(record, long, delay, first)
    u.flags.writeable = y.flags.writeable = False
    places = joined(part.stop - part.start - first for part in long)
    named = [(name, part) for name, part in record.parts.items() if part.samples in long]
    parts = {
        name: replace(part, start=place.start, stop=place.stop)
        for (name, part), place in zip(named, places, strict=False)
    }
    kept = np.zeros(len(record), dtype=bool)
    for part in long:
        kept[part.start + first : part.stop] = True
    return SomeSamples(u, y, record.dt, record.truth, parts, whole=record, kept=kept)


def _pairs(record: Record, long: Parts, delay: int, first: int) -> tuple[Array, Array]:
    """u_{k-delay} and y_k, k = ``first``, ..., of the experiments in ``long``."""
    if not long:
        raise EstimationError(f"no experiment holds more than the {first} samples that the delay takes")
    u = in_each(long, lambda u: u[first - delay : len(u) - delay], record.u)
    return u, in_each(long, lambda y: y[first:], record.y)


@dataclass(frozen=True, eq=False)
class DelaySearch:
    """The share of the output's variance that each delay 0, 1, ... leaves, (D,); ``details["delay"]``.

    It is nan where the block could not be undone with that delay.
    """

    unexplained: Array
    chosen: int


def search_delay(outputs: Callable[[int, int], Record], largest: int) -> DelaySearch:
    """The delay from 0 to ``largest`` on whose input the output depends most, the shortest among ties.

    ``outputs`` gives the pairs of a delay whose outputs begin at a sample of each experiment, with what
    undoes the linear block done. Each delay is judged by :func:`unexplained`.

    Raises
    ------
    EstimationError
        If no delay has such pairs; if none explains more than chance would in one of a hundred records whose
        output depends on none of these inputs; or if the one behind the last explains more still.
    """
    found: dict[int, Record] = {}
    left, refused = np.full(largest + 1, np.nan), ""
    for delay in range(largest + 1):
        try:
            found[delay] = outputs(delay, largest)
        except (EstimationError, np.linalg.LinAlgError) as error:
            refused = f" (the last: {error})"
        else:
            left[delay] = unexplained(found[delay].u, found[delay].y)
    if not found:
        raise EstimationError(f"no delay from 0 to {largest} can be judged{refused}")
    chosen = first_least(left, scale=1.0)
    if (chance := _beside_shifts(found[chosen].u, found[chosen].y)) * len(found) > _FALSE:
        raise EstimationError(
            f"the output depends on no input of 0 to {largest} samples before by more than chance makes (p = "
            f"{chance:.2g} at {chosen}, which tells most of it): raise 'largest_delay', or give the 'delay'"
        )
    if chosen == largest and _grows(outputs, largest):
        raise EstimationError(
            f"the output depends more on the input of {largest + 1} samples before than on any of 0 to "
            f"{largest}: raise 'largest_delay', or give the 'delay'"
        )
    return DelaySearch(left, chosen)


def _grows(outputs: Callable[[int, int], Record], delay: int) -> bool:
    """Whether the delay behind this one explains more, of the outputs that both have."""
    try:
        own, later = (outputs(one, delay + 1) for one in (delay, delay + 1))
    except (EstimationError, np.linalg.LinAlgError):
        return False
    return unexplained(later.u, later.y) < unexplained(own.u, own.y)


def unexplained(u: Array, y: Array) -> float:
    """The share of the variance of ``y`` (N,) that its regressogram on ``u`` (N,) leaves; 1 for none.

    The regressogram (Tukey 1961) is the mean of y in each of about sqrt(N) bins of equally many samples, with
    equal inputs in one bin. It needs no bandwidth, whatever the distribution of u.

    Examples
    --------
    >>> u = np.random.default_rng(1).uniform(-1, 1, 400)
    >>> round(unexplained(u, u**2), 2), round(unexplained(np.roll(u, 1), u**2), 1)
    (0.01, 1.0)
    """
    deviations = y - y.mean()
    total = float(deviations @ deviations)
    if not total > 0.0:
        return 1.0
    n, count = len(u), _bins(len(u))
    edges: Array = np.sort(u)[n * np.arange(1, count) // count]
    bins: Index = np.searchsorted(edges, u, side="right")
    sizes, sums = np.bincount(bins), np.bincount(bins, deviations)
    filled = sizes > 0
    return 1.0 - float(np.sum(sums[filled] ** 2 / sizes[filled])) / total


def _bins(n: int) -> int:
    return max(2, math.isqrt(n))


def late(record: Record, largest: int) -> int:
    """The delay up to ``largest`` on whose input the output clearly depends, if not on the newest; else 0.

    The share of the variance that a regressogram explains of independent signals has a beta distribution. The
    newest input must explain no more than chance does, alone (p > 0.01) or beside an earlier one (p above the
    40th root of its p), and that one what chance never would (p < 1e-9). Where experiments have intervals of
    their own, no lag is one time, and the delay is 0; nor is one noticed where inputs up to ``largest``
    samples apart have a correlation beyond 0.5.

    The levels are our own. Of records without a delay (30 to 500 samples of polynomials, a dead zone and an
    absolute value, before a pole at 0.5 to 0.995) none was noticed to have one: of 19 200 with inputs that
    were independent or AR(1) with 0.3, and of 30 000 with 0.4 to 0.9. docs/concepts.md has the rates at
    which one is noticed, and ``TestRatesOfNoticing`` measures both on other seeds.

    Examples
    --------
    >>> u = np.random.default_rng(1).uniform(-1, 1, 400)
    >>> [late(Record(u, np.roll(u**2, delay)), 10) for delay in (0, 1, 3)]
    [0, 1, 3]
    """
    if len({part.dt for part in record.parts.values()}) > 1 or len(record) <= largest + FEWEST_PAIRS:
        return 0
    if not np.isfinite(record.y).all() or (newest := _by_chance(record.u, record.y)) < _CERTAIN:
        return 0
    lags = range(1, largest + 1)
    pairs = {lag: _pairs(record, longer_than(record.experiments, lag), lag, lag) for lag in lags}
    chances = [1.0, *(_by_chance(u, y) for u, y in pairs.values())]
    best = int(np.argmin(chances))
    least = max(chances[best], _LEAST)
    if least >= _NEVER or newest <= min(_UNLIKELY, least**_BESIDE):
        return 0
    return 0 if any(_alike(record, lag) > _ALIKE for lag in lags) else best


def _alike(record: Record, lag: int) -> float:
    """The size of the correlation of inputs ``lag`` samples apart."""
    before, now = _pairs(replace(record, y=record.u), longer_than(record.experiments, lag), lag, lag)
    size = np.std(now) * np.std(before)
    return float(abs(np.mean((now - now.mean()) * (before - before.mean()))) / size) if size > 0.0 else 0.0


def _by_chance(u: Array, y: Array, factor: float = 1.0) -> float:
    """The probability that a regressogram on an independent ``u`` (N,) explains as much of ``y`` (N,).

    ``factor`` is how many times as much it explains by chance as it would if samples were independent.
    """
    from scipy.special import betainc

    n, bins = len(u), _bins(len(u))
    left = min(max(unexplained(u, y), 0.0), 1.0)
    left = left / (left + (1.0 - left) / factor)
    # Of the normal distribution; other outputs are near enough to it for levels this far apart.
    return float(betainc((n - bins) / 2.0, (bins - 1) / 2.0, left))


def _beside_shifts(u: Array, y: Array) -> float:
    """:func:`_by_chance` for signals with a memory: of these, chance explains what other shifts of u do.

    Not the most that one of them does, which may be a delay; and no two shifts have a period in common.
    """
    from scipy.special import betaincinv

    n, bins = len(u), _bins(len(u))
    shifts = np.unique((n * ((np.arange(1, _SHIFTS + 1) * _GOLDEN) % 1.0)).astype(int))
    explained = [1.0 - unexplained(np.roll(u, shift), y) for shift in shifts.tolist()]
    usual = float(betaincinv((bins - 1) / 2.0, (n - bins) / 2.0, _UPPER))
    found = float(np.quantile(explained, _UPPER))
    if not 0.0 < found < 1.0:
        return _by_chance(u, y)
    return _by_chance(u, y, max(1.0, (found / (1.0 - found)) / (usual / (1.0 - usual))))
