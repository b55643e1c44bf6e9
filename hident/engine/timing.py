"""How long fits take: what stores keep of it, in numbers. No key and no comparison depends on them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hident.arrays import Array
from hident.engine.experiment import Plan, Unit
from hident.engine.store import Stored
from hident.estimators.base import is_batched

if TYPE_CHECKING:
    import pandas as pd

_STATISTICS = ("fits", "median", "q25", "q75", "relative", "batched")


@dataclass(frozen=True)
class Timing:
    """The seconds of the fits of one unit: their number, their median and quartiles.

    ``relative`` is the median in units of the least one of the case. All are nan without fits.
    """

    unit: Unit
    fits: int
    median: float
    q25: float
    q75: float
    relative: float

    @property
    def batched(self) -> bool:
        """Whether many fits were made at once, each of which then has the same share of the time."""
        return is_batched(self.unit.estimator)


def seconds(store: Stored, key: str, trials: int) -> Array:
    """The seconds of the fit of each trial (N,), as far as a store has them; nan where there was none."""
    found = np.full(trials, np.nan)
    for scores in store.trials(key, trials):
        found[scores.trials] = scores.values[:, 0]
    return found


def timings(plan: Plan, store: Stored) -> tuple[Timing, ...]:
    """How long the fits of each unit took, as far as a store knows."""
    # Of very many trials, the seconds of one unit at a time are in memory.
    found = [_quartiles(seconds(store, key, plan.trials)) for key in plan.timing_keys]
    fastest: dict[int, float] = {}
    for unit, (_, (_, median, _)) in zip(plan.units, found, strict=True):
        if np.isfinite(median):
            fastest[unit.data.key] = min(median, fastest.get(unit.data.key, np.inf))
    return tuple(
        Timing(unit, fits, median, q25, q75, _ratio(median, fastest, unit))
        for unit, (fits, (q25, median, q75)) in zip(plan.units, found, strict=True)
    )


def _quartiles(every: Array) -> tuple[int, list[float]]:
    """How many fits there are, and the quartiles of their seconds."""
    fits = every[np.isfinite(every)]
    of = np.quantile(fits, [0.25, 0.5, 0.75]) if len(fits) else np.full(3, np.nan)
    return len(fits), of.tolist()


def _ratio(median: float, fastest: dict[int, float], unit: Unit) -> float:
    least = fastest.get(unit.data.key, 0.0)
    return float(median / least) if least > 0.0 else float("nan")


def timing_frame(plan: Plan, found: Iterable[Timing]) -> pd.DataFrame:
    """The table of timing.csv: the case's columns, the estimator, and its seconds for a fit."""
    import pandas as pd

    axes = [axis.name for axis in plan.axes]
    rows = [
        [
            *(one.unit.labels.get(axis, "") for axis in axes),
            one.unit.name,
            *(getattr(one, name) for name in _STATISTICS),
        ]
        for one in found
    ]
    return pd.DataFrame(rows, columns=[*axes, "estimator", *_STATISTICS])
