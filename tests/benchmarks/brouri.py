"""Brouri's frequency gain identification: one long sine, and the Bode diagrams of both blocks."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from hident import plugins
from hident.engine.experiment import load
from hident.engine.trial import Data, generate
from hident.engine.work import pin_blas
from hident.estimators.base import EstimatorSpec
from tests.benchmarks.timing import figure, least, show

_BODE = Path("configs/brouri_bode.yaml")
_SINE = """
version: 1
title: "Brouri: frequency gain identification"
trials: 1
dt: 0.1
samples: 251320
system:
  kind: wiener_hammerstein
  input_linear: {kind: continuous, a: [12, 20]}
  nonlinearity: {kind: exponential, scale: 50, rate: 0.2}
  output_linear: {kind: continuous, a: [105, 500]}
excitation: {kind: stepped_sine, frequencies: [0.01], amplitude: 1.5, periods: 40, samples_per_period: 6283}
noise: {kind: white, distribution: uniform, half_width: 1}
estimators:
  FGI: {kind: frequency_gain_identification, frequencies: [0.01], coefficients: [50, 10, 1, 1/15]}
metrics:
  gain: {kind: value, of: [gain_i_1]}
"""
_SEED = 2009
_ROUNDS = 15


def main() -> None:
    pin_blas()
    plugins.load()
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder, "sine.yaml")
        config.write_text(_SINE)
        (sine,) = load(config, ()).units
    bode = load(_BODE, ()).units
    show(
        "One trial of Brouri's frequency gain identification: milliseconds",
        ("", "N", "simulation", "estimation", "both", "floor", "both/floor"),
        [
            row("one sine, 40 periods in 25,000 s", sine.data, sine.estimator),
            *(row(f"brouri_bode, 28 frequencies, {unit.name}", unit.data, unit.estimator) for unit in bode),
        ],
        (
            "processor time, least of several turns.",
            "floor: the noise drawn and added to the output, and one real Fourier transform of the record.",
            "aim: at most 2 floors for the sine; at most 300 ms for the Bode diagram",
        ),
    )


def row(name: str, data: Data, estimator: EstimatorSpec) -> list[str]:
    """The line of one trial."""
    record, rng = generate(data, _SEED, 0), np.random.default_rng(_SEED)
    exact = generate(data.model_copy(update={"noise": ()}), _SEED, 0).y
    taken = least(
        {
            "simulation": lambda: generate(data, _SEED, 0),
            "estimation": lambda: estimator.fit(record, rng),
            "floor": lambda: np.fft.rfft(exact + (2.0 * rng.random(len(exact)) - 1.0)),
        },
        _ROUNDS,
    )
    both = taken["simulation"] + taken["estimation"]
    parts = zip(taken.ratios("simulation", "floor"), taken.ratios("estimation", "floor"), strict=True)
    figure(f"{name}: over the floor", [sum(part) for part in parts])
    times = taken["simulation"], taken["estimation"], both, taken["floor"]
    return [
        name,
        f"{len(record):.1e}",
        *(f"{1e3 * time:.1f}" for time in times),
        f"{both / taken['floor']:.2f}",
    ]
