"""The harmonics of a polynomial of a sine, exactly.

With u_i(t) = x_0 + A sin(theta) and z = sin(theta), f(u_i) is a polynomial in z. Written in Chebyshev
polynomials, f = sum_k C_k T_k(z), it is a Fourier series, since T_k(sin theta) = cos(k (theta - pi/2)):

    f(u_i) = C_0 + sum_k C_k sin(k theta - (k - 1) pi/2).

The C_k are signed. In Brouri's terms B_k = |C_k|, and beta_k = k phi_i - (k - 1) pi/2, with another pi where
C_k < 0, for theta = w t + phi_i.
"""

from __future__ import annotations

from math import comb

import numpy as np

from hident.arrays import Array, Complex


def harmonic_matrix(amplitude: Array, offset: Array, degree: int) -> Array:
    """The matrices that take the coefficients of a polynomial to the C_k.

    Parameters
    ----------
    amplitude, offset : array, shape (...)
        A = V |Gi(jw)| and x_0; they broadcast.
    degree : int
        Degree of the polynomial.

    Returns
    -------
    array, shape (..., degree + 1, degree + 1)
        Row k, column m: the part of c_m in C_k.

    Notes
    -----
    Brouri, eq. (17)-(22), for any degree and offset: the binomial expansion (18) and the power formulas (20).
    """
    powers: Array = np.asarray(amplitude, dtype=float)[..., None] ** np.arange(degree + 1)
    return _expanded(powers, offset, degree)


def harmonic_matrix_slope(amplitude: Array, offset: Array, degree: int) -> Array:
    """The derivative of :func:`harmonic_matrix` with respect to the amplitude, of the same shape."""
    power = np.arange(degree + 1.0)
    slopes: Array = power * np.asarray(amplitude, dtype=float)[..., None] ** np.maximum(power - 1.0, 0.0)
    return _expanded(slopes, offset, degree)


def _expanded(powers: Array, offset: Array, degree: int) -> Array:
    """sum_l t_{lk} powers_l binomial(m, l) x_0^(m - l), shape (..., k, m)."""
    l, m = np.ogrid[: degree + 1, : degree + 1]  # noqa: E741
    binomial = np.array([[comb(j, i) for j in range(degree + 1)] for i in range(degree + 1)], dtype=float)
    # Eq. (18a)
    moved = binomial * np.asarray(offset, dtype=float)[..., None, None] ** np.maximum(m - l, 0)
    return np.asarray(powers_in_chebyshev(degree).T @ (powers[..., :, None] * moved))


def powers_in_chebyshev(degree: int) -> Array:
    """t (degree + 1, degree + 1) with z^l = sum_k t_{lk} T_k(z), eq. (20) in one formula."""
    t = np.zeros((degree + 1, degree + 1))
    for l in range(degree + 1):  # noqa: E741
        for k in range(l % 2, l + 1, 2):
            t[l, k] = comb(l, (l - k) // 2) / 2.0 ** (l - (k > 0))
    return t


def quadrature(order: int) -> Complex:
    """e^(-j (k - 1) pi/2) for k = 1, ..., order: the turn of the harmonic k at phi_i = 0, exactly."""
    return np.array([1.0, -1j, -1.0, 1j])[np.arange(order) % 4]
