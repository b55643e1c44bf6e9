import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hident.estimators.moving_horizon.wiener.four_segment import FourSegment, forward, inverse, segments

slopes = st.tuples(*[st.floats(0.05, 20.0)] * 3).map(np.array)
below, above = st.floats(-2.0, -0.1), st.floats(0.1, 2.0)
OUTPUTS = np.linspace(-4.0, 4.0, 401)


def _any_function(test):
    given_function = given(e=slopes, lower=below, upper=above)
    return settings(deadline=None, derandomize=True, max_examples=60)(given_function(test))


class TestTheFunctionAndItsInverse:
    @_any_function
    def test_undo_each_other(self, e, lower, upper):
        x = inverse(OUTPUTS, e, lower, upper)
        np.testing.assert_allclose(forward(x, e, lower, upper), OUTPUTS, atol=1e-12)

    @_any_function
    def test_the_inverse_rises_and_has_the_given_slopes(self, e, lower, upper):
        h = 1e-3
        for y, slope in [
            (lower - 1.0, e[0]),
            (0.5 * lower, e[1]),
            (0.5 * upper, 1.0),
            (upper + 1.0, e[2]),
        ]:
            at = inverse(np.array([y - h, y + h]), e, lower, upper)
            assert np.diff(at)[0] / (2.0 * h) == pytest.approx(slope, rel=1e-9)
        assert np.all(np.diff(inverse(OUTPUTS, e, lower, upper)) > 0.0)

    @_any_function
    def test_vanish_at_zero(self, e, lower, upper):
        assert inverse(np.zeros(1), e, lower, upper) == 0.0
        assert forward(np.zeros(1), e, lower, upper) == 0.0


def test_equation_13_case_by_case():
    e_2, e_1m, e_2m, y_1, y_1m = 3.0, 0.5, 2.0, 0.8, -0.4
    y = np.array([-1.4, -0.2, 0.3, 1.8])
    expected = [e_2m * (-1.4 - y_1m) + e_1m * y_1m, e_1m * -0.2, 0.3, e_2 * (1.8 - y_1) + y_1]
    np.testing.assert_allclose(inverse(y, np.array([e_2m, e_1m, e_2]), y_1m, y_1), expected, rtol=1e-15)


def test_equation_16_case_by_case():
    g = segments(np.array([-1.4, -0.2, 0.3, 1.8]), -0.4, 0.8)
    expected = [[-1.0, -0.4, 0.0], [0.0, -0.2, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    np.testing.assert_allclose(g, expected, atol=1e-15)


def test_many_functions_at_once():
    e = np.array([[2.0, 1.0], [0.5, 3.0], [4.0, 0.2]])
    lower, upper = np.array([-0.5, -1.0]), np.array([0.3, 0.6])
    x = np.linspace(-3.0, 3.0, 12).reshape(6, 2)
    alone = [forward(x[:, j], e[:, j], lower[j], upper[j]) for j in range(2)]
    np.testing.assert_array_equal(forward(x, e, lower, upper), np.stack(alone, axis=1))


def test_the_nonlinearity_takes_the_input_in_units_of_the_static_gain():
    function = FourSegment((2.0, 0.5, 3.0), -0.4, 0.8, gain=-2.5)
    v = np.linspace(-2.0, 2.0, 9)
    np.testing.assert_array_equal(function(v), forward(-2.5 * v, np.array([2.0, 0.5, 3.0]), -0.4, 0.8))
    assert pickle.loads(pickle.dumps(function)) == function
