"""Bases of static functions: values, slopes, lines beyond the ends, other units."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hident.static_functions import (
    BASES,
    Chebyshev,
    CubicSpline,
    DeadZone,
    PiecewiseLinear,
    Saturation,
    StaticFunction,
)

SOME = {
    basis.kind: basis
    for basis in (
        Chebyshev(4, -2.0, 3.0),
        PiecewiseLinear((-3.0, -1.0, 0.5, 2.0)),
        CubicSpline((-3.0, -1.0, 0.0, 2.0, 3.0)),
        Saturation(-0.5, 0.7),
        DeadZone(-0.5, 0.7),
    )
}
X = np.random.default_rng(0).uniform(-5.0, 5.0, 400)
kinds = pytest.mark.parametrize("kind", SOME)


def coefficients(basis, seed=1):
    return np.random.default_rng(seed).normal(size=basis.size)


def function(kind, seed=1):
    return StaticFunction(SOME[kind], tuple(coefficients(SOME[kind], seed).tolist()))


def test_every_kind_is_tested():
    assert SOME.keys() == BASES.keys()


@kinds
class TestOneBasis:
    def test_rows_add_up_to_the_value(self, kind):
        basis, c = SOME[kind], coefficients(SOME[kind])
        assert basis.rows(X).shape == (basis.size, len(X))
        np.testing.assert_allclose(c @ basis.rows(X), basis.value(c, X), rtol=1e-12, atol=1e-12)

    def test_slope_is_the_derivative(self, kind):
        f, h = function(kind), 1e-6
        differences = (f(X + h) - f(X - h)) / (2.0 * h)
        np.testing.assert_allclose(f.slope(X), differences, rtol=1e-6, atol=1e-7)

    def test_shape_rows_are_derivatives(self, kind):
        basis, c, h = SOME[kind], coefficients(SOME[kind]), 1e-6
        rows = basis.shape_rows(c, X)
        assert rows.shape == (len(basis.shape), len(X))
        for k, row in enumerate(rows):
            step = h * np.eye(len(basis.shape))[k]
            up, down = (basis.reshaped(basis.shape + sign * step).value(c, X) for sign in (1.0, -1.0))
            np.testing.assert_allclose(row, (up - down) / (2.0 * h), rtol=1e-6, atol=1e-8)

    def test_it_is_a_line_beyond_its_ends(self, kind):
        f = function(kind)
        for end, way in zip(f.range, (-1.0, 1.0), strict=True):
            far = end + way * np.array([0.0, 1.0, 10.0, 1000.0])
            # Beside the end itself, where a corner has no slope.
            slope = f.slope(np.array([end + way * 1e-9]))
            np.testing.assert_allclose(f(far), f(far[:1]) + slope * (far - end), rtol=1e-8, atol=1e-8)

    def test_the_constant(self, kind):
        np.testing.assert_allclose(SOME[kind].constant() @ SOME[kind].rows(X), 1.0, rtol=1e-12)

    def test_any_shape_of_x(self, kind):
        f = function(kind)
        np.testing.assert_array_equal(f(X.reshape(20, 20)), f(X).reshape(20, 20))
        np.testing.assert_array_equal(f.slope(X.reshape(20, 20)), f.slope(X).reshape(20, 20))
        assert f(np.float64(0.25)).shape == ()


factors = st.floats(0.01, 100.0).flatmap(lambda size: st.sampled_from([size, -size]))
offsets = st.floats(-10.0, 10.0)


@kinds
@given(factor=factors, offset=offsets, seed=st.integers(0, 99))
@settings(max_examples=30, deadline=None)
def test_moved_is_the_function_of_the_moved_variable(kind, factor, offset, seed):
    f = function(kind, seed)
    moved = f.moved(factor, offset)
    size = np.max(np.abs(f(X)))
    np.testing.assert_allclose(moved(factor * X + offset), f(X), rtol=1e-9, atol=1e-9 * size)
    back = moved.moved(1.0 / factor, -offset / factor)
    np.testing.assert_allclose(back(X), f(X), rtol=1e-9, atol=1e-9 * size)
    np.testing.assert_allclose(moved.range, sorted(factor * np.array(f.range) + offset), rtol=1e-12)


@kinds
@given(factor=factors, offset=offsets, seed=st.integers(0, 99))
@settings(max_examples=30, deadline=None)
def test_scaled_is_a_factor_and_a_constant(kind, factor, offset, seed):
    f = function(kind, seed)
    scale = abs(factor) * np.max(np.abs(f(X))) + abs(offset)
    np.testing.assert_allclose(
        f.scaled(factor, offset)(X), factor * f(X) + offset, rtol=1e-12, atol=1e-12 * scale
    )


def test_a_cubic_spline_holds_every_cubic_polynomial():
    basis = CubicSpline((-5.0, -1.0, 2.0, 5.0))
    target = 1.0 - 2.0 * X + 0.3 * X**2 - 0.1 * X**3
    c = np.asarray(np.linalg.lstsq(basis.rows(X).T, target, rcond=None)[0], dtype=float)
    np.testing.assert_allclose(basis.value(c, X), target, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("kind", ["saturation", "dead_zone"])
def test_corners_in_the_wrong_order(kind):
    with pytest.raises(ValueError, match=r"^the corners 1 and -2 are not in increasing order$"):
        SOME[kind].reshaped((1.0, -2.0))
