"""The printed numbers of a run, each with its verdict and the trials behind it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from types import MappingProxyType

import numpy as np

from hident.arrays import Array
from hident.config.suggest import counted
from hident.ledger.judged import Judged
from hident.ledger.power import VerdictPower
from hident.ledger.trial_values import Key, TrialValues
from hident.ledger.verdicts import KNOWN, OWN_DATA
from hident.numerics.rounding import is_constant
from hident.reports.site.remarks import Remarks
from hident.reports.tables.writing import decimals_of, written

MEANINGS = {
    "exact": "ours rounds to the printed digits",
    "agrees": "the printed number lies in the interval that our trials give, and not under "
    "every alternative (plausible mistake) that was tried",
    "untestable": "the printed number is as we get it, and would be so under every alternative that was "
    "tried: it cannot tell whether we are right",
    "differs": "the printed number lies outside of the interval that our trials give",
}
MARKS = {
    "structural": "not counted: the model that is fitted has no such coefficient, so that it is always zero",
    "duplicate": "not counted: the same cell is printed twice",
    "circular": "not counted: the printed number is the truth of the configuration",
    "misprint": "the paper itself shows it, so the joint test leaves the number out",
    "multiplicity": "some number of so many differs by chance; the table as a whole is sound",
}
UNCOUNTED = {
    "structural": "belong to coefficients that the fitted model does not have",
    "duplicate": "are printed a second time",
    "circular": "are the truth of the configuration",
}
"""In few words, why printed numbers do not count."""
DERIVED = "derived"
"""How the note of a number in published.csv begins that is not printed, but follows from printed ones."""
STATISTICS = {"mean": "mean", "median": "median", "std": "standard deviation"}


@dataclass(frozen=True, eq=False)
class Number:
    """One printed number beside ours, with what a page shows of it."""

    place: int
    """Its row in verdicts.csv, from 1."""
    judged: Judged
    of: str
    """In words, which of our series it is; empty if that is not known."""
    values: Array | None
    """The values (N,) of the trials, without those that failed; None if they are not known."""
    failed: int
    fitting: tuple[str, ...] = ()
    """The alternatives under which it would be as likely."""
    excluding: tuple[str, ...] = ()
    """The alternatives that it excludes."""
    note: str = ""
    """What published.csv says of it."""
    true: float | None = None
    """The true value of what is estimated, where it is known."""

    @property
    def row(self) -> str:
        """Its row in the paper, and which of ours stands beside it if there are several."""
        return ", ".join(filter(None, (self.judged.printed.row, self.judged.case)))

    @property
    def id(self) -> str:
        """The name of its details on the page of its run."""
        return f"n{self.place}"

    @property
    def anchor(self) -> str:
        """The name of its cell there."""
        return f"number-{self.place}"

    @property
    def printed(self) -> str:
        """The printed digits; a bound with the sign of whether it is itself allowed."""
        printed = self.judged.printed.printed
        sign = {"at least": ("≥", ">"), "at most": ("≤", "<")}.get(
            " ".join(self.note.split()[:2]).rstrip(":,")
        )
        return printed.replace(sign[1], sign[0], 1) if sign else printed

    @property
    def ours(self) -> str:
        """Ours with one decimal more than are printed, and at least three digits; whole ones as such."""
        return self.written(self.judged.ours)

    def written(self, value: float) -> str:
        """A number like ours, as it is written beside the printed one."""
        return beside(value, self.judged.printed.printed, whole=self._is_whole)

    @property
    def _is_whole(self) -> bool:
        """Whether all trials give whole numbers, as counts and orders are."""
        values = self.values
        there = values is not None and len(values) and np.all(np.abs(values) < 1e6)
        return bool(there and np.all(values == np.rint(values)))  # type: ignore[arg-type]

    @property
    def interval(self) -> str:
        """From where to where ours goes; empty where there is no interval."""
        low, high = self.judged.low, self.judged.high
        if not self.has_interval:
            return ""
        if math.isinf(low) and math.isinf(high):
            return "any number"
        if math.isinf(low):
            return f"up to {self.written(high)}"
        return (
            f"from {self.written(low)} on"
            if math.isinf(high)
            else f"{self.written(low)} to {self.written(high)}"
        )

    @property
    def is_own_data(self) -> bool:
        """Whether the trials are those that the paper ran, so that others would say nothing."""
        return self.judged.interval == OWN_DATA

    @property
    def is_constant(self) -> bool:
        """Whether all trials give the same."""
        return self.values is not None and len(self.values) > 0 and is_constant(self.values)

    @property
    def is_wide(self) -> bool:
        """Whether it agrees by an interval wider than the number itself."""
        it = self.judged
        return it.word == "agrees" and it.high - it.low > abs(it.printed.value)

    @property
    def is_misprint(self) -> bool:
        """Whether the paper itself shows it to be misprinted."""
        return self.judged.mark == "misprint"

    @property
    def is_derived(self) -> bool:
        """Whether the paper prints not the number, but others from which it follows."""
        return self.note.startswith(DERIVED)

    @property
    def trials(self) -> int:
        """How many trials there are, with those that failed."""
        return self.failed + (0 if self.values is None else len(self.values))

    @property
    def is_rare(self) -> bool:
        """Whether so many trials failed that they may decide."""
        return self.failed > (1.0 - KNOWN) * self.trials

    @property
    def within(self) -> int:
        """Of a bound, how many trials keep it."""
        it = self.judged.printed
        values = np.array([]) if self.values is None else self.values
        return int(np.sum(values <= it.value if it.bound == "<" else values >= it.value))

    @property
    def flags(self) -> tuple[str, ...]:
        """What a reader must know of its verdict, in a word or two each."""
        said = {
            "misprint": self.is_misprint,
            "derived": self.is_derived,
            "not counted": not self.judged.counts,
            f"{self.trials - self.failed} of {counted(self.trials, 'trial')}": self.is_rare,
            "wide": self.is_wide,
        }
        return tuple(word for word, holds in said.items() if holds)

    @property
    def statistic(self) -> str:
        """In words, which statistic of the trials ours is; empty if that is not known."""
        return STATISTICS.get(self.judged.statistic or "", "")

    @property
    def has_interval(self) -> bool:
        """Whether there is an interval, which may be open on a side."""
        return self.judged.low < self.judged.high


def beside(value: float, printed: str, *, whole: bool = False) -> str:
    """A number with one decimal more than a printed one has, and at least three digits.

    A ``whole`` one is written so.

    Examples
    --------
    >>> beside(31.5526, "37.37"), beside(0.0821, "0.08"), beside(1.234e-7, "1.5e-7")
    ('31.553', '0.0821', '1.23e-07')
    >>> beside(93.0, "93"), beside(93.0, "93", whole=True)
    ('93.0', '93')
    """
    exponent = Decimal(printed.lstrip("<>")).as_tuple().exponent
    if whole and math.isfinite(value) and value == round(value):
        return f"{value:.0f}"
    short = written(value)
    if value == 0 or "e" in short or short == "-":
        return "0" if value == 0 else short
    decimals = 1 - exponent if isinstance(exponent, int) else 0
    return f"{value:.{max(decimals_of(value, 3), decimals)}f}"


def chance(p: float) -> str:
    """A probability, with as many digits as tell it from 5 %.

    Examples
    --------
    >>> chance(0.05), chance(0.0479), chance(0.0002), chance(1.0)
    ('0.050', '0.048', '< 0.001', '1')
    """
    return "< 0.001" if p < 0.001 else "1" if p >= 0.9995 else f"{p:.3f}" if p < 0.1 else f"{p:.2f}"


def numbers_of(
    judged: tuple[Judged, ...],
    power: VerdictPower | None,
    trials: TrialValues | None,
    remarks: Remarks | None = None,
    truths: Mapping[Key, float] = MappingProxyType({}),
) -> Iterator[Number]:
    """All numbers of a run, in the order of verdicts.csv; ``truths`` are the true values of our series."""
    of = [trials.described_series(one.series) if trials and one.series else "" for one in judged]
    for i, one in enumerate(judged):
        values = trials.series[one.series] if trials and one.series else None
        there = None if values is None else values[np.isfinite(values)]
        known = power.numbers.get(one.place) if power else None
        yield Number(
            place=i + 1,
            judged=one,
            of=of[i],
            values=there,
            failed=0 if values is None or there is None else len(values) - len(there),
            fitting=tuple(name for name, excluded in known.excluded.items() if not excluded) if known else (),
            excluding=tuple(name for name, excluded in known.excluded.items() if excluded) if known else (),
            note=remarks.notes.get(one.key, "") if remarks else "",
            true=truths.get(one.series) if one.series and one.statistic in ("mean", "median") else None,
        )
