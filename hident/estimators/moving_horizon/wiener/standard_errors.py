"""Standard errors of the two-stage Wiener estimate with a four-segment function, by the sandwich formula.

The first stage's parameters solve phi' r = 0 at the fixed point of the iteration, where

    r = T_0{x_nl} + sum a_i T_i{x} - sum b_i T_i{u},    x = w x_lin + (1 - w) x_nl    (17), (29)

depends on the output's noise by x_nl, and on the parameters directly, by x_lin and by x_nl. As for
Hammerstein models (``sandwich.py``), the noise in the regressors is left out, and partition points count as
given.
"""

from __future__ import annotations

import numpy as np

from hident.arrays import Array
from hident.estimators.moving_horizon.output_error import sensitivities
from hident.estimators.moving_horizon.transform.linear_transform import LinearFit, responses_in
from hident.estimators.moving_horizon.transform.sandwich import influence, standard_errors
from hident.estimators.moving_horizon.transform.time_weighted import Knots
from hident.estimators.moving_horizon.wiener.four_segment import forward, inverse_slope, segments
from hident.estimators.moving_horizon.wiener.iteration import Wiener
from hident.linear_blocks import ContinuousTransferFunction


def wiener_errors(
    wiener: Wiener,
    phi: Array,
    block: ContinuousTransferFunction,
    e: Array,
    points: tuple[float, float],
    weight: float,
    second: LinearFit | None,
    constant: float | None = None,
) -> tuple[Array, Array]:
    """The standard errors of a_1, ..., a_n (n,) and of b_0, ..., b_m (m + 1,) of the last stage's block.

    Parameters
    ----------
    wiener : Wiener
        The record and its transforms.
    phi : array, shape (K, P)
        The first stage's regressors.
    block, e, points
        The first stage's linear block, slopes e_-2, e_-1, e_2 and partition points.
    weight : float
        w of (29).
    second : LinearFit or None
        The second stage's block, of the first stage's b_0.
    constant : float or None
        That of the output, whose regressor is the last; None if it is not estimated.
    """
    n, a, parts = wiener.n, np.array(block.a), wiener.horizons.parts
    linear = n + wiener.m + 1
    y = wiener.y - (constant or 0.0)
    g, slope = segments(y, *points), inverse_slope(y, e, *points)
    if constant is not None:
        # x_nl falls with the constant as it does with a slope, by dx/dy.
        g = np.column_stack((g, slope))
    by_block = wiener.transforms(sensitivities(block, wiener.u, wiener.dt, parts), wiener.derivatives)
    by_slopes = wiener.transforms(g, wiener.derivatives)
    jacobian = phi.copy()
    jacobian[:, :linear] -= weight * (by_block @ a).T
    jacobian[:, linear:] += (1.0 - weight) * (by_slopes @ a).T
    bread = np.asarray(np.linalg.solve(phi.T @ jacobian, phi.T), dtype=float)
    knots = Knots.of(wiener.u, wiener.delay, wiener.dt, parts)
    feedback = tuple(((1.0 - weight) * a).tolist())
    first = slope * influence(bread, wiener.horizons, knots, feedback)
    if second is None:
        residual = y - forward(responses_in(parts, block, wiener.u, wiener.dt), e, *points)
        found = standard_errors(first, residual)
        return found[:n], found[n:linear]
    found_block, horizons = second.block, second.horizons
    onto = np.asarray(np.linalg.pinv(second.phi), dtype=float)
    count = len(found_block.a) + 1
    by_c = horizons.transform(horizons.sampled(second.knots), g)[:count]
    by_c = -np.einsum("lkr,l->kr", by_c, np.array([1.0, *found_block.a]))
    by_gain = -horizons.transform(horizons.held(found_block.delay), wiener.u)[0]
    derivative = slope * influence(onto, horizons, second.knots, found_block.a)
    derivative += onto @ (by_c @ first[linear:] + np.outer(by_gain, first[n]))
    residual = y - forward(responses_in(parts, found_block, wiener.u, wiener.dt), e, *points)
    order = len(found_block.a)
    found = standard_errors(np.vstack([derivative, first[n]]), residual)
    return found[:order], np.concatenate((found[-1:], found[order:-1]))
