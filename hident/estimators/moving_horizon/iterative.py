"""What the iterative two-stage estimators of Hammerstein and Wiener systems share."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Annotated, ClassVar, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from hident.arrays import Array
from hident.config.spec import Count, Flag, Real
from hident.errors import EstimationError
from hident.estimators.base import CONTINUOUS, AtOneInterval, require_finite, require_varying
from hident.estimators.convergence import Unconverged
from hident.estimators.moving_horizon.searches import StructureSearch
from hident.estimators.moving_horizon.transform.horizon_least_squares import (
    scaled_condition,
    variance_inflation,
)
from hident.estimators.moving_horizon.transform.linear_transform import LinearFit, SecondStageSpec, StageSpec
from hident.estimators.moving_horizon.transform.time_weighted import Horizons
from hident.linear_blocks import ContinuousTransferFunction
from hident.numerics.parts import Parts, whole
from hident.records import Record


def parameter_names(n: int, lowest: int = 0) -> list[str]:
    """a_1, ..., a_n, b_lowest, ..., b_(n - 1)."""
    return [*(f"a_{i}" for i in range(1, n + 1)), *(f"b_{i}" for i in range(lowest, n))]


def padded(a: ArrayLike, b: ArrayLike, n: int, lowest: int = 0) -> Array:
    """What belongs to :func:`parameter_names`, zero where ``a`` and ``b`` have no parameter."""
    return np.concatenate([np.pad(a, (0, n - np.size(a))), np.pad(b, (0, n - lowest - np.size(b)))])


def regression_names(n: int) -> list[str]:
    """The names that :func:`regression_values` has for a block of at most order ``n``."""
    return [*parameter_names(n), "vif_mean", "vif_max", "condition"]


def regression_values(block: ContinuousTransferFunction, phi: Array, n: int) -> list[float]:
    """The parameters, mean and largest variance inflation factor, and scaled condition of the regressors."""
    factors = variance_inflation(phi)
    measures = factors.mean(), factors.max(), scaled_condition(phi)
    return [*padded(block.a, block.b, n).tolist(), *map(float, measures)]


@contextmanager
def under(field: str) -> Iterator[None]:
    """Name the field under which the values of a ValueError stand."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{error} (under '{field}')") from None


# Section 5's loop ends after this many rounds at the latest.
ROUNDS = 5


class MovingHorizonSpec(AtOneInterval):
    """Base of the estimators of continuous-time models over moving horizons.

    Every horizon lies inside one experiment. Each experiment begins at rest: its input is zero before it, so
    that the delayed input is known from the delay on, or, where it is not, from 'start' on.
    """

    delay: Annotated[Real, Field(ge=0)] = 0.0
    """Delay d, in the unit of dt; need not be a multiple of dt."""
    start: Annotated[Real, Field(ge=0)] = 0.0
    """Time t_0 at which the first horizon starts, counted from the start of each experiment."""
    constant: Flag = False
    """Estimate a constant that is added to the output, such as the offset of a sensor; else it is zero."""

    def letters(self) -> Mapping[str, str]:
        return CONTINUOUS

    def constant_names(self) -> list[str]:
        """The name of the constant's value, if it is estimated."""
        return ["constant"] if self.constant else []

    def free_parameters(self) -> int | None:
        found = super().free_parameters()
        return None if found is None else found + self.constant

    def fewest_samples(self) -> int:
        return 2

    def check(self, n: int, dt: float | None) -> None:
        self._check(whole(n), dt)

    def _check(self, parts: Parts, dt: float | None) -> None:
        if dt is None:
            raise ValueError("a continuous-time method needs the sampling interval 'dt' of the data")
        n = max(part.stop - part.start for part in parts)
        length = (n - 1) * dt
        for delay, field in (
            (self.delay, ""),
            *((delay, f" of {field}") for delay, field in self.tried_delays()),
        ):
            if delay >= length:
                raise ValueError(
                    f"the delay {delay:g}{field} is no shorter than the record, {length:g}: "
                    "take a shorter delay or a longer record"
                )
        self.check_horizons(parts, dt)

    def tried_delays(self) -> Iterator[tuple[float, str]]:
        """The delays that a search tries, each with the field that it stands in."""
        yield from ()

    def check_horizons(self, parts: Parts, dt: float) -> None:
        """Raise ValueError if the horizons do not suit the experiments ``parts``, sampled every ``dt``."""
        raise NotImplementedError

    def check_record(self, record: Record) -> None:
        self.require_experiments(record)
        try:
            self._check(record.experiments, record.dt)
        except ValueError as error:
            raise EstimationError(str(error)) from None

    def sampling_interval(self, record: Record) -> float:
        """The sampling interval of a record that suits; EstimationError if it does not."""
        require_finite(record.y)
        MovingHorizonSpec.check_record(self, record)
        if not np.any(record.y):
            raise EstimationError("the output is zero throughout")
        require_varying(record.y, "output")
        assert record.dt is not None
        return record.dt


class FirstStage(Protocol):
    """What a first stage found."""

    @property
    def block(self) -> ContinuousTransferFunction:
        """The linear block."""


F = TypeVar("F", bound=FirstStage)


