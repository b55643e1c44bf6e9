"""The printed numbers of a paper, and the reasons for those that do not come out.

``experiments/<paper>/published.csv`` has the columns table, row, quantity, printed, note; ``printed`` keeps
the printed digits, after ``<`` or ``>`` where the paper prints a bound. ``reasons.yaml`` lists reasons, each
with the texts or patterns that it applies to.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator, ValidationError, field_validator, model_validator

from hident.config.expression import number
from hident.config.load import Problem, content_of, problems_of, read
from hident.config.spec import NonEmpty, Spec
from hident.config.suggest import did_you_mean
from hident.engine.experiment import Label, Plan, PublishedCells
from hident.engine.results import Results, Series
from hident.errors import ConfigError

_COLUMNS = ("table", "row", "quantity", "printed", "note")
_BOUNDS = ("<", ">")
PUBLISHED, REASONS = "published.csv", "reasons.yaml"
Key = tuple[str, str, str]
Place = tuple[str, str, str, str]
"""A printed number, and which of ours stands beside it; the last is empty where there is one."""
CASE = "case"
"""The column, behind the others, of which of ours it is; there where several stand beside one number."""


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
    def bound(self) -> str:
        """'<' or '>' if the paper prints a bound, such as "<5" for "below 5 %"; else empty."""
        return self.printed[:1] if self.printed[:1] in _BOUNDS else ""

    @property
    def _number(self) -> str:
        return self.printed.removeprefix(self.bound)

    @property
    def value(self) -> float:
        return float(self._number)

    @property
    def half_unit(self) -> float:
        """Half a unit of the last printed digit, by which rounding may have moved it; 0 for a bound."""
        if self.bound:
            return 0.0
        exponent = Decimal(self._number).as_tuple().exponent
        assert isinstance(exponent, int)
        return 0.5 * 10.0**exponent

    def lies_in(self, low: float, high: float) -> bool:
        """Whether it lies in the interval widened by its rounding."""
        return low - self.slack <= self.value <= high + self.slack

    @property
    def slack(self) -> float:
        """Half a unit of the last digit, and a bit for numbers exactly on a rounding boundary."""
        return self.half_unit * (1 + 1e-9)


def _as_list(written: object) -> object:
    return [written] if isinstance(written, str) else written


Patterns = Annotated[NonEmpty[str], BeforeValidator(_as_list)]
"""Texts or shell patterns, of which one must fit; one text stands for a list of it."""


def _in_words(written: str) -> str:
    # What says nothing would cover any difference without a remark.
    if not any(map(str.isalnum, written)):
        raise ValueError("must say why, in words")
    return written


class Misprint(Spec):
    """What the paper itself prints that shows a number of it to be wrong, whatever ours is: one of these."""

    formula: str | None = None
    """What a formula of the paper gives with the numbers of the paper, as an expression of numbers."""
    at_least: str | None = None
    """Another quantity of the same row that is printed, below which the number cannot lie."""

    @field_validator("formula")
    @classmethod
    def _gives_a_number(cls, formula: str | None) -> str | None:
        if formula is not None:
            number(formula)
        return formula

    @model_validator(mode="after")
    def _is_one(self) -> Misprint:
        if (self.formula is None) == (self.at_least is None):
            raise ValueError("must have either 'formula' or 'at_least'")
        return self

    def check(self, printed: Printed, numbers: Mapping[Key, Printed]) -> None:
        """ConfigError if the paper does not show that a number is misprinted."""
        where = f"{REASONS}: the misprint of {_spelled(printed.key)}: the printed {printed.printed}"
        if self.formula is not None:
            value = number(self.formula)
            if printed.bound or abs(value - printed.value) <= printed.slack:
                raise ConfigError(f"{where} is what {self.formula} = {value:g} gives")
            return
        key = (printed.table, printed.row, str(self.at_least))
        if key not in numbers:
            raise ConfigError(f"{where} is to lie below {_spelled(key)}, which is not in published.csv")
        least = numbers[key]
        if printed.bound or least.bound or printed.value + printed.slack >= least.value - least.slack:
            raise ConfigError(f"{where} is not below the printed {least.printed} of {least.quantity}")


class Reason(Spec):
    """Why printed numbers differ from ours; each field but ``reason`` is a shell pattern or several."""

    reason: Annotated[str, AfterValidator(_in_words)]
    """The reason, one or two sentences."""
    config: Patterns = ("*",)
    """Name of the configuration."""
    table: Patterns = ("*",)
    """The table."""
    row: Patterns = ("*",)
    """The row."""
    quantity: Patterns = ("*",)
    """The quantity."""
    misprint: Misprint | None = None
    """What of the paper itself shows that the printed digits are wrong; then no joint test holds them."""

    def covers(self, config: str, key: Key) -> bool:
        """Whether it speaks of this number of this configuration."""
        texts = zip((config, *key), (self.config, self.table, self.row, self.quantity), strict=True)
        return all(any(_fits(text, pattern) for pattern in patterns) for text, patterns in texts)

    def is_of(self, configs: Iterable[str]) -> bool:
        """Whether it speaks of one of these configurations."""
        return any(_fits(config, pattern) for config in configs for pattern in self.config)


def _fits(text: str, pattern: str) -> bool:
    # Square brackets and parentheses are common in names, so only * and ? are patterns.
    return fnmatchcase(text, pattern.replace("[", "[[]"))


Beside = tuple[PublishedCells, Series, Printed]


class _Reasons(Spec):
    reasons: tuple[Reason, ...] = ()
    """The reasons; the first that covers a number counts."""


def read_published(paper: Path, content: bytes | None = None) -> dict[Key, Printed]:
    """The printed numbers of a paper's folder, or of its file's content, by table, row and quantity.

    ConfigError if the file is missing, lacks a column, repeats a key or holds a number that is none.
    """
    path = paper / PUBLISHED
    content = content_of(path) if content is None else content
    if content is None:
        raise ConfigError(f"{path}: no such file")
    try:
        reader = csv.reader(io.StringIO(content.decode(), newline=""))
        header = tuple(next(reader, ()))
        rows = [(reader.line_num, cells) for cells in reader if cells]
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    if header != _COLUMNS:
        raise ConfigError(f"{path}:1: the columns must be {','.join(_COLUMNS)}")
    found: dict[Key, Printed] = {}
    for line, cells in rows:
        if len(cells) != len(_COLUMNS):
            raise ConfigError(f"{path}:{line}: has {len(cells)} cells, not {len(_COLUMNS)}")
        printed = Printed(*cells)
        try:
            number = printed.printed.removeprefix(printed.bound)
            finite = Decimal(number).is_finite() and math.isfinite(float(number)) and "_" not in number
        except (InvalidOperation, OverflowError):
            finite = False
        if not finite:
            raise ConfigError(f"{path}:{line}: '{printed.printed}' is not a number")
        if printed.key in found:
            raise ConfigError(f"{path}:{line}: {' / '.join(printed.key)} stands twice")
        found[printed.key] = printed
    return found


def printed_beside(
    cell: PublishedCells, quantity: str, labels: Mapping[str, Label], numbers: Mapping[Key, Printed]
) -> Printed:
    """The printed number of a cell's quantity at these labels of axes.

    ConfigError if there is none, with the nearest; if the cell names an axis that its estimator does not
    have.
    """

    def label(found: re.Match[str]) -> str:
        if found[1] not in labels:
            raise ConfigError(f"the axis '{found[1]}' does not touch the estimator '{cell.estimator}'")
        return str(labels[found[1]])

    row, written = (re.sub(r"{([^{}]*)}", label, text) for text in (cell.row, quantity))
    key = (cell.table, row, written)
    if key not in numbers:
        near = did_you_mean(_spelled(key), map(_spelled, numbers))
        raise ConfigError(f"published.csv has no number for {_spelled(key)}{near}")
    return numbers[key]


def beside_series(results: Results, cells: Iterable[PublishedCells]) -> Iterator[Beside]:
    """Each of our series with the cell of its correspondence and the printed number that it stands beside.

    ConfigError as of :func:`printed_beside`.
    """
    numbers = published_of(results.plan)
    every = ((cell, *pair) for cell in cells for pair in cell.pairs())
    for cell, quantity, metric in every:
        for series in results.select(cell.estimator, metric, cell.at):
            yield cell, series, printed_beside(cell, quantity, series.unit.labels, numbers)


def _spelled(key: Key) -> str:
    return " / ".join(key)


def cells_astray(plan: Plan, cells: Sequence[PublishedCells]) -> Iterator[tuple[int, str]]:
    """The cells, by their place, beside which no estimate or no printed number stands, and why.

    ConfigError if the paper's printed numbers cannot be read.
    """
    if plan.paper is None:
        return
    numbers = published_of(plan)
    every = ((i, cell, *pair) for i, cell in enumerate(cells) for pair in cell.pairs())
    for i, cell, quantity, metric in every:
        cases = [
            unit.labels
            for unit in plan.units
            if unit.name == cell.estimator and metric in unit.metric_labels and unit.is_at(cell.at)
        ]
        if not cases:
            yield i, f"no estimate of '{cell.estimator}' has the metric '{metric}' at these labels"
        try:
            for labels in cases:
                printed_beside(cell, quantity, labels, numbers)
        except ConfigError as error:
            yield i, str(error)


def check_published(plan: Plan) -> None:
    """Check the cells under ``published`` against the paper's printed numbers.

    ConfigError if the printed numbers cannot be read, or with one line for each cell that stands beside none.
    """
    published = plan.experiment.published
    if published is None:
        return
    astray = cells_astray(plan, published.cells)
    if problems := [Problem(("published", "cells", i), message) for i, message in astray]:
        raise plan.document.error(problems)


def read_reasons(paper: Path, content: bytes | None = None) -> tuple[Reason, ...]:
    """The reasons of a paper's folder, or of its file's content; none if there is no file.

    ConfigError if the file is not a list of reasons.
    """
    path = paper / REASONS
    if content is None and not path.exists():
        return ()
    document = read(path, content)
    try:
        return _Reasons.model_validate(document.data).reasons
    except ValidationError as error:
        raise document.error(problems_of(error)) from None


def published_of(plan: Plan) -> dict[Key, Printed]:
    """The printed numbers of a plan's paper, from the file as the plan knows it."""
    assert plan.paper is not None
    return read_published(plan.paper, plan.paper_file(PUBLISHED))


def misprints_of(plan: Plan) -> frozenset[Key]:
    """The printed numbers of a plan's paper that the paper itself shows to be misprinted.

    ConfigError if a reason says so and the paper does not.
    """
    reasons = [one for one in reasons_of(plan) if one.is_of([plan.name])]
    if not any(one.misprint for one in reasons):
        return frozenset()
    numbers = published_of(plan)
    found = set()
    for key, printed in numbers.items():
        first = next((one for one in reasons if one.covers(plan.name, key)), None)
        if first is not None and first.misprint is not None:
            first.misprint.check(printed, numbers)
            found.add(key)
    return frozenset(found)


def reasons_of(plan: Plan) -> tuple[Reason, ...]:
    """The reasons of a plan's paper, from the file as the plan knows it."""
    content = plan.paper_file(REASONS)
    return () if plan.paper is None or content is None else read_reasons(plan.paper, content)
