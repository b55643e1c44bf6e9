"""Columns of a file of samples: which ones are meant, and what is a column of numbers."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hident.arrays import Array
from hident.config.suggest import did_you_mean, one_of
from hident.errors import ConfigError

Column = str | int
"""The name of a column, or its number from 1."""


SPLIT = "; 'gaps: split' (--gaps split) ends a part at a missing sample"
"""What to do about a missing sample, for the end of a message."""
_DIGITS = re.compile("[0-9]{1,9}")
_SHOWN = 40


def places(path: Path, wanted: Sequence[Column], names: Sequence[str], *, named: bool = True) -> list[int]:
    """Where the wanted columns stand among those of a file, from 0.

    Whole numbers count the columns from 1; digits in a text do, unless a column has them for its name.
    ``named`` says whether the file names its columns at all.

    Raises
    ------
    ConfigError
        If there is no such column, or more than one; the message has the nearest name.
    """
    return [_place(path, column, names, named) for column in wanted]


def _place(path: Path, column: Column, names: Sequence[str], named: bool) -> int:
    known = names if named else ()
    if isinstance(column, str) and known.count(column) == 1:
        return known.index(column)
    if isinstance(column, str) and known.count(column) > 1:
        said = f"there is more than one column '{column}' (the file has: {_some(names)})"
    elif isinstance(column, int) or _DIGITS.fullmatch(column):
        if 1 <= int(column) <= len(names):
            return int(column) - 1
        has = f": {_some(names)}" if named and names else ""
        said = f"there is no column {column} (the file has {len(names)}{has})"
    elif named:
        said = f"there is no column '{column}'{did_you_mean(column, names)} (the file has: {_some(names)})"
    else:
        said = (
            f"there is no column '{column}': the file does not name its columns, so they go by number, "
            f"1 to {len(names)}"
        )
    raise ConfigError(f"{path}: {said}")


def _some(names: Sequence[str]) -> str:
    more = len(names) - _SHOWN
    return f"{one_of(names[:_SHOWN])}, and {more} more" if more > 0 else one_of(names)


def numbers(where: str, values: Any, *, blanks: bool = False) -> Array:
    """The values of a column, shape (N,) or one line or column of a table, as float64.

    Raises
    ------
    ConfigError
        If they are no such numbers, or not finite; with ``blanks`` nan stands for a missing one.
    """
    values = np.asarray(values)
    column = values.reshape(-1) if values.ndim == 2 and 1 in values.shape else values
    if column.ndim != 1 or column.dtype.kind not in "iufb":
        raise ConfigError(
            f"{where}: must be an array of numbers of shape (N,), not {values.dtype} of {values.shape}"
        )
    wrong = np.flatnonzero(np.isinf(column) if blanks else ~np.isfinite(column))
    if len(wrong):
        first = column[wrong[0]]
        hint = SPLIT if np.isnan(first) else ""
        raise ConfigError(f"{where}: sample {wrong[0] + 1}: must be a finite number (got {first}){hint}")
    found: Array = column.astype(float)
    if len(large := np.flatnonzero(np.isinf(found))):
        raise ConfigError(f"{where}: sample {large[0] + 1}: must be a finite number (got {column[large[0]]})")
    return found
