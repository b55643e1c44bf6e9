"""The file of ``--log``: a line of JSON for each thing that the logger "hident" is told."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO

from hident.engine.log import LOGGER
from hident.errors import ConfigError


@contextmanager
def logging_to(path: Path | None) -> Iterator[None]:
    """Append to a file, if one is named, what is told meanwhile.

    Lines that cannot be written, as on a full disk, are lost, and a warning at the end says so.

    Raises
    ------
    ConfigError
        If the file cannot be opened.
    """
    if path is None:
        yield
        return
    try:
        # Without a buffer: a line is there as soon as it is told, and closing can lose nothing.
        file = path.open("ab", buffering=0)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ConfigError(f"the log {path} cannot be written ({reason}): --log names another") from None
    handler, level = _JsonLines(file), LOGGER.level
    LOGGER.addHandler(handler)
    LOGGER.setLevel(logging.INFO)
    try:
        yield
    finally:
        LOGGER.setLevel(level)
        LOGGER.removeHandler(handler)
        file.close()
        if handler.lost:
            print(
                f"warning: {handler.lost} lines of the log {path} could not be written ({handler.fault})",
                file=sys.stderr,
            )


class _JsonLines(logging.Handler):
    """Writes each record as one line; ``lost`` counts those that could not be written, ``fault`` says why."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__()
        self._file = file
        self.lost, self.fault = 0, ""

    def emit(self, record: logging.LogRecord) -> None:
        line = json.dumps(
            {
                "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
                "level": record.levelname.lower(),
                **getattr(record, "hident", {}),
                "message": record.getMessage(),
            },
            default=str,
        )
        try:
            self._file.write(f"{line}\n".encode())
        except OSError as error:
            self.lost, self.fault = self.lost + 1, (error.strerror or str(error)).lower()
