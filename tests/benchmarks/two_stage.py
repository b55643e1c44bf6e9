"""The two-stage algorithm on example 1 of Wang, Zhang, Ljung 2009: memory, speed, and other packages."""

from __future__ import annotations

import importlib
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from hident import plugins
from hident.arrays import Array
from hident.engine.experiment import load
from hident.engine.trial import Data, Job, generate, run_trials
from hident.engine.work import pin_blas
from hident.estimators.base import is_batched
from hident.estimators.bilinear_models.bilinear import Regression, regressors
from hident.estimators.bilinear_models.bilinear_least_squares import BilinearLeastSquares
from hident.estimators.bilinear_models.known_basis import BilinearSpec
from hident.estimators.bilinear_models.two_stage import TwoStage, TwoStageFit, two_stage
from hident.records import Record
from hident.signals.matlab5 import normals
from tests.benchmarks.timing import figure, in_turns, interleaved, least, show

_CONFIG = """
version: 1
title: "Wang, Zhang, Ljung 2009, example 1"
seed: 2009
trials: 100
streams: {kind: matlab5, input: {state: 1}, noise: {state: trial}}
system:
  kind: hammerstein
  nonlinearity: {kind: polynomial, coefficients: [0, 1, 2, 5, 7, 1]}
  linear: {kind: fir, b: [0, 1/sqrt(5), -2/sqrt(5)]}
excitation:
  kind: filtered
  excitation: {kind: iid, distribution: uniform, low: -3, high: 3}
  linear: {kind: ar, a: [0.5], initial: zero}
noise: {kind: white, distribution: gaussian, std: 1}
samples: 100
estimators:
  TSA: {kind: two_stage, lags: 2, degree: 5}
metrics:
  value: {kind: value, of: [b_1, b_2, a_1, a_2, a_3, a_4, a_5]}
"""
_SEED = 2009
_RUNS = (10**3, 10**4, 10**5)
_BATCHES = (10**2, 10**3, 10**4)
_ROUNDS = 15
_CHUNK = 1000
_COMPARED = 100
_TURNS = 3
_TABLE = Path("configs/wang_table1.yaml")
_OF_TABLE = (2000, 10**4)


def main() -> None:
    pin_blas()
    data, spec = example()
    command(data, spec)
    table()
    speed(data, spec)
    packages(data, spec)


def command(data: Data, spec: TwoStage) -> None:
    """Time and peak memory of the command line against the number of trials, and the floor of its numbers."""
    at_least = interleaved({"floor": lambda: floor(data, spec)}, _ROUNDS)["floor"] / _CHUNK
    found = [run(trials) for trials in _RUNS]
    fewest, smallest = _RUNS[0], found[0][1]
    for trials, (taken, peak) in zip(_RUNS, found, strict=True):
        of = f"hident run, two-stage algorithm, {trials:.0e} trials"
        figure(f"{of}: over the floor", [taken / trials / at_least], "3" if trials == 10**4 else "")
        figure(f"{of}: peak MiB", [peak / 2**20])
    show(
        "hident run, two-stage algorithm, one process, start-up, store and tables included",
        ("trials", "seconds", "trials/s", "hident/floor time", "peak MiB", "bytes/trial"),
        [
            [
                f"{trials:.0e}",
                f"{taken:.1f}",
                f"{trials / taken:.0f}",
                f"{taken / trials / at_least:.1f}",
                f"{peak / 2**20:.0f}",
                f"{(peak - smallest) / (trials - fewest):.0f}" if trials > fewest else "",
            ]
            for trials, (taken, peak) in zip(_RUNS, found, strict=True)
        ],
        (
            "floor: the draws, one factorisation for 1000 trials, the products and the singular vectors.",
            "peak: resident set (ru_maxrss). bytes/trial: what each trial adds to the first row's.",
            "aim: at most 3 floors with 1e4 trials; memory independent of the number of trials",
        ),
    )


def run(trials: int) -> tuple[float, int]:
    """Seconds and peak bytes of a run with an empty store."""
    with written() as config:
        taken, _, peak = run_of(config, trials)
    return taken, peak


