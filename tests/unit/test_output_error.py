"""Structured output-error fits: exactness, derivatives, standard errors, efficiency."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hident.errors import EstimationError
from hident.estimators.moving_horizon import output_error
from hident.estimators.moving_horizon.output_error import refine_hammerstein, refine_wiener, sensitivities
from hident.estimators.moving_horizon.wiener.four_segment import (
    FourSegment,
    forward,
    forward_by_slopes,
    forward_slope,
)
from hident.linear_blocks import ContinuousTransferFunction

DT = 0.1
BLOCK = ContinuousTransferFunction((1.0, -1.0), (4.0, 4.0, 3.0), 2.0)
NEAR_BLOCK = ContinuousTransferFunction((1.0, -0.8), (3.6, 4.3, 2.6), 2.0)
C = np.array([2.0, 0.1, -0.3, -0.5])
BENT = FourSegment((0.6, 1.5, 4.0), -0.8, 0.9)
NEAR_BENT = replace(BENT, e=(0.8, 1.2, 3.0))
# A small case for Monte Carlo.
LAG = ContinuousTransferFunction((1.0,), (0.8,))
LAG_C = np.array([1.0, 0.4])


def held(samples=1000, seed=1, std=1.25, hold=10):
    levels = np.random.default_rng(seed).normal(0.0, std, -(-samples // hold))
    return np.repeat(np.clip(levels, -2.5, 2.5), hold)[:samples]


def basis(u):
    return np.column_stack([u, u**2, u**3, np.maximum(u - 0.5, 0.0)])


def noise(y, seed, ratio=0.1):
    return ratio * np.std(y) * np.random.default_rng(seed).normal(size=len(y))


def parameters(found, start):
    return np.array([*found.block.a, *found.block.b[start:], *found.coefficients])


class TestRecoveryWithoutNoise:
    def test_hammerstein(self):
        values = basis(held())
        found = refine_hammerstein(values, BLOCK.respond(values @ C, DT), NEAR_BLOCK, DT)
        np.testing.assert_allclose(found.block.a, BLOCK.a, rtol=1e-9)
        np.testing.assert_allclose(found.block.b, BLOCK.b, rtol=1e-9)
        np.testing.assert_allclose(found.coefficients, C, rtol=1e-9)
        assert found.block.delay == BLOCK.delay
        assert found.iterations <= 8

    def test_wiener(self):
        u = held()
        y = BENT(BLOCK.scaled(2.0).respond(u, DT))
        found = refine_wiener(u, y, NEAR_BLOCK.scaled(1.7), NEAR_BENT, DT)
        np.testing.assert_allclose(found.block.a, BLOCK.a, rtol=1e-9)
        np.testing.assert_allclose(found.block.b, BLOCK.scaled(2.0).b, rtol=1e-9)
        np.testing.assert_allclose(found.coefficients, BENT.e, rtol=1e-9)
        assert found.iterations <= 10

    def test_a_start_whose_first_steps_are_unstable(self):
        values = basis(held())
        far = ContinuousTransferFunction((1.0, 1.0), (1.5, 2.0, 2.0), 2.0)
        found = refine_hammerstein(values, BLOCK.respond(values @ C, DT), far, DT)
        np.testing.assert_allclose(found.block.a, BLOCK.a, rtol=1e-9)

    def test_delay_between_samples(self):
        values, late = basis(held()), replace(BLOCK, delay=0.13)
        found = refine_hammerstein(values, late.respond(values @ C, DT), replace(NEAR_BLOCK, delay=0.13), DT)
        np.testing.assert_allclose(found.block.b, BLOCK.b, rtol=1e-9)


@given(
    gain=st.floats(0.01, 100.0),
    start_gain=st.floats(0.1, 10.0),
    unit=st.floats(0.01, 100.0),
)
@settings(deadline=None, derandomize=True, max_examples=15)
def test_gain_and_unit_of_time(gain, start_gain, unit):
    values = basis(held(300))
    y = BLOCK.respond(values @ C, DT)
    y = y + noise(y, 4)
    one = refine_hammerstein(values, y, NEAR_BLOCK, DT)
    scaled = ContinuousTransferFunction(
        tuple(b * start_gain * unit**i for i, b in enumerate(NEAR_BLOCK.b)),
        tuple(a * unit**i for i, a in enumerate(NEAR_BLOCK.a, start=1)),
        NEAR_BLOCK.delay * unit,
    )
    other = refine_hammerstein(values, gain * y, scaled, DT * unit)
    np.testing.assert_allclose(other.coefficients, gain * one.coefficients, rtol=1e-6)
    powers = unit ** np.arange(1, 4)
    np.testing.assert_allclose(other.block.a, powers * one.block.a, rtol=1e-6)
    errors = np.concatenate([powers, [unit], np.full(4, gain)]) * one.standard_errors
    np.testing.assert_allclose(other.standard_errors, errors, rtol=1e-5)


class TestDerivatives:
    @pytest.mark.parametrize("delay", [0.0, 0.13, 2.0])
    def test_of_the_linear_block(self, delay):
        u, block = held(300), replace(BLOCK, delay=delay)
        exact = sensitivities(block, u, DT)
        theta = np.array([*block.a, *block.b])
        assert exact.shape == (300, len(theta))

        def output(at):
            return ContinuousTransferFunction(tuple(at[3:]), tuple(at[:3]), delay).respond(u, DT)

        for column, e in zip(exact.T, 1e-5 * np.eye(len(theta)), strict=True):
            slope = (output(theta + e) - output(theta - e)) / 2e-5
            np.testing.assert_allclose(column, slope, rtol=0, atol=1e-6 * np.max(np.abs(column)))

    def test_of_the_four_segments(self):
        # No point within a difference of a bend.
        x, e, points = np.linspace(-3.0, 3.0, 100), np.array(BENT.e), (BENT.lower, BENT.upper)
        slope = (BENT(x + 1e-6) - BENT(x - 1e-6)) / 2e-6
        np.testing.assert_allclose(forward_slope(x, e, *points), slope, rtol=1e-6)
        for column, step in zip(forward_by_slopes(x, e, *points).T, 1e-6 * np.eye(3), strict=True):
            above, below = (forward(x, e + s * step, *points) for s in (1, -1))
            np.testing.assert_allclose(column, (above - below) / 2e-6, rtol=0, atol=1e-6)

    def test_no_step_is_left_at_the_fit(self):
        values = basis(held())
        y = BLOCK.respond(values @ C, DT)
        y = y + noise(y, 5)
        found = refine_hammerstein(values, y, NEAR_BLOCK, DT)
        w = values @ found.coefficients
        residuals = y - found.block.respond(w, DT)
        by_block = np.delete(sensitivities(found.block, w, DT), 3, axis=1)
        by_c = np.column_stack([found.block.respond(phi, DT) for phi in values.T])
        slopes = np.hstack([by_block, by_c])
        step = np.linalg.lstsq(slopes, residuals, rcond=None)[0]
        assert np.max(np.abs(step) / found.standard_errors) < 1e-3
        variance = residuals @ residuals / (1000 - 8)
        covariance = variance * np.linalg.inv(slopes.T @ slopes)
        np.testing.assert_allclose(found.standard_errors, np.sqrt(np.diag(covariance)), rtol=1e-6)


class TestWhereTheIterationEnds:
    @staticmethod
    def data(seed):
        u = held(600, seed=seed)
        y = BENT(BLOCK.scaled(2.0).respond(u, DT))
        return u, y + noise(y, seed)

    @staticmethod
    def loss(u, y, at):
        block = ContinuousTransferFunction(tuple(at[3:5]), tuple(at[:3]), BLOCK.delay)
        function = replace(BENT, e=tuple(at[5:]), gain=1.0)
        return np.sum((y - function(block.respond(u, DT))) ** 2)

    def test_at_rest(self):
        u, y = self.data(0)
        found = refine_wiener(u, y, NEAR_BLOCK.scaled(1.7), NEAR_BENT, DT)
        assert not found.stalled
        assert found.left <= 1e-4
        assert refine_hammerstein(basis(u), y, NEAR_BLOCK, DT).left <= 1e-4

    @pytest.mark.parametrize("seed", [40, 41])
    def test_on_a_kink(self, seed):
        u, y = self.data(seed)
        found = refine_wiener(u, y, NEAR_BLOCK.scaled(1.7), NEAR_BENT, DT)
        assert found.stalled
        assert 1e-4 < found.left <= 0.5
        # A minimum all the same: the loss rises along each parameter, both ways.
        at = parameters(found, 0)
        least = self.loss(u, y, at)
        for step in np.diag(1e-2 * found.standard_errors):
            assert self.loss(u, y, at + step) > least
            assert self.loss(u, y, at - step) > least

    @pytest.mark.parametrize("kind", ["hammerstein", "wiener"])
    def test_a_wrong_derivative_does_not_pass_for_a_minimum(self, kind, monkeypatch):
        u, y = self.data(0)

        def fit(block, bent):
            if kind == "hammerstein":
                return refine_hammerstein(basis(u), y, block, DT)
            return refine_wiener(u, y, block, bent, DT)

        found = fit(NEAR_BLOCK.scaled(1.7), NEAR_BENT)
        near = replace(found.block, a=tuple(found.block.a + 0.1 * found.standard_errors[:3]))
        bent = replace(BENT, e=tuple(found.coefficients[-3:].tolist()))
        monkeypatch.setattr(output_error, "sensitivities", lambda *given: -sensitivities(*given))
        with pytest.raises(EstimationError, match=r"^no step lowers the output error after \d+ steps$"):
            fit(near, bent)


def test_four_segments_invert_the_inverse():
    e_far, e_near, e_2 = BENT.e
    y = np.linspace(-2.0, 2.0, 81)
    x = np.select(
        [y < BENT.lower, y < 0.0, y < BENT.upper],
        [e_far * (y - BENT.lower) + e_near * BENT.lower, e_near * y, y],
        e_2 * (y - BENT.upper) + BENT.upper,
    )
    np.testing.assert_allclose(BENT(x), y, rtol=0, atol=1e-14)


@pytest.fixture(scope="module")
def trials():
    """Estimates and standard errors (200, 3) of a small Hammerstein case, and the starts (200,) of a_1."""
    u = held(150, seed=3, hold=3)
    values = np.column_stack([u, u**2])
    clean = LAG.respond(values @ LAG_C, DT)
    found, starts = [], []
    for seed in range(200):
        y = clean + noise(clean, 100 + seed, ratio=0.2)
        # Least squares for the equation of the sampled block: consistent only without noise.
        past = np.column_stack([y[:-1], values[:-1]])
        pole = np.linalg.lstsq(past, y[1:], rcond=None)[0][0]
        starts.append(-DT / np.log(np.clip(pole, 0.1, 0.99)))
        found.append(refine_hammerstein(values, y, replace(LAG, a=(starts[-1],)), DT))
    return (
        np.array([parameters(one, 1) for one in found]),
        np.array([one.standard_errors for one in found]),
        np.array(starts),
    )


def test_standard_errors_cover_the_truth(trials):
    estimates, errors, _ = trials
    inside = np.abs(estimates - [*LAG.a, *LAG_C]) <= 1.96 * errors
    # 95 % of 200, within four standard deviations of that count.
    assert np.all(np.abs(inside.mean(axis=0) - 0.95) <= 4 * np.sqrt(0.95 * 0.05 / 200))
    np.testing.assert_allclose(errors.mean(axis=0), estimates.std(axis=0), rtol=0.2)


def test_it_is_more_accurate_than_its_start(trials):
    estimates, _, starts = trials
    truth = LAG.a[0]
    assert np.mean((estimates[:, 0] - truth) ** 2) < 0.2 * np.mean((starts - truth) ** 2)
    assert estimates[:, 0].std() < starts.std()


def test_wiener_standard_errors_cover_the_truth():
    u = held(200, seed=3, std=2.5, hold=10)
    clean, start = BENT(LAG.respond(u, DT)), replace(LAG, a=(0.7,))
    truth = np.array([*LAG.a, *LAG.b, *BENT.e])
    inside = []
    for seed in range(200):
        found = refine_wiener(u, clean + noise(clean, seed, ratio=0.05), start, NEAR_BENT, DT)
        inside.append(np.abs(parameters(found, 0) - truth) <= 1.96 * found.standard_errors)
    assert np.all(np.abs(np.mean(inside, axis=0) - 0.95) <= 4 * np.sqrt(0.95 * 0.05 / 200))


class TestErrors:
    def test_an_unstable_start(self):
        values = basis(held(200))
        with pytest.raises(EstimationError, match=r"^the start is unstable, or a slope is not positive$"):
            refine_hammerstein(values, values[:, 0], ContinuousTransferFunction((1.0,), (-1.0,)), DT)

    def test_a_start_with_a_falling_slope(self):
        u = held(200)
        with pytest.raises(EstimationError, match=r"^the start is unstable, or a slope is not positive$"):
            refine_wiener(u, u, BLOCK, replace(BENT, e=(1.0, -1.0, 1.0)), DT)

    def test_a_start_without_static_gain(self):
        values = basis(held(200))
        with pytest.raises(EstimationError, match=r"^the start has no static gain: its b_0 is zero$"):
            refine_hammerstein(values, values[:, 0], ContinuousTransferFunction((0.0, 1.0), (1.0, 1.0)), DT)

    def test_too_few_samples(self):
        u = held(3, hold=1)
        with pytest.raises(EstimationError, match=r"^3 samples cannot determine 3 parameters$"):
            refine_hammerstein(np.column_stack([u, u**2]), u, LAG, DT)

    def test_a_constant_input(self):
        values = basis(np.ones(200))
        with pytest.raises(
            EstimationError,
            match=r"^the output does not tell the 4 parameters apart: the input varies too little, "
            r"an order is too high, or a segment holds too few samples$",
        ):
            refine_hammerstein(values, values[:, 0], BLOCK, DT)

    def test_an_output_that_is_not_finite(self):
        values = basis(held(200))
        with pytest.raises(EstimationError, match="200 of 200 samples that are not finite"):
            refine_hammerstein(values, np.full(200, np.nan), BLOCK, DT)


def test_inputs_stay_as_they_are():
    values = basis(held())
    y, bent = BLOCK.respond(values @ C, DT), BENT(BLOCK.scaled(2.0).respond(values[:, 0], DT))
    for array in (values, y, bent):
        array.setflags(write=False)
    refine_hammerstein(values, y, NEAR_BLOCK, DT)
    refine_wiener(values[:, 0], bent, NEAR_BLOCK.scaled(1.7), NEAR_BENT, DT)
