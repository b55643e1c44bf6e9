"""Dask's workers, and those of any other executor: real schedulers and processes that talk over loopback."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import pytest

import hident
from hident import arithmetic
from tests.forked import GUARD_SECONDS

if TYPE_CHECKING:
    from tests.conftest import Lab

pytest.importorskip("distributed")
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="signals and /proc")

# Estimates with 80 samples say which process makes them, and wait for as long as the file `hold` is there.
_HOLD = """
if len(record) == 80:
    Path(f"reached-{os.getpid()}").touch()
    while Path("hold").exists():
        time.sleep(0.005)
"""
_QUIET = ("--no-dashboard", "--host", "127.0.0.1")
_WORKER = ("-m", "distributed.cli.dask_worker", *_QUIET, "--no-nanny", "--nthreads", "1")


class Cluster:
    """A scheduler and workers, which work in the folder of a laboratory."""

    def __init__(self, lab: Lab) -> None:
        self.lab, self.file = lab, lab.folder / "scheduler.json"
        self.processes: list[subprocess.Popen[bytes]] = []
        self.scheduler = self._start(
            "-m", "distributed.cli.dask_scheduler", *_QUIET, "--port", "0", "--scheduler-file", self.file
        )
        lab.await_(self.file.exists)

    def worker(
        self, sitecustomize: str = "", *, pinned: bool = True, nanny: bool = False, **environment: str
    ) -> int:
        """Start a worker and wait until it has joined: its process."""
        if sitecustomize:
            folder = self.lab.folder / f"site{len(self.processes)}"
            folder.mkdir()
            (folder / "sitecustomize.py").write_text(sitecustomize)
            environment["PYTHONPATH"] = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
        under = ("-m", "hident.pinned") if pinned else ()
        how = [part for part in _WORKER if not nanny or part != "--no-nanny"]
        process = self._start(*under, *how, "--scheduler-file", self.file, **environment)
        log = self._log(len(self.processes) - 1)
        self.lab.await_(lambda: "Registered to" in log.read_text() or process.poll() is not None)
        return process.pid

    def run(self, *arguments: str, code: int = 0) -> str:
        """``hident run tiny.yaml`` on the workers: standard error."""
        return self.lab.hident(
            "run", "tiny.yaml", "--scheduler", "scheduler.json", *arguments, code=code
        ).stderr

    def begin(self, *on: str) -> subprocess.Popen[bytes]:
        """Begin to run, in a process group of its own, with a log: when an estimate is held, it returns."""
        (self.lab.folder / "hold").touch()
        on = on or ("--scheduler", "scheduler.json")
        with (self.lab.folder / "log.txt").open("wb") as log:
            process = self._process(log, "-m", "hident", "run", "tiny.yaml", "--plugin", "probe.py", *on)
        self.lab.await_(lambda: self.holding() or process.poll() is not None)
        return process

    def holding(self) -> list[int]:
        """The processes that have held an estimate."""
        return [int(path.name.partition("-")[2]) for path in self.lab.folder.glob("reached-*")]

    def release(self) -> None:
        (self.lab.folder / "hold").unlink()

    def _log(self, number: int) -> Path:
        return self.lab.folder / f"dask{number}.txt"

    def _start(self, *arguments: object, **environment: str) -> subprocess.Popen[bytes]:
        with self._log(len(self.processes)).open("wb") as log:
            return self._process(log, *arguments, **environment)

    def _process(self, log: IO[bytes], *arguments: object, **environment: str) -> subprocess.Popen[bytes]:
        process = subprocess.Popen(
            [sys.executable, *map(str, arguments)],
            cwd=self.lab.folder,
            env=os.environ | environment,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
        self.processes.append(process)
        return process

    def end(self) -> None:
        for process in self.processes:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait(GUARD_SECONDS)


@pytest.fixture
def cluster(lab: Lab) -> Iterator[Cluster]:
    cluster = Cluster(lab)
    yield cluster
    cluster.end()


@pytest.fixture
def held(cluster: Cluster) -> Cluster:
    cluster.lab.probe(_HOLD)
    return cluster


@pytest.fixture(scope="module")
def serial(make_lab: Callable[[Path], Lab], tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What a run by one process gives."""
    lab = make_lab(tmp_path_factory.mktemp("serial"))
    lab.probe(_HOLD)
    lab.run("-q")
    return _files(lab)


