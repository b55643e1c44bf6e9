"""Running: what is stored is kept, what is missing is computed, the same bytes by any executor."""

from __future__ import annotations

import gc
import itertools
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from hident import plugins
from hident.engine import fingerprint
from hident.engine.chunks import Case
from hident.engine.executors import make_executor
from hident.engine.experiment import Unit, load
from hident.engine.results import Results
from hident.engine.runner import run, stored
from hident.engine.scores import Scores
from hident.engine.store import MemoryStore, Reader, Store
from hident.engine.unit_trials import Recent, UnitTrials
from hident.errors import ConfigError, StoreError, TrialsCrashed
from hident.ledger.verdicts import judge
from hident.reports.output import Outputs
from tests.unit.results_maker import PUBLISHED, made

if TYPE_CHECKING:
    from pathlib import Path

    from hident.config.spec import Spec
    from hident.engine.experiment import Plan
    from tests.conftest import Lab

plugins.load()


@dataclass
class Told:
    """What a run tells about itself."""

    total: int = 0
    stored: int = 0
    done: int = 0
    begun: list[str] = field(default_factory=list)
    came_back: list[str] = field(default_factory=list)
    ended: list[str] = field(default_factory=list)

    def start(self, total: int, stored: int) -> None:
        self.total, self.stored = total, stored

    def begins(self, work: str) -> None:
        self.begun.append(work)

    def ends(self, work: str) -> None:
        self.came_back.append(work)

    def advance(self, trials: int) -> None:
        self.done += trials

    def stopping(self) -> None:
        self.ended.append("stopping")

    def finish(self) -> None:
        self.ended.append("finished")


def _plan(lab: Lab, **changes: Any) -> Plan:
    lab.configure(**changes)
    return load(lab.folder / "tiny.yaml")


def _run(
    lab: Lab, plan: Plan, store: str = "s", executor: Executor | None = None, workers: int = 1, **kw: Any
) -> tuple[Results, Told]:
    told = Told()
    with Store(lab.folder / store).writing() as writer:
        results = run(plan, store=writer, executor=executor, workers=workers, **{"progress": told, **kw})
    return results, told


def _bytes(lab: Lab, plan: Plan, store: str = "s") -> dict[str, list[tuple[int, bytes]]]:
    with Store(lab.folder / store).reading() as reader:
        return {
            key: [
                (trial, values.tobytes())
                for scores in reader.trials(key, plan.trials)
                for trial, values in zip(scores.trials.tolist(), scores.values, strict=True)
            ]
            for keys in plan.keys
            for key in keys.values()
        }


def _count(lab: Lab) -> int:
    with Store(lab.folder / "s").reading() as reader:
        return reader.count()


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
    assert (told.total, told.stored, told.done, told.ended) == (24, 0, 24, ["finished"])
    expected = _bytes(lab, plan)
    assert [len(trials) for trials in expected.values()] == [6] * 4

    # Begun by one worker, ended by two.
    _run(lab, plan.changed(trials=2), "pool")
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


_IV = {"estimator": "iv", "metric": "a a_1"}


