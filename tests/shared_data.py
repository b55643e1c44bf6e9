"""Public records that are not committed: they lie in a folder ``shared/data`` beside the repository."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


def measured(name: str) -> Path:
    """The file of a public record; the test is skipped where it is not there."""
    for folder in ROOT.parents:
        if (path := folder / "shared" / "data" / name).is_file():
            return path
    pytest.skip(f"the public record {name} is not here (shared/data beside the repository)")