def run_of(config: Path, trials: int) -> tuple[float, float, int]:
    """Seconds, seconds of the processor and peak bytes of a run of a configuration with an empty store."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "hident", "run", str(config), "--quiet", "--jobs", "1"]
        command += ["--trials", str(trials), "--out", f"{folder}/out", "--store", f"{folder}/store"]
        start = time.perf_counter()
        child = subprocess.Popen(command)
        _, status, usage = os.wait4(child.pid, 0)
        taken = time.perf_counter() - start
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise subprocess.CalledProcessError(child.returncode, command)
    processor = usage.ru_utime + usage.ru_stime
    return taken, processor, usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def table() -> None:
    """wang_table1 with all its columns: its trials, and whole runs, over the floor of all of them."""
    plan = load(_TABLE, ())
    data, jobs = plan.units[0].data, [Job(unit.estimator, ()) for unit in plan.units]
    scored = [Job(unit.estimator, tuple(unit.metrics.values())) for unit in plan.units]
    draws = range(1, _CHUNK + 1)
    outputs = noise_free(data).y + normals(draws, data.samples)
    calls = [call for job in jobs for call in library_calls(data, job, outputs)]
    taken = least(
        {
            "trials": lambda: run_trials(data, scored, [range(_CHUNK)] * len(jobs), plan.seed),
            "floor": lambda: (normals(draws, data.samples), [call() for call in calls]),
        },
        _ROUNDS,
    )
    at_least = taken["floor"] / _CHUNK
    fewest, most = _OF_TABLE
    found = in_turns({str(trials): partial(run_of, _TABLE, trials) for trials in _OF_TABLE}, _TURNS)
    whole, small = ([processor for _, processor, _ in found[str(trials)]] for trials in (most, fewest))
    each = [(one - other) / (most - fewest) for one, other in zip(whole, small, strict=True)]
    figure("wang_table1, trials of a chunk: over the floor", taken.ratios("trials", "floor"), "3")
    figure("wang_table1, each further trial of hident run: over the floor", [one / at_least for one in each])
    of_run = [one / most / at_least for one in whole]
    figure(f"hident run wang_table1, {most:.0e} trials: over the floor", of_run, "3")
    show(
        "wang_table1, four estimators, one process: microseconds of the processor for a trial",
        ("floor", "in a chunk", "in a run", f"run of {most:.0e}, all", f"seconds of a run of {fewest}"),
        [
            [
                *(f"{1e6 * one:.1f}" for one in (at_least, taken["trials"] / _CHUNK)),
                *(f"{1e6 * statistics.median(one):.1f}" for one in (each, [one / most for one in whole])),
                f"{statistics.median(small):.2f}",
            ]
        ],
        (
            "floor: the draws, and the factorisations and products of numpy that all four columns make.",
            "in a run: with store, verdicts (a bootstrap of all trials), tables, trials.csv.xz, without",
            "start-up and figures: what the longer run takes more.",
            "aim: at most 3 floors",
        ),
    )


def library_calls(data: Data, job: Job, outputs: Array) -> list[Callable[[], object]]:
    """The calls of numpy's factorisations and products that the estimates make, to be made again.

    Products that are written ``@`` and what is elementwise are not among them.
    """
    exact = noise_free(data)
    records = [exact.with_signals(exact.u, y) for y in outputs]
    calls: list[Callable[[], object]] = []

    def remembered(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            calls.append(partial(function, *arguments, **options))
            return function(*arguments, **options)

        return call

    with ExitStack() as stack:
        for module, name in ((np, "matmul"), *((np.linalg, name) for name in ("qr", "svd", "eigh", "solve"))):
            stack.enter_context(mock.patch.object(module, name, remembered(getattr(module, name))))
        assert is_batched(job.estimator)
        job.estimator.fit_many(records)
    return calls


def floor(data: Data, spec: TwoStage) -> TwoStageFit:
    """The estimates of a chunk's trials, as library calls on bare arrays make them."""
    exact = noise_free(data)
    outputs = exact.y + normals(range(1, _CHUNK + 1), data.samples)
    return batch(spec, spec.basis_values(exact.u), outputs[:, spec.first :])


def example() -> tuple[Data, TwoStage]:
    """The data and the estimator of the configuration."""
    plugins.load()
    with written() as config:
        (unit,) = load(config, ()).units
    assert isinstance(unit.estimator, TwoStage)
    return unit.data, unit.estimator


@contextmanager
def written() -> Iterator[Path]:
    """The configuration as a file in a folder of its own."""
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder, "example1.yaml")
        config.write_text(_CONFIG)
        yield config


def speed(data: Data, spec: TwoStage) -> None:
    """Trials per second against a loop, and against the one matrix product."""
    exact = noise_free(data)
    noise = np.random.default_rng(_SEED).standard_normal((max(_BATCHES), data.samples))
    y = (exact.y + noise)[:, spec.first :]
    show(
        "Trials per second of the two-stage algorithm, outputs given (hident and plain agree to 1e-9)",
        ("trials", "hident", "floor", "plain", "hident/floor time", "plain/hident time"),
        [row(spec, spec.basis_values(exact.u), y[:trials]) for trials in _BATCHES],
        (
            "hident: b and a of all trials from the basis functions, the regressors factored once.",
            "floor: the product of their pseudoinverse, already known, with the outputs.",
            "plain: numpy's lstsq and svd for each trial.",
            "aim, with 1e4 trials: at most 3 floors; the plain loop takes at least 20 times as long",
        ),
    )