class IterativeSpec(MovingHorizonSpec):
    """Base of the iterative two-stage estimators."""

    share: ClassVar[float]
    """Section 4.4: the share of the settling time that the second stage's horizons last."""
    guesses: ClassVar[bool] = False
    """Whether section 5's loop finds the first structure with a static function of its own."""
    instead: ClassVar[Mapping[str, str]] = {
        "delay": "'second: {structure: search, delays: [...]}' searches among several"
    }

    first: StageSpec
    """The first stage, which finds the static function."""
    second: SecondStageSpec | None = None
    """The second stage, which finds the linear block; without it the first stage's block is the estimate."""
    automatic: Flag = False
    """Section 5's loop: the structure that the second stage finds is the first stage's until it repeats."""
    tolerance: Annotated[Real, Field(gt=0)]
    """The iteration ends when the parameters change by less than this, relative to their norm."""
    max_iterations: Annotated[Count, Field(ge=1)]
    """The most iterations."""
    unconverged: Unconverged = "fail"
    """Whether a first stage that has not converged by then counts as failed, or is kept as it is."""

    @model_validator(mode="after")
    def _loop_needs_a_search(self) -> Self:
        if self.automatic and (self.second is None or self.second.structure != "search"):
            raise ValueError("'automatic' needs a second stage with 'structure: search'")
        return self

    @property
    def largest_n(self) -> int:
        """The largest order n among the stages, up to which parameters are named."""
        return max(self.first.n, 0 if self.second is None else self.second.most)

    def stages(
        self,
        first: Callable[[StageSpec, float, bool], F],
        second: Callable[[F, SecondStageSpec, float], tuple[LinearFit, StructureSearch | None]],
    ) -> tuple[F, LinearFit | None, StructureSearch | None]:
        """Both stages, the second if there is one, in section 5's loop if that is asked for.

        ``first`` takes a structure, a delay, and whether the static function is to be guessed; ``second``
        takes what it found, the second stage, and the length eta of its horizons.

        Raises
        ------
        EstimationError
            If the first stage's block never settles, or the loop ends while the structure still changes.
        """
        guess = self.automatic and self.guesses
        found = first(self.first, self.delay, guess)
        if self.second is None:
            return found, None, None
        fit, search = second(found, self.second, self._second_horizon(found.block))
        for _ in range(ROUNDS if self.automatic else 0):
            n, m, delay = structure_of(fit.block)
            if structure_of(found.block) == (n, m, delay) and not guess:
                break
            guess = False
            found = first(self.first.of_structure(n, m), delay, guess)
            fit, search = second(found, self.second, self._second_horizon(found.block))
        unsettled = self.automatic and structure_of(found.block) != structure_of(fit.block)
        if unsettled and self.unconverged == "fail":
            raise EstimationError(f"the structure still changes after {ROUNDS} rounds of 'automatic'")
        return found, fit, search

    def _second_horizon(self, block: ContinuousTransferFunction) -> float:
        settling = block.settling_time()
        if not math.isfinite(settling):
            raise EstimationError(
                "the first stage's block is unstable or has no static gain: it never settles"
            )
        given = None if self.second is None else self.second.horizon
        return self.share * settling if given is None else given

    def function_parameters(self) -> int:
        """The number of parameters of the first stage besides a_1, ..., a_n and b_1, ..., b_m."""
        raise NotImplementedError

    def first_parameters(self, stage: StageSpec) -> int:
        """The number of parameters of the first stage."""
        return stage.n + stage.m + self.function_parameters() + self.constant

    def tried_delays(self) -> Iterator[tuple[float, str]]:
        if self.second is not None:
            yield from ((delay, "second.delays") for delay in self.second.delays)

    def check_horizons(self, parts: Parts, dt: float) -> None:
        n, stages = parts[-1].stop, [self.first]
        if self.automatic:
            stages.append(self.first.of_structure(self.largest_n, self.largest_n - 1))
        with under("first"):
            for stage in stages:
                stage.horizons(n, dt, self.start, self.first_parameters(stage), parts)
        if self.second is not None:
            with under("second"):
                self.second.check(n, dt, self.start, gain=False, parts=parts)

    def error_names(self, lowest: int) -> list[str]:
        """The names of the standard errors of a_1, ... and of b_i from b_lowest on."""
        return [f"se_{name}" for name in parameter_names(self.largest_n, lowest)]

    def stage_names(self) -> list[str]:
        """The names of the values of both stages' linear blocks and regressions."""
        names = regression_names(self.largest_n)
        return [*names, *(f"first_{name}" for name in names), "n", "m", "delay", "settling_time", "horizon"]

    def stage_values(
        self, first: ContinuousTransferFunction, phi: Array, horizons: Horizons, second: LinearFit | None
    ) -> list[float]:
        """The values of :meth:`stage_names`, from the first stage's block, regressors and horizons."""
        block, last_phi = first, phi
        if second is not None:
            block, last_phi, horizons = second.block, second.regressors, second.horizons
        return [
            *regression_values(block, last_phi, self.largest_n),
            *regression_values(first, phi, self.largest_n),
            *structure_of(block),
            first.settling_time(),
            horizons.eta,
        ]


def known(constant: float | None) -> list[float]:
    """The constant's value, if it was estimated."""
    return [] if constant is None else [constant]


def structure_of(block: ContinuousTransferFunction) -> tuple[int, int, float]:
    """n, m and the delay of a block."""
    return len(block.a), len(block.b) - 1, block.delay
