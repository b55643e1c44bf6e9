"""Gauss and Newton's method on a stack of models: each ends as it does by itself, to the last bit."""

from dataclasses import dataclass

import numpy as np
import pytest

from hident.arrays import Array
from hident.numerics.gauss_newton import gauss_newton, gauss_newton_stack
from hident.numerics.stacks import dots

T = np.linspace(0.0, 3.0, 40)
Y = 2.0 * np.exp(-1.3 * T) + 0.3 * np.random.default_rng(0).normal(size=T.shape)


@dataclass(frozen=True, eq=False)
class Decays:
    """Models a exp(-b t) at (..., 2) parameters; with ``wrong`` (...) not zero, derivatives that mislead."""

    p: Array
    wrong: Array

    @property
    def residuals(self):
        return Y - self.p[..., :1] * np.exp(-self.p[..., 1:] * T)

    @property
    def jacobian(self):
        e = np.exp(-self.p[..., 1:] * T)
        return np.stack([e, -self.p[..., :1] * T * e], axis=-1) * (1.0 - 2.0 * self.wrong[..., None, None])

    @property
    def loss(self):
        return dots(self.residuals, self.residuals)

    def rests(self, change):
        model = Y - self.residuals
        return change <= 1e-9 * np.sqrt(dots(model, model))


STARTS = np.array([[1.0, 0.3], [2.0, 1.3], [0.1, 3.0], [0.0, 1.0], [1.0, 0.5], [-1.0, 2.0]])
WRONG = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0])


def moved(models, step):
    return Decays(models.p + step, models.wrong)


@pytest.mark.parametrize("most", [0, 2, 200])
def test_each_of_a_stack_ends_as_by_itself(most):
    slack = np.full(len(STARTS), 1e-14 * (Y @ Y))
    found = gauss_newton_stack(Decays(STARTS, WRONG), moved, Decays.rests, max_iterations=most, slack=slack)
    ends = []
    for i, start in enumerate(STARTS):
        alone = gauss_newton(
            Decays(start, WRONG[i]),
            moved,
            Decays.rests,
            max_iterations=most,
            slack=float(slack[i]),
            step_at_rest=True,
        )
        assert found.point.p[i].tobytes() == alone.point.p.tobytes()
        ends.append((alone.status, alone.iterations))
    assert [*zip(found.status, found.iterations, strict=True)] == ends
    if most == 200:
        assert {status for status, _ in ends} == {"converged", "stalled", "singular"}
    assert STARTS.tolist()[0] == [1.0, 0.3]
