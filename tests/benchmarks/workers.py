"""Two workers against one."""

from __future__ import annotations

import tempfile
from pathlib import Path

from tests.benchmarks.startup import hident
from tests.benchmarks.timing import interleaved, show

_TRIALS = 4000
_ROUNDS = 2


def main() -> None:
    taken = interleaved({"1": lambda: run(1), "2": lambda: run(2)}, _ROUNDS)
    show(
        f"hident run, {_TRIALS} trials of mzyk_table1 with N = 3000, start-up and tables included",
        ("workers", "seconds", "speed-up"),
        [[workers, f"{time:.1f}", f"{taken['1'] / time:.2f}"] for workers, time in taken.items()],
        ("aim: 1.7 with 2 workers on 2 idle cores",),
    )


def run(workers: int) -> None:
    """Compute all trials, with an empty store."""
    with tempfile.TemporaryDirectory() as folder:
        hident(
            *("run", "configs/mzyk_table1.yaml", "--quiet"),
            *("--set", "figures={}", "--set", "cases.samples=[3000]"),
            *("--trials", str(_TRIALS), "--jobs", str(workers)),
            *("--out", str(Path(folder, "out")), "--store", str(Path(folder, "store"))),
        )
