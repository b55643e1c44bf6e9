"""Structures and orders tried on a record, and one chosen by samples that were kept apart."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np

from hident.arrays import Array
from hident.block_chain import Beginning
from hident.config.spec import canonical
from hident.errors import EstimationError
from hident.estimators.base import require_usable, varies
from hident.estimators.prediction_error.block_specs import LinearBlock
from hident.estimators.prediction_error.chain_fit import ChainFit, fit_chain, fit_with_states
from hident.estimators.prediction_error.criterion import Data
from hident.estimators.prediction_error.parameters import Parameters
from hident.estimators.prediction_error.prediction_error import PredictionError
from hident.estimators.prediction_error.starts import ALL, DEFAULT
from hident.identification.candidates import STRUCTURES, Functions, Orders, chain, orders_of
from hident.identification.continuation import continued, resumed
from hident.identification.split import Split, split
from hident.measurements.delay import Delay, delay_of
from hident.numerics.choices import first_least, standard_error, within_one_standard_error
from hident.numerics.information_criteria import aic, bic
from hident.numerics.judgement import Residuals, judgement
from hident.records import Estimate, Record

By = Literal["validation", "aic", "bic"]
"""What decides: the simulation of samples kept apart, or a criterion of those that are fitted."""

# Orders are compared by short fits to so many samples, static functions by fits to more, the best few chains
# by fits to more still: only the best of these is fitted to a longer record.
_ORDERS, _COMPARED, _BEST = 4000, 12000, 30000
_ORDER_ITERATIONS, _FUNCTION_ITERATIONS = 25, 50
_LINEAR_STARTS, _HIGHEST = 2, 10
_FEWEST, _FINALISTS = 20, 2
# Short fits of higher orders that gain less than this have gained nothing.
_CLOSE = 1.03
_MOST_LINEAR, _MORE_LINEAR, _MANY = 4, 8, 5000
# Beyond the first few, linear models grow until so many orders in a row have gained nothing.
_NO_GAIN = 2
# Delays are compared by linear models with so many coefficients and poles; so many steps over the interval.
_NEAR_DELAY, _STEPS = 2, 8
# Where linear models leave more than this part of the output, their roots say little of those of a chain.
_FAR_FROM_LINEAR = 0.1
# So many standard errors are no chance.
_SURELY = 3.0
# Errors below this part of the output's spread are rounding: no sensor has as many digits.
_ROUNDING = 1e-8


@dataclass(frozen=True, eq=False)
class Trial:
    """A chain that was tried, and its fit; ``reason`` says why there is none.

    ``count`` is the number of free parameters. ``fitted`` (N,) and ``validation`` (M,) are the squared errors
    of the simulation of all samples that are to be fitted, of which a short fit has seen a part, and of those
    that are kept apart.
    """

    structure: str
    spec: PredictionError
    count: int = 0
    fit: ChainFit | None = None
    fitted: Array = field(default_factory=lambda: np.zeros(0))
    validation: Array = field(default_factory=lambda: np.zeros(0))
    reason: str = ""

    @property
    def rms(self) -> float:
        """The root mean squared error on the samples kept apart; infinite without a fit."""
        return float(np.sqrt(np.mean(self.validation))) if len(self.validation) else np.inf

    @property
    def estimation(self) -> float:
        """The root mean squared error on the samples that are to be fitted; infinite without a fit."""
        return float(np.sqrt(np.mean(self.fitted))) if len(self.fitted) else np.inf

    @property
    def aic(self) -> float:
        """Akaike's criterion of the samples that are fitted; infinite without a fit."""
        return aic(self._mse, len(self.fitted), self.count) if self.fit is not None else np.inf

    @property
    def bic(self) -> float:
        """Schwarz's criterion of the samples that are fitted; infinite without a fit."""
        return bic(self._mse, len(self.fitted), self.count) if self.fit is not None else np.inf

    @property
    def _mse(self) -> float:
        return max(self.estimation**2, float(np.finfo(float).tiny))

    def worth(self, by: By) -> float:
        """The criterion: the lower, the better."""
        return self.rms if by == "validation" else self.aic if by == "aic" else self.bic


