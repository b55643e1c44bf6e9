"""Both two-stage algorithms of Chen, Hwang and Chang 2009: speed, and what a longer record costs."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from hident import plugins
from hident.arrays import Array
from hident.engine.experiment import load
from hident.engine.trial import Data, generate
from hident.engine.work import pin_blas
from hident.estimators.moving_horizon.hammerstein.iterative_hammerstein import IterativeHammerstein
from hident.estimators.moving_horizon.iterative import IterativeSpec
from hident.estimators.moving_horizon.transform.linear_transform import SecondStageSpec, StageSpec
from hident.estimators.moving_horizon.transform.time_weighted import Horizons, Knots
from hident.records import Record
from tests.benchmarks import chen_plain
from tests.benchmarks.scaling import exponent, per_sample
from tests.benchmarks.timing import figure, least, seconds, show

_TABLE_1, _TABLE_2 = Path("configs/chen_table1.yaml"), Path("configs/chen_table2.yaml")
_SEED = 2009
_ROUNDS = 9
_PLAIN_ROUNDS = 3
_CLOSE = 0.05
"""Without noise the plain way differs by its quadrature alone, and by less than this."""
_SIZES = [10**3, 10**4, 10**5, 10**6]
_PARTITION = (-0.5, 0.5)


def main() -> None:
    scaling()
    pin_blas()
    plugins.load()
    cases = {
        "Hammerstein, Table 1: cases A, B, C": estimators(_TABLE_1, {"type": "I"}),
        "Wiener, Table 2: case E": estimators(_TABLE_2, {"case": "E"}),
    }
    show(
        "One trial of chen_table1 and of chen_table2, data given, partition points searched: milliseconds",
        ("", "solves", "hident", "QR", "lstsq", "plain", "hident/QR", "hident/lstsq", "plain/hident"),
        [row(name, *case) for name, case in cases.items()],
        (
            "processor time, least of several turns.",
            "solves: least-squares problems in the trial, one for each pair and iteration.",
            "QR: their factorisations alone, as hident compresses and stacks them.",
            "lstsq, the floor: numpy.linalg.lstsq alone, one call for each of these.",
            "plain: each integral (18) anew by Simpson's rule for each pair, iteration and horizon.",
            "aim: at most 3 floors; the plain way takes at least 15 times as long;",
            "40 ms (Hammerstein) and 120 ms (Wiener) on an idle core",
        ),
    )


def estimators(config: Path, labels: dict[str, str]) -> tuple[Data, list[IterativeSpec]]:
    """The data of the case with the ``labels``, and its estimators."""
    units = [unit for unit in load(config, ()).units if unit.is_at(labels)]
    specs = [unit.estimator for unit in units if isinstance(unit.estimator, IterativeSpec)]
    return units[0].data, specs


def row(name: str, data: Data, specs: list[IterativeSpec]) -> list[str]:
    """The line of one kind of trial."""
    check(data.model_copy(update={"noise": ()}), specs)
    record = generate(data, _SEED, 0)
    problems = factored(record, specs)
    taken = least(
        {
            "hident": lambda: fit(record, specs),
            "QR": lambda: [np.linalg.qr(stack, mode="r") for stack in problems],
            "lstsq": lambda: [solved(stack) for stack in problems],
        },
        _ROUNDS,
    )
    taken = taken.joined(least({"plain": lambda: plain(record, specs)}, _PLAIN_ROUNDS))
    figure(f"{name}: over the floor", taken.ratios("hident", "lstsq"), "3")
    figure(f"{name}: plain way over hident", taken.ratios("plain", "hident"), "15")
    ours = taken["hident"]
    return [
        name,
        str(sum(len(stack) for stack in problems)),
        *(f"{1e3 * time:.1f}" for time in taken.values()),
        *(f"{ours / taken[other]:.2f}" for other in ("QR", "lstsq")),
        f"{taken['plain'] / ours:.0f}",
    ]


def fit(record: Record, specs: list[IterativeSpec]) -> list[dict[str, float]]:
    """The estimates of one trial."""
    rng = np.random.default_rng(_SEED)
    return [dict(spec.fit(record, rng).values) for spec in specs]


def plain(record: Record, specs: list[IterativeSpec]) -> list[chen_plain.Values]:
    """The same estimates, the plain way."""
    assert record.dt is not None
    found = []
    for spec in specs:
        delay, start = round(spec.delay / record.dt), round(spec.start / record.dt)
        data = chen_plain.Data(record.u, record.y, record.dt, delay, start)
        assert spec.second is not None
        stages = stage(spec.first), stage(spec.second)
        if isinstance(spec, IterativeHammerstein):
            degree = getattr(spec.nonlinearity, "degree", None)
            found.append(chen_plain.hammerstein(data, *stages, degree))
        else:
            found.append(chen_plain.wiener(data, *stages))
    return found


def stage(spec: StageSpec | SecondStageSpec) -> chen_plain.Stage:
    """A stage as the plain way takes it; the second one's horizon follows from the first."""
    assert spec.n is not None
    return chen_plain.Stage(spec.n, spec.m, spec.horizon or 0.0, spec.overlap)


