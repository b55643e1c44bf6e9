"""The estimator that chooses settings of another one by the data."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, GetJsonSchemaHandler, model_validator
from pydantic_core import CoreSchema, PydanticCustomError

from hident.arrays import Array, Characteristic, Flags
from hident.config.spec import Count, NonEmpty, Of, Real, component, components
from hident.config.suggest import counted, one_of
from hident.errors import EstimationError, TrialFailed
from hident.estimators.base import EstimatorSpec, Experiments
from hident.estimators.normalisation import MissedConstant, Normalisation
from hident.estimators.selection.candidates import (
    along,
    as_numbers,
    as_written,
    axes_of,
    candidates_of,
    is_number,
    value_at,
    word,
)
from hident.estimators.selection.folds import Fold, at_the_end, in_blocks
from hident.numerics.choices import ROUNDING, first_least, within_one_standard_error
from hident.numerics.information_criteria import aic, bic, fpe
from hident.records import Estimate, Record, needed

Criterion = Literal["cross_validation", "leave_one_out", "holdout", "validation", "aic", "bic", "fpe"]
_FAILURES = (TrialFailed, np.linalg.LinAlgError, ArithmeticError)
_INFORMATION: tuple[Literal["aic"], Literal["bic"]] = ("aic", "bic")
_PENALISED = {"aic": aic, "bic": bic, "fpe": fpe}
# Those that fit each candidate to the whole record.
_OF_WHOLE = ("leave_one_out", "validation", *_PENALISED)
# From the one that takes the fewest records to the one that takes all.
_TAKEN: tuple[Experiments, ...] = ("one", "at_one_interval", "any")
_OF = {"folds": ("cross_validation",), "share": ("holdout",), "gap": ("cross_validation", "holdout")}


@dataclass(frozen=True, eq=False)
class Selection:
    """How the settings were chosen.

    ``over`` holds the values of each setting, ``criterion`` (C,) that of each candidate: all combinations of
    the values, the last setting varying the fastest. Those that failed have nan, and their reasons stand in
    ``failures``. ``chosen`` is the place of the one that was taken, ``estimator`` itself, and ``within`` how
    that chose, if it is a selection too.

    ``parameters`` counts the free parameters of each candidate (None: it does not say), ``near`` (C,) says
    whose squared error is within one standard error of the least (None of a criterion with a penalty), and
    ``aic`` and ``bic`` (C,) are those of the fits to the whole record, as far as there are any; else nan.
    """

    by: Criterion
    over: Mapping[str, tuple[Any, ...]]
    criterion: Array
    failures: Mapping[int, str]
    chosen: int
    estimator: EstimatorSpec
    within: Selection | None = None
    parameters: tuple[int | None, ...] = ()
    near: Flags | None = None
    aic: Array = field(default_factory=lambda: np.zeros(0))
    bic: Array = field(default_factory=lambda: np.zeros(0))

    def word(self, path: str, place: int) -> str:
        """A value of a setting as a label shows it."""
        value = self.over[path][place]
        return f"{value:.4g}" if is_number(value) else word(value)


class _PartlyGiven(Of):
    """Pydantic annotation: a component whose fields may be given elsewhere."""

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        return {"type": "object", "required": ["kind"]}


@component("estimator", "select")
class Select(EstimatorSpec):
    """Another estimator, with the settings that a criterion on the record prefers.

    The candidates are all combinations of the values in ``over``. The one with the least criterion is taken;
    of those that tie within rounding, the first (of the settings in alphabetical order, the last varies the
    fastest), so the simplest value stands first. A candidate that fails, or for which a record is too short,
    is left out.

    ``cross_validation``: the mean squared error on blocks in time, each held out in turn; ``holdout``: that
    on the last part of each experiment; ``validation``: that on the record's validation part;
    ``leave_one_out``, of nonparametric regression: that of the samples, each without its own, where what
    undid the linear block stays. With the mean squared error V on the record and the number d of free
    parameters, ``aic`` is N ln V + 2 d, ``bic`` N ln V + d ln N and ``fpe`` V (1 + d/N)/(1 - d/N).

    ``take: simplest`` takes, of all candidates whose mean squared error is within one standard error of the
    least, the one with the fewest free parameters.

    The error is that of the output simulated from the input of the whole experiment, so that a block that is
    held out begins in the state that the input has brought the model to. Of nonparametric regression it is
    that of what is regressed: of one-step prediction. What an experiment has after a block is fitted as an
    experiment of its own: no lagged row reaches across. A sample of which one candidate says nothing, such as
    the first that its filter drops, counts for none.

    The estimate is that of the chosen candidate on the whole record. Its values also hold ``selected`` and
    the key path, as in ``selected bandwidth.h0``: the chosen number, or the place in the list, from 1, of
    what is no number. ``details["selection"]`` holds the criterion of every candidate.

    References: Stone 1974 (cross-validation); Akaike 1970 (fpe), 1974 (aic); Schwarz 1978 (bic); Burman,
    Chow, Nolan 1994 (gaps for dependent data); Breiman, Friedman, Olshen, Stone 1984, 3.4.3 (the simplest).

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Fir(b=[1, 0.5]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> kernel = {"kind": "kernel", "kernel": "gaussian", "bandwidth": {"alpha": 0}}
    >>> chosen = hi.Select(by="leave_one_out", over={"bandwidth.h0": [0.01, 0.1, 1]}, estimator=kernel)
    >>> hi.fit(chosen, record).values
    {'selected bandwidth.h0': 0.1}
    """

    by: Criterion
    """What decides."""
    over: dict[str, NonEmpty[Any]]
    """Key paths in the estimator, each with the values to choose from; 1..6 stands for 1 to 6."""
    estimator: Annotated[EstimatorSpec, _PartlyGiven("estimator")]
    """The estimator; the keys that 'over' names may be left out."""
    folds: Annotated[Count, Field(ge=2)] = 5
    """Number of blocks of each experiment, of cross_validation."""
    share: Annotated[Real, Field(gt=0, lt=1)] = 0.25
    """Share of each experiment that is held out, at its end, of holdout."""
    gap: Annotated[Count, Field(ge=0)] = 0
    """Samples beside a block that are not fitted either: as many as the noise remembers."""
    take: Literal["best", "simplest"] = "best"
    """The candidate with the least criterion, or the simplest within one standard error of that."""

    @model_validator(mode="before")
    @classmethod
    def _each_candidate(cls, data: Any) -> Any:
        """The data with sound values, and the estimator of the first candidate."""
        if not isinstance(data, Mapping) or not isinstance(data.get("over"), Mapping):
            return data
        written = as_written(data.get("estimator"))
        if written is None or str(written.get("kind")) not in components("estimator"):
            return data
        axes = axes_of(data["over"])
        candidates = candidates_of(written, axes, data["over"])
        over = {path: [value_at(candidates[places], path) for places in along(axes, path)] for path in axes}
        return {**data, "over": over, "estimator": next(iter(candidates.values()))}

    @model_validator(mode="after")
    def _can_be_judged(self) -> Self:
        for name, criteria in _OF.items():
            if name in self.model_fields_set and self.by not in criteria:
                raise ValueError(f"'{name}' is of {one_of(criteria)}: leave it out, or set 'by'")
        if self.take == "simplest" and self.by in _PENALISED:
            raise ValueError(f"'{self.by}' has a penalty for parameters already: leave 'take' out")
        for candidate in self.candidates:
            if lacks := self._lacks(candidate):
                raise PydanticCustomError("config", f"'{self.by}' {lacks}")
            for path in self.over:
                if (name := _name(path)) in candidate.names():
                    raise ValueError(
                        f"'over' chooses '{path}', and so does a selection inside: both would be called "
                        f"'{name}'; choose by the path from here, such as estimator.{path}"
                    )
        return self

    def _lacks(self, candidate: EstimatorSpec) -> str:
        """What a candidate lacks for the criterion; empty if nothing."""
        named = f"which '{candidate.kind}'"
        if self.take == "simplest" and candidate.free_parameters() is None:
            return f"needs the number of free parameters to take the simplest, {named} does not say"
        if self.by == "leave_one_out":
            lacks = "left_out" not in candidate.provides()
            said = f"needs each sample's estimate without it, {named} does not give: take cross_validation"
            return said * lacks
        if not candidate.explains():
            return f"needs what is left of the output, {named} does not tell: it gives no response"
        if self.by in _PENALISED and candidate.free_parameters() is None:
            return f"needs the number of free parameters, {named} does not say: take cross_validation"
        if self.by == "cross_validation" and candidate.takes_experiments() == "one":
            return f"makes several experiments of one, {named} does not take: take holdout"
        return ""

    @cached_property
    def candidates(self) -> tuple[EstimatorSpec, ...]:
        """All combinations of the values, the last setting by name varying the fastest."""
        written = as_written(self.estimator)
        assert written is not None
        return tuple(candidates_of(written, axes_of(self.over), self.over).values())

    @cached_property
    def _selected(self) -> tuple[dict[str, float], ...]:
        """For each candidate its values of the settings, as numbers by the names of the estimate's."""
        paths = sorted(self.over)
        numbers = [as_numbers(self.over[path]) for path in paths]
        names = list(map(_name, paths))
        return tuple(dict(zip(names, chosen, strict=True)) for chosen in itertools.product(*numbers))

    def names(self) -> list[str]:
        common = set.intersection(*(set(candidate.names()) for candidate in self.candidates))
        own = [name for name in self.candidates[0].names() if name in common]
        return [*own, *self._selected[0]]

    def provides(self) -> frozenset[str]:
        common = frozenset.intersection(*(candidate.provides() for candidate in self.candidates))
        return common | {f"value {name}" for name in self._selected[0]}

    def fewest_samples(self) -> int:
        return min(map(self._fewest_samples_with, self.candidates))

    def _fewest_samples_with(self, candidate: EstimatorSpec) -> int:
        """The fewest samples of which a candidate can be judged."""
        fewest = candidate.fewest_samples()
        if self.by == "cross_validation":
            return math.ceil((fewest + 2 * self.gap) * self.folds / (self.folds - 1))
        if self.by == "holdout":
            return max(math.ceil((fewest + self.gap) / (1.0 - self.share)), 2)
        return fewest

    def unsuited(self, n: int, dt: float | None) -> dict[str, str]:
        """The candidates that records of ``n`` samples every ``dt`` do not suit, by their settings: why."""
        return {self._words(i): why for i, why in self._unsuited(n, dt).items()}

    def _unsuited(self, n: int, dt: float | None) -> dict[int, str]:
        found: dict[int, str] = {}
        for i, candidate in enumerate(self.candidates):
            if n < (fewest := self._fewest_samples_with(candidate)):
                found[i] = f"needs at least {counted(fewest, 'sample')}"
                continue
            try:
                candidate.check(n, dt)
            except ValueError as error:
                found[i] = str(error)
        return found

    def takes_experiments(self) -> Experiments:
        return min((candidate.takes_experiments() for candidate in self.candidates), key=_TAKEN.index)

    def draws(self) -> bool:
        return any(candidate.draws() for candidate in self.candidates)

    def needs_of_truth(self) -> frozenset[str]:
        return frozenset().union(*(candidate.needs_of_truth() for candidate in self.candidates))

    def letters(self) -> Mapping[str, str]:
        return self.candidates[0].letters()

    def normalisations(self) -> tuple[Normalisation, ...] | None:
        rules: dict[tuple[str, frozenset[str]], Normalisation] = {}
        for candidate in self.candidates:
            if (own := candidate.normalisations()) is None:
                return None
            # Of candidates of several lengths the last, as a rule the longest, tells of a system.
            rules |= {(rule.rule, rule.parts): rule for rule in own}
        return tuple(rules.values())

    def misses_constant(self, nonlinearity: Characteristic) -> MissedConstant | None:
        every = [candidate.misses_constant(nonlinearity) for candidate in self.candidates]
        missed = next(filter(None, every), None)
        return missed and missed._replace(when=self.settings_with([one is not None for one in every]))

    def settings_with(self, is_so: Sequence[bool]) -> str:
        """With which settings something is so of the candidates (C,), in words; empty if of all or none."""
        if all(is_so) or not any(is_so):
            return ""
        paths = sorted(self.over)
        every = [*itertools.product(*(range(len(self.over[path])) for path in paths))]
        for k, path in enumerate(paths):
            places = sorted({place[k] for place, own in zip(every, is_so, strict=True) if own})
            if [place[k] in places for place in every] == [*is_so]:
                return f"{path} {one_of(word(self.over[path][place]) for place in places)}"
        return "some of its settings"

    def discrete_step(self, dt: float | None) -> float:
        return self.candidates[0].discrete_step(dt)

    def check(self, n: int, dt: float | None) -> None:
        steps = {candidate.discrete_step(dt) for candidate in self.candidates}
        if "linear" in self.provides() and len(steps) > 1:
            raise ValueError(
                f"its candidates have blocks at several sampling intervals: {one_of(map(str, sorted(steps)))}"
            )
        # That none has samples enough is said by their number.
        if n >= self.fewest_samples() and len(why := self._unsuited(n, dt)) == len(self.candidates):
            raise ValueError(self._none(why))

    def check_record(self, record: Record) -> None:
        self._require_validation(record)
        hopeless = self._unsuited(len(record), record.dt)
        for i, candidate in enumerate(self.candidates):
            if i in hopeless:
                continue
            try:
                candidate.check_record(record)
            except EstimationError as error:
                hopeless[i] = str(error)
        if len(hopeless) == len(self.candidates):
            raise EstimationError(self._none(hopeless))

    def _require_validation(self, record: Record) -> None:
        if self.by == "validation" and record.validation is None:
            raise EstimationError(
                "'by: validation' is on the record's validation part, and this record has none, as no "
                "simulated one has: take holdout or cross_validation"
            )

    def explains(self) -> bool:
        return all(candidate.explains() for candidate in self.candidates)

    def errors(self, estimate: Estimate, record: Record) -> Array:
        chosen, own = _chosen(estimate)
        return chosen.errors(own, record)

    def left_out_errors(self, estimate: Estimate, record: Record) -> Array:
        chosen, own = _chosen(estimate)
        return chosen.left_out_errors(own, record)

    def begun_in_motion(self, shortest: int) -> Self:
        begun = self.model_copy()
        # Its own are not what 'over' and 'estimator' make any more.
        vars(begun)["candidates"] = tuple(one.begun_in_motion(shortest) for one in self.candidates)
        return begun

    def free_parameters(self) -> None:
        return None

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        self.require_experiments(record)
        self._require_validation(record)
        judge = self._judge(record, rng)
        errors: dict[int, Array] = {}
        whole: dict[int, Estimate] = {}
        failures = self._unsuited(len(record), record.dt)
        for i, candidate in enumerate(self.candidates):
            if i in failures:
                continue
            try:
                errors[i], fitted = judge(candidate)
            except _FAILURES as error:
                failures[i] = str(error) or "singular"
            else:
                whole |= {i: fitted} if fitted is not None else {}
        if not errors:
            raise EstimationError(self._none(failures))
        judged = needed(record.validation) if self.by == "validation" else record
        errors = self._common(errors)
        criterion = self._criterion(self.by, errors, judged)
        near = None if self.by in _PENALISED else self._near(errors)
        # Errors are rounded to a part of the output, their squares to the square of that; where there is a
        # penalty, that is seen to before.
        chosen = first_least(criterion, scale=0.0 if near is None else ROUNDING * _size(judged))
        if self.take == "simplest" and near is not None:
            chosen = self._simplest(near, criterion)
        estimator = self.candidates[chosen]
        estimate = whole[chosen] if chosen in whole else estimator.fit(record, rng)
        selection = Selection(
            self.by,
            {path: tuple(self.over[path]) for path in sorted(self.over)},
            criterion,
            failures,
            chosen,
            estimator,
            estimate.details.get("selection"),
            tuple(candidate.free_parameters() for candidate in self.candidates),
            near,
            *self._fits(errors, whole, record),
        )
        return replace(
            estimate,
            values={**estimate.values, **self._selected[chosen]},
            details={**estimate.details, "selection": selection},
        )

    def _judge(
        self, record: Record, rng: np.random.Generator | None
    ) -> Callable[[EstimatorSpec], tuple[Array, Estimate | None]]:
        """What gives a candidate's errors (N,), and its estimate from the whole record if that was made."""
        if self.by in _OF_WHOLE:

            def within(candidate: EstimatorSpec) -> tuple[Array, Estimate]:
                estimate = candidate.fit(record, rng)
                left_out = self.by == "leave_one_out"
                errors = candidate.left_out_errors if left_out else candidate.errors
                judged = needed(record.validation) if self.by == "validation" else record
                return errors(estimate, judged), estimate

            return within
        folds = record.once(("folds", self.by, self.folds, self.share, self.gap), lambda: self._folds(record))

        def held_out(candidate: EstimatorSpec) -> tuple[Array, None]:
            errors = np.full(len(record), np.nan)
            for fold in folds:
                fitted = candidate
                if self.by == "cross_validation":
                    lengths = [part.stop - part.start for part in fold.training.experiments]
                    fitted = candidate.begun_in_motion(min(lengths))
                if len(fold.training) < fitted.fewest_samples():
                    raise EstimationError(
                        f"{len(fold.training)} samples are left to fit, and {candidate.kind} needs at least "
                        f"{fitted.fewest_samples()}: use a longer record"
                    )
                estimate = fitted.fit(fold.training, rng)
                errors[fold.held_out] = candidate.errors(estimate, record)[fold.held_out]
            return errors, None

        return held_out

    def _folds(self, record: Record) -> list[Fold]:
        if self.by == "holdout":
            return [at_the_end(record, self.share, self.gap)]
        return in_blocks(record, self.folds, self.gap)

    def _common(self, errors: Mapping[int, Array]) -> dict[int, Array]:
        """The errors at the samples that all candidates have one for."""
        common = np.logical_and.reduce([np.isfinite(one) for one in errors.values()])
        if not np.any(common):
            raise EstimationError(
                "no sample is left on which all candidates can be compared: use a longer record"
            )
        return {i: one[common] for i, one in errors.items()}

    def _criterion(self, by: Criterion, errors: Mapping[int, Array], judged: Record) -> Array:
        """A criterion of each candidate (C,), of their errors at common samples; else nan."""
        found = np.full(len(self.candidates), np.nan)
        for i, one in errors.items():
            mse, count = float(np.mean(one**2)), len(one)
            if (penalised := _PENALISED.get(by)) is None:
                found[i] = mse
            elif (d := self.candidates[i].free_parameters()) is not None:
                # No fit is better than rounding.
                least = max(mse, ROUNDING**2 * _size(judged), np.finfo(float).tiny)
                found[i] = penalised(least, count, d)
        if by == self.by and not np.isfinite(found).any():
            raise EstimationError(f"'{by}' is finite for no candidate: {count} samples are too few")
        return found

    def _near(self, errors: Mapping[int, Array]) -> Flags:
        near = np.zeros(len(self.candidates), dtype=bool)
        near[list(errors)] = within_one_standard_error([one**2 for one in errors.values()])
        return near

    def _simplest(self, near: Flags, criterion: Array) -> int:
        """The place of the candidate with the fewest parameters among the near ones, of equals the best."""
        sizes = {int(i): needed(self.candidates[i].free_parameters()) for i in np.flatnonzero(near)}
        fewest = [i for i, size in sizes.items() if size == min(sizes.values())]
        return fewest[first_least(criterion[fewest])]

    def _fits(
        self, errors: Mapping[int, Array], whole: Mapping[int, Estimate], record: Record
    ) -> list[Array]:
        """Akaike's and Schwarz's criterion (C,) of the fits to the whole record; nan where there is none."""
        if self.by == "validation":
            errors = {}
            for i, estimate in whole.items():
                with suppress(*_FAILURES):
                    errors[i] = self.candidates[i].errors(estimate, record)
            errors = self._common(errors)
        elif self.by not in _PENALISED:
            errors = {}
        return [self._criterion(by, errors, record) for by in _INFORMATION]

    def _words(self, i: int) -> str:
        """The settings of a candidate."""
        paths = sorted(self.over)
        chosen = [*itertools.product(*(self.over[path] for path in paths))][i]
        return ", ".join(f"{path} {word(value)}" for path, value in zip(paths, chosen, strict=True))

    def _none(self, failures: Mapping[int, str]) -> str:
        """What to say where every candidate failed."""
        reasons: dict[str, list[int]] = {}
        for i, reason in failures.items():
            reasons.setdefault(reason, []).append(i)
        if len(reasons) == 1:
            return f"all {len(failures)} candidates fail: {next(iter(reasons))}"
        said = (
            f"{reason} ({self._words(where[0])})" for reason, where in itertools.islice(reasons.items(), 3)
        )
        return f"all {len(failures)} candidates fail, among others: {'; '.join(said)}"


def _name(path: str) -> str:
    """What an estimate's values call the choice of a setting."""
    return f"selected {path}"


def _chosen(estimate: Estimate) -> tuple[EstimatorSpec, Estimate]:
    """The estimator that a selection took, and the estimate as that one gave it."""
    found = estimate.details["selection"]
    assert isinstance(found, Selection)
    return found.estimator, replace(estimate, details={**estimate.details, "selection": found.within})


def _size(record: Record) -> float:
    """The mean square of the output."""
    return float(np.mean(record.y**2))
