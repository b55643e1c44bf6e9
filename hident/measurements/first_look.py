"""What a record can tell before anything is fitted to it, and what is wrong with it, in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hident.measurements.delay import Correlation, Delay, delay_of
from hident.measurements.excitation import Excitation, excitation
from hident.measurements.signal_values import Signal, scaled, signal_of
from hident.measurements.suspicions import suspicions
from hident.records import Record


@dataclass(frozen=True, eq=False)
class FirstLook:
    """What :func:`first_look` finds; ``wrong`` says in sentences what should be known before a fit."""

    samples: int
    experiments: int
    dt: float | None
    input: Signal
    output: Signal
    correlation: Correlation | None
    delay: Delay | None
    excitation: Excitation
    wrong: tuple[str, ...]


def first_look(record: Record) -> FirstLook:
    """What a record can tell before anything is fitted to it.

    Parameters
    ----------
    record : Record
        Measured or simulated; experiments are looked at each by itself.

    Returns
    -------
    FirstLook
        The signals' values, the delay with its interval, what nonlinearities the input can excite, and in
        words what is wrong.

    Examples
    --------
    >>> u = np.sign(np.random.default_rng(0).normal(size=500))
    >>> look = first_look(Record(u, np.convolve(u, [0, 0, 1, 0.5])[:500]))
    >>> (look.delay.low, look.delay.high), look.input.levels
    ((2, 2), (-1.0, 1.0))
    >>> print(look.wrong[0])
    The input has 2 levels: it cannot tell a nonlinearity of degree 2 or more from one of degree 1.
    """
    with np.errstate(all="ignore"):
        parts = record.experiments
        u, y = scaled(record.u), scaled(record.y)
        signals = signal_of(record.u, u, parts), signal_of(record.y, y, parts)
        correlated, found = delay_of(record)
        excited = excitation(u, parts)
        wrong = suspicions(record, u, y, signals, correlated, found, excited)
        return FirstLook(
            len(record), len(parts), record.dt, *signals, correlated, found, excited, tuple(wrong)
        )
