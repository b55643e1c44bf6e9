"""Scores as bytes that can be told from anything else: how the trials store keeps them.

A block begins with a mark and holds its own key, its length and a checksum, so that it can be found and
trusted wherever it stands in a damaged file.
"""

from __future__ import annotations

import json
import mmap
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hident.arrays import Array
from hident.engine.scores import Scores

# The mark, the checksum of all that follows, the length of the whole; then the lengths of the key and of the
# reasons, the first trial, how many trials and values of each. The key, the reasons and the values follow:
# four bytes for each value where that is enough for all to come back to the last bit, else eight.
_MARK = b"\x93hident\x03"
_BEGIN = struct.Struct("<8sII")
_SIZES = struct.Struct("<IIqII")
LARGEST = 16_000
"""The bytes of a block, if it holds more than one trial."""


@dataclass(frozen=True, eq=False)
class Block:
    """Scores of consecutive trials of a key."""

    key: str
    scores: Scores

    @property
    def place(self) -> tuple[str, int, int, int]:
        """The key, the first trial, how many they are and how many of them failed."""
        trials = self.scores.trials
        return self.key, int(trials[0]), len(trials), len(self.scores.failures)

    def encoded(self) -> bytes:
        """The bytes of the block."""
        scores, first = self.scores, int(self.scores.trials[0])
        reasons: dict[str, list[int]] = {}
        for trial, reason in scores.failures.items():
            reasons.setdefault(reason, []).append(trial - first)
        key = self.key.encode()
        text = json.dumps(reasons, ensure_ascii=False).encode() if reasons else b""
        rest = _SIZES.pack(len(key), len(text), first, *scores.values.shape)
        rest += key + text + _shortest(scores.values).tobytes()
        return _BEGIN.pack(_MARK, zlib.crc32(rest), _BEGIN.size + len(rest)) + rest

    @classmethod
    def decoded(cls, data: Any, start: int = 0) -> Block | None:
        """The block that begins there; None if there is none, or a damaged one."""
        try:
            mark, checksum, size = _BEGIN.unpack_from(data, start)
            rest = data[start + _BEGIN.size : start + size]
            if mark != _MARK or size > len(data) - start or zlib.crc32(rest) != checksum:
                return None
            key_size, text_size, first, count, labels = _SIZES.unpack_from(rest)
        except (struct.error, TypeError):
            return None
        key, text = _SIZES.size + key_size, _SIZES.size + key_size + text_size
        kind = "<f4" if len(rest) - text == 4 * count * labels else "<f8"
        values = np.frombuffer(rest, dtype=kind, offset=text).reshape(count, labels).astype(float)
        reasons = json.loads(rest[key:text]) if text_size else {}
        failures = {first + offset: reason for reason, of in reasons.items() for offset in of}
        scores = Scores(np.arange(first, first + count), values, failures)
        return cls(rest[_SIZES.size : key].decode(), scores)


def _shortest(values: Array) -> Array:
    # Of most, the first trial says already that four bytes are too few.
    for some in (values[:1], values):
        with np.errstate(over="ignore"):
            short = some.astype("<f4")
        if not np.array_equal(short, some, equal_nan=True):
            return values.astype("<f8")
    return short


def blocks_of(key: str, scores: Scores) -> Iterator[tuple[Block, bytes]]:
    """The scores as blocks that are small enough, with their bytes."""
    for run in scores.runs():
        block = Block(key, run)
        data, count = block.encoded(), len(run.trials)
        if len(data) <= LARGEST or count == 1:
            yield block, data
        else:
            parts = -(-len(data) // LARGEST)
            size = max(1, count // parts)
            for i in range(0, count, size):
                yield from blocks_of(key, run.of(slice(i, i + size)))


def blocks_in(path: Path) -> Iterator[Block]:
    """Every undamaged block in a file, wherever it stands; of one that stands twice, both."""
    if not path.exists() or not path.stat().st_size:
        return
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        for found in re.finditer(re.escape(_MARK), content):
            if block := Block.decoded(content, found.start()):
                yield block
