import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hident.estimators.moving_horizon.wiener import stage
from hident.estimators.moving_horizon.wiener.batched_blocks import responses, time_constants
from hident.estimators.moving_horizon.wiener.iteration import FourSegments, Powers, Rule, iterate
from hident.estimators.moving_horizon.wiener.stage import search_partition
from hident.linear_blocks import ContinuousTransferFunction
from tests.unit.wiener_records import TRUTH, cubic, record, wiener


class TestManyBlocks:
    @pytest.mark.parametrize("delay", [0.0, 0.03, 0.4, 0.43])
    def test_respond_as_each_alone(self, delay):
        a = np.array([[4.0, 5.0, 2.0], [1.5, 2.0, 0.3], [6.0, 12.0, 8.0]])
        b = np.array([[1.0, -2.0], [0.5, 0.1], [-1.0, 0.0]])
        u = record(dt=0.1).u
        together = responses(a, b, delay, u, 0.1)
        for j in range(3):
            alone = ContinuousTransferFunction(tuple(b[j]), tuple(a[j]), delay).respond(u, 0.1)
            np.testing.assert_allclose(together[:, j], alone, atol=1e-11)

    def test_first_order_without_delay(self):
        t = 0.1 * np.arange(50)
        x = responses(np.array([[2.0]]), np.array([[3.0]]), 0.0, np.ones(50), 0.1)
        np.testing.assert_allclose(x[:, 0], 3.0 * (1.0 - np.exp(-t / 2.0)), atol=1e-13)

    def test_a_delay_beyond_the_record_leaves_nothing(self):
        assert not np.any(responses(np.array([[2.0]]), np.array([[3.0]]), 9.0, np.ones(50), 0.1))

    def test_poles_in_the_right_half_plane_are_reflected(self):
        # (1 - 2 s)(1 + 3 s) becomes (1 + 2 s)(1 + 3 s).
        unstable, reflected = np.array([[1.0, -6.0]]), np.array([[5.0, 6.0]])
        u, b = record(dt=0.1).u, np.array([[1.0, 0.5]])
        expected = responses(reflected, b, 0.0, u, 0.1)
        np.testing.assert_allclose(responses(unstable, b, 0.0, u, 0.1), expected, atol=1e-11)

    @settings(deadline=None, derandomize=True, max_examples=30)
    @given(real=st.floats(0.1, 3.0), imaginary=st.floats(0.0, 3.0), other=st.floats(-3.0, -0.1))
    def test_time_constants_are_the_negative_inverse_poles(self, real, imaginary, other):
        tau = np.array([real + 1j * imaginary, real - 1j * imaginary, other])
        a = np.asarray(np.poly(-tau).real[1:], dtype=float)
        np.testing.assert_allclose(
            np.sort_complex(time_constants(a[None])[0]), np.sort_complex(tau), atol=1e-4
        )


class TestTheIteration:
    def test_many_pairs_at_once_give_what_each_gives_alone(self):
        data = wiener(record(seed=3))
        points = np.array([[-0.6, -0.9, -0.2], [0.5, 0.3, 0.8]])
        together = iterate(data, FourSegments.of_points(data, points, data.y), Rule())
        for j in range(3):
            alone = iterate(data, FourSegments.of_points(data, points[:, j : j + 1], data.y), Rule())
            np.testing.assert_allclose(together.theta[j], alone.theta[0], rtol=1e-7)
            assert together.iterations[j] == alone.iterations[0]

    def test_transforms_alone_give_what_samples_give(self):
        """x of the four-segment form is never built; its transforms are those of the samples of (29)."""
        data = wiener(record())
        points, c = np.array([[-0.6], [0.5]]), np.array([[0.5, -1.0, -2.0]])
        x_lin = np.sin(0.3 * data.dt * np.arange(len(data.y)))[:, None]
        begun = FourSegments.of_points(data, points, data.y)
        basis = np.stack(
            [np.minimum(data.y + 0.6, 0.0), np.clip(data.y, -0.6, 0.0), np.maximum(data.y - 0.5, 0.0)]
        )
        x = 0.3 * x_lin + 0.7 * (data.y - c @ basis).T
        found = begun.updated(x_lin, c, 0.3, np.zeros(1)).derivatives
        np.testing.assert_allclose(found, data.transforms(x)[..., 1:], atol=1e-12)

    def test_the_truth_is_a_fixed_point(self):
        data = record(cubic)
        x = TRUTH.respond(data.u, data.dt)[:, None]
        found = iterate(wiener(data), Powers(wiener(data), 3, x), Rule(tolerance=1e-8))
        assert found.iterations[0] <= 2
        np.testing.assert_allclose(found.theta[0], [3.0, 2.0, 1.2, -0.5, 0.2, 0.05], rtol=1e-7)


class TestTheSearch:
    def test_the_best_pair_is_no_worse_than_the_grid(self):
        search = search_partition(wiener(record(dt=0.1)), Rule(), 0.0)
        assert search.loss.shape == (len(search.lower), len(search.upper)) == (8, 8)
        assert np.all(np.diff(search.lower) > 0.0)
        assert np.all(np.diff(search.upper) > 0.0)
        assert search.best_loss <= np.nanmin(search.loss)

    def test_is_the_same_a_few_pairs_at_a_time(self, monkeypatch):
        data = wiener(record(dt=0.1))
        whole = search_partition(data, Rule(), 0.0)
        monkeypatch.setattr(stage, "_AT_ONCE", 5 * len(data.y))
        parts = search_partition(data, Rule(), 0.0)
        np.testing.assert_allclose(parts.loss, whole.loss, rtol=1e-6)
        np.testing.assert_allclose(parts.best, whole.best, rtol=1e-12)
