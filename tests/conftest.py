"""A laboratory: a folder with a tiny experiment, a plugin, and the program as a user starts it."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, settings

from hident.engine.blocks import Block
from hident.engine.scores import SECONDS
from hident.engine.work import pin_blas
from tests.forked import GUARD_SECONDS, Forked, run_forked

# As in a run. On matrices of a few rows, BLAS's threads take several times the processor time of one.
pin_blas()

# In the background of a script SIGINT is ignored, under nohup SIGHUP, and so they would be in all that is
# started here.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

# The same examples everywhere, however slow the machine.
settings.register_profile(
    "suite",
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("suite")

HOLD = """
if len(record) == 80:
    Path("reached").touch()
    while Path("hold").exists():
        time.sleep(0.005)
"""
"""For a probe: the cases with 80 samples wait for as long as the file `hold` is there."""

TINY: dict[str, Any] = {
    "version": 1,
    "title": "Tiny",
    "seed": 7,
    "trials": 6,
    "system": {
        "kind": "hammerstein",
        "nonlinearity": "mzyk2009",
        "linear": {"kind": "ar", "a": [0.8]},
    },
    "excitation": {"kind": "iid", "distribution": "uniform", "low": -6, "high": 6},
    "noise": {"kind": "white", "distribution": "uniform", "half_width": 0.1},
    "cases": {"samples": [50, 80]},
    "estimators": {
        "known": {"kind": "known_dynamics", "a": [0.8]},
        "iv": {"kind": "instrumental_variables", "order": 1, "instrument": "abs"},
    },
    "metrics": {"a": {"kind": "error", "of": ["a_1"]}},
    "tables": {
        "a": {
            "kind": "grid",
            "title": "Error of a_1",
            "rows": "samples",
            "columns": [{"estimator": "iv", "metric": "a a_1"}],
        }
    },
}

PROBE = '''
import os, sys, time
from pathlib import Path

import numpy as np

from hident.config.spec import component
from hident.errors import EstimationError
from hident.estimators.base import EstimatorSpec
from hident.records import Estimate, Truth
from hident.systems.base import SystemSpec


@component("system", "square")
class Square(SystemSpec):
    """A system that needs no library that is slow to import."""

    def simulate(self, u, dt=1.0):
        return u**2

    def truth(self):
        return Truth()


@component("estimator", "probe")
class Probe(EstimatorSpec):
    """A probe."""

    def names(self):
        return ["a_1"]

    def fit(self, record, rng):
        value = float(record.u.sum() + 1e3 * record.y.sum())
BODY
        return Estimate(values={"a_1": value})
'''


_PROGRAM = [sys.executable, "-m", "hident"]
_TRACEBACK = "Traceback (most recent call last)"


class Lab:
    """A working folder; ``config`` is what tiny.yaml holds."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.config = json.loads(json.dumps(TINY))
        self.started: list[Forked] = []

    def configure(self, name: str = "tiny", **changes: Any) -> None:
        self.config |= changes
        text = yaml.safe_dump(self.config, sort_keys=False)
        (self.folder / f"{name}.yaml").write_text(text, encoding="utf-8")

    def probe(self, body: str = "") -> None:
        """Write the plugin, with further lines in its ``fit``, and let it replace the second estimator."""
        text = PROBE.replace("BODY", textwrap.indent(textwrap.dedent(body).strip("\n"), " " * 8))
        (self.folder / "probe.py").write_text(text, encoding="utf-8")
        self.configure(
            system="square",
            estimators={"known": self.config["estimators"]["known"], "probe": "probe"},
            metrics={"a": {"kind": "value", "of": ["a_1"]}},
            tables={},
        )

    def _arguments(self, arguments: tuple[str, ...]) -> list[str]:
        plugin = ["--plugin", "probe.py"] if (self.folder / "probe.py").exists() else []
        takes = arguments[:1] and arguments[0] in ("run", "power", "status", "export", "validate", "accept")
        return [*arguments, *(plugin if takes else [])]

    def hident(
        self, *arguments: str, code: int | None = 0, fresh: bool = False, **options: Any
    ) -> subprocess.CompletedProcess[str]:
        """Run the program to its end, and check its exit code and that it shows no traceback.

        Python is started anew only where the start is the matter: with ``fresh``.
        """
        if fresh or not hasattr(os, "fork"):
            done = subprocess.run(
                [*_PROGRAM, *self._arguments(arguments)],
                cwd=self.folder,
                capture_output=True,
                text=True,
                timeout=GUARD_SECONDS,
                check=False,
                **options,
            )
        else:
            done = run_forked(self._arguments(arguments), self.folder, **options)
        assert code is None or done.returncode == code, (done.returncode, done.stdout, done.stderr)
        assert _TRACEBACK not in done.stdout + done.stderr
        return done

    def run(self, *arguments: str, code: int = 0, **options: Any) -> str:
        """``hident run tiny.yaml``, with one worker unless told otherwise; returns standard error."""
        jobs = () if "--jobs" in arguments else ("--jobs", "1")
        return self.hident("run", "tiny.yaml", *jobs, *arguments, code=code, **options).stderr

    def start(self, *arguments: str, log: str = "log.txt", **options: Any) -> Forked:
        """Start the program in a process group of its own, as a terminal does; it writes to a log."""
        with (self.folder / log).open("wb") as file:
            process = Forked(self._arguments(arguments), self.folder, file, file, **options)
        self.started.append(process)
        return process

    @property
    def log(self) -> str:
        return (self.folder / "log.txt").read_text(encoding="utf-8")

    @property
    def table(self) -> bytes:
        return (self.folder / "out/tiny/table.csv").read_bytes()

    @property
    def store(self) -> Path:
        return self.folder / ".hident/trials.sqlite"

    def trials(self) -> dict[tuple[str, str, int], bytes]:
        """All stored values by estimator, case and trial, to the last bit."""
        query = (
            "SELECT described, data FROM blocks JOIN units USING (key) WHERE key NOT GLOB ? "
            "ORDER BY key, first"
        )
        with closing(sqlite3.connect(self.store)) as connection:
            rows = connection.execute(query, (f"{SECONDS}*",))
            found = [(json.loads(text), Block.decoded(data)) for text, data in rows]
        return {
            (unit["estimator"], str(unit["case"]), trial): values.tobytes()
            for unit, block in found
            if block is not None
            for trial, values in zip(block.scores.trials.tolist(), block.scores.values, strict=True)
        }

    def forget(self) -> None:
        """Remove the stored trials and the outputs."""
        for name in (".hident", "out"):
            shutil.rmtree(self.folder / name, ignore_errors=True)

    def await_(self, condition: Callable[[], object]) -> None:
        """Wait until a condition holds."""
        end = time.monotonic() + GUARD_SECONDS
        while not condition():
            assert time.monotonic() < end, "waited in vain; the log says: " + self.log
            time.sleep(0.01)

    def await_alone(self) -> None:
        """Wait until no process works in the folder any more."""
        self.await_(lambda: not self._processes())

    def _processes(self) -> list[int]:
        found = []
        for entry in Path("/proc").glob("[0-9]*"):
            try:
                if (entry / "cwd").readlink() == self.folder:
                    found.append(int(entry.name))
            except OSError:
                continue
        return found

    def end(self) -> None:
        """End what a failed test left behind."""
        for process in self.started:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@pytest.fixture(scope="session")
def make_lab() -> Iterator[Callable[[Path], Lab]]:
    """Makes a laboratory in a folder, and ends its processes."""
    made: list[Lab] = []

    def make(folder: Path) -> Lab:
        laboratory = Lab(folder.resolve())
        laboratory.configure()
        made.append(laboratory)
        return laboratory

    yield make
    for laboratory in made:
        laboratory.end()


@pytest.fixture
def lab(make_lab: Callable[[Path], Lab], tmp_path: Path) -> Iterator[Lab]:
    """A folder of its own with tiny.yaml in it."""
    laboratory = make_lab(tmp_path)
    yield laboratory
    laboratory.end()
