"""Nonlinearities: closed forms, break points, symmetries, messages."""

import pickle
from typing import Annotated, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pydantic import TypeAdapter, ValidationError

from hident.arrays import Characteristic
from hident.config.spec import Of, components
from hident.linear_blocks import TransferFunction
from hident.systems import nonlinearity as own
from hident.systems.base import NonlinearitySpec

spec: TypeAdapter[NonlinearitySpec] = TypeAdapter(Annotated[NonlinearitySpec, Of("nonlinearity")])
quick = settings(deadline=None, derandomize=True, max_examples=50)
inputs = hnp.arrays(float, hnp.array_shapes(max_dims=2, max_side=20), elements=st.floats(-8, 8))


def build(kind: str, **keys: Any) -> NonlinearitySpec:
    return spec.validate_python({"kind": kind, **keys})


POINTS = [[-1, 2], [0, 0], [2, 1], [3, 1.5]]
EXAMPLES: dict[str, tuple[NonlinearitySpec, Characteristic, tuple[float, ...]]] = {
    "abs": (build("abs"), np.abs, (0,)),
    "chen_type_1": (build("chen_type_1"), lambda u: u / np.sqrt(0.1 + 0.9 * u**2), ()),
    "chen_type_2": (build("chen_type_2"), lambda u: -(u**2) * (1 - np.exp(0.7 * u)), ()),
    "chen_type_3": (
        build("chen_type_3"),
        lambda u: np.where(u >= 0, u / np.sqrt(0.1 + 0.9 * u**2), -(u**2) * (1 - np.exp(0.7 * u))),
        (0,),
    ),
    "chen_type_4": (build("chen_type_4", d=0.5), lambda u: u / np.sqrt(0.5 + 0.9 * u**2), ()),
    "dead_zone": (
        build("dead_zone", low=-1, high=2, gain=3),
        lambda u: np.select([u < -1, u > 2], [3 * (u + 1), 3 * (u - 2)], 0.0),
        (-1, 2),
    ),
    "exponential": (build("exponential", scale=50, rate=0.2), lambda u: 50 * np.exp(0.2 * u), ()),
    "expression": (
        build("expression", expression="maximum(u, 1)**2", breaks=[1]),
        lambda u: np.where(u > 1, u**2, 1.0),
        (1,),
    ),
    "identity": (build("identity"), lambda u: u, ()),
    "mzyk2009": (
        build("mzyk2009"),
        lambda u: np.select(
            [u > 0, u < 0], [1.5 * (u - np.pi) + 2 * np.sin(u), 0.5 * (u + np.pi) + 2 * np.sin(u)], -np.pi / 2
        ),
        (0,),
    ),
    "piecewise_linear": (
        build("piecewise_linear", points=POINTS),
        lambda u: np.where(u < 0, -2 * u, u / 2),
        (0,),
    ),
    "polynomial": (
        build("polynomial", coefficients=[0, 1, 2, 5, 7, 1]),
        lambda u: u + 2 * u**2 + 5 * u**3 + 7 * u**4 + u**5,
        (),
    ),
    "power": (build("power", exponent=3), lambda u: u * u * u, ()),
    "saturation": (
        build("saturation", low=-1, high=2, gain=3),
        lambda u: np.select([u < -1, u > 2], [-3.0, 6.0], 3 * u),
        (-1, 2),
    ),
    "sign": (build("sign"), lambda u: 1.0 * (u > 0) - 1.0 * (u < 0), (0,)),
}
every = pytest.mark.parametrize("kind", EXAMPLES)


def test_every_kind_has_its_example():
    known = components("nonlinearity").items()
    assert {kind for kind, cls in known if cls.__module__ == own.__name__} == set(EXAMPLES)


@every
@quick
@given(u=inputs)
def test_characteristic_has_its_closed_form(kind, u):
    characteristic, closed_form, _ = EXAMPLES[kind]
    before = u.copy()
    value = characteristic(u)
    np.testing.assert_allclose(value, closed_form(u), rtol=1e-12, atol=1e-12)
    assert value.dtype == np.float64
    assert value.shape == u.shape
    assert not np.shares_memory(value, u)
    np.testing.assert_array_equal(u, before)


