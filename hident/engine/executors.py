"""Where chunks of trials run: this process, processes beside it, or any ``concurrent.futures.Executor``.

BLAS is held to one thread everywhere, the serial executor included, so that the same bytes come out of every
executor and every number of workers on one machine. Dask's workers stand in :mod:`hident.engine.dask`.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import pickle
import signal
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor
from concurrent.futures import wait as wait_for
from contextlib import ExitStack, contextmanager
from functools import cache
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, TypeVar

from hident import arithmetic, plugins, stopping
from hident.config.suggest import did_you_mean
from hident.engine.experiment import Plan
from hident.engine.fingerprint import libraries
from hident.engine.work import Call, Terms, pin_blas
from hident.errors import ConfigError

T = TypeVar("T")
NAMES = ("processes", "dask")
"""What an executor can be called, besides ``MODULE:FACTORY``."""
# The address of a socket has at most 103 bytes, of which multiprocessing takes 32 for names of its own.
_LONGEST_FOLDER = 70
# So often in a row workers may be killed before one has begun anything.
_STARTS = 3
_SECONDS_TO_END = 5.0


class WorkerDied(Exception):
    """So many workers died with a call, which no other one gets; the executor goes on."""

    def __init__(self, deaths: int) -> None:
        super().__init__(deaths)
        self.deaths = deaths


class WorkersGone(Exception):
    """The workers are out of reach, all of them and for good: why."""


class Workers(Executor):
    """An executor as a run uses it: what it had begun when it broke can be begun again with others."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.tell: Callable[[str], object] = warnings.warn
        """Whom a warning is for."""
        self.others: dict[str, str] = {}
        """Arithmetics that are not that of this process, each with the first worker that had it."""

    @property
    def used(self) -> dict[str, Any]:
        """How many there were, and which of them had another arithmetic than this process, for run.json."""
        return {"workers": self.count, **({"other_arithmetics": dict(self.others)} if self.others else {})}

    @property
    def most(self) -> int:
        """How many calls it is given at once; one if this process is inside it at Ctrl-C."""
        # A worker finds its next chunk waiting while this process stores the last one.
        return 2 * self.count if self.count > 1 else 1

    def start(self) -> None:
        """Let the workers be there, as far as that can be known, and be such as they must.

        Raises
        ------
        BrokenExecutor
            If none can begin anything.
        ConfigError
            If they cannot be used.
        """

    def renew(self) -> str:
        """Put other workers in the place of those that broke the executor: how these ended, if that is known.

        Raises
        ------
        BrokenExecutor
            If there are no others.
        """
        raise BrokenExecutor

    def kill(self) -> None:
        """End now, whatever the workers are doing."""
        self.shutdown(cancel_futures=True)

    def compare(self, theirs: str, worker: str) -> None:
        """Tell of an arithmetic that is not that of this process."""
        ours = libraries()["arithmetic"]
        if theirs != ours and theirs not in self.others:
            self.others[theirs] = worker
            self.tell(
                f"the worker on {worker} computes with another arithmetic than this process, so that last "
                f"digits may differ within one result: '{theirs}' there, '{ours}' here"
            )


class SerialExecutor(Workers):
    """Runs each call at once in this process: for one worker, and for debugging."""

    def __init__(self) -> None:
        super().__init__(1)

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        pin_blas()
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class Given(Workers):
    """An executor that somebody else has made, and ends."""

    def __init__(self, executor: Executor, count: int, terms: Terms) -> None:
        super().__init__(count)
        self._executor, self._terms = executor, terms

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        return self._executor.submit(Call(self._terms, fn, *args, **kwargs))


