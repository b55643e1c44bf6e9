"""What every component owes, by its registration alone; an estimator also by one example below.

What is owed stands in hident.testing, where those who write a plugin have it too.
"""

from dataclasses import dataclass, field
from typing import Any, get_args

import pytest

from hident import plugins
from hident.config.spec import PLURALS, Family, Of, components
from hident.estimators.base import EstimatorSpec
from hident.signals.base import ExcitationSpec
from hident.testing import checks
from hident.testing.base import CUBIC, made_data
from hident.testing.components import BASES, ClassContract, SettingContract
from hident.testing.estimators import EstimatorContract

plugins.load()

# Without what other tests register.
COMPONENTS = [
    (family, kind)
    for family in PLURALS.values()
    for kind, cls in components(family).items()
    if cls.__module__.startswith("hident.")
]
AR = {"kind": "ar", "a": [0.5]}
IID = {"kind": "iid", "distribution": "uniform", "low": -1, "high": 1}
FIR = {"kind": "fir", "b": [0.0, 0.8, 0.6]}


@dataclass(frozen=True)
class Example:
    """An estimator's settings, and the system whose data suit it.

    ``invariances`` are those that it has: ``scale`` (of the output: the nonlinearity scales with it, the
    feedback stays) and ``order`` (of the samples: it does not matter). ``several`` is an excitation with
    several experiments; by default the example's own twice, the second one around another level.
    """

    settings: dict[str, Any]
    linear: dict[str, Any] = field(default_factory=lambda: AR)
    dt: float | None = None
    system: dict[str, Any] | str = "hammerstein"
    excitation: dict[str, Any] = field(default_factory=lambda: IID)
    samples: int = 300
    several: dict[str, Any] | None = None
    invariances: frozenset[str] = frozenset({"scale"})


