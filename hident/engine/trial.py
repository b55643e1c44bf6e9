"""One Monte Carlo trial: the only place where data meet an estimator."""

from __future__ import annotations

import copy
import hashlib
import json
import time
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import Annotated, Any, NamedTuple, TypeVar

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo

from hident import stopping
from hident.arrays import Array
from hident.config.spec import Count, Of, Real, Spec, canonical
from hident.config.suggest import one_of
from hident.engine.clock import Clock, Limit, TookTooLong
from hident.engine.comparable import completed, depends_on_estimate, truth_for
from hident.engine.scores import Scores, gathered
from hident.errors import EstimationError, TrialFailed
from hident.estimators.base import Batched, EstimatorSpec, is_batched
from hident.metrics.base import MetricSpec
from hident.records import Estimate, Part, Record, Truth
from hident.signals.base import MOST_SAMPLES, ExcitationSpec, NoiseSpec, Stretch
from hident.signals.streams import NumpyStreams, OfData, StreamsSpec
from hident.systems.base import SystemSpec

T = TypeVar("T")

FAILURES = (TrialFailed, np.linalg.LinAlgError, ArithmeticError)
"""What an estimate, a metric or a simulation may raise as its result: the trial counts as failed."""
_PERTURBATION = 4
"""Spawn key of the perturbation's draws; those of the streams' roles are smaller."""
_SHARED = 0
"""The key of a stream that belongs to no case: what its cases have in common is the seed alone."""
_CHECKED = 1
"""The trial of which a batch is held against ``fit``: the first chunk of a run holds trial 0 alone."""
OF_METRIC = "metric: "
"""How the reason begins where the estimate was made and a metric failed on it."""


def digest(value: Any) -> str:
    """SHA-256 of plain data, 32 hexadecimal digits; keys are sorted, floats kept to the last bit."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _listed(value: Any) -> Any:
    if value is None:
        raise ValueError("must be a noise or a list of them; write [] for none")
    return [value] if isinstance(value, str | Mapping | NoiseSpec) else value


def _start_can_be_chosen(excitation: ExcitationSpec, info: ValidationInfo) -> ExcitationSpec:
    system = info.data.get("system")
    if excitation.chooses_start() and system is not None and not system.follows_waveforms():
        raise ValueError(
            "'start' needs a wiener_hammerstein system with continuous blocks; "
            f"this {system.kind} starts as its linear blocks say: leave it out"
        )
    return excitation


Samples = Annotated[Count, Field(ge=1, le=MOST_SAMPLES)]
Step = Annotated[Real, Field(gt=0)]
System = Annotated[SystemSpec, Of("system")]
Excitation = Annotated[ExcitationSpec, Of("excitation"), AfterValidator(_start_can_be_chosen)]
Noises = Annotated[tuple[Annotated[NoiseSpec, Of("noise")], ...], BeforeValidator(_listed)]
Streams = Annotated[StreamsSpec, Of("streams")]


class Data(Spec):
    """The data-generating part of a case: by a simulation, unless a subclass knows better."""

    samples: Samples
    """Length N of the record."""
    dt: Step | None = None
    """Sampling interval; leave out in discrete time, where times count samples."""
    system: System
    """The true system."""
    excitation: Excitation
    """The input signal."""
    noise: Noises = ()
    """What happens to the output on its way to the record, in this order."""
    streams: Streams = NumpyStreams()
    """Where the random numbers come from."""

    @cached_property
    def key(self) -> int:
        """Hash of everything that the data depend on besides the seed and the trial."""
        return int(digest(canonical(self)), 16)

    def stream_key(self, role: OfData) -> int:
        """The key of the stream of a role: that of the data, unless all cases share the stream."""
        return _SHARED if role in self.streams.share else self.key

    @property
    def resampled(self) -> bool:
        """Whether :meth:`record_for` gives each estimator records of its own."""
        return False

    @property
    def validated(self) -> bool:
        """Whether the records have a validation part."""
        return False

    @property
    def optional_files(self) -> tuple[str, ...]:
        """The names of the files without which a configuration is left out, not wrong."""
        return ()

    def require(self) -> None:
        """Raise ConfigError if this process cannot have the records."""

    def before_noise(self, seed: int, trial: int) -> Record:
        """The record before noise."""
        inputs = self.streams.generator("input", seed, self.stream_key("input"), trial)
        interval = _interval(self)
        stretches = self.excitation.stretches(self.samples, interval)
        one_grid = len(stretches) == 1 and stretches[0].dt == interval
        if not one_grid or self.system.follows_waveforms():
            u, y, parts = _experiments(self.system, stretches, inputs)
        else:
            u, y, parts = *_sampled(self.system, stretches[0], inputs), {}
        return Record(u, y, self.dt, self.system.truth(), parts)

    def record_for(self, job: Job, record: Record, seed: int, trial: int) -> Record:
        """The record that a job has in a trial, made from what :func:`generate` gives."""
        return record

    def lacks(self, need: str) -> str:
        """What to say of a part of the truth that something needs and that is not there."""
        because = f": {why}" if (why := self.system.lacks(need)) else ""
        return (
            f"needs the {need} of the system, which '{self.system.kind}' does not have{because} "
            f"(it has: {one_of(sorted(self.system.provides()))})"
        )

    def unrepeatable(self, estimator: EstimatorSpec) -> str:
        """Why an estimator cannot have more trials than one; empty if it can."""
        return ""

    def says(self) -> str:
        """What tables say of the records; empty where the configuration says it all."""
        return ""


@dataclass(frozen=True)
class Job:
    """One estimator and its metrics, as a trial needs them."""

    estimator: EstimatorSpec
    metrics: tuple[MetricSpec, ...]

    @cached_property
    def key(self) -> int:
        """Hash that the estimator's own random stream depends on."""
        return int(digest(canonical(self.estimator)), 16)


