"""Whether an input can tell the numbers of a chain apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hident.errors import EstimationError
from hident.estimators.prediction_error.allocations import block
from hident.estimators.prediction_error.criterion import Data, point_at
from hident.estimators.prediction_error.structure import ChainStructure
from hident.linear_blocks import TransferFunction
from hident.static_functions import StaticFunction

_SAMPLES = 4000
# A smooth input tells numbers apart that noise may hide all the same.
_TELLS = 1e-10


def require_excitation(structure: ChainStructure, data: Data) -> None:
    """Raise EstimationError if the input tells fewer numbers apart than white Gaussian noise would.

    The rank of the Jacobian of a chain with poles, zeros and functions of no special kind is counted for both
    inputs: what is missing is the input's fault, whatever the true system is.
    """
    few = data.first(_SAMPLES)
    noise = np.random.default_rng(0).standard_normal(len(few.u))
    try:
        wanted = structure.made(few, _generic(structure), {}).count()
    except ValueError as error:
        raise EstimationError(str(error)) from None
    if wanted > data.count:
        raise EstimationError(f"{wanted} numbers are to be found, and {data.count} samples count")
    got, possible = (_rank(structure, one) for one in (few, replace(few, u=noise)))
    if got < possible:
        levels = len(np.unique(few.u))
        few_levels = f" (it has {levels} levels)" if levels < 20 else ""
        raise EstimationError(
            f"the input{few_levels} tells {got} of {possible} numbers of the chain apart: use one with more "
            "levels or frequencies, or blocks with fewer coefficients, knots or a narrower range"
        )


def _generic(structure: ChainStructure) -> dict[int, TransferFunction]:
    """Linear blocks with poles and zeros of no special kind, none of them twice."""
    linear = {}
    for i, orders in structure.linear.items():
        k = np.arange(orders.nf)
        poles = 0.8 * np.cos(np.pi * (k + 0.5 + 0.13 * i) / (orders.nf + 0.5))
        k = np.arange(orders.nb - 1)
        zeros = 0.7 * np.cos(np.pi * (k + 0.3 + 0.17 * i) / orders.nb)
        linear[i] = block(zeros.astype(complex), poles.astype(complex), orders.nk)
    return linear


def _rank(structure: ChainStructure, data: Data) -> int:
    try:
        parameters = structure.made(data, _generic(structure), {})
    except ValueError:
        return 0
    draws = np.random.default_rng(1)
    for i in parameters.free:
        function = parameters.chain.blocks[i]
        if isinstance(function, StaticFunction):
            # The identity would hide a factor behind it: a bend everywhere.
            bent = np.asarray(function.coefficients) * (
                1.0 + 0.5 * draws.standard_normal(function.basis.size)
            )
            parameters = parameters.with_block(i, replace(function, coefficients=tuple(bent.tolist())))
    # Solved coefficients would be those of the record: any output that is no special one will do.
    y = draws.standard_normal(len(data.u))
    point = point_at(replace(data, y=y + parameters.chain.response(data.u, data.start)), parameters)
    if point is None:
        return 0
    rows = point.rows()
    lengths = np.linalg.norm(rows, axis=1)
    lengths[lengths == 0.0] = 1.0
    rows /= lengths[:, None]
    values = np.linalg.svd(rows, compute_uv=False)
    return int(np.count_nonzero(values > _TELLS * values[0]))
