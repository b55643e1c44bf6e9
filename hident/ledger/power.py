"""The power of printed numbers: which alternatives they exclude, and which of them a table rejects.

``numbers.csv`` holds, for each printed number and each alternative that changes what stands beside it,
whether it would differ there; where several of ours stand beside one number, for each of them.
``mutations.csv`` holds, for each table and alternative, the p-value of the joint test and whether the table
rejects it: the share of those is the table's mutation score.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from hident.config.spec import canonical
from hident.engine.experiment import Plan
from hident.engine.run_files import MUTATIONS, NUMBERS, RUN
from hident.engine.trial import digest
from hident.errors import ConfigError
from hident.ledger.published import CASE, Place

_NUMBERS = ("table", "row", "quantity", "printed", "alternative", "verdict")
_MUTATIONS = ("table", "alternative", "numbers", "excluding", "joint_p", "verdict")
FEWEST = 40
"""Trials of an alternative, below which no number by itself has a p-value under 5 %."""
_EXCLUDED = {True: "excluded", False: "fits"}
_REJECTED = {True: "rejected", False: "survives"}


@dataclass(frozen=True)
class Mutation:
    """What a table makes of an alternative: of its ``numbers``, so many are ``excluding`` it."""

    table: str
    alternative: str
    numbers: int
    excluding: int
    joint_p: float
    rejected: bool


@dataclass(frozen=True)
class NumberPower:
    """A printed number, and for each alternative that changes what stands beside it whether it differs."""

    printed: str
    excluded: Mapping[str, bool]


@dataclass(frozen=True)
class VerdictPower:
    """Of one configuration: what each printed number excludes, and what each table rejects."""

    numbers: Mapping[Place, NumberPower]
    mutations: tuple[Mutation, ...]

    def of_table(self, table: str) -> list[Mutation]:
        """What a table makes of each alternative that it is tried on."""
        return [one for one in self.mutations if one.table == table]

    def score(self, table: str) -> tuple[int, int]:
        """How many alternatives a table rejects, and how many it is tried on."""
        found = self.of_table(table)
        return sum(one.rejected for one in found), len(found)

    def files(self) -> dict[str, str]:
        """The texts of its files by their names."""
        cases = [CASE] * any(case for *_, case in self.numbers)
        numbers = (
            (*key, number.printed, name, _EXCLUDED[excluded], *[case] * len(cases))
            for (*key, case), number in self.numbers.items()
            for name, excluded in number.excluded.items()
        )
        mutations = (
            (*(getattr(one, name) for name in _MUTATIONS[:-1]), _REJECTED[one.rejected])
            for one in self.mutations
        )
        return {NUMBERS: _text((*_NUMBERS, *cases), numbers), MUTATIONS: _text(_MUTATIONS, mutations)}

    @classmethod
    def decoded(cls, numbers: bytes, mutations: bytes) -> VerdictPower:
        """What :meth:`files` gave; ValueError if the bytes are no such files."""
        found: dict[Place, tuple[str, dict[str, bool]]] = {}
        for table, row, quantity, printed, name, word, *case in _rows(numbers, _NUMBERS, CASE):
            _, excluded = found.setdefault((table, row, quantity, "".join(case)), (printed, {}))
            excluded[name] = _known(_EXCLUDED, word)
        tables = [
            Mutation(table, name, int(count), int(excluding), float(p), _known(_REJECTED, word))
            for table, name, count, excluding, p, word in _rows(mutations, _MUTATIONS)
        ]
        return cls({key: NumberPower(*number) for key, number in found.items()}, tuple(tables))


def power_of(plan: Plan) -> VerdictPower | None:
    """The accepted power of a plan; None if there is none, or it is of another configuration.

    ConfigError if its files cannot be read.
    """
    if plan.paper is None or not plan.experiment.alternatives:
        return None
    numbers, mutations = plan.power_file(NUMBERS), plan.power_file(MUTATIONS)
    if numbers is None or mutations is None or not is_of(plan.power_file(RUN), canonical(plan.experiment)):
        return None
    try:
        return VerdictPower.decoded(numbers, mutations)
    except ValueError as error:
        raise ConfigError(
            f"{plan.name}: the accepted results of its alternatives cannot be read ({error}): hident power "
            f"{plan.name}, and hident accept --power {plan.name}"
        ) from None


def is_of(run: bytes | None, resolved: Any) -> bool:
    """Whether the run.json beside the files of alternatives is that of this configuration."""
    try:
        match json.loads(run or b""):
            case {"experiment": {"hash": known}}:
                return bool(known == without_reports(resolved))
    except (ValueError, RecursionError):
        pass
    return False


def without_reports(resolved: Any) -> str:
    """A hash of all of an experiment that its alternatives and verdicts depend on, as run.json holds it."""
    reports = ("title", "tables", "figures", "formats", "trials")
    return digest({k: v for k, v in canonical(resolved).items() if k not in reports})


def _text(header: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()


def _rows(data: bytes, columns: tuple[str, ...], may: str = "") -> Iterator[list[str]]:
    """The rows of a file of these columns, behind which one more may stand."""
    header, *rows = csv.reader(io.StringIO(data.decode(), newline=""), strict=True)
    known = tuple(header) == columns or (may and tuple(header) == (*columns, may))
    if not known or any(len(row) != len(header) for row in rows):
        raise ValueError(f"the columns must be {','.join(columns)}")
    yield from rows


def _known(words: Mapping[bool, str], word: str) -> bool:
    for value, known in words.items():
        if word == known:
            return value
    raise ValueError(f"'{word}' is none of {', '.join(words.values())}")