@every
def test_break_points_are_where_the_curve_breaks(kind):
    characteristic, _, expected = EXAMPLES[kind]
    assert characteristic.break_points() == expected
    # A kink shows in second differences as step * jump of slope, a smooth curve as step^2 * curvature.
    step = 1e-5
    u = np.arange(-2.5, 2.5, step) + step / 3
    broken = u[1:-1][np.abs(np.diff(characteristic(u), 2)) > 1e-6]
    assert set(np.round(broken, 3) + 0.0) == set(expected)


@every
def test_survives_pickling(kind):
    characteristic = EXAMPLES[kind][0]
    again = pickle.loads(pickle.dumps(characteristic))
    u = np.linspace(-3, 3, 7)
    assert again == characteristic
    np.testing.assert_array_equal(again(u), characteristic(u))


@every
def test_has_a_one_line_description(kind):
    assert components("nonlinearity")[kind].summary()


@pytest.mark.parametrize(
    ("kind", "keys"),
    [("chen_type_1", {}), ("chen_type_4", {"d": 0.02}), ("sign", {}), ("power", {"exponent": 5})],
)
@quick
@given(u=inputs)
def test_odd_symmetry(kind, keys, u):
    characteristic = build(kind, **keys)
    np.testing.assert_allclose(characteristic(-u), -characteristic(u), rtol=1e-15, atol=0)


def test_type_4_is_type_1_at_its_constant():
    u = np.linspace(-3, 3, 101)
    np.testing.assert_array_equal(build("chen_type_4", d=0.1)(u), build("chen_type_1")(u))


def test_type_3_does_not_overflow_where_its_branch_is_not_used():
    np.testing.assert_allclose(build("chen_type_3")(np.array([1e5, -1e3])), [1 / np.sqrt(0.9), -1e6])


def test_mzyk_jumps_at_zero_from_above_to_below():
    below, at, above = build("mzyk2009")(np.array([-1e-12, 0.0, 1e-12]))
    np.testing.assert_allclose([below, at, above], [np.pi / 2, -np.pi / 2, -3 * np.pi / 2], atol=1e-10)


def test_mzyk_equals_its_formula():
    u = np.linspace(-2 * np.pi, 2 * np.pi, 1001)
    formula = build("expression", expression="(1/2 + sign(u))*(abs(u) - pi) + 2*sin(u)", breaks=[0])
    np.testing.assert_allclose(formula(u), build("mzyk2009")(u), rtol=0, atol=1e-14)


def test_mzyk_moments_under_the_papers_uniform_input():
    """Mean 0, energy 5 pi^3/3 - 8 pi = 26.54, variance 2.11; var delta of eq. (20) is 3.76."""
    node, weight = np.polynomial.legendre.leggauss(40)
    u = np.concatenate((np.pi * (node - 1), np.pi * (node + 1)))
    weight = np.pi * np.concatenate((weight, weight))
    mu = build("mzyk2009")(u)
    energy = weight @ mu**2
    variance = energy / (4 * np.pi)
    assert weight @ mu == pytest.approx(0.0, abs=1e-12)
    assert energy == pytest.approx(5 * np.pi**3 / 3 - 8 * np.pi, rel=1e-13)
    assert variance == pytest.approx(2.11, abs=0.005)
    gamma = TransferFunction(a=(0.8,)).impulse_response(200)
    noise_variance = 0.2**2 / 12
    assert noise_variance + variance * (gamma[1:] @ gamma[1:]) == pytest.approx(3.76, abs=0.005)


def test_a_power_of_zero_is_one_everywhere():
    np.testing.assert_array_equal(build("power", exponent=0)(np.array([-1.0, 0.0, 2.0])), 1.0)


@quick
@given(
    steps=st.lists(st.floats(0.01, 3), min_size=1, max_size=8),
    values=st.lists(st.floats(-5, 5), min_size=9, max_size=9),
    ends=st.tuples(st.none() | st.floats(-3, 3), st.none() | st.floats(-3, 3)),
)
def test_piecewise_linear_is_continuous_and_meets_its_points(steps, values, ends):
    knots = np.concatenate(([0.0], np.cumsum(steps))) - 2.0
    points = list(zip(knots.tolist(), values, strict=False))
    curve = build("piecewise_linear", points=points, left_slope=ends[0], right_slope=ends[1])
    np.testing.assert_allclose(curve(knots), values[: len(knots)], rtol=0, atol=1e-12)
    steepest = 10 / 0.009
    step = 1e-9
    assert np.all(np.abs(curve(knots + step) - curve(knots - step)) <= 2.1 * step * steepest)