def check(exact: Data, specs: list[IterativeSpec]) -> None:
    """Raise AssertionError unless both ways give the same numbers, up to the plain one's quadrature."""
    record = generate(exact, _SEED, 0)
    for ours, other in zip(fit(record, specs), plain(record, specs), strict=True):
        np.testing.assert_allclose([*other.values()], [ours[name] for name in other], rtol=_CLOSE)


def factored(record: Record, specs: list[IterativeSpec]) -> list[Array]:
    """All matrices that a trial factors, in stacks (J, rows, columns): regressors, and the target last."""
    stacks = []
    factor = np.linalg.qr

    def remembered(matrices: Array, *, mode: Any) -> Any:
        stacks.append(np.array(matrices, ndmin=3))
        return factor(matrices, mode=mode)

    with mock.patch.object(np.linalg, "qr", remembered):
        fit(record, specs)
    return stacks


def solved(stack: Array) -> list[Array]:
    """The least-squares solutions, one after the other."""
    return [np.linalg.lstsq(matrix[:, :-1], matrix[:, -1], rcond=None)[0] for matrix in stack]


def scaling() -> None:
    """Seconds and peak memory against the number of samples, each size in a process of its own."""
    found = [measured(size) for size in _SIZES]
    names = [name for name in found[0] if name != "peak"]
    peaks = [int(one["peak"]) for one in found]
    rows = [
        [f"{size:.0e}", *(f"{one[name]:.3g}" for name in names), f"{peak / 2**20:.0f}", each]
        for size, one, peak, each in zip(_SIZES, found, peaks, per_sample(_SIZES, peaks), strict=True)
    ]
    rates = {name: exponent(_SIZES[1:], [one[name] for one in found[1:]]) for name in names}
    for name, rate in rates.items():
        figure(f"exponent of N from 1e4 on: {name}", [rate], "1.1")
    show(
        "Scaling: time-weighted transforms, and case B of chen_table1 with given partition points",
        ("N", *names, "peak MiB", "bytes/sample"),
        rows,
        (
            "from N = 1e4 on, " + ", ".join(f"{name}: N^{rate:.2f}" for name, rate in rates.items()),
            "sampled, held: seconds to build the operator for such signals. transform: to apply it to one.",
            "fit: both stages with standard errors. peak: resident set (ru_maxrss), data included.",
            "aim: at most N^1.1, memory O(N)",
        ),
    )


def measured(size: int) -> dict[str, float]:
    """Seconds by name and peak bytes, from a child."""
    command = [sys.executable, "-m", "tests.benchmarks.chen", str(size)]
    answer = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    return dict(json.loads(answer))


def measure(size: int) -> dict[str, float]:
    """Seconds by name and peak bytes of this process, for records of ``size`` samples."""
    pin_blas()
    plugins.load()
    data, (_, spec, _) = estimators(_TABLE_1, {"type": "I"})
    assert isinstance(spec, IterativeHammerstein)
    given = spec.nonlinearity.model_copy(update={"partition": _PARTITION})
    spec = spec.model_copy(update={"nonlinearity": given})
    record = generate(data.model_copy(update={"samples": size}), _SEED, 0)
    assert record.dt is not None
    fit(generate(data, _SEED, 0), [spec])
    over = Horizons.of(
        size, record.dt, eta=spec.first.horizon, overlap=spec.first.overlap, order=spec.first.n
    )
    knots = Knots.of(record.u, spec.delay, record.dt)
    # Built for this record, not remembered: each delay is another.
    delays = iter(np.linspace(2.0, 2.1, 4))
    times = {
        "held": min(seconds(lambda: over.held(next(delays))) for _ in range(3)),
        "sampled": seconds(lambda: over.sampled(knots)),
    }
    operator = over.sampled(knots)
    times["transform"] = min(seconds(partial(over.transform, operator, record.y)) for _ in range(3))
    del operator  # not counted with the fit's memory
    times["fit"] = seconds(lambda: fit(record, [spec]))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return {**times, "peak": float(peak)}


if __name__ == "__main__":
    print(json.dumps(measure(int(sys.argv[1]))))
