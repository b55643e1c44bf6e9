"""Runs of very many trials: their memory, what a trial takes and stores, and a run that has nothing to do.

``python -m tests.benchmarks.many_trials 1000000`` measures as many as it is told to, beside a thousand.
Processor time is that of all processes of a run.
"""

from __future__ import annotations

import argparse
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import psutil  # comes with distributed

from hident import plugins
from hident.engine.experiment import load
from tests.benchmarks.timing import figure, show

_RUNS = {
    "mzyk_table1, N = 50": ("mzyk_table1", ["cases.samples=[50]", "figures={}"]),
    "wang_table1": ("wang_table1", []),
}
_FEW, _MANY = 1000, 100_000
_ROUNDS = 3
"""How often the few are measured, beside the start."""
_LOOK_SECONDS = 0.05
_MIB = 2**20


def main(sizes: Sequence[int] = (_MANY,)) -> None:
    plugins.load()
    for name, (config, settings) in _RUNS.items():
        measure(name, config, settings, sizes)


@dataclass(frozen=True)
class _Taken:
    """What a run took, in processor seconds and peak bytes."""

    seconds: float
    main: int
    worker: int
    """Of the largest."""


def measure(name: str, config: str, settings: list[str], sizes: Sequence[int]) -> None:
    """Show what runs of a configuration take, those of a thousand trials first."""
    numbers = sum(len(unit.metric_labels) for unit in load(Path(f"configs/{config}.yaml"), settings).units)
    # What the first trial of every case takes is of the start, as are the tables and figures.
    start = statistics.median(run(config, settings, 2)[0].seconds for _ in range(_ROUNDS))
    few = [(run(config, settings, _FEW)[0].seconds - start) / _FEW for _ in range(_ROUNDS)]
    rows = []
    for size in (_FEW, *sizes):
        taken, rerun, stored = run(config, settings, size)
        of_trial = statistics.median(few) if size == _FEW else (taken.seconds - start) / size
        over = [of_trial / one for one in few]
        of_numbers = stored / (8 * numbers * size)
        rows.append(
            [
                f"{size:.0e}",
                f"{1e3 * of_trial:.2f}",
                f"{statistics.median(over):.2f}",
                *(f"{peak / _MIB:.0f}" for peak in (taken.main, taken.worker)),
                f"{stored / size:.0f}",
                f"{of_numbers:.2f}",
                f"{rerun.seconds:.1f}",
            ]
        )
        if size != _FEW:
            of = f"{name}, {size:.0e} trials"
            figure(f"{of}: processor time of one over that of {_FEW:.0e}", over, "1.2")
            figure(f"{of}: peak MiB of the main process", [taken.main / _MIB])
            figure(f"{of}: peak MiB of a worker", [taken.worker / _MIB])
            figure(f"{of}: bytes stored over those of the numbers", [of_numbers], "2")
            figure(f"{of}: processor seconds of a run with nothing to do", [rerun.seconds], "3")
    show(
        f"{name}: many trials, {numbers} numbers each, by 2 processes",
        ("trials", "ms", "over few", "main MiB", "worker MiB", "bytes", "over numbers", "rerun s"),
        rows,
        (
            "ms: processor time for a trial, beyond the start. MiB: peak resident sets.",
            "bytes: of the store for a trial. rerun: processor seconds of a run with nothing to do.",
            "aims: 1.2 over few; 2 over the numbers; rerun 3 s; memory that does not grow with the trials",
        ),
    )


def run(config: str, settings: list[str], trials: int) -> tuple[_Taken, _Taken, int]:
    """What a run takes, what the same takes again, and the bytes of the store."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "hident", "run", f"configs/{config}.yaml", "--quiet", "--jobs", "2"]
        command += [word for one in settings for word in ("--set", one)]
        command += ["--trials", str(trials), "--store", folder, "--out", f"{folder}/out"]
        first, again = watched(command), watched(command)
        return first, again, Path(folder, "trials.sqlite").stat().st_size


def watched(command: list[str]) -> _Taken:
    """What a command takes, with all processes that it starts."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    seen = _Seen(psutil.Process(process.pid))
    while process.poll() is None:
        seen.look()
        time.sleep(_LOOK_SECONDS)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    return _Taken(sum(seen.seconds.values()), *seen.peaks)


@dataclass
class _Seen:
    """The processes of a run as they were when they were last seen."""

    main: psutil.Process
    seconds: dict[int, float] = field(default_factory=dict)
    _peaks: dict[int, int] = field(default_factory=dict)

    def look(self) -> None:
        """Look at all again."""
        try:
            for one in (self.main, *self.main.children(recursive=True)):
                self.seconds[one.pid] = sum(one.cpu_times()[:2])
                # Workers are forked by another process: what this one forks begins with its own peak.
                if one.ppid() == self.main.pid:
                    continue
                status = Path(f"/proc/{one.pid}/status").read_text(encoding="utf-8")
                if found := re.search(r"VmHWM:\s*(\d+) kB", status):
                    self._peaks[one.pid] = 1024 * int(found[1])
        except (psutil.Error, OSError):
            return

    @property
    def peaks(self) -> tuple[int, int]:
        """Peak bytes of the main process, and of the largest worker."""
        others = [peak for pid, peak in self._peaks.items() if pid != self.main.pid]
        return self._peaks[self.main.pid], max(others, default=0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.many_trials", description=__doc__)
    parser.add_argument("sizes", nargs="*", type=int, default=[_MANY], help="numbers of trials")
    main(parser.parse_args().sizes)
