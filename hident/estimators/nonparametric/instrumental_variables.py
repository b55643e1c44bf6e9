"""Step 1 of Mzyk 2009: the linear block of a Hammerstein system by instrumental variables.

======  ===================================================================================
phi_k   regressors y_{k-1}, ..., y_{k-p}, 1
psi_k   instruments m(u_{k-1-q}), ..., m(u_{k-p-q}), 1 (the paper: q = 0)
theta   a_1, ..., a_p and the constant; with several experiments, a 1 and a constant for each
======  ===================================================================================
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.spec import Count, component
from hident.errors import EstimationError
from hident.estimators.base import require_finite
from hident.estimators.nonparametric.least_squares import DynamicsSpec, dynamics, lagged
from hident.numerics.least_squares import ILL_CONDITIONED, lengths
from hident.numerics.parts import Parts
from hident.records import Estimate, Record
from hident.systems.base import NonlinearitySpec, OfStatic


def instrumental_variables(
    y: Array, m: Array, p: int, ma_order: int = 0, parts: Parts | None = None
) -> Estimate:
    """Identify the linear block with the instruments m(u_k).

    Parameters
    ----------
    y, m : arrays, shape (N,)
        The output y_k, and m(u_k) for a function m with cov(mu(u_k), m(u_k)) != 0.
    p : int
        Order of the autoregression A, at least 1.
    ma_order : int
        Order q of the moving average B = 1 + b_1 z^-1 + ... + b_q z^-q.
    parts : sequence of slices, optional
        Where the experiments stand; one by default.

    Returns
    -------
    Estimate
        The linear block B/A, the values ``a_1``, ..., ``a_p``, ``b_1``, ..., ``b_q`` and ``c`` = E w_k, its
        mean over all samples where the experiments differ in it.

    Raises
    ------
    EstimationError
        If Psi'Phi is singular, or (q > 0) the instruments are
        uncorrelated with what A leaves of the output.

    Notes
    -----
    Mzyk 2009, eq. (9)-(13). The input must be white and independent of the noise.

    Differs from the paper: a record has no outputs before its first, so the sums begin at k = p + q, not
    at the first sample, in each experiment. For q > 0 (remark 3's invertible ARMA block) the instruments are
    delayed by q more samples, which makes them uncorrelated with w_k, ..., w_{k-q} and so identifies A; then
    cov((A y)_k, m(u_{k-l})) = b_l cov(w_k, m(u_k)) gives B, with b_0 = 1 as the paper's gamma_0 = 1. The
    constant of the regression is then B(1) E w_k, and ``c`` is that divided by B(1). Remark 3's own way for
    an invertible filter is a high order p with q = 0.
    """
    require_finite(y)
    q = ma_order
    start = p + q
    # Eq. (12)
    outputs = lagged(y, range(p + 1), start, parts)
    now, phi = outputs[0], outputs[1:]
    psi = lagged(m, range(1 + q, p + q + 1), start, parts)
    phi_scale, psi_scale = lengths(phi.T), lengths(psi.T)
    moments = (psi @ phi.T) / np.outer(psi_scale, phi_scale)
    condition = float(np.linalg.cond(moments))
    if not condition < ILL_CONDITIONED:
        raise EstimationError(
            f"Psi'Phi is singular (condition number {condition:.1e}): the instruments are uncorrelated with "
            "the output, or the order is too high; choose an instrument that is odd for an odd nonlinearity "
            "and even for an even one, or a lower order"
        )
    theta = np.linalg.solve(moments, psi @ now / psi_scale) / phi_scale
    a, constant = theta[:p], float(theta[p:] @ phi[p:].mean(axis=1))

    b = np.ones(1)
    if q:
        undone = now - a @ phi[:p]
        for row in phi[p:]:
            undone[row > 0.0] -= undone[row > 0.0].mean()
        instruments = lagged(m, range(q + 1), start, parts)[: q + 1]
        covariance = instruments @ undone
        if not abs(covariance[0]) > _UNCORRELATED * np.linalg.norm(instruments[0]) * np.linalg.norm(now):
            raise EstimationError(
                "the instruments are not correlated with what the feedback leaves of the output: the moving "
                "average cannot be told; use an input that varies irregularly, or another instrument"
            )
        b = covariance / covariance[0]
        if not abs(b.sum()) > _UNCORRELATED * np.abs(b).sum():
            raise EstimationError(
                "the moving average has no static gain (1 + b_1 + ... is zero): the constant c cannot be told"
            )
    return dynamics(a, b, constant / float(b.sum()))


# A correlation coefficient below this is rounding.
_UNCORRELATED = 1e-12


@component("estimator", "instrumental_variables", source="Mzyk 2009, eq. (12)")
class InstrumentalVariables(DynamicsSpec):
    """Linear block by instrumental variables m(u); consistent under output noise.

        theta = (sum_k psi_k phi_k')^-1 sum_k psi_k y_k

    The first ``order`` + ``ma_order`` samples of each experiment serve as past samples only.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity="abs", linear=hi.Ar(a=[0.5]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> round(hi.fit(hi.InstrumentalVariables(order=1, instrument="abs"), record).values["a_1"], 1)
    0.5
    """

    order: Annotated[Count, Field(ge=1)]
    """Order p of the autoregression; a high one also approximates an invertible ARMA block."""
    instrument: Annotated[NonlinearitySpec, OfStatic()]
    """The function m of the input: correlated with the nonlinearity's output."""
    ma_order: Annotated[Count, Field(ge=0)] = 0
    """Order q of the moving average b_1, ..., b_q (b_0 = 1)."""

    def numerator_order(self) -> int:
        return self.ma_order

    def identify(self, record: Record) -> Estimate:
        m = self.instrument(record.u)
        return instrumental_variables(record.y, m, self.order, self.ma_order, record.experiments)
