"""Fields and parts that the estimators of Hammerstein systems with known basis functions share.

Symbols are in :mod:`hident.estimators.bilinear_models.bilinear`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from hident.arrays import Array, Characteristic
from hident.config.spec import Count, Flag
from hident.errors import EstimationError
from hident.estimators.base import (
    FUNCTIONS,
    IMPULSE_RESPONSE,
    POWERS,
    AtOneInterval,
    offset,
    require_finite,
    require_varying,
    varies,
)
from hident.estimators.bilinear_models.bilinear import Regression, normalised, regressors
from hident.estimators.discrete_response import at_step
from hident.estimators.normalisation import Normalisation, unit_length
from hident.linear_blocks import TransferFunction
from hident.numerics.least_squares import Factorisation
from hident.numerics.parts import Parts, following, in_each, longer_than
from hident.records import Estimate, Record, Response, needed
from hident.systems.base import NonlinearitySpec, OfStatic
from hident.systems.nonlinearity import Power

# Where functions are told from powers.
_PROBES = np.array([-2.0, -1.0, 0.0, 0.5, 1.0, 3.0])


@dataclass(frozen=True, eq=False)
class Expansion:
    """The nonlinearity sum_j a_j phi_j, Eq. (3)."""

    functions: tuple[NonlinearitySpec, ...]
    a: tuple[float, ...]

    def __call__(self, x: Array) -> Array:
        return np.asarray(sum(a * phi(x) for a, phi in zip(self.a, self.functions, strict=True)))


class LaggedSpec(AtOneInterval):
    """Base of the estimators that regress y(t) on known functions of x(t-delay), x(t-delay-1), ...

    The first delay + lags - 1 samples of each experiment serve as lagged inputs only.
    """

    lags: Annotated[Count, Field(ge=1)]
    """Number n of coefficients of the linear block."""
    delay: Annotated[Count, Field(ge=0)] = 1
    """The first lag: y(t) depends on x(t-delay), ..., x(t-delay-lags+1)."""
    constant: Flag = False
    """Estimate a constant that is added to the output, such as the offset of a sensor or the nonlinearity's
    own; else it is zero, and one that is there biases all parameters."""

    def functions(self) -> tuple[NonlinearitySpec, ...]:
        """phi_1, ..., phi_m."""
        raise NotImplementedError

    @property
    def first(self) -> int:
        """The first sample whose lagged inputs are all on record."""
        return self.delay + self.lags - 1

    def fewest_samples(self) -> int:
        # One equation more than coefficients, for the variance of the noise.
        return self.first + self.lags * len(self.functions()) + 1 + self.constant

    def free_parameters(self) -> int | None:
        found = super().free_parameters()
        return None if found is None else found + self.constant

    def constant_names(self) -> list[str]:
        """The name of the constant's value, if it is estimated."""
        return ["constant"] if self.constant else []

    def beside_constant(self, rule: Normalisation) -> Normalisation:
        """The rule, with what is said of a constant."""
        return rule.beside(self.constant, self.functions())

    def basis_values(self, x: Array) -> Array:
        """The basis functions (m, N) of the input.

        Raises
        ------
        EstimationError
            If a function is not finite.
        """
        basis = np.array([phi(x) for phi in self.functions()])
        for j, row in enumerate(basis, start=1):
            if wrong := len(row) - np.count_nonzero(np.isfinite(row)):
                raise EstimationError(f"phi_{j} is not finite at {wrong} of {len(row)} samples of the input")
        return basis

    def data(self, record: Record) -> tuple[Array, Array, Parts]:
        """The regressors Phi (rows, n m), the outputs (rows,), and where the rows of each experiment stand.

        Raises
        ------
        EstimationError
            If no experiment is long enough for the lags, or the output is not finite or constant.
        """
        phi, parts = self.design(record)
        return phi, self.outputs(record), parts

    def outputs(self, record: Record) -> Array:
        """The outputs (rows,) that are regressed.

        Raises
        ------
        EstimationError
            If the output is not finite or constant, or no experiment is long enough for the lags.
        """
        require_finite(record.y)
        require_varying(record.y, "output")
        return in_each(self._long_enough(record), lambda y: y[self.first :], record.y)

    def all_outputs(self, records: Sequence[Record]) -> Array:
        """The outputs (T, rows) of T records of the same experiments, as :meth:`outputs` gives each."""
        y = np.stack([record.y for record in records])
        if not np.all(np.isfinite(y)) or not np.all(varies(y)):
            for record in records:
                self.outputs(record)
        return in_each(self._long_enough(records[0]), lambda y: y[:, self.first :], y, axis=1)

    def design(self, record: Record) -> tuple[Array, Parts]:
        """The regressors Phi (rows, n m), and where the rows of each experiment stand.

        Raises
        ------
        EstimationError
            If no experiment is long enough for the lags.
        """
        self.require_experiments(record)
        parts = self._long_enough(record)
        # The basis has a row for each function, the regressors one for each sample.
        phi = in_each(parts, lambda x: regressors(self.basis_values(x), self.lags, self.delay), record.u)
        return phi, following(parts, self.first)

    def _long_enough(self, record: Record) -> Parts:
        parts = longer_than(record.experiments, self.first)
        if not parts:
            longest = max(part.stop - part.start for part in record.experiments)
            raise EstimationError(f"{longest} samples are too few for the lags {self.delay} to {self.first}")
        return parts

    def check_record(self, record: Record) -> None:
        phi, _ = self.design(record)
        try:
            Regression.of(phi, self.lags, delay=self.delay, constant=self.constant)
        except EstimationError as error:
            raise EstimationError(f"the input cannot tell the parameters apart: {error}") from None

    def b_names(self) -> list[str]:
        """The names of the linear coefficients: b_i multiplies lag i."""
        return [f"b_{i}" for i in range(self.delay, self.delay + self.lags)]

    def linear(self, b: Array) -> TransferFunction:
        """The linear block with the coefficients ``b`` (n,)."""
        return TransferFunction(b=(0.0,) * self.delay + tuple(b.tolist()))

    def responding(self, estimate: Estimate, dt: float | None) -> Estimate:
        """The estimate with the response of its two blocks, from rest, and its constant."""
        nonlinearity, linear = needed(estimate.nonlinearity), needed(estimate.linear)
        constant = estimate.values.get("constant")
        return replace(estimate, response=self.response(nonlinearity, linear, dt, constant))

    @staticmethod
    def response(
        nonlinearity: Characteristic,
        linear: TransferFunction,
        dt: float | None,
        constant: float | None = None,
    ) -> Response:
        """The response of the two blocks, from rest, and a constant beside it."""
        of_blocks = at_step(lambda u: linear.filter(nonlinearity(u)), 1.0 if dt is None else dt)
        return offset(of_blocks, constant)


