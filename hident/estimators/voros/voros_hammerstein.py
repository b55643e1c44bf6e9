"""Voros's method for Hammerstein systems, and what it shares with his method for Wiener systems.

======  =====================================================================================
f, g    the two-segment polynomial: f_1 x + f_2 x^2 + ... for x >= 0, g_1 x + g_2 x^2 + ... for x < 0
h(t)    the switching function: 1 where the argument is negative, else 0
a_i     feedback of the discrete linear block, i = 1, ..., n
b_i     its numerator, lags i = delay, ..., delay + m - 1
x(t)    the internal variable between the blocks
k       constant of the output, if there is one
======  =====================================================================================

Key-term separation: the product of the two blocks' parameters is written out for one term only, the key
term, and in the others x(t) stays. The model is then linear in all parameters for a known x(t), which is
taken from the iteration before.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from hident.arrays import Array, Characteristic, Index
from hident.config.spec import Count, Flag, Real, component
from hident.errors import EstimationError
from hident.estimators.base import DISCRETE, AtOneInterval, offset, require_finite, require_varying
from hident.estimators.convergence import History, Unconverged, settle
from hident.estimators.discrete_response import at_step
from hident.estimators.normalisation import Normalisation, first_coefficient
from hident.linear_blocks import TransferFunction
from hident.numerics.least_squares import Factorisation
from hident.numerics.parts import Parts, in_each, joined, longer_than, whole
from hident.numerics.whole import nearest_whole
from hident.records import Estimate, Record

_DIVERGED = 1e6
"""Growth of the internal variable, relative to the first iteration's, that counts as divergence."""


@dataclass(frozen=True, eq=False)
class TwoSegmentPolynomial:
    """f_1 x + ... + f_r x^r for x >= 0 and g_1 x + ... + g_r x^r for x < 0."""

    f: tuple[float, ...]
    g: tuple[float, ...]

    def __call__(self, x: Array) -> Array:
        from numpy.polynomial.polynomial import polyval

        return np.where(x < 0.0, polyval(x, (0.0, *self.g)), polyval(x, (0.0, *self.f)))


@dataclass(frozen=True)
class Structure:
    """Numbers of coefficients a and b, the first lag, the degree of each polynomial; whether there is k."""

    n: int
    m: int
    delay: int
    degree: int
    constant: bool = False

    @property
    def lags(self) -> range:
        """The lags of b."""
        return range(self.delay, self.delay + self.m)

    @property
    def first(self) -> int:
        """The first sample whose lags are all on record."""
        return max(self.n, self.delay + self.m - 1)

    def ones(self, rows: int) -> Array:
        """The regressor (rows, 1) of a constant; (rows, 0) without one."""
        return np.ones((rows, int(self.constant)))


@dataclass(frozen=True)
class Rule:
    """How to iterate.

    ``relaxation`` is the share of the new internal variable. No parameter may change by more than
    ``tolerance``, relative to the largest. Reaching ``max_iterations`` is not an error.
    """

    relaxation: float = 1.0
    tolerance: float = 1e-6
    max_iterations: int = 200


@dataclass(frozen=True, eq=False)
class Iterations:
    """The parameters theta (iterations + 1, P), the start first, and whether the last ones converged."""

    theta: Array
    converged: bool

    @property
    def count(self) -> int:
        return len(self.theta) - 1


def segments(x: Array, degree: int) -> Array:
    """x^j where x >= 0, then x^j where x < 0, for j = 1, ..., degree; shape (N, 2 degree)."""
    powers = x[:, None] ** np.arange(1, degree + 1)
    negative = x[:, None] < 0.0
    return np.hstack([np.where(negative, 0.0, powers), np.where(negative, powers, 0.0)])


def instants(parts: Parts, first: int) -> Index:
    """The samples whose lags are all on record: all but the ``first`` of each experiment."""
    return np.concatenate([np.arange(part.start + first, part.stop) for part in longer_than(parts, first)])


