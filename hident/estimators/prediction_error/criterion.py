"""The prediction errors of a chain of blocks, and their derivatives by forward sensitivities.

    y = G_n(... f_2(G_1(f_1(u)))) + v,     D(q) v = C(q) e,     V(theta) = sum_k e_k^2.

A column of the Jacobian starts where its parameter acts and passes through the blocks behind it, like a
signal: through a linear block as through a filter, through a static one times f'(x). With B/F as the block, x
its input and y its output, the derivatives by its own parameters are d y/d b_i = q^-i (x/F) and
d y/d f_i = -q^-i (y/F) (Ljung, System Identification, 2nd ed., 10.3). Where the states z at the first sample
are to be found, Z(q)/F(q) with Z = z_0 + z_1 q^-1 + ... is added to y: their columns are shifted impulse
responses of 1/F.

The coefficients c of the last static block enter linearly: y = sum_k c_k G(phi_k(x)). They are solved for at
each trial of the others (Golub and Pereyra's variable projection, in Kaufman's form).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from types import MappingProxyType
from typing import Any

import numpy as np

from hident.arrays import Array
from hident.block_chain import Block, BlockChain, Start, free_response, settled_state
from hident.estimators.prediction_error.continuous_structure import ContinuousStructure
from hident.estimators.prediction_error.parameters import LinearStructure, Parameters, States, is_stable
from hident.fitted_model import NoiseModel
from hident.linear_blocks import TransferFunction
from hident.numerics.parts import Parts, in_each
from hident.static_functions import StaticFunction

# Directions along which columns of length one change the output by less (squared, relative to the largest)
# are free: a factor between two blocks, a coefficient of which the data say nothing.
FREE = 1e-13
_UNKNOWN_PAST = 200
NO_STATES: Mapping[int, States] = MappingProxyType({})


@dataclass(frozen=True, eq=False)
class Data:
    """Input and output (N,) of some experiments, and what of them counts.

    The first ``n_init`` samples of each experiment are simulated, and left out of the criterion.
    """

    u: Array
    y: Array
    experiments: Parts
    start: Start = "settled"
    n_init: int = 0

    @cached_property
    def counted(self) -> Any:
        """What selects the samples that count, along the last axis."""
        if not self.n_init:
            return slice(None)
        kept = [np.arange(part.start + self.n_init, part.stop) for part in self.experiments]
        return np.concatenate(kept)

    @cached_property
    def count(self) -> int:
        """The number of samples that count."""
        return len(self.y[self.counted])

    def first(self, samples: int) -> Data:
        """So many of the first samples, of whole experiments and of a part of the last."""
        if samples >= len(self.u):
            return self
        experiments = tuple(
            slice(part.start, min(part.stop, samples))
            for part in self.experiments
            if part.start + self.n_init < samples
        )
        stop = experiments[-1].stop
        return Data(self.u[:stop], self.y[:stop], experiments, self.start, self.n_init)

    def busiest(self, samples: int) -> Data:
        """So many samples in a row of one experiment, where the output varies most; all if there are no more.

        A record may begin with silence. What was before such samples is not known: more of them are left out.
        """
        if samples >= len(self.u):
            return self
        best, where = -1.0, slice(0, samples)
        for part in self.experiments:
            length = min(samples, part.stop - part.start)
            y = self.y[part] - np.mean(self.y[part])
            sums = np.concatenate(([0.0], np.cumsum(y))), np.concatenate(([0.0], np.cumsum(y**2)))
            first, second = ((total[length:] - total[:-length]) / length for total in sums)
            # Times the length: a shorter experiment says less.
            spread = (second - first**2) * length
            if spread.max() > best:
                place = part.start + int(np.argmax(spread))
                best, where = float(spread.max()), slice(place, place + length)
        left_out = max(self.n_init, min(_UNKNOWN_PAST, (where.stop - where.start) // 10))
        whole = (slice(0, where.stop - where.start),)
        return Data(self.u[where], self.y[where], whole, self.start, left_out)

    def filtered(self, b: Array, denominator: Array, rows: Array) -> Array:
        """The rows (..., N) through B/F, each experiment by itself, begun as ``start`` says."""
        from scipy.signal import lfilter

        at_rest = self.start == "rest" or len(denominator) == len(b) == 1
        state = None if at_rest else settled_state(b, denominator)

        def of_one(x: Array) -> Array:
            if state is None:
                return np.asarray(lfilter(b, denominator, x))
            return np.asarray(lfilter(b, denominator, x, zi=x[..., :1] * state)[0])

        return in_each(self.experiments, of_one, rows, axis=rows.ndim - 1)

    def through(self, block: Block, x: Array) -> Array:
        """What stands behind a block; a static one takes (N,), a linear one (..., N)."""
        if isinstance(block, TransferFunction):
            return self.filtered(np.asarray(block.b), block.denominator, x)
        return block(x)

    def begun(self, block: Block, x: Array, states: States) -> Array:
        """As :meth:`through` for a signal (N,), with the block's own states in addition."""
        y = self.through(block, x)
        return y + self.free(block, states) if states else y

    def free(self, block: Block, states: States) -> Array:
        """What the states of a linear block at the first samples add to its output, shape (N,)."""
        assert isinstance(block, TransferFunction)
        return np.concatenate(
            [
                free_response(block, state, part.stop - part.start)
                for state, part in zip(states, self.experiments, strict=True)
            ]
        )

    def whitened(self, noise: NoiseModel, rows: Array) -> Array:
        """The rows (..., N) through D/C, each experiment by itself."""
        if not (noise.ar or noise.ma):
            return rows
        return in_each(self.experiments, noise.innovations, rows, axis=rows.ndim - 1)

    def delayed(self, row: Array, steps: int, out: Array, factor: float = 1.0) -> None:
        """Write ``factor`` times q^-steps of a signal (N,) to ``out`` (N,)."""
        for part in self.experiments:
            piece, into = row[part], out[part]
            if steps < len(piece):
                np.multiply(piece[: len(piece) - steps], factor, out=into[steps:])
            into[:steps] = factor * piece[0] if self.start == "settled" else 0.0


