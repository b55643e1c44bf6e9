"""Structures and orders tried on a record, and one chosen by samples that were kept apart."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hident.arrays import Array
from hident.block_chain import BlockChain, Start
from hident.config.spec import canonical
from hident.errors import EstimationError
from hident.estimators.base import require_usable
from hident.estimators.prediction_error.block_specs import LinearBlock
from hident.estimators.prediction_error.chain_fit import ChainFit, fit_chain
from hident.estimators.prediction_error.criterion import Data, simulated
from hident.estimators.prediction_error.prediction_error import PredictionError
from hident.identification.candidates import FIRST_STATIC, STATIC, STRUCTURES, Orders, chain, orders_of
from hident.identification.continuation import continued
from hident.measurements.delay import correlation, delay
from hident.numerics.judgement import Residuals, judgement
from hident.numerics.parts import Parts, following, joined
from hident.records import Estimate, Record

# Orders are compared by short fits to so many samples, static functions by whole fits to more.
_COMPARED, _ORDERS, _ORDER_ITERATIONS, _FUNCTION_ITERATIONS = 12000, 4000, 25, 50
_LINEAR_STARTS, _HIGHEST = 2, 10
# The share of each experiment that is kept apart where nothing else is.
_KEPT_APART = 0.2
# First samples that are not fitted: at most this many, and this share of an experiment.
_MOST_INITIAL, _INITIAL_SHARE = 250, 20
_BATCHES, _FEWEST, _WHOLE = 20, 20, 2
# Blocks of so many samples whose variance is below this part of the mean one are at rest.
_BLOCK, _AT_REST, _SEVERAL = 50, 0.01, 10
# Short fits of higher orders that gain less than this have gained nothing.
_CLOSE = 1.03
_MOST_LINEAR, _MORE_LINEAR, _MANY = 4, 8, 5000


@dataclass(frozen=True, eq=False)
class Trial:
    """A chain that was tried, and its fit; ``reason`` says why there is none.

    ``estimation`` is the root mean squared error that was fitted, ``validation`` the squared errors (M,) of
    the simulation of the samples kept apart.
    """

    structure: str
    spec: PredictionError
    count: int = 0
    fit: ChainFit | None = None
    estimation: float = np.inf
    validation: Array = field(default_factory=lambda: np.zeros(0))
    reason: str = ""

    @property
    def rms(self) -> float:
        """The root mean squared error on the samples kept apart; infinite without a fit."""
        return float(np.sqrt(np.mean(self.validation))) if len(self.validation) else np.inf

    @property
    def bic(self) -> float:
        """Schwarz's criterion of the errors that were fitted."""
        assert self.fit is not None
        n = self.fit.point.data.count
        return n * float(np.log(max(self.estimation, 1e-300) ** 2)) + self.count * float(np.log(n))


@dataclass(frozen=True, eq=False)
class Split:
    """What is fitted, and what is kept apart: the samples ``kept`` of ``validation``, ``said`` in words."""

    estimation: Data
    everything: Data
    validation: Data
    kept: Any
    kept_experiments: Parts
    said: str

    def simulated(self, model: BlockChain) -> Array:
        """The output of a chain at the samples kept apart."""
        return np.asarray(simulated(self.validation, model)[self.kept])

    @property
    def output(self) -> Array:
        """The measured output at the samples kept apart."""
        return np.asarray(self.validation.y[self.kept])

    @property
    def input(self) -> Array:
        """The input at the samples kept apart."""
        return np.asarray(self.validation.u[self.kept])