def noise_free(data: Data) -> Record:
    """The record without noise; its input is that of every trial."""
    return generate(data.model_copy(update={"noise": ()}), _SEED, 0)


def row(spec: TwoStage, basis: Array, y: Array) -> list[str]:
    """The line of the outputs ``y`` (T, rows)."""
    phi = regressors(basis, spec.lags, spec.delay)
    inverse = np.linalg.pinv(phi)
    found = batch(spec, basis, y)
    np.testing.assert_allclose(np.hstack([found.b, found.a]), plain(phi, spec.lags, y), rtol=1e-9)
    taken = interleaved(
        {
            "hident": lambda: batch(spec, basis, y),
            "floor": lambda: y @ inverse.T,
            "plain": lambda: plain(phi, spec.lags, y),
        },
        _ROUNDS,
    )
    ours, at_least, loop = taken["hident"], taken["floor"], taken["plain"]
    of = f"two-stage algorithm, {len(y):.0e} outputs at once"
    figure(f"{of}: over the floor", taken.ratios("hident", "floor"), "3" if len(y) >= 10**4 else "")
    figure(f"{of}: plain way over hident", taken.ratios("plain", "hident"))
    return [
        f"{len(y):.0e}",
        *(f"{len(y) / time:.2e}" for time in taken.values()),
        f"{ours / at_least:.2f}",
        f"{loop / ours:.0f}",
    ]


def batch(spec: TwoStage, basis: Array, y: Array) -> TwoStageFit:
    """The estimates of all trials, ``y`` (T, rows), from the basis functions (m, N)."""
    return two_stage(Regression.of(regressors(basis, spec.lags, spec.delay), spec.lags), y)


def plain(phi: Array, n: int, outputs: Array) -> Array:
    """b and a, a row for each row of ``outputs`` (T, rows), one after the other."""
    found = []
    for y in outputs:
        theta = np.linalg.lstsq(phi, y, rcond=None)[0].reshape(-1, n).T
        left, singular_values, right = np.linalg.svd(theta, full_matrices=False)
        sign = np.sign(left[0, 0])
        found.append(np.concatenate([sign * left[:, 0], sign * singular_values[0] * right[0]]))
    return np.array(found)


@dataclass(frozen=True, eq=False)
class Found:
    """What one trial gives: the output without noise (rows,), Theta (n, m), and b and a, if estimated."""

    output: Array
    theta: Array
    parameters: tuple[Array, Array] | None = None


@dataclass(frozen=True)
class Contender:
    """``fit`` takes the input (N,) and the outputs (T, N) of all trials, ``read`` one of the fits."""

    fit: Callable[[Array, Array], Sequence[Any]]
    read: Callable[[Any], Found]


def packages(data: Data, spec: TwoStage) -> None:
    """Errors and times of hident and of packages that can fit the same data."""
    exact = noise_free(data)
    outputs = np.array([generate(data, _SEED, trial).y for trial in range(_COMPARED)])
    contenders, missing = hidents(spec, exact), []
    for package, of_package in {"pysid": pysids, "sysidentpy": frols}.items():
        try:
            contenders |= of_package(spec, exact)
        except ImportError as reason:
            missing.append(f"{package} skipped ({reason}): pip install 'hident[bench]'")
    taken = interleaved(
        {name: partial(each.fit, exact.u, outputs) for name, each in contenders.items()}, _TURNS
    )
    b, a = spec.true_parameters(exact)
    ours, *others = taken
    for other in others:
        figure(f"two-stage algorithm, {_COMPARED} trials: {other} over {ours}", taken.ratios(other, ours))
    rows = []
    for name, each in contenders.items():
        found = [each.read(fit) for fit in each.fit(exact.u, outputs)]
        values = [f.parameters for f in found if f.parameters]
        rows.append(
            [
                name,
                error([f.output for f in found], exact.y[spec.first :], np.sqrt(data.samples - spec.first)),
                error([f.theta for f in found], np.outer(b, a)),
                error([b for b, _ in values], b) if values else "-",
                error([a for _, a in values], a) if values else "-",
                f"{1e3 * taken[name] / _COMPARED:.3g}",
            ]
        )
    show(
        f"Error and time of packages on the paper's data, {_COMPARED} trials of {data.samples} samples",
        ("method", "output", "Theta", "b", "a", "ms/trial"),
        rows,
        (
            "output: rms error of the predicted noise-free output (standard deviation of the noise: 1);",
            "least squares expects 0.247 with the 6 free parameters of b a', 0.319 with the 10 of Theta.",
            "Theta = b a', b, a: rms over trials of the length of the error over that of the truth;",
            "-: the package stops at Theta. phi: x, x^2, ..., x^5 are given as five inputs.",
            *missing,
        ),
    )


