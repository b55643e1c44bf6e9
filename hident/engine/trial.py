"""One Monte Carlo trial: the only place where data meet an estimator."""

from __future__ import annotations

import copy
import hashlib
import json
import traceback
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, cast

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from hident.config.spec import Count, Of, Real, Spec, canonical
from hident.errors import SimulationError, TrialFailed
from hident.estimators.base import EstimatorSpec
from hident.metrics.base import MetricSpec
from hident.records import Array, Estimate, Part, Record
from hident.signals.base import ExcitationSpec, NoiseSpec, Stretch
from hident.signals.streams import NumpyStreams, StreamsSpec
from hident.systems.base import SystemSpec

# A plugin that calls sys.exit() must not end the run.
_CRASHES = (Exception, SystemExit)


def digest(value: Any) -> str:
    """SHA-256 of plain data, 32 hexadecimal digits; keys are sorted, floats kept to the last bit."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


class Data(Spec):
    """The data-generating part of a case."""

    samples: Annotated[Count, Field(ge=1)]
    """Length N of the record."""
    dt: Annotated[Real, Field(gt=0)] | None = None
    """Sampling interval; leave out in discrete time, where times count samples."""
    system: Annotated[SystemSpec, Of("system")]
    """The true system."""
    excitation: Annotated[ExcitationSpec, Of("excitation")]
    """The input signal."""
    noise: tuple[Annotated[NoiseSpec, Of("noise")], ...] = ()
    """What happens to the output on its way to the record, in this order."""
    streams: Annotated[StreamsSpec, Of("streams")] = NumpyStreams()
    """Where the random numbers come from."""

    @field_validator("noise", mode="before")
    @classmethod
    def _listed(cls, value: Any) -> Any:
        if value is None:
            raise ValueError("must be a noise or a list of them; write [] for none")
        return [value] if isinstance(value, str | Mapping | NoiseSpec) else value

    @field_validator("excitation")
    @classmethod
    def _start_can_be_chosen(cls, excitation: ExcitationSpec, info: ValidationInfo) -> ExcitationSpec:
        system = info.data.get("system")
        if excitation.chooses_start() and system is not None and not system.follows_waveforms():
            raise ValueError(
                "'start' needs a wiener_hammerstein system with continuous blocks; "
                f"this {system.kind} starts as its linear blocks say: leave it out"
            )
        return excitation

    @cached_property
    def key(self) -> int:
        """Hash of everything that the data depend on besides the seed and the trial."""
        return int(digest(canonical(self)), 16)


@dataclass(frozen=True)
class Job:
    """One estimator and its metrics, as a trial needs them."""

    estimator: EstimatorSpec
    metrics: tuple[MetricSpec, ...]

    @cached_property
    def key(self) -> int:
        """Hash that the estimator's own random stream depends on."""
        return int(digest(canonical(self.estimator)), 16)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one job gave in one trial.

    ``values`` holds a number for each label of each metric, nan throughout if the estimate failed; then
    ``failure`` says why. Of an error that is not a result, ``failure`` is the message and ``crash`` the
    traceback.
    """

    job: int
    trial: int
    values: Array
    failure: str = ""
    crash: str = ""


def generate(data: Data, seed: int, trial: int) -> Record:
    """The record of one trial."""
    inputs = data.streams.generator("input", seed, data.key, trial)
    stretches = data.excitation.stretches(data.samples, _interval(data))
    if len(stretches) > 1 or data.system.follows_waveforms():
        u, y, parts = _experiments(data.system, stretches, inputs)
    else:
        u, y, parts = *_sampled(data.system, stretches[0], inputs), {}
    noise = data.streams.generator("noise", seed, data.key, trial)
    for spec in data.noise:
        y = spec.measure(y, noise)
    # All estimators of a trial share them: one that writes crashes instead of changing the others' data.
    u.flags.writeable = y.flags.writeable = False
    return Record(u, y, data.dt, data.system.truth(), parts)


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
    """The estimate of one job from a trial's record."""
    if job.estimator.draws():
        rng = data.streams.generator("estimator", seed, job.key, trial)
    else:
        # An estimator that draws all the same must crash, not draw from a stream that is not its own.
        rng = cast(np.random.Generator, None)
    return job.estimator.fit(record, rng)


def run_trials(
    data: Data, jobs: Sequence[Job], wanted: Mapping[int, Sequence[int]], seed: int
) -> list[Outcome]:
    """Run the jobs that each trial wants: ``wanted`` maps trials to indices of jobs.

    A crash does not end the others, so that what was computed can be kept.
    """
    with np.errstate(all="ignore"):
        return [
            outcome
            for trial, indices in wanted.items()
            for outcome in _run_trial(data, jobs, indices, seed, trial)
        ]


def _run_trial(
    data: Data, jobs: Sequence[Job], indices: Sequence[int], seed: int, trial: int
) -> Iterator[Outcome]:
    try:
        record = generate(data, seed, trial)
    except SimulationError as error:
        yield from (_failed(index, jobs[index], trial, error) for index in indices)
        return
    except _CRASHES as error:
        yield from (_crashed(index, trial, error) for index in indices)
        return
    for index in indices:
        job = jobs[index]
        try:
            found = estimate(data, job, record, seed, trial)
            values = [value for metric in job.metrics for value in _scored(metric, found, record)]
            yield Outcome(index, trial, np.array(values, dtype=float))
        except (TrialFailed, np.linalg.LinAlgError) as error:
            yield _failed(index, job, trial, error)
        except _CRASHES as error:
            yield _crashed(index, trial, error)


def _scored(metric: MetricSpec, found: Estimate, record: Record) -> Sequence[float]:
    values, labels = metric.evaluate(found, record), metric.labels("")
    if len(values) != len(labels):
        raise ValueError(f"the metric '{metric.kind}' gives {len(values)} values for {len(labels)} labels")
    return values


def _failed(index: int, job: Job, trial: int, error: Exception) -> Outcome:
    count = sum(len(metric.labels("")) for metric in job.metrics)
    return Outcome(index, trial, np.full(count, np.nan), failure=str(error) or "singular")


def _crashed(index: int, trial: int, error: BaseException) -> Outcome:
    said = f"{type(error).__name__}: {error}"
    return Outcome(index, trial, np.empty(0), said, "".join(traceback.format_exception(error)))