def delayed(rows: Array, lags: Sequence[int], at: Index) -> Array:
    """``rows`` (N,) at t - lag for each lag and each t in ``at``; shape (at, lags)."""
    return rows[at[:, None] - np.asarray(lags, dtype=np.intp)]


def solve(columns: Array, y: Array) -> Array:
    """The least squares solution (P,) for ``columns`` (rows, P).

    Raises
    ------
    EstimationError
        If the columns are linearly dependent.
    """
    regression, (rows, count) = Factorisation.of(columns), columns.shape
    if regression.is_dependent:
        raise EstimationError(
            f"the {count} regressors are linearly dependent over {rows} samples: the input needs several "
            "levels of either sign, or the record is too short, or a degree or an order too high"
        )
    return regression.solution(y)


def iterate(update: Callable[[Array], tuple[Array, Array]], theta: Array, x: Array, rule: Rule) -> Iterations:
    """Repeat ``theta, new = update(x)`` and x <- x + relaxation (new - x) until theta rests.

    Parameters
    ----------
    update : callable
        The parameters (P,) found with the internal variable x (N,), and the one that they give.
    theta, x : array, shapes (P,) and (N,)
        The start.
    rule : Rule
        The relaxation and when to stop.

    Raises
    ------
    EstimationError
        If the internal variable grows without bound, or a regression is singular.
    """
    found, bound = [theta], _DIVERGED * float(np.max(np.abs(x)))
    for iteration in range(1, rule.max_iterations + 1):
        theta, new = update(x)
        found.append(theta)
        x = x + rule.relaxation * (new - x)
        # Written so that nan counts as divergence too.
        if not np.max(np.abs(x)) <= bound:
            raise EstimationError(f"the internal variable diverged in iteration {iteration}")
        if np.max(np.abs(theta - found[-2])) <= rule.tolerance * np.max(np.abs(theta)):
            return Iterations(np.array(found), True)
    return Iterations(np.array(found), False)


