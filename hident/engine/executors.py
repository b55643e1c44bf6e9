"""Where chunks of trials run: any ``concurrent.futures.Executor`` will do.

BLAS is held to one thread everywhere, the serial executor included, so that the same bytes come out of every
executor and every number of workers on one machine.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, TypeVar

from hident import plugins

T = TypeVar("T")


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


def make_executor(workers: int, plugin_files: Iterable[Path] = ()) -> Executor:
    """A serial executor for one worker, else a pool of processes."""
    if workers == 1:
        return SerialExecutor()
    # Workers are started afresh: forking a process with threads (BLAS, a progress bar) may deadlock.
    method = "spawn" if sys.platform == "win32" else "forkserver"
    context = multiprocessing.get_context(method)
    if method == "forkserver":
        context.set_forkserver_preload(["hident.engine.trial"])
    return ProcessPoolExecutor(
        workers, mp_context=context, initializer=_start_worker, initargs=(tuple(plugin_files),)
    )


def usable_cores() -> int:
    """The cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def pin_blas() -> None:
    """Hold all BLAS libraries of this process to one thread."""
    import scipy.linalg  # noqa: F401  (its BLAS must be loaded to be held)
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)


def _start_worker(plugin_files: tuple[Path, ...]) -> None:
    # Ctrl-C is for the parent, which lets the chunks in flight finish.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    plugins.load(plugin_files)
    pin_blas()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
