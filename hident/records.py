"""What flows between the rooms: a record of measurements, the truth behind it, and an estimate."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, Protocol, TypeVar, cast, get_args

import numpy as np
from numpy.typing import NDArray

from hident.arrays import Array, Characteristic
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction
from hident.numerics.choices import sorting
from hident.numerics.parts import Parts, whole

# Times written with a few digits are uneven by their rounding.
_UNEVEN = 1e-3

T = TypeVar("T")
ModelPart = Literal[
    "nonlinearity", "left_out", "unfiltered", "linear", "continuous", "response", "frequencies", "model"
]
"""A part of an estimate that is no value."""
Response = Callable[[Array, float], Array]
"""The noise-free output (N,) to an input (N,), given the sampling interval."""
Structure = Literal["N-L", "L-N", "L-N-L"]
"""The blocks of a system from its input to its output: static nonlinearities N and linear blocks L."""
LeftOut = Callable[[float, float], tuple[Array, Array]]
"""The inputs from low to high among the samples that a nonlinearity was estimated from, in increasing order,
and the estimate at each without its own sample."""


class Model(Protocol):
    """What tells the output of any record, each experiment by itself, begun as the method begins it."""

    def simulate(self, record: Record) -> Array:
        """The output (N,) from the record's input alone."""

    def predict(self, record: Record, steps: int = 1) -> Array:
        """The output (N,) from what was measured up to ``steps`` samples before."""


@dataclass(frozen=True, eq=False)
class Held:
    """A signal that is ``levels[j]`` from ``times[j]`` on, both of shape (J,), and ``before`` until time 0.

    The times increase from 0; the last level goes on.
    """

    times: Array
    levels: Array
    before: float = 0.0


@dataclass(frozen=True, eq=False)
class Periodic:
    """offset + Re sum_h amplitudes[h] exp(j harmonics[h] omega t) with omega = 2 pi/period.

    ``harmonics`` and ``amplitudes`` have the shape (H,). Unless ``settled``, the signal is the constant
    offset until time 0.
    """

    period: float
    offset: float
    harmonics: NDArray[np.int64]
    amplitudes: NDArray[np.complex128]
    settled: bool = True


Waveform = Held | Periodic
"""What a signal is between its samples; time 0 is its first sample."""


@dataclass(frozen=True, eq=False)
class Part:
    """One of the experiments that a record consists of: its samples are ``start`` to ``stop`` - 1.

    ``dt`` is its own sampling interval, and ``waveform`` what was applied, from time 0 at its first sample.
    """

    start: int
    stop: int
    dt: float
    waveform: Waveform

    def __len__(self) -> int:
        return self.stop - self.start

    @property
    def samples(self) -> slice:
        """Where the part stands in the record: ``record.y[part.samples]``."""
        return slice(self.start, self.stop)


@dataclass(frozen=True, eq=False)
class Truth:
    """What only a simulation knows.

    ``linear`` is the linear block in discrete time, ``continuous`` that in continuous time, ``response``
    the whole system. ``values`` are the true parameters by name (``a_1``, ``b_0``, ...). ``breakpoints``
    are the points at which the nonlinearity or its derivative jumps, in increasing order. ``blocks`` are
    the linear blocks in continuous time where there are several, by their place: ``input`` and ``output``;
    ``discrete_blocks`` those in discrete time. Of a system of blocks in series ``structure`` is their order,
    and ``rescaled`` takes what each is to be divided by, by its place (``linear``, ``nonlinearity``,
    ``input``, ``output``), and gives the truth of the same system, the others multiplied by as much.
    """

    nonlinearity: Characteristic | None = None
    linear: TransferFunction | None = None
    continuous: ContinuousTransferFunction | None = None
    response: Response | None = None
    blocks: Mapping[str, ContinuousTransferFunction] = field(default_factory=dict)
    values: Mapping[str, float] = field(default_factory=dict)
    breakpoints: tuple[float, ...] = ()
    discrete_blocks: Mapping[str, TransferFunction] = field(default_factory=dict)
    structure: Structure | None = None
    rescaled: Callable[[Mapping[str, float]], Truth] | None = None

    def provides(self) -> frozenset[str]:
        """The parts that it holds: ``nonlinearity``, ``linear``, ``response``, ``value NAME``..."""
        names = ("nonlinearity", "linear", "continuous", "response")
        return _provided(self, names) | ({"blocks"} if self.blocks else set())


def _provided(parts: Truth | Estimate, names: Iterable[str]) -> frozenset[str]:
    known = {name for name in names if getattr(parts, name) is not None}
    return frozenset(known | {f"value {name}" for name in parts.values})


def needed(part: T | None) -> T:
    """A part of a truth or an estimate that is there, as was seen before the run."""
    assert part is not None
    return part


