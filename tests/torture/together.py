"""Several runs at once, and clocks that go backwards."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path

from tests.torture.victim import Lost, Tally, Victim, new_victim

COUNT = 10
_TRIALS, _SECONDS = 60, 0.002
_TIMES = {"1970": 0.0, "2038": 2.0**31, "2500": 1.67e10, "a day ahead": time.time() + 86400}


def torture(tally: Tally, rng: random.Random, count: int) -> None:
    """Start two and five runs at once ``count`` times; set the clock between halves of a run as often."""
    with new_victim(_TRIALS) as victim:
        for i in range(count):
            for runs in (2, 5):
                with tally.fault(f"{runs} runs at once on one store, waiting", i):
                    _at_once(victim, [("--wait", "86400")] * runs)
                with tally.fault(f"{runs} runs at once on one store", i):
                    _at_once(victim, [()] * runs)
            with tally.fault("2 runs at once into one folder", i):
                _at_once(victim, [("--store", ".hident"), ("--store", "other")])
            word = sorted(_TIMES)[i % len(_TIMES)]
            with tally.fault("files from another time", word):
                _other_time(victim, _TIMES[word], rng)


def _at_once(victim: Victim, options: list[tuple[str, ...]]) -> None:
    victim.forget()
    started = [
        victim.started_run("--jobs", str(1 + i % 2), *option, seconds=_SECONDS, log=f"log{i}.txt")
        for i, option in enumerate(options)
    ]
    codes = [process.wait() for process in started]
    said = "\n".join((victim.folder / f"log{i}.txt").read_text() for i in range(len(options)))
    assert "Traceback" not in said, said
    waits = any(options)
    assert 0 in codes, (codes, said)
    assert set(codes) <= ({0} if waits else {0, 75}), (codes, said)
    assert victim.outputs() == victim.truth, "other outputs than those of an undisturbed run"
    stores = len(set(options)) if waits else 1
    if (made := victim.fits()) > stores * victim.units:
        raise Lost(f"{made} trials were computed for {stores} stores of {victim.units}")
    victim.check_ending()


def _other_time(victim: Victim, when: float, rng: random.Random) -> None:
    """All files of half a run are from another time, as if the clock had been set."""
    victim.forget()
    process = victim.started_run("--jobs", "1", seconds=_SECONDS)
    time.sleep(rng.uniform(0.1, 0.5))
    os.kill(process.pid, signal.SIGINT)
    process.wait()
    stored = victim.stored()
    _set_times(victim, when)
    if (made := victim.check_ending()) > victim.units - stored:
        raise Lost(f"{stored} of {victim.units} were stored, and {made} computed after that")
    _set_times(victim, when)
    assert "is up to date" in victim.run()


def _set_times(victim: Victim, when: float) -> None:
    paths: list[Path] = [victim.folder / "tiny.yaml", victim.folder / "probe.py"]
    paths += [*(victim.folder / ".hident").rglob("*"), *(victim.folder / "out").rglob("*")]
    for path in paths:
        os.utime(path, (when, when))
