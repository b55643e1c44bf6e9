"""The same bytes, whatever computes the trials, in whatever pieces and order, interrupted or not."""

from __future__ import annotations

import itertools
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from hident import plugins
from hident.engine.executors import PoolExecutor, Workers
from hident.engine.experiment import Plan, load
from hident.engine.results import Results
from hident.engine.runner import run
from hident.engine.store import MemoryStore, TrialStore
from hident.ledger.trial_values import TrialValues
from hident.reports.output import Outputs
from tests.forked import GUARD_SECONDS

plugins.load()
CONFIGS = Path(__file__).parents[2] / "configs"
# One of each paper, with fewer cases where all would take long.
SOME = {
    "mzyk_table1": ["cases.samples=[50, 100]"],
    "wang_table1": [],
    "chen_fig4": [],
    "brouri_nonlinearity": [],
}
TRIALS = 5


def _plan(name: str, trials: int = TRIALS) -> Plan:
    return load(CONFIGS / f"{name}.yaml", [*SOME[name], "figures={}"], {"trials": trials})


def _files(results: Results, folder: Path) -> dict[str, bytes]:
    Outputs(results.plan, folder).write(results, {})
    return {name: (folder / name).read_bytes() for name in ("table.csv", "trials.csv.xz", "table.md")}


@pytest.fixture(scope="module", params=SOME)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def alone(name: str) -> Results:
    """A run by this process, in chunks as they come."""
    return run(_plan(name))


@pytest.fixture(scope="module")
def files(alone: Results, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    return _files(alone, tmp_path_factory.mktemp("alone"))


WORKERS: dict[str, Callable[[], Workers]] = {
    f"{count} processes": partial(PoolExecutor, count, ()) for count in (1, 2, 4)
}


@pytest.fixture(scope="module", params=WORKERS)
def workers(request: pytest.FixtureRequest) -> Iterator[Workers]:
    with WORKERS[request.param]() as executor:
        yield executor


def test_by_workers(name: str, files: dict[str, bytes], workers: Workers, tmp_path: Path) -> None:
    assert _files(run(_plan(name), executor=workers), tmp_path) == files


def test_by_dask_workers(name: str, files: dict[str, bytes], tmp_path: Path) -> None:
    """In a program of its own: other tests fork this process, where Dask's threads would then be missing."""
    pytest.importorskip("distributed")
    settings = [word for one in (*SOME[name], "figures={}") for word in ("--set", one)]
    subprocess.run(
        [
            *(sys.executable, "-m", "hident", "run", CONFIGS / f"{name}.yaml", "--quiet"),
            *("--executor", "dask", "--jobs", "2", "--trials", str(TRIALS), *settings),
            *("--store", tmp_path / "store", "--out", tmp_path / "out"),
        ],
        cwd=tmp_path,
        check=True,
        timeout=GUARD_SECONDS,
    )
    assert {file: (tmp_path / "out" / name / file).read_bytes() for file in files} == files


@pytest.mark.parametrize("size", [1, TRIALS])
def test_in_chunks_of_any_size(
    name: str, files: dict[str, bytes], size: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hident.engine.chunks.SECONDS", 1e9)
    monkeypatch.setattr("hident.engine.chunks._LARGEST", size)
    assert _files(run(_plan(name)), tmp_path) == files


class Interrupted(MemoryStore):
    """Ctrl-C comes after some chunks."""

    def __init__(self, chunks: int) -> None:
        super().__init__()
        self.left = chunks

    def add(self, units: Mapping[str, Any], scores: Any) -> None:
        super().add(units, scores)
        self.left -= 1
        if not self.left:
            raise KeyboardInterrupt


def _finished(store: TrialStore, plan: Plan) -> Results:
    while True:
        try:
            return run(plan, store=store)
        except KeyboardInterrupt:
            continue


def test_interrupted_and_after_a_shorter_run(name: str, files: dict[str, bytes], tmp_path: Path) -> None:
    store = Interrupted(2)
    run_to_end = _finished(store, _plan(name, TRIALS - 2))
    assert len(run_to_end.series[0].values) == TRIALS - 2
    store.left = 2
    assert _files(_finished(store, _plan(name)), tmp_path) == files


def _reversed(written: Mapping[str, Any] | Sequence[Any]) -> Any:
    return dict(reversed([*written.items()])) if isinstance(written, Mapping) else [*reversed(written)]


def test_in_any_order_of_cases_and_estimators(
    name: str, alone: Results, files: dict[str, bytes], tmp_path: Path
) -> None:
    plan = _plan(name)
    data = dict(plan.document.data)
    data["estimators"] = _reversed(data["estimators"])
    data["cases"] = {axis: _reversed(labels) for axis, labels in data.get("cases", {}).items()}
    other = run(load(replace(plan.document, data=data)))
    one, two = (dict(TrialValues.of(results).series) for results in (alone, other))
    assert one.keys() == two.keys()
    assert all(one[key].tobytes() == two[key].tobytes() for key in one)
    keys = [{*itertools.chain(*(keys.values() for keys in of.plan.keys))} for of in (alone, other)]
    assert keys[0] == keys[1]
    # The rows stand in the order of the file.
    table, of_other = (one["table.csv"].splitlines() for one in (files, _files(other, tmp_path)))
    assert table[0] == of_other[0]
    assert sorted(table) == sorted(of_other)
