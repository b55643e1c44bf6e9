"""Voros's method for Wiener systems; symbols are in :mod:`hident.estimators.voros.voros_hammerstein`."""

from __future__ import annotations

import numpy as np

from hident.arrays import Array, Characteristic
from hident.config.spec import component
from hident.estimators.normalisation import Normalisation, unit_slope
from hident.estimators.voros.voros_hammerstein import (
    Iterations,
    Rule,
    Structure,
    VorosSpec,
    delayed,
    instants,
    iterate,
    segments,
    solve,
)
from hident.linear_blocks import TransferFunction
from hident.numerics.parts import Parts, in_each, whole


def voros_wiener(
    u: Array, y: Array, structure: Structure, rule: Rule, parts: Parts | None = None
) -> Iterations:
    """Fit y(t) = x(t) + sum f_j x(t)^j + sum (g_j - f_j) x(t)^j h(t), x being a linear block's output.

    With a constant k, y(t) - k in the place of y(t).

    Parameters
    ----------
    u, y : array, shape (N,)
        Input and output.
    structure : Structure
        The numbers of coefficients.
    rule : Rule
        The relaxation and when to stop.
    parts : sequence of slices, optional
        Where the experiments stand; one by default.

    Returns
    -------
    Iterations
        With theta = (a_1, ..., a_n, b_delay, ..., f_1 = 1, ..., f_r, g_1, ..., g_r), and k behind if there
        is one.

    Raises
    ------
    EstimationError
        If a regression is singular, or the iteration diverges.

    Notes
    -----
    Voros 2003. The key term is x(t) with f_1 = 1, replaced by sum a_i x(t-i) + sum b_i u(t-i); the same sum
    with the new coefficients and the old x(t-i) is the next internal variable. The iteration starts from the
    linear model, which takes y for x. Simulating the linear block instead, where x(t-i) is new as well,
    diverges through unstable blocks on the way.
    """
    n, delay, degree = structure.n, structure.delay, structure.degree
    parts = parts or whole(len(u))
    past, at = range(1, n + 1), instants(parts, structure.first)
    ones = structure.ones(len(at))
    inputs = delayed(u, range(delay, delay + structure.m), at)

    def renewed(x: Array, a: Array, b: Array) -> Array:
        """sum a_i x(t-i) + sum b_i u(t-i), both signals being zero before each experiment."""
        of_x, of_u = TransferFunction((0.0, *a)), TransferFunction((0.0,) * delay + tuple(b))
        return in_each(parts, lambda x, u: of_x.filter(x) + of_u.filter(u), x, u)

    def update(x: Array) -> tuple[Array, Array]:
        # Without the column of f_1, which is in the key term; that of g_1 then carries g_1 - f_1.
        curved = segments(x[at], degree)[:, 1:]
        columns = np.hstack([delayed(x, past, at), inputs, curved, ones])
        a, b, f, g, level = np.split(solve(columns, y[at]), np.cumsum([n, structure.m, degree - 1, degree]))
        g[0] += 1.0
        return np.concatenate((a, b, [1.0], f, g, level)), renewed(x, a, b)

    a, b, level = np.split(
        solve(np.hstack([delayed(y, past, at), inputs, ones]), y[at]), np.cumsum([n, structure.m])
    )
    # The equation of the linear model holds (1 - a_1 - ... - a_n) k.
    level = level / (1.0 - np.sum(a))
    straight = np.eye(1, degree)[0]
    start = np.concatenate((a, b, straight, straight, level))
    return iterate(update, start, renewed(y - np.sum(level) if len(level) else y, a, b), rule)


@component("estimator", "voros_wiener", source="Voros 2003, IEEE Trans. Control Syst. Technol. 11, 253")
class VorosWiener(VorosSpec):
    """Wiener system with a two-segment polynomial, discrete, by key-term separation.

        x(t) = sum_i a_i x(t-i) + sum_i b_i u(t-i),    y = x + f_2 x^2 + ... + f_r x^r + (g(x) - f(x)) h(x)

    The first term of y is the key term, in which x is written out.

    f_1 is 1 and the static gain lies in the linear block. Both polynomials vanish at zero.

    Examples
    --------
    >>> import hident as hi
    >>> quadratic = hi.Polynomial(coefficients=[0, 1, 0.2])
    >>> system = hi.Wiener(linear=hi.Ar(a=[0.5]), nonlinearity=quadratic)
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> round(hi.fit(hi.VorosWiener(n=1, m=1, delay=0, degree=2), record).linear.a[0], 3)
    0.5
    """

    def normalisations(self) -> tuple[Normalisation, ...]:
        return (unit_slope("f_1 = 1", "b f g", "nonlinearity", "linear").beside(self.constant),)

    def identify(self, u: Array, y: Array, parts: Parts) -> Iterations:
        return voros_wiener(u, y, self.structure(), self.rule(), parts)

    def simulate(self, nonlinearity: Characteristic, linear: TransferFunction, u: Array) -> Array:
        return nonlinearity(linear.filter(u))
