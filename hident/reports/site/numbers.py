"""The printed numbers of a run, each with its verdict and the trials behind it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal

import numpy as np

from hident.arrays import Array
from hident.ledger.judged import Judged
from hident.ledger.power import VerdictPower
from hident.ledger.trial_values import TrialValues
from hident.reports.tables.writing import decimals_of, written

MEANINGS = {
    "exact": "ours rounds to the printed digits",
    "agrees": "the printed number lies in the interval that our trials give, and not in that of every "
    "alternative that was tried",
    "untestable": "the printed number is as we get it, and would be under every alternative that was tried: "
    "it cannot tell whether we are right",
    "differs": "the printed number lies outside of the interval that our trials give",
}
MARKS = {
    "structural": "not counted: the coefficient is not there, and zero in all trials",
    "duplicate": "not counted: the same cell is printed twice",
    "circular": "not counted: the printed number is the truth of the configuration",
    "multiplicity": "some number of so many differs by chance; the table as a whole is sound",
}
UNCOUNTED = {
    "structural": "belong to coefficients that are not there",
    "duplicate": "are printed a second time",
    "circular": "are the truth of the configuration",
}
"""In few words, why printed numbers do not count."""
STATISTICS = {"mean": "mean", "median": "median", "std": "standard deviation"}


@dataclass(frozen=True, eq=False)
class Number:
    """One printed number beside ours, with what a page shows of it."""

    id: str
    """Its anchor."""
    judged: Judged
    of: str
    """In words, which of our series it is; empty if that is not known."""
    values: Array | None
    """The values (N,) of the trials, without those that failed; None if they are not known."""
    failed: int
    fitting: tuple[str, ...]
    """The alternatives under which it would be as likely."""

    @property
    def ours(self) -> str:
        """Ours with as many decimals as are printed, and at least three digits."""
        return beside(self.judged.ours, self.judged.printed.printed)

    @property
    def statistic(self) -> str:
        """In words, which statistic of the trials ours is; empty if that is not known."""
        return STATISTICS.get(self.judged.statistic or "", "")

    @property
    def has_interval(self) -> bool:
        """Whether there is an interval, which may be open on a side."""
        return self.judged.low < self.judged.high


def beside(value: float, printed: str) -> str:
    """A number with as many decimals as a printed one, and at least three digits.

    Examples
    --------
    >>> beside(31.5526, "37.37"), beside(0.0821, "0.08"), beside(1.234e-7, "1.5e-7")
    ('31.55', '0.0821', '1.23e-07')
    """
    exponent = Decimal(printed.lstrip("<>")).as_tuple().exponent
    short = written(value)
    if value == 0 or "e" in short or short == "-":
        return "0" if value == 0 else short
    decimals = -exponent if isinstance(exponent, int) else 0
    return f"{value:.{max(decimals_of(value, 3), decimals)}f}"


def numbers_of(
    judged: tuple[Judged, ...], power: VerdictPower | None, trials: TrialValues | None
) -> Iterator[Number]:
    """All numbers of a run, in the order of verdicts.csv."""
    for i, one in enumerate(judged):
        values = trials.series[one.series] if trials and one.series else None
        there = None if values is None else values[np.isfinite(values)]
        known = power.numbers.get(one.key) if power else None
        yield Number(
            id=f"n{i + 1}",
            judged=one,
            of=trials.described_series(one.series) if trials and one.series else "",
            values=there,
            failed=0 if values is None or there is None else len(values) - len(there),
            fitting=tuple(name for name, excluded in known.excluded.items() if not excluded) if known else (),
        )
