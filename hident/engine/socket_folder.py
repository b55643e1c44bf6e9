"""Preloaded by the process that forks the workers: at its end it takes the folder of its socket away.

The process that started it does so too, unless it was killed. By then all that use the socket have ended.
"""

import atexit
import shutil
from multiprocessing import forkserver
from pathlib import Path


def _remove() -> None:
    address = forkserver._forkserver._forkserver_address  # type: ignore[attr-defined]
    if isinstance(address, str) and (folder := Path(address).parent).name.startswith("pymp-"):
        shutil.rmtree(folder, ignore_errors=True)


atexit.register(_remove)
