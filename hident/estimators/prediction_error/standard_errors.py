"""Standard errors of the numbers of a chain, of residuals that need not be white."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hident.arrays import Array
from hident.block_chain import BlockChain
from hident.estimators.prediction_error.criterion import FREE, Point
from hident.estimators.prediction_error.gauge import normalised_with_factors
from hident.estimators.prediction_error.parameters import LinearStructure, Parameters
from hident.numerics.autoregression import ArModel, yule_walker
from hident.numerics.parts import Parts, following, in_each
from hident.static_functions import StaticFunction

_STEP = 1e-6


def names(parameters: Parameters, i: int) -> list[str]:
    """The names of the numbers of block i, in their order: b and a of a linear block, c of a static one."""
    return parameters.structures[i].names()


def values(parameters: Parameters, i: int) -> Array:
    """The numbers of block i in that order, a with the sign of :class:`TransferFunction`."""
    return parameters.structures[i].values(parameters.numbers(i))


def normal_form(point: Point) -> Parameters:
    """The parameters in which the rule of :mod:`gauge` holds."""
    return _normal_form(point.parameters, point)


def _normal_form(parameters: Parameters, point: Point) -> Parameters:
    chain, factors = normalised_with_factors(parameters.chain, parameters.held, point.data.start)
    states = {i: tuple(factors[i] * state for state in one) for i, one in parameters.states.items()}
    return Parameters.of(parameters.structures, chain, parameters.held, states)


def standard_errors(point: Point) -> tuple[Mapping[str, float], ...]:
    """The standard error of each number of each block that is not held, in the normal form.

    With H the Hessian of half the sum of squares and S the covariance of the gradient, which follows from an
    autoregressive model of the residuals, its order by Schwarz's criterion (Den Haan and Levin 1997, Handbook
    of Statistics 15, 299), the covariance is H^+ S H^+ (Ljung, 9.2; White 1982, Econometrica 50, 1), carried
    to the normal form by its derivative: what is free drops out there. Where states are found with the
    numbers, their part of H and S counts, and no error of theirs is given.
    """
    return by_name(point, np.sqrt(np.maximum(np.diag(carried(point, _covariance(point))), 0.0)))


def carried(point: Point, covariance: Array) -> Array:
    """The covariance (P, P) of the numbers of all blocks to be found, in the normal form."""
    derivative = _derivative(point)
    return derivative @ covariance @ derivative.T


def by_name(point: Point, numbers: Array) -> tuple[Mapping[str, float], ...]:
    """Numbers (P,) of all blocks to be found, for each block by their names; nothing of one that is held."""
    parameters = point.parameters
    found: list[Mapping[str, float]] = []
    waiting = iter(numbers.tolist())
    for i in range(len(parameters.structures)):
        block = names(parameters, i) if i in parameters.free else []
        found.append(dict(zip(block, waiting, strict=False)))
    return tuple(found)


def _covariance(point: Point) -> Array:
    """The covariance of the numbers of all blocks to be found, each block's together, in their own form."""
    from scipy.signal import lfilter

    count, rows = rows_of_numbers(point)
    lengths = np.linalg.norm(rows, axis=1)
    lengths[lengths == 0.0] = 1.0
    rows /= lengths[:, None]
    values, vectors = np.linalg.eigh(rows @ rows.T)
    known = values > FREE * values[-1]
    inverse = (vectors[:, known] / values[known]) @ vectors[:, known].T
    samples = len(point.residuals)
    freedom = max(samples - int(np.count_nonzero(known)), 1)
    experiments = following(point.data.experiments, point.data.n_init)
    noise = _residual_model(point.residuals, experiments)

    def coloured(piece: Array) -> Array:
        return np.asarray(lfilter([1.0], np.r_[1.0, -noise.a], piece[:, ::-1], axis=1))

    # S = J^T R J with R = variance (D^T D)^-1: the rows backwards through 1/D.
    rows = in_each(experiments, coloured, rows, axis=1)
    meat = noise.variance * samples / freedom * (rows @ rows.T)
    covariance = inverse @ meat @ inverse / np.outer(lengths, lengths)
    return np.asarray(covariance[:count, :count])


def rows_of_numbers(point: Point) -> tuple[int, Array]:
    """How many numbers are to be found in all blocks, and the rows of these and of the states behind them."""
    numbers, states = _order(point)
    return len(numbers), point.rows()[[*numbers, *states]]


def _residual_model(residuals: Array, experiments: Parts) -> ArModel:
    """The autoregression of residuals (N,) that Schwarz's criterion chooses.

    Of an order that is always high, the spectrum falls where the fit has taken its share: where the input has
    most of its power, and the standard errors need it.
    """
    count = len(residuals)
    models = yule_walker(residuals, int(min(10 * np.log10(count), count // 10)), experiments)
    left = [one for one in models if one.variance > 0.0] or models[:1]
    if len(left) == 1:
        return left[0]
    return min(left, key=lambda one: count * np.log(one.variance) + np.log(count) * len(one.a))


def _order(point: Point) -> tuple[list[int], list[int]]:
    """Where the rows of each block's numbers stand among those of the point, and where those of the states.

    The noise's are left out.
    """
    parameters = point.parameters
    stepped = len(parameters.theta)
    behind = stepped + len(point.noise.ar) + len(point.noise.ma)
    found: list[int] = []
    for i in parameters.free:
        count, place = parameters.stepped(i), parameters.place(i)
        found += range(place, place + count)
        found += range(behind, behind + parameters.structures[i].size - count)
    numbers = set(found)
    return found, [row for row in range(stepped) if row not in numbers]


def _derivative(point: Point) -> Array:
    """The derivative of the numbers in the normal form by those in their own form, by differences."""
    parameters = point.parameters
    own = [parameters.numbers(i) for i in parameters.free]
    sizes = np.cumsum([0, *(len(numbers) for numbers in own)])
    whole = np.concatenate(own)
    steps = _STEP * np.concatenate([_scales(parameters, i) for i in parameters.free])
    found = np.empty((len(whole), len(whole)))
    for k, step in enumerate(steps):
        sides = []
        for sign in (1.0, -1.0):
            moved = whole.copy()
            moved[k] += sign * step
            chain: BlockChain = parameters.chain
            blocks = list(chain.blocks)
            for i, start, stop in zip(parameters.free, sizes, sizes[1:], strict=False):
                blocks[i] = parameters.structures[i].made(moved[start:stop])
            form = _normal_form(replace(parameters, chain=replace(chain, blocks=tuple(blocks))), point)
            sides.append(np.concatenate([values(form, i) for i in form.free]))
        found[:, k] = (sides[0] - sides[1]) / (2.0 * step)
    return found


def _scales(parameters: Parameters, i: int) -> Array:
    """By how much each number of block i must change to matter: each sort has a unit of its own."""
    numbers, structure = np.abs(parameters.numbers(i)), parameters.structures[i]
    if isinstance(structure, LinearStructure):
        return structure.scales(parameters.numbers(i))
    shape = len(structure.basis.shape)
    block = parameters.chain.blocks[i]
    assert isinstance(block, StaticFunction)
    low, high = block.range
    largest = float(np.max(numbers[shape:])) or 1.0
    return np.concatenate((np.full(shape, high - low), np.full(len(numbers) - shape, largest)))
