"""A folder of results: the files of one run, and what ``run.json`` says of them."""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any, Literal

from hident.engine.fingerprint import libraries
from hident.engine.run_files import CRASHES, DEFAULT_FORMAT, FORMATS, RUN, TEX, Format, figure_formats
from hident.engine.trial import digest
from hident.errors import StoreError

State = Literal["none", "old", "altered", "incomplete", "up to date"]


@dataclass(frozen=True)
class RunFolder:
    """The folder of a run, such as out/<config>; it need not be there."""

    path: Path

    @property
    def finished(self) -> bool:
        """Whether a run wrote it to the end."""
        return (self.path / RUN).is_file()

    def run(self) -> dict[str, Any] | None:
        """The content of run.json; None if there is none, or it is broken."""
        try:
            run = json.loads((self.path / RUN).read_bytes())
        except (OSError, ValueError, RecursionError):
            return None
        return run if isinstance(run, dict) else None

    def files(self) -> tuple[str, ...]:
        """The names of the files that run.json lists; none if it lists anything else."""
        match self.run():
            case {"files": [*names]} if all(isinstance(name, str) for name in names):
                return tuple(names)
        return ()

    def undrawn(self) -> tuple[str, ...]:
        """The names of the files of the figures that could not be drawn."""
        match self.run():
            case {"undrawn": [*names]}:
                return tuple(map(str, names))
        return ()

    def formats(self) -> tuple[Format, ...]:
        """The formats of its figures, and tex if its tables are there for LaTeX."""
        match self.run():
            case {"formats": [*names]}:
                asked = tuple(name for name in FORMATS if name in names)
            case _:
                asked = (DEFAULT_FORMAT,)
        return (*figure_formats(asked), *(name for name in asked if name == TEX))

    def timed_out(self) -> int:
        """How many trials count as failed because the clock ended them."""
        match self.run():
            case {"timed_out": {"trials": int(trials)}}:
                return trials
        return 0

    def optional_files(self) -> tuple[str, ...]:
        """The names of the files without which the configuration is left out, from its folder."""
        match self.run():
            case {"experiment": {"optional_files": [*names]}}:
                return tuple(map(str, names))
        return ()

    @property
    def sealed(self) -> bool:
        """Whether run.json says that a run wrote it, by a key or by hashes."""
        provenance = (self.run() or {}).get("provenance")
        return isinstance(provenance, dict) and not {"key", "sha256"}.isdisjoint(provenance)

    def altered(self) -> list[str]:
        """The files that are not as they were written, by the hashes in run.json; one that is gone counts."""
        if not self.sealed:
            return []  # Not written by a run.
        run = self.run() or {}
        digests = run["provenance"].pop("sha256", None)
        if not isinstance(digests, dict):
            return [RUN]
        found = [] if digests.pop(RUN, None) == digest(run) else [RUN]
        return sorted(found + [name for name, known in digests.items() if self._digest(name) != known])

    def state(self, key: str) -> State:
        """Whether it holds, unaltered, what the run writes whose outputs have this key."""
        if not (self.path / RUN).exists():
            return "none"
        provenance = (self.run() or {}).get("provenance")
        if not isinstance(provenance, dict) or "key" not in provenance:
            return "altered"
        if provenance["key"] != key:
            return "old"
        if self.altered():
            return "altered"
        return "incomplete" if self.undrawn() or self.timed_out() else "up to date"

    def arithmetic(self) -> Any:
        """What decided the last bits: see :func:`arithmetic_of`; None without a run.json."""
        run = self.run()
        return None if run is None else arithmetic_of(run.get("provenance"))

    @contextmanager
    def renewed(self) -> Iterator[RunFolder]:
        """A new folder beside the files; once it is filled and sealed, its files take their place.

        Files that an earlier run listed and the new one does not are removed.

        StoreError if a file cannot be written or moved.
        """
        new = RunFolder(self.path / ".new")
        try:
            shutil.rmtree(new.path, ignore_errors=True)
            new.path.mkdir(parents=True)
            yield new
            files = new.files()
            for stale in {*self.files(), CRASHES} - {*files}:
                if Path(stale).name == stale:
                    (self.path / stale).unlink(missing_ok=True)
            for name in (*files, RUN):
                (new.path / name).replace(self.path / name)
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise StoreError(
                f"{error.filename2 or self.path} cannot be written ({reason}). All trials are kept: make "
                "room for the outputs, or name another folder with --out, and run again"
            ) from None
        finally:
            shutil.rmtree(new.path, ignore_errors=True)

    def seal(self, run: dict[str, Any]) -> None:
        """Write run.json, with the hashes of the files that it lists and of itself without the hashes."""
        of_run = {RUN: digest(run)}
        run["provenance"]["sha256"] = {**{name: self._digest(name) for name in run["files"]}, **of_run}
        self._write_run(run)

    def add(self, name: str, data: bytes) -> None:
        """Write one more file, and its hash into run.json, if that holds hashes."""
        (self.path / name).write_bytes(data)
        run = self.run()
        if run and "sha256" in run.get("provenance", {}):
            run["provenance"]["sha256"][name] = self._digest(name)
            self._write_run(run)

    def write_text(self, name: str, text: str) -> None:
        """Write a file of text."""
        # The text of an error may hold what is no letter, such as one half of a pair.
        path = self.path / name
        path.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")

    def keep_tracebacks(self, tracebacks: str) -> Path | None:
        """Write the tracebacks of crashes to a file; None if that is impossible."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self.write_text(CRASHES, tracebacks)
        except OSError:
            return None
        return self.path / CRASHES

    def _write_run(self, run: dict[str, Any]) -> None:
        self.write_text(RUN, json.dumps(run, indent=2, ensure_ascii=False) + "\n")

    def _digest(self, name: str) -> str | None:
        """SHA-256 of a file's bytes; None if there is none inside the folder."""
        path = PurePath(name)
        try:
            if path.is_absolute() or ".." in path.parts:
                return None
            # A part at a time: of a million trials a file has hundreds of megabytes.
            with (self.path / path).open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
        except (OSError, ValueError):
            return None


@contextmanager
def phase(seconds: dict[str, float], name: str) -> Iterator[None]:
    """Note how long a phase of a run takes, for run.json."""
    start = time.perf_counter()
    yield
    seconds[name] = round(time.perf_counter() - start, 3)


def arithmetic_of(provenance: Any) -> Any:
    """What decided the last bits of a run: the arithmetic in use and the versions of its libraries.

    Two runs with equal ones have made the same roundings.
    """
    provenance = provenance if isinstance(provenance, dict) else {}
    used, versions = provenance.get("arithmetic"), provenance.get("libraries")
    identity = used.get("identity") if isinstance(used, dict) else None
    versions = versions if isinstance(versions, dict) else {}
    return identity, {name: versions.get(name) for name in libraries()}
