"""Making the results of a run the accepted ones."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Literal

from hident.config.suggest import counted, one_of
from hident.engine.run_files import RUN, SENSITIVITY, TIMING, TRIALS
from hident.errors import ConfigError, NothingToCompare, StoreError
from hident.ledger.compare import compare
from hident.ledger.sensitivity import Sensitivity
from hident.ledger.trial_values import TrialValues
from hident.run_folder import RunFolder


@dataclass(frozen=True)
class Accepted:
    """What accepting a configuration changed; ``differences`` are those of ``compare``, at its tolerance."""

    config: str
    change: Literal["new", "changed", "unchanged"]
    differences: tuple[str, ...] = ()

    def __str__(self) -> str:
        count = len(self.differences)
        extent = f", {counted(count, 'difference')}" if count else ""
        return f"{self.config}: {self.change}{extent}"


def accept(
    ours: Path,
    results: Path,
    measure: Callable[[TrialValues], Sensitivity] | None = None,
    repetitions: int = 0,
) -> Accepted:
    """Make ``results/<config>`` a copy of ``ours``, the folder ``out/<config>`` of a finished run.

    Copied are ``run.json``, the files that it lists, and ``timing.csv`` if it is there: no comparison reads
    it. A kill at any moment leaves the old results, or the
    new ones, or, between two renames, the old ones as ``.<config>.old``, which the next call puts back first.

    Beside the copy stands ``sensitivity.csv``, which ``measure`` makes from the values of the trials with so
    many ``repetitions``, and whose hash joins those in ``run.json``. The one of the old results is kept
    where the trials' values and the repetitions are the same.

    NothingToCompare if ``ours`` has no ``run.json``. ConfigError if ``run.json`` is broken, or lists a file
    that is missing, lies elsewhere, or was altered. StoreError if a file cannot be read or written.
    """
    config = ours.resolve().name
    try:
        files = _files(ours, config)
        sensitivity = None
        if measure is not None and PurePath(TRIALS) in files:
            values = _values(ours, config)
            known = _known(results / config, values, repetitions)
            sensitivity = known or measure(values).encoded()
        results.mkdir(parents=True, exist_ok=True)
        return _replace(ours, files, results, config, sensitivity)
    except OSError as error:
        raise StoreError(f"{ours} cannot be accepted into {results}: {error}") from None


def _values(ours: Path, config: str) -> TrialValues:
    try:
        return TrialValues.decoded((ours / TRIALS).read_bytes())
    except ValueError as error:
        raise ConfigError(f"{ours / TRIALS} cannot be read ({error}): hident run {config}") from None


def _known(accepted: Path, values: TrialValues, repetitions: int) -> bytes | None:
    """The sensitivity of results with the same values, measured by as many repetitions."""
    try:
        data = (accepted / SENSITIVITY).read_bytes()
        counts = Sensitivity.decoded(data).counts
        same = (accepted / TRIALS).read_bytes() == values.encoded()
    except (OSError, ValueError):
        return None
    measured = {unit: count.perturbed for unit, count in counts.items()}
    wanted = dict.fromkeys(values.units, values.trials * repetitions)
    return data if same and measured == wanted and not RunFolder(accepted).altered() else None


def _files(ours: Path, config: str) -> set[PurePath]:
    """``run.json`` and the files that it lists, relative to the folder."""
    path, folder = ours / RUN, RunFolder(ours)
    if not folder.finished:
        raise NothingToCompare(f"{ours} holds no finished run: hident run {config}")
    if undrawn := folder.undrawn():
        names = one_of(undrawn)
        raise ConfigError(f"{ours} lacks {names}, which could not be drawn: hident run {config}")
    if count := folder.timed_out():
        trials = counted(count, "trial")
        raise ConfigError(
            f"{ours} lacks {trials}, which the trial timeout ended: hident run {config}, without it or with "
            "a longer one"
        )
    if not (listed := folder.files()):
        raise ConfigError(f"{path} does not list the files of a run: hident run {config}")
    files = {PurePath(name) for name in (RUN, *listed)}
    for name in sorted(files):
        if name.is_absolute() or ".." in name.parts:
            raise ConfigError(f"{path} lists {name}, which is not in its folder")
        if not (ours / name).is_file():
            raise ConfigError(f"{ours} lacks {name}, which its run.json lists: hident run {config}")
    if changed := folder.altered():
        verb = "was" if len(changed) == 1 else "were"
        raise ConfigError(f"{ours}: {one_of(changed)} {verb} altered since the run: hident run {config}")
    return files


def _replace(
    ours: Path, files: set[PurePath], results: Path, config: str, sensitivity: bytes | None
) -> Accepted:
    target, staged, old = (results / name for name in (config, f".{config}.new", f".{config}.old"))
    _tidy(target, staged, old)
    try:
        staged.mkdir()
        for name in files:
            copy = staged / name
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ours / name, copy)
        if (ours / TIMING).is_file():
            shutil.copyfile(ours / TIMING, staged / TIMING)
        if sensitivity is not None:
            RunFolder(staged).add(SENSITIVITY, sensitivity)
        accepted = _changes(staged, target, config)
        if target.exists():
            target.rename(old)
        staged.rename(target)
    finally:
        _tidy(target, staged, old)
    return accepted


def _tidy(target: Path, staged: Path, old: Path) -> None:
    """Put the old results back if the new ones did not arrive, and remove what is left over."""
    if old.exists() and not target.exists():
        old.rename(target)
    for folder in (staged, old):
        shutil.rmtree(folder, ignore_errors=True)


def _changes(staged: Path, target: Path, config: str) -> Accepted:
    try:
        differences = compare(staged, target).differences
    except NothingToCompare:
        return Accepted(config, "new")
    return Accepted(config, "changed" if differences else "unchanged", differences)