@dataclass(frozen=True, eq=False)
class Point:
    """A chain and a noise model, and what they leave of the output."""

    data: Data
    parameters: Parameters
    noise: NoiseModel
    signals: tuple[Array, ...]
    projected_rows: Array
    """G(phi_k(x)) of the coefficients that are solved for, shape (K, N), not whitened."""

    @cached_property
    def v(self) -> Array:
        """The output less the simulation, shape (N,)."""
        return self.data.y - self.signals[-1]

    @cached_property
    def errors(self) -> Array:
        """The prediction errors, shape (N,)."""
        return self.data.whitened(self.noise, self.v)

    @property
    def residuals(self) -> Array:
        """The prediction errors that count."""
        return np.asarray(self.errors[self.data.counted])

    @cached_property
    def loss(self) -> float:
        """The sum of squared prediction errors."""
        return float(self.residuals @ self.residuals)

    @property
    def theta(self) -> Array:
        """What is found by steps: the chain's numbers, then d, then c."""
        return np.concatenate((self.parameters.theta, self.noise.ar, self.noise.ma))

    def rows(self) -> Array:
        """The derivatives of the prediction by theta, then by the coefficients that are solved for.

        Of shape (P + K, M) with M samples that count.
        """
        data, parameters = self.data, self.parameters
        count, solved = len(parameters.theta), len(self.projected_rows)
        orders = len(self.noise.ar) + len(self.noise.ma)
        rows = np.empty((count + orders + solved, len(data.u)))
        filled = 0
        for i, block in enumerate(parameters.chain.blocks):
            x, y = self.signals[i], self.signals[i + 1]
            if isinstance(block, TransferFunction):
                if filled:
                    rows[:filled] = data.through(block, rows[:filled])
                structure, states = parameters.structures[i], parameters.states.get(i, ())
                assert isinstance(structure, LinearStructure)
                if i not in parameters.held:
                    filled += _linear_rows(data, structure, block, x, y, states, rows[filled:])
                filled += _state_rows(data, block, states, rows[filled:])
            else:
                if filled:
                    rows[:filled] *= block.slope(x)
                if i not in parameters.held:
                    filled += _static_rows(block, x, i == parameters.projected, rows[filled:])
        if solved:
            rows[count + orders :] = self.projected_rows
        if orders:
            whitened = np.vstack((rows[:count], rows[count + orders :]))
            whitened = data.whitened(self.noise, whitened)
            rows[:count], rows[count + orders :] = whitened[:count], whitened[count:]
            _noise_rows(data, self.noise, self.v, rows[count : count + orders])
        return rows if isinstance(data.counted, slice) else rows[:, data.counted]

    @property
    def counted_output(self) -> Array:
        """The output at the samples that count."""
        return np.asarray(self.data.y[self.data.counted])

    def prediction(self, theta: Array, change: Array) -> Array | None:
        """The predictions that count, of other numbers, the solved coefficients changed by ``change`` (K,).

        None as in :meth:`moved`.
        """
        if (split := self._split(theta)) is None:
            return None
        parameters, noise = split
        if (place := parameters.projected) is not None:
            block = parameters.chain.blocks[place]
            assert isinstance(block, StaticFunction)
            coefficients = tuple((np.asarray(block.coefficients) + change).tolist())
            parameters = parameters.with_block(place, replace(block, coefficients=coefficients))
        data = self.data
        with np.errstate(all="ignore"):
            try:
                x = simulated(data, parameters.chain, parameters.states)
            except ValueError:
                return None
            found = (data.y - data.whitened(noise, data.y - x))[data.counted]
        return found if np.all(np.isfinite(found)) else None

    def moved(self, theta: Array) -> Point | None:
        """The point of other numbers; None where a block or the noise is not stable or has no such shape."""
        split = self._split(theta)
        return None if split is None else point_at(self.data, *split)

    def _split(self, theta: Array) -> tuple[Parameters, NoiseModel] | None:
        count, orders = len(self.parameters.theta), len(self.noise.ar)
        ar, ma = np.split(theta[count:], [orders])
        noise = replace(self.noise, ar=tuple(ar.tolist()), ma=tuple(ma.tolist()))
        try:
            parameters = self.parameters.moved(theta[:count])
        except ValueError:
            return None
        return (parameters, noise) if parameters.is_stable() and _is_invertible(noise) else None


