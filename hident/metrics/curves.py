"""An estimate as curves: its blocks and its output at given points, whose spread over trials figures show."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from hident.arrays import Array
from hident.block_chain import BlockChain
from hident.config.spec import Count, Interval, component
from hident.config.suggest import there_is_no
from hident.errors import EstimationError
from hident.fitted_model import FittedModel
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction
from hident.metrics.base import MetricSpec
from hident.metrics.outputs import OnOutput
from hident.numerics.parts import in_each, longer_than
from hident.records import Estimate, Record, needed
from hident.sampled_blocks import SampledTransferFunction
from hident.static_functions import StaticFunction

# The default band reaches so far below the Nyquist frequency.
_BELOW = 1000.0
_MOST_POINTS = 1000


@dataclass(frozen=True, eq=False)
class Points:
    """The points ``x`` (K,) of one curve, and the labels of the metric's numbers there."""

    x: Array
    labels: tuple[str, ...]


class CurveMetric(MetricSpec):
    """Base of the metrics whose numbers are the ordinates of curves."""

    def curves(self, name: str, dt: float | None) -> Mapping[str, Points]:
        """The curves by what they are, given the metric's own name and the sampling interval of the data."""
        raise NotImplementedError

    def measured(self, record: Record) -> Array | None:
        """What was measured at the points of its only curve (K,); None if nothing was."""
        return None


def _chain(estimate: Estimate) -> BlockChain:
    model = estimate.model
    if not isinstance(model, FittedModel):
        raise EstimationError("the estimate is no chain of blocks that have names: leave 'block' out")
    return model.chain


def _named(estimate: Estimate, name: str, kind: type) -> TransferFunction | StaticFunction:
    """The block of a chain by its name."""
    chain = _chain(estimate)
    found = {
        one: block for one, block in zip(chain.names, chain.blocks, strict=True) if isinstance(block, kind)
    }
    if name not in found:
        raise EstimationError(there_is_no("block", name, found))
    return found[name]


class _OfBlock(CurveMetric):
    block: str = ""
    """Name of the block in the chain, such as N1 or L2; the only one of its sort by default."""

    def needs_of_estimate(self) -> frozenset[str]:
        return frozenset({"model" if self.block else self.part})

    @property
    def part(self) -> str:
        """The part of an estimate that holds the only block of its sort."""
        raise NotImplementedError


@component("metric", "static_function")
class StaticFunctionValues(_OfBlock):
    """A static function at evenly spaced inputs.

    Examples
    --------
    >>> import hident as hi
    >>> metric = hi.StaticFunctionValues(interval=[0, 2], points=3)
    >>> hi.score(hi.Estimate(nonlinearity=np.square), hi.Record([0], [0]), f=metric)
    {'f 1': 0.0, 'f 2': 1.0, 'f 3': 4.0}
    """

    interval: Interval
    """Where the input begins and ends."""
    points: Annotated[Count, Field(ge=2, le=_MOST_POINTS)] = 41
    """Number of inputs."""

    @property
    def part(self) -> str:
        return "nonlinearity"

    def labels(self, name: str) -> tuple[str, ...]:
        return tuple(f"{name} {k}" for k in range(1, self.points + 1))

    def curves(self, name: str, dt: float | None) -> Mapping[str, Points]:
        return {"value": Points(np.linspace(*self.interval, self.points), self.labels(name))}

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        x = np.linspace(*self.interval, self.points)
        found = _named(estimate, self.block, StaticFunction) if self.block else needed(estimate.nonlinearity)
        assert not isinstance(found, TransferFunction)
        values: list[float] = np.asarray(found(x), dtype=float).tolist()
        return values


