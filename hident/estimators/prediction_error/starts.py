"""Where the search for a chain of blocks starts: what linear least squares can say about it.

- The best linear approximation, its poles and zeros split between the linear blocks in all ways (Schoukens,
  Pintelon, Rolain 2014, Automatica 50, 628), for any chain; the static block that is last is solved for.
- For a static block before one linear block, the over-parameterised model F y = sum_k B_k phi_k(u), and the
  leading singular pair of its coefficients (Bai 1998, Automatica 34, 333), by Steiglitz and McBride's
  iteration.
- For a static block behind the first linear block, the leading eigenvector of the second-order Volterra
  kernel, which an even function has where the best linear approximation is nothing.
- For several static blocks, the fits of the chain without one of them.
- For a static block between two linear ones, the fits of the chain without one of these: see
  :mod:`hident.estimators.prediction_error.fewer_blocks`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Literal, get_args

import numpy as np

from hident.arrays import Array, Complex
from hident.block_chain import BlockChain
from hident.estimators.prediction_error.allocations import block, fits, parted, splits
from hident.estimators.prediction_error.criterion import Data, Point, least_squares, point_at
from hident.estimators.prediction_error.descent import norm
from hident.estimators.prediction_error.linear_start import demeaned, stabilised, steiglitz_mcbride
from hident.estimators.prediction_error.parameters import LinearStructure
from hident.estimators.prediction_error.structure import ChainStructure
from hident.linear_blocks import TransferFunction

# The linear approximation is made of so many samples, splits are scored on so many.
_APPROXIMATED, _SCORED = 20000, 4000
# A longer approximation has more splits than can be tried.
_MOST_ROOTS = 6
# Between two blocks, all splits of six roots; between more, some of them.
_MOST_SPLITS, _MOST_OF_MANY = 64, 16
# Of so many roots, all splits are tried again with those of a fit.
_FEW_ROOTS = 4
_KERNEL_LAGS, _KERNEL_SAMPLES = 20, 10000


Initialisation = Literal[
    "linear_approximation", "over_parameterised", "volterra_kernel", "shorter_chains", "fewer_linear_blocks"
]
"""One of the methods above."""
ALL: tuple[Initialisation, ...] = get_args(Initialisation)
DEFAULT: tuple[Initialisation, ...] = ALL[:-1]
"""All but the last, which takes as long as the others together, and longer."""


def starts(
    structure: ChainStructure, data: Data, initialisation: Collection[Initialisation] = DEFAULT
) -> list[Point]:
    """The starts of a chain with at most one static block to be found, the best first."""
    few = data.first(_SCORED)
    found: list[Point] = []
    if "linear_approximation" in initialisation:
        found += _splits_of_approximation(structure, data, few)
    if "over_parameterised" in initialisation:
        found += _overparameterised(structure, data, few)
    if "volterra_kernel" in initialisation:
        found += _of_the_kernel(structure, data, few)
    found.sort(key=lambda point: point.loss)
    return _spread_out(structure, found[0], few) if found and len(structure.spreads()) > 1 else found


def scored(
    structure: ChainStructure,
    linear: Mapping[int, TransferFunction],
    few: Data,
    spreads: Sequence[float] | None = None,
) -> Point | None:
    """The point of these linear blocks, with the static ones as they come; None if it is not finite.

    Of several spreads before a static block, by default all that it tries, it is the best one's.
    """
    if not all(one.is_stable() for one in linear.values() if one.a):
        return None
    best: Point | None = None
    for spread in structure.spreads() if spreads is None else spreads:
        try:
            point = point_at(few, structure.made(few, linear, {}, spread))
        except ValueError:
            continue
        if point is not None and (best is None or point.loss < best.loss):
            best = point
    return best


def _spread_out(structure: ChainStructure, best: Point, few: Data) -> list[Point]:
    """The start with each spread of the signal before a static block: the loss does not tell its sign yet."""
    blocks = best.parameters.chain.blocks
    linear = {i: one for i in structure.linear if isinstance(one := blocks[i], TransferFunction)}
    points = [scored(structure, linear, few, (spread,)) for spread in structure.spreads()]
    return sorted((point for point in points if point is not None), key=lambda point: point.loss)


def _splits_of_approximation(structure: ChainStructure, data: Data, few: Data) -> Iterator[Point]:
    """For each split of the poles, the best split of the zeros."""
    wanted = structure.linear
    if not wanted:
        if (point := scored(structure, {}, few)) is not None:
            yield point
        return
    sizes = [(one.nb, one.nf) for one in wanted.values()]
    delays = [one.nk for one in wanted.values()]
    poles_wanted, zeros_wanted = sum(nf for _, nf in sizes), sum(nb - 1 for nb, _ in sizes)
    if len(wanted) > 1:
        poles_wanted, zeros_wanted = min(poles_wanted, _MOST_ROOTS), min(zeros_wanted, _MOST_ROOTS)
    whole = demeaned(data.first(_APPROXIMATED))
    models = steiglitz_mcbride(whole, zeros_wanted + 1, poles_wanted, sum(delays))
    if not models:
        return
    best = min(models, key=lambda model: linear_loss(whole, model))
    # Splitting costs the product of both: the last model alone where there is more than one block.
    tried = models if len(wanted) == 1 else [best]
    for model in tried:
        yield from _best_splits(structure, model, sizes, delays, few)


def _best_splits(
    structure: ChainStructure,
    model: TransferFunction,
    sizes: Sequence[tuple[int, int]],
    delays: Sequence[int],
    few: Data,
) -> Iterator[Point]:
    places = list(structure.linear)
    most = _MOST_SPLITS if len(places) < 3 else _MOST_OF_MANY
    own_poles, own_zeros = model.poles(), _zeros(model, sum(delays))
    zero_splits, pole_splits = (
        splits(own_zeros, len(places), most),
        splits(own_poles, len(places), _MOST_SPLITS),
    )
    if not any(fits(zeros, poles, sizes) for zeros in zero_splits for poles in pole_splits):
        zero_splits = splits(parted(own_zeros), len(places), most)
        pole_splits = splits(parted(own_poles), len(places), _MOST_SPLITS)
    for poles in pole_splits:
        best: Point | None = None
        for zeros in zero_splits:
            if not fits(zeros, poles, sizes):
                continue
            linear = {
                i: block(z, p, delay) for i, z, p, delay in zip(places, zeros, poles, delays, strict=True)
            }
            point = scored(structure, linear, few)
            if point is not None and (best is None or point.loss < best.loss):
                best = point
        if best is not None:
            yield best


def exchanged(structure: ChainStructure, found: BlockChain, data: Data) -> list[Point]:
    """Other splits of the poles and zeros that a fit has found between its linear blocks, the best first.

    A linear approximation knows its roots from what the nonlinearity distorts; a fit that put one into the
    wrong block knows all of them better. Only of so few that all splits can be tried.
    """
    wanted = structure.linear
    if len(wanted) != 2:
        return []
    delays = [one.nk for one in wanted.values()]
    of_blocks = [one for i in wanted if isinstance(one := found.blocks[i], TransferFunction)]
    zeros = np.concatenate([_zeros(one, delay) for one, delay in zip(of_blocks, delays, strict=True)])
    poles = np.concatenate([one.poles() for one in of_blocks])
    if max(len(zeros), len(poles)) > _FEW_ROOTS:
        return []
    sizes = [(one.nb, one.nf) for one in wanted.values()]
    points: list[Point] = []
    for p, z in product(splits(poles, 2, _MOST_SPLITS), splits(zeros, 2, _MOST_SPLITS)):
        if fits(z, p, sizes):
            roots = zip(wanted, z, p, delays, strict=True)
            linear = {i: block(own_zeros, own_poles, delay) for i, own_zeros, own_poles, delay in roots}
            if (point := scored(structure, linear, data)) is not None:
                points.append(point)
    return sorted(points, key=lambda point: point.loss)


def _zeros(model: TransferFunction, delay: int) -> Complex:
    b = np.asarray(model.b[delay:])
    # A first coefficient of nothing is a zero at infinity.
    largest = float(np.max(np.abs(b), initial=0.0))
    b = np.where(np.abs(b) < 1e-3 * largest, np.sign(b + (b == 0.0)) * 1e-3 * largest, b)
    return np.roots(b).astype(np.complex128)


def linear_loss(data: Data, model: TransferFunction) -> float:
    """What a linear model leaves of demeaned data, a constant apart."""
    return float(np.var((data.y - data.through(model, data.u))[data.counted]))


def _overparameterised(structure: ChainStructure, data: Data, few: Data) -> Iterator[Point]:
    if len(structure.blocks) != 2 or structure.given:
        return
    kind, orders = structure.blocks
    if isinstance(kind, LinearStructure) or not isinstance(orders, LinearStructure):
        return
    data = data.first(_APPROXIMATED)
    low, high = float(np.min(data.u)), float(np.max(data.u))
    if not high > low:
        return
    basis = kind.basis_for(data.u, low, high)
    phi = basis.rows(data.u)
    # The constant is a column of its own: functions that sum to one would repeat it.
    phi = phi - phi.mean(axis=1, keepdims=True)
    keep = [k for k in range(len(phi)) if norm(phi[k]) > 0.0]
    phi = phi[keep]
    f = np.zeros(orders.nf)
    for _ in range(8):
        denominator = np.r_[1.0, f]
        inputs, y = (data.filtered(np.ones(1), denominator, signal) for signal in (phi, data.y))
        rows = np.empty((len(phi) * orders.nb + orders.nf + 1, len(data.u)))
        for k, j in product(range(len(phi)), range(orders.nb)):
            data.delayed(inputs[k], orders.nk + j, rows[k * orders.nb + j])
        for j in range(orders.nf):
            data.delayed(y, j + 1, rows[len(phi) * orders.nb + j], -1.0)
        rows[-1] = 1.0
        numbers = least_squares(rows[:, data.counted], y[data.counted])
        products = numbers[: len(phi) * orders.nb].reshape(len(phi), orders.nb)
        f = (
            -np.asarray(
                stabilised(TransferFunction(a=tuple((-numbers[len(phi) * orders.nb : -1]).tolist()))).a
            )
            if orders.nf
            else f
        )
        b = np.linalg.svd(products)[2][0]
        linear = TransferFunction((*(0.0,) * orders.nk, *b.tolist()), tuple((-f).tolist()))
        if (point := scored(structure, {1: linear}, few)) is not None:
            yield point


def _of_the_kernel(structure: ChainStructure, data: Data, few: Data) -> Iterator[Point]:
    """Starts for an even function behind the first linear block."""
    wanted = structure.linear
    if not structure.static or not wanted:
        return
    first, last = min(wanted), max(wanted)
    if first > structure.static[0] or len(structure.static) > 1 or len(wanted) > 2:
        return
    orders = wanted[first]
    data = demeaned(data.first(_KERNEL_SAMPLES))
    for h in _kernel_vectors(data, orders):
        for model in _rational(h, orders):
            if last == first:
                linear = {first: model}
            else:
                x = data.through(model, data.u)
                squared = replace(data, u=x**2 - np.mean(x**2))
                behind = wanted[last]
                models = steiglitz_mcbride(squared, behind.nb, behind.nf, behind.nk)
                nearest = min(models, key=lambda one: linear_loss(squared, one))
                # Its gain has the unit of the output over the square of the input's.
                b = np.asarray(nearest.b) / (norm(np.asarray(nearest.b)) or 1.0)
                linear = {first: model, last: replace(nearest, b=tuple(b.tolist()))}
            if (point := scored(structure, linear, few)) is not None:
                yield point


def _kernel_vectors(data: Data, orders: LinearStructure) -> list[Array]:
    """Leading eigenvectors of the second-order kernel, over the first lags from the delay on."""
    lags = min(_KERNEL_LAGS, max(len(data.u) // 40, 2))
    past = np.empty((lags, len(data.u)))
    for j in range(lags):
        data.delayed(data.u, orders.nk + j, past[j])
    pairs = [(i, j) for i in range(lags) for j in range(i, lags)]
    if len(pairs) > len(data.u) // 4:
        return []
    rows = np.empty((len(pairs) + lags + 1, len(data.u)))
    for k, (i, j) in enumerate(pairs):
        np.multiply(past[i], past[j], out=rows[k])
    rows[len(pairs) : -1] = past
    rows[-1] = 1.0
    numbers = least_squares(rows[:, data.counted], data.y[data.counted])
    kernel = np.zeros((lags, lags))
    for (i, j), value in zip(pairs, numbers, strict=False):
        kernel[i, j] += value / 2.0
        kernel[j, i] += value / 2.0
    values, vectors = np.linalg.eigh(kernel)
    return [vectors[:, np.argmax(np.abs(values))]]


def _rational(h: Array, orders: LinearStructure) -> Iterator[TransferFunction]:
    """Models whose impulse response from the delay on is near h (n,)."""
    impulse = np.zeros(len(h))
    impulse[0] = 1.0
    data = Data(impulse, h, (slice(0, len(h)),), "rest")
    models = steiglitz_mcbride(data, orders.nb, min(orders.nf, len(h) // 3), 0, constant=False)
    if models:
        best = min(models, key=lambda model: norm(h - data.through(model, impulse)))
        yield replace(best, b=((0.0,) * orders.nk + best.b))
