"""Running: what is stored is kept, what is missing is computed, the same bytes by any executor."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import pytest

from hident import plugins
from hident.engine.executors import SerialExecutor, make_executor
from hident.engine.experiment import load
from hident.engine.results import Results
from hident.engine.runner import run, stored, unit_key
from hident.engine.store import Store
from hident.errors import TrialsCrashed

if TYPE_CHECKING:
    from hident.engine.experiment import Plan
    from tests.conftest import Lab

plugins.load()


@dataclass
class Told:
    """What a run tells about itself."""

    total: int = 0
    stored: int = 0
    done: int = 0
    ends: list[str] = field(default_factory=list)

    def start(self, total: int, stored: int) -> None:
        self.total, self.stored = total, stored

    def advance(self, trials: int) -> None:
        self.done += trials

    def stopping(self) -> None:
        self.ends.append("stopping")

    def finish(self) -> None:
        self.ends.append("finished")


def _plan(lab: Lab, **changes: Any) -> Plan:
    lab.configure(**changes)
    return load(lab.folder / "tiny.yaml")


def _run(
    lab: Lab, plan: Plan, store: str = "s", executor: Executor | None = None, workers: int = 1, **kw: Any
) -> tuple[Results, Told]:
    told = Told()
    with Store(lab.folder / store).writing() as writer:
        trials, seed = plan.experiment.trials, plan.experiment.seed
        results = run(
            plan,
            writer,
            executor or SerialExecutor(),
            workers,
            **{"trials": trials, "seed": seed, "progress": told, **kw},
        )
    return results, told


def _bytes(lab: Lab, plan: Plan, store: str = "s") -> dict[str, list[tuple[int, bytes]]]:
    keys = [unit_key(unit, plan.experiment.seed) for unit in plan.units]
    found = Store(lab.folder / store).read(keys, plan.experiment.trials)
    return {key: [(t.trial, t.values.tobytes()) for t in trials] for key, trials in found.items()}


_REAL: dict[str, Any] = {
    "estimators": {
        "kernel": {"kind": "kernel", "kernel": "triangular", "bandwidth": {"h0": 1, "alpha": "1/5"}},
        "series": {
            "kind": "orthogonal",
            "basis": {"kind": "trigonometric", "interval": [-6, 6]},
            "terms": {"q0": 2, "alpha": "1/5"},
            "prefilter": {"kind": "instrumental_variables", "order": 1, "instrument": "abs"},
        },
    },
    "metrics": {"mise": {"kind": "mise", "at": "samples", "interval": [-6, 6]}},
    "tables": {},
}


def test_same_bytes_by_one_worker_two_workers_threads_and_any_order(lab: Lab) -> None:
    plan = _plan(lab, **_REAL)
    serial, told = _run(lab, plan)
    assert (told.total, told.stored, told.done, told.ends) == (24, 0, 24, ["finished"])
    expected = _bytes(lab, plan)
    assert [len(trials) for trials in expected.values()] == [6] * 4

    # Begun by one worker, ended by two.
    _run(lab, plan, "pool", trials=2)
    with make_executor(2) as pool:
        results, told = _run(lab, plan, "pool", pool, 2)
    assert (told.stored, told.done) == (8, 16)
    assert _bytes(lab, plan, "pool") == expected
    assert results.frame().to_csv() == serial.frame().to_csv()

    with ThreadPoolExecutor(3) as threads:
        _run(lab, plan, "threads", threads, 3)
    assert _bytes(lab, plan, "threads") == expected

    estimators = dict(reversed(_REAL["estimators"].items()))
    turned = _plan(lab, estimators=estimators, cases={"samples": [80, 50]})
    _run(lab, turned, "turned")
    assert _bytes(lab, turned, "turned") == expected


def test_more_trials_extend_a_run_and_fewer_compute_nothing(lab: Lab) -> None:
    few = _plan(lab, trials=10)
    _run(lab, few)
    before = _bytes(lab, few)
    more = _plan(lab, trials=30)
    _, told = _run(lab, more)
    assert (told.total, told.stored, told.done) == (120, 40, 80)
    assert {key: trials[:10] for key, trials in _bytes(lab, more).items()} == before
    results, told = _run(lab, _plan(lab, trials=20))
    assert (told.total, told.stored, told.done) == (80, 80, 0)
    assert {len(series.values) for series in results.series} == {20}


@pytest.mark.parametrize(
    ("change", "computed"),
    [
        ({"title": "Another", "tables": {}}, 0),
        ({"cases": {"samples": [80, 50, 60]}}, 12),
        ({"metrics": {"a": {"kind": "error", "of": ["a_1"], "estimators": ["iv", "known"]}}}, 0),
        ({"metrics": {"a": {"kind": "value", "of": ["a_1"]}}}, 24),
        ({"estimators": {"new name": {"kind": "known_dynamics", "a": [0.8]}}, "tables": {}}, 0),
        ({"estimators": {"known": {"kind": "known_dynamics", "a": [0.7]}}, "tables": {}}, 12),
        ({"seed": 8}, 24),
        ({"noise": []}, 24),
    ],
)
def test_a_change_computes_what_depends_on_it(lab: Lab, change: dict[str, Any], computed: int) -> None:
    _run(lab, _plan(lab))
    plan = _plan(lab, **change)
    assert (
        sum(stored(plan, Store(lab.folder / "s"), 6, plan.experiment.seed)) == 6 * len(plan.units) - computed
    )
    _, told = _run(lab, plan)
    assert told.done == computed


class Scripted(Executor):
    """Runs each call at once, but ends with a given exception in place of a given call, and counts calls."""

    def __init__(self, at: int, act: Callable[[], Exception | None]) -> None:
        self.calls, self._at, self._act = 0, at, act

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.calls += 1
        error = self._act() if self.calls == self._at else None
        if error is not None:
            future.set_exception(error)
        else:
            future.set_result(fn(*args, **kwargs))
        return future


def test_a_broken_pool_keeps_what_is_finished(lab: Lab) -> None:
    plan = _plan(lab, trials=200)
    executor = Scripted(4, lambda: BrokenExecutor("gone"))
    with pytest.raises(TrialsCrashed, match="a worker process ended abruptly"):
        _run(lab, plan, executor=executor, workers=2)
    # Of the four chunks that were under way at first, three had finished.
    assert executor.calls == 4
    assert Store(lab.folder / "s").count() == 3 * 2


def test_interrupt_stores_what_is_in_flight(lab: Lab) -> None:
    plan = _plan(lab, trials=200)
    before = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    told = Told()
    try:
        executor = Scripted(3, lambda: signal.raise_signal(signal.SIGINT))
        with pytest.raises(KeyboardInterrupt):
            _run(lab, plan, executor=executor, workers=2, progress=told)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert told.ends == ["stopping", "finished"]
    assert Store(lab.folder / "s").count() == executor.calls * 2 == told.done


def test_chunks_grow_to_about_a_quarter_of_a_second(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = _plan(lab, trials=100, cases={}, samples=50, tables={})
    clock = iter(range(10**6))
    # Every chunk takes one second by this clock: so one trial is in the first, and one in every other.
    monkeypatch.setattr(time, "perf_counter", lambda: float(next(clock)))
    slow = Scripted(0, lambda: None)
    _run(lab, plan, "slow", slow)
    # By this one, it takes a microsecond.
    monkeypatch.setattr(time, "perf_counter", lambda: next(clock) * 1e-6)
    fast = Scripted(0, lambda: None)
    _run(lab, plan, "fast", fast)
    assert fast.calls == 2
    assert slow.calls > 20


def test_failed_estimates_are_stored_and_not_recomputed(lab: Lab) -> None:
    silent = {**lab.config["system"], "nonlinearity": {"kind": "expression", "expression": "0*u"}}
    plan = _plan(lab, system=silent, noise=[])
    results, _ = _run(lab, plan)
    failed = [series.statistics["failed"] for series in results.select("iv")]
    assert failed == [6, 6]
    assert [series.statistics["failed"] for series in results.select("known")] == [0, 0]
    assert _run(lab, plan)[1].done == 0
