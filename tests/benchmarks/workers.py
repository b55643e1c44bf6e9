"""Trials per second of one process, two and two Dask workers, and what a chunk costs besides its trials."""

from __future__ import annotations

import importlib.util
import statistics
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from hident import plugins
from hident.engine import chunks
from hident.engine.executors import named_executor
from hident.engine.experiment import load
from hident.engine.runner import Silent, run
from hident.engine.scores import Scores
from hident.engine.store import Store
from tests.benchmarks.startup import hident
from tests.benchmarks.timing import figure, interleaved, processor_seconds, show

# A configuration of each paper, with the trials of a run of some seconds.
_RUNS = {
    "mzyk_table1": (["cases.samples=[3000]"], 600),
    "wang_table1": ([], 1000),
    "chen_table2": ([], 4),
    "brouri_gains": ([], 20),
}
_ROUNDS = 3


def main() -> None:
    executors = ["processes"]
    if importlib.util.find_spec("distributed"):
        executors.append("dask")
    plugins.load()
    throughput(executors)
    handling(executors)
    figure("millions of numbers stored per second of the main process", [stored() for _ in range(_ROUNDS)])


def throughput(executors: list[str]) -> None:
    """Trials per second of whole commands."""
    rows = []
    for config, (settings, trials) in _RUNS.items():
        ways: dict[str, Callable[[], object]] = {
            "1 process": partial(run_command, config, settings, trials, 1),
            "2 processes": partial(run_command, config, settings, trials, 2),
        }
        if "dask" in executors:
            ways["2 Dask workers"] = partial(run_command, config, settings, trials, 2, "--executor", "dask")
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


def run_command(config: str, settings: list[str], trials: int, jobs: int, *more: str) -> None:
    """Compute all trials, with an empty store."""
    with tempfile.TemporaryDirectory() as folder:
        hident(
            *("run", f"configs/{config}.yaml", "--quiet", *more),
            *(argument for one in ["figures={}", *settings] for argument in ("--set", one)),
            *("--trials", str(trials), "--jobs", str(jobs)),
            *("--out", str(Path(folder, "out")), "--store", str(Path(folder, "store"))),
        )


def handling(executors: list[str]) -> None:
    """What a chunk costs the process that gives it out and stores it: that much of each is not divided."""
    rows = []
    for config, (settings, trials) in _RUNS.items():
        for name in executors:
            taken = [of_chunk(config, settings, trials, name) for _ in range(_ROUNDS)]
            milliseconds = [1e3 * one for one, _ in taken]
            figure(f"{config}: milliseconds of the main process for a chunk, {name}", milliseconds)
            middle = statistics.median(milliseconds)
            most = 1e3 * chunks.SECONDS / middle
            rows.append([config, name, f"{taken[0][1]:.0f}", f"{middle:.1f}", f"{most:.0f}"])
    show(
        f"Processor time of the main process for a chunk of {chunks.SECONDS} s, and the workers it can serve",
        ("configuration", "executor", "trials of a chunk", "ms", "workers"),
        rows,
        ("Dask's scheduler is in that process here; one that stands alone takes its part of it away",),
    )


def of_chunk(config: str, settings: list[str], trials: int, name: str) -> tuple[float, float]:
    """Seconds of this process for a chunk by two workers, and how many trials that has."""
    plan = load(Path(f"configs/{config}.yaml"), [*settings, "figures={}"], {"trials": trials})
    with (
        tempfile.TemporaryDirectory() as folder,
        named_executor(name, None, 2, (), [plan]) as executor,
        Store(Path(folder)).writing() as store,
    ):
        # Let the workers have loaded everything.
        run(plan.changed(trials=4), executor=executor)
        counted = _Counted()
        taken = processor_seconds(lambda: run(plan, store=store, executor=executor, progress=counted))
        # To read what is stored, and to make the results of it, is not of the chunks.
        taken -= processor_seconds(lambda: run(plan, store=store, executor=executor))
    return taken / counted.chunks, trials * len(plan.units) / counted.chunks


def stored() -> float:
    """Millions of numbers that a second of this process stores, in chunks as a thousand workers give them."""
    count, trials, keys = 40, 5000, 6
    values = np.random.default_rng(1).random((trials, 1))

    def store_all() -> None:
        for i in range(count):
            scores = Scores(np.arange(i * trials, (i + 1) * trials), values)
            store.add({}, [(f"{key:064d}", scores) for key in range(keys)])

    with tempfile.TemporaryDirectory() as folder, Store(Path(folder)).writing() as store:
        return 1e-6 * count * trials * keys / processor_seconds(store_all)


class _Counted(Silent):
    chunks = 0

    def ends(self, work: str) -> None:
        self.chunks += 1
