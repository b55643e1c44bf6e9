"""Trials per second of one process, two and two Dask workers, and what a chunk costs besides its trials."""

from __future__ import annotations

import importlib.util
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from tests.benchmarks.startup import hident
from tests.benchmarks.timing import figure, interleaved, show

# A configuration of each paper, with the trials of a run of some seconds.
_RUNS = {
    "mzyk_table1": (["--set", "cases.samples=[3000]"], 2000),
    "wang_table1": ([], 2000),
    "chen_table2": ([], 10),
    "brouri_gains": ([], 60),
}
_ROUNDS = 3


def main() -> None:
    rows = []
    for config, (settings, trials) in _RUNS.items():
        ways: dict[str, Callable[[], object]] = {
            "1 process": partial(run, config, settings, trials, 1),
            "2 processes": partial(run, config, settings, trials, 2),
        }
        if importlib.util.find_spec("distributed"):
            ways["2 Dask workers"] = partial(run, config, settings, trials, 2, "--executor", "dask")
        taken = interleaved(ways, _ROUNDS)
        for way, seconds in taken.items():
            ratios = taken.ratios("1 process", way)
            if way != "1 process":
                figure(f"{config}, {trials} trials: {way} over 1", ratios, "1.7" if "proc" in way else "")
            rows.append(
                [config, str(trials), way, f"{seconds:.1f}", f"{trials / seconds:.0f}", f"{ratios[0]:.2f}"]
            )
    show(
        "hident run from an empty store, start-up and tables included",
        ("configuration", "trials", "by", "seconds", "trials/s", "speed-up"),
        rows,
        ("aim: 1.7 with 2 processes on 2 idle cores",),
    )


def run(config: str, settings: list[str], trials: int, jobs: int, *more: str) -> None:
    """Compute all trials, with an empty store."""
    with tempfile.TemporaryDirectory() as folder:
        hident(
            *("run", f"configs/{config}.yaml", "--quiet", "--set", "figures={}", *settings, *more),
            *("--trials", str(trials), "--jobs", str(jobs)),
            *("--out", str(Path(folder, "out")), "--store", str(Path(folder, "store"))),
        )