def error(found: Iterable[Array], truth: Array, size: float | None = None) -> str:
    """Root mean square over trials of the distance to the truth, in units of ``size`` or of its length."""
    squares = [np.sum((each - truth) ** 2) for each in found]
    return f"{np.sqrt(np.mean(squares)) / (np.linalg.norm(truth) if size is None else size):.3g}"


def hidents(spec: TwoStage, exact: Record) -> dict[str, Contender]:
    """The two-stage algorithm on all trials at once and as a run calls it, and nonlinear least squares."""
    phi, n = spec.data(exact)[0], spec.lags

    def together(x: Array, outputs: Array) -> list[Array]:
        found = batch(spec, spec.basis_values(x), outputs[:, spec.first :])
        return list(np.hstack([found.b, found.a]))

    def read(values: Array) -> Found:
        theta = np.outer(values[:n], values[n:])
        return Found(phi @ theta.T.ravel(), theta, (values[:n], values[n:]))

    def contender(estimator: BilinearSpec) -> Contender:
        def fit(x: Array, outputs: Array) -> list[Array]:
            rng = np.random.default_rng(_SEED)
            fits = (estimator.fit(Record(x, y), rng).values for y in outputs)
            return [np.array([values[name] for name in spec.parameters()]) for values in fits]

        return Contender(fit, read)

    least_squares = BilinearLeastSquares.model_validate({"lags": n, "degree": spec.degree})
    return {
        "hident two_stage, all trials in one call": Contender(together, read),
        "hident two_stage": contender(spec),
        "hident bilinear_least_squares": contender(least_squares),
    }


def pysids(spec: TwoStage, exact: Record) -> dict[str, Contender]:
    """pysid's least squares with the basis functions as inputs, without and with one pole."""
    pysid = importlib.import_module("pysid")
    lfilter = importlib.import_module("scipy.signal").lfilter
    basis = spec.basis_values(exact.u)
    orders, delays = [[spec.lags - 1] * len(basis)], [[spec.delay] * len(basis)]

    def read(model: Any) -> Found:
        poles = [1.0] if model.A is None else model.A[0, 0]
        numerators = model.B[0]
        output = sum(lfilter(b, poles, phi) for b, phi in zip(numerators, basis, strict=True))
        return Found(output[spec.first :], np.array([b[spec.delay :] for b in numerators]).T)

    def contender(method: Callable[..., Any], *structure: Any) -> Contender:
        def fit(x: Array, outputs: Array) -> list[Any]:
            inputs = spec.basis_values(x).T
            return [method(*structure, inputs, y[:, None]) for y in outputs]

        return Contender(fit, read)

    return {
        "pysid fir, inputs phi": contender(pysid.fir, orders, delays),
        "pysid arx, inputs phi": contender(pysid.arx, [[1]], orders, delays),
    }


def frols(spec: TwoStage, exact: Record) -> dict[str, Contender]:
    """SysIdentPy's forward regression on all monomials of the lagged inputs, their number by BIC."""
    selection = importlib.import_module("sysidentpy.model_structure_selection")
    polynomial = importlib.import_module("sysidentpy.basis_function").Polynomial
    least_squares = importlib.import_module("sysidentpy.parameter_estimation").LeastSquares
    shape = spec.lags, len(spec.functions())

    def fit(x: Array, outputs: Array) -> list[Any]:
        return [
            selection.FROLS(
                xlag=shape[0],
                ylag=1,
                model_type="NFIR",
                basis_function=polynomial(degree=shape[1]),
                estimator=least_squares(),
                info_criteria="bic",
                n_info_values=21,
            ).fit(X=x[:, None], y=y[:, None])
            for y in outputs
        ]

    def read(model: Any) -> Found:
        theta = np.zeros(shape)
        # 2001 stands for x(t-1), 2002 for x(t-2); a monomial is written as its factors, then zeros.
        for factors, value in zip(np.asarray(model.final_model, dtype=int), model.theta[:, 0], strict=True):
            lags = factors[factors > 0] - 2001
            if len(set(lags)) == 1:
                theta[lags[0], len(lags) - 1] = value
        output = model.predict(X=exact.u[:, None], y=exact.y[:, None])[:, 0]
        return Found(output[spec.first :], theta)

    return {"SysIdentPy FROLS, NFIR, BIC": Contender(fit, read)}
