"""Preloaded by the process that forks the workers: at its end it takes its socket away, and the folder of it.

The process that started it does so too, unless it was killed. By then all that use the socket have ended. The
folder stays where it holds anything else: a process that was forked from another one shares it with that.
"""

import atexit
from contextlib import suppress
from multiprocessing import forkserver
from pathlib import Path


def _remove() -> None:
    address = forkserver._forkserver._forkserver_address  # type: ignore[attr-defined]
    if isinstance(address, str) and Path(address).parent.name.startswith("pymp-"):
        with suppress(OSError):
            Path(address).unlink(missing_ok=True)
            Path(address).parent.rmdir()


atexit.register(_remove)