@dataclass(frozen=True, eq=False)
class Identification:
    """All that was tried, and what was chosen, see :func:`identify` (which has an example).

    ``chosen`` is the trial with the fewest parameters (of a long record, the best) among those whose mean
    squared error on the samples kept apart is within one standard error of the least (``within`` holds their
    places) and that are not surely worse on those that are fitted; or the one with the least criterion, as
    ``by`` says.
    ``model_fit`` is its fit to all samples, ``parts`` what it was chosen by, ``functions`` are the static
    functions that were tried, and ``notes`` say what was not and why. ``delay`` is that which the correlation
    of input and output tells, None if there is none.
    """

    trials: tuple[Trial, ...]
    within: frozenset[int]
    chosen: Trial
    model_fit: ChainFit
    parts: Split
    by: By
    functions: Functions
    notes: tuple[str, ...] = ()
    delay: Delay | None = None

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
        whole = self.parts.everything.y
        scale = float(np.max(np.abs(whole - np.mean(whole))))
        parts = self.parts.kept_experiments
        return judgement(self.parts.input, self.parts.output, made, parts, scale=scale)


def identify(
    record: Record,
    structures: Sequence[str] = tuple(STRUCTURES),
    *,
    by: By = "validation",
    n_init: int | None = None,
    start: Beginning = "settled",
    delay: int | None = None,
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
    by : {"validation", "aic", "bic"}
        What decides: the simulation of the samples kept apart, or a criterion of those that are fitted.
    n_init : int, optional
        First samples of each experiment that are not fitted; by default 250, or a twentieth of the shortest.
    start : {"settled", "rest", "estimated"}
        What was before the record: its first input for ever, nothing, or what its first samples tell. Then
        the chosen chain is fitted with the states in which each experiment begins, and leaves out the first
        ``n_init`` samples only if they are given.
    delay : int, optional
        The delay of the chains, in samples, at its last linear block; by default the correlation of input and
        output and the fits tell it.
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

    if by not in get_args(By):
        raise ValueError(f"'by' must be one of {', '.join(get_args(By))}, not {by!r}")
    require_usable(record)
    # On matrices of a few rows, BLAS's threads take several times the processor time of one. What is not
    # finite in a chain that is tried is a reason against it, and no warning.
    with threadpool_limits(1), np.errstate(all="ignore"):
        search = _Search(split(record, n_init, start), by, tell, delay_of(record)[1], delay, start, n_init)
        return search.identified(structures)


class _Search:
    """What has been tried on a record so far, and what decides."""

    def __init__(
        self,
        parts: Split,
        by: By,
        tell: Callable[[Trial], None],
        delay: Delay | None = None,
        given: int | None = None,
        start: Beginning = "settled",
        n_init: int | None = None,
    ) -> None:
        if parts.estimation.count < _FEWEST or len(parts.output) < _FEWEST:
            raise EstimationError(
                f"{parts.estimation.count} samples to fit and {len(parts.output)} to choose by are too few: "
                f"at least {_FEWEST} of each, beside the first {parts.everything.n_init} samples"
            )
        shortest = min(part.stop - part.start for part in parts.estimation.experiments)
        if given is not None and shortest - given < _FEWEST:
            raise EstimationError(
                f"a delay of {given} samples is too long: the shortest experiment has {shortest} to fit"
            )
        # What the input was in the first samples shows in those that count.
        counted = parts.estimation.y[parts.estimation.counted]
        for fitted, name in ((parts.estimation.u, "input"), (counted, "output")):
            if not varies(fitted):
                raise EstimationError(
                    f"the {name} is {fitted[0]:g} in all samples that are to be fitted, which tell nothing: "
                    f"it varies only in those to choose by ({parts.said}) or in the first ones"
                )
        self.parts, self.by, self._tell = parts, by, tell
        self.trials: list[Trial] = []
        self.short = parts.estimation.busiest(_COMPARED)
        self.is_long = len(self.short.u) < len(parts.estimation.u)
        self.delay, self.given, self.start = delay, given, start
        # What the chosen chain leaves out in the end: nothing where its states are found.
        self.n_init = n_init or 0 if parts.finds_states else parts.everything.n_init
        self.functions = Functions.of_input(parts.estimation.u)
        self.is_far_from_linear = False
        self.nothing = _ROUNDING * float(np.std(parts.everything.y))

    def identified(self, structures: Sequence[str]) -> Identification:
        self.lag = self._lag()
        n = self._linear_order(is_asked="linear" in structures)
        for structure in structures:
            if structure != "linear" and self.functions.of(structure):
                self._grow(structure, n)
        wanted = self._wanted(structures)
        if not wanted:
            failed = [f"{one.structure}: {one.reason}" for one in self.trials if one.reason]
            reasons = [*failed[:1], *self.functions.notes(structures)] or ["no structure was asked for"]
            raise EstimationError(f"nothing could be fitted: {'; '.join(reasons)}")
        chosen = self._whole(wanted) if self.is_long else self._pruned(wanted)
        fit = chosen.fit
        assert fit is not None
        if self.parts.everything is not self.parts.estimation:
            again = resumed(chosen.spec.structure(), _stateless(fit), self.parts.everything)
            fit = _counted_as(again, fit)
        if self.parts.finds_states:
            # All that is to be fitted now, from each first sample on.
            whole = replace(self.parts.everything, n_init=self.n_init)
            fit = _counted_as(fit_with_states(chosen.spec.structure(), fit.point.parameters, whole), fit)
        near = near_the_best(self._wanted(structures), self.nothing)
        within = frozenset(i for i, one in enumerate(self.trials) if one in near)
        notes = self.functions.notes(structures)
        trials = tuple(self.trials)
        return Identification(
            trials, within, chosen, fit, self.parts, self.by, self.functions, notes, self.delay
        )

    def _wanted(self, structures: Sequence[str]) -> list[Trial]:
        return [one for one in self.trials if one.fit is not None and one.structure in structures]

    def _lag(self) -> int:
        """The least lag, in the interval of the delay, of a linear model that is hardly worse than the best.

        A step of an eighth of the interval, then of half of that around the best, and so on.
        """
        if self.given is not None:
            return self.given
        if self.delay is None:
            return 0
        low, high = self.delay.low, self.delay.high
        few = self.short.busiest(_ORDERS)
        tried: dict[int, Trial] = {}
        step = max(1, -(-(high - low) // _STEPS))
        lags = {*range(low, high, step), high}
        while len(lags) > 1 or step > 1:
            for lag in sorted(lags - tried.keys()):
                spec = self._chain("linear", [Orders(_NEAR_DELAY, _NEAR_DELAY, lag)])
                tried[lag] = self._fitted("linear", spec, few, _LINEAR_STARTS)
            fitted = {lag: one for lag, one in tried.items() if one.fit is not None}
            if not fitted:
                return low
            least = min(fitted, key=lambda lag: (fitted[lag].worth(self.by), lag))
            if step == 1:
                return min(lag for lag, one in fitted.items() if one in self._close([*fitted.values()]))
            step = -(-step // 2)
            lags = {lag for lag in (least - step, least + step) if low <= lag <= high}
        return low

    def _linear_order(self, *, is_asked: bool) -> int:
        """The order of the linear model that is chosen."""
        highest = _MORE_LINEAR if len(self.short.u) >= _MANY else _MOST_LINEAR
        few = self.short.busiest(_ORDERS)
        linear: list[Trial] = []
        for n in range(1, highest + 1):
            linear.append(self._fitted("linear", self._chain("linear", n), few, _LINEAR_STARTS))
            worth = [one.worth(self.by) for one in linear]
            if n > _MOST_LINEAR and n - 1 - int(np.argmin(worth)) >= _NO_GAIN:
                break
        if not any(one.fit for one in linear):
            return 2
        left = min(one.estimation for one in linear)
        self.is_far_from_linear = left**2 > _FAR_FROM_LINEAR * float(np.var(self.parts.estimation.y))
        chosen = simplest(linear, self.by, self.nothing)
        if is_asked:
            self._tightened(chosen, few)
        return 1 + linear.index(chosen)

    def _chain(
        self, structure: str, n: int | Sequence[Orders], *static: Mapping[str, Any]
    ) -> PredictionError:
        """The chain of a structure with these orders, or those for a linear approximation of order n."""
        orders = self._orders(structure, n, self.lag) if isinstance(n, int) else n
        return chain(structure, orders, static, n_init=self.n_init, start=self.start)

    def _orders(self, structure: str, n: int, lag: int) -> list[Orders]:
        return orders_of(structure, n, lag, is_sure=self.given is not None)

    def _tightened(self, start: Trial, data: Data) -> Trial:
        """The trial with the largest delay, inside the interval, that loses nothing by fewer coefficients."""
        if self.given is not None or self.delay is None:
            return start
        *_, last = _orders(start.spec)
        if max(self.lag, last.nk) <= 1:
            return start
        for nk in range(self.delay.high, last.nk, -1):
            if (spec := _later(start.spec, nk)) is None:
                continue
            one = self._fitted(start.structure, spec, data)
            if self._fewest_of_close([start, one]) is one:
                return one
        return start

    def _grow(self, structure: str, n: int) -> None:
        """Orders around the linear ones with one static function, then others with the best of them."""
        step = STRUCTURES[structure].count("L")
        tried = self.functions.of(structure)
        few = self.short.busiest(_ORDERS)
        first: list[Trial] = []
        seen = set()
        waiting = [max(n - step, 1), n, n + step]
        while waiting:
            m = waiting.pop(0)
            orders = self._orders(structure, m, self.lag)
            if tuple(orders) in seen:
                continue
            seen.add(tuple(orders))
            first.append(self._fitted(structure, self._chain(structure, orders, *tried[0]), few))
            # While the highest orders are the best, there may be better ones.
            least = min(one.worth(self.by) for one in first)
            if not waiting and first[-1].worth(self.by) <= least < np.inf and m + step <= _HIGHEST:
                waiting.append(m + step)
        first += [
            self._fitted(structure, self._chain(structure, orders, *tried[0]), few)
            for orders in self._at_other_lags(structure, n)
            if tuple(orders) not in seen
        ]
        start = self._fewest_of_close(first)
        # Of two blocks the first may hold some of a delay; beside many samples, few coefficients are no risk.
        if start is not None and (step == 1 or not self.is_long):
            start = self._tightened(start, few)
        for static in tried[1:]:
            if start is not None:
                self._gone_on(self._chain(structure, list(_orders(start.spec)), *static), start, self.short)
            else:
                # A record may tell the parameters of simpler functions apart.
                self._fitted(structure, self._chain(structure, n, *static), self.short)

    def _at_other_lags(self, structure: str, n: int) -> list[list[Orders]]:
        """The orders at the ends of the interval of the delay, for what linear models do not tell."""
        if self.given is not None or self.delay is None:
            return []
        ends = dict.fromkeys((self.delay.low, self.delay.high))
        return [self._orders(structure, n, lag) for lag in ends if lag != self.lag]

    def _fewest_of_close(self, trials: Sequence[Trial]) -> Trial | None:
        return min(self._close(trials), key=lambda one: one.count, default=None)

    def _close(self, trials: Sequence[Trial]) -> list[Trial]:
        """The fitted trials that the best one gains next to nothing on; by a criterion, the best one."""
        found = [one for one in trials if one.fit is not None]
        if self.by != "validation":
            return [best(found, self.by)] if found else []
        least = min((one.rms for one in found), default=np.inf)
        return [one for one in found if one.rms <= _CLOSE * least]

    def _pruned(self, wanted: list[Trial]) -> Trial:
        """The one of those wanted that is chosen, and lower orders of its linear blocks if they will do.

        Orders were compared with another function: with the chosen one, lower ones may do.
        """
        chosen = preferred(wanted, self.by, self.nothing)
        while (spec := _smaller(chosen.spec)) is not None:
            smaller = self._fitted(chosen.structure, spec, self.short)
            if smaller.fit is None or preferred([*wanted, smaller], self.by, self.nothing) is not smaller:
                break
            wanted = [*wanted, smaller]
            chosen = smaller
        return chosen

    def _whole(self, wanted: list[Trial]) -> Trial:
        """The best of the best few of those wanted, fitted to all that is to be fitted.

        A part of a long record cannot tell rich functions apart, and a few parameters more are no risk beside
        all of it.
        """
        few = sorted(wanted, key=lambda one: one.worth(self.by))[:_FINALISTS]
        whole = self.parts.estimation
        gone_on = [self._gone_on(one.spec, one, whole.busiest(_BEST), whole) for one in few]
        chosen = best([one for one in gone_on if one.fit is not None] or few, self.by)
        assert chosen.fit is not None
        try:
            structure = chosen.spec.structure()
            fit = resumed(structure, _stateless(chosen.fit), whole, _ORDER_ITERATIONS)
            found = self._judged(chosen.structure, chosen.spec, _counted_as(fit, chosen.fit))
        except (EstimationError, np.linalg.LinAlgError):
            return chosen
        return found if found.fit is not None else chosen

    def _fitted(self, structure: str, spec: PredictionError, data: Data, most_starts: int = 8) -> Trial:
        """A chain fitted to data from starts of its own."""
        try:
            is_hard = structure == "wiener_hammerstein" and self.is_far_from_linear
            fit = fit_chain(
                spec.structure(),
                replace(data, n_init=self.n_init) if self.parts.finds_states else data,
                most_starts=most_starts,
                max_iterations=_ORDER_ITERATIONS,
                states=self.parts.finds_states,
                initialisation=ALL if is_hard else DEFAULT,
            )
            return self._judged(structure, spec, fit)
        except (EstimationError, np.linalg.LinAlgError) as error:
            return self._told(Trial(structure, spec, reason=str(error)))

    def _gone_on(self, spec: PredictionError, begun: Trial, data: Data, whole: Data | None = None) -> Trial:
        """A chain fitted to data, from where another one with the same linear blocks ended."""
        assert begun.fit is not None
        most = _FUNCTION_ITERATIONS if data.count < _COMPARED // 2 else _ORDER_ITERATIONS
        try:
            fit = continued(spec.structure(), begun.fit.point.parameters.chain, data, most, whole)
            if self.parts.finds_states:
                data = replace(data, n_init=self.n_init)
                fit = fit_with_states(spec.structure(), fit.point.parameters, data, most)
            return self._judged(begun.structure, spec, _counted_as(fit, begun.fit))
        except (EstimationError, np.linalg.LinAlgError) as error:
            return self._told(Trial(begun.structure, spec, reason=str(error)))

    def _judged(self, structure: str, spec: PredictionError, fit: ChainFit) -> Trial:
        with np.errstate(all="ignore"):
            fitted, kept = self.parts.errors(fit.point.parameters.chain)
        if not (np.all(np.isfinite(kept)) and np.all(np.isfinite(fitted))):
            return self._told(Trial(structure, spec, reason="the simulation of the record is not finite"))
        # A factor between a linear block and a static function is no parameter, nor is a state.
        count = _stateless(fit).count() - STRUCTURES[structure].count("L")
        return self._told(Trial(structure, spec, count, fit, fitted**2, kept**2))

    def _told(self, trial: Trial) -> Trial:
        """The trial, kept in the place of a shorter fit of the same chain if there was one."""
        same = (i for i, one in enumerate(self.trials) if one.spec == trial.spec)
        if (place := next(same, None)) is None:
            self.trials.append(trial)
        elif trial.fit is not None:
            self.trials[place] = trial
        self._tell(trial)
        return trial


def best(trials: Sequence[Trial], by: By) -> Trial:
    """The trial with the least criterion."""
    return trials[first_least([one.worth(by) for one in trials])]


def near_the_best(trials: Sequence[Trial], nothing: float = 0.0) -> list[Trial]:
    """The trials that the samples kept apart do not tell from the best of them.

    Errors below ``nothing`` are no more than rounding.
    """
    found = [one for one in trials if one.fit is not None]
    near = within_one_standard_error([np.maximum(one.validation, nothing**2) for one in found])
    return [one for one, is_near in zip(found, near, strict=True) if is_near]


def simplest(trials: Sequence[Trial], by: By, nothing: float = 0.0) -> Trial:
    """The one with the fewest parameters that cannot be told from the best; by a criterion, the best."""
    if by != "validation":
        return best(trials, by)
    return min(near_the_best(trials, nothing), key=lambda one: (one.count, one.rms))


def preferred(trials: Sequence[Trial], by: By, nothing: float = 0.0) -> Trial:
    """As :func:`simplest`, but for those that are surely worse than the best on the samples that are fitted.

    Where few samples are kept apart, a chain may be as good there by chance; the many others tell.
    """
    if by != "validation":
        return best(trials, by)
    near = near_the_best(trials, nothing)
    first = min(near, key=lambda one: one.rms)

    def is_surely_worse(one: Trial) -> bool:
        more = np.maximum(one.fitted, nothing**2) - np.maximum(first.fitted, nothing**2)
        return float(np.mean(more)) > _SURELY * standard_error(more)

    return min((one for one in near if not is_surely_worse(one)), key=lambda one: (one.count, one.rms))


def _orders(spec: PredictionError) -> Iterator[Orders]:
    return (Orders(b.nb, b.nf, b.nk) for b in spec.blocks if isinstance(b, LinearBlock))


def _later(spec: PredictionError, nk: int) -> PredictionError | None:
    """The chain whose last linear block has a larger delay and fewer coefficients; None if none are left.

    One linear block ends where it did. Of two the first may have held a part of the delay: one coefficient
    less is enough.
    """
    blocks = [canonical(block) for block in spec.blocks]
    linear = [block for block in blocks if block["kind"] == "linear"]
    last = linear[-1]
    last |= {"nb": last["nb"] - (nk - last.get("nk", 0) if len(linear) == 1 else 1), "nk": nk}
    if last["nb"] < 1:
        return None
    return PredictionError(blocks=blocks, n_init=spec.n_init, start=spec.start)


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


def _stateless(fit: ChainFit) -> Parameters:
    """The parameters of a fit without the states at the first samples of its data."""
    return replace(fit.point.parameters, states={})


def _counted_as(fit: ChainFit, search: ChainFit) -> ChainFit:
    """The fit with the starts of the search that it goes on from."""
    return replace(fit, starts=search.starts, finalists=search.finalists, agreeing=search.agreeing)
