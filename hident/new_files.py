"""Files that are there whole or not at all: written beside their place and renamed into it. Folders."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hident.errors import StoreError


def made_folder(path: Path) -> Path:
    """The folder, which is made with those above it if it is not there.

    Raises
    ------
    StoreError
        If it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{path} cannot be made: {(error.strerror or str(error)).lower()}") from None
    return path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """The file to write to, beside ``path``, which takes its place when the block ends without an error.

    Raises
    ------
    StoreError
        If it cannot be written or renamed.

    Examples
    --------
    >>> with replacing(Path("valve.txt")) as new:
    ...     characters = new.write_text("open")
    >>> Path("valve.txt").read_text()
    'open'
    """
    # The ending stays the last: writers choose the format by it.
    temporary = path.with_name(f".part-{path.name}")
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise StoreError(f"{path} cannot be written: {(error.strerror or str(error)).lower()}") from None
    finally:
        temporary.unlink(missing_ok=True)