MEMORYLESS = frozenset({"scale", "order"})
BANDWIDTH = {"h0": 0.5, "alpha": 0.2}
TRIGONOMETRIC = {"kind": "trigonometric", "interval": [-1, 1]}
TERMS = {"q0": 1, "alpha": 0.2}
LEAST_SQUARES = {"kind": "least_squares", "order": 1}
CONTINUOUS = {"kind": "continuous", "a": [2.5, 1.5], "b": [1, 0.2], "delay": 0.3}
MOVING: dict[str, Any] = {"linear": CONTINUOUS, "dt": 0.1}
STEPS: dict[str, Any] = {
    "system": "wiener",
    "excitation": {
        "kind": "multistep",
        "distribution": "uniform",
        "limits": [-1.5, 1.5],
        "switching_time": 1,
    },
}
HORIZONS = {"delay": 0.3, "first": {"n": 2, "m": 1, "horizon": 8}}
BLOCKS: dict[str, Any] = {
    "dt": 0.5,
    "system": {
        "kind": "wiener_hammerstein",
        "input_linear": {"kind": "continuous", "a": [0.5]},
        "nonlinearity": {"kind": "polynomial", "coefficients": [2, 1, 0.5]},
        "output_linear": {"kind": "continuous", "a": [1]},
    },
}
STAIRCASE = {"kind": "staircase", "levels": [-1, 0, 1], "hold": 40}
SINES = {
    "kind": "experiments",
    "parts": [
        {"name": "staircase", "excitation": STAIRCASE, "samples": 240},
        {
            "name": "sines",
            "excitation": {
                "kind": "stepped_sine",
                "frequencies": [0.5, 1],
                "periods": 5,
                "samples_per_period": 32,
            },
        },
    ],
}
MULTISINES = {
    "kind": "experiments",
    "parts": [
        {
            "name": "multisine",
            "excitation": {"kind": "multisine", "period": 32, "rms": 1, "grid": "odd", "highest": 5},
            "periods": 2,
            "repetitions": 3,
        }
    ],
}
# A new estimator gets all that hident.testing checks by one line here.
EXAMPLES = [
    Example({"kind": "kernel", "kernel": "window_unit", "bandwidth": BANDWIDTH}, invariances=MEMORYLESS),
    Example({"kind": "kernel", "kernel": "gaussian", "bandwidth": BANDWIDTH}, invariances=MEMORYLESS),
    Example({"kind": "kernel", "kernel": "epanechnikov", "bandwidth": BANDWIDTH, "prefilter": LEAST_SQUARES}),
    Example({"kind": "kernel", "kernel": "triangular", "bandwidth": "rule_of_thumb"}, invariances=MEMORYLESS),
    Example(
        {"kind": "kernel", "kernel": "gaussian", "bandwidth": "plug_in", "prefilter": LEAST_SQUARES},
    ),
    Example({"kind": "orthogonal", "basis": TRIGONOMETRIC, "terms": TERMS}, invariances=MEMORYLESS),
    Example(
        {
            "kind": "orthogonal",
            "basis": {"kind": "legendre", "interval": [-1, 1]},
            "terms": TERMS,
            "density": {"distribution": "uniform", "low": -1, "high": 1},
            "known_point": {"u": 0, "value": 0},
        },
        invariances=MEMORYLESS,
    ),
    Example({"kind": "orthogonal", "basis": TRIGONOMETRIC, "terms": TERMS, "prefilter": LEAST_SQUARES}),
    Example(
        {
            "kind": "kernel",
            "kernel": "gaussian",
            "bandwidth": BANDWIDTH,
            "delay": "search",
            "largest_delay": 3,
            "prefilter": LEAST_SQUARES,
        },
        linear={"kind": "arma", "a": [0.5], "b": [0, 1]},
    ),
    Example({"kind": "orthogonal", "basis": TRIGONOMETRIC, "terms": TERMS, "delay": 1}, linear=FIR),
    Example({"kind": "least_squares", "order": 2}),
    Example({"kind": "instrumental_variables", "order": 1, "instrument": "identity"}),
    Example({"kind": "instrumental_variables", "order": 1, "instrument": "identity", "ma_order": 1}),
    Example({"kind": "known_dynamics", "a": [0.5, -0.1], "b": [1, 0.2]}),
    Example({"kind": "two_stage", "lags": 3, "degree": 3, "delay": 0}, linear=FIR),
    Example({"kind": "bilinear_least_squares", "lags": 3, "degree": 3, "delay": 0}, linear=FIR),
    Example(
        {
            "kind": "bilinear_least_squares",
            "lags": 3,
            "degree": 3,
            "delay": 0,
            "start": "random",
            "solver": "subspace_trust_region",
            "unconverged": "keep",
            "excess": True,
        },
        linear=FIR,
        invariances=frozenset(),
    ),
    Example({"kind": "separable_least_squares", "lags": 2, "degree": 3, "delay": 0, "feedback": 1}),
    Example(
        {"kind": "known_nonlinearity", "lags": 2, "nonlinearity": CUBIC}, linear=FIR, invariances=frozenset()
    ),
    Example(
        {"kind": "cramer_rao", "lags": 2, "degree": 3, "variance": 0.01}, linear=FIR, invariances=frozenset()
    ),
    Example(
        {
            "kind": "iterative_hammerstein",
            "nonlinearity": {"kind": "polynomial", "degree": 3},
            **HORIZONS,
            "second": {"structure": "search", "largest_n": 2},
        },
        **MOVING,
    ),
    Example(
        {
            "kind": "iterative_hammerstein",
            "nonlinearity": {"kind": "three_segment", "points": 3},
            **HORIZONS,
            "second": {"n": 2, "m": 1},
        },
        **MOVING,
    ),
    Example(
        {
            "kind": "iterative_wiener",
            "nonlinearity": {"kind": "four_segment", "partition": [-0.3, 0.6]},
            **HORIZONS,
            "second": {"n": 2, "m": 1},
        },
        **MOVING,
        **STEPS,
        invariances=frozenset(),
    ),
    Example(
        {"kind": "iterative_wiener", "nonlinearity": {"kind": "polynomial", "degree": 2}, **HORIZONS},
        **MOVING,
        **STEPS,
        invariances=frozenset(),
    ),
    Example(
        {
            "kind": "select",
            "by": "leave_one_out",
            "over": {"bandwidth.h0": [0.2, 0.5], "kernel": ["gaussian", "triangular"]},
            "estimator": {"kind": "kernel", "bandwidth": {"alpha": 0.2}, "prefilter": LEAST_SQUARES},
        },
    ),
    Example(
        {
            "kind": "select",
            "by": "cross_validation",
            "over": {"weight": ["identity", {"kind": "ar", "a": [0.3]}]},
            "estimator": {"kind": "two_stage", "lags": 3, "degree": 3, "delay": 0},
        },
        linear=FIR,
    ),
    Example({"kind": "voros_hammerstein", "n": 1, "m": 2, "delay": 0, "degree": 3}),
    Example(
        {"kind": "voros_wiener", "n": 1, "m": 1, "delay": 0, "degree": 3},
        linear={"kind": "fir", "b": [1.0]},
        invariances=frozenset(),
    ),
    Example(
        {
            "kind": "output_error",
            "start": {
                "kind": "iterative_hammerstein",
                "nonlinearity": {"kind": "polynomial", "degree": 3},
                **HORIZONS,
            },
        },
        **MOVING,
    ),
    Example(
        {
            "kind": "output_error",
            "start": {
                "kind": "iterative_wiener",
                "nonlinearity": {"kind": "four_segment", "partition": [-0.3, 0.6]},
                **HORIZONS,
            },
        },
        **MOVING,
        **STEPS,
        invariances=frozenset(),
    ),
    Example({"kind": "linear_model", "delay": 0.3, "block": {"n": 2, "m": 1, "horizon": 8}}, **MOVING),
    Example(
        {
            "kind": "linear_model",
            "delay": 0.3,
            "constant": True,
            "block": {"structure": "search", "largest_n": 2, "horizon": 8},
        },
        **MOVING,
    ),
    Example(
        {
            "kind": "iterative_hammerstein",
            "nonlinearity": {"kind": "polynomial", "degree": 3},
            "constant": True,
            "tolerance": 1e-12,
            **HORIZONS,
            "second": {"n": 2, "m": 1},
        },
        **MOVING,
    ),
    Example(
        {
            "kind": "iterative_wiener",
            "nonlinearity": {"kind": "four_segment", "partition": [-0.3, 0.6]},
            "constant": True,
            **HORIZONS,
            "second": {"n": 2, "m": 1},
        },
        **MOVING,
        **STEPS,
        invariances=frozenset(),
    ),
    Example(
        {"kind": "nonlinearity_identification", "degree": 2},
        **BLOCKS,
        excitation=STAIRCASE,
        samples=240,
        several=SINES,
    ),
    Example(
        {
            "kind": "frequency_gain_identification",
            "frequencies": [0.5, 1],
            "order": 2,
            "nonlinearity": {"kind": "nonlinearity_identification", "degree": 2},
            "phases": "single",
            "gauge": {"kind": "rational", "input": [0, 1], "output": [0, 1]},
        },
        **BLOCKS,
        excitation=SINES,
        samples=560,
        several=SINES,
    ),
    Example(
        {"kind": "best_linear_approximation", "harmonics": [1, 3]},
        **BLOCKS,
        excitation=MULTISINES,
        samples=192,
        several=MULTISINES,
    ),
    Example(
        {
            "kind": "prediction_error",
            "blocks": [{"kind": "polynomial", "degree": 3}, {"kind": "linear", "nb": 1, "nf": 1}],
            "n_init": 20,
        },
    ),
    Example(
        {
            "kind": "prediction_error",
            "blocks": [
                {"kind": "linear", "nb": 1, "nf": 1},
                {"kind": "piecewise_linear", "knots": 4, "range": [-3, 3]},
            ],
            "noise": {"ar": 1, "ma": 1},
            "start": "rest",
            "n_init": 20,
        },
        system="wiener",
    ),
    Example(
        {
            "kind": "prediction_error",
            "blocks": [
                {"kind": "expansion", "basis": ["identity", {"kind": "power", "exponent": 2}]},
                {"kind": "continuous", "n": 2, "m": 1, "delay": 0.3},
            ],
            "start": "rest",
            "n_init": 80,
        },
        **MOVING,
        excitation=STEPS["excitation"],
    ),
    Example(
        {
            "kind": "prediction_error",
            "blocks": [
                {"kind": "continuous", "n": 2, "m": 1, "delay": 0.3},
                {"kind": "series", "basis": {"kind": "legendre", "interval": [-1.5, 1.5]}, "q": 3},
            ],
            "n_init": 20,
        },
        **MOVING,
        **STEPS,
    ),
    Example(
        {
            "kind": "prediction_error",
            "blocks": [{"kind": "linear", "nb": 1, "nf": 1}, {"kind": "polynomial", "degree": 2}],
            "start": "estimated",
            "initialisation": ["linear_approximation"],
        },
        system="wiener",
    ),
    Example(
        {
            "kind": "chain_cramer_rao",
            "of": {
                "kind": "prediction_error",
                "blocks": [
                    {"kind": "polynomial", "degree": 3, "range": [-2, 2], "start": CUBIC},
                    {"kind": "linear", "nb": 1, "nf": 1, "start": AR},
                ],
            },
            "noise": [0.5],
            "variance": 0.01,
        },
        invariances=frozenset(),
    ),
]


