"""The seconds of fits: measured, kept beside the scores, and in no key and no comparison."""

from __future__ import annotations

import itertools
import sqlite3
import time
import tracemalloc
from contextlib import closing
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest

from hident import plugins
from hident.engine.executors import make_executor
from hident.engine.experiment import load
from hident.engine.runner import run
from hident.engine.scores import SECONDS, Scores
from hident.engine.store import MemoryStore, Store
from hident.engine.timing import timings
from hident.engine.trial import Job, run_trials
from hident.estimators.base import is_batched

if TYPE_CHECKING:
    from hident.engine.experiment import Plan
    from hident.engine.results import Results
    from tests.conftest import Lab

plugins.load()


@pytest.fixture
def ticking(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that goes on by a second whenever it is read: so a fit takes one."""
    monkeypatch.setattr(time, "perf_counter", map(float, itertools.count()).__next__)


def _plan(lab: Lab, **changes: Any) -> Plan:
    lab.configure(**changes)
    return load(lab.folder / "tiny.yaml")


def _of(results: Results) -> list[tuple[int, float, float, float, float]]:
    return [(one.fits, one.median, one.q25, one.q75, one.relative) for one in results.timings]


@pytest.mark.usefixtures("ticking")
def test_each_fit_is_timed(lab: Lab) -> None:
    results = run(_plan(lab))
    assert _of(results) == [(6, 1.0, 1.0, 1.0, 1.0)] * 4
    frame = results.timing_frame()
    assert list(frame.columns) == [
        "samples", "estimator", "fits", "median", "q25", "q75", "relative", "batched",
    ]  # fmt: skip
    assert frame["samples"].to_list() == [50, 50, 80, 80]
    assert not frame["batched"].any()


@pytest.mark.usefixtures("ticking")
def test_of_a_batch_each_fit_has_an_even_share(lab: Lab) -> None:
    two_stage = {"kind": "two_stage", "lags": 2, "degree": 2}
    metrics = {"a": {"kind": "value", "of": ["a_1"]}}
    plan = _plan(lab, estimators={"tsa": two_stage}, metrics=metrics, tables={})
    unit = plan.units[0]
    job = Job(unit.estimator, ())
    assert is_batched(unit.estimator)
    [outcome] = run_trials(unit.data, [job], [[0, 1, 2, 3]], plan.seed)
    assert outcome.seconds.trials.tolist() == [0, 1, 2, 3]
    assert outcome.seconds.values[:, 0].tolist() == [0.25] * 4
    assert run(plan).timing_frame()["batched"].all()


def test_what_fails_has_no_time(lab: Lab) -> None:
    silent = {**lab.config["system"], "nonlinearity": {"kind": "expression", "expression": "0*u"}}
    known, iv, *_ = run(_plan(lab, system=silent, noise=[])).timings
    assert (known.unit.name, known.fits) == ("known", 6)
    assert (iv.unit.name, iv.fits) == ("iv", 0)
    assert np.isnan([iv.median, iv.q25, iv.q75, iv.relative]).all()
    assert known.relative == 1.0


def test_the_fastest_is_that_of_the_case(lab: Lab) -> None:
    plan, store = _plan(lab), MemoryStore()
    results = run(plan, store=store)
    medians = {(one.unit.name, one.unit.labels["samples"]): one.median for one in results.timings}
    for one in results.timings:
        least = min(medians[name, one.unit.labels["samples"]] for name in ("known", "iv"))
        assert one.relative == one.median / least


def test_stored_trials_keep_their_seconds_and_a_new_metric_counts_for_its_fit(lab: Lab) -> None:
    plan, store = _plan(lab), MemoryStore()
    first = run(plan, store=store)
    assert _of(run(plan, store=store)) == _of(first)
    # Another title, another metric: the same estimates, with the same key.
    metrics = {**lab.config["metrics"], "b": {"kind": "value", "of": ["a_1"]}}
    other = _plan(lab, title="Other", metrics=metrics)
    assert other.timing_keys == plan.timing_keys
    assert [one[0] for one in _of(run(other, store=store))] == [6] * 4
    assert plan.changed(seed=8).timing_keys != plan.timing_keys
    assert plan.changed(perturbation=1).timing_keys != plan.timing_keys


def test_with_two_workers_as_many_fits_are_timed(lab: Lab) -> None:
    plan = _plan(lab)
    with make_executor(2) as pool:
        results = run(plan, executor=pool, workers=2)
    assert [one.fits for one in results.timings] == [6] * 4
    assert all(one.median > 0.0 for one in results.timings)


@pytest.mark.parametrize(
    "query", ["DELETE FROM blocks WHERE key GLOB ?", "UPDATE blocks SET data = x'00' WHERE key GLOB ?"]
)
def test_a_store_without_them_or_with_damaged_ones_gives_all_scores(lab: Lab, query: str) -> None:
    plan = _plan(lab)
    with Store(lab.folder / "s").writing() as writer:
        scores = run(plan, store=writer).frame()
        assert writer.count() == 24
    with closing(sqlite3.connect(lab.folder / "s/trials.sqlite")) as connection, connection:
        assert connection.execute(query, (f"{SECONDS}*",)).rowcount
    with Store(lab.folder / "s").writing() as writer:
        results = run(plan, store=writer)
        assert writer.count() == 24
    pd.testing.assert_frame_equal(results.frame(), scores)
    assert [one.fits for one in results.timings] == [0] * 4


def test_a_mended_store_keeps_them(lab: Lab) -> None:
    plan = _plan(lab)
    with Store(lab.folder / "s").writing() as writer:
        before = _of(run(plan, store=writer))
    path = lab.folder / "s/trials.sqlite"
    content = bytearray(path.read_bytes())
    content[:100] = bytes(100)
    path.write_bytes(content)
    with Store(lab.folder / "s").writing() as writer:
        assert "24 scores are saved" in writer.mended
        assert _of(run(plan, store=writer)) == before


def test_of_many_units_the_seconds_of_one_are_in_memory(lab: Lab) -> None:
    class Timed(MemoryStore):
        def trials(self, key: str, below: int) -> list[Scores]:
            return [Scores(np.arange(below), np.ones((below, 1)))]

    plan = _plan(lab, trials=10_000, cases={"samples": [*range(50, 60)]})
    tracemalloc.start()
    assert [one.fits for one in timings(plan, Timed())] == [10_000] * 20
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # Its numbers, values, what is found of them and sorted copies; all units have 20 such.
    assert peak < 8 * 8 * 10_000


def test_timing_csv_is_of_the_run_accepted_with_it_and_nothing_compares_it(lab: Lab) -> None:
    lab.run("-q")
    out = lab.folder / "out/tiny"
    table = pd.read_csv(out / "timing.csv")
    assert table["fits"].to_list() == [6] * 4
    assert (table["median"] > 0.0).all()
    assert "timing.csv" not in (out / "run.json").read_text()
    lab.hident("accept", "tiny", "-q", "-j1")
    accepted = lab.folder / "results/tiny/timing.csv"
    assert accepted.read_bytes() == (out / "timing.csv").read_bytes()
    (out / "timing.csv").write_text("anything\n")
    assert "up to date" in lab.hident("status", "tiny.yaml").stdout
    assert "no differences" in lab.hident("compare").stdout
    assert "no differences" in lab.hident("compare", "results", "out").stdout
    accepted.unlink()
    assert "no differences" in lab.hident("compare").stdout


def test_seconds_are_exported(lab: Lab) -> None:
    lab.run("-q")
    said = lab.hident("export", "tiny.yaml", "seconds.csv", "--what", "timing").stdout
    assert said == "seconds.csv: 24 rows of 24 trials\n"
    table = pd.read_csv(lab.folder / "seconds.csv")
    assert list(table.columns) == ["samples", "estimator", "trial", "seconds"]
    medians = table.groupby(["samples", "estimator"])["seconds"].median()
    written = pd.read_csv(lab.folder / "out/tiny/timing.csv").set_index(["samples", "estimator"])["median"]
    np.testing.assert_allclose(medians.loc[written.index], written, rtol=1e-3)


def test_a_table_cannot_take_the_name(lab: Lab) -> None:
    lab.configure(tables={"timing": lab.config["tables"]["a"]})
    said = lab.hident("validate", "tiny.yaml", code=2).stderr
    assert "the name 'timing' is kept for timing.csv, which a run writes itself" in said
