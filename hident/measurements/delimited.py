"""Columns of text: a sample in each line, its values parted by commas, semicolons, tabs or blanks.

What a file says is defined by one careful pass over its cells, which knows line and column of what is wrong.
NumPy's reader goes first, as it is many times faster, and its answer counts where nothing can be wrong.
"""

from __future__ import annotations

import codecs
import csv
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from hident.arrays import Array
from hident.errors import ConfigError
from hident.measurements.columns import SPLIT, Column, places

_SEPARATORS = ",;\t"
_BLANK = " "
_POINT = "."
_COMMENTS = ("#", "%")
_QUOTED = re.compile('"[^"]*"')
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x19\x1b-\x1f]")
# Spreadsheets write what they could not compute as #N/A, #NV, #DIV/0!, #WERT!, #NAME? and the like.
_MISSING = re.compile(r"|nan|na|n/a|null|none|#n/?[av]|#[^\W_]+(/0)?[!?]", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
_DAY_FIRST = re.compile(r"(\d\d?)\.(\d\d?)\.(\d{4})(?:[T ]+(\d\d?)(:.+))?")
_DATES = "dates such as 2024-03-01 12:00:00.5 or 01.03.2024 12:00"
_OTHER_DATE = re.compile(r"\d+[-/:.]\d+[-/:.]")
# What may be thousands as well: groups of three digits, and no zero before them.
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2},\d{3}")
# Excel's own first line, which it does not show.
_SAYS_SEPARATOR = re.compile(r'"?sep=(.)"?', re.IGNORECASE)
# So many lines tell what parts the values.
_LOOKED_AT = 20


class NotText(Exception):
    """The bytes are no text that could hold columns."""


def read_delimited(
    path: Path,
    wanted: Sequence[Column],
    *,
    blanks: bool = False,
    times: Column | None = None,
    decimal: str | None = None,
) -> list[Array]:
    """The wanted columns, each of shape (N,); with ``blanks``, nan where a value is missing.

    The column ``times`` may hold dates: it is in seconds since the first one then.

    ``decimal`` is what stands before the decimals, a point or a comma; None: what the numbers show.

    Raises
    ------
    ConfigError
        If a column is missing, or holds what is no finite number.
    NotText, UnicodeDecodeError, csv.Error, OSError
        If the file cannot be read at all.
    """
    table = _Table.of(path)
    asked = places(path, wanted, table.names, named=table.named)
    table.check_first_line(wanted, asked)
    quick = None if decimal == "," else table.quickly(asked, blanks)
    if quick:
        return quick
    clock = None if times is None else places(path, [times], table.names, named=table.named)[0]
    return table.carefully(asked, blanks, decimal, clock)


@dataclass(frozen=True)
class _Table:
    path: Path
    separator: str
    names: tuple[str, ...]
    """Names of the columns; their numbers, if the file has no line of names."""
    named: bool
    first: int
    """Number of the first line, from 1."""
    body: list[str]
    """The lines after that of the names."""

    @classmethod
    def of(cls, path: Path) -> _Table:
        lines = _text(path.read_bytes()).replace("\r\n", "\n").replace("\r", "\n").split("\n")
        i = 0
        while i < len(lines) - 1 and (not lines[i].strip() or lines[i].lstrip().startswith(_COMMENTS)):
            i += 1
        if (says := _SAYS_SEPARATOR.fullmatch(lines[i].strip(" "))) and i < len(lines) - 1:
            i += 1
        separator = says[1] if says and says[1] in _SEPARATORS else _separator(lines[i:])
        cells = _full(next(iter(_rows([lines[i]], separator)), (0, []))[1])
        named = not cells or not all(_is_number_of_any(cell) or _date(cell) for cell in cells if cell)
        names = cells if named else [str(1 + k) for k in range(len(cells))]
        return cls(path, separator, tuple(names), named, i + 1, lines[i + 1 :] if named else lines[i:])

    def check_first_line(self, wanted: Sequence[Column], asked: Sequence[int]) -> None:
        """Refuse a first line of names that holds a number where a column is meant by its number."""
        for column, place in zip(wanted, asked, strict=True):
            name = self.names[place]
            if self.named and _is_number_of_any(name) and column != name:
                other = next(cell for cell in self.names if cell and not _is_number_of_any(cell))
                raise ConfigError(
                    f"{self.path}:{self.first}: holds numbers ('{name}') as well as what is none ('{other}')"
                )

    def quickly(self, asked: Sequence[int], blanks: bool) -> list[Array] | None:
        """The columns by NumPy's reader; None where only the careful pass can tell."""
        lines = [line for line in self.body if line.strip()]
        if not lines or not all(map(self._regular, lines)):
            return None
        delimiter = None if self.separator == _BLANK else self.separator
        try:
            values = np.loadtxt(lines, delimiter=delimiter, usecols=asked, comments=None, ndmin=2)
        except ValueError:
            return None
        if (np.isinf(values) if blanks else ~np.isfinite(values)).any():
            return None
        return list(values.T.copy())

    def _regular(self, line: str) -> bool:
        """Whether a line plainly has the columns of the first one; a separator may stand at its end."""
        if '"' in line:
            return False
        if self.separator == _BLANK:
            return len(line.split()) == len(self.names)
        extra = line.count(self.separator) + 1 - len(self.names)
        return extra == 0 or (extra == 1 and line.rstrip(" ").endswith(self.separator))

    def carefully(
        self, asked: Sequence[int], blanks: bool, decimal: str | None, clock: int | None
    ) -> list[Array]:
        """The columns cell by cell; that at ``clock`` may hold dates."""
        samples: list[tuple[str, list[str]]] = []
        for number, row in _rows(self.body, self.separator):
            where = f"{self.path}:{self.first + self.named + number - 1}"
            if len(row) < len(self.names) or any(row[len(self.names) :]):
                first = "names" if self.named else "has"
                raise ConfigError(
                    f"{where}: has {len(row)} columns, where the first line {first} {len(self.names)}"
                )
            samples.append((where, [row[place] for place in asked]))
        decimal = decimal or self._decimal(samples)
        times = [(where, row[asked.index(clock)]) for where, row in samples] if clock in asked else []
        seconds = _seconds(times)
        values = [
            [
                seconds[where]
                if place == clock and where in seconds
                else self._value(text, place, where, blanks, decimal)
                for text, place in zip(row, asked, strict=True)
            ]
            for where, row in samples
        ]
        return list(np.array(values, dtype=float).reshape(-1, len(asked)).T.copy())

    def _decimal(self, samples: Sequence[tuple[str, Sequence[str]]]) -> str:
        """What stands before the decimals: a comma where it does so once, and cannot be one of thousands."""
        commas = [(where, text) for where, row in samples for text in row if _DECIMAL_COMMA.fullmatch(text)]
        if not commas:
            return _POINT
        if all(_THOUSANDS.fullmatch(text) for _, text in commas):
            where, text = commas[0]
            raise ConfigError(
                f"{where}: '{text}' may be {text.replace(',', '.')} or {text.replace(',', '')}: if the comma "
                "stands before decimals, say so by 'decimal: \",\"' (--decimal ,)"
            )
        return ","

    def _value(self, text: str, place: int, where: str, blanks: bool, decimal: str) -> float:
        if blanks and _MISSING.fullmatch(text):
            return math.nan
        number = text
        if decimal != _POINT and _DECIMAL_COMMA.fullmatch(text):
            number = text.replace(",", ".")
        elif decimal != _POINT and "." in text:
            number = ""
        if _is_number(number) and math.isfinite(value := float(number)):
            return value
        column = f"'{self.names[place]}'" if self.named else self.names[place]
        hint = ""
        if self.named and text == self.names[place]:
            hint = "; the names of the columns stand here once more"
        elif _MISSING.fullmatch(text):
            hint = SPLIT
        elif decimal == _POINT and _DECIMAL_COMMA.fullmatch(text):
            hint = "; by 'decimal', numbers are written with a decimal point"
        elif decimal != _POINT and "." in text:
            hint = "; numbers are written with a decimal comma here"
        raise ConfigError(f"{where}: column {column}: must be a finite number (got '{text}'){hint}")


