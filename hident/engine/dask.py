"""Dask's workers: a cluster on this machine, or one that stands, on any machines."""

from __future__ import annotations

import json
import logging
import multiprocessing
import pickle
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from hident import arithmetic
from hident.engine.executors import WorkerDied, Workers, WorkersGone, signals_blocked, unpickled
from hident.engine.work import Call, Terms
from hident.errors import ConfigError

if TYPE_CHECKING:
    from distributed import Client

T = TypeVar("T")
_SECONDS_TO_CONNECT = 10
# How often the workers are counted.
_SECONDS = 1.0
_SHOWN = 3


class DaskExecutor(Workers):
    """The workers of a client; one that dies is no concern of a run until its call has killed several.

    A call is given to other workers by the scheduler, as often as its ``allowed-failures`` says.
    """

    def __init__(self, connect: Callable[[], Client], terms: Terms, *, own: bool) -> None:
        super().__init__(0)
        self._connect, self._terms, self._own = connect, terms, own
        self._client: Any = None
        self._address = ""
        self._counted = 0.0

    @property
    def most(self) -> int:
        """Three for each thread that is there now: one under way, two that wait for it beside it."""
        if time.monotonic() > self._counted + _SECONDS and self._client.status == "running":
            # That the scheduler is gone, the calls that are under way will say.
            with suppress(OSError):
                now = sum(self._client.nthreads().values())
                if self.count and not now:
                    self._tell_of_none()
                self.count = now
            self._counted = time.monotonic()
        return 3 * max(1, self.count)

    def start(self) -> None:
        if self._client is None:
            # Where it starts, it unblocks what was blocked.
            if sys.platform != "win32":
                resource_tracker.ensure_running()
            with signals_blocked(), arithmetic.handed_on():
                self._client = self._connect()
        self._address = self._client.scheduler.address
        if not self._client.nthreads():
            self._tell_of_none()
            self._client.wait_for_workers(1)
        check = pickle.dumps(Call(self._terms, self._terms.met))
        try:
            asked = self._client.run(unpickled, check, on_error="return")
        except OSError as error:
            raise WorkersGone(_gone(self._address, f" ({error})")) from None
        # Whoever has left meanwhile is asked nothing.
        answers = {address: answer for address, answer in asked.items() if not isinstance(answer, OSError)}
        wrong = [
            f"{address}: {answer if isinstance(answer, ConfigError) else _unusable(answer)}"
            for address, answer in answers.items()
            if isinstance(answer, Exception)
        ]
        if wrong:
            more = f"\n(and {len(wrong) - _SHOWN} more workers)" if len(wrong) > _SHOWN else ""
            raise ConfigError("\n".join(wrong[:_SHOWN]) + more)
        for address, theirs in answers.items():
            self.compare(theirs, address)

    def _tell_of_none(self) -> None:
        self.tell(f"the scheduler at {self._address} has no workers: waiting for one")

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        call = pickle.dumps(Call(self._terms, fn, *args, **kwargs))
        future: Future[T] = Future()
        # A worker may have begun it at any time.
        future.set_running_or_notify_cancel()
        theirs = self._client.submit(unpickled, call, pure=False)
        self._client.loop.add_callback(_tell, self._client, theirs, future, self._address)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        if self._own and self._client is not None:
            self._client.close()
            if self._client.cluster is not None:
                self._client.cluster.close()
            self._client = None

    def kill(self) -> None:
        if self._own and self._client is not None and self._client.cluster is not None:
            for nanny in self._client.cluster.workers.values():
                nanny.auto_restart = False
            for worker in multiprocessing.active_children():
                worker.kill()
        self.shutdown()


async def _tell(client: Client, theirs: Any, future: Future[Any], address: str) -> None:
    """Hand on what becomes of a call."""
    from distributed import CancelledError, KilledWorker
    from distributed.comm import CommClosedError

    try:
        future.set_result(await client.gather(theirs, asynchronous=True))
    except KilledWorker as killed:
        future.set_exception(WorkerDied(killed.allowed_failures + 1))
    except (CancelledError, CommClosedError):
        # A client cancels all calls when it loses the scheduler, and when somebody restarts the workers.
        restarted = client.status == "running"
        future.set_exception(WorkerDied(1) if restarted else WorkersGone(_gone(address)))
    except BaseException as error:
        future.set_exception(error)


def _gone(address: str, why: str = "") -> str:
    return f"the scheduler at {address} is gone{why}, and its workers with it"


def _unusable(error: Exception) -> str:
    return f"hident cannot be used there ({error})"


def _be_silent() -> None:
    """What goes wrong in Dask's own threads is told by what becomes of the calls."""
    for name in [*logging.root.manager.loggerDict]:
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL)


def require() -> None:
    """ConfigError if Dask is not installed."""
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise ConfigError("Dask is not installed: pip install 'hident[dask]'") from None


def local(workers: int, terms: Terms) -> Workers:
    """Workers of a cluster on this machine, which ends with them."""
    require()

    def connect() -> Client:
        from distributed import Client, LocalCluster

        _be_silent()
        cluster = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            memory_limit=0,
            silence_logs=logging.CRITICAL,
            # A chunk whose worker died is sent again by the run, as with other processes of this machine.
            # A scheduler without a dashboard listens at port 8787 all the same, if it is not told another.
            scheduler_kwargs={
                "allowed_failures": 0,
                "dashboard": False,
                "dashboard_address": "127.0.0.1:0",
            },
        )
        return Client(cluster, set_as_default=False)

    return DaskExecutor(connect, terms, own=True)


def joined(scheduler: str, terms: Terms) -> Workers:
    """Workers of a cluster that stands: its scheduler's address, or the file that the scheduler wrote."""
    require()
    address = _address(scheduler)

    def connect() -> Client:
        from distributed import Client

        _be_silent()
        try:
            return Client(address, timeout=_SECONDS_TO_CONNECT, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ConfigError(f"--scheduler: {scheduler}: no scheduler answers: {error}") from None

    return DaskExecutor(connect, terms, own=True)


def _address(scheduler: str) -> str:
    from distributed.comm.registry import get_backend

    try:
        address = scheduler
        if "://" not in scheduler:
            address = str(json.loads(Path(scheduler).read_text(encoding="utf-8"))["address"])
        get_backend(address.partition("://")[0])
    except (OSError, ValueError, TypeError, LookupError) as error:
        raise ConfigError(
            "--scheduler: must be an address such as tcp://host:8786, or the file of a scheduler (got "
            f"'{scheduler}': {error})"
        ) from None
    return address


def is_client(executor: object) -> bool:
    """Whether it is a client of Dask's."""
    distributed = sys.modules.get("distributed")
    return distributed is not None and isinstance(executor, distributed.Client)
