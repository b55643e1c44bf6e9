"""The fit of a chain of blocks: starts, a race of them on a part of the record, the best on all of it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hident.block_chain import BlockChain
from hident.errors import EstimationError
from hident.estimators.base import unknown_past
from hident.estimators.prediction_error.criterion import Data, Point, least_squares, point_at
from hident.estimators.prediction_error.descent import Descent, Status, descend
from hident.estimators.prediction_error.excitation import require_excitation
from hident.estimators.prediction_error.fewer_blocks import of_fewer_blocks
from hident.estimators.prediction_error.linear_start import stabilised
from hident.estimators.prediction_error.parameters import LinearStructure, Parameters
from hident.estimators.prediction_error.starts import DEFAULT, Initialisation, exchanged, starts
from hident.estimators.prediction_error.structure import ChainStructure
from hident.fitted_model import NoiseModel
from hident.initial_states import initial_states
from hident.linear_blocks import TransferFunction

# The race: so many samples, and iterations of each start, then of the best of them.
_FIRST_HEAT, _SECOND_HEAT = (6000, 6), (12000, 40)
_KEPT_OF_FIRST = 3
# So many other splits of the roots that were found are raced.
_EXCHANGED = 4
# With smooth functions: so many starts, of which so many go on for so many iterations.
_RACED_OF_SMOOTH, _KEPT_OF_SMOOTH, _SMOOTH_ITERATIONS = 6, 2, 12
_NEAR_ONE_OPTIMUM, _ONE_LOSS = 0.02, 1e-9
# Roots of the first noise model are no farther from 0.
_FARTHEST_OF_NOISE = 0.99
_MOST_STATES = 500
# Two fits whose losses are nearer than this are one optimum.
_SAME = 1e-3


@dataclass(frozen=True, eq=False)
class ChainFit:
    """The best fit that was found.

    ``starts`` counts the starts that were raced, ``finalists`` those that were followed to the end of the
    last heat, and ``agreeing`` those of them that came to one loss: where it is one of several, there are
    other optima.
    """

    point: Point
    status: Status
    iterations: int
    evaluations: int
    starts: int
    finalists: int
    agreeing: int


def fit_chain(
    structure: ChainStructure,
    data: Data,
    *,
    ar: int = 0,
    ma: int = 0,
    most_starts: int = 8,
    max_iterations: int = 100,
    states: bool = False,
    initialisation: Collection[Initialisation] = DEFAULT,
) -> ChainFit:
    """Fit a chain to data, then the ``states`` at the first samples and the noise with it, if asked for.

    Raises
    ------
    EstimationError
        If the input says too little, or no start can be made of the data.
    """
    everything = data
    if states:
        # The search is not to be misled by what it does not know yet.
        shortest = min(part.stop - part.start for part in data.experiments)
        data = replace(data, n_init=max(data.n_init, unknown_past(shortest)))
    require_excitation(structure, data)
    first, second = (data.busiest(samples) for samples, _ in (_FIRST_HEAT, _SECOND_HEAT))
    points = distinct(all_starts(structure, first, data, initialisation), most_starts)
    if not points:
        raise EstimationError("no start could be made: the record says nothing about such a chain of blocks")
    evaluations = 0
    raced = _heat(structure, [one.parameters for one in points], first, _FIRST_HEAT[1])
    evaluations += sum(one.evaluations for one in raced)
    finalists = distinct([one.point for one in raced], _KEPT_OF_FIRST)
    most = _SECOND_HEAT[1] if len(second.u) < len(data.u) else max_iterations
    second_heat = _heat(structure, [one.parameters for one in finalists], second, most)
    second_heat = _with_exchanges(structure, second_heat, first, second, most)
    smooth = structure.smooth(first.u)
    if _agreeing(second_heat) == 1 and smooth is not structure:
        # Of several static blocks the starts were smooth already.
        if len(structure.free_static) > 1:
            others = (
                distinct(_nested(structure, first, data), 2) if "shorter_chains" in initialisation else []
            )
        else:
            others = _smooth_starts(structure, smooth, points, first)[:1]
        if others:
            second_heat += _heat(structure, [one.parameters for one in others], second, most)
        second_heat.sort(key=lambda one: one.point.loss)
    if "fewer_linear_blocks" in initialisation:
        second_heat += [descend(one, most) for one in _of_fewer_blocks(structure, second, most)]
        second_heat.sort(key=lambda one: one.point.loss)
    evaluations += sum(one.evaluations for one in second_heat)
    best, agreeing = second_heat[0], _agreeing(second_heat)
    iterations = best.iterations
    if states:
        last = fit_with_states(structure, best.point.parameters, everything, max_iterations)
        best = Descent(last.point, last.status, last.iterations, last.evaluations)
        evaluations, iterations = evaluations + best.evaluations, iterations + best.iterations
    elif len(second.u) < len(data.u):
        [best] = _heat(structure, [best.point.parameters], data, max_iterations)
        evaluations, iterations = evaluations + best.evaluations, iterations + best.iterations
    if ar or ma:
        # Of several optima, the noise model may prefer another one than output error does.
        is_whole = best is second_heat[0]
        others = distinct([one.point for one in second_heat], _KEPT_OF_FIRST, _SAME)[1:] if is_whole else []
        modelled = [descend(_with_noise(one, ar, ma), max_iterations) for one in (best.point, *others)]
        best = min(modelled, key=lambda one: one.point.loss)
        evaluations += sum(one.evaluations for one in modelled)
        iterations += best.iterations
    return ChainFit(best.point, best.status, iterations, evaluations, len(points), len(second_heat), agreeing)


def fit_with_states(
    structure: ChainStructure, parameters: Parameters, data: Data, max_iterations: int = 100
) -> ChainFit:
    """The fit that goes on from another one, and finds the states at the first samples of the data as well.

    Raises
    ------
    EstimationError
        If there are too many states.
    """
    parameters = _with_states(parameters, data)
    evaluations = iterations = 0
    # The first samples may reach farther than those of the search, once their states are known.
    for _ in range(2):
        [best] = _heat(structure, [parameters], data, max_iterations)
        parameters = best.point.parameters
        evaluations, iterations = evaluations + best.evaluations, iterations + best.iterations
    return ChainFit(best.point, best.status, iterations, evaluations, 1, 1, 1)


def _with_exchanges(
    structure: ChainStructure, found: list[Descent], first: Data, second: Data, most: int
) -> list[Descent]:
    """The fits, the best first, with those from other splits of the roots between two linear blocks."""
    least = np.inf
    # Each better fit knows its roots better.
    while found[0].point.loss < (1.0 - _SAME) * least:
        least = found[0].point.loss
        others = exchanged(structure, found[0].point.parameters.chain, first)[:_EXCHANGED]
        if not others:
            break
        raced = _heat(structure, [one.parameters for one in others], first, _FIRST_HEAT[1])
        more = _heat(structure, [raced[0].point.parameters], second, most)
        found = sorted((*found, *more), key=lambda one: one.point.loss)
    return found


def _agreeing(found: Sequence[Descent]) -> int:
    """How many came to the least loss."""
    least = min(one.point.loss for one in found)
    return sum(one.point.loss <= least * (1.0 + _SAME) for one in found)


def all_starts(
    structure: ChainStructure, first: Data, data: Data, initialisation: Collection[Initialisation] = DEFAULT
) -> list[Point]:
    """The starts of a chain, scored on the first heat's data; of several static blocks by shorter chains."""
    free = structure.free_static
    if len(free) > 1 and (smooth := structure.smooth(first.u)) is not structure:
        points = distinct(all_starts(smooth, first, data, initialisation), _RACED_OF_SMOOTH)
        return _smooth_starts(structure, smooth, points, first)
    found = starts(structure, data, initialisation)
    if "shorter_chains" in initialisation:
        found += _nested(structure, first, data)
    scored = [point_at(first, one.parameters) for one in found]
    return sorted((one for one in scored if one is not None), key=lambda one: one.loss)


