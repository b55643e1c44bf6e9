"""What is tortured, a small experiment in a folder of its own, and the tally of faults."""

from __future__ import annotations

import os
import re
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from tests.conftest import Lab
from tests.forked import Forked

# Each fit leaves a byte in the file `fits`. Some trials fail.
_BODY = """
with open(os.path.join(os.path.dirname(__file__), "fits"), "ab") as file:
    file.write(b".")
time.sleep(float(os.environ.get("SECONDS", 0)))
if record.u[0] > 5:
    raise EstimationError(f"the input begins at {record.u[0]:.1f}")
"""
_PROBES = 2
_CASES = (50, 80)


class Lost(AssertionError):
    """Something that was computed is gone."""


class Tally:
    """How often each kind of fault was tried, and how it went."""

    HEAD = ("fault", "tried", "recovered", "lost", "wrong")

    def __init__(self) -> None:
        self.counts: dict[str, Counter[str]] = {}
        self.notes: list[str] = []

    @contextmanager
    def fault(self, kind: str, details: object) -> Iterator[None]:
        """Count what happens inside: an assertion that fails is wrong, and told with the details."""
        counts = self.counts.setdefault(kind, Counter())
        counts["tried"] += 1
        try:
            yield
        except AssertionError as error:
            word = "lost" if isinstance(error, Lost) else "wrong"
            counts[word] += 1
            print(f"{word}: {kind}, {details}: {str(error)[:2000]}", file=sys.stderr, flush=True)
        else:
            counts["recovered"] += 1

    @property
    def sound(self) -> bool:
        return not any(counts["lost"] or counts["wrong"] for counts in self.counts.values())

    def table(self) -> str:
        rows = [
            (kind, *(str(counts[word]) for word in self.HEAD[1:])) for kind, counts in self.counts.items()
        ]
        lines = [self.HEAD, ("---", *["---:"] * 4), *rows]
        return "\n".join([*(f"| {' | '.join(line)} |" for line in lines), "", *self.notes])


class Victim(Lab):
    """The experiment ``tiny``, with two probes in two cases; ``truth`` holds its undisturbed outputs."""

    truth: dict[str, bytes]
    fresh_workers = True
    """Whether the process that forks the workers of a run is started anew."""
    said = ""
    """What the run of the last :meth:`check_ending` said."""

    def __init__(self, folder: Path, trials: int, body: str = "") -> None:
        super().__init__(folder.resolve())
        self.trials_wanted = trials
        self.sockets = folder / "tmp"
        self.sockets.mkdir(parents=True, exist_ok=True)
        self.probe(f"{body}\n{_BODY}")
        plugin = self.folder / "probe.py"
        # Of equal estimators the scores are stored once.
        plugin.write_text(plugin.read_text().replace('"""A probe."""', "place: int"))
        self.configure(
            trials=trials,
            seed=11,
            estimators={f"probe {i}": {"kind": "probe", "place": i} for i in range(_PROBES)},
            cases={"samples": [*_CASES]},
        )

    @property
    def units(self) -> int:
        """How many trials of units there are in all, each one fit."""
        return _PROBES * len(_CASES) * self.trials_wanted

    def started_run(self, *arguments: str, seconds: float = 0.0, **options: Any) -> Forked:
        """A run on its way, each fit of which takes so long.

        Its sockets are put where those that are left can be seen.
        """
        options |= {"env": {**os.environ, "SECONDS": str(seconds)}, "fresh_workers": self.fresh_workers}
        before = options.pop("preexec_fn", lambda: None)

        def prepare() -> None:
            tempfile.tempdir = str(self.sockets)
            before()

        return self.start("run", "tiny.yaml", *arguments, preexec_fn=prepare, **options)

    def undisturbed(self) -> None:
        """Run it to the end, and keep what it gives."""
        self.run("-q")
        self.truth = self.outputs()
        assert b"failed" in self.truth["table.csv"].splitlines()[0]
        self.forget()

    def outputs(self) -> dict[str, bytes]:
        """The files whose every byte is decided by the experiment."""
        folder = self.folder / "out/tiny"
        assert folder.is_dir(), f"no outputs: {self.log[-2000:]}"
        return {name: (folder / name).read_bytes() for name in ("table.csv", "table.md", "trials.csv.xz")}

    def stored(self) -> int:
        """How many trials `status` says are stored."""
        said = self.hident("status", "tiny.yaml").stdout
        return int(said.splitlines()[1].split()[1])

    def fits(self) -> int:
        """How many fits were made since the last :meth:`forget`, or since it was asked."""
        path = self.folder / "fits"
        found = path.stat().st_size if path.exists() else 0
        path.unlink(missing_ok=True)
        return found

    def forget(self) -> None:
        super().forget()
        self.fits()

    def check_ending(self, *arguments: str, damaged: bool = False) -> int:
        """One more run ends with the undisturbed outputs and leaves nothing else; returns its fits."""
        before = self.fits()
        self.said = self.run("-q", *arguments)
        assert self.outputs() == self.truth, "other outputs than those of an undisturbed run"
        self.check_left(damaged=damaged)
        made = self.fits()
        assert made <= self.units, f"{made} fits for {self.units} trials ({before} before)"
        return made

    def check_left(self, *, damaged: bool = False) -> None:
        """Neither processes nor files are left that were not meant to stay."""
        self.await_alone()
        left = [path.name for path in self.sockets.iterdir()]
        left += [path.name for path in (self.folder / "out").rglob("*") if path.name.startswith(".")]
        for path in (self.folder / ".hident").iterdir():
            kept = damaged and re.fullmatch(r"trials\.sqlite.*\.damaged-\d+.*", path.name)
            if path.name not in ("trials.sqlite", "lock") and not kept:
                left.append(path.name)
        assert not left, f"left behind: {left}"

    def processes(self) -> list[int]:
        return self._processes()


@cache
def _undisturbed(trials: int, body: str) -> dict[str, bytes]:
    with tempfile.TemporaryDirectory(dir="/tmp", prefix="t") as name:
        victim = Victim(Path(name), trials, body=body)
        victim.undisturbed()
    return victim.truth


@contextmanager
def new_victim(trials: int, body: str = "", truth_body: str = "") -> Iterator[Victim]:
    """A victim in a temporary folder, with a short name as sockets need."""
    with tempfile.TemporaryDirectory(dir="/tmp", prefix="t") as name:
        victim = Victim(Path(name), trials, body)
        victim.truth = _undisturbed(trials, truth_body)
        try:
            yield victim
        finally:
            victim.end()


def filled_store(victim: Victim) -> Callable[[], None]:
    """Fill the store, and return what puts it back as it was, with the outputs gone."""
    victim.run("-q")
    kept = victim.folder / "kept"
    shutil.copytree(victim.store.parent, kept)

    def restore() -> None:
        victim.forget()
        shutil.copytree(kept, victim.store.parent)

    return restore
