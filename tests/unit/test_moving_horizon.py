"""Least squares over moving horizons and its diagnostics, against their definitions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hident.estimators.moving_horizon.transform.horizon_least_squares import (
    scaled_condition,
    solve,
    variance_inflation,
)

QUICK = settings(deadline=None, derandomize=True, max_examples=30)


def problem(seed, shape=(), rows=40, parameters=4):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(*shape, rows, parameters)), rng.normal(size=(*shape, rows))


class TestSolve:
    @QUICK
    @given(seed=st.integers(0, 99), parameters=st.integers(1, 9), spread=st.floats(0, 12))
    def test_equals_lstsq_however_the_columns_are_scaled(self, seed, parameters, spread):
        phi, z = problem(seed, parameters=parameters)
        scale = 10.0 ** np.linspace(-spread, spread, parameters)
        wanted = np.linalg.lstsq(phi, z)[0]
        np.testing.assert_allclose(solve(phi * scale, z) * scale, wanted, rtol=1e-11, atol=1e-12)

    @pytest.mark.parametrize("shape", [(1,), (5,), (2, 3)])
    def test_takes_stacks(self, shape):
        phi, z = problem(0, shape)
        found = solve(phi, z)
        assert found.shape == (*shape, 4)
        for index in np.ndindex(shape):
            np.testing.assert_allclose(found[index], np.linalg.lstsq(phi[index], z[index])[0], rtol=1e-11)

    def test_as_many_equations_as_parameters_are_met(self):
        phi, z = problem(3, rows=4)
        np.testing.assert_allclose(phi @ solve(phi, z), z, atol=1e-12)

    def test_does_not_change_its_arguments(self):
        phi, z = problem(1)
        before = phi.copy(), z.copy()
        solve(phi, z)
        np.testing.assert_array_equal(phi, before[0])
        np.testing.assert_array_equal(z, before[1])

    @pytest.mark.parametrize("mix", [[1, 0, 0, 0], [-1e5, 3, 0, 0], [0, 0, 0, 0]])
    def test_dependent_regressors_give_what_is_not_finite(self, mix):
        phi, z = problem(2)
        found = solve(np.column_stack((phi, phi @ np.array(mix, dtype=float))), z)
        assert not np.isfinite(found[-1])

    def test_one_singular_member_of_a_stack_leaves_the_others(self):
        phi, z = problem(4, (3,))
        phi[1, :, 2] = phi[1, :, 0]
        found = solve(phi, z)
        assert not np.isfinite(found[1]).all()
        for i in (0, 2):
            np.testing.assert_allclose(found[i], np.linalg.lstsq(phi[i], z[i])[0], rtol=1e-11)


class TestDiagnostics:
    @QUICK
    @given(seed=st.integers(0, 99), mix=st.floats(0, 0.999), parameters=st.integers(2, 6))
    def test_variance_inflation_is_the_textbook_one(self, seed, mix, parameters):
        phi = problem(seed, parameters=parameters)[0]
        phi[:, 1] = mix * phi[:, 0] + (1 - mix) * phi[:, 1] + 7.0
        found = variance_inflation(phi)
        for j in range(parameters):
            others = np.column_stack((np.ones(len(phi)), np.delete(phi, j, axis=1)))
            residual = phi[:, j] - others @ np.linalg.lstsq(others, phi[:, j])[0]
            r_squared = 1 - residual @ residual / np.sum((phi[:, j] - phi[:, j].mean()) ** 2)
            assert found[j] == pytest.approx(1 / (1 - r_squared), rel=1e-6)

    def test_one_regressor_inflates_nothing(self):
        np.testing.assert_allclose(variance_inflation(problem(0, parameters=1)[0]), 1.0)

    @QUICK
    @given(seed=st.integers(0, 99), scale=st.floats(1e-6, 1e6), shift=st.floats(-5, 5))
    def test_units_and_offsets_do_not_matter_to_it(self, seed, scale, shift):
        phi = problem(seed)[0]
        moved = phi * [scale, 1, 1, 1] + [0, shift, 0, 0]
        np.testing.assert_allclose(variance_inflation(moved), variance_inflation(phi), rtol=1e-8)

    @QUICK
    @given(seed=st.integers(0, 99), spread=st.floats(0, 12))
    def test_the_condition_is_that_of_unit_columns(self, seed, spread):
        phi = problem(seed)[0]
        wanted = np.linalg.cond(phi / np.sqrt(np.sum(phi**2, axis=0)))
        scale = 10.0 ** np.linspace(-spread, spread, 4)
        assert scaled_condition(phi * scale) == pytest.approx(wanted, rel=1e-9)

    def test_both_take_stacks(self):
        phi = problem(0, (2, 3))[0]
        for measure, shape in ((variance_inflation, (2, 3, 4)), (scaled_condition, (2, 3))):
            found = measure(phi)
            assert found.shape == shape
            np.testing.assert_allclose(found[1, 2], measure(phi[1, 2]), rtol=1e-11)
