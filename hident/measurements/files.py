"""The columns of a file of samples, by its suffix."""

from __future__ import annotations

import csv
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hident.arrays import Array
from hident.config.suggest import one_of
from hident.errors import ConfigError
from hident.measurements.columns import Column, numbers, places
from hident.measurements.delimited import NotText, read_delimited

Reader = Callable[..., list[Array]]


class _NoSuchFormat(Exception):
    """The file is not what its suffix says."""


def read_columns(
    path: Path,
    wanted: Sequence[Column],
    *,
    blanks: bool = False,
    times: Column | None = None,
    decimal: str | None = None,
) -> list[Array]:
    """The wanted columns of a file, float64 of shape (N,).

    Parameters
    ----------
    path : Path
        Text with a sample in each line (.csv, .tsv, .txt, .dat), separated by commas, semicolons, tabs or
        blanks, with or without a line of names; lines before it that begin with # or % are skipped.
        Parquet. Arrays of shape (N,), or tables with one line or column, in NPZ, MATLAB's MAT or HDF5;
        what stands in a structure or a group goes by ``outer.inner`` or ``outer/inner``. A file that holds
        nothing but one table has that table's columns, by number.
    wanted : sequence of str or int
        The names of the columns, or their numbers from 1.
    blanks : bool
        Whether a value may be missing (an empty cell, na or nan): it is nan.
    times : str or int, optional
        The column that may hold dates, in text (ISO 8601, or 31.12.2024 12:00) or Parquet: it is in
        seconds since the first one then.
    decimal : {".", ","}, optional
        What stands before the decimals of numbers in text; by default what they show.

    Raises
    ------
    ConfigError
        If the file cannot be read, or a column is missing or holds what is no finite number.

    Examples
    --------
    >>> path = Path("valve.dat")
    >>> written = path.write_text(" 0.0 1.0 0.5\\n 0.1 2.0 0.7\\n")
    >>> read_columns(path, [2, 3])
    [array([1., 2.]), array([0.5, 0.7])]
    """
    reader = _READERS.get(path.suffix.lower())
    try:
        if path.is_dir():
            raise ConfigError(f"{path}: is a folder; name a file")
        if reader is None:
            *rest, last = _READERS
            raise ConfigError(f"{path}: the name must end in {one_of(rest)} or {last}")
        more: dict[str, Any] = {"times": times} if reader in (read_delimited, _parquet) else {}
        if reader is read_delimited:
            more["decimal"] = decimal
        return _of_one_length(path, wanted, reader(path, wanted, blanks=blanks, **more))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except (NotText, UnicodeDecodeError, csv.Error, zipfile.BadZipFile, _NoSuchFormat):
        raise ConfigError(f"{path}: cannot be read: it is no {path.suffix[1:].upper()} file") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None


def _of_one_length(path: Path, wanted: Sequence[Column], columns: list[Array]) -> list[Array]:
    for name, column in zip(wanted, columns, strict=True):
        if len(column) != len(columns[0]):
            raise ConfigError(
                f"{path}: column '{name}': has {len(column)} samples, "
                f"where '{wanted[0]}' has {len(columns[0])}"
            )
    return columns


def _of_arrays(
    path: Path, wanted: Sequence[Column], arrays: Mapping[str, Any], *, blanks: bool
) -> list[Array]:
    """The columns among arrays by name, which are read when they are asked for."""
    names = list(arrays)
    if len(names) == 1 and (table := np.asarray(arrays[names[0]])).ndim == 2 and 1 not in table.shape:
        asked = places(path, wanted, [""] * table.shape[1], named=False)
        found = [table[:, place] for place in asked]
    else:
        found = [arrays[names[place]] for place in places(path, wanted, names)]
    return [
        numbers(f"{path}: column '{name}'", values, blanks=blanks)
        for name, values in zip(wanted, found, strict=True)
    ]


def _npz(path: Path, wanted: Sequence[Column], *, blanks: bool) -> list[Array]:
    with path.open("rb") as file:
        if not zipfile.is_zipfile(file):
            raise zipfile.BadZipFile
        file.seek(0)
        # What is wrong with a file, or a member, that was damaged or packed by others has many kinds.
        try:
            with np.load(file, allow_pickle=False) as arrays:
                return _of_arrays(path, wanted, arrays, blanks=blanks)
        except (ValueError, RuntimeError, EOFError, zlib.error):
            raise ConfigError(f"{path}: holds what is no array of numbers") from None