def _files(lab: Lab) -> dict[str, bytes]:
    return {name: (lab.folder / "out/tiny" / name).read_bytes() for name in ("table.csv", "trials.csv.xz")}


def _run_json(lab: Lab) -> Any:
    return json.loads((lab.folder / "out/tiny/run.json").read_text())["provenance"]


@pytest.mark.parametrize("executor", ["dask", "loky:get_reusable_executor", "own:threads"])
def test_the_same_bytes_by_other_executors(lab: Lab, serial: dict[str, bytes], executor: str) -> None:
    if executor.startswith("loky"):
        pytest.importorskip("loky")
    own = "from concurrent.futures import ThreadPoolExecutor as threads\n"
    (lab.folder / "own.py").write_text(own)
    lab.probe(_HOLD)
    said = lab.hident("run", "tiny.yaml", "--executor", executor, "--jobs", "2").stderr
    assert "warning" not in said
    assert _files(lab) == serial
    assert _run_json(lab)["workers"] == 2
    lab.await_alone()


def test_a_cluster_of_its_own_needs_no_port_that_others_may_have(lab: Lab) -> None:
    """8787 is the one that every scheduler tries first, and warns about: here as an error."""
    with socket.socket() as other:
        with contextlib.suppress(OSError):
            other.bind(("0.0.0.0", 8787))
            other.listen()
        # Not in this process: later tests fork it, and Dask's threads would be missing there.
        done = subprocess.run(
            [
                sys.executable,
                "-W",
                "error",
                "-m",
                "hident",
                "run",
                "tiny.yaml",
                "--executor",
                "dask",
                "--jobs",
                "1",
            ],
            cwd=lab.folder,
            capture_output=True,
            text=True,
            timeout=GUARD_SECONDS,
            check=False,
        )
    assert done.returncode == 0, done.stderr


def test_the_same_bytes_by_workers_that_stand_and_the_lost_are_replaced(
    held: Cluster, serial: dict[str, bytes]
) -> None:
    for _ in range(2):
        held.worker()
    process = held.begin()
    # As a preempted node.
    os.kill(held.holding()[0], signal.SIGKILL)
    held.worker()
    held.release()
    assert process.wait(GUARD_SECONDS) == 0, held.lab.log
    assert _files(held.lab) == serial
    # The workers serve whoever comes next.
    held.lab.forget()
    held.run("-q")
    assert _files(held.lab) == serial


_OTHER_VERSION = "import hident\nhident.__version__ = '0.0.1'\n"
_NO_PLUGIN = """
from pathlib import Path

there = Path.is_file
Path.is_file = lambda path: path.name != "probe.py" and there(path)
"""


@pytest.mark.parametrize(
    ("sitecustomize", "said"),
    [
        (_OTHER_VERSION, f"differs from this process: hident: 0.0.1 there, {hident.__version__} here. "),
        (
            _NO_PLUGIN,
            "cannot load what this process has loaded: plugin {plugin}: no such file. A plugin must ",
        ),
    ],
)
def test_one_worker_that_is_not_as_it_must_be_is_named_before_the_first_trial(
    cluster: Cluster, sitecustomize: str, said: str
) -> None:
    cluster.lab.probe()
    cluster.worker()
    other = cluster.worker(sitecustomize)
    error = cluster.run(code=2).partition("error: ")[2]
    assert error.startswith("tcp://127.0.0.1:")
    assert f", process {other} {said.format(plugin=cluster.lab.folder / 'probe.py')}" in error
    assert error.count("tcp://") == 1
    assert not cluster.lab.store.exists() or not cluster.lab.trials()


@pytest.mark.long
def test_a_worker_without_hident_is_named(cluster: Cluster) -> None:
    cluster.worker("import sys\nsys.modules['hident.engine.work'] = None\n")
    error = cluster.run(code=2).partition("error: ")[2]
    assert error.startswith("tcp://127.0.0.1:")
    assert "hident cannot be used there (ModuleNotFoundError(" in error


