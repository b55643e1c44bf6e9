"""Trials per second of Table I against a plain loop, and against the library calls that it takes at least."""

from __future__ import annotations

import numpy as np

from hident.engine.trial import Data, Job
from hident.engine.work import pin_blas
from tests.benchmarks import floor, plain
from tests.benchmarks.table1 import cases, scores
from tests.benchmarks.timing import figure, interleaved, seconds, show

_SEED = 2009
_ROUNDS = 15
_SHARE = 0.05
"""Seconds of a turn, for each of the fast two."""


def main() -> None:
    pin_blas()
    show(
        "Trials per second of mzyk_table1, one process (all three give the same numbers to 1e-9)",
        ("N", "hident", "floor", "plain", "hident/floor time", "plain/hident time"),
        [row(data, jobs) for data, jobs in cases()],
        (
            "floor: the library calls of each estimate on bare arrays. plain: as the paper prints it.",
            "aim: at most 2 floors for N >= 1000; the plain loop takes at least 20 times as long at N = 3000",
        ),
    )


def row(data: Data, jobs: list[Job]) -> list[str]:
    """The line of one case."""
    burn_in = data.system.burn_in()
    check(data, jobs, burn_in)
    count = max(3, int(_SHARE / seconds(lambda: scores(data, jobs, _SEED, range(1)))))
    taken = interleaved(
        {
            "hident": lambda: scores(data, jobs, _SEED, range(count)),
            "floor": lambda: [floor.trial(data, _SEED, i, burn_in) for i in range(count)],
            "plain": lambda: plain.trial(data, _SEED, 0),
        },
        _ROUNDS,
    )
    ours, least, loop = taken["hident"] / count, taken["floor"] / count, taken["plain"]
    of = f"trial of mzyk_table1, N = {data.samples}"
    figure(f"{of}: over the floor", taken.ratios("hident", "floor"), "2" if data.samples >= 1000 else "3")
    figure(f"{of}: plain way over hident", [one * count for one in taken.ratios("plain", "hident")])
    return [
        str(data.samples),
        *(f"{1.0 / time:.0f}" for time in (ours, least)),
        f"{1.0 / loop:.1f}",
        f"{ours / least:.2f}",
        f"{loop / ours:.0f}",
    ]


def check(data: Data, jobs: list[Job], burn_in: int) -> None:
    """Raise AssertionError unless all three ways give the same numbers."""
    for number, ours in enumerate(scores(data, jobs, _SEED, range(2))):
        for other in (plain.trial(data, _SEED, number), floor.trial(data, _SEED, number, burn_in)):
            np.testing.assert_allclose(other, ours, rtol=1e-9, atol=1e-9)
