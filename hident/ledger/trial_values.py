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
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hident.arrays import Array
from hident.engine.results import Results, Series

_NAMES = ("estimator", "metric")

Key = tuple[str, ...]
"""The labels of the axes, then the estimator, then (of a series) the metric."""


class _Values(Mapping[Key, Array]):
    """The values of series, each read when it is asked for."""

    def __init__(self, series: Mapping[Key, Series]) -> None:
        self._series = series

    def __getitem__(self, key: Key) -> Array:
        return self._series[key].values

    def __iter__(self) -> Iterator[Key]:
        return iter(self._series)

    def __len__(self) -> int:
        return len(self._series)


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
        return cls(axes, _Values({tuple(key): s for key, s in zip(keys, results.series, strict=True)}))

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
        return b"".join(self._encoded())

    def write(self, file: Path) -> None:
        """Write the file, a series at a time."""
        with file.open("wb") as out:
            out.writelines(self._encoded())

    def _encoded(self) -> Iterator[bytes]:
        compressor = lzma.LZMACompressor(format=lzma.FORMAT_XZ, preset=1)
        for text in self._texts():
            yield compressor.compress(text.encode())
        yield compressor.flush()

    def _texts(self) -> Iterator[str]:
        """The text, in pieces: a row may hold millions of numbers."""
        yield from _row([*self.axes, *_NAMES], np.arange(self.trials))
        for key, values in self.series.items():
            yield from _row(key, values)

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


def _row(names: Sequence[str], numbers: NDArray[np.generic]) -> Iterator[str]:
    """A row of the file: names, and after them numbers, of which nan is an empty cell."""
    line = io.StringIO(newline="")
    csv.writer(line, lineterminator="").writerow(names)
    yield line.getvalue()
    for start in range(0, len(numbers), 10_000):
        yield "".join("," if math.isnan(v) else f",{v!r}" for v in numbers[start : start + 10_000].tolist())
    yield "\n"


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
