"""What no unbiased estimate of a chain of blocks can beat, from the true blocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field

from hident.arrays import Array, Characteristic
from hident.config.spec import Of, Real, component
from hident.errors import EstimationError
from hident.estimators.base import AtOneInterval, require_finite, require_varying
from hident.estimators.normalisation import MissedConstant, Normalisation
from hident.estimators.prediction_error.criterion import FREE, point_at, simulated
from hident.estimators.prediction_error.excitation import require_excitation
from hident.estimators.prediction_error.parameters import is_stable
from hident.estimators.prediction_error.prediction_error import PredictionError
from hident.estimators.prediction_error.standard_errors import by_name, carried, rows_of_numbers
from hident.fitted_model import NoiseModel
from hident.records import Estimate, Record


def _of_true_blocks(of: PredictionError) -> PredictionError:
    for i, block in enumerate(of.blocks, start=1):
        if block.given() is None:
            raise ValueError(f"block {i} needs 'start', the true block")
    if of.start == "estimated":
        raise ValueError("must begin 'settled' or at 'rest': the bound is for a known beginning")
    return of


@component("estimator", "chain_cramer_rao", source="Ljung, System Identification, 2nd ed., (7.74), (9.29)")
class ChainCramerRao(AtOneInterval):
    """Least standard deviations of a chain's numbers, from the true blocks: Cramer-Rao bound.

    For Gaussian noise of known spectrum on the output; that it has to be estimated costs nothing in large
    samples. ``se_b_0`` and so on are in the form of ``prediction_error``, ``output_mse`` is the least mean
    squared error of the model's output on the record's input.

    Examples
    --------
    >>> import hident as hi
    >>> f, g = hi.Polynomial(coefficients=[0, 1, 0.5]), hi.Ar(a=[0.5])
    >>> input = hi.Iid(distribution="gaussian", std=1)
    >>> record = hi.simulate(hi.Hammerstein(nonlinearity=f, linear=g), input, 500, noise=hi.White(std=0.1))
    >>> blocks = [hi.PolynomialBlock(degree=2, range=(-5, 5), start=f), hi.LinearBlock(nb=1, nf=1, start=g)]
    >>> of = hi.PredictionError(blocks=blocks, start="rest")
    >>> bound = hi.fit(hi.ChainCramerRao(of=of, variance=0.01), record)
    >>> round(bound.values["output_mse"], 9)
    8e-05
    """

    of: Annotated[PredictionError, Of("estimator"), AfterValidator(_of_true_blocks)]
    """The prediction_error with the true blocks, each as its ``start``; ``held`` ones are known."""
    noise: tuple[Real, ...] = ()
    """Feedback coefficients a_1, a_2, ... of autoregressive noise; white if left out."""
    variance: Annotated[Real, Field(gt=0)] | None = None
    """Variance of the innovation; by default that of the record's own noise."""

    def names(self) -> Sequence[str]:
        return [*(name for name in self.of.names() if name.startswith("se_")), "output_mse"]

    def letters(self) -> Mapping[str, str]:
        return self.of.letters()

    def normalisations(self) -> tuple[Normalisation, ...] | None:
        return self.of.normalisations()

    def misses_constant(self, nonlinearity: Characteristic) -> MissedConstant | None:
        return self.of.misses_constant(nonlinearity)

    def fewest_samples(self) -> int:
        return self.of.fewest_samples()

    def check(self, n: int, dt: float | None) -> None:
        self.of.check(n, dt)

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        require_finite(record.y)
        require_varying(record.u, "input")
        self.require_experiments(record)
        structure, data = self.of.structure(record.dt), self.of.data(record)
        require_excitation(structure, data)
        noise = NoiseModel(ar=self.noise)
        parameters = structure.made(data, {}, {})
        if not is_stable(np.r_[1.0, -np.asarray(self.noise)]):
            raise EstimationError("the noise is not stable, and has no spectrum")
        # Of the output that is met exactly, the coefficients that are solved for are the true ones.
        point = point_at(replace(data, y=simulated(data, parameters.chain)), parameters, noise)
        if point is None:
            raise EstimationError("the output of the true blocks is not finite")
        innovations = data.whitened(noise, record.y - point.signals[-1])[data.counted]
        variance = self.variance or float(np.mean(innovations**2))
        covariance = variance * _inverse(rows_of_numbers(point)[1])
        plain = rows_of_numbers(replace(point, noise=NoiseModel()))[1]
        output_mse = float(np.einsum("ij,ik,jk->", covariance, plain, plain, optimize=True)) / data.count
        errors = np.sqrt(np.maximum(np.diag(carried(point, covariance)), 0.0))
        found = self.of.standard_errors(by_name(point, errors))
        return Estimate(values={**found, "output_mse": output_mse})


def _inverse(rows: Array) -> Array:
    """The pseudoinverse (P, P) of rows (P, N) times their transpose, free directions left out."""
    lengths = np.linalg.norm(rows, axis=1)
    lengths[lengths == 0.0] = 1.0
    rows = rows / lengths[:, None]
    values, vectors = np.linalg.eigh(rows @ rows.T)
    known = values > FREE * values[-1]
    inverse = (vectors[:, known] / values[known]) @ vectors[:, known].T
    return np.asarray(inverse / np.outer(lengths, lengths))
