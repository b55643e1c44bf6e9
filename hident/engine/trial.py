"""One Monte Carlo trial: the only place where data meet an estimator."""

from __future__ import annotations

import hashlib
import json
import traceback
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, cast

import numpy as np
from pydantic import Field, field_validator

from hident.config.spec import Count, Of, Real, Spec, canonical
from hident.errors import EstimationError, SimulationError
from hident.estimators.base import EstimatorSpec
from hident.metrics.base import MetricSpec
from hident.records import Array, Estimate, Record
from hident.signals.base import ExcitationSpec, NoiseSpec
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
        return [value] if isinstance(value, str | Mapping | NoiseSpec) else value

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


def generate_input(data: Data, seed: int, trial: int, burn_in: int = 0) -> Array:
    """The input of one trial (burn_in + N,), which begins ``burn_in`` samples before the record."""
    dt = 1.0 if data.dt is None else data.dt
    stream = data.streams.generator("input", seed, data.key, trial)
    return data.excitation.sample(data.samples, dt, stream, burn_in)


def generate(data: Data, seed: int, trial: int) -> Record:
    """The record of one trial."""
    burn_in = data.system.burn_in()
    u = generate_input(data, seed, trial, burn_in)
    y = data.system.simulate(u, 1.0 if data.dt is None else data.dt)[burn_in:]
    noise = data.streams.generator("noise", seed, data.key, trial)
    for spec in data.noise:
        y = spec.measure(y, noise)
    u = u[burn_in:]
    # All estimators of a trial share them: one that writes crashes instead of changing the others' data.
    u.flags.writeable = y.flags.writeable = False
    return Record(u, y, data.dt, data.system.truth())


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
        except (EstimationError, np.linalg.LinAlgError) as error:
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