def split(record: Record, n_init: int | None, start: Start = "settled") -> Split:
    """The validation record if there is one, else the last fifth of each experiment."""
    shortest = min(part.stop - part.start for part in record.experiments)
    initial = min(_MOST_INITIAL, shortest // _INITIAL_SHARE) if n_init is None else n_init
    quiet = quiet_beginning(record, 2 * initial) if len(record.experiments) == 1 else 0
    u, y = record.u[quiet:], record.y[quiet:]
    experiments = (slice(0, len(u)),) if quiet else record.experiments
    everything = Data(u, y, experiments, start, initial)
    if record.validation is not None:
        other = record.validation
        kept = Data(other.u, other.y, other.experiments, start, initial)
        return Split(
            everything,
            everything,
            kept,
            kept.counted,
            following(kept.experiments, initial),
            f"the record for validation, {kept.count} samples",
        )
    cuts = [part.start + round((part.stop - part.start) * (1.0 - _KEPT_APART)) for part in record.experiments]
    cuts = [cut - quiet for cut in cuts]
    firsts = [slice(part.start, cut) for part, cut in zip(experiments, cuts, strict=True)]
    lasts = [np.arange(cut, part.stop) for part, cut in zip(experiments, cuts, strict=True)]
    u, y = (np.concatenate([signal[first] for first in firsts]) for signal in (u, y))
    several = " of each experiment" if len(firsts) > 1 else ""
    tails = np.concatenate(lasts)
    return Split(
        Data(u, y, joined(first.stop - first.start for first in firsts), start, initial),
        everything,
        everything,
        tails,
        joined(map(len, lasts)),
        f"the last fifth{several}, {len(tails)} samples",
    )


@dataclass(frozen=True, eq=False)
class Identification:
    """All that was tried, and what was chosen, see :func:`identify` (which has an example).

    ``chosen`` is the trial with the fewest numbers (of a long record, the best) among those whose mean
    squared error on the samples kept apart is within one standard error of the least (of the difference, in
    batches; ``within`` counts the places of these trials), ``model_fit`` its fit to all samples, and
    ``parts`` what it was chosen by.
    """

    trials: tuple[Trial, ...]
    within: frozenset[int]
    chosen: Trial
    model_fit: ChainFit
    parts: Split

    def estimate(self, record: Record) -> Estimate:
        """The chosen model, fitted to all of the record."""
        return self.chosen.spec.estimate(self.model_fit, record)

    def residuals(self) -> Residuals:
        """What the chosen model leaves of the samples kept apart, before it was fitted to all.

        Raises
        ------
        EstimationError
            If these are too few to judge by.
        """
        assert self.chosen.fit is not None
        made = self.parts.simulated(self.chosen.fit.point.parameters.chain)
        return judgement(self.parts.input, self.parts.output, made, self.parts.kept_experiments)


def quiet_beginning(record: Record, kept: int) -> int:
    """How many first samples say nothing, as input and output are at rest; ``kept`` of the rest stay.

    A rest has its own noise and its own drift, which a fit would take for the system's.
    """
    blocks = len(record) // _BLOCK
    if blocks < _SEVERAL:
        return 0
    spreads = [
        np.var(signal[: blocks * _BLOCK].reshape(blocks, _BLOCK), axis=1) for signal in (record.u, record.y)
    ]
    moves = np.any([spread > _AT_REST * np.mean(spread) for spread in spreads], axis=0)
    # A block that moves by itself, as a record's first may, is no beginning.
    mostly = np.convolve(moves, np.full(_SEVERAL, 1.0 / _SEVERAL), "valid") >= 0.5
    return max(int(np.argmax(mostly)) * _BLOCK - kept, 0)


def identify(
    record: Record,
    structures: Sequence[str] = tuple(STRUCTURES),
    *,
    n_init: int | None = None,
    start: Start = "settled",
    tell: Callable[[Trial], None] = lambda trial: None,
) -> Identification:
    """Try structures on a record.

    Parameters
    ----------
    record : Record
        Measured or simulated; its ``validation`` is what the choice is made by, else the last fifth of each
        of its experiments, simulated from the record's beginning.
    structures : sequence of str
        Names among :data:`hident.identification.candidates.STRUCTURES`.
    n_init : int, optional
        First samples of each experiment that are not fitted; by default 250, or a twentieth of the shortest.
    start : {"settled", "rest"}
        What was before the record: its first input for ever, or nothing.
    tell : callable
        Is given each trial when it is done.

    Raises
    ------
    EstimationError
        If the record is constant or too short, or nothing could be fitted.

    Examples
    --------
    >>> import hident as hi
    >>> valve = hi.DeadZone(low=-1, high=1)
    >>> system = hi.Hammerstein(nonlinearity=valve, linear=hi.Arma(a=[0.7], b=[0, 0.3]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-3, high=3), 300)
    >>> found = identify(record, ["hammerstein"])
    >>> found.chosen.structure, round(found.estimate(record).linear.a[0], 2)
    ('hammerstein', 0.7)
    """
    import scipy.linalg  # noqa: F401  (its BLAS must be loaded to be held)
    from threadpoolctl import threadpool_limits

    require_usable(record)
    # On matrices of a few rows, BLAS's threads take several times the processor time of one.
    with threadpool_limits(1):
        return _identified(record, structures, n_init, start, tell)


def _identified(
    record: Record,
    structures: Sequence[str],
    n_init: int | None,
    start: Start,
    tell: Callable[[Trial], None],
) -> Identification:
    parts = split(record, n_init, start)
    if parts.estimation.count < _FEWEST or len(parts.output) < _FEWEST:
        raise EstimationError(
            f"{parts.estimation.count} samples to fit and {len(parts.output)} to choose by are too few: at "
            f"least {_FEWEST} of each, beside the first {parts.everything.n_init} samples"
        )
    initial = parts.everything.n_init
    short = parts.estimation.busiest(_COMPARED)
    trials: list[Trial] = []

    def tried(trial: Trial) -> Trial:
        trials.append(trial)
        tell(trial)
        return trial

    lag = first_lag(parts.estimation)
    highest = _MORE_LINEAR if len(short.u) >= _MANY else _MOST_LINEAR
    few = short.busiest(_ORDERS)
    linear = [
        tried(_fitted("linear", spec, few, parts, _LINEAR_STARTS))
        for n in range(1, highest + 1)
        for spec in [chain("linear", orders_of("linear", n, lag), {}, n_init=initial, start=start)]
    ]
    n = 1 + linear.index(_simplest(linear)) if any(one.fit for one in linear) else 2
    for structure in structures:
        if structure != "linear":
            _grow(structure, n, lag, short, parts, tried)
    wanted = [one for one in trials if one.fit is not None and one.structure in structures]
    if not wanted:
        reason = next((one.reason for one in trials if one.reason), "no structure was asked for")
        raise EstimationError(f"nothing could be fitted: {reason}")
    chosen = _simplest(wanted)
    # The orders were compared with another function: with the chosen one, lower ones may do.
    while len(short.u) == len(parts.estimation.u) and (spec := _smaller(chosen.spec)) is not None:
        smaller = tried(_fitted(chosen.structure, spec, short, parts))
        if smaller.fit is None or _simplest([*wanted, smaller]) is not smaller:
            break
        wanted.append(smaller)
        chosen = smaller
    assert chosen.fit is not None
    if len(short.u) < len(parts.estimation.u):
        # A part of a long record cannot tell rich functions apart: the best few go on to all that is fitted.
        best = sorted(wanted, key=lambda one: one.rms)[:_WHOLE]
        whole = [
            tried(_gone_on(one.structure, one.spec, one.fit, parts.estimation, parts))
            for one in best
            if one.fit is not None
        ]
        wanted = [one for one in whole if one.fit is not None] or wanted
        # A few numbers more are no risk beside so many samples.
        chosen = min(wanted, key=lambda one: one.rms)
    model_fit = chosen.fit
    assert model_fit is not None
    if parts.everything is not parts.estimation:
        again = continued(chosen.spec.structure(), model_fit.point.parameters.chain, parts.everything)
        model_fit = _counted_as(again, model_fit)
    near = _near_the_best(wanted)
    within = frozenset(i for i, one in enumerate(trials) if one in near)
    return Identification(tuple(trials), within, chosen, model_fit, parts)


def first_lag(data: Data) -> int:
    """The lag at which the output surely answers to the input, by their correlation; 0 if there is none."""
    found = correlation(data.u, data.y, data.experiments)
    shown = None if found is None else delay(found)
    return 0 if shown is None else shown.low


def _grow(
    structure: str,
    n: int,
    lag: int,
    short: Data,
    parts: Split,
    tried: Callable[[Trial], Trial],
) -> None:
    """Orders around the linear ones with one static function, then other functions with the best of them."""
    step = STRUCTURES[structure].count("L")
    initial, start = parts.everything.n_init, parts.everything.start
    first: list[Trial] = []
    seen = set()
    waiting = [max(n - step, 1), n, n + step]
    while waiting:
        m = waiting.pop(0)
        orders = orders_of(structure, m, lag)
        if tuple(orders) in seen:
            continue
        seen.add(tuple(orders))
        spec = chain(structure, orders, FIRST_STATIC, n_init=initial, start=start)
        first.append(tried(_fitted(structure, spec, short.busiest(_ORDERS), parts)))
        # While the highest orders are the best, there may be better ones.
        if not waiting and first[-1].rms <= min(one.rms for one in first) < np.inf and m + step <= _HIGHEST:
            waiting.append(m + step)
    found = [one for one in first if one.fit is not None]
    least = min((one.rms for one in found), default=np.inf)
    close = [one for one in found if one.rms <= _CLOSE * least]
    best = min(close, key=lambda one: one.count, default=None)
    for static in STATIC:
        if best is not None and best.fit is not None:
            spec = chain(structure, list(_orders(best.spec)), static, n_init=initial, start=start)
            tried(_gone_on(structure, spec, best.fit, short, parts))
        elif static["kind"] != FIRST_STATIC["kind"]:
            # An input of few levels may tell the numbers of simpler functions apart.
            simpler = chain(structure, orders_of(structure, n, lag), static, n_init=initial, start=start)
            tried(_fitted(structure, simpler, short, parts))


def _orders(spec: PredictionError) -> Iterator[Orders]:
    return (Orders(b.nb, b.nf, b.nk) for b in spec.blocks if isinstance(b, LinearBlock))


def _smaller(spec: PredictionError) -> PredictionError | None:
    """The chain with one pole and one coefficient less in each linear block; None if there is none."""
    blocks = []
    for block in spec.blocks:
        written = canonical(block)
        if isinstance(block, LinearBlock):
            if block.nf < 2 or block.nb < 2:
                return None
            written |= {"nb": block.nb - 1, "nf": block.nf - 1}
        blocks.append(written)
    return PredictionError(blocks=blocks, n_init=spec.n_init, start=spec.start)


def _fitted(structure: str, spec: PredictionError, data: Data, parts: Split, most_starts: int = 8) -> Trial:
    try:
        fit = fit_chain(spec.structure(), data, most_starts=most_starts, max_iterations=_ORDER_ITERATIONS)
        return _judged(structure, spec, fit, parts)
    except (EstimationError, np.linalg.LinAlgError) as error:
        return Trial(structure, spec, reason=str(error))


def _gone_on(structure: str, spec: PredictionError, fit: ChainFit, data: Data, parts: Split) -> Trial:
    try:
        most = _FUNCTION_ITERATIONS if data.count < _COMPARED // 2 else _ORDER_ITERATIONS
        found = continued(spec.structure(), fit.point.parameters.chain, data, most)
        return _judged(structure, spec, _counted_as(found, fit), parts)
    except (EstimationError, np.linalg.LinAlgError) as error:
        return Trial(structure, spec, reason=str(error))


def _counted_as(fit: ChainFit, search: ChainFit) -> ChainFit:
    """The fit with the starts of the search that it goes on from."""
    return replace(fit, starts=search.starts, finalists=search.finalists, agreeing=search.agreeing)


def _judged(structure: str, spec: PredictionError, fit: ChainFit, parts: Split) -> Trial:
    with np.errstate(all="ignore"):
        errors = parts.output - parts.simulated(fit.point.parameters.chain)
    if not np.all(np.isfinite(errors)):
        return Trial(structure, spec, reason="the simulation of the samples kept apart is not finite")
    estimation = float(np.sqrt(fit.point.loss / fit.point.data.count))
    return Trial(structure, spec, fit.point.parameters.count(), fit, estimation, errors**2)


def _near_the_best(trials: Sequence[Trial]) -> list[Trial]:
    """The trials whose mean squared error is within one standard error of the least, paired, in batches."""
    found = [one for one in trials if one.fit is not None]
    best = min(found, key=lambda one: one.rms)
    near = []
    for one in found:
        more = one.validation - best.validation
        means = np.array([batch.mean() for batch in np.array_split(more, min(_BATCHES, len(more)))])
        error = float(np.std(means, ddof=1) / np.sqrt(len(means))) if len(means) > 1 else 0.0
        if float(np.mean(more)) <= error:
            near.append(one)
    return near


def _simplest(trials: Sequence[Trial]) -> Trial:
    near = _near_the_best(trials)
    return min(near, key=lambda one: (one.count, one.rms))
