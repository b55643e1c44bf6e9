"""What of a record is fitted, and what is kept apart to choose by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hident.arrays import Array
from hident.block_chain import Beginning, BlockChain, Start
from hident.estimators.base import unknown_past
from hident.estimators.prediction_error.criterion import NO_STATES, Data, simulated
from hident.estimators.prediction_error.parameters import States
from hident.initial_states import initial_states
from hident.linear_blocks import TransferFunction
from hident.numerics.parts import Parts, following, joined
from hident.records import Record

# The share of each experiment that is kept apart where nothing else is.
_KEPT_APART = 0.2
# First samples that are not fitted: at most this many, and this share of an experiment.
_MOST_INITIAL, _INITIAL_SHARE = 250, 20
# Blocks of so many samples whose variance is below this part of the mean one are at rest.
_BLOCK, _AT_REST, _SEVERAL = 50, 0.01, 10


@dataclass(frozen=True, eq=False)
class Split:
    """What is fitted, and what is kept apart: the samples ``kept`` of ``validation``, ``said`` in words.

    ``fitted`` are the samples of ``everything`` that count in ``estimation``.
    """

    estimation: Data
    everything: Data
    validation: Data
    fitted: Any
    kept: Any
    kept_experiments: Parts
    said: str
    finds_states: bool = False
    """Whether a simulation begins with the states that the first samples of the output tell."""

    def simulated(self, model: BlockChain) -> Array:
        """The output of a chain at the samples kept apart."""
        return np.asarray(self._simulated(self.validation, model)[self.kept])

    def _simulated(self, data: Data, model: BlockChain) -> Array:
        return simulated(data, model, self._states(data, model) if self.finds_states else NO_STATES)

    def _states(self, data: Data, model: BlockChain) -> dict[int, States]:
        """The states of each linear block at the first sample of each experiment, by its place.

        What is kept apart at the end of an experiment tells nothing of its beginning.
        """
        ends = self.estimation.experiments if data is self.everything else data.experiments
        found = []
        for whole, told in zip(data.experiments, ends, strict=True):
            part = slice(whole.start, whole.start + told.stop - told.start)
            found.append(initial_states(model, data.u[part], data.y[part]))
        places = [i for i, block in enumerate(model.blocks) if isinstance(block, TransferFunction)]
        return {place: tuple(one[k] for one in found) for k, place in enumerate(places)}

    def errors(self, model: BlockChain) -> tuple[Array, Array]:
        """What the simulation by a chain leaves of the samples that are fitted, and of those kept apart."""
        whole = self.everything.y - self._simulated(self.everything, model)
        if self.validation is self.everything:
            return np.asarray(whole[self.fitted]), np.asarray(whole[self.kept])
        return np.asarray(whole[self.fitted]), self.output - self.simulated(model)

    @property
    def output(self) -> Array:
        """The measured output at the samples kept apart."""
        return np.asarray(self.validation.y[self.kept])

    @property
    def input(self) -> Array:
        """The input at the samples kept apart."""
        return np.asarray(self.validation.u[self.kept])


def split(record: Record, n_init: int | None, beginning: Beginning = "settled") -> Split:
    """The validation record if there is one, else the last fifth of each experiment."""
    shortest = min(part.stop - part.start for part in record.experiments)
    initial = min(_MOST_INITIAL, shortest // _INITIAL_SHARE) if n_init is None else n_init
    finds_states = beginning == "estimated"
    start: Start = "rest" if beginning == "rest" else "settled"
    if finds_states:
        # Where the states are not known yet, these samples are not to mislead the search.
        initial = max(initial, unknown_past(shortest))
    is_quiet = len(record.experiments) == 1 and not finds_states
    quiet = quiet_beginning(record, 2 * initial) if is_quiet else 0
    u, y = record.u[quiet:], record.y[quiet:]
    experiments = (slice(0, len(u)),) if quiet else record.experiments
    everything = Data(u, y, experiments, start, initial)
    if record.validation is not None:
        other = record.validation
        kept = Data(other.u, other.y, other.experiments, start, initial)
        return Split(
            everything,
            everything,
            kept,
            everything.counted,
            kept.counted,
            following(kept.experiments, initial),
            f"the record for validation, {kept.count} samples",
            finds_states,
        )
    cuts = [part.start + round((part.stop - part.start) * (1.0 - _KEPT_APART)) for part in record.experiments]
    cuts = [cut - quiet for cut in cuts]
    firsts = [slice(part.start, cut) for part, cut in zip(experiments, cuts, strict=True)]
    lasts = [np.arange(cut, part.stop) for part, cut in zip(experiments, cuts, strict=True)]
    u, y = (np.concatenate([signal[first] for first in firsts]) for signal in (u, y))
    several = " of each experiment" if len(firsts) > 1 else ""
    tails = np.concatenate(lasts)
    heads = np.concatenate([np.arange(first.start + initial, first.stop) for first in firsts])
    return Split(
        Data(u, y, joined(first.stop - first.start for first in firsts), start, initial),
        everything,
        everything,
        heads,
        tails,
        joined(map(len, lasts)),
        f"the last fifth{several}, {len(tails)} samples",
        finds_states,
    )


def quiet_beginning(record: Record, kept: int) -> int:
    """How many first samples say nothing, as input and output are at rest; ``kept`` of the rest stay.

    A rest has its own noise and its own drift, which a fit would take for the system's.
    """
    blocks = len(record) // _BLOCK
    if blocks < _SEVERAL:
        return 0
    spreads = [
        np.var(signal[: blocks * _BLOCK].reshape(blocks, _BLOCK), axis=1) for signal in (record.u, record.y)
    ]
    moves = np.any([spread > _AT_REST * np.mean(spread) for spread in spreads], axis=0)
    # A block that moves by itself, as a record's first may, is no beginning.
    mostly = np.convolve(moves, np.full(_SEVERAL, 1.0 / _SEVERAL), "valid") >= 0.5
    return max(int(np.argmax(mostly)) * _BLOCK - kept, 0)
