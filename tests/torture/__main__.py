"""``python -m tests.torture``: torture hident, print the counts, exit with 1 if anything is lost or wrong."""

from __future__ import annotations

import argparse
import random
import signal
import sys
import time

from tests.torture import disk, inputs, kills, results, store, together, workers
from tests.torture.victim import Tally

KINDS = {
    module.__name__.rpartition(".")[2]: module
    for module in (inputs, kills, store, disk, together, workers, results)
}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.torture", description=__doc__)
    parser.add_argument("--only", choices=KINDS, action="append", help="one kind; may be repeated")
    parser.add_argument("--count", type=int, help="how many faults of a kind, by its own measure")
    parser.add_argument("--seed", type=int, default=1, help="of the random faults")
    options = parser.parse_args()
    # In the background of a script SIGINT is ignored, under nohup SIGHUP, and so they would be in all that is
    # started here.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    tally = Tally()
    for name in options.only or KINDS:
        start = time.monotonic()
        count = KINDS[name].COUNT if options.count is None else options.count
        # Each kind has the same faults whichever others are asked for.
        KINDS[name].torture(tally, random.Random(f"{options.seed} {name}"), count)
        print(f"{name}: {time.monotonic() - start:.0f} s", file=sys.stderr, flush=True)
    print(tally.table())
    return 0 if tally.sound else 1


if __name__ == "__main__":
    sys.exit(main())
