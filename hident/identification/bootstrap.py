"""How sure a chosen model is: its chain fitted again to what it simulates, and its residuals reordered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hident.block_chain import BlockChain
from hident.errors import EstimationError
from hident.estimators.prediction_error.chain_fit import fit_with_states
from hident.estimators.prediction_error.standard_errors import normal_form
from hident.identification.continuation import continued
from hident.identification.identify import Identification
from hident.numerics.bootstrap import block_length, resampled
from hident.numerics.parts import following, in_each


@dataclass(frozen=True, eq=False)
class Bootstrap:
    """The chains fitted again, to circular blocks of ``length`` residuals; ``failed`` counts the others."""

    chains: tuple[BlockChain, ...]
    length: int
    failed: int


def bootstrap(
    found: Identification, count: int, *, seed: int = 0, tell: Callable[[int], None] = lambda done: None
) -> Bootstrap:
    """Fit the chosen chain again ``count`` times, by a residual bootstrap with circular blocks.

    The blocks are as long as suits how long the residuals remember. What the model cannot explain is in the
    residuals, and is drawn like noise: bands say how far the estimate would move, not whether it is right.

    Parameters
    ----------
    found : Identification
        What was chosen, and its fit to all samples.
    count : int
        How many times.
    seed : int
        Of the draws.
    tell : callable
        Is given how many are done.

    Raises
    ------
    EstimationError
        If none of them can be fitted.

    Examples
    --------
    >>> import hident as hi
    >>> from hident.identification.identify import identify
    >>> system = hi.Hammerstein(nonlinearity="identity", linear=hi.Arma(a=[0.7], b=[0, 0.3]))
    >>> uniform = hi.Iid(distribution="uniform", low=-3, high=3)
    >>> record = hi.simulate(system, uniform, 300, noise=hi.White(std=0.1))
    >>> poles = [chain.linear[0].a[0] for chain in bootstrap(identify(record, ["linear"]), 20).chains]
    >>> bool(0.001 < np.std(poles) < 0.01)
    True
    """
    point = found.model_fit.point
    data, chain = point.data, point.parameters.chain
    experiments = following(data.experiments, data.n_init)
    length = block_length(point.residuals, experiments)
    structure = found.chosen.spec.structure()
    chains = []
    for done, seeds in enumerate(np.random.SeedSequence(seed).spawn(count), start=1):
        rng = np.random.default_rng(seeds)
        y = point.signals[-1].copy()
        y[data.counted] += in_each(experiments, lambda e, rng=rng: resampled(e, length, rng), point.residuals)
        try:
            drawn = replace(data, y=y)
            if found.parts.finds_states:
                again = fit_with_states(structure, replace(point.parameters, states={}), drawn)
            else:
                again = continued(structure, chain, drawn)
            chains.append(normal_form(again.point).chain)
        except (EstimationError, np.linalg.LinAlgError):
            pass
        tell(done)
    if not chains:
        raise EstimationError(f"none of {count} bootstraps could be fitted")
    return Bootstrap(tuple(chains), length, count - len(chains))
