"""The comparison of two sets of results, trial by trial, and in both directions.

Trial i has the same data on every machine, so the values of two runs stand side by side
(:mod:`hident.ledger.trial_values`). Between equal arithmetics no value may differ. Between different ones a
last bit may send an estimate down another branch: of each unit as many trials may do so as the sensitivity
stored with the reference makes likely (:mod:`hident.ledger.sensitivity`), and all others are held to the
relative tolerance.

The cells of table.csv must be the statistics of the trials beside them. The other files are compared by their
contents (:mod:`hident.ledger.contents`), but those in a format that one side was not asked for; where some
trials took another branch and may, what these files differ in is listed and not counted. The numbers that a
figure draws, and its packed drawing, are compared between equal arithmetics, if both sides have those of any
figure; else its picture is. Every file must be what was written, by the hashes in its run.json.
Hidden files, ``*.tmp``, timing.csv, what `hident show` wrote of a trial, and the provenance in ``run.json``
do not count.
"""

from __future__ import annotations

from collections.abc import Iterator, Set
from dataclasses import dataclass
from pathlib import Path

from hident.config.suggest import counted, one_of
from hident.engine.results import STATISTICS
from hident.engine.run_files import (
    BENCHMARKS,
    POWER,
    RUN,
    SENSITIVITY,
    SHOWN,
    TABLE,
    TEX,
    TIMING,
    TRIALS,
    in_format,
    is_drawn,
    is_vector,
)
from hident.errors import ConfigError, NothingToCompare, StoreError
from hident.ledger.contents import Row, content_differences, decode_table
from hident.ledger.sensitivity import Sensitivity
from hident.ledger.trial_comparison import TrialComparison, follows
from hident.ledger.trial_values import Key, TrialValues
from hident.run_folder import RunFolder

CHANCE = 0.01
"""That a comparison of sound results finds, in any of its units, more moved trials than likely."""
# What run.json says of the number of trials.
_OF_TRIALS = (
    "experiment.trials ",
    "experiment.hash ",
    "experiment.resolved.trials",
    "experiment.sequential",
)


@dataclass(frozen=True)
class Comparison:
    """What a comparison found.

    ``differences`` has one readable text each, ``allowed`` what differs and may: units some trials of which
    took another branch, and the files that follow. ``compared`` is the number of result folders that both
    sides have, ``absent`` names the configurations that only the reference has; those among them whose
    optional records are not here stand in ``left_out`` instead, in words, and so do figures that the sides
    have in different formats only.
    """

    differences: tuple[str, ...]
    compared: int
    absent: tuple[str, ...]
    allowed: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()


_Said = tuple[str, bool]
"""What differs, and whether it counts as a difference."""


def compare(
    ours: Path, reference: Path, *, rtol: float = 1e-6, complete: bool = False, partial: bool = False
) -> Comparison:
    """Compare two result folders, or two folders of result folders.

    Parameters
    ----------
    ours, reference : Path
        A result folder holds ``run.json`` or ``table.csv``.
    rtol : float
        Relative tolerance of numbers; 0 asks for every bit. Below that of the stored sensitivity, none may
        differ between different arithmetics either.
    complete : bool
        Whether a configuration that only the reference has is a difference, unless its record is optional
        and not here.
    partial : bool
        Whether runs of different numbers of trials are compared on the trials that both have; then nothing
        is said of the files that show statistics.

    Raises
    ------
    NothingToCompare
        If one side does not exist or holds no results.
    ConfigError
        If one side is a result folder and the other a folder of them.
    StoreError
        If a folder cannot be listed.
    """
    try:
        mine = _results(ours, "hident run <config> makes them")
        theirs = _results(reference, "hident accept <config> makes run results the accepted ones")
        if ("." in mine) != ("." in theirs):
            one, many = (ours, reference) if "." in mine else (reference, ours)
            raise ConfigError(f"{one} is one result folder and {many} a folder of them: name two of a kind")
        return _compare(ours, reference, mine | theirs, rtol, complete, partial)
    except OSError as error:
        raise StoreError(f"{ours} and {reference} cannot be compared: {error}") from None


