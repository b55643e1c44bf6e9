"""A comparison finds one constant that is off by 0.1 %, in the code of any of the four papers."""

from __future__ import annotations

import pytest

from tests.planted_changes import PLANTS, Plant, found, main

_PAPERS = ("mzyk", "wang", "chen", "brouri")


def test_changes_are_planted_all_over_the_four_papers() -> None:
    assert len({(plant.target, plant.old) for plant in PLANTS}) >= 20
    for paper in _PAPERS:
        assert sum(plant.config.startswith(paper) for plant in PLANTS) >= 5


@pytest.mark.parametrize("plant", PLANTS, ids=str)
def test_a_planted_change_is_found(plant: Plant) -> None:
    with plant.planted():
        assert found(plant.config) != []


def test_changes_are_found_under_another_arithmetic_too(capfd: pytest.CaptureFixture[str]) -> None:
    """Those of two configurations; CI asks for all."""
    configs = ["wang_table2", "brouri_bla"]
    code = main([*configs, "--foreign"])
    lines = capfd.readouterr().out.splitlines()
    if lines[0].startswith("the other arithmetic cannot be had here"):
        pytest.skip(lines[0])
    assert code == 0
    planted = sum(plant.config in configs for plant in PLANTS)
    assert [line.partition(":")[0] for line in lines] == ["equal"] * len(configs) + ["found"] * planted
