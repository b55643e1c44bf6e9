"""Damage to what a run has written: `compare` notices it, and the next run writes it anew."""

from __future__ import annotations

import random
import shutil

from hident.engine.run_files import TIMING
from tests.torture.victim import Tally, Victim, new_victim

COUNT = 100


def torture(tally: Tally, rng: random.Random, count: int) -> None:
    """Change ``count`` bytes, each in one of the written files."""
    with new_victim(100) as victim:
        victim.run("-q")
        shutil.copytree(victim.folder / "out", victim.folder / "results")
        victim.fits()
        for i in range(count):
            # What nothing compares is not of the results.
            names = sorted({path.name for path in (victim.folder / "out/tiny").iterdir()} - {TIMING})
            name = names[i % len(names)]
            with tally.fault(f"results: {name}", i):
                _one(victim, name, rng)


def _one(victim: Victim, name: str, rng: random.Random) -> None:
    path = victim.folder / "out/tiny" / name
    before = path.read_bytes()
    content = bytearray(before)
    content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    path.write_bytes(content)
    assert victim.hident("compare", "out", "results", code=None).returncode in (1, 2), "not noticed"
    made = victim.check_ending()
    assert made == 0, f"{made} trials were computed again"
    victim.hident("compare", "out", "results")