@pytest.mark.long
def test_a_worker_that_joins_later_is_asked_too(held: Cluster, serial: dict[str, bytes]) -> None:
    held.worker()
    process = held.begin()
    other = held.worker(_OTHER_VERSION)
    assert process.wait(GUARD_SECONDS) == 2
    assert f", process {other} differs from this process: hident: 0.0.1 there" in held.lab.log
    assert held.lab.trials()
    held.release()
    os.kill(other, signal.SIGKILL)
    held.run("-q")
    assert _files(held.lab) == serial


@pytest.mark.long
def test_a_worker_that_has_loaded_what_has_changed_since_is_refused(cluster: Cluster) -> None:
    cluster.lab.probe()
    worker = cluster.worker()
    cluster.run("-q")
    cluster.lab.probe("value += 1")
    error = cluster.run("-q", code=2)
    assert f", process {worker} differs from this process: code of {cluster.lab.folder}: " in error
    assert " here. Install the same there, and start it anew" in error


def test_another_arithmetic_is_told_and_noted(cluster: Cluster, serial: dict[str, bytes]) -> None:
    if arithmetic.asked() != "pinned" or arithmetic.hindrance("x86_64", arithmetic.features()):
        pytest.skip("this processor has no AVX2, or the tests were asked to run without")
    cluster.lab.probe(_HOLD)
    cluster.worker(pinned=False, OPENBLAS_CORETYPE="Nehalem", HIDENT_ARITHMETIC="native")
    said = cluster.run()
    [(theirs, worker)] = _run_json(cluster.lab)["other_arithmetics"].items()
    assert "Nehalem" in theirs
    assert f"warning: the worker on {worker} computes with another arithmetic than this process" in said
    assert f"'{theirs}' there, '{arithmetic.identity()}' here" in said


def test_a_scheduler_that_is_gone_ends_the_run_and_the_next_one_resumes(
    held: Cluster, serial: dict[str, bytes]
) -> None:
    held.worker()
    process = held.begin()
    held.lab.await_(held.lab.trials)
    held.scheduler.kill()
    assert process.wait(GUARD_SECONDS) == 3
    assert "error: the scheduler at tcp://127.0.0.1:" in held.lab.log
    assert " is gone, and its workers with it.\nAll finished trials are kept: run again.\n" in held.lab.log
    assert "Traceback" not in held.lab.log
    before = held.lab.trials()
    assert before
    held.release()
    held.lab.run("-q")
    assert before.items() <= held.lab.trials().items()
    assert _files(held.lab) == serial


@pytest.mark.long
def test_workers_that_somebody_restarts_have_lost_their_chunks_and_no_more(
    held: Cluster, serial: dict[str, bytes]
) -> None:
    held.worker(nanny=True)
    process = held.begin()
    restart = """
import json
from distributed import Client
with Client(json.load(open("scheduler.json"))["address"]) as client:
    client.restart()
"""
    subprocess.run([sys.executable, "-c", restart], cwd=held.lab.folder, timeout=GUARD_SECONDS, check=True)
    held.release()
    assert process.wait(GUARD_SECONDS) == 0, held.lab.log
    assert _files(held.lab) == serial


def test_workers_that_are_all_gone_are_told_and_waited_for(held: Cluster, serial: dict[str, bytes]) -> None:
    held.worker()
    process = held.begin()
    os.kill(held.holding()[0], signal.SIGKILL)
    held.lab.await_(lambda: " has no workers: waiting for one\n" in held.lab.log)
    held.release()
    held.worker()
    assert process.wait(GUARD_SECONDS) == 0, held.lab.log
    assert _files(held.lab) == serial


def test_a_client_that_does_not_wait_is_refused(cluster: Cluster) -> None:
    script = """
import asyncio, json
from distributed import Client
import hident as hi
async def main():
    async with Client(json.load(open("scheduler.json"))["address"], asynchronous=True) as client:
        try:
            hi.run("tiny.yaml", executor=client)
        except hi.ConfigError as error:
            print(error)
asyncio.run(main())
"""
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=cluster.lab.folder,
        capture_output=True,
        text=True,
        timeout=GUARD_SECONDS,
        check=False,
    )
    said = "executor: must be a Client that waits for its answers (asynchronous=False)\n"
    assert (done.returncode, done.stdout) == (0, said), done.stderr