class VorosSpec(AtOneInterval):
    """Base of Voros's methods: their fields, the decimation of the record, and their report.

    The first samples of each experiment, as many as the largest lag, serve as past samples only.
    """

    holds = ("nonlinearity", "linear", "response")

    n: Annotated[Count, Field(ge=1)]
    """Number n of feedback coefficients a_1, ..., a_n."""
    m: Annotated[Count, Field(ge=1)]
    """Number m of numerator coefficients, those of the lags delay, ..., delay + m - 1."""
    delay: Annotated[Count, Field(ge=0)] = 1
    """The first lag, in steps; a held input before a continuous block with dead time d has d / step + 1."""
    degree: Annotated[Count, Field(ge=1)]
    """Degree of the polynomial in each segment."""
    constant: Flag = False
    """Estimate a constant that is added to the output, such as the offset of a sensor or the nonlinearity's
    own; else it is zero, and one that is there biases all parameters."""
    step: Annotated[Real, Field(gt=0)] | None = None
    """Sampling interval of the discrete block, a multiple of dt (default: dt); the record is decimated."""
    relaxation: Annotated[Real, Field(gt=0, le=1)] = 1.0
    """Share of the new internal variable in each iteration: 1 is Voros's own, less damps."""
    tolerance: Annotated[Real, Field(gt=0)] = 1e-6
    """Converged when no parameter changes by more, relative to the largest."""
    max_iterations: Annotated[Count, Field(ge=1)] = 200
    """Most iterations."""
    unconverged: Unconverged = "fail"
    """Whether an iteration that has not converged by then counts as failed, or is kept as it is."""

    def letters(self) -> Mapping[str, str]:
        of = "coefficients of the nonlinearity's powers where its argument is"
        return {**DISCRETE, "f": f"{of} not negative", "g": f"{of} negative"}

    def identify(self, u: Array, y: Array, parts: Parts) -> Iterations:
        """The iterations for a decimated record of these experiments, theta = (a, b, f, g), and k behind."""
        raise NotImplementedError

    def simulate(self, nonlinearity: Characteristic, linear: TransferFunction, u: Array) -> Array:
        """The response at the method's own step, from rest."""
        raise NotImplementedError

    def structure(self) -> Structure:
        return Structure(self.n, self.m, self.delay, self.degree, self.constant)

    def rule(self) -> Rule:
        return Rule(self.relaxation, self.tolerance, self.max_iterations)

    def fewest_samples(self) -> int:
        # Every parameter but the one of the key term, and one equation more.
        return self.structure().first + self.n + self.m + 2 * self.degree + self.constant

    def parameters(self) -> list[str]:
        """The names of the parameters a, b, f, g, and of k."""
        return [
            *(f"a_{i}" for i in range(1, self.n + 1)),
            *(f"b_{i}" for i in range(self.delay, self.delay + self.m)),
            *(f"{segment}_{j}" for segment in "fg" for j in range(1, self.degree + 1)),
            *(["constant"] if self.constant else []),
        ]

    def free_parameters(self) -> int:
        # A rule gives one of them.
        return len(self.parameters()) - 1

    def names(self) -> list[str]:
        return [*self.parameters(), "iterations", "converged"]

    def discrete_step(self, dt: float | None) -> float:
        return super().discrete_step(dt) if self.step is None else self.step

    def check(self, n: int, dt: float | None) -> None:
        ratio = self._ratio(1.0 if dt is None else dt)
        left = len(range(0, n, ratio))
        if ratio > 1 and left < self.fewest_samples():
            raise ValueError(
                f"a 'step' of {self.step:g} leaves {left} of the {n} samples, and the method needs at least "
                f"{self.fewest_samples()}: use a shorter step or a longer record"
            )

    def _ratio(self, dt: float) -> int:
        """The samples of the record in a step."""
        if self.step is None:
            return 1
        quotient = self.step / dt
        ratio = nearest_whole(quotient)
        if ratio is None:
            near = f": {max(round(quotient), 1) * dt:g} is the nearest" if math.isfinite(quotient) else ""
            raise ValueError(
                f"'step' must be a multiple of the sampling interval {dt:g}, not {self.step:g}{near}"
            )
        return ratio

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        require_finite(record.y)
        require_varying(record.y, "output")
        self.require_experiments(record)
        dt = 1.0 if record.dt is None else record.dt
        ratio = self._ratio(dt)
        u, y = (in_each(record.experiments, lambda part: part[::ratio], one) for one in (record.u, record.y))
        parts = joined(len(range(part.start, part.stop, ratio)) for part in record.experiments)
        first = self.structure().first
        rows = sum(part.stop - part.start - first for part in longer_than(parts, first))
        if rows < self.fewest_samples() - first:
            raise EstimationError(
                f"{len(u)} samples at the method's step are too few: it needs {self.fewest_samples()}"
                + (f", and {first} more for each further experiment" if len(parts) > 1 else "")
            )
        found = self.identify(u, y, parts)
        settle(found.converged, found.count, self.unconverged)
        return self._estimate(found, ratio * dt)

    def _estimate(self, found: Iterations, step: float) -> Estimate:
        linear_ones = self.n + self.m
        sizes = [self.n, self.m, self.degree, self.degree]
        a, b, f, g, constant = np.split(found.theta, np.cumsum(sizes), axis=1)
        b = np.pad(b, ((0, 0), (self.delay, 0)))
        nonlinearity = TwoSegmentPolynomial(tuple(f[-1].tolist()), tuple(g[-1].tolist()))
        linear = TransferFunction(b=tuple(b[-1].tolist()), a=tuple(a[-1].tolist()))
        others = zip(self.parameters()[linear_ones:], np.hstack([f, g, constant]).T, strict=True)
        response = at_step(lambda u: self.simulate(nonlinearity, linear, u), step)
        return Estimate(
            nonlinearity=nonlinearity,
            linear=linear,
            response=offset(response, float(constant[-1, 0]) if self.constant else None),
            values=self.named(found.theta[-1], found.count, found.converged),
            details={"history": History(a, b, dict(others), found.converged)},
        )