class Made(Workers):
    """An executor that is made by a factory, and again by it where its workers are lost."""

    def __init__(self, make: Callable[[], Executor], count: int, terms: Terms, name: str = "") -> None:
        super().__init__(count)
        self._make, self._terms, self._name = make, terms, name
        self._executor: Executor | None = None

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        # Pickled here, an error in that is one of this call.
        call = pickle.dumps(Call(self._terms, fn, *args, **kwargs))
        with _as_workers_start():
            if self._executor is None:
                self._executor = self._make()
            try:
                future: Any = self._executor.submit(_called, call, os.getpid())
            except (BrokenExecutor, KeyboardInterrupt):
                raise
            except BaseException as error:
                said = f"{type(error).__name__}: {error}".rstrip(": ")
                raise WorkersGone(f"the executor {self._name} takes no calls ({said})") from None
        if not isinstance(future, Future):
            raise ConfigError(
                f"--executor: submit of {self._name} must give a concurrent.futures.Future (got {future!r})"
            )
        return future

    def start(self) -> None:
        for left in reversed(range(_STARTS)):
            try:
                # One for each, so that all start at once; then the first that has begun will do.
                begun = [self.submit(int) for _ in range(self.count)]
                for future in wait_for(begun, return_when=FIRST_COMPLETED).done:
                    future.result()
            except BrokenExecutor:
                if not self.renew().startswith("signal") or not left:
                    raise
            else:
                return

    def renew(self) -> str:
        if self._executor is not None:
            self._executor.shutdown(wait=False)
            self._executor = None
        return ""

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        # Not every executor can cancel, and none need: a run waits for what it has sent.
        if self._executor is not None:
            self._executor.shutdown(wait)

    def kill(self) -> None:
        for worker in multiprocessing.active_children():
            # SIGTERM is blocked in what is started here; loky's cannot kill.
            getattr(worker._popen, "kill", worker.terminate)()  # type: ignore[attr-defined]
        self.shutdown(wait=False)


if sys.platform != "win32":
    from multiprocessing.context import ForkServerContext, ForkServerProcess

    class _Worker(ForkServerProcess):
        """A worker, which ignores SIGTERM: the pool means it to end by it when another one has died."""

        def terminate(self) -> None:
            self.kill()

    class _WorkersContext(ForkServerContext):
        Process = _Worker


class PoolExecutor(Made):
    """Processes that know the plugins; they ignore Ctrl-C and its like, and end when their parent does."""

    def __init__(self, workers: int, plugin_files: tuple[Path, ...]) -> None:
        super().__init__(self._pool, workers, Terms.here(plugin_files))
        self._processes: set[multiprocessing.process.BaseProcess] = set()

    def _pool(self) -> Executor:
        # Workers are started afresh: forking a process with threads (BLAS, a progress bar) may deadlock.
        if sys.platform == "win32":
            context = multiprocessing.get_context("spawn")
        else:
            context = _WorkersContext()
            # Once for all workers; scipy.signal alone takes a second.
            modules = (
                "hident.engine.socket_folder",
                "hident.engine.work",
                *plugins.built_in(),
                "scipy.signal",
            )
            context.set_forkserver_preload([*modules])
            # Here, as its start unblocks signals, which later ones would inherit.
            with signals_blocked():
                resource_tracker.ensure_running()
            forkserver.ensure_running()
        return ProcessPoolExecutor(self.count, mp_context=context, initializer=_start_worker)

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        if len(self._processes) == self.count:
            return super().submit(fn, *args, **kwargs)
        # A worker whose start is cut in half would be known to nobody.
        with stopping.postponed():
            before = set(multiprocessing.active_children())
            try:
                return super().submit(fn, *args, **kwargs)
            finally:
                self._processes |= set(multiprocessing.active_children()) - before

    def kill(self) -> None:
        for worker in self._processes:
            worker.kill()
        if self._executor is not None:
            self._executor.shutdown(cancel_futures=True)

    def renew(self) -> str:
        for process in self._processes:
            # The pool ends those that are left, but not one that is stopped.
            if not wait([process.sentinel], _SECONDS_TO_END):
                process.kill()
        if self._executor is not None:
            self._executor.shutdown()
        # 255 stands for what multiprocessing does not know; the pool has killed those that were left.
        codes = [process.exitcode for process in self._processes]
        told = [code for code in codes if code not in (None, 0, 255)]
        code = next((code for code in told if code != -signal.SIGKILL), [*told, 0][0])
        self._processes = set()
        super().renew()
        return f"signal {-code}" if code < 0 else f"exit code {code}" if code else ""


def make_executor(workers: int, plugin_files: Iterable[Path] = (), plans: Iterable[Plan] = ()) -> Workers:
    """A serial executor for one worker, else a pool of processes, which are to compute with the same code."""
    # This process fits a trial again for its figure.
    pin_blas()
    plugin_files = tuple(plugin_files)
    for plan in plans if plugin_files and workers > 1 else ():
        # What plugins import within functions is read for the keys.
        _ = plan.keys
    return SerialExecutor() if workers == 1 else PoolExecutor(workers, plugin_files)