def _linear_rows(
    data: Data,
    structure: LinearStructure,
    block: TransferFunction,
    x: Array,
    y: Array,
    states: States,
    out: Array,
) -> int:
    # Before the first sample the output was that of the input alone.
    free = data.free(block, states) if states else None
    driven = y if free is None else y - free
    from_input, from_output = data.filtered(np.ones(1), block.denominator, np.stack((x, driven)))
    # A continuous block has other numbers than the discrete one that it is for its samples.
    is_continuous = isinstance(structure, ContinuousStructure)
    rows = np.empty((structure.nb + structure.nf, len(x))) if is_continuous else out
    for j in range(structure.nb):
        data.delayed(from_input, structure.nk + j, rows[j])
    for j in range(structure.nf):
        data.delayed(from_output, j + 1, rows[structure.nb + j], -1.0)
    if free is not None:
        at_rest, row = replace(data, start="rest"), np.empty(len(y))
        over = at_rest.filtered(np.ones(1), block.denominator, free)
        for j in range(structure.nf):
            at_rest.delayed(over, j + 1, row, -1.0)
            rows[structure.nb + j] += row
    if isinstance(structure, ContinuousStructure):
        out[: structure.size] = structure.derivatives(block) @ rows
    return structure.size


def _state_rows(data: Data, block: TransferFunction, states: States, out: Array) -> int:
    """The derivatives of a block's output by its states: nothing outside of their own experiment."""
    count = 0
    for state, part in zip(states, data.experiments, strict=False):
        response = free_response(block, np.ones(1), part.stop - part.start)
        for j in range(len(state)):
            row = out[count]
            row[:] = 0.0
            row[part.start + j : part.stop] = response[: len(response) - j]
            count += 1
    return count


def _static_rows(block: StaticFunction, x: Array, is_projected: bool, out: Array) -> int:
    shape = len(block.basis.shape)
    if shape:
        out[:shape] = block.basis.shape_rows(np.asarray(block.coefficients), x)
    if is_projected:
        return shape
    out[shape : shape + block.basis.size] = block.basis.rows(x)
    return shape + block.basis.size


