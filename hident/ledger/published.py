"""The printed numbers of a paper, and the reasons for those that do not come out.

``experiments/<paper>/published.csv`` has the columns table, row, quantity, printed, note; ``printed`` keeps
the printed digits. ``reasons.yaml`` lists reasons, each with the texts or patterns that it applies to.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from fnmatch import fnmatchcase
from pathlib import Path

from pydantic import ValidationError

from hident.config.load import problems_of, read
from hident.config.spec import Spec
from hident.errors import ConfigError

_COLUMNS = ("table", "row", "quantity", "printed", "note")
Key = tuple[str, str, str]


@dataclass(frozen=True)
class Printed:
    """One printed number; ``digits`` are its decimals."""

    table: str
    row: str
    quantity: str
    printed: str
    note: str

    @property
    def key(self) -> Key:
        return self.table, self.row, self.quantity

    @property
    def value(self) -> float:
        return float(self.printed)

    @property
    def half_unit(self) -> float:
        """Half a unit of the last printed digit: what rounding may have moved the number by."""
        exponent = Decimal(self.printed).as_tuple().exponent
        assert isinstance(exponent, int)
        return 0.5 * 10.0**exponent


class Reason(Spec):
    """Why printed numbers differ from ours; each field but ``reason`` may be a shell pattern."""

    reason: str
    """The reason, one or two sentences."""
    config: str = "*"
    """Name of the configuration."""
    table: str = "*"
    """The table."""
    row: str = "*"
    """The row."""
    quantity: str = "*"
    """The quantity."""

    def covers(self, config: str, key: Key) -> bool:
        """Whether it speaks of this number of this configuration."""
        texts = zip((config, *key), (self.config, self.table, self.row, self.quantity), strict=True)
        # Square brackets and parentheses are common in names, so only * and ? are patterns.
        return all(fnmatchcase(text, pattern.replace("[", "[[]")) for text, pattern in texts)


class _Reasons(Spec):
    reasons: tuple[Reason, ...] = ()
    """The reasons; the first that covers a number counts."""


def read_published(paper: Path) -> dict[Key, Printed]:
    """The printed numbers of a paper's folder, by table, row and quantity.

    Raises
    ------
    ConfigError
        If the file is missing, lacks a column, repeats a key or holds a number that is none.
    """
    path = paper / "published.csv"
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            if tuple(reader.fieldnames or ()) != _COLUMNS:
                raise ConfigError(f"{path}:1: the columns must be {','.join(_COLUMNS)}")
            rows = [(reader.line_num, Printed(**row)) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error, TypeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    found: dict[Key, Printed] = {}
    for line, printed in rows:
        try:
            finite = Decimal(printed.printed).is_finite()
        except InvalidOperation:
            finite = False
        if not finite:
            raise ConfigError(f"{path}:{line}: '{printed.printed}' is not a number")
        if printed.key in found:
            raise ConfigError(f"{path}:{line}: {' / '.join(printed.key)} stands twice")
        found[printed.key] = printed
    return found


def read_reasons(paper: Path) -> tuple[Reason, ...]:
    """The reasons of a paper's folder; none if there is no file.

    Raises
    ------
    ConfigError
        If the file is not a list of reasons.
    """
    path = paper / "reasons.yaml"
    if not path.exists():
        return ()
    document = read(path)
    try:
        return _Reasons.model_validate(document.data).reasons
    except ValidationError as error:
        raise document.error(problems_of(error)) from None