class Crash(NamedTuple):
    """An error that is not a result."""

    error: str
    traceback: str


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one job gave in its trials: the scores of each of its metrics.

    A trial that crashed, in the estimate or in a metric, has no scores there, and its first crash is among
    ``crashes``. Trials that the clock ended are in ``late`` instead, as scores that failed. ``seconds`` says
    how long each estimate took that there is; of a batch, each has the same share.
    """

    scores: tuple[Scores, ...]
    crashes: Mapping[int, Crash]
    late: tuple[Scores, ...]
    seconds: Scores


def generate(data: Data, seed: int, trial: int, perturbation: int = 0) -> Record:
    """The record of one trial; with a ``perturbation``, that record a last bit away.

    Under perturbation k > 0 each sample of y, and each level of u, is moved toward zero by one unit in the
    last place or left, at random: another draw for each k, as another processor's rounding would be. Equal
    values of u stay equal, so that a held input keeps its levels. The truth stays.
    """
    noise = data.streams.generator("noise", seed, data.stream_key("noise"), trial)
    return _noisy(data, data.before_noise(seed, trial), noise, seed, trial, perturbation)


def _noisy(
    data: Data, clean: Record, noise: np.random.Generator, seed: int, trial: int, perturbation: int
) -> Record:
    if data.resampled and not perturbation:
        # One record for all trials: what they are resampled from is fitted to it once.
        return _unwritable(clean)
    # A noise that works in place has its own.
    u, y = clean.u, clean.y.copy()
    for spec in data.noise:
        y = spec.measure(y, noise)
    if perturbation:
        sequence = np.random.SeedSequence([seed, data.key, perturbation], spawn_key=(_PERTURBATION, trial))
        u, y = _perturbed(u, y, np.random.default_rng(sequence))
    return _unwritable(clean.with_signals(u, y))


def _unwritable(record: Record) -> Record:
    # All estimators of a trial share it: one that writes crashes instead of changing the others' data.
    record.u.flags.writeable = record.y.flags.writeable = False
    return record


def _perturbed(u: Array, y: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    def moved(values: Array) -> Array:
        return np.where(rng.random(len(values)) < 0.5, np.nextafter(values, 0.0), values)

    levels, level_of = np.unique(u, return_inverse=True)
    return moved(levels)[level_of], moved(y)


def _interval(data: Data) -> float:
    return 1.0 if data.dt is None else data.dt


def _experiments(
    system: SystemSpec, stretches: Sequence[Stretch], rng: np.random.Generator
) -> tuple[Array, Array, dict[str, Part]]:
    """Input and noise-free output of all experiments, one after the other, and where each stands."""
    inputs, outputs, parts, start = [], [], {}, 0
    for stretch in stretches:
        waveform = stretch.waveform(copy.deepcopy(rng))
        if system.follows_waveforms():
            u = stretch.excitation.sample(stretch.samples, stretch.dt, rng)
            y = system.respond(waveform, stretch.samples, stretch.dt)
        else:
            u, y = _sampled(system, stretch, rng)
        inputs.append(u)
        outputs.append(y)
        parts[stretch.name] = Part(start, start + stretch.samples, stretch.dt, waveform)
        start += stretch.samples
    return np.concatenate(inputs), np.concatenate(outputs), parts


def _sampled(system: SystemSpec, stretch: Stretch, rng: np.random.Generator) -> tuple[Array, Array]:
    """Input and noise-free output of one experiment on a system that knows the input by its samples."""
    burn_in = system.burn_in()
    u = stretch.excitation.sample(stretch.samples, stretch.dt, rng, burn_in)
    return u[burn_in:], system.simulate(u, stretch.dt)[burn_in:]


def estimate(data: Data, job: Job, record: Record, seed: int, trial: int) -> Estimate:
    """The estimate of one job from a trial's record.

    Raises
    ------
    EstimationError
        If the estimator does not take the record's experiments; and what its ``fit`` raises.
    """
    job.estimator.require_experiments(record)
    # An estimator that draws, and does not say so, must crash, not draw from a stream that is not its own.
    draws = job.estimator.draws()
    rng = data.streams.generator("estimator", seed, job.key, trial) if draws else None
    return job.estimator.fit(record, rng)


def run_trials(
    data: Data,
    jobs: Sequence[Job],
    wanted: Sequence[Sequence[int]],
    seed: int,
    perturbation: int = 0,
    limit: Limit | None = None,
) -> list[Outcome]:
    """Run each job in the trials that it is wanted for, which rise: its outcome.

    A failure or a crash does not end the others, so that what was computed can be kept. The numbers do not
    depend on which trials run together. With a limit, each record, estimate and score of a trial is ended
    that takes longer.
    """
    data.require()
    with Clock(limit) as clock:
        trials = sorted({trial for of in wanted for trial in of})
        made = _records(data, seed, trials, perturbation, clock)
        records = {trial: record for trial, record in made.items() if isinstance(record, Record)}
        failed = {trial: error for trial, error in made.items() if isinstance(error, BaseException)}
        outcomes = []
        for job, of in zip(jobs, wanted, strict=True):
            there = {trial: records[trial] for trial in of if trial in records}
            own, lost = _own(data, job, there, seed, clock)
            seconds: dict[int, float] = {}
            found = {**failed, **lost, **_estimates(data, job, own, seed, clock, seconds)}
            outcomes.append(_outcome(data, job, {trial: found[trial] for trial in of}, own, clock, seconds))
    return outcomes


def _own(
    data: Data, job: Job, records: dict[int, Record], seed: int, clock: Clock
) -> tuple[dict[int, Record], dict[int, BaseException]]:
    """The records that the job has in the trials, and what was raised in place of others."""
    if not data.resampled:
        return records, {}
    made = {
        trial: _attempt(partial(data.record_for, job, record, seed, trial), clock)
        for trial, record in records.items()
    }
    return (
        {trial: one for trial, one in made.items() if isinstance(one, Record)},
        {trial: one for trial, one in made.items() if isinstance(one, BaseException)},
    )


def _outcome(
    data: Data,
    job: Job,
    found: Mapping[int, Estimate | BaseException],
    records: Mapping[int, Record],
    clock: Clock,
    seconds: Mapping[int, float],
) -> Outcome:
    crashes: dict[int, Crash] = {}
    scores, late = [], []
    truth = data.system.truth()
    for written in job.metrics:
        labels = len(written.labels(""))
        made = _attempt(partial(scoring_of, written, job.estimator, truth, data.dt), clock)
        scored: dict[int, Array | str | Crash]
        if isinstance(made, BaseException):
            scored = dict.fromkeys(found, _failed(made, OF_METRIC))
        else:
            metric, seen = made
            scored = {
                trial: _score(metric, labels, one, partial(seen, records[trial]), clock)
                if isinstance(one, Estimate)
                else _failed(one)
                for trial, one in found.items()
            }
        crashes = {trial: one for trial, one in scored.items() if isinstance(one, Crash)} | crashes
        ended = {trial: str(one) for trial, one in scored.items() if isinstance(one, _Late)}
        kept = {trial: one for trial, one in scored.items() if not isinstance(one, Crash | _Late)}
        scores.append(gathered(kept, labels))
        late.append(gathered(ended, labels))
    return Outcome(tuple(scores), crashes, tuple(late), _seconds_of(found, seconds))


def _seconds_of(found: Mapping[int, Estimate | BaseException], seconds: Mapping[int, float]) -> Scores:
    """The seconds of the estimates that there are: how soon a method fails says nothing of its speed."""
    timed = [trial for trial, one in found.items() if isinstance(one, Estimate)]
    taken = np.array([seconds[trial] for trial in timed], dtype=float)
    return Scores(np.array(timed, dtype=np.int64), taken[:, np.newaxis])


def scoring_of(
    metric: MetricSpec, estimator: EstimatorSpec, truth: Truth, dt: float | None
) -> tuple[MetricSpec, Callable[[Record, Estimate], Record]]:
    """The metric as it scores the estimator's estimates, and what makes the records that it is given.

    They are the trial's own, unless the truth must be brought to the estimator's form first, which may be
    that of the one estimate.

    Raises
    ------
    ValueError
        If nothing brings the truth to the estimator's form.
    """
    brought = truth_for(metric, estimator, truth, dt)
    complete, of_each = completed(metric, estimator, dt), depends_on_estimate(metric, estimator)

    def seen(record: Record, found: Estimate) -> Record:
        own = truth_for(metric, estimator, truth, dt, found) if of_each else brought
        return record if own is truth else replace(record, truth=own)

    return complete, seen


def _attempt(make: Callable[[], T], clock: Clock) -> T | BaseException:
    """What is made, or what was raised instead."""
    try:
        with np.errstate(all="ignore"):
            return clock.limited(make)
    # Whatever a component raises, SystemExit and GeneratorExit too, must not end the run.
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) and stopping.may_interrupt():
            raise
        return error


def _records(
    data: Data, seed: int, trials: Sequence[int], perturbation: int, clock: Clock
) -> dict[int, Record | BaseException]:
    """The records of the trials, or what was raised; where the input is fixed, they are simulated once."""
    once = cache(lambda: data.before_noise(seed, 0)) if data.streams.is_fixed("input") else None
    key = data.stream_key("noise")
    noises = _attempt(lambda: data.streams.generators("noise", seed, key, trials), clock)

    def record(place: int, trial: int) -> Record:
        clean = once() if once else data.before_noise(seed, trial)
        # Where one of the streams cannot be had, the others can.
        if isinstance(noises, BaseException):
            noise = data.streams.generator("noise", seed, key, trial)
        else:
            noise = noises[place]
        return _noisy(data, clean, noise, seed, trial, perturbation)

    return {trial: _attempt(partial(record, place, trial), clock) for place, trial in enumerate(trials)}


def _estimates(
    data: Data,
    job: Job,
    records: Mapping[int, Record],
    seed: int,
    clock: Clock,
    seconds: dict[int, float],
) -> dict[int, Estimate | BaseException]:
    """The estimates from the records, or what was raised; ``seconds`` is told how long each took."""

    def apart(trials: Iterable[int]) -> dict[int, Estimate | BaseException]:
        found: dict[int, Estimate | BaseException] = {}
        for trial in trials:
            alone = partial(estimate, data, job, records[trial], seed, trial)
            found[trial], seconds[trial] = _timed(alone, clock)
        return found

    if not (is_batched(job.estimator) and records):
        return apart(records)
    together, took = _timed(partial(_together, data, job, job.estimator, records, seed), clock)
    if not isinstance(together, BaseException):
        wrong = _otherwise(together, apart({_CHECKED} & together.keys() if len(together) > 1 else ()))
        seconds |= dict.fromkeys(records, took / len(records))
        return dict.fromkeys(records, wrong) if wrong else {**together}
    late = isinstance(together, TookTooLong)
    if late and len(records) == 1:
        return dict.fromkeys(records, together)
    found = apart(records)
    # Where no record by itself explains the error, it is that of fit_many; but the clock is for one trial.
    own = not late and all(isinstance(one, Estimate) for one in found.values())
    return dict.fromkeys(records, together) if own else found


def _timed(make: Callable[[], T], clock: Clock) -> tuple[T | BaseException, float]:
    """What is made, or what was raised instead, and the seconds that it took."""
    start = time.perf_counter()
    made = _attempt(make, clock)
    return made, time.perf_counter() - start


def _together(
    data: Data, job: Job, estimator: Batched, records: Mapping[int, Record], seed: int
) -> dict[int, Estimate | EstimationError]:
    # Most have the same experiments.
    for record in {(id(record.parts), record.dt): record for record in records.values()}.values():
        estimator.require_experiments(record)
    drawn = []
    if job.estimator.draws():
        drawn = [data.streams.generators("estimator", seed, job.key, [*records])]
    found = estimator.fit_many([*records.values()], *drawn)
    kinds = {type(one).__name__ for one in found if not isinstance(one, Estimate | EstimationError)}
    if kinds or len(found) != len(records):
        named = f"fit_many of {type(estimator).__name__}"
        raise TypeError(
            f"{named} gave a {min(kinds)} where an Estimate or an EstimationError belongs"
            if kinds
            else f"{named} gave {len(found)} estimates for {len(records)} records"
        )
    return dict(zip(records, found, strict=True))


def _otherwise(
    together: Mapping[int, Estimate | EstimationError], apart: Mapping[int, Estimate | BaseException]
) -> ValueError | None:
    """What is wrong where ``fit_many`` gives other values of a record than ``fit``."""
    for trial, by_itself in apart.items():
        if isinstance(by_itself, TookTooLong):
            continue
        one, other = (
            {name: repr(float(value)) for name, value in found.values.items()}
            if isinstance(found, Estimate)
            else {}
            for found in (together[trial], by_itself)
        )
        for name in {**one, **other}:
            if one.get(name) != other.get(name):
                return ValueError(
                    f"fit_many gives {name} = {one.get(name)} for trial {trial}, and fit {other.get(name)}"
                )
    return None


class _Late(str):
    """Why a trial failed that the clock ended."""

    __slots__ = ()


def _score(
    metric: MetricSpec, labels: int, found: Estimate, seen: Callable[[Estimate], Record], clock: Clock
) -> Array | str | Crash:
    """The values of a metric of what is ``seen``; or why it failed; or its crash."""
    values = _attempt(lambda: numbers(metric, found, seen(found), labels), clock)
    return _failed(values, OF_METRIC) if isinstance(values, BaseException) else values


def numbers(metric: MetricSpec, found: Estimate, record: Record, labels: int) -> Array:
    """The values of a metric, so many as it has labels; what is raised is what its ``evaluate`` raises."""
    values = np.array(metric.evaluate(found, record), dtype=float)
    if values.shape != (labels,):
        raise ValueError(f"the metric '{metric.kind}' gives {values.size} values for {labels} labels")
    return values


def _failed(error: BaseException, prefix: str = "") -> str | Crash:
    """The reason, if the error is a result."""
    if isinstance(error, FAILURES):
        return (_Late if isinstance(error, TookTooLong) else str)(prefix + reason(error))
    said = f"{type(error).__name__}: {_text(error)}"
    return Crash(said, _encodable("".join(traceback.format_exception(error))))


def reason(error: BaseException) -> str:
    """Why a trial failed, in words."""
    if isinstance(error, ArithmeticError):
        return f"{type(error).__name__}: {_text(error)}"
    return _text(error) or "singular"


def _text(error: BaseException) -> str:
    try:
        return _encodable(str(error))
    except Exception:
        return "(its message cannot be shown)"


def _encodable(text: str) -> str:
    """The text as a file can hold it: lone surrogates are written out."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")