def named_executor(
    name: str | None, scheduler: str | None, workers: int, plugin_files: Iterable[Path], plans: Iterable[Plan]
) -> Workers:
    """What ``--executor`` and ``--scheduler`` ask for.

    Raises
    ------
    ConfigError
        If there is no such executor, or it cannot be used.
    """
    if scheduler is not None and name not in (None, "dask"):
        raise ConfigError(f"--scheduler: is Dask's, and goes with --executor dask, not {name}")
    if scheduler is None and name in (None, "processes"):
        return make_executor(workers, plugin_files, plans)
    pin_blas()
    terms = Terms.anywhere(plugin_files, plans)
    if scheduler is None and name != "dask":
        return Made(_factory(str(name), workers), workers, terms, str(name))
    from hident.engine import dask

    return dask.local(workers, terms) if scheduler is None else dask.joined(scheduler, terms)


def _factory(name: str, workers: int) -> Callable[[], Executor]:
    """What ``MODULE:FACTORY`` names makes, given the number of workers."""
    module_name, _, attribute = name.partition(":")
    if not module_name or not attribute:
        near = did_you_mean(name, NAMES)
        raise ConfigError(
            f"--executor: unknown executor{near} (allowed: {', '.join(NAMES)}, MODULE:FACTORY) (got '{name}')"
        )
    # As python -m does: a factory of one's own stands in the folder where the program is started.
    sys.path.insert(0, "")
    try:
        module = importlib.import_module(module_name)
    except (Exception, SystemExit) as error:
        said = str(error) if isinstance(error, ImportError) else f"{type(error).__name__}: {error}"
        raise ConfigError(f"--executor: the module of '{name}' cannot be imported: {said}") from None
    finally:
        sys.path.remove("")
    found = getattr(module, attribute, None)
    if not callable(found):
        near = did_you_mean(attribute, [other for other in dir(module) if callable(getattr(module, other))])
        raise ConfigError(f"--executor: {module_name} has no factory '{attribute}'{near}")

    def make() -> Executor:
        try:
            made = found(workers)
        except (Exception, SystemExit) as error:
            raise ConfigError(f"--executor: {name}({workers}): {type(error).__name__}: {error}") from error
        if isinstance(made, Executor):
            return made
        raise ConfigError(
            f"--executor: {name}({workers}) must give a concurrent.futures.Executor (got {made!r})"
        )

    return make


def unpickled(call: bytes) -> Any:
    """Run a call that was pickled."""
    return pickle.loads(call)()


def _called(call: bytes, run: int) -> Any:
    """Run a call that was pickled; a process that the run has started ends with it."""
    _watch(run)
    return unpickled(call)


@cache
def _watch(run: int) -> None:
    parent = multiprocessing.parent_process()
    # That of loky's has no sentinel.
    if parent is not None and parent.pid == run and getattr(parent, "_sentinel", None) is not None:
        threading.Thread(target=_end_with_parent, daemon=True).start()
    elif os.getppid() == run:
        threading.Thread(target=_end_without, args=(run,), daemon=True).start()


def _end_without(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


@contextmanager
def _as_workers_start() -> Iterator[None]:
    with ExitStack() as stack:
        for each in (signals_blocked(), _short_socket_names(), arithmetic.handed_on()):
            stack.enter_context(each)
        yield


@contextmanager
def _short_socket_names() -> Iterator[None]:
    """Let multiprocessing, where it starts here, put its socket into a folder whose path is short enough.

    Raises
    ------
    ConfigError
        If there is none.
    """
    before = tempfile.tempdir
    if len(os.fsencode(tempfile.gettempdir())) > _LONGEST_FOLDER and sys.platform != "win32":
        tempfile.tempdir = next((name for name in ("/tmp", "/var/tmp") if os.access(name, os.W_OK)), None)
        if tempfile.tempdir is None:
            tempfile.tempdir = before
            raise ConfigError(
                f"worker processes need a folder for their sockets, and the path of {tempfile.gettempdir()} "
                "is too long: set TMPDIR to a shorter one, or run with --jobs 1"
            )
    try:
        yield
    finally:
        tempfile.tempdir = before


@contextmanager
def signals_blocked() -> Iterator[None]:
    """Let the processes that are started here inherit that Ctrl-C and its like are not for them."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, stopping.SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start_worker() -> None:
    stopping.ignore()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
