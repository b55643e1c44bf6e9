"""The values of all trials as a file beside table.csv, exact and compact: ``trials.csv.xz``.

One row for each series in the order of table.csv (the axes, estimator, metric), then one column for each
trial; empty where the trial failed. Text, so that a value survives any library and version, and compressed
with xz, which Python's own lzma and so pandas reads without another package; a random 64-bit value costs
about 9 bytes. Numbers are the shortest decimals that give the same float back: ``pd.read_csv`` does, before
pandas 3 with ``float_precision="round_trip"``.

The bytes depend on the values alone: an xz header holds no time and no name.
"""

from __future__ import annotations

import csv
import io
import lzma
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hident.arrays import Array
from hident.engine.results import Results

_NAMES = ("estimator", "metric")

Key = tuple[str, ...]
"""The labels of the axes, then the estimator, then (of a series) the metric."""


@dataclass(frozen=True, eq=False)
class TrialValues:
    """The values (N,) of each series, nan where a trial failed."""

    axes: tuple[str, ...]
    series: Mapping[Key, Array]

    @classmethod
    def of(cls, results: Results) -> TrialValues:
        """The values of a run."""
        axes = tuple(axis.name for axis in results.plan.axes)
        # As table.csv writes the labels.
        text = results.frame()[[*axes, *_NAMES]].to_csv(index=False, lineterminator="\n")
        _, *keys = csv.reader(io.StringIO(text, newline=""))
        return cls(axes, {tuple(key): s.values for key, s in zip(keys, results.series, strict=True)})

    @classmethod
    def decoded(cls, data: bytes) -> TrialValues:
        """What :meth:`encoded` gave; ValueError if the bytes are no such file."""
        try:
            text = lzma.decompress(data, format=lzma.FORMAT_XZ).decode()
        except lzma.LZMAError as error:
            raise ValueError(str(error).lower()) from None
        header, *rows = csv.reader(io.StringIO(text, newline=""), strict=True)
        width = header.index("metric") + 1 if "metric" in header else 0
        if width < len(_NAMES) or any(len(row) != len(header) for row in rows):
            raise ValueError("it is no table of trials")
        series = {
            tuple(row[:width]): np.array([float(cell) if cell else math.nan for cell in row[width:]])
            for row in rows
        }
        if len(series) != len(rows):
            raise ValueError("a series stands twice")
        return cls(tuple(header[: width - len(_NAMES)]), series)

    def encoded(self) -> bytes:
        """The bytes of the file."""
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([*self.axes, *_NAMES, *range(self.trials)])
        for key, values in self.series.items():
            writer.writerow([*key, *("" if math.isnan(v) else repr(v) for v in values.tolist())])
        return lzma.compress(text.getvalue().encode(), format=lzma.FORMAT_XZ, preset=1)

    @property
    def trials(self) -> int:
        """How many trials each series has."""
        return len(next(iter(self.series.values()), ()))

    @cached_property
    def units(self) -> dict[Key, list[Key]]:
        """The series of each unit, that is, of each estimator at each case."""
        units: dict[Key, list[Key]] = {}
        for key in self.series:
            units.setdefault(key[:-1], []).append(key)
        return units

    def described(self, unit: Key) -> str:
        """A unit in words; an axis that does not touch it is left out."""
        *labels, estimator = unit
        named = [f"{a} {label}" for a, label in zip(self.axes, labels, strict=True) if label]
        return ", ".join([*named, f"estimator '{estimator}'"])

    def described_series(self, series: Key) -> str:
        """A series in words."""
        return f"{self.described(series[:-1])}, metric {series[-1]}"


@dataclass(frozen=True, eq=False)
class Difference:
    """Where two series differ: ``moved`` (N,) marks the trials, ``largest`` is that of the other ones.

    ``largest`` is relative, in the scale of :func:`difference`.
    """

    moved: NDArray[np.bool_]
    largest: float


def scale_of(ours: Array, reference: Array) -> float:
    """The median absolute value of two series together."""
    values = np.abs(np.concatenate([ours, reference]))
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else 0.0


def difference(ours: Array, reference: Array, rtol: float) -> Difference:
    """Compare two series (N,) trial by trial.

    Two values are equal if |a - b| <= rtol max(|a|, |b|, s), where s is the median absolute value of the
    series. A value alone is no measure of its rounding: the error of an estimate is a difference of two
    numbers and passes near zero by chance, where a relative tolerance would ask for more digits than were
    ever there, while what the trials are typically off by is known. Two nan are equal, and nan differs from
    any number.
    """
    with np.errstate(all="ignore"):
        distance = np.abs(ours - reference)
        size = np.maximum(np.maximum(np.abs(ours), np.abs(reference)), scale_of(ours, reference))
        finite = np.isfinite(ours) & np.isfinite(reference)
        same = (ours == reference) | (np.isnan(ours) & np.isnan(reference))
        equal = same | (finite & (distance <= rtol * size))
        relative = np.where(equal & ~same, distance / size, 0.0)
    return Difference(~equal, float(relative.max(initial=0.0)))