def _separator(lines: Sequence[str]) -> str:
    """What parts the values: in text with decimal commas, not what there is most of."""
    shown = [line for line in lines[: 2 * _LOOKED_AT] if line.strip()][:_LOOKED_AT]
    bare = [_QUOTED.sub("", line) for line in shown]
    if not bare:
        return _BLANK
    for separator in ";\t":
        if all(separator in line for line in bare):
            return separator
    rows = [line.split() for line in bare]
    numbers = [cell for row in rows[-1:] for cell in row]
    if len(numbers) > 1 and all(map(_is_number_of_any, numbers)) and any("," in cell for cell in numbers):
        return _BLANK
    separator = max(_SEPARATORS, key=bare[0].count)
    return separator if separator in bare[0] else _BLANK


def _is_number_of_any(text: str) -> bool:
    return _is_number(text) or _DECIMAL_COMMA.fullmatch(text) is not None


def _text(raw: bytes) -> str:
    # Spreadsheets begin their files with a mark that is no part of the first name. Their "Unicode text" is
    # UTF-16.
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raw = raw.decode("utf-16").encode()
    if _CONTROL.search(raw):
        raise NotText
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        # Older programs write in the letters of Western Europe.
        return raw.decode("cp1252")


def _seconds(times: Sequence[tuple[str, str]]) -> dict[str, float]:
    """Seconds since the first date, by where each stands; empty if the times are no dates."""
    start = next((date for _, text in times if (date := _date(text))), None)
    seconds = {}
    for where, text in times:
        date = _date(text)
        if date is None and ((start and not _MISSING.fullmatch(text)) or _OTHER_DATE.match(text)):
            raise ConfigError(f"{where}: the times must be numbers, or {_DATES} (got '{text}')")
        if start and date:
            if (date.tzinfo is None) != (start.tzinfo is None):
                raise ConfigError(f"{where}: all times must have an offset from UTC, or none (got '{text}')")
            seconds[where] = (date - start).total_seconds()
    return seconds


def _date(text: str) -> datetime | None:
    """A date as ISO 8601 or, with points, the day first; None if it is none, or a number."""
    if _is_number_of_any(text):
        return None
    if day_first := _DAY_FIRST.fullmatch(text):
        day, month, year, hour, rest = day_first.groups()
        text = f"{year}-{month:0>2}-{day:0>2}" + (f"T{hour:0>2}{rest}" if hour else "")
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None


def _rows(lines: Sequence[str], separator: str) -> Iterator[tuple[int, list[str]]]:
    """The cells of each line that holds any, with its number from 1."""
    if separator == _BLANK and not any('"' in line for line in lines):
        yield from ((number, line.split()) for number, line in enumerate(lines, 1) if line.strip())
        return
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    for row in reader:
        cells = [cell.strip() for cell in row]
        if separator == _BLANK:
            cells = [cell for cell in cells if cell]
        if len(cells) > 1 or any(cells):
            yield reader.line_num, cells


def _full(cells: list[str]) -> list[str]:
    """The cells without empty ones at the end."""
    while cells and not cells[-1]:
        cells = cells[:-1]
    return cells


def _is_number(text: str) -> bool:
    # Python's own reading takes the underscores of its source code.
    if "_" in text:
        return False
    try:
        float(text)
    except ValueError:
        return False
    return True
