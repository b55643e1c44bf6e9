"""Where chunks of trials run: any ``concurrent.futures.Executor`` will do.

BLAS is held to one thread everywhere, the serial executor included, so that the same bytes come out of every
executor and every number of workers on one machine.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from functools import cache
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, TypeVar

from hident import arithmetic, plugins, stopping
from hident.engine.fingerprint import libraries
from hident.errors import ConfigError

T = TypeVar("T")
# The address of a socket has at most 103 bytes, of which multiprocessing takes 32 for names of its own.
_LONGEST_FOLDER = 70


class SerialExecutor(Executor):
    """Runs each call at once in this process: for one worker, and for debugging."""

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        pin_blas()
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


if sys.platform != "win32":
    from multiprocessing.context import ForkServerContext, ForkServerProcess

    class _Worker(ForkServerProcess):
        """A worker, which ignores SIGTERM: the pool means it to end by it when another one has died."""

        def terminate(self) -> None:
            self.kill()

    class _Workers(ForkServerContext):
        Process = _Worker


class PoolExecutor(ProcessPoolExecutor):
    """Processes that know the plugins; they ignore Ctrl-C and its like, and end when their parent does."""

    def __init__(self, workers: int, plugin_files: tuple[Path, ...]) -> None:
        # Workers are started afresh: forking a process with threads (BLAS, a progress bar) may deadlock.
        if sys.platform == "win32":
            context = multiprocessing.get_context("spawn")
        else:
            context = _Workers()
            # Once for all workers; scipy.signal alone takes a second.
            modules = (
                "hident.engine.socket_folder",
                "hident.engine.trial",
                *plugins.built_in(),
                "scipy.signal",
            )
            context.set_forkserver_preload([*modules])
            # Here, as its start unblocks signals, which later ones would inherit.
            with _signals_blocked():
                resource_tracker.ensure_running()
        super().__init__(workers, mp_context=context, initializer=_start_worker)
        self._plugin_files = plugin_files
        # That of the keys.
        self._arithmetic = libraries()["arithmetic"]

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        # Pickled here and unpickled within the call, an error in either is an exception of this call,
        # where the pool itself would lose its workers.
        try:
            call = pickle.dumps((fn, args, kwargs))
        except Exception as error:
            raise ConfigError(
                f"a component cannot be sent to worker processes ({error}): define its class at the top "
                "level of its module, or run with --jobs 1"
            ) from None
        with _signals_blocked(), _short_socket_names(), arithmetic.handed_on():
            if sys.platform != "win32":
                forkserver.ensure_running()
            return super().submit(_call, self._plugin_files, self._arithmetic, call)


def make_executor(workers: int, plugin_files: Iterable[Path] = ()) -> Executor:
    """A serial executor for one worker, else a pool of processes."""
    # This process fits a trial again for its figure.
    pin_blas()
    return SerialExecutor() if workers == 1 else PoolExecutor(workers, tuple(plugin_files))


def end(executor: Executor) -> None:
    """End an executor now, whatever its workers are doing."""
    for worker in multiprocessing.active_children():
        worker.kill()
    executor.shutdown(cancel_futures=True)


@cache
def pin_blas() -> None:
    """Hold all BLAS libraries of this process to one thread."""
    import scipy.linalg  # noqa: F401  (its BLAS must be loaded to be held)
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)


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
def _signals_blocked() -> Iterator[None]:
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


def _call(plugin_files: tuple[Path, ...], of_parent: str, call: bytes) -> Any:
    _prepare(plugin_files, of_parent)
    fn, args, kwargs = pickle.loads(call)
    return fn(*args, **kwargs)


@cache
def _prepare(plugin_files: tuple[Path, ...], of_parent: str) -> None:
    plugins.load(plugin_files)
    pin_blas()
    if (own := arithmetic.identity()) != of_parent:
        raise ConfigError(
            "worker processes compute with another arithmetic than this process, so that last digits would "
            f"differ within one result: '{own}' there, '{of_parent}' here. Import hident before numpy, or "
            "run with --jobs 1"
        )
