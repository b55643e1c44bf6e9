"""A record of measurements: which columns of which files, and what is done to them."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import count
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
)
from pydantic_core import CoreSchema

from hident.arrays import Array
from hident.config.spec import Count, Real, Spec
from hident.config.suggest import one_of
from hident.errors import ConfigError
from hident.measurements.columns import SPLIT, Column
from hident.measurements.files import SUFFIXES, read_columns
from hident.measurements.preparation import (
    Samples,
    Trend,
    at_even_times,
    between_gaps,
    decimated,
    less,
    means,
    range_of,
    record_of,
    within,
    without_line,
)
from hident.records import Record


def _columns(value: Any) -> Any:
    found = value if isinstance(value, list | tuple) else [value]
    for column in found:
        if isinstance(column, bool) or not isinstance(column, str | int) or column in ("", None):
            raise ValueError("must be the name of a column or its number, or a list, one for each experiment")
        if isinstance(column, int) and column < 1:
            raise ValueError("must be a column's number from 1, or its name")
    return tuple(found)


def _column(value: Any) -> Any:
    if isinstance(value, list | tuple):
        raise ValueError("must be the name of a column or its number")
    return _columns(value)[0]


def _files(value: Any) -> Any:
    found = value if isinstance(value, list | tuple) else [value]
    if not all(isinstance(file, str) and file for file in found):
        raise ValueError("must be the name of a file, or a list of names")
    return tuple(found)


def _codes(value: Any) -> Any:
    return tuple(value) if isinstance(value, list | tuple) else (value,)


def _a_range(text: str) -> str:
    range_of(text)
    return text


def _selection(value: Any) -> Any:
    """What stands for a mapping: a range, two columns, or a file, also with its columns."""
    if isinstance(value, list | tuple) and len(value) == 2:
        return {"input": value[0], "output": value[1]}
    if not isinstance(value, str):
        return value
    try:
        range_of(value)
    except ValueError as error:
        if value.lower().endswith(SUFFIXES):
            return {"file": value}
        *file, one, other = ["", *(name.strip() for name in value.split(","))]
        columns = {"input": one, "output": other}
        if file == [""] and one and other:
            return columns
        if len(file) == 2 and file[1].lower().endswith(SUFFIXES) and one and other:
            return columns | {"file": file[1]}
        if ".." in value and "," not in value:
            raise ValueError(str(error)) from None
        raise ValueError(
            "must be a range of samples such as 801..1000, two columns such as 'uVal,yVal', a file, also "
            "with its columns as 'other.csv,u,y', or a mapping of 'file', 'input', 'output' and 'samples'"
        ) from None
    return {"samples": value}


def _or_list(one: dict[str, Any]) -> WithJsonSchema:
    return WithJsonSchema({"anyOf": [*one["anyOf"], {"type": "array", "items": one, "minItems": 1}]})


_TEXT = {"anyOf": [{"type": "string"}]}
_COLUMN = {"anyOf": [{"type": "string"}, {"type": "integer", "minimum": 1}]}
Files = Annotated[tuple[str, ...], BeforeValidator(_files), Field(min_length=1), _or_list(_TEXT)]
Columns = Annotated[tuple[Column, ...], BeforeValidator(_columns), Field(min_length=1), _or_list(_COLUMN)]
Range = Annotated[str, AfterValidator(_a_range)]
_NUMBER = {"anyOf": [{"type": "number"}, {"type": "string"}]}
Codes = Annotated[tuple[Real, ...], BeforeValidator(_codes), _or_list(_NUMBER)]


class Selection(Spec):
    """Other samples of the same system: what it does not name is as in the record."""

    file: Files | None = None
    """The file, or a list of files, one for each experiment."""
    input: Columns | None = None
    """The column of the input, or a list of columns."""
    output: Columns | None = None
    """The column of the output, or a list of columns."""
    samples: Range | None = None
    """A range of the samples of each experiment, such as 801..1000, counted from 1."""


class _Shorthands:
    """Tells the JSON Schema what :func:`_selection` takes in the place of a mapping."""

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        columns = {"type": "array", "items": _COLUMN, "minItems": 2, "maxItems": 2}
        return {"anyOf": [handler(schema), {"type": "string", "minLength": 1}, columns]}


class Units(Spec):
    """The units of the signals and of time, as figures and models show them."""

    input: str = ""
    """Unit of the input."""
    output: str = ""
    """Unit of the output."""
    time: str = ""
    """Unit of time."""


class Offset(Spec):
    """The values of the signals at the operating point, which are taken off."""

    input: Real = 0.0
    """Taken off the input."""
    output: Real = 0.0
    """Taken off the output."""


class MeasuredRecord(Spec):
    """A record of measurements, from files of samples.

    Several files, or several columns of the input or of the output, are experiments of one record, the parts
    of which have the names of what they differ in.

    Examples
    --------
    >>> written = Path("tanks.csv").write_text("u,y,uVal,yVal\\n1,0,2,1\\n2,0.5,0,1.5\\n0,1.2,1,0.5\\n")
    >>> spec = MeasuredRecord(file="tanks.csv", input="u", output="y", dt=4, validation="uVal,yVal")
    >>> record = spec.read(Path())
    >>> record.y, record.dt, record.validation.y
    (array([0. , 0.5, 1.2]), 4.0, array([1. , 1.5, 0.5]))
    """

    file: Files
    """The file, from the folder of the configuration, or a list of files, one for each experiment."""
    input: Columns
    """The column of the input by its name, or its number from 1; a list: one for each experiment."""
    output: Columns
    """The column of the output by its name, or its number from 1; a list: one for each experiment."""
    dt: Annotated[Real, Field(gt=0)] | None = None
    """Sampling interval; leave it out in discrete time, or where a column has the times."""
    time: Annotated[Column, BeforeValidator(_column), WithJsonSchema(_COLUMN)] | None = None
    """The column of the sampling times (numbers or dates), in place of dt; even unless resample is given."""
    estimation: Range | None = None
    """The samples to estimate from, such as 1..800, in each experiment, counted from 1; all by default."""
    validation: Annotated[Selection, BeforeValidator(_selection), _Shorthands()] | None = None
    """What to validate on: 801..1000, two columns 'uVal,yVal', a file, 'other.csv,u,y', or a mapping."""
    detrend: Trend | None = None
    """mean: takes the means of the estimation samples off all; linear: off each experiment its line."""
    offset: Offset | None = None
    """The operating point, which is taken off."""
    resample: Annotated[Real, Field(gt=0)] | None = None
    """Interval at which samples at uneven times are interpolated along straight lines."""
    decimate: Annotated[Count, Field(ge=1)] = 1
    """Keeps every so many-th sample behind a filter without phase (FIR, 20 times as long)."""
    decimal: Literal[".", ","] | None = None
    """What stands before the decimals of numbers in text files; by default what the numbers show."""
    missing: Codes = ()
    """The numbers that the input or the output has where a sample is missing, such as -9999."""
    gaps: Literal["error", "split"] = "error"
    """What a missing sample (an empty cell, na, nan) or a hole in the times is: an error, or a part's end."""
    units: Units = Units()
    """Units of the input, the output and time."""

    @field_validator("time")
    @classmethod
    def _one_clock(cls, time: Column | None, info: ValidationInfo) -> Column | None:
        if time is not None and info.data.get("dt") is not None:
            raise ValueError("give 'dt' or 'time', not both")
        return time

    @field_validator("validation")
    @classmethod
    def _apart(cls, validation: Selection | None, info: ValidationInfo) -> Selection | None:
        if validation is None or validation.file or validation.input or validation.output:
            return validation
        estimation = info.data.get("estimation")
        if validation.samples is None:
            raise ValueError("must name a file, columns or a range of samples")
        if estimation is None:
            raise ValueError("is a range of the samples to estimate from: give 'estimation', a range, too")
        (first, last), (start, stop) = range_of(estimation), range_of(validation.samples)
        if first <= (stop or math.inf) and start <= (last or math.inf):
            raise ValueError(f"shares samples with 'estimation' ({estimation})")
        return validation

    @field_validator("offset")
    @classmethod
    def _one_level(cls, offset: Offset | None, info: ValidationInfo) -> Offset | None:
        if offset is not None and info.data.get("detrend") is not None:
            raise ValueError("give 'detrend' or 'offset', not both")
        return offset

    @field_validator("resample")
    @classmethod
    def _needs_times(cls, resample: float | None, info: ValidationInfo) -> float | None:
        if resample is not None and info.data.get("time") is None:
            raise ValueError("needs the column of the sampling times: give 'time'")
        return resample

    def read(self, folder: Path) -> Record:
        """The record, with that for validation; files are named from the folder.

        Raises
        ------
        ConfigError
            If a file cannot be read, or its samples do not suit.
        """
        other = self.validation or Selection()
        for inputs, outputs in (
            (self.input, self.output),
            (other.input or self.input, other.output or self.output),
        ):
            if same := set(map(str, inputs)) & set(map(str, outputs)):
                raise ConfigError(f"the input and the output are one column, '{min(same)}'")
        with np.errstate(all="ignore"):
            return self._read(folder)

    def read_input(self, folder: Path) -> Record:
        """The record of an input alone: the output may be the same column, and means nothing then.

        Raises
        ------
        ConfigError
            As :meth:`read`.
        """
        with np.errstate(all="ignore"):
            return self._read(folder)

    def _read(self, folder: Path) -> Record:
        # A range for validation is of the same columns.
        columns = cache(
            partial(read_columns, blanks=self.gaps == "split", times=self.time, decimal=self.decimal)
        )
        experiments = self._experiments(folder, Selection(samples=self.estimation), columns)
        offset = self._offset(experiments)
        record = self._record(experiments, offset)
        if self.validation is None:
            return record
        validation = self._record(self._experiments(folder, self.validation, columns), offset)
        if (
            record.dt is not None
            and validation.dt is not None
            and not math.isclose(record.dt, validation.dt, rel_tol=1e-3)
        ):
            raise ConfigError(
                f"the samples for validation are {validation.dt:g} apart, and those to estimate from "
                f"{record.dt:g}: 'resample' brings them to one interval"
            )
        return replace(record, validation=validation)

    def files(self) -> tuple[str, ...]:
        """The names of all files that it reads, each once."""
        others = self.validation.file if self.validation and self.validation.file else ()
        return tuple(dict.fromkeys((*self.file, *others)))

    def digest(self, folder: Path) -> str:
        """SHA-256 of the file's bytes, hexadecimal; of several files, that of their digests in a row.

        Raises
        ------
        ConfigError
            If a file cannot be read.
        """
        digests = []
        for name in self.files():
            path = folder / name
            try:
                with path.open("rb") as file:
                    digests.append(hashlib.file_digest(file, "sha256").hexdigest())
            except OSError as error:
                reason = (error.strerror or str(error)).lower()
                raise ConfigError(f"{path}: cannot be read: {reason}") from None
        return digests[0] if len(digests) == 1 else hashlib.sha256("".join(digests).encode()).hexdigest()

    def _experiments(
        self, folder: Path, selection: Selection, columns: Callable[..., list[Array]]
    ) -> list[Samples]:
        """What is read by ``columns`` and made even, of one selection."""
        chosen = _spread(
            {
                "file": selection.file or self.file,
                "input": selection.input or self.input,
                "output": selection.output or self.output,
            }
        )
        _require_own_outputs(chosen)
        return [
            one
            for name, (file, *signals) in zip(_names(chosen), chosen, strict=True)
            for one in self._even(
                folder / file,
                self._uncoded(folder / file, signals, columns(folder / file, self._wanted(signals))),
                name,
                selection.samples,
            )
        ]

    def _wanted(self, signals: Sequence[Column]) -> tuple[Column, ...]:
        return (*signals, *(() if self.time is None else (self.time,)))

    def _uncoded(self, path: Path, signals: Sequence[Column], columns: Sequence[Array]) -> list[Array]:
        """The columns, nan where a signal has a code for missing samples."""
        if not self.missing:
            return list(columns)
        codes = np.array(self.missing, dtype=float)
        # A file may hold single precision.
        codes = np.concatenate([codes, codes.astype(np.float32)])
        found = list(columns)
        for i, name in enumerate(signals):
            there = np.isin(found[i], codes)
            if there.any() and self.gaps == "error":
                first = int(np.argmax(there))
                raise ConfigError(
                    f"{path}: column '{name}': sample {first + 1} is missing ({found[i][first]:g}){SPLIT}"
                )
            found[i] = np.where(there, np.nan, found[i])
        return found

    def _even(
        self, path: Path, columns: Sequence[Array], name: str, samples: str | None
    ) -> Iterator[Samples]:
        if not len(columns[0]):
            raise ConfigError(f"{path}: holds no samples")
        u, y, *times = columns
        try:
            measured = within(Samples(name, u, y, self.dt, *times), samples)
        except ValueError as error:
            raise ConfigError(f"{path}: {error}") from None
        parts = between_gaps(measured) if self.gaps == "split" else [measured]
        if not parts:
            raise ConfigError(f"{path}: holds no two samples without a gap between them")
        for part in parts:
            try:
                yield at_even_times(part, self.resample)
            except ValueError as error:
                raise ConfigError(f"{path}: column '{self.time}': {error}") from None

    def _offset(self, experiments: Sequence[Samples]) -> tuple[float, float]:
        if self.detrend == "mean":
            return means(experiments)
        return (self.offset.input, self.offset.output) if self.offset else (0.0, 0.0)

    def _record(self, experiments: Sequence[Samples], offset: tuple[float, float]) -> Record:
        units = {name: unit for name, unit in self.units if unit}
        offsets = dict(zip(("input", "output"), offset, strict=True)) if any(offset) else {}
        try:
            level = [
                without_line(one) if self.detrend == "linear" else less(one, *offset) for one in experiments
            ]
            record = record_of([decimated(one, self.decimate) for one in level], units, offsets)
            return replace(record, detrended=self.detrend == "linear")
        except ValueError as error:
            raise ConfigError(f"{one_of(self.file)}: {error}") from None


