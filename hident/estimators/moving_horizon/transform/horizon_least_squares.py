"""Least squares over moving horizons, and what it says about the regressors.

Chen, Hwang and Chang 2009, eq. (25), (26) and section 6 on multicollinearity. All functions take stacks of
regressions: phi (..., N, P) and z (..., N).
"""

from __future__ import annotations

import numpy as np

from hident.arrays import Array
from hident.numerics.least_squares import lengths

# What is left of a regressor of length one, less its projection on those before it, where it is rounding.
_DEPENDENT = 1e-13


def solve(phi: Array, z: Array, scale: Array | None = None) -> Array:
    """The least-squares parameters (..., P), eq. (25), (26), by QR of the columns scaled to length one.

    A singular regression gives values that are not finite. ``scale`` (..., P) are the lengths of the whole
    columns where ``phi`` holds what is left of them.
    """
    scale = lengths(phi) if scale is None else scale
    both = np.concatenate((phi / scale[..., None, :], z[..., None]), axis=-1)
    r = np.asarray(np.linalg.qr(both, mode="r"))
    parameters = phi.shape[-1]
    theta = back_substituted(r[..., :parameters, :parameters], r[..., :parameters, parameters])
    return np.asarray(theta / scale)


def back_substituted(r: Array, right: Array) -> Array:
    """The solution of R x = right for upper triangular R (..., P, P); not finite where R is singular."""
    pivots = np.diagonal(r, axis1=-2, axis2=-1)
    pivots = np.where(np.abs(pivots) < _DEPENDENT, np.nan, pivots)
    x = right.copy()
    for i in reversed(range(right.shape[-1])):
        x[..., i] /= pivots[..., i]
        x[..., :i] -= r[..., :i, i] * x[..., i, None]
    return x


def variance_inflation(phi: Array) -> Array:
    """The variance inflation factors of the regressors (..., P): the diagonal of the inverse correlations."""
    centred = phi - phi.mean(axis=-2, keepdims=True)
    centred = centred / np.linalg.norm(centred, axis=-2, keepdims=True)
    r = np.linalg.qr(centred, mode="r")
    inverse = np.linalg.inv(r)
    return np.asarray(np.sum(inverse**2, axis=-1))


def scaled_condition(phi: Array) -> Array:
    """The condition number (...) of the regressors scaled to length one."""
    scale = np.linalg.norm(phi, axis=-2, keepdims=True)
    return np.asarray(np.linalg.cond(phi / scale))
