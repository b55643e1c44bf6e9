"""The trust region in a plane: its pieces against their definitions, its minima against scipy's."""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from hident.arrays import Array
from hident.numerics.stacks import copied
from hident.numerics.subspace_trust_region import (
    conjugate_gradients,
    least_in_ball,
    subspace_trust_region,
)

T = np.linspace(0.0, 3.0, 40)
Y = 2.0 * np.exp(-1.3 * T) + 0.5 + 0.3 * np.random.default_rng(0).normal(size=T.shape)


def rosenbrock(p):
    return np.array([1.0 - p[0], 10.0 * (p[0] ** 2 - p[1])]), np.array([[1.0, 0.0], [-20.0 * p[0], 10.0]])


def decay(p):
    e = np.exp(-p[1] * T)
    return Y - p[0] * e - p[2], np.stack([e, -p[0] * T * e, np.ones_like(T)], axis=1)


def product(p):
    """Two factors, of which the data say the product only: the columns depend on one another."""
    e = np.exp(-T)
    return 3.0 * e - p[0] * p[1] * e, np.stack([p[1] * e, p[0] * e], axis=1)


@dataclass(frozen=True, eq=False)
class Models:
    """Models at their parameters (T, P), with residuals and derivatives."""

    p: Array
    residuals: Array
    jacobian: Array

    @classmethod
    def at(cls, of, p):
        return cls(p, *map(np.stack, zip(*map(of, p), strict=True)))

    @property
    def loss(self):
        return np.sum(self.residuals**2, axis=-1)

    def each(self):
        return [Models(*one) for one in zip(self.p, self.residuals, self.jacobian, strict=True)]


@dataclass(frozen=True, eq=False)
class End:
    """Where one minimisation ended, and how."""

    p: Array
    loss: float
    status: str
    iterations: int


@dataclass
class Walk:
    """The steps of a minimisation: where each began, where it led, each the first of its stack."""

    of: Callable[[Array], tuple[Array, Array]]
    steps: list[tuple[Models, Array, Models]] = field(default_factory=list)

    def moved(self, models, steps):
        new = Models.at(self.of, models.p + steps)
        before, after = models.each()[0], copied(new).each()[0]
        self.steps.append((before, steps[0], after))
        return new

    def minimum(self, start, **fields):
        [end] = self.minima([start], **fields)
        return end

    def minima(self, starts, **fields):
        found = subspace_trust_region(Models.at(self.of, np.array(starts)), self.moved, **fields)
        ends = zip(found.point.p, found.point.loss, found.status, found.iterations, strict=True)
        return [End(*end) for end in ends]


PROBLEMS = pytest.mark.parametrize(
    ("of", "start"), [(rosenbrock, [-1.2, 1.0]), (decay, [1.0, 0.3, 0.0]), (product, [5.0, 2.0])]
)


