"""Octave, which runs the sources for MATLAB where it is installed."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.forked import GUARD_SECONDS

_OCTAVE = shutil.which("octave-cli") or shutil.which("octave")
needs_octave = pytest.mark.skipif(_OCTAVE is None, reason="Octave is not installed: apt-get install octave")


def printed(folder: Path, program: str) -> list[str]:
    """The lines that Octave prints of a program, with the functions that stand in the folder."""
    (folder / "all_of_it.m").write_text(program, encoding="utf-8")
    done = subprocess.run(
        [str(_OCTAVE), "--norc", "--quiet", "all_of_it.m"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=GUARD_SECONDS,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()
