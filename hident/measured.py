"""Records of measurements, from files: CSV with a line of names, or NumPy's NPZ."""

from __future__ import annotations

import csv
import math
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hident.arrays import Array
from hident.config.suggest import did_you_mean, one_of
from hident.errors import ConfigError
from hident.records import Record

_SEPARATORS = ",;\t"


def read(
    path: str | Path,
    *,
    input: str,  # noqa: A002
    output: str,
    dt: float | None = None,
    time: str | None = None,
) -> Record:
    """The record of a measurement, from a file of its samples.

    Parameters
    ----------
    path : str or Path
        A CSV file, whose first line names the columns (separated by commas, semicolons or tabs; decimal
        points), or an NPZ file with an array of shape (N,) for each column.
    input, output : str
        The names of the columns that hold u and y, in any units.
    dt : float, optional
        Sampling interval; leave it out in discrete time.
    time : str, optional
        The column of the sampling times, in place of ``dt``; they must be evenly spaced.

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
    path = Path(path)
    if dt is not None and time is not None:
        raise ConfigError("give 'dt' or 'time', not both")
    if dt is not None and not 0.0 < dt < math.inf:
        raise ConfigError(f"dt must be a number > 0 (got {dt!r})")
    names = [input, output, *([] if time is None else [time])]
    u, y, *times = _columns(path, names)
    if not len(u):
        raise ConfigError(f"{path}: holds no samples")
    if time is None:
        return Record(u, y, dt)
    try:
        return Record.at(times[0], u, y)
    except ValueError as error:
        raise ConfigError(f"{path}: column '{time}': {error}") from None


def _columns(path: Path, names: Sequence[str]) -> list[Array]:
    try:
        match path.suffix.lower():
            case ".csv":
                return _of_csv(path, names)
            case ".npz":
                return _of_npz(path, names)
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except (UnicodeDecodeError, csv.Error, zipfile.BadZipFile):
        raise ConfigError(f"{path}: cannot be read: it is no {path.suffix[1:].upper()} file") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    raise ConfigError(f"{path}: the name must end in .csv or .npz")


def _require(path: Path, names: Sequence[str], known: Sequence[str]) -> None:
    for name in names:
        if known.count(name) != 1:
            said = "no column" if name not in known else "more than one column"
            near = did_you_mean(name, known) if name not in known else ""
            raise ConfigError(f"{path}: there is {said} '{name}'{near} (the file has: {one_of(known)})")


def _of_csv(path: Path, names: Sequence[str]) -> list[Array]:
    # Spreadsheets begin their files with a mark that is no part of the first name.
    with path.open(encoding="utf-8-sig", newline="") as file:
        first = file.readline()
        separator = max(_SEPARATORS, key=first.count)
        known = [name.strip() for name in next(csv.reader([first], delimiter=separator), [])]
        _require(path, names, known)
        places = [known.index(name) for name in names]
        samples: list[list[float]] = []
        rows = csv.reader(file, delimiter=separator)
        for row in rows:
            line = f"{path}:{rows.line_num + 1}"
            if not row:
                continue
            if len(row) != len(known):
                raise ConfigError(f"{line}: has {len(row)} columns, where the first line names {len(known)}")
            samples.append(
                [_number(row[i], f"{line}: column '{name}'") for i, name in zip(places, names, strict=True)]
            )
    return list(np.array(samples, dtype=float).reshape(-1, len(names)).T.copy())


def _number(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    # Python's own reading takes the underscores of its source code.
    if "_" in text or not math.isfinite(value):
        raise ConfigError(f"{where}: must be a finite number (got '{text.strip()}')")
    return value


def _of_npz(path: Path, names: Sequence[str]) -> list[Array]:
    with path.open("rb") as file:
        if not zipfile.is_zipfile(file):
            raise zipfile.BadZipFile
    with np.load(path, allow_pickle=False) as arrays:
        _require(path, names, arrays.files)
        try:
            found = {name: arrays[name] for name in names}
        except ValueError:
            raise ConfigError(f"{path}: holds what is no array of numbers") from None
    columns = []
    for name in names:
        where = f"{path}: column '{name}'"
        column = found[name]
        if column.ndim != 1 or column.dtype.kind not in "iuf":
            raise ConfigError(
                f"{where}: must be an array of numbers of shape (N,), not {column.dtype} of {column.shape}"
            )
        if len(wrong := np.flatnonzero(~np.isfinite(column))):
            raise ConfigError(f"{where}: sample {wrong[0]}: must be a finite number (got {column[wrong[0]]})")
        if len(column) != len(found[names[0]]):
            raise ConfigError(
                f"{where}: has {len(column)} samples, where '{names[0]}' has {len(found[names[0]])}"
            )
        columns.append(column.astype(float))
    return columns