@pytest.mark.parametrize(("of", "start"), [(rosenbrock, [-1.2, 1.0]), (decay, [1.0, 0.3, 0.0])])
def test_minimum_is_that_of_another_solver(of, start):
    expected = least_squares(lambda p: of(p)[0], start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    found = Walk(of).minimum(start, tolerance=1e-14, max_iterations=1000)
    assert found.status == "converged"
    assert found.loss == pytest.approx(2.0 * expected.cost, rel=1e-10, abs=1e-12)
    np.testing.assert_allclose(found.p, expected.x, atol=2e-5)


def test_columns_that_depend_on_one_another_do_no_harm():
    found = Walk(product).minimum([5.0, 2.0])
    assert found.status == "converged"
    assert np.prod(found.p) == pytest.approx(3.0, abs=1e-3)


@PROBLEMS
def test_the_loss_never_grows(of, start):
    walk = Walk(of)
    found = walk.minimum(start)
    losses = [model.loss for model, _, _ in walk.steps] + [found.loss]
    assert found.status == "converged"
    assert found.iterations == len(walk.steps)
    assert all(after <= before for before, after in pairwise(losses))
    assert losses[-1] < losses[0]


@PROBLEMS
@pytest.mark.parametrize("tolerance", [1e-2, 1e-6])
def test_it_rests_at_the_first_step_that_changes_little(of, start, tolerance):
    walk = Walk(of)
    walk.minimum(start, tolerance=tolerance)

    def little(model, step, new):
        limit = tolerance * (1.0 + model.loss)
        promised = model.loss - np.sum((model.residuals - model.jacobian @ step) ** 2)
        return abs(model.loss - new.loss) < limit and promised < 4.0 * limit

    assert [little(*step) for step in walk.steps] == [False] * (len(walk.steps) - 1) + [True]


def test_steps_may_run_out():
    found = Walk(rosenbrock).minimum([-1.2, 1.0], max_iterations=3)
    assert (found.status, found.iterations) == ("exhausted", 3)


def test_where_no_step_lowers_the_loss_it_stalls():
    def wrong(p):
        residuals, jacobian = decay(p)
        return residuals, -jacobian

    start = [1.0, 0.3, 0.0]
    found = Walk(wrong).minimum(start)
    assert (found.status, found.iterations) == ("stalled", 30)
    assert found.p.tolist() == start


def test_at_a_minimum_it_takes_no_step():
    walk = Walk(rosenbrock)
    found = walk.minimum([1.0, 1.0])
    assert (found.status, found.iterations, walk.steps) == ("converged", 0, [])


def test_a_loss_that_is_no_number_shortens_the_step():
    def broken(p):
        residuals, jacobian = rosenbrock(p)
        return (residuals if p[0] < 1.5 else residuals * np.nan), jacobian

    walk = Walk(broken)
    found = walk.minimum([1.4, -20.0], radius=100.0)
    assert found.status == "converged"
    assert np.isfinite(found.loss)


def test_the_radius_holds_the_steps_and_grows():
    walk = Walk(decay)
    walk.minimum([1.0, 0.3, 0.0], radius=1e-3)
    lengths = [np.linalg.norm(step) for _, step, _ in walk.steps]
    assert lengths[:5] == pytest.approx([1e-3, 2e-3, 4e-3, 8e-3, 16e-3], rel=1e-9)


def test_a_linear_problem_of_two_parameters_takes_one_step():
    design = np.stack([np.ones_like(T), T], axis=1)
    walk = Walk(lambda p: (Y - design @ p, design))
    found = walk.minimum([1.0, 1.0])
    np.testing.assert_allclose(found.p, np.linalg.lstsq(design, Y)[0], rtol=1e-10)
    np.testing.assert_allclose(walk.steps[0][2].p, found.p, rtol=1e-10)


def test_the_others_of_a_stack_do_not_matter():
    starts = [[1.0, 0.3, 0.0], [3.0, 1.0, 1.0], [0.1, 5.0, 0.0], [2.0, 1.3, 0.5]]
    alone = [Walk(decay).minimum(start) for start in starts]
    assert len({end.iterations for end in alone}) > 1
    for radius in (1e-3, 10.0):
        alone = [Walk(decay).minimum(start, radius=radius) for start in starts]
        for one, other in zip(Walk(decay).minima(starts, radius=radius), alone, strict=True):
            assert (one.p.tobytes(), one.status, one.iterations) == (
                other.p.tobytes(),
                other.status,
                other.iterations,
            )


def root(seed, size, rank):
    return np.random.default_rng(seed).normal(size=(rank, size)) * np.logspace(0, 2, size)


def semidefinite(seed, size, rank):
    return root(seed, size, rank).T @ root(seed, size, rank)


@pytest.mark.parametrize("most", [1, 2, 3])
def test_conjugate_gradients_minimise_the_quadratic_over_what_they_span(most):
    hessian = semidefinite(1, 7, 7)
    gradient = np.random.default_rng(2).normal(size=7) * np.logspace(0, 2, 7)
    inverse = 1.0 / np.linalg.norm(hessian, axis=0)
    span = [inverse * gradient]
    for _ in range(most - 1):
        span.append(inverse * (hessian @ span[-1]))
    basis = np.linalg.qr(np.transpose(span)).Q
    expected = -basis @ np.linalg.solve(basis.T @ hessian @ basis, basis.T @ gradient)
    [found] = conjugate_gradients(hessian[None], gradient[None], most)
    np.testing.assert_allclose(found, expected, rtol=1e-8)


def test_conjugate_gradients_end_where_the_residual_is_a_tenth():
    hessian = semidefinite(3, 7, 7)
    gradient = np.random.default_rng(4).normal(size=7) * np.logspace(0, 2, 7)
    scale = np.linalg.norm(hessian, axis=0)
    steps = [conjugate_gradients(hessian[None], gradient[None], k)[0] for k in range(8)]
    left = [np.linalg.norm((hessian @ step + gradient) / scale) for step in steps]
    # Allowed any number, they stop at the first one that is small enough.
    last = next(k for k, one in enumerate(left) if one <= 0.1 * left[0])
    assert last > 1
    assert conjugate_gradients(hessian[None], gradient[None], 100)[0].tolist() == steps[last].tolist()


@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.integers(0, 10_000), st.sampled_from([(1, 1), (2, 1), (2, 2)]), st.floats(1e-3, 1e3))
def test_least_in_ball_is_optimal(seed, shape, radius):
    size, rank = shape
    hessian = semidefinite(seed, size, rank)
    gradient = root(seed, size, rank).T @ np.random.default_rng(seed + 1).normal(size=rank)
    [step] = least_in_ball(hessian[None], gradient[None], np.array([radius]))
    length = np.linalg.norm(step)
    assert length <= radius * (1.0 + 1e-9)

    def model(s):
        return s @ gradient + 0.5 * s @ hessian @ s

    others = np.random.default_rng(seed + 2).normal(size=(300, size))
    others *= (
        radius * np.random.default_rng(seed + 3).random((300, 1)) / np.linalg.norm(others, axis=1)[:, None]
    )
    assert all(model(step) <= model(other) + 1e-9 * abs(model(step)) for other in others)
    # (H + shift I) s = -g, with a shift on the boundary only.
    slope = -(hessian @ step + gradient)
    shift = slope @ step / length**2
    np.testing.assert_allclose(slope, shift * step, atol=1e-7 * float(np.linalg.norm(gradient)))
    if length < radius * (1.0 - 1e-6):
        assert abs(shift) * length <= 1e-7 * np.linalg.norm(gradient)
    else:
        assert shift > -1e-9 * np.linalg.norm(hessian)