def _spread(lists: Mapping[str, Sequence[Any]]) -> list[tuple[Any, ...]]:
    """One tuple for each experiment: lists of one item hold for all."""
    longest = max(lists, key=lambda name: len(lists[name]))
    n = len(lists[longest])
    for name, items in lists.items():
        if len(items) not in (1, n):
            raise ConfigError(
                f"'{name}' lists {len(items)} ({one_of(items)}) and '{longest}' {n}: one is for all "
                "experiments, or one for each"
            )
    columns = [[*items] * (n if len(items) == 1 else 1) for items in lists.values()]
    return list(zip(*columns, strict=True))


def _require_own_outputs(chosen: Sequence[tuple[Any, ...]]) -> None:
    """Refuse several inputs of one output: these are no experiments."""
    inputs: dict[tuple[Any, str], Any] = {}
    for file, one, output in chosen:
        other = inputs.setdefault((file, str(output)), one)
        if str(other) != str(one):
            raise ConfigError(
                f"{file}: the output '{output}' has two inputs, '{other}' and '{one}': a list is one of "
                "experiments, each with an output of its own, and a model has one input"
            )


def _names(chosen: Sequence[tuple[Any, ...]]) -> list[str]:
    """Names of experiments: by their files or else by their columns, and numbered where these are equal."""
    for labels in (
        [Path(file).stem for file, _, _ in chosen],
        [str(output) for _, _, output in chosen],
        [str(column) for _, column, _ in chosen],
    ):
        if len(set(labels)) == len(labels):
            return labels
    return [str(number) for number, _ in zip(count(1), chosen, strict=False)]