@pytest.mark.parametrize(
    ("change", "computed"),
    [
        ({"title": "Another", "tables": {}}, 0),
        ({"figures": {"scatter": {"kind": "scatter", "panels": [{"x": _IV, "y": _IV}]}}}, 0),
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
    assert sum(stored(plan, Store(lab.folder / "s"))) == 6 * len(plan.units) - computed
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
    assert _count(lab) == 3 * 2


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
    assert told.ended == ["stopping", "finished"]
    assert _count(lab) == executor.calls * 2 == told.done


def test_the_first_trial_of_every_case_comes_first(lab: Lab) -> None:
    plan = _plan(lab, cases={"samples": [50, 60, 70]}, trials=3, tables={})
    _, told = _run(lab, plan)
    first, rest = told.begun[:3], told.begun[3:]
    assert first == [f"trial 0 of 'known', 'iv' at samples {samples}" for samples in (50, 60, 70)]
    assert not any(work.startswith("trial 0 ") for work in rest)
    assert told.begun == told.came_back


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


class Lacking:
    """A unit that lacks so many trials."""

    def __init__(self, trials: int) -> None:
        self._trials = trials

    def trials_missing(self) -> Any:
        return np.ones(self._trials, dtype=bool)

    def lacking(self, trials: list[int]) -> list[Any]:
        return []


@pytest.mark.parametrize(
    ("workers", "trials", "first", "last"),
    [
        (0, 1000, 25, 25),
        (6, 1000, 25, 25),
        (100, 10**6, 400, 25),
        (100, 10_000, 50, 25),
        (1000, 10**7, 4000, 25),
    ],
)
def test_chunks_of_many_workers_take_longer_but_not_at_the_end(
    workers: int, trials: int, first: int, last: int
) -> None:
    units: list[Any] = [Lacking(trials)]
    data: Any = None
    case = Case(data, units, seconds=0.01)
    sizes = [len(chunk.trials) for chunk in case.chunks(lambda: workers)]
    assert (sizes[0], sizes[-2]) == (first, last)
    assert sum(sizes) == trials
    assert sizes[:-1] == sorted(sizes[:-1], reverse=True)


@pytest.mark.parametrize("recent", [None, Recent(0), Recent(4)], ids=["held", "none", "recent"])
def test_trials_that_are_not_stored_are_read_beside_those_that_are(lab: Lab, recent: Recent | None) -> None:
    plan, store = _plan(lab, trials=4), MemoryStore()
    trials = UnitTrials(plan.units[0], plan.keys[0], plan.timing_keys[0], 4, store, recent)
    of_metric = np.array([[0.5], [0.25], [np.nan]])
    stored = Scores(np.array([0, 2, 3]), of_metric, {3: "singular"})
    store.add({}, [(plan.keys[0]["a"], stored)])
    trials.read()
    trials.put("a", Scores(np.array([1]), np.array([[np.nan]]), {1: "took longer"}), stored=False)
    assert trials.complete() == 4
    [series] = trials.series()
    np.testing.assert_array_equal(series.values, [0.5, np.nan, 0.25, np.nan])
    assert sorted(series.reasons) == [("singular", 1), ("took longer", 1)]


def test_of_very_many_trials_what_was_asked_for_last_is_not_read_again(lab: Lab) -> None:
    class Counted(MemoryStore):
        reads = 0

        def trials(self, key: str, below: int) -> list[Scores]:
            self.reads += 1
            return super().trials(key, below)

    metrics = {"a": {"kind": "value", "of": ["a_1", "b_0"]}}
    known = {f"known {i}": {"kind": "known_dynamics", "a": [0.1 * i]} for i in (7, 8)}
    plan, store = _plan(lab, trials=4, metrics=metrics, estimators=known, tables={}), Counted()
    expected = run(plan, store=store)

    def read(most: int) -> tuple[int, int]:
        store.reads, recent = 0, Recent(most)
        units = [
            UnitTrials(*of, 4, store, recent)
            for of in zip(plan.units[:2], plan.keys, plan.timing_keys, strict=False)
        ]
        every = [one for unit in units for one in unit.series()]
        made = store.reads
        for one, other in zip(every, expected.series, strict=False):
            for _ in range(3):
                assert one.values.tobytes() == np.ascontiguousarray(other.values).tobytes()
        assert sum(array.size for array in recent._arrays.values()) <= most
        return made, store.reads - made

    # Two metrics of two labels with four values each: both, one, one label, nothing.
    assert read(16) == (2, 0)
    assert read(8) == (2, 2)
    assert read(4) == (4, 4)
    assert read(3) == (4, 12)


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_the_garbage_collector_passes_over_what_was_loaded_before(lab: Lab, jobs: str) -> None:
    lab.probe("import gc\nvalue = float(gc.get_freeze_count())")
    lab.run("-q", "--jobs", jobs)
    frozen = [np.frombuffer(value)[0] for (unit, *_), value in lab.trials().items() if unit == "probe"]
    assert len(frozen) == 12
    assert min(frozen) > 10_000


def test_after_a_run_the_garbage_collector_looks_at_all_again(lab: Lab) -> None:
    run(_plan(lab))
    assert gc.get_freeze_count() == 0


def test_of_very_many_trials_nothing_is_held(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    class Watching(Told):
        def ends(self, work: str) -> None:
            super().ends(work)
            held.append(sum(isinstance(one, Scores) for one in gc.get_objects()))

    held: list[int] = []
    monkeypatch.setattr("hident.engine.runner._HELD", 0)
    monkeypatch.setattr("hident.engine.chunks._LARGEST", 1)
    _run(lab, _plan(lab, trials=12), progress=Watching())
    assert len(held) == 24
    assert held[-1] <= held[2]


def test_failed_estimates_are_stored_and_not_recomputed(lab: Lab) -> None:
    silent = {**lab.config["system"], "nonlinearity": {"kind": "expression", "expression": "0*u"}}
    plan = _plan(lab, system=silent, noise=[])
    results, _ = _run(lab, plan)
    failed = [series.statistics["failed"] for series in results.select("iv")]
    assert failed == [6, 6]
    assert [series.statistics["failed"] for series in results.select("known")] == [0, 0]
    assert _run(lab, plan)[1].done == 0


class Counting(Executor):
    """Runs each call at once, and counts the estimates and the scores that it makes."""

    def __init__(self) -> None:
        self.estimates = self.scores = 0

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        done = fn(*args, **kwargs)
        self.estimates += sum(len(outcome.scores[0].trials) for outcome in done.outcomes)
        self.scores += sum(len(scores.trials) for outcome in done.outcomes for scores in outcome.scores)
        future.set_result(done)
        return future


_ONE: dict[str, Any] = {"kind": "error", "of": ["a_1"]}
_TWO: dict[str, Any] = {"kind": "value", "of": ["a_1"]}


@pytest.mark.parametrize(
    ("metrics", "scores"),
    [
        ({"a": _ONE, "b": _TWO}, 0),
        ({"b": _TWO, "renamed": _ONE}, 0),
        ({"a": _ONE}, 0),
        ({"a": _ONE, "b": _TWO, "new": {"kind": "percent_error", "of": ["a_1"]}}, 24),
        ({"a": _ONE, "b": {"kind": "percent_error", "of": ["a_1"]}}, 24),
        ({"a": {**_ONE, "estimators": ["iv"]}, "b": _TWO}, 0),
    ],
)
def test_a_new_or_changed_metric_costs_its_own_scores_only(
    lab: Lab, metrics: dict[str, Any], scores: int
) -> None:
    _run(lab, _plan(lab, metrics={"a": _ONE, "b": _TWO}, tables={}))
    executor = Counting()
    _, told = _run(lab, _plan(lab, metrics=metrics), executor=executor)
    assert (executor.estimates, executor.scores) == (scores, scores)
    assert told.done == scores


def test_scores_are_the_same_whether_a_metric_came_first_or_later(lab: Lab) -> None:
    both = _plan(lab, metrics={"a": _ONE, "b": _TWO}, tables={})
    _run(lab, both)
    _run(lab, _plan(lab, metrics={"b": _TWO}).changed(trials=2), "later")
    both = _plan(lab, metrics={"a": _ONE, "b": _TWO})
    results, told = _run(lab, both, "later")
    assert (told.stored, told.done) == (0, 24)
    assert _bytes(lab, both, "later") == _bytes(lab, both)
    assert results.frame().to_csv() == _run(lab, both)[0].frame().to_csv()


def test_stored_trials_are_read_once_and_keys_are_made_once(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = _plan(lab)
    _run(lab, plan)
    plan = _plan(lab)
    read: list[str] = []
    hashed: list[object] = []
    keyed: list[Unit] = []
    read_one, hash_one, keys_of = Reader.trials, fingerprint.fingerprint, Unit.keys

    def reading(reader: Reader, key: str, below: int) -> Iterator[Scores]:
        read.append(key)
        return read_one(reader, key, below)

    def hashing(specs: Iterable[Spec]) -> str:
        hashed.append(specs)
        return hash_one(specs)

    def keying(unit: Unit, seed: int, perturbation: int = 0) -> dict[str, str]:
        keyed.append(unit)
        return keys_of(unit, seed, perturbation)

    monkeypatch.setattr(Reader, "trials", reading)
    monkeypatch.setattr(Unit, "keys", keying)
    monkeypatch.setattr("hident.engine.expansion.fingerprint", hashing)
    outputs = Outputs(plan, lab.folder / "out")
    outputs.state()
    outputs.write(_run(lab, plan)[0], {})
    scores = [key for keys in plan.keys for key in keys.values()]
    assert sorted(read) == sorted([*scores, *plan.timing_keys])
    stored(plan, Store(lab.folder / "s"))
    # Of each unit, the code that a metric's scores and that its seconds depend on.
    assert len(hashed) == 2 * len(plan.units)
    assert len(keyed) == len(plan.units)


def test_perturbed_trials_are_a_last_bit_away_and_have_keys_of_their_own(lab: Lab) -> None:
    plan = _plan(lab, **_REAL)
    plain, _ = _run(lab, plan)
    before = _bytes(lab, plan)
    first, told = _run(lab, plan.changed(perturbation=1))
    assert (told.stored, told.done) == (0, 24)
    second, _ = _run(lab, plan.changed(perturbation=2))
    values = [np.array([s.values for s in results.series]) for results in (plain, first, second)]
    for one, other in itertools.combinations(values, 2):
        assert (one != other).any()
        np.testing.assert_allclose(one, other, rtol=1e-9)
    assert _bytes(lab, plan) == before
    again, told = _run(lab, plan.changed(perturbation=1))
    assert told.done == 0
    assert again.frame().to_csv() == first.frame().to_csv()
    assert len({key for k in range(3) for unit in plan.units for key in unit.keys(7, k).values()}) == 12
    for unit in plan.units:
        assert unit.keys(7) == unit.keys(7, 0)


def test_a_store_in_memory_holds_the_same_and_a_run_needs_none(lab: Lab) -> None:
    plan, told, store = _plan(lab, **_REAL), Told(), MemoryStore()
    results = run(plan, store=store, progress=told)
    assert (told.stored, told.done) == (0, 24)
    expected = _run(lab, plan)[0].frame().to_csv()
    assert results.frame().to_csv() == run(plan).frame().to_csv() == expected
    more = plan.changed(trials=8)
    run(more, store=store, progress=told)
    assert (told.stored, told.done) == (24, 24 + 8)
    key = plan.keys[0]["mise"]
    assert np.concatenate([scores.trials for scores in store.trials(key, 7)]).tolist() == list(range(7))


def test_another_seed_or_number_of_trials_is_another_plan(lab: Lab) -> None:
    plan = _plan(lab)
    other = plan.changed(trials=3, seed=0)
    assert (plan.trials, plan.seed, other.trials, other.seed) == (6, 7, 3, 0)
    assert plan.changed(trials=3).keys == plan.keys != other.keys
    assert other.keys == load(lab.folder / "tiny.yaml", (), {"seed": 0}).keys
    with pytest.raises(ConfigError, match=r"trials must be at least 1, seed and .* not 0, 7 and 0"):
        plan.changed(trials=0)


def test_the_outputs_have_the_key_of_the_paper_s_files_that_were_read(tmp_path: Path) -> None:
    reasons = tmp_path / "experiments/someone2001/reasons.yaml"
    rest = PUBLISHED.format(runs=100, statistic="mean")
    numbers = "T,N=10,error,5.0,\nT,N=100,error,5.0,\nT,N=1000,error,5.0,\n"
    results = made(tmp_path, {}, rest=rest, printed=numbers, reasons="reasons: [{reason: one}]\n")
    plan, folder = results.plan, tmp_path / "out"
    assert {verdict.reason for verdict in judge(results)} == {"one"}
    reasons.write_text("reasons: [{reason: two}]\n")
    outputs = Outputs(plan, folder)
    outputs.write(results, {})
    assert "one" in (folder / "verdicts.csv").read_text()
    assert outputs.state() == "up to date"
    assert Outputs(load(plan.path), folder).state() == "old"


def test_an_error_that_is_not_the_store_s_keeps_its_own_name(lab: Lab) -> None:
    executor = Scripted(2, lambda: OSError("AF_UNIX path too long"))
    with pytest.raises(OSError, match="AF_UNIX path too long"):
        _run(lab, _plan(lab), executor=executor)
    assert _count(lab) == 2


def test_of_very_many_numbers_a_series_at_a_time_is_read_and_all_comes_out_the_same(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    flat, of = {"kind": "expression", "expression": "0*u"}, "system.nonlinearity"
    cases = {"block": {"flat": {of: flat, "noise": []}, "straight": {of: "identity"}}}
    plan = _plan(lab, cases=cases, samples=50, tables={})
    folders = [lab.folder / "held", lab.folder / "read"]
    held, _ = _run(lab, plan)
    Outputs(plan, folders[0]).write(held, {})
    monkeypatch.setattr("hident.engine.runner._HELD", 0)
    with Store(lab.folder / "s").writing() as writer:
        read = run(plan, store=writer)
        assert read.series[0].values is not read.series[0].values
        Outputs(plan, folders[1]).write(read, {})
    for name in ("table.csv", "trials.csv.xz", "table.md"):
        assert len({(folder / name).read_bytes() for folder in folders}) == 1
    assert [series.reasons for series in read.series] == [series.reasons for series in held.series]
    assert run(plan).frame().to_csv() == held.frame().to_csv()


def test_a_store_that_forgets_while_the_run_goes_is_told_so(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Forgetful(MemoryStore):
        def add(self, units: Mapping[str, Any], scores: Iterable[tuple[str, Scores]]) -> None:
            super().add(units, [*scores][:1])

    monkeypatch.setattr("hident.engine.runner._HELD", 0)
    with pytest.raises(StoreError, match="the trials store was changed while the run was going"):
        run(_plan(lab), store=Forgetful())


def test_what_is_begun_is_told_before_it_is_computed(lab: Lab) -> None:
    told = Told()

    class Asking(Counting):
        """Runs each call at once, if it was told of."""

        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            assert len(told.begun) == len(told.came_back) + 1
            return super().submit(fn, *args, **kwargs)

    run(_plan(lab), executor=Asking(), progress=told)
    assert told.begun == told.came_back != []