class BilinearSpec(LaggedSpec):
    """Base of the estimators of a Hammerstein system with known basis functions."""

    degree: Annotated[Count, Field(ge=1)] | None = None
    """The basis functions x, x^2, ..., x^degree; give this or 'basis'."""
    basis: tuple[Annotated[NonlinearitySpec, OfStatic()], ...] | None = None
    """The basis functions phi_1, ..., phi_m, e.g. [identity, abs, {kind: power, exponent: 3}]."""

    @model_validator(mode="after")
    def _one_basis(self) -> Self:
        if (self.degree is None) == (self.basis is None):
            raise ValueError("give either 'degree' or 'basis'")
        if self.basis is not None and not self.basis:
            raise ValueError("'basis' must be a list of at least one function")
        return self

    def functions(self) -> tuple[NonlinearitySpec, ...]:
        return self._functions

    @cached_property
    def _functions(self) -> tuple[NonlinearitySpec, ...]:
        if self.basis is not None:
            return self.basis
        assert self.degree is not None  # by validation
        return tuple(Power(exponent=j) for j in range(1, self.degree + 1))

    def basis_letter(self) -> str:
        """What the coefficients of the basis functions are: of powers, if these are x, x^2, ..."""
        powers = (np.allclose(phi(_PROBES), _PROBES**j) for j, phi in enumerate(self.functions(), start=1))
        return POWERS if self.degree is not None or all(powers) else FUNCTIONS

    def letters(self) -> Mapping[str, str]:
        return {"a": self.basis_letter(), "b": IMPULSE_RESPONSE}

    def normalisations(self) -> tuple[Normalisation, ...]:
        return (self.beside_constant(unit_length(self.delay, self.lags, "a b", responses=True)),)

    def free_parameters(self) -> int:
        # The length of b is one.
        return len(self.parameters()) - 1 + self.constant

    def true_parameters(self, record: Record) -> tuple[Array, Array]:
        """b and a of the simulated system, normalised.

        Raises
        ------
        EstimationError
            If the record has no truth, or the truth is not of this form.
        """
        truth = record.truth
        if truth is None or truth.linear is None or truth.nonlinearity is None:
            raise EstimationError("the true parameters are needed, and the record has none")
        response = np.asarray(truth.linear.b)
        last = self.delay + self.lags
        if truth.linear.a or np.any(response[: self.delay]) or np.any(response[last:]):
            raise EstimationError(
                f"the true linear block is not a finite response at the lags {self.delay} to {last - 1}"
            )
        b = np.zeros(self.lags)
        b[: len(response) - self.delay] = response[self.delay :]
        basis, w = self.basis_values(record.u), truth.nonlinearity(record.u)
        if self.constant:
            basis = np.vstack([basis, np.ones(len(w))])
        a = Factorisation.of(basis.T).solution(w)
        if np.linalg.norm(a @ basis - w) > 1e-9 * np.linalg.norm(w):
            raise EstimationError("the true nonlinearity is not a combination of the basis functions")
        return normalised(b, a[: len(self.functions())])

    def parameters(self) -> list[str]:
        """The names of b_i and a_j."""
        return [*self.b_names(), *(f"a_{j}" for j in range(1, len(self.functions()) + 1))]

    def nonlinearity(self, a: Array) -> Expansion:
        """The nonlinearity with the coefficients ``a`` (m,)."""
        return Expansion(self.functions(), tuple(a.tolist()))
