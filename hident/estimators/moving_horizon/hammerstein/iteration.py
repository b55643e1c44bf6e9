"""The iteration of a continuous-time Hammerstein model over moving horizons, for a stack of static functions.

Chen, Hwang and Chang 2009, section 4, eq. (22), (25), (27). The static function is x = sum c_j f_j(u), so
the transforms of x are those of the f_j times c: they are computed once, and one QR factorisation compresses
all rows. It begins with the columns that never change, so that an iteration is a least-squares problem in
b_1, ..., b_m alone for each member of the stack.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hident.arrays import Array, Flags, Index
from hident.estimators.moving_horizon.transform.horizon_least_squares import back_substituted, solve
from hident.numerics.least_squares import lengths


@dataclass(frozen=True, eq=False)
class Iteration:
    """The end of the iteration for a stack of B static functions.

    ``theta`` (B, n + m + p) holds a_1, ..., a_n, b_1, ..., b_m, c_1, ..., c_p, not finite where the
    regression is singular; ``loss`` (B,) is the criterion (30); ``history`` (iterations, n + m + p)
    belongs to the first of the stack.
    """

    theta: Array
    loss: Array
    iterations: Index
    converged: Flags
    history: Array


def iterate(
    y: Array, basis: Array, initial: Array, *, m: int, tolerance: float, max_iterations: int
) -> Iteration:
    """Iterate (25) and (27) until the parameters change by less than ``tolerance``, relative to their norm.

    Parameters
    ----------
    y : array, shape (n + 1, N)
        Transforms of the output, of orders 0 to n, over N horizons.
    basis : array, shape (B, m + 1, N, p)
        Transforms of the p functions f_j(u(t - d)), of orders 0 to m, for each of B static functions.
    initial : array, shape (m + 1, N)
        Transforms of the first internal variable, u itself.
    """
    n, p = len(y) - 1, basis.shape[-1]
    count, horizons = basis.shape[0], y.shape[1]
    slopes, others = (
        np.broadcast_to(part.T, (count, horizons, len(part)))
        for part in (-y[1:], np.concatenate((y[:1], initial[1:])))
    )
    columns = np.concatenate(
        (slopes, basis[:, 0], others, basis[:, 1:].transpose(0, 2, 1, 3).reshape(count, horizons, -1)),
        axis=-1,
    )
    # Every regression matrix below is these columns times a small one; the first ``fixed`` are in all.
    root, fixed = np.asarray(np.linalg.qr(columns, mode="r")), n + p
    scale = lengths(root[..., :fixed])
    upper = root[:, :fixed, :fixed] / scale[:, None]
    target, first = root[..., fixed], root[..., fixed + 1 : fixed + 1 + m]
    functions = root[..., fixed + 1 + m :].reshape(count, root.shape[1], m, p)

    theta = np.zeros((count, n + m + p))
    loss, history = np.full(count, np.inf), []
    iterations, converged = np.zeros(count, dtype=np.intp), np.zeros(count, dtype=bool)
    active, derivatives = np.arange(count), first
    for iteration in range(1, max_iterations + 1):
        # Eq. (25): b from the rows that the fixed columns leave, then a and c.
        z = target[active]
        b = solve(derivatives[:, fixed:], z[:, fixed:], lengths(derivatives))
        residual = z - np.einsum("bkm,bm->bk", derivatives, b)
        ac = back_substituted(upper[active], residual[:, :fixed]) / scale[active]
        found = np.concatenate((ac[:, :n], b, ac[:, n:]), axis=-1)
        regular = np.all(np.isfinite(found), axis=-1)
        change = np.linalg.norm(found - theta[active], axis=-1)
        still = ~(change <= tolerance * np.linalg.norm(found, axis=-1)) & (m > 0)
        theta[active] = found
        loss[active] = np.where(regular, np.sum(residual[:, fixed:] ** 2, axis=-1), np.nan)  # Eq. (30)
        iterations[active] = iteration
        converged[active] = ~still
        if active[0] == 0:
            history.append(found[0])
        # A singular regression stays one.
        active = active[still & regular]
        if len(active) == 0:
            break
        # Eq. (27), as transforms
        derivatives = np.einsum("bkmp,bp->bkm", functions[active], theta[active, n + m :])
    return Iteration(theta, loss, iterations, converged, np.array(history))
