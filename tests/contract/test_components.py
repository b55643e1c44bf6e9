"""What every component owes, by its registration alone; an estimator also by one example below."""

import inspect
import json
import pickle
from dataclasses import dataclass, field, replace
from typing import Any, get_args

import numpy as np
import pytest
from pydantic import ValidationError

from hident import plugins
from hident.config.describe import fields
from hident.config.load import problems_of
from hident.config.meanings import meanings
from hident.config.spec import PLURALS, Component, Family, Of, Spec, canonical, components
from hident.engine.trial import Data, Job, estimate, generate
from hident.errors import EstimationError
from hident.estimators.base import EstimatorSpec
from hident.estimators.nonparametric.bases import BasisSpec
from hident.estimators.prediction_error.block_specs import BlockSpec
from hident.metrics.base import MetricSpec
from hident.metrics.nonlinearity import IntegratedSquaredError
from hident.metrics.values import Value
from hident.records import ModelPart, Record
from hident.reports.base import FigureSpec, TableSpec
from hident.signals.base import ExcitationSpec, NoiseSpec
from hident.signals.streams import NumpyStreams, StreamsSpec
from hident.systems.base import NonlinearitySpec, SystemSpec
from hident.systems.linear import LinearSpec
from tests.unit.tried import tried

plugins.load()

BASES: dict[str, type[Component]] = {
    "estimator": EstimatorSpec,
    "system": SystemSpec,
    "linear": LinearSpec,
    "nonlinearity": NonlinearitySpec,
    "excitation": ExcitationSpec,
    "noise": NoiseSpec,
    "streams": StreamsSpec,
    "metric": MetricSpec,
    "basis": BasisSpec,
    "block": BlockSpec,
    "table": TableSpec,
    "figure": FigureSpec,
}
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
CUBIC = {"kind": "polynomial", "coefficients": [0, 1, 0.5, 0.25]}


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
# A new estimator gets all tests of this file by one line here.
EXAMPLES = [
    Example({"kind": "kernel", "kernel": "window_unit", "bandwidth": BANDWIDTH}, invariances=MEMORYLESS),
    Example({"kind": "kernel", "kernel": "gaussian", "bandwidth": BANDWIDTH}, invariances=MEMORYLESS),
    Example({"kind": "kernel", "kernel": "epanechnikov", "bandwidth": BANDWIDTH, "prefilter": LEAST_SQUARES}),
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
    ("linear", {"kind": "arma", "a": [0.5, "-1/4"], "b": [1, 2], "initial": [1, 2]}),
    ("nonlinearity", {"kind": "expression", "expression": "0.5*abs(u) + 2*sin(u)", "breaks": [0]}),
    ("nonlinearity", {"kind": "piecewise_linear", "points": [[0, 1], [1, 3]], "left_slope": 0}),
    ("excitation", UNIFORM),
    ("excitation", {"kind": "multistep", "switching_time": 5, "std": 1, "limits": [-2, 2]}),
    ("noise", {"kind": "ar", "a": [0.5], "nsr": 0.1}),
    ("noise", {"kind": "white", "distribution": "uniform", "half_width": 0.1}),
    ("streams", {"kind": "numpy", "fixed": ["input"]}),
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
    ("figure", {"kind": "realisation", "estimators": ["k"], "interval": [-1, 1], "at": [{"n": 50}]}),
]


def _each_example(invariance=None):
    chosen = [e for e in EXAMPLES if invariance is None or invariance in e.invariances]
    names = [f"{example.settings['kind']}-{EXAMPLES.index(example)}" for example in chosen]
    return pytest.mark.parametrize("example", chosen, ids=names)


def _spec(example):
    spec = Of("estimator").validate(example.settings)
    assert isinstance(spec, EstimatorSpec)
    return spec


def _data(example, samples=None):
    return Data.model_validate(
        {
            "samples": example.samples if samples is None else samples,
            "dt": example.dt,
            "system": example.system
            if isinstance(example.system, dict)
            else {"kind": example.system, "nonlinearity": CUBIC, "linear": example.linear},
            "excitation": example.excitation,
            "noise": {"kind": "white", "std": 0.01},
        }
    )


def _fit(example, record):
    with np.errstate(all="ignore"):
        found = _spec(example).fit(record, np.random.default_rng(0))
        return found, None if found.nonlinearity is None else found.nonlinearity(np.linspace(-0.9, 0.9, 31))


