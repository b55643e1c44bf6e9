"""Gauss and Newton's method for nonlinear least squares, its steps halved until the loss falls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Literal, Protocol, TypeVar

import numpy as np

from hident.arrays import Array
from hident.numerics.least_squares import Factorisation

_HALVINGS = 30

Status = Literal["converged", "stalled", "exhausted", "singular"]
"""How it ended: at rest, no step lowers the loss, no iteration is left, the Jacobian is singular."""


class Point(Protocol):
    """A model: its residuals (N,), output less model, and the derivative (N, P) of the model."""

    @property
    def residuals(self) -> Array:
        """What the model leaves of the output."""

    @property
    def jacobian(self) -> Array:
        """The derivative; columns beyond those of a step belong to parameters that the model solves for."""

    @property
    def loss(self) -> float:
        """The sum of squared residuals."""


P = TypeVar("P", bound=Point)


@dataclass(frozen=True, eq=False)
class Minimum(Generic[P]):
    """Where it ended, and how; ``factors`` are those of the last Jacobian of which a step was computed."""

    point: P
    status: Status
    iterations: int
    evaluations: int
    factors: Factorisation
    length: float
    """The change of the model's output that the last step promised."""


def descended(
    point: P, step: Array, moved: Callable[[P, Array], P | None], slack: float = 0.0
) -> tuple[P | None, int]:
    """The first model along the halved steps with a lower loss, or None, and how many were tried.

    The parameters are those of :func:`gauss_newton`.
    """
    for halving in range(_HALVINGS):
        new = moved(point, 0.5**halving * step)
        if new is not None and new.loss < point.loss + slack:
            return new, halving + 1
    return None, _HALVINGS


def gauss_newton(
    start: P,
    moved: Callable[[P, Array], P | None],
    rests: Callable[[P, float], bool],
    *,
    max_iterations: int,
    slack: float = 0.0,
    step_at_rest: bool = False,
) -> Minimum[P]:
    """Minimise the sum of squared residuals from ``start``.

    Parameters
    ----------
    start : Point
        The first model.
    moved : callable
        The model a step (P,) away from another, None where there is none; it may use the first entries only,
        which gives the step of variable projection in Kaufman's form.
    rests : callable
        Whether a model is at rest whose step promises to change the output by this length.
    max_iterations : int
        The most steps.
    slack : float
        A loss that is larger by less counts as lower: it differs by rounding only.
    step_at_rest : bool
        Whether the step of a model at rest is made all the same.
    """
    point, iterations, evaluations = start, 0, 0
    status: Status | None = None
    while status is None:
        factors = Factorisation.of(point.jacobian)
        length = float(np.linalg.norm(factors.q.T @ point.residuals))
        rest = rests(point, length)
        if factors.is_dependent:
            status = "singular"
        elif rest and not step_at_rest:
            status = "converged"
        elif iterations == max_iterations:
            status = "exhausted"
        else:
            new, tried = descended(point, factors.solution(point.residuals), moved, slack)
            evaluations += tried
            if new is not None:
                point, iterations = new, iterations + 1
            if rest:
                status = "converged"
            elif new is None:
                status = "stalled"
    return Minimum(point, status, iterations, evaluations, factors, length)
