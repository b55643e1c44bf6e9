"""The signals that end a run: SIGTERM and SIGHUP do it as Ctrl-C does.

Batch systems, service managers and terminals that close send them. What is in flight is stored, the workers
end, and the exit code says which signal it was.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

# Windows has no SIGHUP.
_OTHERS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
SIGNALS = (signal.SIGINT, *_OTHERS)
_received: list[int] = []
_waiting: list[threading.Event] = []


def listen() -> None:
    """Treat SIGTERM and SIGHUP as Ctrl-C from now on; one that is ignored, as by nohup, stays so."""
    if not _in_main_thread():
        return
    for number in _OTHERS:
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _interrupt)


def may_interrupt() -> bool:
    """Whether Ctrl-C and its like can raise KeyboardInterrupt here: in no worker, and in no other thread."""
    return _in_main_thread() and any(callable(signal.getsignal(number)) for number in SIGNALS)


def ignore() -> None:
    """Let none of the signals disturb the end of this process."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def postponed() -> Iterator[None]:
    """Let a signal that comes inside be dealt with when this is over.

    Blocking it in this thread is not enough: another one may take it, and Python deals with it in this one.
    """
    if not _in_main_thread():
        yield
        return
    came: list[int] = []
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    before = {number: handler for number, handler in handlers.items() if callable(handler)}
    for number in before:
        signal.signal(number, lambda number, frame: came.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in came[:1]:
            signal.raise_signal(number)


@contextmanager
def deferred() -> Iterator[threading.Event]:
    """The first signal sets the event instead of raising KeyboardInterrupt; the next one raises it."""
    event = threading.Event()
    before = signal.getsignal(signal.SIGINT)
    if not _in_main_thread() or before not in (signal.default_int_handler, signal.SIG_IGN):
        yield event
        return
    if before is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, _end)
    _waiting.append(event)
    try:
        yield event
    finally:
        _waiting.clear()
        signal.signal(signal.SIGINT, before)


def exit_code() -> int:
    """128 and the number of the signal that came first, as shells have it; that of Ctrl-C if none did."""
    return 128 + (_received[0] if _received else signal.SIGINT)


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


def _interrupt(number: int, frame: FrameType | None) -> None:
    _received.append(number)
    handler = signal.getsignal(signal.SIGINT)
    # A shell lets this process ignore Ctrl-C in the background of a script, and this one not.
    (handler if callable(handler) else _end)(signal.SIGINT, frame)


def _end(number: int, frame: FrameType | None) -> None:
    if not _waiting:
        raise KeyboardInterrupt
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    _waiting.pop().set()
