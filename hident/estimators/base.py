"""What every estimator's spec answers."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal, Protocol, TypeGuard, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from hident.arrays import Array, Characteristic, Flags
from hident.config.spec import Component
from hident.errors import EstimationError
from hident.estimators.normalisation import MissedConstant, Normalisation
from hident.model_output import simulated
from hident.records import Estimate, ModelPart, Record, Response

Experiments = Literal["one", "at_one_interval", "any"]
"""The records of several experiments that an estimator takes: none, those with one sampling interval, all."""

FEEDBACK = "coefficients of a discrete block's feedback"
NUMERATOR = "coefficients of a discrete block's numerator"
IMPULSE_RESPONSE = "values of a discrete block's impulse response"
POWERS = "coefficients of the nonlinearity's powers"
FUNCTIONS = "coefficients of the nonlinearity's own basis functions"
DISCRETE: Mapping[str, str] = {"a": FEEDBACK, "b": NUMERATOR}
CONTINUOUS: Mapping[str, str] = {
    "a": "coefficients of a continuous block's denominator",
    "b": "coefficients of a continuous block's numerator",
}

# Sampling intervals this close, relative to their size, are one.
_SAME_INTERVAL = 1e-9
_HUGE = 1e60
# Values this close, relative to the largest, are one.
_ROUNDING = 1e-13
# The most samples of an experiment in which what was before it is taken to show.
_UNKNOWN_PAST = 200
# A coefficient of a linear block or of a nonlinearity, such as a_1 or e_-2.
_COEFFICIENT = re.compile(r"[a-h]_-?\d+")


class EstimatorSpec(Component):
    """Base of all estimators.

    Of a continuous-time method, times are in the unit of ``dt``.

    ``fit`` raises :class:`hident.errors.EstimationError` when the estimate is singular or diverges.
    """

    identifies_dynamics: ClassVar[bool] = False
    """Whether the estimate always holds a discrete linear block, so that it can serve as a prefilter."""
    holds: ClassVar[tuple[ModelPart, ...]] = ()
    """The parts of the estimate besides its values."""

    def names(self) -> Sequence[str]:
        """The names of the estimate's values, in the order in which :meth:`named` takes them."""
        return ()

    def letters(self) -> Mapping[str, str]:
        """What its values are by their letters (``a`` for a_1, a_2, ...); one that is left out is not said.

        A value whose letter is something else in a system is not compared with the system's.
        """
        return {}

    def provides(self) -> frozenset[str]:
        """The parts of the estimate: those that it ``holds``, and ``value NAME`` for each value."""
        return frozenset((*self.holds, *(f"value {name}" for name in self.names())))

    def named(self, *values: ArrayLike) -> dict[str, float]:
        """The values by their names: numbers and arrays, one after the other.

        Raises
        ------
        ValueError
            If there are more or fewer than names.
        """
        names, numbers = self.names(), np.hstack(values).astype(float).tolist()
        if len(names) != len(numbers):
            raise ValueError(f"{self.kind} names {len(names)} values, and its estimate has {len(numbers)}")
        return dict(zip(names, numbers, strict=True))

    def fewest_samples(self) -> int:
        """The shortest record that the method accepts."""
        return 1

    def takes_experiments(self) -> Experiments:
        """Which records of several experiments (``Record.parts``) it takes; ``one``: none.

        ``at_one_interval``: it looks back in time or works at the record's sampling interval, and nothing
        that it does reaches from one experiment into another (see :mod:`hident.numerics.parts`). ``any``: it
        takes each sample by itself, or each experiment by itself at that experiment's own interval.
        """
        return "one"

    def check_experiments(self, intervals: Mapping[str, float], dt: float | None) -> None:
        """Raise EstimationError unless it takes a record of these experiments.

        ``intervals`` are the sampling intervals of the record's experiments by their names, ``dt`` the
        record's own (None: discrete time).
        """
        taken = self.takes_experiments()
        if taken == "any":
            return
        if taken == "one" and len(intervals) > 1:
            raise EstimationError(
                f"{self.kind} takes a record of one experiment, and this one has {len(intervals)}: "
                "it does not say that it keeps them apart"
            )
        step = 1.0 if dt is None else dt
        for name, interval in intervals.items():
            if abs(interval - step) > _SAME_INTERVAL * step:
                raise EstimationError(
                    f"{self.kind} works at one sampling interval, and the experiment '{name}' has "
                    f"{interval:g} where the record has {step:g}: sample all at the record's 'dt'"
                )

    def require_experiments(self, record: Record) -> None:
        """Raise EstimationError unless it takes the record's experiments.

        A run asks before each ``fit``; a ``fit`` that others call asks by itself.
        """
        self.check_experiments({name: part.dt for name, part in record.parts.items()}, record.dt)

    def draws(self) -> bool:
        """Whether ``fit`` draws from its stream; where it does not, the stream need not be seeded."""
        return True

    def needs_of_truth(self) -> frozenset[str]:
        """The parts it needs of the truth, as a bound or a reference does; none by default."""
        return frozenset()

    def normalisations(self) -> tuple[Normalisation, ...] | None:
        """How it fixes the factor between the blocks, which no data determine; None if it does not say.

        One rule for each set of parts; a part that none governs does not depend on the factor.
        """
        return None

    def misses_constant(self, nonlinearity: Characteristic) -> MissedConstant | None:
        """How it cannot hold the constant of a true nonlinearity; None if it can, or does not say."""
        missed = (rule.misses(nonlinearity) for rule in self.normalisations() or ())
        return next(filter(None, missed), None)

    def discrete_step(self, dt: float | None) -> float:
        """The sampling interval of the estimate's discrete linear block, given that of the data."""
        return 1.0 if dt is None else dt

    def check(self, n: int, dt: float | None) -> None:
        """Raise ValueError if records of ``n`` samples every ``dt`` (None: discrete time) do not suit."""

    def check_record(self, record: Record) -> None:
        """Raise EstimationError if a record like this one, that of trial 0, is hopeless."""

    def explains(self) -> bool:
        """Whether :meth:`errors` tells what its estimates leave unexplained of a record."""
        return not self.provides().isdisjoint({"response", "model"})

    def errors(self, estimate: Estimate, record: Record) -> Array:
        """What an estimate of this method leaves unexplained of a record's output, (N,).

        By default the output less what the model simulates from the input, each experiment from rest. The
        first samples of each, 200 or a tenth if that is fewer, are nan: what was before shows in them.

        Raises
        ------
        EstimationError
            If the estimate simulates no output that is finite.
        """
        errors = record.y - simulated(estimate, record)
        for part in record.experiments:
            errors[part.start : part.start + unknown_past(part.stop - part.start)] = np.nan
        return errors

    def begun_in_motion(self, shortest: int) -> EstimatorSpec:
        """The same method for experiments of at least so many samples that begin while all is in motion.

        By default itself. One that takes its experiments to begin in a state of its own leaves first samples
        out instead.
        """
        return self

    def left_out_errors(self, estimate: Estimate, record: Record) -> Array:
        """:meth:`errors` of the record that was fitted, (N,), each sample estimated without itself.

        Of those that provide ``left_out``.
        """
        raise NotImplementedError

    def free_parameters(self) -> int | None:
        """How many numbers it fits to a record; None if it does not say.

        By default its coefficients of linear blocks and nonlinearities. One that a rule fixes may be among
        them, the same one for all settings.
        """
        return sum(bool(_COEFFICIENT.fullmatch(name)) for name in self.names()) or None

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        """Estimate from a record.

        Parameters
        ----------
        record : Record
            Input and output, both of shape (N,).
        rng : numpy.random.Generator, optional
            The estimator's own stream; only one that :meth:`draws` needs it.

        Raises
        ------
        EstimationError
            If the estimate is singular or diverges, or the record does not suit the method.
        """
        raise NotImplementedError