def read(
    path: str | Path | Sequence[str | Path],
    *,
    input: Column | Sequence[Column],  # noqa: A002
    output: Column | Sequence[Column],
    dt: float | None = None,
    time: Column | None = None,
    **prepared: Any,
) -> Record:
    """The record of a measurement, from files of its samples.

    Parameters
    ----------
    path : str or Path, or a list of them
        Text with a sample in each line (CSV, TSV, TXT, DAT: separated by commas, semicolons, tabs or blanks,
        decimal points or commas), Parquet, NPZ, MAT or HDF5. A list: one file for each experiment.
    input, output : str or int, or a list of them
        The columns that hold u and y, in any units, by their names, or by their numbers from 1. A list: one
        for each experiment.
    dt : float, optional
        Sampling interval; leave it out in discrete time.
    time : str or int, optional
        The column of the sampling times, in place of ``dt``; they must be evenly spaced. Dates in text
        count in seconds.
    **prepared
        What else a :class:`MeasuredRecord` says: ``estimation``, ``validation``, ``detrend``, ``offset``,
        ``resample``, ``decimate``, ``decimal``, ``missing``, ``gaps``, ``units``.

    Returns
    -------
    Record
        The samples as float64, shape (N,), and no truth.

    Raises
    ------
    ConfigError
        If the file cannot be read, or a column is missing or holds what is no finite number; the message
        names the column, and the line.

    Examples
    --------
    >>> from pathlib import Path
    >>> import hident as hi
    >>> written = Path("valve.csv").write_text("t,u,y\\n0,1,0\\n0.1,2,0.5\\n0.2,0,1.2\\n")
    >>> record = hi.read("valve.csv", input="u", output="y", time="t")
    >>> record.u, record.y, record.dt
    (array([1., 2., 0.]), array([0. , 0.5, 1.2]), 0.1)
    """
    if dt is not None and time is not None:
        raise ConfigError("give 'dt' or 'time', not both")
    if dt is not None and not 0.0 < dt < math.inf:
        raise ConfigError(f"dt must be a number > 0 (got {dt!r})")
    files = [path] if isinstance(path, str | Path) else path
    given = {"input": input, "output": output, "dt": dt, "time": time, **prepared}
    return MeasuredRecord(file=[str(file) for file in files], **given).read(Path())
