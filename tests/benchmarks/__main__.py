"""``python -m tests.benchmarks [NAME ...]``: the benchmarks named, all by default."""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path

from tests.benchmarks.summary import finish
from tests.benchmarks.timing import FIGURES

# Those with peak memory come early: a child's begins at what its parent holds when it starts.
_ALL = ("startup", "scaling", "two_stage", "chen", "brouri", "records", "workers", "many_trials", "trials")


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks", description="Measure speed and memory."
    )
    parser.add_argument("what", nargs="*", choices=(*_ALL, "all"), default="all")
    what = parser.parse_args().what
    for name in _ALL if "all" in what else what:
        importlib.import_module(f"tests.benchmarks.{name}").main()
    finish(FIGURES, Path("results"))


if __name__ == "__main__":
    main()
