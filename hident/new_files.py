"""Files that are there whole or not at all: written beside their place, and renamed into it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hident.errors import StoreError


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
