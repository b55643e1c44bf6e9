"""The program in a fork of the process of the tests, which has imported everything that is slow to import.

A run has its own process, arguments, folder, environment, streams and components, as if started anew, in a
tenth of the processor time. What a start itself does is not tested by it: the libraries are loaded, and the
components of the test modules are registered.
"""

from __future__ import annotations

import functools
import os
import signal
import subprocess
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, NoReturn

# No test waits for this; it ends what would hang for ever.
GUARD_SECONDS = 900


def run_forked(
    arguments: Sequence[str],
    cwd: Path,
    env: Mapping[str, str] | None = None,
    preexec_fn: Callable[[], object] = lambda: None,
) -> subprocess.CompletedProcess[str]:
    """Run the program to its end; the options are those of ``subprocess.run``."""
    _import_what_is_slow()
    environment = dict(os.environ if env is None else env)
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        with warnings.catch_warnings():
            # A fork of a process with threads: those of BLAS and of xdist do not count in the child.
            warnings.simplefilter("ignore", DeprecationWarning)
            child = os.fork()
        if child == 0:
            _become(arguments, cwd, environment, preexec_fn, (out, err))
        _, status = os.waitpid(child, 0)
        said = []
        for file in (out, err):
            file.seek(0)
            said.append(file.read().decode())
    return subprocess.CompletedProcess(list(arguments), os.waitstatus_to_exitcode(status), *said)


@functools.cache
def _import_what_is_slow() -> None:
    import matplotlib.pyplot  # noqa: F401
    import pandas  # noqa: F401
    import rich.progress  # noqa: F401
    import scipy.optimize
    import scipy.signal
    import scipy.stats  # noqa: F401

    import hident.commands  # noqa: F401
    from hident import plugins

    plugins.load()


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
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        for descriptor, file in enumerate(files, start=1):
            os.dup2(file.fileno(), descriptor)
        sys.stdin, sys.stdout, sys.stderr = (
            open(descriptor, mode, encoding="utf-8", closefd=False)  # noqa: SIM115
            for descriptor, mode in ((0, "r"), (1, "w"), (2, "w"))
        )
        os.environ.clear()
        os.environ.update(env)
        os.chdir(cwd)
        _warn_as_python_does()
        _stop_the_clock()
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
            stream.flush()
        os._exit(code)


def _warn_as_python_does() -> None:
    """Not as the tests, in which every warning is an error."""
    warnings.resetwarnings()
    for kind in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
        warnings.simplefilter("ignore", kind)


def _stop_the_clock() -> None:
    """On a machine however slow, no run takes so long that it says how far it is."""
    from hident import progress

    progress.Lines = functools.partial(progress.Lines, clock=lambda: 0.0)  # type: ignore[assignment, misc]
