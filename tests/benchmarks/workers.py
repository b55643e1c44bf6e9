"""Trials per second by workers that have loaded everything, and what a chunk costs besides its trials.

Speed-ups are ratios of wall time, as what two processes save is nothing else: they want idle cores. The
processor time of all processes, over that of the serial run, says what the workers do besides the same
trials, and what a chunk costs the main process is of its processor time: a busy machine moves these less.
"""

from __future__ import annotations

import itertools
import math
import statistics
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import psutil  # comes with distributed

from hident import plugins
from hident.engine import chunks
from hident.engine.executors import PoolExecutor, SerialExecutor, Workers, named_executor
from hident.engine.experiment import Plan, load
from hident.engine.runner import Silent, run
from hident.engine.scores import Scores
from hident.engine.store import Store
from tests.benchmarks.timing import figure, in_turns, processor_seconds, seconds, show

# A configuration of each paper.
_RUNS = {
    "mzyk_table1, N = 50": ("mzyk_table1", ["cases.samples=[50]"]),
    "wang_table1": ("wang_table1", []),
    "chen_table2": ("chen_table2", []),
    "brouri_gains": ("brouri_gains", []),
}
_SERIAL = "serial"
_WAYS: dict[str, Callable[[Plan], Workers]] = {
    _SERIAL: lambda plan: SerialExecutor(),
    "1 process": lambda plan: PoolExecutor(1, plan.plugin_files),
    "2 processes": lambda plan: PoolExecutor(2, plan.plugin_files),
    "2 Dask workers": lambda plan: named_executor("dask", None, 2, plan.plugin_files, [plan]),
}
_HANDLED = {"2 processes": "processes", "2 Dask workers": "dask"}
"""Those of which it is measured what a chunk costs, and how they are called there."""
_AIMS = {"2 processes": "1.7"}
_ROUNDS = 5
_SECONDS = 5.0
"""What a serial run is to take: so long that the end, where one of two workers waits, is little of it."""
_PILOT_SECONDS = 1.0


def main() -> None:
    plugins.load()
    handled = [row for name, (config, settings) in _RUNS.items() for row in measure(name, config, settings)]
    show(
        f"Processor time of the main process for a chunk of {chunks.SECONDS} s, and the workers it can serve",
        ("configuration", "executor", "trials of a chunk", "ms", "workers"),
        handled,
        ("Dask's scheduler is in that process here; one that stands alone takes its part of it away",),
    )
    figure("millions of numbers stored per second of the main process", [stored() for _ in range(_ROUNDS)])


@dataclass(frozen=True)
class _Taken:
    """What a run took."""

    seconds: float
    processor: float
    """Processor seconds of this process and of its workers."""
    chunk: float
    """Processor seconds of this process for a chunk that others compute."""
    trials: float
    """How many trials of a unit that has."""


def measure(name: str, config: str, settings: list[str]) -> list[list[str]]:
    """Show what the executors give for one configuration; return the rows of what chunks cost."""
    plan = piloted(load(Path(f"configs/{config}.yaml"), [*settings, "figures={}"]))
    # Each with seeds of its own that are the same as the others': in one round all compute the same trials.
    taken = in_turns(
        {way: partial(measured, plan, way, itertools.count(plan.seed + 1)) for way in _WAYS}, _ROUNDS
    )
    throughput(name, plan.trials, taken)
    return [handling(name, _HANDLED[way], taken[way]) for way in _HANDLED]


def piloted(plan: Plan) -> Plan:
    """The plan with as many trials as take some seconds here, an even number, for two workers."""
    # What the first run loads is not of its trials.
    run(plan.changed(trials=1))
    for trials in (4**power for power in itertools.count()):
        taken = processor_seconds(partial(run, plan.changed(trials=trials)))
        if taken > _PILOT_SECONDS:
            return plan.changed(trials=2 * math.ceil(_SECONDS * trials / taken / 2))
    raise AssertionError


def measured(plan: Plan, way: str, seeds: Iterator[int]) -> _Taken:
    """What the plan takes with the next seed.

    The workers are there for this run only: those that wait take processor time too, Dask's 15 % of a core.
    """
    with _WAYS[way](plan) as executor:
        # Let the workers have loaded everything.
        run(plan.changed(trials=max(4, plan.trials // 8)), executor=executor)
        plan = plan.changed(seed=next(seeds))
        before = processor_seconds_of_all()
        wall = seconds(lambda: run(plan, executor=executor))
        processor = processor_seconds_of_all() - before
        return _Taken(wall, processor, *(of_chunk(plan, executor) if way in _HANDLED else (0.0, 0.0)))


def processor_seconds_of_all() -> float:
    """Processor time so far of this process and of those that it has started and that live."""
    this = psutil.Process()
    return float(sum(sum(one.cpu_times()[:2]) for one in (this, *this.children(recursive=True))))


def of_chunk(plan: Plan, executor: Workers) -> tuple[float, float]:
    """Seconds of this process for a chunk, given out and stored, and how many trials that has."""
    with tempfile.TemporaryDirectory() as folder, Store(Path(folder)).writing() as store:
        counted = _Counted()
        taken = processor_seconds(lambda: run(plan, store=store, executor=executor, progress=counted))
        # To read what is stored, and to make the results of it, is not of the chunks.
        taken -= processor_seconds(lambda: run(plan, store=store, executor=executor))
    return taken / counted.chunks, plan.trials * len(plan.units) / counted.chunks


def throughput(name: str, trials: int, taken: dict[str, list[_Taken]]) -> None:
    """Trials per second, and what they are over those of the serial run of the same round."""
    rows = []
    for way, runs in taken.items():
        rates = [trials / one.seconds for one in runs]
        pairs = [*zip(taken[_SERIAL], runs, strict=True)]
        speed_ups = [serial.seconds / one.seconds for serial, one in pairs]
        processor = [one.processor / serial.processor for serial, one in pairs]
        figure(f"{name}: trials per second, {way}", rates)
        if way == _SERIAL:
            of_trial = [1e3 * one.processor / trials for one in runs]
            figure(f"{name}: milliseconds of processor time for a trial, {way}", of_trial)
        else:
            figure(f"{name}: speed-up by {way}", speed_ups, _AIMS.get(way, ""))
            figure(f"{name}: processor time by {way} over serial", processor)
        rows.append(
            [
                way,
                f"{statistics.median(one.seconds for one in runs):.1f}",
                f"{statistics.median(rates):.1f}",
                *(f"{of(speed_ups):.2f}" for of in (statistics.median, min, max)),
                f"{statistics.median(processor):.2f}",
            ]
        )
    show(
        f"{name}: {trials} trials by workers that have loaded everything",
        ("by", "seconds", "trials/s", "speed-up", "least", "greatest", "processor time"),
        rows,
        (
            "speed-up: by wall time, over the serial run of the same round.",
            "processor time: of all processes, over that of the serial run.",
            f"aim: {_AIMS['2 processes']} with 2 processes on 2 idle cores",
        ),
    )


def handling(name: str, executor: str, runs: list[_Taken]) -> list[str]:
    """What a chunk costs the process that gives it out and stores it: that much of each is not divided."""
    milliseconds = [1e3 * one.chunk for one in runs]
    figure(f"{name}: milliseconds of the main process for a chunk, {executor}", milliseconds)
    middle = statistics.median(milliseconds)
    most = 1e3 * chunks.SECONDS / middle
    return [name, executor, f"{runs[0].trials:.0f}", f"{middle:.1f}", f"{most:.0f}"]


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