def _same(one, other, tolerance=0.0):
    """Whether two fits agree: the curves, the linear blocks and the values."""
    (a, curve_a), (b, curve_b) = one, other
    np.testing.assert_allclose(
        np.array([] if curve_a is None else curve_a),
        np.array([] if curve_b is None else curve_b),
        rtol=tolerance,
        atol=tolerance,
    )
    np.testing.assert_allclose(
        list(a.values.values()), list(b.values.values()), rtol=tolerance, atol=tolerance
    )
    assert list(a.values) == list(b.values)
    assert (a.linear is None) == (b.linear is None)
    if a.linear is not None and b.linear is not None:
        np.testing.assert_allclose(a.linear.a, b.linear.a, rtol=tolerance, atol=tolerance)
        np.testing.assert_allclose(a.linear.b, b.linear.b, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize(("family", "kind"), COMPONENTS)
class TestEveryComponent:
    def test_descends_from_the_base_of_its_family(self, family, kind):
        assert issubclass(components(family)[kind], BASES[family])

    def test_says_in_one_line_what_it_is(self, family, kind):
        summary = components(family)[kind].summary()
        assert summary.endswith(".")
        assert 10 <= len(summary) <= 100
        assert "\n" not in summary

    def test_documents_its_fields(self, family, kind):
        for spec in _with_nested(components(family)[kind]):
            assert set(meanings(spec)) == set(spec.model_fields), spec
            assert all(text.endswith((".", ")", "]")) for text in meanings(spec).values()), spec

    def test_can_be_described(self, family, kind):
        for path, holds, default, meaning in fields(components(family)[kind]):
            assert path
            assert meaning
            assert holds or (not default and ", " in path)

    def test_is_frozen_and_strict(self, family, kind):
        for spec in _with_nested(components(family)[kind]):
            assert spec.model_config["frozen"]
            assert spec.model_config["extra"] == "forbid"

    def test_refuses_an_unknown_key_with_the_nearest_name(self, family, kind):
        cls = components(family)[kind]
        name = next(iter(cls.model_fields), None)
        typo = f"{name}_" if name else "anything"
        with pytest.raises(ValidationError) as caught:
            Of(family).validate({"kind": kind, typo: 1})
        near = f"; did you mean '{name}'?" if name else ""
        allowed = ", ".join(cls.model_fields) or "none"
        messages = {problem.location: problem.message for problem in problems_of(caught.value)}
        assert messages[typo,] == f"unknown key{near} (allowed: {allowed})"

    def test_refuses_what_is_no_mapping(self, family, kind):
        for wrong in (3, [kind], None, True):
            with pytest.raises(ValidationError, match="must be a mapping with 'kind:'"):
                Of(family).validate(wrong)


@pytest.mark.parametrize(("family", "plain"), SETTINGS, ids=lambda value: str(value)[:40])
def test_survives_pickling_and_its_canonical_form(family, plain):
    spec = Of(family).validate(plain)
    assert pickle.loads(pickle.dumps(spec)) == spec
    assert Of(family).validate(canonical(spec)) == spec
    assert Of(family).validate(json.loads(json.dumps(canonical(spec)))) == spec


def _with_nested(spec):
    """The class and the plain specs that its fields hold, however deep."""
    yield spec
    for one in spec.model_fields.values():
        pending = [one.annotation]
        while pending:
            annotation = pending.pop()
            if inspect.isclass(annotation) and issubclass(annotation, Spec):
                if not issubclass(annotation, Component):
                    yield from _with_nested(annotation)
            else:
                pending += get_args(annotation)


def test_every_family_has_a_base_and_a_plural():
    assert set(BASES) == set(get_args(Family)) == set(PLURALS.values())


def test_every_estimator_has_an_example():
    estimators = {kind for family, kind in COMPONENTS if family == "estimator"}
    assert {example.settings["kind"] for example in EXAMPLES} == estimators, "add a line to EXAMPLES"


@_each_example()
class TestEveryEstimator:
    def test_leaves_the_record_as_it_is(self, example):
        record = generate(_data(example), 1, 0)
        u, y = record.u.copy(), record.y.copy()
        record.u.setflags(write=False)
        record.y.setflags(write=False)
        _fit(example, record)
        assert np.array_equal(record.u, u)
        assert np.array_equal(record.y, y)

    def test_does_not_modify_the_points_that_it_is_evaluated_at(self, example):
        found, _ = _fit(example, generate(_data(example), 1, 0))
        if found.nonlinearity is not None:
            points = np.linspace(0.9, -0.9, 7)
            points.setflags(write=False)
            assert found.nonlinearity(points).shape == points.shape

    def test_gives_the_same_bytes_for_the_same_stream(self, example):
        data, spec = _data(example), _spec(example)
        found = []
        for _ in range(2):
            result = estimate(data, Job(spec, ()), generate(data, 1, 0), 1, 0)
            points = np.linspace(-0.9, 0.9, 31)
            found.append((result, None if result.nonlinearity is None else result.nonlinearity(points)))
        _same(*found)

    def test_gives_the_same_bytes_whatever_runs_with_it(self, example):
        spec, trials = _spec(example), 5
        names = [name.removeprefix("value ") for name in spec.provides() if name.startswith("value ")]
        metrics: list[MetricSpec] = [Value(of=tuple(names))] if names else []
        if "nonlinearity" in spec.provides():
            metrics.append(IntegratedSquaredError(interval=(-0.5, 0.5), points=20))
        jobs = [Job(spec, tuple(metrics)), Job(spec, tuple(metrics))]
        for streams in ({}, {"fixed": ["input"]}):
            data = _data(example).model_copy(update={"streams": NumpyStreams(**streams)})
            found = [
                {
                    (outcome.trial, outcome.job): outcome.values.tobytes()
                    for chunk in chunks
                    for outcome in tried(data, jobs, dict.fromkeys(chunk, (0, 1)), 1)
                }
                for chunks in ([range(trials)], [[trial] for trial in range(trials)], [[3, 0], [2], [4, 1]])
            ]
            assert found[0] == found[1] == found[2]
            assert all(found[0][trial, 0] == found[0][trial, 1] for trial in range(trials)) or spec.draws()

    def test_provides_what_it_says(self, example):
        found, _ = _fit(example, generate(_data(example), 1, 0))
        given = {name for name in get_args(ModelPart) if getattr(found, name) is not None}
        assert given | {f"value {name}" for name in found.values} == _spec(example).provides()
        assert all(isinstance(value, float) for value in found.values.values())

    def test_dynamics_are_promised_by_those_that_always_give_them(self, example):
        spec = _spec(example)
        assert not type(spec).identifies_dynamics or "linear" in spec.provides()

    @pytest.mark.parametrize("more", [0, 1, 2, 5])
    def test_short_records_are_estimated_or_fail_as_a_result(self, example, more):
        record = generate(_data(example, _spec(example).fewest_samples() + more), 1, 0)
        try:
            found, curve = _fit(example, record)
        except EstimationError as error:
            assert str(error)
        else:
            assert set(found.values) == {
                part.removeprefix("value ") for part in _spec(example).provides() if part.startswith("value ")
            }
            assert (curve is None) == (found.nonlinearity is None)

    @pytest.mark.parametrize("wrong", [np.nan, np.inf])
    def test_an_output_that_is_not_finite_never_gives_a_curve_of_numbers(self, example, wrong):
        sound = generate(_data(example), 1, 0)
        record = replace(sound, y=np.where(np.arange(len(sound)) == 100, wrong, sound.y))
        try:
            found, curve = _fit(example, record)
        except EstimationError:
            return
        # Only what does not look at the output can be estimated from it.
        assert curve is None
        assert np.isfinite(list(found.values.values())).all()

    def test_a_constant_record_is_estimated_or_fails_as_a_result(self, example):
        sound = generate(_data(example), 1, 0)
        for u, y in [(0.5, 0.0), (0.5, 1.0), (0.0, 0.0)]:
            try:
                _fit(example, replace(sound, u=np.full(len(sound), u), y=np.full(len(sound), y)))
            except EstimationError as error:
                assert str(error)


def _several(example, length=None):
    """A record of several experiments at very different levels."""
    parts = [
        {"name": name, "samples": length or example.samples, "excitation": excitation}
        for name, excitation in (("low", example.excitation), ("high", _raised(example.excitation)))
    ]
    excitation = example.several or {"kind": "experiments", "parts": parts}
    samples = example.samples if example.several else 2 * (length or example.samples)
    if example.several is SINES:
        samples = 560
    return generate(_data(replace(example, excitation=excitation), samples), 1, 0)


def _raised(excitation):
    match excitation["kind"]:
        case "iid":
            return {**excitation, "low": -1.5, "high": 2}
        case "multistep":
            return {**excitation, "limits": [-1, 2]}
    return excitation


def _reversed(record):
    """The same experiments in the other order."""
    parts, start = {}, 0
    for name, part in reversed(record.parts.items()):
        parts[name] = replace(part, start=start, stop=start + len(part))
        start += len(part)
    u, y = (
        np.concatenate([signal[part.samples] for part in reversed(record.parts.values())])
        for signal in (record.u, record.y)
    )
    return Record(u, y, record.dt, record.truth, parts)


@_each_example()
class TestSeveralExperiments:
    """Where one ends and the next begins, nothing looks back: else their order would matter."""

    def test_their_order_does_not_matter_or_they_are_refused_by_name(self, example):
        record, spec = _several(example), _spec(example)
        assert len(record.parts) > 1
        if spec.takes_experiments() == "one":
            with pytest.raises(EstimationError, match=f"^{spec.kind} takes a record of one experiment"):
                spec.fit(record, np.random.default_rng(5))
            return
        _same(_fit(example, record), _fit(example, _reversed(record)), 1e-8)

    def test_their_sampling_intervals_are_one_unless_each_is_taken_by_itself(self, example):
        record, spec = _several(example), _spec(example)
        first, *others = record.parts
        parts = {**record.parts, first: replace(record.parts[first], dt=0.7 * record.parts[first].dt)}
        if spec.takes_experiments() != "at_one_interval":
            return
        assert others
        message = f"^{spec.kind} works at one sampling interval, and the experiment 'low' has"
        with pytest.raises(EstimationError, match=message):
            spec.fit(replace(record, parts=parts), np.random.default_rng(5))

    @pytest.mark.parametrize("length", [1, 2, 3, 5, 9, 40])
    def test_short_ones_are_estimated_or_fail_as_a_result(self, example, length):
        if example.several is not None:
            pytest.skip("its experiments have given lengths")
        try:
            _fit(example, _several(example, length))
        except EstimationError as error:
            assert str(error)


def _dull(example):
    """Records that excite nothing, by what is dull in them."""
    sound = generate(_data(example), 1, 0)
    n = len(sound)
    alternating = np.where(np.arange(n) % 2, -1.0, 1.0)
    yield "input", replace(sound, u=np.zeros(n), y=np.zeros(n))
    yield "input", replace(sound, u=np.full(n, 0.5), y=np.ones(n))
    yield "input", replace(sound, u=np.full(n, 0.5), y=np.zeros(n))
    yield "output", replace(sound, y=np.zeros(n))
    yield "output", replace(sound, y=np.ones(n))
    # The response of any linear block after a static function is of period 2 as well.
    yield "period", replace(sound, u=alternating, y=0.3 + 0.7 * np.roll(alternating, 1))


# Who may estimate from what: a static function has its values where the input was, a known nonlinearity of
# two values tells two lags apart, a bound knows the truth, and a given block is given.
_STATIC = ("kernel", "orthogonal")
_CONTENT = {
    "input": ("known_dynamics",),
    "output": ("known_dynamics", "cramer_rao", *_STATIC),
    "period": ("known_dynamics", "known_nonlinearity", *_STATIC),
}


@_each_example()
def test_data_that_excite_nothing_fail_with_a_reason(example):
    kind = example.settings["kind"]
    for dull, record in _dull(example):
        try:
            found, _ = _fit(example, record)
        except EstimationError as error:
            assert len(str(error)) > 20
        else:
            assert kind in _CONTENT[dull], dull
            assert kind not in _STATIC or "prefilter" not in example.settings
            assert np.isfinite(list(found.values.values())).all()


@_each_example("scale")
def test_the_scale_of_the_output(example):
    record = generate(_data(example), 1, 0)
    found, curve = _fit(example, record)
    scaled, scaled_curve = _fit(example, replace(record, y=8.0 * record.y))
    if curve is not None:
        np.testing.assert_allclose(scaled_curve, 8.0 * curve, rtol=1e-9)
    if found.linear is not None:
        np.testing.assert_allclose(scaled.linear.a, found.linear.a, rtol=1e-9, atol=1e-12)


@_each_example("order")
def test_the_order_of_the_samples(example):
    record = generate(_data(example), 1, 0)
    shuffled = np.random.default_rng(2).permutation(len(record))
    other = Record(record.u[shuffled], record.y[shuffled], record.dt, record.truth)
    _same(_fit(example, record), _fit(example, other), 1e-10)