@component("metric", "frequency_response")
class FrequencyResponse(_OfBlock):
    """Gain in dB and phase in degrees of a linear block, at frequencies of equal ratios.

    Those of a continuous block are without the hold. The phase is unwound from the lowest frequency on.

    Examples
    --------
    >>> import hident as hi
    >>> metric = hi.FrequencyResponse(band=[0.1, 1], points=2)
    >>> estimate = hi.Estimate(linear=hi.TransferFunction(b=(0.0, 10.0)))
    >>> scores = hi.score(estimate, hi.Record([0], [0]), g=metric)
    >>> {name: round(value, 1) for name, value in scores.items()}
    {'g gain 1': 20.0, 'g gain 2': 20.0, 'g phase 1': -5.7, 'g phase 2': -57.3}
    """

    band: Interval | None = None
    """Lowest and highest angular frequency, radians in the unit of time (default: up to the Nyquist
    frequency, from a thousandth of it)."""
    points: Annotated[Count, Field(ge=2, le=_MOST_POINTS)] = 41
    """Number of frequencies."""

    @model_validator(mode="after")
    def _positive(self) -> Self:
        if self.band is not None and self.band[0] <= 0.0:
            raise ValueError(f"'band' must begin above zero, not at {self.band[0]:g}")
        return self

    @property
    def part(self) -> str:
        return "linear or continuous"

    def labels(self, name: str) -> tuple[str, ...]:
        return tuple(f"{name} {what} {k}" for what in ("gain", "phase") for k in range(1, self.points + 1))

    def curves(self, name: str, dt: float | None) -> Mapping[str, Points]:
        labels, omega = self.labels(name), self._omega(dt)
        return {
            "gain": Points(omega, labels[: self.points]),
            "phase": Points(omega, labels[self.points :]),
        }

    def _omega(self, dt: float | None) -> Array:
        highest = math.pi / (dt or 1.0)
        return np.geomspace(*(self.band or (highest / _BELOW, highest)), self.points)

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        block = (
            _named(estimate, self.block, TransferFunction)
            if self.block
            else needed(estimate.continuous or estimate.linear)
        )
        omega = self._omega(record.dt)
        if isinstance(block, SampledTransferFunction):
            block = block.continuous
        if isinstance(block, ContinuousTransferFunction):
            response = block.frequency_response(omega)
        else:
            assert isinstance(block, TransferFunction)
            response = block.frequency_response(omega, record.dt or 1.0)
        gain = 20.0 * np.log10(np.maximum(np.abs(response), np.finfo(float).tiny))
        return [*gain.tolist(), *np.degrees(np.unwrap(np.angle(response))).tolist()]


@component("metric", "model_output")
class ModelOutput(OnOutput, CurveMetric):
    """The model's output at each of some samples.

    Examples
    --------
    >>> import hident as hi
    >>> record = hi.Record([1.0, 2.0, 3.0], [1.1, 1.9, 3.1])
    >>> estimate = hi.Estimate(response=lambda u, dt: 2.0 * u)
    >>> hi.score(estimate, record, y=hi.ModelOutput(samples=[2, 3]))
    {'y 2': 4.0, 'y 3': 6.0}
    """

    samples: tuple[Count, Count]
    """The first and the last sample, counted from 1 in what is left without ``n_init``."""

    @model_validator(mode="after")
    def _some(self) -> Self:
        first, last = self.samples
        if not 1 <= first <= last:
            raise ValueError(f"'samples' must count from 1 upwards, not from {first} to {last}")
        if last - first >= _MOST_POINTS:
            raise ValueError(f"'samples' are {last - first + 1}, and at most {_MOST_POINTS} are kept")
        return self

    def needs_of_estimate(self) -> frozenset[str]:
        return frozenset({self.needed_part()})

    def says(self, dt: float | None) -> str:
        return self.described()

    def labels(self, name: str) -> tuple[str, ...]:
        first, last = self.samples
        return tuple(f"{name} {k}" for k in range(first, last + 1))

    def curves(self, name: str, dt: float | None) -> Mapping[str, Points]:
        first, last = self.samples
        k = np.arange(first, last + 1, dtype=float)
        return {"output": Points((self.n_init + k - 1.0) * (dt or 1.0), self.labels(name))}

    def measured(self, record: Record) -> Array | None:
        record = needed(record.validation) if self.on == "validation" else record
        parts = longer_than(record.experiments, self.n_init)
        first, last = self.samples
        return in_each(parts, lambda y: y[self.n_init :], record.y)[first - 1 : last]

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        made = self.compared(estimate, record).y_hat
        first, last = self.samples
        if last > len(made):
            raise EstimationError(f"there are {len(made)} samples, and 'samples' ends with {last}")
        values: list[float] = made[first - 1 : last].tolist()
        return values
