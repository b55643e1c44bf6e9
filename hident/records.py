"""What flows between the rooms: a record of measurements, the truth behind it, and an estimate."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from hident.systems.continuous import ContinuousTransferFunction
    from hident.systems.linear import TransferFunction

Array = NDArray[np.float64]
Characteristic = Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class Truth:
    """What only a simulation knows.

    ``linear`` is the linear block in discrete time, ``continuous`` that in continuous time. ``values`` are
    the true parameters by name (``a_1``, ``b_0``, ...). ``breakpoints`` are the points at which the
    nonlinearity or its derivative jumps, in increasing order.
    """

    nonlinearity: Characteristic | None = None
    linear: TransferFunction | None = None
    continuous: ContinuousTransferFunction | None = None
    values: Mapping[str, float] = field(default_factory=dict)
    breakpoints: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Record:
    """Input and output, float64 of shape (N,), at sampling interval ``dt`` (None: discrete time)."""

    u: Array
    y: Array
    dt: float | None = None
    truth: Truth | None = None

    def __post_init__(self) -> None:
        if self.u.shape != self.y.shape or self.u.ndim != 1:
            raise ValueError(
                "u and y must be one-dimensional and of one length, "
                f"not of shapes {self.u.shape} and {self.y.shape}"
            )

    def __len__(self) -> int:
        return len(self.u)

    @cached_property
    def order(self) -> NDArray[np.intp]:
        """An order that sorts u, shared by all estimators of this record."""
        order = np.argsort(self.u)
        order.flags.writeable = False
        return order


@dataclass(frozen=True, eq=False)
class Estimate:
    """What an estimator returns; a part that it does not estimate is None or empty.

    ``details`` holds what only a figure of one trial shows, such as a search or the history of an iteration.
    """

    nonlinearity: Characteristic | None = None
    linear: TransferFunction | None = None
    continuous: ContinuousTransferFunction | None = None
    values: Mapping[str, float] = field(default_factory=dict)
    diagnostics: Mapping[str, float] = field(default_factory=dict)
    details: Mapping[str, Any] = field(default_factory=dict)