def test_piecewise_linear_takes_given_end_slopes():
    curve = build("piecewise_linear", points=[[0, 0], [1, 2]], left_slope=-1, right_slope=0)
    np.testing.assert_allclose(curve(np.array([-3.0, 0.5, 5.0])), [3, 1, 2])
    assert curve.break_points() == (0, 1)
    straight = build("piecewise_linear", points=[[0, 0], [0.1, 0.1], [0.3, 0.3]])
    assert straight.break_points() == ()


def test_dead_zone_and_saturation_add_up_to_the_identity():
    u = np.linspace(-5, 5, 101)
    ends = {"low": -1, "high": 2}
    np.testing.assert_allclose(build("dead_zone", **ends)(u) + build("saturation", **ends)(u), u, atol=1e-15)


INF = float("inf")


@pytest.mark.parametrize("kind", ["saturation", "dead_zone"])
@quick
@given(u=inputs)
def test_a_limit_may_be_missing_on_one_side(kind, u):
    # Beyond any input a limit is as good as none.
    for ends, far, breaks in (
        ({"low": -1, "high": INF}, {"low": -1, "high": 100}, (-1,)),
        ({"low": -INF, "high": 2}, {"low": -100, "high": 2}, (2,)),
    ):
        found = build(kind, gain=3, **ends)
        assert found.break_points() == breaks
        limited = u if kind == "saturation" else np.clip(u, -90, 90)
        np.testing.assert_allclose(found(limited), build(kind, gain=3, **far)(limited), atol=1e-12)


@pytest.mark.parametrize(("formula", "value"), [("2", 2.0), ("pi/2", np.pi / 2), ("1 > 0", 1.0)])
def test_a_formula_without_u_keeps_the_shape(formula, value):
    result = build("expression", expression=formula)(np.zeros((3, 2)))
    np.testing.assert_array_equal(result, np.full((3, 2), value))


def test_breaks_of_a_formula_are_sorted_once_each():
    assert build("expression", expression="u", breaks=["pi", 0, -1, 0]).break_points() == (-1, 0, np.pi)


@pytest.mark.parametrize(
    ("kind", "keys", "place", "message"),
    [
        (
            "expression",
            {"expression": "abs(x)"},
            "expression",
            "unknown name 'x' in the formula 'abs(x)'",
        ),
        ("expression", {"expression": "u +"}, "expression", "cannot read the formula 'u +': invalid syntax"),
        ("power", {"exponent": -1}, "exponent", "must be 0 or more, not -1"),
        ("power", {"exponent": 1.5}, "exponent", "must be a whole number"),
        ("polynomial", {"coefficients": []}, "coefficients", "must be a list of at least one number"),
        ("chen_type_4", {"d": 0}, "d", "must be positive, not 0"),
        ("saturation", {"low": 1, "high": 1}, "", "'low' must be below 'high', not 1 and 1"),
        ("dead_zone", {"low": INF, "high": 1}, "", "'low' must be below 'high', not inf and 1"),
        (
            "saturation",
            {"low": -INF, "high": INF},
            "",
            "'low' and 'high' are infinite: one of them must be a number",
        ),
        ("saturation", {"low": 0, "high": float("nan")}, "high", "must be a number, or a formula such as"),
        ("saturation", {"low": 0, "high": 1, "gain": INF}, "gain", "must be a finite number"),
        ("piecewise_linear", {"points": [[0, 1]]}, "points", "must be at least two points, not 1"),
        ("piecewise_linear", {"points": [[0, 1], 2]}, "points.1", "must be a pair [u, value]"),
        (
            "piecewise_linear",
            {"points": [[1, 0], [0.5, 1]]},
            "points",
            "u must increase from point to point: 0.5 follows 1",
        ),
    ],
)
def test_what_is_refused(kind, keys, place, message):
    with pytest.raises(ValidationError) as caught:
        build(kind, **keys)
    (error,) = caught.value.errors()
    assert ".".join(map(str, error["loc"])) == place
    assert error["msg"].removeprefix("Value error, ").startswith(message)
