"""A comparison finds one constant that is off by 0.1 %, in the code of any of the four papers."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.accepted import ROOT
from tests.arithmetics import ARITHMETICS, Arithmetic
from tests.planted_changes import CONFIGS, PLANTS, Plant, found

_PAPERS = ("mzyk", "wang", "chen", "brouri")


def test_changes_are_planted_all_over_the_four_papers() -> None:
    assert len({(plant.target, plant.old) for plant in PLANTS}) >= 20
    for paper in _PAPERS:
        assert sum(plant.config.startswith(paper) for plant in PLANTS) >= 5


@pytest.mark.parametrize("plant", PLANTS, ids=str)
def test_a_planted_change_is_found(plant: Plant) -> None:
    with plant.planted():
        assert found(plant.config) != []


def test_all_is_found_under_another_arithmetic_too() -> None:
    foreign = Arithmetic(
        "foreign", {**ARITHMETICS["nehalem"].settings, **ARITHMETICS["no-avx2"].settings}, frozenset()
    )
    if why := foreign.hindrance():
        pytest.skip(f"the other arithmetic cannot be had here: {why}")
    done = subprocess.run(
        [sys.executable, "-m", "tests.planted_changes"],
        cwd=ROOT,
        env=foreign.environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    said = [line.partition(":")[0] for line in done.stdout.splitlines()]
    assert said == ["equal"] * len(CONFIGS) + ["found"] * len(PLANTS)
