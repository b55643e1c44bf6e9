"""Making the results of a run the accepted ones."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Literal

from hident.errors import ConfigError, NothingToCompare, StoreError
from hident.ledger.compare import compare


@dataclass(frozen=True)
class Accepted:
    """What accepting a configuration changed; ``differences`` are those of ``compare``, at its tolerance."""

    config: str
    change: Literal["new", "changed", "unchanged"]
    differences: tuple[str, ...] = ()

    def __str__(self) -> str:
        count = len(self.differences)
        extent = f", {count} difference{'s' * (count != 1)}" if count else ""
        return f"{self.config}: {self.change}{extent}"


def accept(ours: Path, results: Path) -> Accepted:
    """Make ``results/<config>`` an exact copy of ``ours``, the folder ``out/<config>`` of a finished run.

    Copied are ``run.json`` and the files that it lists. A kill at any moment leaves the old results, or the
    new ones, or, between two renames, the old ones as ``.<config>.old``, which the next call puts back first.

    Raises
    ------
    NothingToCompare
        If ``ours`` has no ``run.json``.
    ConfigError
        If ``run.json`` is broken or lists a file that is missing or lies elsewhere.
    StoreError
        If a file cannot be read or written.
    """
    config = ours.resolve().name
    try:
        files = _files(ours, config)
        results.mkdir(parents=True, exist_ok=True)
        return _replace(ours, files, results, config)
    except OSError as error:
        raise StoreError(f"{ours} cannot be accepted into {results}: {error}") from None


def _files(ours: Path, config: str) -> set[PurePath]:
    """``run.json`` and the files that it lists, relative to the folder."""
    path = ours / "run.json"
    if not path.is_file():
        raise NothingToCompare(f"{ours} holds no finished run: hident run {config}")
    try:
        run = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        run = None
    match run:
        case {"files": [*listed]} if all(isinstance(name, str) for name in listed):
            files = {PurePath(name) for name in ("run.json", *listed)}
        case _:
            raise ConfigError(f"{path} does not list the files of a run: hident run {config}")
    for name in sorted(files):
        if name.is_absolute() or ".." in name.parts:
            raise ConfigError(f"{path} lists {name}, which is not in its folder")
        if not (ours / name).is_file():
            raise ConfigError(f"{ours} lacks {name}, which its run.json lists: hident run {config}")
    return files


def _replace(ours: Path, files: set[PurePath], results: Path, config: str) -> Accepted:
    target, staged, old = (results / name for name in (config, f".{config}.new", f".{config}.old"))
    _tidy(target, staged, old)
    try:
        staged.mkdir()
        for name in files:
            copy = staged / name
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ours / name, copy)
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
