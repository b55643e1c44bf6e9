"""Measured records beside other packages: the error on samples that were not fitted, and the time of a fit.

Packages that are not installed are left out with a line, and so are records that are not here.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hident import plugins
from hident.arrays import Array
from hident.engine.experiment import load
from hident.engine.replay import OneTrial
from hident.engine.work import pin_blas
from hident.errors import RecordAbsent
from hident.estimators.prediction_error.prediction_error import PredictionError
from hident.identification.identify import identify
from hident.records import Record, needed
from tests.benchmarks.timing import figure, processor_seconds, show

# Of each configuration's record, the first samples of its validation part that are not scored.
_RECORDS = {"data_example": 10, "data_tanks": 50, "data_exchanger": 50}
_FOLDER = Path("configs")
_ORDER = 3
_IDENTIFY_AIM = 60

Simulate = Callable[[Array, Array], Array]
"""The output (N,) to an input (N,), given the first measured outputs."""


@dataclass(frozen=True)
class Contender:
    """``fit`` gives, from a record and how many first samples are not scored, what simulates."""

    name: str
    fit: Callable[[Record, int], Simulate]


def main() -> None:
    plugins.load()
    pin_blas()
    contenders, missing = hidents(), []
    for package, of_package in {"pysid": pysids, "sysidentpy": sysidentpys, "jax_sysid": jaxes}.items():
        try:
            contenders += of_package()
        except ImportError as reason:
            missing.append(f"{package} skipped ({reason}): pip install 'hident[bench]'")
    rows = []
    for name, n_init in _RECORDS.items():
        try:
            plan = load(_FOLDER / f"{name}.yaml")
        except RecordAbsent as reason:
            missing.append(f"{name} skipped: {reason}")
            continue
        record = needed(OneTrial(plan, 0).record(plan.units[0].data)[0])
        rows += [[name, *row(contender, record, n_init)] for contender in contenders]
    show(
        "Records: simulation of samples that were not fitted",
        ("record", "method", "RMSE", "fit %", "processor s"),
        rows,
        (
            "The validation part is simulated from its input; the first 10 (data_example) or 50 samples are",
            "not scored, and where a model wants an initial state, it is taken from these. One fit each,",
            "with what a package compiles for it. hident identify chooses without the validation part.",
            *missing,
        ),
    )


def row(contender: Contender, record: Record, n_init: int) -> list[str]:
    """The line of one method on one record; what it raises stands in the place of the numbers."""
    found: list[Simulate] = []
    fitted = replace(record, validation=None)
    try:
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            taken = processor_seconds(lambda: found.append(contender.fit(fitted, n_init)))
            other = needed(record.validation)
            made = found[0](other.u, other.y)
    except Exception as error:
        return [contender.name, f"failed: {type(error).__name__}", "-", "-"]
    rmse = float(np.sqrt(np.mean((made - other.y)[n_init:] ** 2)))
    if contender.name == "hident identify":
        figure(f"identify, record of {len(record)} samples: processor seconds", [taken], str(_IDENTIFY_AIM))
    fit = 100.0 * (1.0 - rmse / float(np.std(other.y[n_init:])))
    return [contender.name, f"{rmse:.4g}", f"{fit:.1f}", f"{taken:.2f}"]


def hidents() -> list[Contender]:
    """The whole search, and one fit of a given structure."""

    def searched(record: Record, n_init: int) -> Simulate:
        model = needed(identify(record).estimate(record).model)
        return lambda u, y: model.simulate(Record(u, y, record.dt, offsets=record.offsets))

    def given(record: Record, n_init: int) -> Simulate:
        cubic = {"kind": "polynomial", "degree": 3}
        linear = {"kind": "linear", "nb": _ORDER + 1, "nf": _ORDER}
        spec = PredictionError.model_validate({"blocks": [cubic, linear, cubic], "n_init": n_init})
        model = needed(spec.fit(record).model)
        return lambda u, y: model.simulate(Record(u, y, record.dt, offsets=record.offsets))

    return [Contender("hident identify", searched), Contender("hident N-L-N, cubic, order 3", given)]


def pysids() -> list[Contender]:
    """A linear ARX model, by pysid, whose output error method fails on records like these."""
    pysid: Any = importlib.import_module("pysid")
    lfilter: Any = importlib.import_module("scipy.signal").lfilter

    def fit(record: Record, n_init: int) -> Simulate:
        means = record.u.mean(), record.y.mean()
        u, y = record.u - means[0], record.y - means[1]
        model = pysid.arx([[_ORDER]], [[_ORDER]], [[0]], u[:, None], y[:, None])
        b, a = np.ravel(model.B[0, 0]), np.ravel(model.A[0, 0])
        return lambda u, y: np.asarray(lfilter(b, a, u - means[0]) + means[1])

    return [Contender("pysid arx, linear, order 3", fit)]


def sysidentpys() -> list[Contender]:
    """A polynomial NARX model whose terms forward regression chooses, by SysIdentPy."""
    selection: Any = importlib.import_module("sysidentpy.model_structure_selection")
    polynomial: Any = importlib.import_module("sysidentpy.basis_function").Polynomial
    least_squares: Any = importlib.import_module("sysidentpy.parameter_estimation").LeastSquares

    def fit(record: Record, n_init: int) -> Simulate:
        model = selection.FROLS(
            xlag=_ORDER,
            ylag=_ORDER,
            basis_function=polynomial(degree=3),
            estimator=least_squares(),
            order_selection=True,
            info_criteria="bic",
            n_info_values=20,
        ).fit(X=record.u[:, None], y=record.y[:, None])

        def simulate(u: Array, y: Array) -> Array:
            return np.asarray(model.predict(X=u[:, None], y=y[:, None])[:, 0])

        return simulate

    return [Contender("SysIdentPy FROLS, cubic NARX, BIC", fit)]


def jaxes() -> list[Contender]:
    """The residual recurrent network of jax-sysid's first example, by its settings."""
    jax: Any = importlib.import_module("jax")
    model_class: Any = importlib.import_module("jax_sysid.models").Model
    width = 5

    def state(x: Any, u: Any, params: Any) -> Any:
        a, b, _, w1, w2, w3, b1, b2, *_ = params
        return a @ x + b @ u + w3 @ jax.nn.sigmoid(w1 @ x + w2 @ u + b1) + b2

    def output(x: Any, u: Any, params: Any) -> Any:
        c = params[2]
        w4, w5, b3, b4 = params[8:]
        return c @ x + w5 @ jax.nn.sigmoid(w4 @ x + b3) + b4

    def begun() -> list[Array]:
        draws = np.random.default_rng(0)
        shapes = {"B": (_ORDER, 1), "C": (1, _ORDER)}
        small: Mapping[str, Array] = {k: 0.1 * draws.standard_normal(shape) for k, shape in shapes.items()}
        return [
            0.5 * np.eye(_ORDER),
            small["B"],
            small["C"],
            0.1 * draws.standard_normal((width, _ORDER)),
            *(0.5 * draws.standard_normal(shape) for shape in ((width, 1), (_ORDER, width))),
            np.zeros(width),
            np.zeros(_ORDER),
            *(0.5 * draws.standard_normal(shape) for shape in ((width, _ORDER), (1, width))),
            np.zeros(width),
            np.zeros(1),
        ]

    def fit(record: Record, n_init: int) -> Simulate:
        scales = [(x.mean(), x.std()) for x in (record.u, record.y)]
        u, y = (((x - m) / s)[:, None] for x, (m, s) in zip((record.u, record.y), scales, strict=True))
        model = model_class(_ORDER, 1, 1, state_fcn=jax.jit(state), output_fcn=jax.jit(output))
        model.init(params=begun())
        model.loss(rho_x0=1e-4, rho_th=1e-4)
        model.optimization(adam_epochs=1000, lbfgs_epochs=1000)
        model.fit(y, u)
        (u_mean, u_std), (y_mean, y_std) = scales

        def simulate(u: Array, y: Array) -> Array:
            u, y = ((u - u_mean) / u_std)[:, None], ((y - y_mean) / y_std)[:, None]
            x0 = model.learn_x0(u[:n_init], y[:n_init], LBFGS_refinement=True, verbosity=False)
            made = np.asarray(model.predict(x0, u)[0], dtype=float)
            return np.asarray(made[:, 0] * y_std + y_mean)

        return simulate

    return [Contender("jax-sysid, residual network, order 3", fit)]
