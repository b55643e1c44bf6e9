"""A site on this machine alone, made again when what it is made of changes: ``hident report --serve``."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from hident.errors import ConfigError, HidentError

HOST = "127.0.0.1"
PORT = 8000
_SECONDS = 1.0
"""Between two looks at the files."""

State = dict[Path, tuple[int, int]]
"""The size and the time of the last change of files."""


class _Handler(SimpleHTTPRequestHandler):
    """Files of one folder: no lists of them, none that is hidden, and nothing that a link leads out to."""

    def __init__(self, *arguments: Any, directory: Path) -> None:
        self._site = directory.resolve()
        super().__init__(*arguments, directory=str(self._site))

    def send_head(self) -> Any:
        # Another name would be that of a page elsewhere whose address was turned to this machine.
        host = self.headers.get("Host", "").rpartition(":")[0] or self.headers.get("Host", "")
        if host not in (HOST, "localhost"):
            self.send_error(HTTPStatus.FORBIDDEN)
            return None
        try:
            path = Path(self.translate_path(self.path)).resolve()
            inside = path.relative_to(self._site)
        except (OSError, ValueError):
            inside = None
        if inside is None or any(part.startswith(".") for part in inside.parts):
            self.send_error(HTTPStatus.NOT_FOUND)
            return None
        return super().send_head()

    def list_directory(self, path: Any) -> Any:
        self.send_error(HTTPStatus.NOT_FOUND)

    def end_headers(self) -> None:
        # What is made again is seen when the page is loaded again.
        self.send_header("Cache-Control", "no-cache")
        super().end_headers()

    def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002
        """Say nothing of what is asked for."""


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    # On some systems two servers could share a port, and each get some of the requests.
    allow_reuse_address = sys.platform != "win32"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a browser that went away."""


def serve(make: Callable[[], object], watched: Iterable[Path], site: Path, port: int) -> None:
    """Make a site and serve it, and make it again when files change, until Ctrl-C is pressed.

    What cannot be made again, such as while a run is writing, is said, and the site stays as it was.

    ConfigError if the port cannot be had (0 is any that is free); whatever the first making raises.
    """
    try:
        server = _Server((HOST, port), partial(_Handler, directory=site))
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ConfigError(
            f"--port {port}: cannot be used ({reason}): name another one, or 0 for any that is free"
        ) from None
    with server:
        changes = _changes(tuple(watched), site)
        next(changes)
        make()
        with _answering(server), suppress(KeyboardInterrupt):
            address = f"http://{HOST}:{server.server_port}/"
            print(f"{address} (made again when its sources change; Ctrl-C ends it)", flush=True)
            for _ in changes:
                try:
                    make()
                except (HidentError, OSError) as error:
                    print(f"error: {error}", file=sys.stderr)
                # A log file shows at once what became of a change.
                sys.stdout.flush()
                sys.stderr.flush()
    print("ended")


@contextmanager
def _answering(server: _Server) -> Iterator[None]:
    """Answer what is asked of the server, in a thread of its own, inside the block."""
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
    thread.start()
    try:
        yield
    finally:
        server.shutdown()
        thread.join()


def _changes(watched: tuple[Path, ...], site: Path) -> Iterator[None]:
    """Yield at once, and then each time that files have changed and come to rest."""
    made_of = last = state(watched, site)
    yield
    while True:
        time.sleep(_SECONDS)
        now = state(watched, site)
        if now == last and now != made_of:
            made_of = now
            yield
        last = now


def state(watched: Iterable[Path], site: Path) -> State:
    """The size and time of the files in some folders, but of those of the site, and of what is hidden.

    Looked at, not told by the system: what another machine writes to a shared disk is told by no system.
    """
    found: State = {}
    for root in watched:
        for folder, folders, files in os.walk(root):
            folders[:] = [name for name in folders if not name.startswith(".") and Path(folder, name) != site]
            for path in (Path(folder, name) for name in files if not name.startswith(".")):
                with suppress(OSError):
                    of_file = path.stat()
                    found[path] = of_file.st_size, of_file.st_mtime_ns
    return found