def _compare(
    ours: Path, reference: Path, names: Set[str], rtol: float, complete: bool, partial: bool
) -> Comparison:
    pairs = {
        name: _Pair(ours / name, reference / name, rtol, partial)
        for name in sorted(names)
        if _files(ours / name) and _files(reference / name)
    }
    # The chance is that of all units together.
    units = sum(len(pair.trials.units) for pair in pairs.values() if pair.trials)
    found: list[_Said] = []
    absent = []
    left_out = []
    for name in sorted(names):
        if name in pairs:
            found += pairs[name].judged(CHANCE / max(units, 1))
            left_out += pairs[name].left_out()
        elif not _files(reference / name):
            found.append((f"{name}: not accepted yet; hident accept {name}", True))
        elif lacking := _lacking(reference / name):
            left_out.append(f"{name}: {lacking}")
        else:
            absent.append(name)
            if complete:
                found.append((f"{name}: not run; hident run {name}", True))
    if "." not in names:
        others = {
            name for name in _files(ours) | _files(reference) if name.partition("/")[0] not in {*names, POWER}
        }
        found += [(line, True) for line in _lines(ours, reference, others, rtol)]
    differences, allowed = (tuple(line for line, counts in found if counts is of) for of in (True, False))
    return Comparison(differences, len(pairs), tuple(absent), allowed, tuple(left_out))


def _lacking(accepted: Path) -> str:
    """What is said of accepted results that cannot be had here; empty if they can.

    An optional record is looked for from the folder configs/ beside that of the results.
    """
    folder = accepted.resolve().parent.parent / "configs"
    absent = [name for name in RunFolder(accepted).optional_files() if not (folder / name).exists()]
    return f"its record is not here ({one_of(absent)})" if absent else ""


def _results(folder: Path, remedy: str) -> set[str]:
    """The names of the result folders in a folder; ``.`` alone if it is one."""
    if not folder.is_dir():
        raise NothingToCompare(f"there is no folder {folder}: {remedy}")
    if _is_result(folder):
        return {"."}
    names = {path.name for path in folder.iterdir() if not path.name.startswith(".") and _is_result(path)}
    if not names:
        raise NothingToCompare(f"{folder} holds no results: {remedy}")
    return names


def _is_result(folder: Path) -> bool:
    return any((folder / name).is_file() for name in (RUN, TABLE))


def _files(folder: Path) -> set[str]:
    """The files that count, as paths relative to the folder."""
    paths = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    found = {
        path.as_posix()
        for path in paths
        if path.suffix != ".tmp"
        and path.name != TIMING
        and not any(part.startswith((".", SHOWN)) for part in path.parts[:-1])
        and not path.name.startswith(".")
    }
    return found - {BENCHMARKS}


def _lines(ours: Path, reference: Path, names: Set[str], rtol: float) -> list[str]:
    """What the files of these names differ in, a line each with the name; one that is missing differs."""
    found: list[str] = []
    for name in sorted(names):
        mine, theirs = ours / name, reference / name
        if not mine.is_file():
            found.append(f"{name}: missing")
        elif not theirs.is_file():
            found.append(f"{name}: extra, the reference lacks it")
        else:
            found += [f"{name}: {line}" for line in content_differences(mine, theirs, rtol)]
    return found