UNIFORM = {"kind": "iid", "distribution": "uniform", "low": "-2*pi", "high": "2*pi"}
CELL = {"table": "T", "row": "r", "quantity": "q", "estimator": "k", "metric": "m"}
SETTINGS: list[tuple[Family, dict[str, Any]]] = [
    *(("estimator", example.settings) for example in EXAMPLES),
    ("system", {"kind": "hammerstein", "nonlinearity": "mzyk2009", "linear": AR}),
    (
        "system",
        {"kind": "wiener_hammerstein", "input_linear": FIR, "nonlinearity": CUBIC, "output_linear": AR},
    ),
    (
        "system",
        {
            "kind": "hammerstein_wiener",
            "input_nonlinearity": CUBIC,
            "linear": AR,
            "output_nonlinearity": "abs",
        },
    ),
    ("system", BLOCKS["system"]),
    ("linear", {"kind": "arma", "a": [0.5, "-1/4"], "b": [1, 2], "initial": [1, 2]}),
    ("linear", {"kind": "zpk", "zeros": [-1, [0, 1]], "poles": [0.5, [0.3, "0.1*pi"], 0], "gain": 2}),
    ("linear", {"kind": "sos", "sections": [[1, 2, 1, 1, -0.5, 0.1]], "initial": "zero"}),
    ("linear", {"kind": "continuous", "integrators": 1}),
    ("linear", {"kind": "continuous_zpk", "poles": [0, [-1, 2]], "zeros": [-3], "delay": 0.5}),
    ("nonlinearity", {"kind": "expression", "expression": "0.5*abs(u) + 2*sin(u)", "breaks": [0]}),
    ("nonlinearity", {"kind": "piecewise_linear", "points": [[0, 1], [1, 3]], "left_slope": 0}),
    ("nonlinearity", {"kind": "saturation", "low": -1, "high": float("inf")}),
    ("nonlinearity", {"kind": "backlash", "width": 0.5, "initial": 0.1}),
    ("nonlinearity", {"kind": "relay", "low": -1, "high": 1, "outputs": [0, 2], "initial": "upper"}),
    ("excitation", UNIFORM),
    ("excitation", {"kind": "multistep", "switching_time": 5, "std": 1, "limits": [-2, 2]}),
    ("noise", {"kind": "ar", "a": [0.5], "nsr": 0.1}),
    ("noise", {"kind": "white", "distribution": "uniform", "half_width": 0.1}),
    ("streams", {"kind": "numpy", "fixed": ["input"], "share": ["input", "noise"]}),
    ("metric", {"kind": "error", "of": ["a_1"], "estimators": ["k"]}),
    ("metric", {"kind": "mise", "interval": [-1, 1]}),
    ("basis", TRIGONOMETRIC),
    (
        "block",
        {"kind": "linear", "nb": 2, "nf": 1, "nk": 1, "start": {"kind": "fir", "b": [0, 1]}, "held": True},
    ),
    (
        "block",
        {"kind": "dead_zone", "range": [-1, 1], "start": {"kind": "dead_zone", "low": -0.5, "high": 0.5}},
    ),
    ("table", {"kind": "grid", "title": "T", "rows": "n", "columns": [{"estimator": "k", "metric": "m"}]}),
    ("table", {"kind": "distance", "title": "T", "rows": "n", "cells": [CELL]}),
    ("table", {"kind": "comparison", "title": "T", "metric": "m", "estimators": ["k", "l"], "best": "zero"}),
    ("figure", {"kind": "realisation", "estimators": ["k"], "interval": [-1, 1], "at": [{"n": 50}]}),
]