def voros_hammerstein(
    u: Array,
    y: Array,
    structure: Structure,
    rule: Rule,
    parts: Parts | None = None,
    key: int | None = None,
) -> Iterations:
    """Fit y(t) = sum a_i y(t-i) + x(t-key) + sum b_i x(t-i), i not key, to a two-segment polynomial x of u.

    With a constant k, y(t) - k in the place of y(t) everywhere.

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
    key : int, optional
        The lag of the key term; the first one by default.

    Returns
    -------
    Iterations
        With theta = (a_1, ..., a_n, b_delay, ..., f_1, ..., f_r, g_1, ..., g_r), of which b_key is 1, and k
        behind if there is one.

    Raises
    ------
    EstimationError
        If a regression is singular, or the iteration diverges.

    Notes
    -----
    Voros 1999. The key term is b_key x(t-key) with b_key = 1; his is the first lag's, and any other serves,
    best that of a large coefficient. Voros's second polynomial is the difference g - f, which spans the
    same. The iteration starts with all other b_i at zero, where no internal variable is needed.
    """
    n, at = structure.n, instants(parts or whole(len(u)), structure.first)
    place = 0 if key is None else structure.lags.index(key)
    key = structure.lags[place]
    others = [lag for lag in structure.lags if lag != key]
    basis = segments(u, structure.degree)
    ones = structure.ones(len(at))
    known = np.hstack([delayed(y, range(1, n + 1), at), basis[at - key]])

    def theta(a: Array, b: Array, c: Array, level: Array) -> Array:
        # The equation holds (1 - a_1 - ... - a_n) k.
        return np.concatenate((a, np.insert(b, place, 1.0), c, level / (1.0 - np.sum(a))))

    def update(x: Array) -> tuple[Array, Array]:
        columns = np.hstack([known, delayed(x, others, at), ones])
        a, c, b, level = np.split(solve(columns, y[at]), [n, known.shape[1], known.shape[1] + len(others)])
        return theta(a, b, c, level), basis @ c

    a, c, level = np.split(solve(np.hstack([known, ones]), y[at]), [n, known.shape[1]])
    return iterate(update, theta(a, np.zeros(structure.m - 1), c, level), basis @ c, rule)


@component("estimator", "voros_hammerstein", source="Voros 1999, IEEE Trans. Autom. Control 44, 2145")
class VorosHammerstein(VorosSpec):
    """Hammerstein system with a two-segment polynomial, discrete, by key-term separation.

        y(t) = sum_i a_i y(t-i) + x(t-k) + sum_{i != k} b_i x(t-i),    x = f(u) + (g(u) - f(u)) h(u)

    The term of the lag k is the key term, in which x is written out.

    The key term's b is 1, so that the static gain lies in the nonlinearity. Both polynomials vanish at zero.

    Examples
    --------
    >>> import hident as hi
    >>> quadratic = hi.Polynomial(coefficients=[0, 1, 2])
    >>> system = hi.Hammerstein(nonlinearity=quadratic, linear=hi.Ar(a=[0.5]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> round(hi.fit(hi.VorosHammerstein(n=1, m=1, delay=0, degree=2), record).linear.a[0], 3)
    0.5
    """

    key: Annotated[Count, Field(ge=0)] | None = None
    """Lag of the key term, whose b is 1: the first by default, as Voros has it; best that of a large b."""

    @model_validator(mode="after")
    def _key_is_a_lag(self) -> Self:
        lags = self.structure().lags
        if self.key is not None and self.key not in lags:
            raise ValueError(
                f"'key' must be a lag of the numerator, {lags[0]} to {lags[-1]}, not {self.key}: "
                "set 'delay' and 'm' so that they hold it"
            )
        return self

    def normalisations(self) -> tuple[Normalisation, ...]:
        lag = self.delay if self.key is None else self.key
        return (first_coefficient(lag, values="b f g", step=self.step).beside(self.constant),)

    def identify(self, u: Array, y: Array, parts: Parts) -> Iterations:
        return voros_hammerstein(u, y, self.structure(), self.rule(), parts, self.key)

    def simulate(self, nonlinearity: Characteristic, linear: TransferFunction, u: Array) -> Array:
        return linear.filter(nonlinearity(u))
