"""The time-weighted transform: exact for held signals, of high order for sampled ones."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial
from scipy.integrate import quad

from hident.estimators.moving_horizon.transform.time_weighted import SMOOTH, Horizons, Knots, fewest_samples
from hident.linear_blocks import ContinuousTransferFunction

QUICK = settings(deadline=None, derandomize=True, max_examples=30)


def horizons(samples=401, dt=0.05, *, eta=8.0, overlap=0.3, order=3, start=0.0):
    return Horizons.of(samples, dt, eta=eta, overlap=overlap, order=order, start=start)


def transforms(f, over, knots=SMOOTH):
    """The transforms (n + 1, count) of a function of time, from its samples."""
    return over.transform(over.sampled(knots), f(over.dt * np.arange(over.samples)))


def weight(over):
    """w against s, and its derivatives with respect to time."""
    w = Polynomial([0.0, 4.0, -4.0]) ** over.order
    return [w.deriv(i) / over.eta**i if i else w for i in range(over.order + 1)]


def reference(cells, over, k):
    """The transforms (n + 1,) over horizon k of a signal of constant ``cells`` (start, end, level)."""
    begin = over.starts[k] * over.dt
    total = np.zeros(over.order + 1)
    for start, end, level in cells:
        low, high = np.clip([(start - begin) / over.eta, (end - begin) / over.eta], 0.0, 1.0)
        if high > low:
            for i, w in enumerate(weight(over)):
                total[i] += (-1) ** i * level * quad(w, low, high, epsabs=1e-13, epsrel=1e-10)[0]
    return total


class TestDefinition:
    def test_is_the_weighted_mean_over_the_horizon(self):
        over = horizons(order=2, start=1.0)
        found = transforms(lambda t: np.exp(-0.2 * t), over)
        for k in (0, over.count - 1):
            begin = over.starts[k] * over.dt
            for i, w in enumerate(weight(over)):
                wanted, _ = quad(lambda s, w=w: w(s) * np.exp(-0.2 * (begin + over.eta * s)), 0, 1)  # noqa: B023
                assert found[i, k] == pytest.approx((-1) ** i * wanted, rel=1e-9, abs=1e-12)

    @QUICK
    @given(
        coefficients=st.lists(st.floats(-2, 2), min_size=1, max_size=6),
        order=st.integers(1, 6),
        start=st.floats(0, 3),
    )
    def test_of_derivatives_of_polynomials(self, coefficients, order, start):
        over = horizons(order=order, start=start)
        f = Polynomial(coefficients, domain=[0, 20], window=[-1, 1])
        found = transforms(f, over)
        scale = np.max(np.abs(f(np.linspace(0, 20, 100))))
        for i in range(order + 1):
            # Polynomials of degree 5 are exact whatever the sampling.
            wanted = transforms(f.deriv(i) if i else f, over)[0]
            np.testing.assert_allclose(found[i], wanted, rtol=0, atol=1e-12 * scale)

    @QUICK
    @given(
        omega=st.floats(0.1, 1.5),
        phase=st.floats(0, 7),
        order=st.integers(1, 5),
        eta=st.floats(5, 12),
        overlap=st.floats(0.05, 1),
    )
    def test_of_derivatives_of_sines(self, omega, phase, order, eta, overlap):
        over = horizons(2001, 0.01, eta=eta, overlap=overlap, order=order)
        found = transforms(lambda t: np.sin(omega * t + phase), over)
        for i in range(order + 1):
            derivative = transforms(lambda t, i=i: omega**i * np.sin(omega * t + phase + i * np.pi / 2), over)
            np.testing.assert_allclose(found[i], derivative[0], rtol=0, atol=1e-9)

    @QUICK
    @given(rate=st.floats(-1, 0.2), order=st.integers(1, 5), start=st.floats(0, 5))
    def test_of_derivatives_of_exponentials(self, rate, order, start):
        over = horizons(2001, 0.01, order=order, start=start)
        found = transforms(lambda t: np.exp(rate * t), over)
        for i in range(order + 1):
            np.testing.assert_allclose(found[i], rate**i * found[0], rtol=0, atol=1e-9 * found[0].max())

    @QUICK
    @given(tau=st.floats(1e-5, 1e5), order=st.integers(1, 5))
    def test_the_unit_of_time_scales_the_derivatives(self, tau, order):
        f = np.random.default_rng(order).normal(size=401)
        over, scaled = horizons(order=order), horizons(dt=0.05 * tau, eta=8 * tau, order=order)
        powers = tau ** np.arange(order + 1.0)[:, None]
        for one, other in (
            (over.sampled(), scaled.sampled()),
            (over.held(1.23), scaled.held(1.23 * tau)),
        ):
            wanted = over.transform(one, f)
            found = scaled.transform(other, f) * powers
            np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-9 * np.abs(wanted).max())

    def test_several_signals_at_once_are_each_transformed(self):
        over = horizons()
        f = np.random.default_rng(0).normal(size=(over.samples, 3))
        together = over.transform(over.sampled(), f)
        assert together.shape == (4, over.count, 3)
        for j in range(3):
            np.testing.assert_allclose(together[..., j], over.transform(over.sampled(), f[:, j]), atol=1e-14)


class TestHeld:
    @pytest.mark.parametrize("delay", [0.0, 1.0, 0.13, 7.37, 100.0])
    @pytest.mark.parametrize("order", [1, 3, 5])
    def test_equals_the_integral_cell_by_cell(self, delay, order):
        over = horizons(81, 0.25, eta=8.0, order=order, start=0.6)
        f = np.random.default_rng(order).normal(size=over.samples)
        found = over.transform(over.held(delay), f)
        cells = [(i * over.dt + delay, (i + 1) * over.dt + delay, level) for i, level in enumerate(f)]
        for k in range(over.count):
            np.testing.assert_allclose(found[:, k], reference(cells, over, k), rtol=0, atol=1e-12)

    @QUICK
    @given(delay=st.floats(0, 20), hold=st.integers(1, 40), orders=st.integers(1, 4))
    def test_runs_give_the_transforms_of_functions(self, delay, hold, orders):
        over = horizons(start=2.0)
        u = np.repeat(np.random.default_rng(hold).integers(-2, 3, 500), hold)[:401].astype(float)
        operator, levels = over.held_runs(u, delay, orders)
        assert len(levels) == 1 + np.count_nonzero(np.diff(u))
        found = over.transform(operator, np.stack([levels, levels**3], axis=-1))
        for j, f in enumerate((u, u**3)):
            np.testing.assert_allclose(
                found[..., j], over.transform(over.held(delay), f)[:orders], rtol=0, atol=1e-11
            )

    @QUICK
    @given(delay=st.floats(0, 3))
    def test_joins_the_response_of_a_block_in_its_equation(self, delay):
        """y + a_1 y' + a_2 y'' = x(t - d) + b_1 x'(t - d), with y from samples and x held."""
        dt, hold = 0.02, 50
        delay = round(delay / dt) * dt
        x = np.repeat(np.random.default_rng(1).normal(size=20), hold)
        block = ContinuousTransferFunction((1.0, -0.7), (1.5, 0.8), delay)
        # Behind the delay: the piece before it may be too short for an interpolation of its own.
        over = Horizons.of(len(x), dt, eta=4.0, overlap=0.2, order=2, start=delay)
        y = over.transform(over.sampled(Knots.of(x, delay, dt)), block.respond(x, dt))
        z = over.transform(over.held(delay), x)
        np.testing.assert_allclose(y[0] + 1.5 * y[1] + 0.8 * y[2], z[0] - 0.7 * z[1], rtol=0, atol=1e-8)


class TestSampled:
    @staticmethod
    def slope(f, steps, knots=lambda steps: SMOOTH):
        """The order of convergence of all transforms, against a much finer grid."""

        def sampled(per_unit):
            over = horizons(round(20.4 * per_unit) + 1, 1 / per_unit, order=2, start=1.0)
            return transforms(f, over, knots(per_unit))

        exact = sampled(640)
        errors = [np.max(np.abs(sampled(per_unit) - exact)) for per_unit in steps]
        return -np.polyfit(np.log(steps), np.log(errors), 1)[0]

    def test_converges_with_order_five_or_more_on_smooth_functions(self):
        assert self.slope(lambda t: np.sin(1.3 * t) * np.exp(-0.1 * t), [5, 10, 20]) >= 5.0

    @staticmethod
    def kinked(t):
        """Smooth but for the kinks at 0.4 + whole numbers."""
        at = t - 0.4
        cell = np.floor(at + 1e-9)
        return np.sin(t) + np.sin(cell) ** 2 * (at - cell) * (1 - (at - cell)) * np.exp(t / 9)

    def test_kinks_do_not_spoil_the_order_at_known_knots(self):
        steps = [5, 10, 20]
        assert self.slope(self.kinked, steps, lambda per_unit: Knots(per_unit, round(0.4 * per_unit))) >= 5.0

    def test_kinks_cost_orders_where_they_are_not_known(self):
        assert 1.0 < self.slope(self.kinked, [5, 10, 20, 40]) < 3.5

    def test_reads_no_sample_twice_removed_from_its_horizon(self):
        over = horizons(start=3.0)
        columns = [over.sampled()[[k]].indices[over.sampled()[[k]].data != 0] for k in range(over.count)]
        for k, read in enumerate(columns):
            assert read.min() >= over.starts[k] - 6
            assert read.max() <= over.starts[k] + over.length + 6


class TestKnots:
    U = np.repeat([1.0, -1.0, 0.5, 2.0, 2.0, 0.0], 10)

    @pytest.mark.parametrize(
        ("delay", "knots"),
        [
            (0.0, Knots(10, 0)),
            (0.3, Knots(10, 3)),
            (1.0, Knots(10, 0)),
            (2.7, Knots(10, 7)),
            (0.25, SMOOTH),
        ],
    )
    def test_lie_at_the_delayed_changes(self, delay, knots):
        assert Knots.of(self.U, delay, 0.1) == knots

    def test_none_are_seen_in_fast_or_constant_inputs(self):
        assert Knots.of(np.repeat([1.0, -1.0, 2.0], 4), 0.0, 1.0) == SMOOTH
        assert Knots.of(np.ones(50), 0.0, 1.0) == SMOOTH
        assert Knots.of(np.random.default_rng(0).normal(size=50), 0.0, 1.0) == SMOOTH

    def test_lie_as_far_apart_as_the_changes_allow(self):
        assert Knots.of(np.concatenate((np.ones(20), np.zeros(30))), 0.0, 1.0) == Knots(20, 0)
        assert Knots.of(np.concatenate((np.ones(20), np.zeros(30), np.ones(9))), 0.0, 1.0).hold == 10

    @QUICK
    @given(hold=st.integers(5, 30), phase=st.integers(0, 29), cells=st.integers(5, 200))
    def test_no_stencil_reaches_across_one(self, hold, phase, cells):
        phase %= hold
        first = Knots(hold, phase).stencils(cells)
        cell = np.arange(cells)
        assert np.all((first >= 0) & (first + 5 <= cells))
        assert np.all((first <= cell) & (cell < first + 5))
        # But at the ends of the record, where a piece may be too short.
        knot = cell - (cell - phase) % hold
        whole = (knot >= 0) & (knot + hold <= cells)
        assert np.all(first[whole] >= knot[whole])
        assert np.all(first[whole] + 5 <= (knot + hold)[whole])


class TestHorizons:
    @pytest.mark.parametrize(
        ("t_f", "eta", "overlap", "count"),
        [
            (100, 15, 0.1, 55),
            (100, 10, 0.2, 43),
            (100, 5, 0.1, 185),
            (120, 15, 0.1, 68),
            (120, 12, 0.05, 175),
            (120, 18, 0.2, 27),
            (120, 10, 0.1, 107),
        ],
    )
    @pytest.mark.parametrize("dt", [0.05, 0.1, 0.125])
    def test_are_as_many_as_the_paper_prints(self, t_f, eta, overlap, count, dt):
        over = Horizons.of(round(t_f / dt) + 1, dt, eta=eta, overlap=overlap, order=3, start=2.5)
        assert over.count == count
        assert len(over.starts) == count
        assert over.starts[0] == 2.5 / dt

    @QUICK
    @given(
        dt=st.floats(1e-3, 10),
        cells=st.integers(16, 60),
        overlap=st.floats(0.01, 1),
        start=st.floats(0, 50),
        samples=st.integers(300, 500),
    )
    def test_lie_inside_the_record_and_their_stride_apart(self, dt, cells, overlap, start, samples):
        eta = cells * dt
        over = Horizons.of(samples, dt, eta=eta, overlap=overlap, order=3, start=start * dt)
        assert over.eta == pytest.approx(eta)
        assert over.starts.min() >= 0
        assert over.starts.max() + over.length < samples
        exact = start + overlap * cells * np.arange(over.count)
        assert np.max(np.abs(over.starts - exact)) <= 1.0

    @pytest.mark.parametrize(("order", "fewest"), [(1, 8), (3, 16), (8, 36)])
    def test_each_holds_four_intervals_for_each_half_wave(self, order, fewest):
        assert fewest_samples(order) == fewest
        assert horizons(dt=1.0, eta=fewest, order=order).length == fewest

    def test_too_coarse_a_sampling_is_told(self):
        with pytest.raises(
            ValueError,
            match=re.escape(
                "the horizon 4 holds 8 sampling intervals of 0.5, and order 3 needs 16: "
                "take a horizon of at least 8 or a sampling interval of at most 0.25"
            ),
        ):
            horizons(dt=0.5, eta=4)

    def test_a_horizon_beyond_all_records_is_told(self):
        with pytest.raises(ValueError, match=r"is longer than any record sampled every 0\.5"):
            horizons(dt=0.5, eta=1e308)

    def test_too_long_a_horizon_is_told(self):
        with pytest.raises(
            ValueError,
            match=re.escape(
                "the horizon 18 is too long for the record: it spans 17.5 from the start 2.5, "
                "and 19.8 is the least that holds one horizon"
            ),
        ):
            horizons(eta=18, overlap=0.1, start=2.5)

    def test_fewer_horizons_than_parameters_are_told(self):
        over = horizons(eta=8, overlap=0.3)
        over.require(5)
        with pytest.raises(
            ValueError,
            match=re.escape(
                "5 horizons are fewer than the 6 parameters: take a shorter horizon, "
                "a smaller overlap step or a longer record"
            ),
        ):
            over.require(6)

    def test_operators_of_long_records_hold_their_overlaps_and_no_more(self):
        over = Horizons.of(100_001, 0.1, eta=10, overlap=0.5, order=3)
        for operator, margin in ((over.sampled(Knots(10)), 13), (over.held(0.05), 2)):
            assert operator.shape == (4 * over.count, over.samples)
            assert operator.nnz <= 4 * over.count * (over.length + margin)

    def test_operators_are_kept_for_the_next_trial(self):
        assert horizons().sampled(Knots(10)) is horizons().sampled(Knots(10))
        assert horizons().held(0.3) is horizons().held(0.3)
