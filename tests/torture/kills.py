"""Kills and signals at random moments: nothing that was stored is computed again, nothing else is left."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path

from tests.forked import Forked
from tests.torture.victim import Lost, Tally, Victim, new_victim

COUNT = 100
_TRIALS, _SECONDS = 100, 0.008
# At most, as a chunk is a quarter of a second; of each worker one is computed and one waits to be stored.
_CHUNK = int(0.25 / _SECONDS)
_IN_FLIGHT = 2 * 2 * _CHUNK


def torture(tally: Tally, rng: random.Random, count: int) -> None:
    """Interrupt ``count`` runs by SIGKILL, and a tenth as many by each other way."""
    few = max(1, count // 10)
    ways = [(name, signal.SIGKILL) for name in ("main process", "worker")] * ((count + 1) // 2)
    ways += [(name, number) for name, number in _SIGNALS for _ in range(few)]
    with new_victim(_TRIALS) as victim:
        whole = _undisturbed_seconds(victim)
        for target, number in ways:
            victim.forget()
            moment, jobs = rng.uniform(0, whole), rng.choice(("1", "2"))
            if target == "worker":
                jobs = "2"
            with tally.fault(f"{number.name} to {target}", f"after {moment:.3f} s, {jobs} jobs"):
                _one(victim, target, number, moment, jobs, rng)


_SIGNALS = [
    ("process group", signal.SIGINT),
    ("process group twice", signal.SIGINT),
    ("main process", signal.SIGTERM),
    ("process group", signal.SIGTERM),
    ("process group", signal.SIGHUP),
    ("process group, then SIGCONT", signal.SIGSTOP),
]


def _undisturbed_seconds(victim: Victim) -> float:
    start = time.monotonic()
    victim.started_run("--jobs", "2", seconds=_SECONDS).wait()
    return time.monotonic() - start


def _one(
    victim: Victim, target: str, number: signal.Signals, moment: float, jobs: str, rng: random.Random
) -> None:
    process = victim.started_run("--jobs", jobs, seconds=_SECONDS)
    time.sleep(moment)
    _send(victim, process, target, number, rng)
    code = process.wait()
    victim.await_alone()
    assert "Traceback" not in victim.log, victim.log
    # Python's own, of a process that outlives the run to clean up after it.
    assert "Warning" not in victim.log.replace("UserWarning: resource_tracker", ""), victim.log
    assert code in _codes(target, number), f"exit code {code}: {victim.log}"
    computed, stored = victim.fits(), victim.stored()
    lost = computed - stored
    if (code == 0 and target != "worker") or (number in (signal.SIGTERM, signal.SIGHUP) and jobs == "2"):
        allowed = 0
    else:
        allowed = _CHUNK if jobs == "1" else _IN_FLIGHT
    if lost > allowed:
        raise Lost(f"{computed} trials were computed and {stored} stored")
    again = victim.check_ending()
    if again > victim.units - stored:
        raise Lost(f"{stored} of {victim.units} were stored, and {again} computed after that")


def _codes(target: str, number: signal.Signals) -> tuple[int, ...]:
    """How a run may end; any may be over when the signal comes."""
    if number == signal.SIGSTOP:
        return (0,)
    if number != signal.SIGKILL:
        return (0, 128 + number)
    # A run survives its workers.
    return (0, -number) if target == "main process" else (0,)


def _send(victim: Victim, process: Forked, target: str, number: signal.Signals, rng: random.Random) -> None:
    if process.poll() is not None:
        return
    if target == "main process":
        os.kill(process.pid, number)
    elif target == "worker":
        if workers := _workers(victim, process.pid):
            os.kill(rng.choice(workers), number)
    else:
        os.killpg(process.pid, number)
        if target.endswith("twice") and process.poll() is None:
            time.sleep(rng.uniform(0, 0.1))
            _again(process.pid, number)
        if target.endswith("SIGCONT"):
            time.sleep(rng.uniform(0, 1))
            _again(process.pid, signal.SIGCONT)


def _again(group: int, number: signal.Signals) -> None:
    try:
        os.killpg(group, number)
    except ProcessLookupError:
        return


def _workers(victim: Victim, main: int) -> list[int]:
    """The processes that the process which forks them has forked."""
    parents = {}
    for pid in victim.processes():
        try:
            parents[pid] = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
    return [pid for pid, parent in parents.items() if main not in (pid, parent)]