def _each(contracts):
    """All checks of contracts, each a test of its own."""
    return pytest.mark.parametrize(
        "check",
        [
            pytest.param(check, id=f"{name}-{check}" if name else str(check))
            for name, contract in contracts
            for check in contract.checks()
        ],
    )


def _contract(example):
    spec = Of("estimator").validate(example.settings)
    assert isinstance(spec, EstimatorSpec)
    system = example.system
    if isinstance(system, str):
        system = {"kind": system, "nonlinearity": CUBIC, "linear": example.linear}
    given = {"samples": example.samples, "dt": example.dt, "system": system, "excitation": example.excitation}
    data = made_data(given)
    return EstimatorContract(
        spec, data, _several(example, given), example.invariances, _learns_from(example.settings)
    )


def _several(example, given):
    """Data of several experiments at very different levels."""
    if example.several is not None:
        return made_data({**given, "excitation": example.several, "samples": _lengths(example.several)})
    parts = [
        {"name": name, "samples": example.samples, "excitation": excitation}
        for name, excitation in (("low", example.excitation), ("high", _raised(example.excitation)))
    ]
    excitation = {"kind": "experiments", "parts": parts}
    return made_data({**given, "excitation": excitation, "samples": 2 * example.samples})


def _lengths(excitation):
    spec = Of("excitation").validate(excitation)
    assert isinstance(spec, ExcitationSpec)
    return sum(stretch.samples for stretch in spec.stretches(0, 0.5))


