"""Seconds of commands that compute nothing."""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

from tests.benchmarks.timing import figure, seconds, show

_RUNS = 5


def main() -> None:
    config = "configs/mzyk_table1.yaml"
    with tempfile.TemporaryDirectory() as folder:
        place = ["--out", str(Path(folder, "out")), "--store", str(Path(folder, "store")), "--quiet"]
        hident("run", config, *place)
        commands = {
            "hident --help": (["--help"], 0.3),
            f"hident validate {config}": (["validate", config], 1.0),
            f"hident run {config}, all trials stored": (["run", config, *place], 1.5),
        }
        rows = []
        for name, (arguments, aim) in commands.items():
            taken = [seconds(partial(hident, *arguments)) for _ in range(_RUNS)]
            figure(f"{name}: seconds", taken, f"{aim:.1f}")
            rows.append([name, f"{statistics.median(taken):.2f}", f"{min(taken):.2f}", f"{aim:.1f}"])
    show(f"Start-up, seconds (of {_RUNS} runs)", ("command", "median", "least", "aim"), rows, ())


def hident(*arguments: str) -> None:
    """Run the command line in a process of its own."""
    subprocess.run([sys.executable, "-m", "hident", *arguments], check=True, stdout=subprocess.DEVNULL)