class _Pair:
    """The results of one configuration on both sides; ``trials`` is None if a side has none to read."""

    def __init__(self, ours: Path, reference: Path, rtol: float, partial: bool) -> None:
        self._ours, self._reference, self._rtol, self._partial = ours, reference, rtol, partial
        used = [RunFolder(folder).arithmetic() for folder in (ours, reference)]
        self._same_arithmetic = None in used or used[0] == used[1]
        self.trials = self._compared_trials()
        self._names, self._apart = self._in_formats_of_both()

    def judged(self, chance: float) -> Iterator[_Said]:
        """What the configuration differs in; ``chance`` is that of more moved trials than likely."""
        title = self._reference.resolve().name
        yield from ((f"{title}{line}", counts) for line, counts in self._judged(chance))

    def _altered(self) -> Iterator[str]:
        """What was altered on either side, and a run.json that cannot say so though the other's can."""
        sides = ((RunFolder(self._ours), ""), (RunFolder(self._reference), "the reference "))
        sealed = any(folder.sealed for folder, _ in sides)
        for folder, whose in sides:
            was = "was " if whose else ""
            yield from (f"{name}: {whose}{was}altered since it was written" for name in folder.altered())
            if sealed and folder.finished and not folder.sealed:
                yield f"{RUN}: {whose}lacks provenance.key and provenance.sha256, which every run writes"

    def _judged(self, chance: float) -> Iterator[_Said]:
        yield from ((f"/{line}", True) for line in self._altered())
        names = self._names
        if (trials := self.trials) is None:
            yield from self._files_differ(names)
            return
        count, wanted = trials.ours.trials, trials.reference.trials
        if count != wanted and not self._partial:
            yield f": {counted(count, 'trial')}, reference {wanted}: --partial compares those of both", True
            return
        yield from ((f": {line}", True) for line in sorted(trials.unmatched()))
        moved = list(trials.moved(chance))
        yield from ((f": {unit.said}", not unit.allowed) for unit in moved)
        yield from ((f"/{line}", True) for line in self._table(trials))
        run = self._files_differ({RUN})
        if count != wanted:
            of_trials = tuple(f"/{RUN}: {path}" for path in _OF_TRIALS)
            yield from (said for said in run if not said[0].startswith(of_trials))
            return
        others = self._files_differ(names - {RUN, TABLE, TRIALS})
        if moved and others:
            # What follows from the trials is told by its name alone.
            follow = ", ".join(sorted({line.removeprefix("/").partition(": ")[0] for line, _ in others}))
            yield f": {follow}: as these trials give", not all(unit.allowed for unit in moved)
            others = []
        yield from (*run, *others)

    def left_out(self) -> list[str]:
        """What is not compared, in words."""
        title, figures = self._reference.resolve().name, one_of(self._apart)
        return [f"{title}: {figures}, in no format that both sides have"] if figures else []

    def _in_formats_of_both(self) -> tuple[set[str], list[str]]:
        """The files to compare, and the figures that the sides have in different formats only.

        What one side was not asked for is no difference.
        """
        sides = [(_files(folder), RunFolder(folder)) for folder in (self._ours, self._reference)]
        (mine, _), (theirs, _) = sides
        of_one = {
            name
            for (files, folder), (others, other) in (sides, sides[::-1])
            for name in files - others
            if name in folder.files() and in_format(name) not in (None, *other.formats())
        }
        names = (mine | theirs) - of_one - {SENSITIVITY}
        for is_one in (is_drawn, is_vector):
            if not (self._same_arithmetic and all(any(map(is_one, folder.files())) for _, folder in sides)):
                names -= {
                    name for files, folder in sides for name in files & {*folder.files()} if is_one(name)
                }
        drawn = {name.rpartition(".")[0] for name in names if in_format(name) not in (None, TEX)}
        figures = {name.rpartition(".")[0] for name in of_one if in_format(name) != TEX}
        return names, sorted(figures - drawn)

    def _compared_trials(self) -> TrialComparison | None:
        try:
            ours, reference = (
                TrialValues.decoded((folder / TRIALS).read_bytes())
                for folder in (self._ours, self._reference)
            )
        except (OSError, ValueError, EOFError):
            return None
        if ours.axes != reference.axes:
            return None
        same = self._same_arithmetic
        sensitivity = None if same else (_sensitivity(self._reference) or Sensitivity(reference.axes, {}))
        return TrialComparison(ours, reference, self._rtol, sensitivity)

    def _table(self, trials: TrialComparison) -> Iterator[str]:
        """What is wrong with table.csv: cells that are not those of the trials, rows that differ."""
        mine, wrong = _rows(self._ours, trials.ours)
        theirs, wrong_there = _rows(self._reference, trials.reference)
        yield from (f"{TABLE}: {line}" for line in wrong)
        yield from (f"{TABLE}: of the reference, {line}" for line in wrong_there)
        if trials.ours.trials != trials.reference.trials:
            return
        for series in trials.units.values():
            for key, compared in series.items():
                if key in mine and key in theirs and not compared.moved.any():
                    name = trials.reference.described_series(key)
                    lines = trials.rows(mine[key], theirs[key], key)
                    yield from (f"{TABLE}: {name}: {line}" for line in lines)

    def _files_differ(self, names: Set[str]) -> list[_Said]:
        return [(f"/{line}", True) for line in _lines(self._ours, self._reference, names, self._rtol)]


def _rows(folder: Path, values: TrialValues) -> tuple[dict[Key, Row], list[str]]:
    """The rows of table.csv by their series, and where they are not the statistics of the trials."""
    try:
        table = decode_table((folder / TABLE).read_bytes())
    except (OSError, ValueError) as error:
        return {}, [f"it cannot be read: {error}"]
    names = (*values.axes, "estimator", "metric")
    columns = {*names, *STATISTICS}
    if wrong := sorted(columns.symmetric_difference(table.columns)):
        return {}, [f"column {name} is {'missing' if name in columns else 'extra'}" for name in wrong]
    rows = {tuple(row[name] for name in names): row for row in table.rows}
    lines = [] if len(rows) == len(table.rows) else ["a row stands twice"]
    for key in sorted(values.series.keys() | rows.keys()):
        name = values.described_series(key)
        if key in rows and key in values.series:
            lines += [f"{name}: {line}" for line in follows(rows[key], values.series[key])]
        else:
            lines.append(f"{name}: {'its trials are' if key in rows else 'the row is'} missing")
    return rows, lines


def _sensitivity(folder: Path) -> Sensitivity | None:
    try:
        return Sensitivity.decoded((folder / SENSITIVITY).read_bytes())
    except (OSError, ValueError):
        return None