def _of_fewer_blocks(structure: ChainStructure, data: Data, most: int) -> list[Point]:
    """Of L-N-L, the fits of L-N and N-L."""

    def fit(shorter: ChainStructure, data: Data) -> BlockChain:
        return fit_chain(shorter, data, max_iterations=most).point.parameters.chain

    return [*of_fewer_blocks(structure, data, fit)]


def _nested(structure: ChainStructure, first: Data, data: Data) -> list[Point]:
    """Of several static blocks, the fits of the chain without one of them."""
    found: list[Point] = []
    if len(structure.free_static) > 1:
        for i in structure.free_static:
            shorter = structure.without(i)
            points = distinct(all_starts(shorter, first, data), 4)
            if not points:
                continue
            for raced in _heat(shorter, [one.parameters for one in points], first, _FIRST_HEAT[1])[:2]:
                found += _lengthened(structure, i, raced.point, first)
    return found


def _smooth_starts(
    structure: ChainStructure, smooth: ChainStructure, points: Sequence[Point], first: Data
) -> list[Point]:
    """Where the chain with smooth functions comes to from these points, as starts of the chain itself."""
    raced = _heat(smooth, [one.parameters for one in points], first, _FIRST_HEAT[1])
    # Of several functions, those near one optimum count once: richer ones may prefer another one.
    within = _NEAR_ONE_OPTIMUM if len(structure.free_static) > 1 else _ONE_LOSS
    best = distinct([one.point for one in raced], _KEPT_OF_SMOOTH, within)
    fitted = _heat(smooth, [one.parameters for one in best], first, _SMOOTH_ITERATIONS)
    found = [point_at(first, structure.ranged(first, one.point.parameters)) for one in fitted]
    return sorted((one for one in found if one is not None), key=lambda one: one.loss)