@dataclass(frozen=True, eq=False)
class Record:
    """Input and output, float64 of shape (N,), at sampling interval ``dt`` (None: discrete time).

    ``parts`` are the experiments by name, one after the other, where several were made, where one has a
    sampling interval of its own, or where it matters what the input is between its samples. ``truth`` is
    there if the record was simulated. ``validation`` are other samples of the same system. ``units`` are
    those of the ``input``, the ``output`` and ``time``; ``offsets`` what was taken off the ``input`` and the
    ``output`` as they were measured, and ``detrended`` says that each experiment has lost its straight lines.

    Raises
    ------
    ValueError
        If u and y are not one-dimensional and of one length.

    Examples
    --------
    >>> record = Record(np.arange(3.0), np.array([0.1, 0.9, 2.2]), dt=0.5)
    >>> len(record), record.y
    (3, array([0.1, 0.9, 2.2]))
    """

    u: Array
    y: Array
    dt: float | None = None
    truth: Truth | None = None
    parts: Mapping[str, Part] = field(default_factory=dict)
    validation: Record | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    offsets: Mapping[str, float] = field(default_factory=dict)
    detrended: bool = False

    def __post_init__(self) -> None:
        for name in ("u", "y"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))
        if self.u.shape != self.y.shape or self.u.ndim != 1:
            raise ValueError(
                "u and y must be one-dimensional and of one length, "
                f"not of shapes {self.u.shape} and {self.y.shape}"
            )

    def __len__(self) -> int:
        return len(self.u)

    def with_signals(self, u: Array, y: Array) -> Record:
        """The record with other signals (N,): what ``replace`` gives, sooner."""
        known = self.parts, self.validation, self.units, self.offsets, self.detrended
        return Record(u, y, self.dt, self.truth, *known)

    @classmethod
    def at(cls, t: Array, u: Array, y: Array) -> Record:
        """The record of measurements at the times ``t`` (N,), which must be evenly spaced.

        Raises
        ------
        ValueError
            If there are fewer than two samples, or the sampling is not uniform.
        """
        if len(t) < 2:
            raise ValueError(f"needs at least 2 samples, not {len(t)}")
        intervals = np.diff(t)
        dt = float(t[-1] - t[0]) / len(intervals)
        worst = int(np.argmax(np.abs(intervals - dt)))
        if not abs(intervals[worst] - dt) <= _UNEVEN * dt:
            raise ValueError(
                f"the sampling is not uniform: from t = {t[worst]:g} to {t[worst + 1]:g} the interval is "
                f"{intervals[worst]:g}, and {dt:g} on average (allowed: {_UNEVEN:g} of it off); "
                "interpolate the record to even times first"
            )
        return cls(u, y, dt)

    @cached_property
    def experiments(self) -> Parts:
        """The samples of each experiment, in their order: all of the record unless it names its parts.

        Whatever looks back in time must not look from one into another.
        """
        return tuple(part.samples for part in self.parts.values()) or whole(len(self))

    def once(self, key: Hashable, make: Callable[[], T]) -> T:
        """What ``make`` gives, made once for all estimators and metrics of this record that ask by the key.

        Examples
        --------
        >>> record = Record(np.arange(3.0), np.zeros(3))
        >>> record.once("count", lambda: 3), record.once("count", lambda: 4)
        (3, 3)
        """
        if key not in self._made:
            self._made[key] = make()
        return cast(T, self._made[key])

    @cached_property
    def _made(self) -> dict[Hashable, Any]:
        return {}

    @cached_property
    def order(self) -> NDArray[np.intp]:
        """An order that sorts u over the whole record, shared by all estimators of this record."""
        order = sorting(self.u)
        order.flags.writeable = False
        return order


@dataclass(frozen=True, eq=False)
class Estimate:
    """What an estimator returns; a part that it does not estimate is None or empty.

    ``nonlinearity`` takes and gives arrays of one shape, ``left_out`` is it at the samples, each without its
    own, and ``unfiltered`` what the same method makes of the record without its prefilter; ``linear`` and
    ``continuous`` are the linear block in discrete and in continuous time, ``response`` the whole model from
    rest, ``model`` what it gives for a record; ``values`` are parameters by name, and ``frequencies`` (n,)
    the angular ones that values such as ``gain_i_1`` number. ``details`` holds what only a figure of one
    trial shows, such as a search or the history of an iteration.

    Examples
    --------
    >>> estimate = Estimate(linear=TransferFunction(a=(0.5,)), values={"a_1": 0.5})
    >>> sorted(estimate.provides())
    ['linear', 'value a_1']
    """

    nonlinearity: Characteristic | None = None
    left_out: LeftOut | None = None
    unfiltered: Callable[[], Estimate] | None = None
    linear: TransferFunction | None = None
    continuous: ContinuousTransferFunction | None = None
    response: Response | None = None
    frequencies: Array | None = None
    model: Model | None = None
    values: Mapping[str, float] = field(default_factory=dict)
    details: Mapping[str, Any] = field(default_factory=dict)

    def provides(self) -> frozenset[str]:
        """The parts that it holds, spelled as in :meth:`Truth.provides`."""
        return _provided(self, get_args(ModelPart))