def _raised(excitation):
    match excitation["kind"]:
        case "iid":
            return {**excitation, "low": -1.5, "high": 2}
        case "multistep":
            return {**excitation, "limits": [-1, 2]}
    return excitation


# Who may estimate from what: a static function has its values where the input was, a known nonlinearity of
# two values tells two lags apart, a bound knows the truth, and a given block is given.
_STATIC = ("kernel", "orthogonal")
_CONTENT = {
    "constant input": ("known_dynamics",),
    "constant output": ("known_dynamics", "cramer_rao", "chain_cramer_rao", *_STATIC),
    "period of two": ("known_dynamics", "known_nonlinearity", *_STATIC),
}


def _learns_from(settings):
    kind = settings["kind"]
    if kind in _STATIC and "prefilter" in settings:
        return ()
    return tuple(dull for dull, kinds in _CONTENT.items() if kind in kinds)


@_each(("", ClassContract(components(family)[kind])) for family, kind in COMPONENTS)
def test_every_component(check):
    check()


@_each((str(plain)[:40], SettingContract(Of(family).validate(plain))) for family, plain in SETTINGS)
def test_every_setting(check):
    check()


@pytest.mark.parametrize(
    "check",
    [
        pytest.param(check, id=str(check))
        for family, plain in SETTINGS
        if family in ("nonlinearity", "system", "excitation", "noise", "metric")
        for check in checks(Of(family).validate(plain))
    ],
)
def test_what_happens_to_a_signal(check):
    check()


@_each((str(i), _contract(example)) for i, example in enumerate(EXAMPLES))
def test_every_estimator(check):
    check()


def test_every_family_has_a_base_and_a_plural():
    assert set(BASES) == set(get_args(Family)) == set(PLURALS.values())


def test_every_estimator_has_an_example():
    estimators = {kind for family, kind in COMPONENTS if family == "estimator"}
    assert {example.settings["kind"] for example in EXAMPLES} == estimators, "add a line to EXAMPLES"
