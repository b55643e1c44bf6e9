"""Seconds and peak memory against the number of samples, each size in a process of its own."""

from __future__ import annotations

import json
import math
import resource
import statistics
import subprocess
import sys

from tests.benchmarks.timing import figure, seconds, show

_ESTIMATORS = {"kernel (4)": (0, 7), "kernel, filtered (15)": (1, 7), "trigonometric series (7)": (2, 6)}
"""Place in mzyk_table1, and the largest size as a power of ten."""
_SECONDS = 0.5
_FEWEST, _MOST = 3, 100


def main() -> None:
    for name, (job, largest) in _ESTIMATORS.items():
        sizes = [10**power for power in range(3, largest + 1)]
        found = [measured(job, size) for size in sizes]
        times = [time for time, _ in found]
        figure(f"exponent of N from 1e4 on: {name}", [exponent(sizes[1:], times[1:])], "1.1")
        figure(f"{name}: peak MiB at N = {sizes[-1]:.0e}", [found[-1][1] / 2**20], "1024")
        rows = [
            [f"{size:.0e}", f"{time:.3g}", f"{1e9 * time / size:.0f}", f"{peak / 2**20:.0f}", each]
            for size, (time, peak), each in zip(
                sizes, found, per_sample(sizes, [peak for _, peak in found]), strict=True
            )
        ]
        show(
            f"Scaling: {name}",
            ("N", "seconds", "ns/sample", "peak MiB", "bytes/sample"),
            rows,
            (
                f"seconds grow like N^{exponent(sizes, times):.2f}, from N = 1e4 on like "
                f"N^{exponent(sizes[1:], times[1:]):.2f} (aim: at most 1.1)",
            ),
        )
    print(
        "  seconds: fit and evaluation at the samples, least of 3 or more.\n"
        "  peak: resident set (ru_maxrss) of a process that runs one whole trial (data, fit, metric);\n"
        "  bytes/sample: what each sample adds to it. aim: O(N), and less than 1024 MiB at N = 1e7"
    )


def exponent(sizes: list[int], times: list[float]) -> float:
    """The slope of log time on log N."""
    return statistics.linear_regression([*map(math.log, sizes)], [*map(math.log, times)]).slope


def per_sample(sizes: list[int], peaks: list[int]) -> list[str]:
    """Bytes that each sample adds to the process of the smallest size; from 1e5 on, where they show."""
    return [
        f"{(peak - peaks[0]) / size:.0f}" if size >= 10**5 else ""
        for size, peak in zip(sizes, peaks, strict=True)
    ]


def measured(job: int, size: int) -> tuple[float, int]:
    """Seconds and peak bytes, from a child."""
    command = [sys.executable, "-m", "tests.benchmarks.scaling", str(job), str(size)]
    answer = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    time, peak = json.loads(answer)
    return time, peak


def measure(job: int, size: int) -> tuple[float, int]:
    """Seconds of fit and evaluation, and the peak bytes of this process after one trial."""
    import numpy as np

    from hident.engine.trial import generate, run_trials
    from hident.engine.work import pin_blas
    from hident.records import Record
    from tests.benchmarks.table1 import cases

    pin_blas()
    data, jobs = cases("figures={}", f"cases.samples=[{size}]")[0]
    [outcome] = run_trials(data, [jobs[job]], [[0]], 1)
    assert all(np.isfinite(scores.values).all() for scores in outcome.scores)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)

    record, rng = generate(data, 1, 0), np.random.default_rng(1)

    def fit_and_evaluate() -> None:
        samples = Record(record.u, record.y)
        found = jobs[job].estimator.fit(samples, rng).nonlinearity
        assert found is not None
        found(samples.u[samples.order])

    fit_and_evaluate()
    times: list[float] = []
    while len(times) < _FEWEST or (sum(times) < _SECONDS and len(times) < _MOST):
        times.append(seconds(fit_and_evaluate))
    return min(times), peak


if __name__ == "__main__":
    print(json.dumps(measure(int(sys.argv[1]), int(sys.argv[2]))))
