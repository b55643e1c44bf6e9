"""Gauss and Newton's method for nonlinear least squares, its steps halved until the loss falls.

Of one model, or of a stack of T models (:mod:`hident.numerics.stacks`), each with the same numbers as alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Literal, Protocol, TypeVar

import numpy as np

from hident.arrays import Array, Flags, Index
from hident.numerics.least_squares import Factorisation
from hident.numerics.stacks import applied, chosen, copied, dots, put

_HALVINGS = 30

Status = Literal["converged", "stalled", "exhausted", "singular"]
"""How it ended: at rest, no step lowers the loss, no iteration is left, the Jacobian is singular."""


class Point(Protocol):
    """A model: its residuals (N,), output less model, and the derivative (N, P) of the model.

    A stack of T models has T of each, one after the other.
    """

    @property
    def residuals(self) -> Array:
        """What the model leaves of the output."""

    @property
    def jacobian(self) -> Array:
        """The derivative; columns beyond those of a step belong to parameters that the model solves for."""

    @property
    def loss(self) -> Any:
        """The sum of squared residuals: a float, or an array (T,)."""


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


@dataclass(frozen=True, eq=False)
class Minima(Generic[P]):
    """Where T models ended, and how."""

    point: P
    status: tuple[Status, ...]
    iterations: Index


def gauss_newton_stack(
    start: P,
    moved: Callable[[P, Array], P],
    rests: Callable[[P, Array], Flags],
    *,
    max_iterations: int,
    slack: Array,
) -> Minima[P]:
    """:func:`gauss_newton` of a stack of models, where a step at rest is made all the same.

    ``moved`` gives the models a step (T, P) away from some of them, ``rests`` which of them are at rest whose
    steps promise these changes (T,); ``slack`` (T,) is that of each.
    """
    point, rows = start, np.arange(len(slack))
    found, iterations = copied(start), np.full(len(rows), max_iterations)
    status: list[Status] = ["exhausted"] * len(rows)
    for made in range(max_iterations + 1):
        factors = Factorisation.of(point.jacobian)
        change = applied(factors.q.swapaxes(-1, -2), point.residuals)
        rest, singular = rests(point, np.sqrt(dots(change, change))), factors.dependent
        ends = singular if made < max_iterations else np.ones(len(rows), dtype=bool)
        if np.any(ends):
            put(found, rows[ends], chosen(point, ends))
            for row in rows[singular].tolist():
                status[row] = "singular"
            iterations[rows[ends]] = made
        go = np.flatnonzero(~ends)
        if not len(go):
            break
        point, rows, rest = chosen(point, go), rows[go], rest[go]
        step = np.linalg.solve(factors.r[go], change[go][..., None])[..., 0] / factors.length[go]
        new, lower = _descended(point, step, moved, slack[rows])
        over = rest | ~lower
        if np.any(over):
            put(found, rows[over], chosen(new, over))
            iterations[rows[over]] = made + lower[over]
            for row, at_rest in zip(rows[over].tolist(), rest[over].tolist(), strict=True):
                status[row] = "converged" if at_rest else "stalled"
            left = np.flatnonzero(~over)
            new, rows = chosen(new, left), rows[left]
        point = new
        if not len(rows):
            break
    return Minima(found, tuple(status), iterations)


def _descended(point: P, step: Array, moved: Callable[[P, Array], P], slack: Array) -> tuple[P, Flags]:
    """:func:`descended` of a stack, and which models it moved; the others stay where they are."""
    new, most = moved(point, step), point.loss + slack
    lower = np.asarray(new.loss < most)
    waiting = np.flatnonzero(~lower)
    for halving in range(1, _HALVINGS):
        if not len(waiting):
            return new, lower
        tried = moved(chosen(point, waiting), 0.5**halving * step[waiting])
        falls = np.asarray(tried.loss < most[waiting])
        put(new, waiting[falls], chosen(tried, falls))
        lower[waiting[falls]] = True
        waiting = waiting[~falls]
    put(new, waiting, chosen(point, waiting))
    return new, lower
