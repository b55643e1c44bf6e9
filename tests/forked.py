"""The program in a fork of the process of the tests, which has imported everything that is slow to import.

A run has its own process, arguments, folder, environment, streams and components, as if started anew, in a
tenth of the processor time; so have its workers, and the process that forks them. What a start itself does is
not tested by it: the libraries are loaded, and the components of the test modules are registered.
"""

from __future__ import annotations

import atexit
import contextlib
import faulthandler
import functools
import gc
import multiprocessing
import os
import pickle
import re
import signal
import socket
import subprocess
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Mapping, Sequence
from multiprocessing import forkserver, resource_tracker, util
from pathlib import Path
from typing import IO, Any, NoReturn

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
    """The program on its way, in a process group of its own; methods are those of ``subprocess.Popen``.

    With ``fresh_workers`` the process that forks its workers is started anew, which takes a second or more.
    """

    def __init__(
        self,
        arguments: Sequence[str],
        cwd: Path,
        out: IO[bytes],
        err: IO[bytes],
        env: Mapping[str, str] | None = None,
        preexec_fn: Callable[[], object] = lambda: None,
        *,
        fresh_workers: bool = False,
    ) -> None:
        _prepare()
        environment = dict(os.environ if env is None else env)
        self._code: int | None = None
        with warnings.catch_warnings():
            # A fork of a process with threads: those of BLAS and of xdist do not count in the child.
            warnings.simplefilter("ignore", DeprecationWarning)
            self.pid = os.fork()
        if self.pid == 0:
            _become(arguments, cwd, environment, preexec_fn, (out, err), fresh_workers)

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
    fresh_workers: bool,
) -> NoReturn:
    """Be the program, and end as it ends: nothing of the tests goes on in this process."""
    code = 99
    # What the tests have left to collect has descriptors, whose numbers are others' here.
    gc.freeze()
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
        if _WITH_WORKERS.search(" ".join(arguments)) and not fresh_workers:
            _Spare().stand_in()
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


_WITH_WORKERS = re.compile(r"(--jobs |-j ?)[2-9]")
_STARTS_FORKSERVER = re.compile(r"from multiprocessing\.forkserver import main; main\(\d+, \d+, (.*)\)")


class _Spare:
    """A fork of a program that has not begun, to be the process that forks its workers.

    Until it is wanted it is deaf to signals; it ends when the program does.
    """

    def __init__(self) -> None:
        before = signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        self._program, spare = socket.socketpair()
        self._pid = os.fork()
        if self._pid == 0:
            self._program.close()
            _serve(spare)
        spare.close()
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def stand_in(self) -> None:
        """Take the place of what multiprocessing would start anew."""
        start = util.spawnv_passfds

        def start_or_wake(path: bytes, args: Sequence[Any], passfds: Sequence[int]) -> int:
            call = _STARTS_FORKSERVER.fullmatch(str(args[-1]))
            if call is None or len(passfds) != 2:
                return start(path, args, passfds)
            util.spawnv_passfds = start
            state = call[1], dict(os.environ), signal.pthread_sigmask(signal.SIG_BLOCK, [])
            socket.send_fds(self._program, [pickle.dumps(state)], [*passfds])
            self._program.close()
            return self._pid

        util.spawnv_passfds = start_or_wake


def _serve(program: socket.socket) -> NoReturn:
    """Wait for the program, then fork its workers as a process does that was started for it."""
    code = 1
    try:
        state, passed, _, _ = socket.recv_fds(program, 1 << 20, 2)
        if not state:
            os._exit(0)
        listener, alive = passed
        call, environment, blocked = pickle.loads(state)
        faulthandler.disable()
        atexit._clear()
        for path in [*Path("/proc/self/fd").iterdir()]:
            if int(path.name) not in (0, 1, 2, listener, alive):
                with contextlib.suppress(OSError):
                    os.close(int(path.name))
        os.environ.clear()
        os.environ.update(environment)
        tempfile.tempdir = None
        # What it does when it is imported, it does for this process.
        sys.modules.pop("hident.engine.socket_folder", None)
        for number in signal.sigpending():
            signal.signal(number, signal.signal(number, signal.SIG_IGN))
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        eval(f"forkserver.main({listener}, {alive}, {call})")
    except SystemExit:
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        atexit._run_exitfuncs()
        os._exit(code)


def _stop_the_clock() -> None:
    """On a machine however slow, no run takes so long that it says how far it is."""
    from hident import progress

    progress.Lines = functools.partial(progress.Lines, clock=lambda: 0.0)  # type: ignore[assignment, misc]
