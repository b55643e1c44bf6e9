"""A short version of `make torture`: a few faults of each kind. See docs/robustness.md."""

from __future__ import annotations

import random
import sys
from types import ModuleType

import pytest

from tests.torture import disk, inputs, kills, results, store, together, workers
from tests.torture.victim import Tally, Victim

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="signals, /proc and limits")
_FEW = ("os._exit(0)", "changes the working directory", "closes the streams")


@pytest.fixture
def tally():
    made = Tally()
    yield made
    assert made.counts
    assert made.sound, made.table()


# Full disks, runs at once and misdeeds have shorter tests in test_store_faults.py and its neighbours.
_LONG = [pytest.param(kind, marks=pytest.mark.long) for kind in (disk, together)]


@pytest.mark.parametrize("kind", [results, store, *_LONG], ids=lambda kind: kind.__name__)
def test_few_faults(kind: ModuleType, tally: Tally, monkeypatch: pytest.MonkeyPatch) -> None:
    # A store of 80 pages, where 2000 trials take 112.
    monkeypatch.setattr(store, "_TRIALS", 500)
    kind.torture(tally, random.Random(1), 1)


def test_few_kills(tally: Tally, monkeypatch: pytest.MonkeyPatch) -> None:
    # The other signals have tests of their own in test_interrupt.py.
    monkeypatch.setattr(kills, "_SIGNALS", [])
    # Nor do kills while the workers start, so that most of these come while they compute.
    monkeypatch.setattr(Victim, "fresh_workers", False)
    kills.torture(tally, random.Random(1), 4)


@pytest.mark.long
def test_few_misdeeds(tally: Tally, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "MISDEEDS", {name: workers.MISDEEDS[name] for name in _FEW})
    workers.torture(tally, random.Random(1), 1)


def test_bad_input(tally: Tally, monkeypatch: pytest.MonkeyPatch) -> None:
    # No time is asserted here, and few programs are started.
    monkeypatch.setattr(inputs, "bombs", lambda folder: iter(()))
    inputs.torture(tally, random.Random(1), 100, timed=False)