def _lengthened(structure: ChainStructure, i: int, point: Point, data: Data) -> list[Point]:
    """The start of the longer chain in which block i is the identity."""
    blocks = {j + (j >= i): one for j, one in enumerate(point.parameters.chain.blocks)}
    try:
        made = point_at(data, structure.after(blocks, data))
    except ValueError:
        return []
    return [] if made is None else [made]


def distinct(points: Sequence[Point], most: int, within: float = _ONE_LOSS) -> list[Point]:
    """The best points, those of one loss, up to a part of it, once."""
    found: list[Point] = []
    for point in sorted(points, key=lambda one: one.loss):
        if len(found) < most and not any(abs(point.loss - one.loss) <= within * one.loss for one in found):
            found.append(point)
    return found


def _heat(
    structure: ChainStructure, chains: Sequence[Parameters], data: Data, iterations: int
) -> list[Descent]:
    """Where each chain comes in so many iterations, the best first."""
    begun = [point_at(data, structure.ranged(data, chain)) for chain in chains]
    found = [descend(point, iterations) for point in begun if point is not None]
    if not found:
        raise EstimationError("the output of every start is not finite on this record")
    return sorted(found, key=lambda one: one.point.loss)


def _with_states(parameters: Parameters, data: Data) -> Parameters:
    """The parameters with the states that meet the first samples of each experiment best."""
    found = [initial_states(parameters.chain, data.u[part], data.y[part]) for part in data.experiments]
    total = sum(len(state) for states in found for state in states)
    if total > _MOST_STATES:
        raise EstimationError(
            f"the linear blocks have {total} states at the first samples of {len(found)} experiments, and at "
            f"most {_MOST_STATES} can be found: leave first samples out by 'n_init' instead"
        )
    places = [i for i, one in enumerate(parameters.structures) if isinstance(one, LinearStructure)]
    return replace(parameters, states={i: tuple(one[k] for one in found) for k, i in enumerate(places)})


def _with_noise(point: Point, ar: int, ma: int) -> Point:
    """The point with a noise model by Hannan and Rissanen's two regressions (1982, Biometrika 69, 81)."""
    data = replace(point.data, start="rest")
    long = ar + (ma + 10 if ma else 0)
    rows = np.empty((long, len(point.v)))
    for j in range(long):
        data.delayed(point.v, j + 1, rows[j])
    d = least_squares(rows[:, data.counted], point.v[data.counted])
    c = np.zeros(0)
    if ma:
        e = point.v - d @ rows
        rows = np.empty((ar + ma, len(e)))
        for j in range(ar):
            data.delayed(point.v, j + 1, rows[j])
        for j in range(ma):
            data.delayed(e, j + 1, rows[ar + j])
        numbers = least_squares(rows[:, data.counted], point.v[data.counted])
        d, c = numbers[:ar], numbers[ar:]
    inside = [stabilised(TransferFunction(a=tuple(a.tolist())), _FARTHEST_OF_NOISE).a for a in (d, -c)]
    noise = NoiseModel(ar=inside[0], ma=tuple(-value for value in inside[1]))
    found = point_at(point.data, point.parameters, noise)
    if found is None:
        raise EstimationError("the noise of the output error has no model that is finite")
    return found