def _parquet(
    path: Path, wanted: Sequence[Column], *, blanks: bool, times: Column | None = None
) -> list[Array]:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise ConfigError(f"{path}: reading Parquet needs pyarrow: pip install 'hident[parquet]'") from None
    with path.open("rb") as file:
        try:
            table = pq.ParquetFile(file)
            names = table.schema_arrow.names
        except (pa.ArrowException, OSError):
            raise _NoSuchFormat from None
        chosen = [names[place] for place in places(path, wanted, names)]
        clock = None if times is None else names[places(path, [times], names)[0]]
        try:
            frame = table.read(columns=list(dict.fromkeys(chosen)))
        except (pa.ArrowException, OSError):
            raise _NoSuchFormat from None
    columns = []
    for name in chosen:
        column = frame.column(name)
        where = f"{path}: column '{name}'"
        if pa.types.is_decimal(column.type):
            column = column.cast(pa.float64())
        if name == clock and pa.types.is_timestamp(column.type):
            columns.append(numbers(where, _seconds(column.to_numpy()), blanks=blanks))
            continue
        if not (_is_numeric(column.type)):
            raise ConfigError(f"{where}: must hold numbers, not {column.type}")
        columns.append(numbers(where, column.to_numpy(), blanks=blanks))
    return columns


def _seconds(dates: np.ndarray[Any, Any]) -> Array:
    """Seconds since the first date there is, nan where one is missing."""
    there = dates[~np.isnat(dates)]
    since: Array = (dates - there[0]) / np.timedelta64(1, "s") if len(there) else np.full(len(dates), np.nan)
    return since


def _is_numeric(kind: Any) -> bool:
    from pyarrow import types

    return bool(types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind))


def _mat(path: Path, wanted: Sequence[Column], *, blanks: bool) -> list[Array]:
    from scipy.io import loadmat

    with path.open("rb") as file:
        try:
            held = loadmat(file, simplify_cells=True)
        except NotImplementedError:
            held = None
        # What a broken file raises depends on where it is broken.
        except Exception:
            raise _NoSuchFormat from None
    if held is not None:
        variables = {name: value for name, value in held.items() if not name.startswith("__")}
        return _of_arrays(path, wanted, dict(_flat(variables)), blanks=blanks)
    # MATLAB writes HDF5 with the axes in the other order.
    return _of_hdf5(
        path,
        wanted,
        "a MAT file of version 7.3 is HDF5: reading it",
        ", or save it in MATLAB with '-v7'",
        lambda values: values.T,
        blanks=blanks,
    )


def _flat(held: Mapping[str, Any], outer: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in held.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{outer}{name}.")
        else:
            yield f"{outer}{name}", value


def _hdf5(path: Path, wanted: Sequence[Column], *, blanks: bool) -> list[Array]:
    return _of_hdf5(path, wanted, "reading HDF5", "", lambda values: values, blanks=blanks)


def _of_hdf5(
    path: Path,
    wanted: Sequence[Column],
    what: str,
    instead: str,
    turned: Callable[[Any], Any],
    *,
    blanks: bool,
) -> list[Array]:
    try:
        import h5py
    except ImportError:
        raise ConfigError(f"{path}: {what} needs h5py: pip install 'hident[hdf5]'{instead}") from None
    with path.open("rb"):
        pass
    try:
        file = h5py.File(path, "r")
    except OSError:
        raise _NoSuchFormat from None
    with file:
        sets: dict[str, Any] = {}

        def visit(name: str, item: Any) -> None:
            # MATLAB keeps what its cells point at in groups of its own.
            if isinstance(item, h5py.Dataset) and not name.startswith("#"):
                sets[name] = item

        file.visititems(visit)
        return _of_arrays(path, wanted, _Read(sets, turned), blanks=blanks)


class _Read(Mapping[str, Any]):
    """Data sets that are read when they are asked for."""

    def __init__(self, sets: Mapping[str, Any], turned: Callable[[Any], Any]) -> None:
        self._sets, self._turned = sets, turned

    def __getitem__(self, name: str) -> Any:
        return self._turned(np.asarray(self._sets[name][()]))

    def __iter__(self) -> Iterator[str]:
        return iter(self._sets)

    def __len__(self) -> int:
        return len(self._sets)


_READERS: dict[str, Reader] = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat"), read_delimited),
    ".parquet": _parquet,
    ".mat": _mat,
    ".npz": _npz,
    **dict.fromkeys((".h5", ".hdf5"), _hdf5),
}
SUFFIXES = tuple(_READERS)
"""The endings of the files that can be read."""
