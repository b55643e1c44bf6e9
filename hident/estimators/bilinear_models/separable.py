"""Hammerstein systems with a rational linear block by separable least squares.

======  =====================================================================================
F       1 - f_1 q^-1 - ... - f_p q^-p; the output without noise is (1/F) of b'phi(t)a
X       the regressors phi_j(x(t-i)) filtered by 1/F from rest, shape (rows, n m)
H       the responses of 1/F to impulses in the first p rows: what came before the experiment
r       residuals; for given f, of the best a, b and start
======  =====================================================================================

``parts`` say where the rows of each experiment stand (one by default): each is filtered from rest by itself,
and has a start of its own.

The output may hold a constant beside (1/F) b'phi(t)a, which for given f is one more of the starts.

For given f the problem is the bilinear one with X for Phi. Wang, Zhang, Ljung 2009, section 2, name this
way and leave it out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.spec import Count, component
from hident.errors import EstimationError
from hident.estimators.base import DISCRETE, with_errors
from hident.estimators.bilinear_models.bilinear import Regression
from hident.estimators.bilinear_models.bilinear_least_squares import (
    bilinear_least_squares,
    complement,
    jacobian,
)
from hident.estimators.bilinear_models.known_basis import BilinearSpec
from hident.estimators.bilinear_models.two_stage import two_stage
from hident.estimators.normalisation import Normalisation, unit_length
from hident.linear_blocks import TransferFunction
from hident.numerics.gauss_newton import gauss_newton
from hident.numerics.least_squares import Factorisation
from hident.numerics.parts import Parts, in_each, whole
from hident.numerics.stacks import times
from hident.records import Estimate, Record

_PREFILTERINGS = 10
_EDGE = 0.999
"""Modulus that a pole of the first estimates may reach."""


@dataclass(frozen=True, eq=False)
class Inner:
    """The best a, b and start for given f, with the residuals (rows,) and the output without noise (rows,).

    ``derivative`` (rows, p + n + m - 1 + p for each experiment) is that of the output by f, by b and a within
    assumption 1, and by the start; ``tangent`` (n + m, n + m - 1) are the directions of b and a. ``constant``
    is that of the output, which has the last column of the derivative; None if it has none.
    """

    f: Array
    b: Array
    a: Array
    residuals: Array
    output: Array
    jacobian: Array
    tangent: Array
    constant: float | None = None

    @property
    def loss(self) -> float:
        return float(self.residuals @ self.residuals)


def _filtered(f: Array, rows: Array, parts: Parts) -> Array:
    from scipy.signal import lfilter

    denominator = np.concatenate(([1.0], -f))
    return in_each(parts, lambda part: np.asarray(lfilter([1.0], denominator, part, axis=0)), rows)


def _delayed(rows: Array, p: int, parts: Parts) -> Array:
    """``rows`` (N,) delayed by 1, ..., p samples from rest, shape (N, p)."""

    def delayed(part: Array) -> Array:
        padded = np.concatenate([np.zeros(p), part])
        return np.column_stack([padded[p - k : len(padded) - k] for k in range(1, p + 1)])

    return in_each(parts, delayed, rows)


def _impulses(p: int, parts: Parts) -> Array:
    """An impulse in each of the first p rows of each part, shape (rows, up to p for each part)."""
    first = [part.start + k for part in parts for k in range(min(p, part.stop - part.start))]
    impulses = np.zeros((parts[-1].stop, len(first)))
    impulses[first, np.arange(len(first))] = 1.0
    return impulses


def start(phi: Array, y: Array, p: int, parts: Parts | None = None, *, constant: bool = False) -> Array:
    """First estimate of f (p,): a linear regression for F y, repeated with everything filtered by 1/F.

    ``phi`` has shape (rows, n m), ``y`` (rows,). The first round is exact without noise, and the repetition
    (Steiglitz and McBride's) takes away most of the bias of white output noise.

    Raises
    ------
    EstimationError
        If the regressors are dependent, or there are too few rows.
    """
    parts = parts or whole(len(y))
    beside = _impulses(p, parts)
    if constant:
        # F times a constant is one but for the start, and 1/F of that is one again.
        beside = np.column_stack([beside, np.ones(len(y))])
    unknowns = p + phi.shape[1] + beside.shape[1]
    if len(y) <= unknowns:
        raise EstimationError(
            f"{len(y)} equations cannot determine {unknowns} unknowns, the start of each experiment among "
            "them: use longer experiments, fewer lags or fewer basis functions"
        )
    f = np.zeros(p)
    for _ in range(1 + _PREFILTERINGS):
        filtered = _filtered(f, np.column_stack([y, phi, beside]), parts)
        columns = np.column_stack([_delayed(filtered[:, 0], p, parts), filtered[:, 1:]])
        regression = Factorisation.of(columns)
        if regression.is_dependent:
            raise EstimationError(
                "past outputs and inputs are linearly dependent: the input varies too little, "
                f"or the feedback order {p} is too high"
            )
        new = _stabilised(regression.solution(filtered[:, 0])[:p])
        if np.allclose(new, f, rtol=0.0, atol=1e-12):
            return new
        f = new
    return f


def _stabilised(f: Array) -> Array:
    """The coefficients with poles outside the unit circle reflected into it."""
    poles = TransferFunction(a=tuple(f)).poles()
    modulus = np.abs(poles)
    if np.all(modulus < _EDGE):
        return f
    target = np.where(modulus > 1.0, 1.0 / modulus, modulus)
    poles = poles / modulus.clip(1e-300) * np.minimum(target, _EDGE)
    return -np.real(np.poly(poles))[1:]


def inner_solution(
    f: Array,
    phi: Array,
    y: Array,
    n: int,
    guess: tuple[Array, Array] | None = None,
    parts: Parts | None = None,
    *,
    constant: bool = False,
) -> Inner:
    """Solve the bilinear problem for given f, from ``guess`` or the two-stage estimate.

    Raises
    ------
    EstimationError
        If the filtered regressors are dependent, or the problem does not converge.
    """
    p, parts = len(f), parts or whole(len(y))
    X, H = _filtered(f, phi, parts), _filtered(f, _impulses(p, parts), parts)
    if constant:
        H = np.column_stack([H, np.ones(len(y))])
    q = np.linalg.qr(H).Q

    def without_start(signals: Array) -> Array:
        return signals - times(times(signals, q), q.T)

    regression = Regression.of(X, n, without_start)
    if guess is None:
        first = two_stage(regression, y)
        guess = first.b, first.a
    found = bilinear_least_squares(regression, y, *guess)
    if not found.converged:
        raise EstimationError(f"the inner problem has not converged in {found.iterations} iterations")
    b, a = found.b, found.a
    rest = y - X @ np.outer(a, b).ravel()
    residuals = without_start(rest)
    output = y - residuals
    level = float(Factorisation.of(H).solution(rest)[-1]) if constant else None
    tangent = complement(np.concatenate([b, np.zeros_like(a)]))
    # F y = b'phi a + impulses: so the derivative by f_k is 1/F of the output k samples ago.
    driven = output if level is None else output - level
    derivative = np.column_stack(
        [_filtered(f, _delayed(driven, p, parts), parts), jacobian(X, b, a) @ tangent, H]
    )
    return Inner(f, b, a, residuals, output, derivative, tangent, level)


def separable_least_squares(
    phi: Array,
    y: Array,
    n: int,
    p: int,
    *,
    parts: Parts | None = None,
    tolerance: float = 1e-10,
    max_iterations: int = 100,
    constant: bool = False,
) -> tuple[Inner, int]:
    """Fit y(t) = (1/F) b'phi(t) a + v(t): f by Gauss and Newton's method, a, b and the start inside.

    Parameters
    ----------
    phi : array, shape (rows, n m)
        The regressors.
    y : array, shape (rows,)
        The output.
    n, p : int
        Number of lags and order of F.
    parts : sequence of slices, optional
        Where the rows of each experiment stand.
    tolerance : float
        Converged when a step in f changes the output by less than this, relative to it.
    max_iterations : int
        Most steps.
    constant : bool
        Whether the output has a constant beside this.

    Returns
    -------
    Inner, int
        The solution and the number of steps.

    Raises
    ------
    EstimationError
        If the regressors are dependent, or the iterations do not converge.

    Notes
    -----
    Consistent for an output noise of any colour that is independent of the input, efficient for a white
    Gaussian one. The derivative by f is that of variable projection in Kaufman's form.
    """

    def moved(current: Inner, step: Array) -> Inner | None:
        f = current.f + step[:p]
        if not TransferFunction(a=tuple(f)).is_stable():
            return None
        return inner_solution(f, phi, y, n, (current.b, current.a), parts, constant=constant)

    first = start(phi, y, p, parts, constant=constant)
    found = gauss_newton(
        inner_solution(first, phi, y, n, parts=parts, constant=constant),
        moved,
        lambda current, length: length <= tolerance * float(np.linalg.norm(current.output)),
        max_iterations=max_iterations,
        slack=1e-14 * float(y @ y),
        step_at_rest=True,
    )
    if found.status != "converged":
        raise EstimationError(
            f"the feedback coefficients have not converged in {found.iterations} iterations"
        )
    return found.point, found.iterations


@component("estimator", "separable_least_squares", source="Wang, Zhang, Ljung 2009, section 2")
class SeparableLeastSquares(BilinearSpec):
    """Hammerstein system with feedback in the linear block: a_1, ..., a_p outside, b_i and c_j inside.

        F(q) y(t) = sum_i b_i x(t-i) + F(q) v(t),    F(q) = 1 - a_1 q^-1 - ... - a_p q^-p
        x = sum_j c_j phi_j(u)

    Here a_i are the linear block's feedback coefficients, as in all of its kinds, and the nonlinearity is
    c_1 phi_1 + ... + c_m phi_m.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Arma(a=[0.5], b=[0.6, -0.8]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> estimator = hi.SeparableLeastSquares(lags=2, basis=["identity", "abs"], delay=0, feedback=1)
    >>> found = hi.fit(estimator, record)
    >>> [round(found.values[name], 6) for name in ("a_1", "b_0", "b_1")]
    [0.5, 0.6, -0.8]
    """

    holds = ("nonlinearity", "linear", "response")

    feedback: Annotated[Count, Field(ge=1)]
    """Order p of the feedback a_1, ..., a_p."""

    def fewest_samples(self) -> int:
        return super().fewest_samples() + 2 * self.feedback

    def letters(self) -> Mapping[str, str]:
        return {**DISCRETE, "c": self.basis_letter()}

    def normalisations(self) -> tuple[Normalisation, ...]:
        return (self.beside_constant(unit_length(self.delay, self.lags, "b c")),)

    def parameters(self) -> list[str]:
        feedback = [f"a_{i}" for i in range(1, self.feedback + 1)]
        return [*feedback, *self.b_names(), *(f"c_{j}" for j in range(1, len(self.functions()) + 1))]

    def names(self) -> list[str]:
        return [*with_errors(self.parameters()), "loss", "iterations", *self.constant_names()]

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        phi, y, parts = self.data(record)
        p, n = self.feedback, self.lags
        Regression.of(phi, n, delay=self.delay, constant=self.constant)
        found, iterations = separable_least_squares(phi, y, n, p, parts=parts, constant=self.constant)
        parameters = found.f, found.b, found.a
        constant = [] if found.constant is None else [found.constant]
        estimate = Estimate(
            nonlinearity=self.nonlinearity(found.a),
            linear=TransferFunction(b=self.linear(found.b).b, a=tuple(found.f.tolist())),
            values=self.named(*parameters, self._standard_errors(found), found.loss, iterations, *constant),
        )
        return self.responding(estimate, record.dt)

    def _standard_errors(self, found: Inner) -> Array:
        """Those of f, b and a under white noise, shape (p + n + m,)."""
        p, k = len(found.f), found.tangent.shape[1]
        root = Factorisation.of(found.jacobian).inverse_root
        root = np.vstack([root[:p], found.tangent @ root[p : p + k]])
        rows, columns = found.jacobian.shape
        return np.asarray(np.sqrt(found.loss / (rows - columns)) * np.linalg.norm(root, axis=1))