class AtOneInterval(EstimatorSpec):
    """Base of the estimators that draw nothing, and keep several experiments at one interval apart."""

    def takes_experiments(self) -> Experiments:
        return "at_one_interval"

    def draws(self) -> bool:
        return False


@runtime_checkable
class Batched(Protocol):
    """An estimator that estimates from many records at once, faster than one by one (:func:`is_batched`)."""

    def require_experiments(self, record: Record) -> None:
        """As every estimator."""

    def fit_many(self, records: Sequence[Record]) -> list[Estimate | EstimationError]:
        """What ``fit`` gives or raises for each record, to the last bit, however many there are.

        Those of one fixed input share the array ``u``. An estimator that draws takes a second argument,
        ``rngs``: the stream of each record. Where it raises, each record is fitted by itself; if that
        succeeds, the error is the method's own, and all these trials have crashed.
        """


def is_batched(estimator: EstimatorSpec) -> TypeGuard[Batched]:
    """Whether a run calls ``fit_many``: no subclass has its own ``fit``, and it takes streams if it draws."""
    if not isinstance(estimator, Batched):
        return False
    if estimator.draws() and "rngs" not in inspect.signature(estimator.fit_many).parameters:
        return False
    order = type(estimator).__mro__
    fit, fit_many = (
        next(i for i, cls in enumerate(order) if name in vars(cls)) for name in ("fit", "fit_many")
    )
    return fit_many <= fit


def unknown_past(samples: int) -> int:
    """How many of an experiment's first samples are left out where what was before it would show in them."""
    return min(_UNKNOWN_PAST, samples // 10)


def with_errors(names: Sequence[str]) -> list[str]:
    """The names, then those of their standard errors."""
    return [*names, *(f"se_{name}" for name in names)]


def offset(response: Response, constant: float | None) -> Response:
    """The response with a constant added to it, if there is one."""
    return response if constant is None else lambda u, dt: response(u, dt) + constant


def require_finite(y: Array) -> None:
    """Raise EstimationError if the output holds nan or infinity."""
    wrong = len(y) - np.count_nonzero(np.isfinite(y))
    if wrong:
        raise EstimationError(f"the output has {wrong} of {len(y)} samples that are not finite")


def require_moderate(signal: Array, name: str) -> None:
    """Raise EstimationError if squares of the signal, the input or the output as ``name`` says, overflow."""
    largest = float(np.max(np.abs(signal), initial=0.0))
    if not largest < _HUGE or 0.0 < largest < 1.0 / _HUGE:
        raise EstimationError(
            f"the {name} reaches {largest:g}, which no computation with squares survives: use another unit"
        )


def require_usable(record: Record) -> None:
    """Raise EstimationError unless the signals are finite, of moderate size and vary."""
    require_finite(record.y)
    for signal, name in ((record.u, "input"), (record.y, "output")):
        require_moderate(signal, name)
    for signal, name in ((record.u, "input"), (record.y, "output")):
        require_varying(signal, name)


def require_varying(signal: Array, name: str) -> None:
    """Raise EstimationError if the signal, the input or the output as ``name`` says, is constant."""
    if varies(signal):
        return
    raise EstimationError(
        f"the {name} is {signal[0]:g} throughout: nothing can be learnt from a constant {name}"
        + ("; use one that varies" if name == "input" else "")
    )


def varies(signals: Array) -> Flags:
    """Whether each signal (..., N) takes different values, apart from rounding."""
    return np.asarray(np.ptp(signals, axis=-1) > _ROUNDING * np.max(np.abs(signals), axis=-1))
