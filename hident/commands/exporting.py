"""What a configuration gave, as one table: the verb export.

Scores and seconds come from the store; records and estimates, which no store keeps, are made again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hident.config.suggest import counted
from hident.engine.experiment import Plan, Unit
from hident.engine.replay import OneTrial, Realised, replayed
from hident.engine.runner import complete, reached
from hident.engine.store import Reader, Store
from hident.engine.timing import seconds
from hident.engine.work import pin_blas
from hident.errors import ConfigError
from hident.new_files import replacing
from hident.records import Record

if TYPE_CHECKING:
    import pandas as pd

    from hident.arrays import Array

What = StrEnum("What", "values records estimates timing")
SUFFIXES = (".csv", ".parquet")
_ROWS = 100_000
"""The rows that are in memory at once."""

Rows = Iterator[Sequence[Any]]


@dataclass(frozen=True)
class _Table:
    """The rows of an export, each of which begins with the labels of the axes."""

    columns: tuple[str, ...]
    rows: Callable[[Plan, Reader], Rows]


def export(plan: Plan, folder: Path, file: Path, what: What = What.values) -> str:
    """Write what a plan gave to CSV or Parquet; returns a line that says so.

    An axis that has the name of a column besides is named ``case NAME``. ConfigError if the name of the file
    ends otherwise, or another axis is named so.
    """
    table = _TABLES[what]
    if file.suffix not in SUFFIXES:
        raise ConfigError(f"{file}: the name must end in {' or '.join(SUFFIXES)}")
    axes = [f"case {axis.name}" if axis.name in table.columns else axis.name for axis in plan.axes]
    if taken := next((name for name in axes if axes.count(name) > 1), None):
        raise ConfigError(
            f"{plan.path}: two columns of an export of {what} would be '{taken}': rename an axis"
        )
    pin_blas()
    with Store(folder).reading() as reader:
        plan = reached(plan, reader)
        rows = write_rows(file, [*axes, *table.columns], table.rows(plan, reader), texts=len(plan.axes))
        if what in (What.records, What.estimates):
            made = f"{counted(rows, 'row')} of {counted(plan.trials, 'trial')}"
            return f"{file}: {made}, made again from their seeds"
        done = sum(complete(reader, keys.values(), plan.trials) for keys in plan.keys)
    missing = plan.trials * len(plan.units) - done
    said = f"; {counted(missing, 'trial', 'are')} not computed yet (hident run)" if missing else ""
    return f"{file}: {counted(rows, 'row')} of {counted(done, 'trial')}{said}"


def write_rows(file: Path, columns: Sequence[str], rows: Rows, *, texts: int = 0) -> int:
    """Write a table to CSV or Parquet, some rows at a time; the first ``texts`` columns are texts in Parquet.

    Returns how many rows there are. ConfigError if Parquet is wanted and cannot be written.
    """
    try:
        with replacing(file) as new:
            frames = _frames(columns, rows)
            if file.suffix == ".parquet":
                return _write_parquet(new, frames, texts)
            return _write_csv(new, frames)
    except ImportError:
        raise ConfigError("writing Parquet needs pyarrow: pip install 'hident[parquet]'") from None


def _frames(columns: Sequence[str], rows: Rows) -> Iterator[pd.DataFrame]:
    import pandas as pd

    held: list[Any] = []
    for row in rows:
        held.append(row)
        if len(held) >= _ROWS:
            yield pd.DataFrame(held, columns=[*columns])
            held = []
    yield pd.DataFrame(held, columns=[*columns])


def _write_csv(file: Path, frames: Iterable[pd.DataFrame]) -> int:
    rows = 0
    with file.open("w", encoding="utf-8", newline="") as out:
        for frame in frames:
            frame.to_csv(out, index=False, header=not rows, lineterminator="\n")
            rows += len(frame)
    return rows


def _write_parquet(file: Path, frames: Iterable[pd.DataFrame], texts: int) -> int:
    import pyarrow as pa
    import pyarrow.parquet as pq

    with ExitStack() as stack:
        writer, rows = None, 0
        for frame in frames:
            # An axis may hold numbers and names, which a column of Parquet cannot.
            axes = frame.columns[:texts]
            table = pa.Table.from_pandas(frame.astype(dict.fromkeys(axes, str)), preserve_index=False)
            if writer is None:
                writer = stack.enter_context(pq.ParquetWriter(file, table.schema))
            writer.write_table(table)
            rows += len(frame)
    return rows


def _labels(plan: Plan, unit: Unit) -> list[Any]:
    return [unit.labels.get(axis.name, np.nan) for axis in plan.axes]


def _values(plan: Plan, reader: Reader) -> Rows:
    for unit, keys in zip(plan.units, plan.keys, strict=True):
        for name, metric in unit.metrics.items():
            labels = metric.labels(name)
            for scores in reader.trials(keys[name], plan.trials):
                for trial, values in zip(scores.trials.tolist(), scores.values.tolist(), strict=True):
                    failure = scores.failures.get(trial, "")
                    for label, value in zip(labels, values, strict=True):
                        yield *_labels(plan, unit), unit.name, trial, label, value, failure


def _timing(plan: Plan, reader: Reader) -> Rows:
    for unit, key in zip(plan.units, plan.timing_keys, strict=True):
        taken = seconds(reader, key, plan.trials)
        for trial in np.flatnonzero(np.isfinite(taken)).tolist():
            yield *_labels(plan, unit), unit.name, trial, float(taken[trial])


def _records(plan: Plan, reader: Reader) -> Rows:
    for number in range(plan.trials):
        trial = OneTrial(plan, number)
        seen: set[int] = set()
        for unit in plan.units:
            # Each estimator has a bootstrap of its own.
            own = unit.data.resampled and number > 0
            if own or unit.data.key not in seen:
                seen.add(unit.data.key)
                record = replayed(trial, unit).record if own else trial.record(unit.data)[0]
                name = unit.name if own else ""
                for row in () if record is None else record_rows(record, trial.noise_free(unit.data)):
                    yield *_labels(plan, unit), name, number, *row


RECORD = ("experiment", "sample", "time", "input", "output", "noise_free")
"""The columns of a record: ``time`` counts samples without a sampling interval, from 0 in each experiment."""


def record_rows(record: Record, noise_free: Array | None) -> Rows:
    """A row for each sample of a record; an output before noise that is not known is missing."""
    clean = np.full(len(record), np.nan) if noise_free is None else noise_free
    parts = list(record.parts.items())
    pieces = [(name, part.samples, part.dt) for name, part in parts] or [
        ("", slice(0, len(record)), 1.0 if record.dt is None else record.dt)
    ]
    for name, samples, dt in pieces:
        signals = (signal[samples].tolist() for signal in (record.u, record.y, clean))
        for i, (u, y, y_clean) in enumerate(zip(*signals, strict=True)):
            yield name, samples.start + i, i * dt, u, y, y_clean


ESTIMATE = ("part", "name", "x", "value", "true")
"""The columns of an estimate: a parameter has a name, a point of a curve an abscissa."""


def _estimates(plan: Plan, reader: Reader) -> Rows:
    for number in range(plan.trials):
        trial = OneTrial(plan, number)
        for unit in plan.units:
            realised = replayed(trial, unit)
            for row in () if realised.found is None else estimate_rows(realised):
                yield *_labels(plan, unit), unit.name, number, *row


def estimate_rows(realised: Realised) -> Rows:
    """A row for each parameter of an estimate that there is, and for each point of its curves."""
    from hident.engine.estimate_curves import curves, parameters

    for name, value, true in parameters(realised):
        yield "parameter", name, np.nan, value, true
    for curve in curves(realised):
        points = (one.tolist() for one in (curve.x, curve.values, curve.true))
        yield from ((curve.part, "", *point) for point in zip(*points, strict=True))


_TABLES = {
    What.values: _Table(("estimator", "trial", "metric", "value", "failure"), _values),
    What.records: _Table(("estimator", "trial", *RECORD), _records),
    What.estimates: _Table(("estimator", "trial", *ESTIMATE), _estimates),
    What.timing: _Table(("estimator", "trial", "seconds"), _timing),
}
