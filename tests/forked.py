"""The program in a fork of the process of the tests, which has imported everything that is slow to import.

A run has its own process, arguments, folder, environment, streams and components, as if started anew, in a
tenth of the processor time. What a start itself does is not tested by it: the libraries are loaded, and the
components of the test modules are registered.
"""

from __future__ import annotations

import contextlib
import functools
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Mapping, Sequence
from multiprocessing import forkserver, resource_tracker
from pathlib import Path
from typing import IO, NoReturn

# No test waits for this; it ends what would hang for ever.
GUARD_SECONDS = 900
ROOT = Path(__file__).parents[1]


def run_forked(
    arguments: Sequence[str],
    cwd: Path,
    env: Mapping[str, str] | None = None,
    preexec_fn: Callable[[], object] = lambda: None,
) -> subprocess.CompletedProcess[str]:
    """Run the program to its end; the options are those of ``subprocess.run``."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        code = Forked(arguments, cwd, out, err, env, preexec_fn).wait()
        said = []
        for file in (out, err):
            file.seek(0)
            said.append(file.read().decode())
    return subprocess.CompletedProcess(list(arguments), code, *said)


class Forked:
    """The program on its way, in a process group of its own; methods are those of ``subprocess.Popen``."""

    def __init__(
        self,
        arguments: Sequence[str],
        cwd: Path,
        out: IO[bytes],
        err: IO[bytes],
        env: Mapping[str, str] | None = None,
        preexec_fn: Callable[[], object] = lambda: None,
    ) -> None:
        _prepare()
        environment = dict(os.environ if env is None else env)
        self._code: int | None = None
        with warnings.catch_warnings():
            # A fork of a process with threads: those of BLAS and of xdist do not count in the child.
            warnings.simplefilter("ignore", DeprecationWarning)
            self.pid = os.fork()
        if self.pid == 0:
            _become(arguments, cwd, environment, preexec_fn, (out, err))

    def poll(self) -> int | None:
        if self._code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self._code = os.waitstatus_to_exitcode(status) if pid else None
        return self._code

    def wait(self) -> int:
        if self._code is None:
            self._code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self._code

    def kill(self) -> None:
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)


@functools.cache
def _prepare() -> None:
    """Import what is slow to import, and read once the source code of which the program makes its keys."""
    import matplotlib.pyplot  # noqa: F401
    import pandas  # noqa: F401
    import rich.progress  # noqa: F401
    import scipy.optimize
    import scipy.signal
    import scipy.stats  # noqa: F401

    import hident.commands.listing
    import hident.commands.running
    import hident.progress  # noqa: F401
    from hident import plugins
    from hident.engine.experiment import load
    from hident.reports.output import Outputs

    plugins.load()
    Outputs(load(ROOT / "configs/mzyk_table1.yaml"), ROOT).key  # noqa: B018


def _become(
    arguments: Sequence[str],
    cwd: Path,
    env: dict[str, str],
    preexec_fn: Callable[[], object],
    files: tuple[IO[bytes], IO[bytes]],
) -> NoReturn:
    """Be the program, and end as it ends: nothing of the tests goes on in this process."""
    code = 99
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(GUARD_SECONDS)
        os.setsid()
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        for descriptor, file in enumerate(files, start=1):
            os.dup2(file.fileno(), descriptor)
        encoding = env.get("PYTHONIOENCODING", "utf-8")
        sys.stdin, sys.stdout, sys.stderr = (
            # Standard error by lines, as Python has it.
            open(descriptor, mode, 1 if descriptor == 2 else -1, encoding=encoding, closefd=False)  # noqa: SIM115
            for descriptor, mode in ((0, "r"), (1, "w"), (2, "w"))
        )
        os.environ.clear()
        os.environ.update(env)
        os.chdir(cwd)
        _warn_as_python_does()
        _stop_the_clock()
        _forget_helpers()
        preexec_fn()
        sys.argv = ["hident", *arguments]
        from hident.cli import main

        main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 98
    except BaseException:
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            # An estimator may have closed it.
            with contextlib.suppress(ValueError):
                stream.flush()
        os._exit(code)


def _warn_as_python_does() -> None:
    """Not as the tests, in which every warning is an error."""
    warnings.resetwarnings()
    for kind in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
        warnings.simplefilter("ignore", kind)


def _forget_helpers() -> None:
    """The processes by which multiprocessing starts others are no children of this one: it has its own.

    So is the folder of their sockets.
    """
    multiprocessing.current_process()._config.pop("tempdir", None)  # type: ignore[attr-defined]
    forkserver._forkserver.__init__()  # type: ignore[misc]
    resource_tracker._resource_tracker.__init__()  # type: ignore[misc]


def _stop_the_clock() -> None:
    """On a machine however slow, no run takes so long that it says how far it is."""
    from hident import progress

    progress.Lines = functools.partial(progress.Lines, clock=lambda: 0.0)  # type: ignore[assignment, misc]
