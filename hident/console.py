"""Standard streams that end no program: what cannot be shown is lost, and the work goes on.

A reader that has gone (``| head``), a stream that was closed, a full disk or an encoding without the letter
must not cost what was computed, nor turn an exit code into another.
"""

from __future__ import annotations

import io
import os
import select
import sys
from errno import EPIPE
from typing import Any


class _Lossy(io.FileIO):
    """A file descriptor whose faults are remembered instead of raised."""

    fault: OSError | None = None

    def write(self, data: Any) -> int:
        """Write, or lose, all of the data."""
        left = memoryview(data).cast("B")
        size = len(left)
        try:
            while left:
                written = super().write(left)
                if written is None:
                    # It does not wait by itself, as a terminal that another program has set up so.
                    select.select([], [self], [])
                left = left[written or 0 :]
        except OSError as error:
            self.fault = error
        return size


class _Lasting(io.TextIOWrapper):
    """A stream that no component can close: messages come after its trials."""

    def close(self) -> None:
        """Only flush."""
        self.flush()


def harden() -> None:
    """Let writing to standard output and standard error never fail, for the rest of this process."""
    _fill()
    sys.stdout = _hardened(sys.stdout, 1)
    sys.stderr = _hardened(sys.stderr, 2)


def fault() -> str:
    """Why standard output could not be written; empty if it could, or if its reader has gone."""
    try:
        sys.stdout.flush()
    except OSError as error:
        return (error.strerror or str(error)).lower()
    raw = _raw(sys.stdout)
    found = raw.fault if isinstance(raw, _Lossy) else None
    return "" if found is None or found.errno == EPIPE else (found.strerror or str(found)).lower()


def _fill() -> None:
    """Give a closed standard stream a place, so that no file of the run gets its number."""
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)


def _raw(stream: Any) -> Any:
    """What a stream writes to; without a buffer between, if Python was told so."""
    buffer = getattr(stream, "buffer", None)
    return getattr(buffer, "raw", buffer)


def _hardened(stream: Any, descriptor: int) -> Any:
    if stream is None:
        return _Lasting(io.BufferedWriter(_lossy(descriptor)), "utf-8", line_buffering=True)
    if type(_raw(stream)) is not io.FileIO:
        # Such as a console of Windows, which takes letters instead of bytes.
        stream.reconfigure(errors="backslashreplace")
        return stream
    stream.flush()
    raw = _lossy(_raw(stream).fileno())
    return _Lasting(
        raw if _raw(stream) is stream.buffer else io.BufferedWriter(raw),
        stream.encoding,
        "backslashreplace",
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )


def _lossy(descriptor: int) -> Any:
    return _Lossy(descriptor, "w", closefd=False)
