"""Records with a block of each experiment held out, for scoring what was fitted to the rest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hident.arrays import Flags
from hident.numerics.parts import Parts
from hident.records import Held, Part, Record


@dataclass(frozen=True, eq=False)
class Fold:
    """What is fitted, ``training``, and which samples (N,) of the record are ``held_out``."""

    training: Record
    held_out: Flags


def in_blocks(record: Record, folds: int, gap: int) -> list[Fold]:
    """One fold for each of ``folds`` blocks in time, which each experiment is cut into.

    ``gap`` samples on both sides of a block are left out of the training too. Blocks without a sample, of
    experiments that are shorter, make no fold.
    """
    found = []
    for k in range(folds):
        blocks = [
            slice(
                part.start + k * (part.stop - part.start) // folds,
                part.start + (k + 1) * (part.stop - part.start) // folds,
            )
            for part in record.experiments
        ]
        if any(block.stop > block.start for block in blocks):
            found.append(_without(record, blocks, gap))
    return found


def at_the_end(record: Record, share: float, gap: int) -> Fold:
    """The fold of the last part of each experiment, a ``share`` of it and at least one sample."""
    lengths = [part.stop - part.start for part in record.experiments]
    kept = [min(int(np.rint((1.0 - share) * length)), length - 1) for length in lengths]
    parts = record.experiments
    return _without(record, [slice(p.start + k, p.stop) for p, k in zip(parts, kept, strict=True)], gap)


def _without(record: Record, blocks: Parts, gap: int) -> Fold:
    held_out = np.zeros(len(record), dtype=bool)
    pieces: list[tuple[int, slice]] = []
    for i, (part, block) in enumerate(zip(record.experiments, blocks, strict=True)):
        held_out[block] = True
        if block.start == block.stop:
            pieces.append((i, part))
            continue
        before, after = slice(part.start, block.start - gap), slice(block.stop + gap, part.stop)
        pieces += [(i, piece) for piece in (before, after) if piece.stop > piece.start]
    return Fold(_of_pieces(record, pieces), held_out)


def _of_pieces(record: Record, pieces: Sequence[tuple[int, slice]]) -> Record:
    """The pieces of a record, each with the place of its experiment, as experiments of their own."""
    where = np.concatenate([np.zeros(0, dtype=int), *(np.arange(p.start, p.stop) for _, p in pieces)])
    u, y = record.u[where], record.y[where]
    parts = dict(_parts(record, pieces)) if len(pieces) > 1 or record.parts else {}
    return replace(record, u=u, y=y, parts=parts, validation=None)


def _parts(record: Record, pieces: Sequence[tuple[int, slice]]) -> Iterator[tuple[str, Part]]:
    named = list(record.parts.items())
    start = 0
    for number, (i, piece) in enumerate(pieces, start=1):
        name, dt = (named[i][0], named[i][1].dt) if named else ("", 1.0 if record.dt is None else record.dt)
        stop = start + piece.stop - piece.start
        # What is fitted here works on samples: between them the input counts as held.
        applied = Held(np.arange(float(stop - start)) * dt, record.u[piece])
        yield f"{name} {number}".strip(), Part(start, stop, dt, applied)
        start = stop
