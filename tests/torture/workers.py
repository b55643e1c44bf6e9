"""Estimators that misbehave: a run says so and can be resumed, or is not disturbed at all."""

from __future__ import annotations

import random
import resource
from collections.abc import Mapping
from dataclasses import dataclass

from tests.torture.victim import Lost, Tally, Victim, new_victim

COUNT = 1
_TRIALS = 60
_MEMORY = 3 * 2**30


@dataclass(frozen=True)
class Misdeed:
    """What an estimator does, and with which exit codes a run may end, by its number of workers."""

    code: str
    ends: Mapping[str, tuple[int, ...]]


_CRASHES = {"1": (3,), "2": (3,)}
# One process ends with its estimator; a pool may survive.
_DIES = {"2": (3,)}
_HARMLESS = {"1": (0,), "2": (0,)}
MISDEEDS = {
    "takes all memory": Misdeed("taken = [np.empty(2**26) for _ in range(2**20)]", _CRASHES),
    "segfault by a signal": Misdeed("os.kill(os.getpid(), 11)", _DIES),
    "segfault": Misdeed("import ctypes; ctypes.string_at(0)", _DIES),
    "os._exit(0)": Misdeed("os._exit(0)", _DIES),
    "sys.exit": Misdeed("sys.exit(0)", _CRASHES),
    "GeneratorExit": Misdeed("raise GeneratorExit", _CRASHES),
    "KeyboardInterrupt": Misdeed("raise KeyboardInterrupt", {"1": (130,), "2": (3, 130)}),
    "StopIteration": Misdeed("raise StopIteration", _CRASHES),
    "deep recursion": Misdeed("f = lambda n: f(n + 1)\n    f(0)", _CRASHES),
    "closes the streams": Misdeed("sys.stdout.close(); sys.stderr.close()", _HARMLESS),
    "closes their descriptors": Misdeed("os.closerange(1, 3)", _HARMLESS),
    "changes the working directory": Misdeed("os.chdir('/')", _HARMLESS),
    "sets numpy's errors": Misdeed("np.seterr(all='raise')", _HARMLESS),
    "turns warnings into errors": Misdeed("import warnings; warnings.simplefilter('error')", _HARMLESS),
    "writes a lot": Misdeed("print('x' * 10**6, flush=True)", _HARMLESS),
    "starts threads": Misdeed(
        "import threading\n"
        "    for _ in range(3): threading.Thread(target=time.sleep, args=(9,), daemon=True).start()",
        _HARMLESS,
    ),
    "seeds and draws": Misdeed("import random; random.seed(1); np.random.seed(1)", _HARMLESS),
    "ignores signals": Misdeed(
        "import signal, threading\n"
        "    if threading.current_thread() is threading.main_thread(): signal.signal(15, signal.SIG_IGN)",
        _HARMLESS,
    ),
    "sets the clock back": Misdeed(
        "at = time.time() - 86400; time.time = lambda: at - time.monotonic()", _HARMLESS
    ),
    "changes the environment": Misdeed("os.environ.clear()", _HARMLESS),
}


def torture(tally: Tally, rng: random.Random, count: int) -> None:
    """Commit each misdeed ``count`` times, in some trials of one of four units, by one and by two workers."""
    for name, misdeed in MISDEEDS.items():
        # Its trials have good and bad ones, whatever the chunk. All divide by zero, and first: who asks
        # for an error and then makes one fails, but the next trial must not.
        body = (
            f"np.log(np.zeros(1))\nif not {_REPAIRED} and len(record) == 80 and self.place "
            f"and record.u[1] > {rng.uniform(3, 5)}:\n"
            f"    {misdeed.code}"
        )
        with new_victim(_TRIALS, body=body) as victim:
            for jobs in sorted(misdeed.ends) * count:
                with tally.fault(f"an estimator: {name}", f"{jobs} jobs"):
                    _commit(victim, jobs, misdeed.ends[jobs])
    _forever(tally)


_REPAIRED = "os.path.exists(os.path.join(os.path.dirname(__file__), 'repaired'))"


def _commit(victim: Victim, jobs: str, ends: tuple[int, ...]) -> None:
    victim.forget()
    repaired = victim.folder / "repaired"
    repaired.unlink(missing_ok=True)
    process = victim.started_run("--jobs", jobs, "-q", preexec_fn=_limit)
    code = process.wait()
    assert code in ends or (code == 0 and jobs == "2"), f"exit code {code}: {victim.log[-2000:]}"
    assert "Traceback (most" not in victim.log, victim.log[-2000:]
    victim.await_alone()
    if code == 0:
        assert victim.outputs() == victim.truth, "other outputs than those of an undisturbed run"
    repaired.touch()
    stored = victim.stored()
    victim.fits()
    if (made := victim.check_ending()) > victim.units - stored:
        raise Lost(f"{stored} of {victim.units} were stored, and {made} computed after that")


def _limit() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))


def _forever(tally: Tally) -> None:
    """An estimate that never ends is given up where a limit is set, and the others are as ever."""
    with new_victim(
        _TRIALS, body=f"if not {_REPAIRED} and self.place and record.u[1] > 5:\n    while True: pass"
    ) as victim:
        if "--trial-timeout" not in victim.hident("run", "--help").stdout:
            tally.notes.append("no estimate ran for ever: this hident has no --trial-timeout")
            return
        with tally.fault("an estimator: never ends", "2 jobs"):
            victim.run("--jobs", "2", "-q", "--trial-timeout", "2")
            victim.check_left()
            (victim.folder / "repaired").touch()
            victim.run("-q", "--seed", "12")