@pytest.mark.long
@pytest.mark.parametrize("on", [(), ("--executor", "dask", "--jobs", "2")], ids=["standing", "local"])
@pytest.mark.parametrize("times", [1, 2])
def test_interrupt_keeps_what_is_in_flight_and_a_second_one_stops_at_once(
    held: Cluster, times: int, on: tuple[str, ...]
) -> None:
    if not on:
        held.worker()
    process = held.begin(*on)
    os.killpg(process.pid, signal.SIGINT)
    held.lab.await_(lambda: "stopping when the trials in flight are stored" in held.lab.log)
    before = len(held.lab.trials())
    if times == 2:
        os.killpg(process.pid, signal.SIGINT)
    else:
        held.release()
    assert process.wait(GUARD_SECONDS) == 130
    assert "interrupted: all stored trials are kept in .hident; the same command resumes" in held.lab.log
    assert "Traceback" not in held.lab.log
    assert (len(held.lab.trials()) > before) == (times == 1)


def test_a_trial_that_ends_its_workers_is_a_crash(lab: Lab) -> None:
    lab.probe("if len(record) == 80:\n    os.kill(os.getpid(), 9)")
    lab.configure(trials=1)
    said = lab.hident("run", "tiny.yaml", "--executor", "dask", "-j2", "--keep-going", code=3).stderr
    assert "of estimator 'probe' at samples 80 crashed: its worker process ended abruptly\n" in said
    assert {case for unit, case, _ in lab.trials() if unit == "probe"} == {"{'samples': 50}"}
    assert len(lab.trials()) == 3
    lab.await_alone()


def test_a_client_from_python(cluster: Cluster) -> None:
    cluster.worker()
    script = """
import json
from distributed import Client
import hident as hi
with Client(json.load(open("scheduler.json"))["address"]) as client:
    found = hi.run("tiny.yaml", executor=client).frame()
    client.submit(int).result()
assert found.equals(hi.run("tiny.yaml").frame())
print(len(found))
"""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", script],
        cwd=cluster.lab.folder,
        capture_output=True,
        text=True,
        timeout=GUARD_SECONDS,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, "4\n"), done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            "--executor daks",
            "unknown executor; did you mean 'dask'? (allowed: processes, dask, MODULE:FACTORY)",
        ),
        ("--executor nowhere:f", "the module of 'nowhere:f' cannot be imported: No module named 'nowhere'"),
        (
            "--executor loky:get_reusable_exec",
            "loky has no factory 'get_reusable_exec'; did you mean 'get_reu",
        ),
        ("--executor json:dumps", "json:dumps(2) must give a concurrent.futures.Executor (got '2')"),
        ("--executor json:dump", "json:dump(2): TypeError: dump() missing 1 required positional argument"),
        ("--executor loky:f --scheduler tcp://h:1", "is Dask's, and goes with --executor dask, not loky:f"),
        (
            "--scheduler nowhere.json",
            "must be an address such as tcp://host:8786, or the file of a scheduler",
        ),
        ("--scheduler tiny.yaml", "must be an address such as tcp://host:8786, or the file of a scheduler"),
        ("--scheduler tpc://localhost:1", "(got 'tpc://localhost:1': unknown address scheme 'tpc' "),
        ("--scheduler tcp://127.0.0.1:9", "tcp://127.0.0.1:9: no scheduler answers: "),
    ],
)
def test_what_cannot_be_used_is_told(lab: Lab, arguments: str, said: str) -> None:
    error = lab.hident("run", "tiny.yaml", "-j2", *arguments.split(), code=2).stderr
    option = "--scheduler" if "--scheduler" in arguments else "--executor"
    assert f"error: {option}: " in error
    assert said in error


def test_dask_that_is_not_installed(lab: Lab) -> None:
    (lab.folder / "distributed.py").write_text("raise ImportError\n")
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(lab.folder), os.environ.get("PYTHONPATH", "")])}
    error = lab.hident("run", "tiny.yaml", "--executor", "dask", code=2, fresh=True, env=env).stderr
    assert error.endswith("error: Dask is not installed: pip install 'hident[dask]'\n")