def _noise_rows(data: Data, noise: NoiseModel, v: Array, out: Array) -> None:
    """The derivatives of y - e by d and c: q^-i v/C and q^-i e/C."""
    from scipy.signal import lfilter

    e, bottom = data.whitened(noise, v), np.r_[1.0, noise.ma]
    at_rest = replace(data, start="rest")
    for order, signal, first in ((len(noise.ar), v, 0), (len(noise.ma), e, len(noise.ar))):
        if order:
            over = in_each(data.experiments, partial(lfilter, [1.0], bottom), signal)
            for j in range(order):
                at_rest.delayed(over, j + 1, out[first + j])


def simulated(data: Data, chain: BlockChain, states: Mapping[int, States] = NO_STATES) -> Array:
    """The output (N,) of a chain; ValueError if it settles nowhere and should.

    ``states`` are those of linear blocks by their places, beyond what the start of the data says.
    """
    x = data.u
    for i, block in enumerate(chain.blocks):
        x = data.begun(block, x, states.get(i, ()))
    return x


def point_at(data: Data, parameters: Parameters, noise: NoiseModel = NoiseModel()) -> Point | None:  # noqa: B008
    """The point of these parameters, with the coefficients solved for; None where it is not finite."""
    try:
        with np.errstate(all="ignore"):
            return _point_at(data, parameters, noise)
    except ValueError:
        # A pole has come so near to z = 1 that the block settles nowhere.
        return None


def _is_invertible(noise: NoiseModel) -> bool:
    # 1/D must be stable for the noise to have a variance, 1/C for its innovations.
    return all(
        is_stable(np.r_[1.0, polynomial])
        for polynomial in (-np.asarray(noise.ar), np.asarray(noise.ma))
        if len(polynomial)
    )


def _point_at(data: Data, parameters: Parameters, noise: NoiseModel) -> Point | None:
    chain, place, states = parameters.chain, parameters.projected, parameters.states
    signals, rows = [data.u], np.zeros((0, len(data.u)))
    for i, block in enumerate(chain.blocks):
        if i == place:
            assert isinstance(block, StaticFunction)
            rows, free = block.basis.rows(signals[-1]), np.zeros(len(data.u)) if states else None
            for j, follower in enumerate(chain.blocks[i + 1 :], start=i + 1):
                rows = data.through(follower, rows)
                if free is not None:
                    free = data.begun(follower, free, states.get(j, ()))
            if not np.all(np.isfinite(rows)):
                return None
            y = data.y if free is None else data.y - free
            coefficients = solved(data.whitened(noise, rows), data.whitened(noise, y), data)
            block = replace(block, coefficients=tuple(coefficients.tolist()))  # noqa: PLW2901
            parameters = parameters.with_block(i, block)
        signals.append(data.begun(block, signals[-1], states.get(i, ())))
    point = Point(data, parameters, noise, tuple(signals), rows)
    return point if np.isfinite(point.loss) else None


def solved(rows: Array, y: Array, data: Data) -> Array:
    """The coefficients (K,) of the least-squares fit of rows (K, N) to y (N,), over the samples that count.

    Of what the data do not determine, the least coefficients of rows of length one.
    """
    if not isinstance(data.counted, slice):
        rows, y = rows[:, data.counted], y[data.counted]
    return least_squares(rows, y, FREE)


def least_squares(rows: Array, y: Array, free: float = 1e-14) -> Array:
    """The numbers (P,) whose sum of rows (P, N) is nearest to y (N,); the least ones if several are.

    ``free`` is what a squared singular value of rows of length one is nothing below, beside the largest.
    """
    normal, right = rows @ rows.T, rows @ y
    lengths = np.sqrt(np.diag(normal))
    lengths[lengths == 0.0] = 1.0
    values, vectors = np.linalg.eigh(normal / np.outer(lengths, lengths))
    known = values > free * values[-1]
    vectors = vectors[:, known]
    return np.asarray((vectors @ ((vectors.T @ (right / lengths)) / values[known])) / lengths)
