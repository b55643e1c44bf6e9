"""Run it with `python -m pytest starter`."""

from pathlib import Path

import pytest

import hident as hi
from hident.testing import Check, checks, plugin

HERE = Path(__file__).parent
method, score = plugin(HERE / "starter.py"), plugin(HERE / "starter_error.py")
CHECKS = [
    *checks(method.Starter()),
    *checks(method.Starter(degree=2)),
    *checks(score.StarterError(interval=[-0.9, 0.9])),
]


@pytest.mark.parametrize("check", CHECKS, ids=str)
def test_what_every_component_owes(check: Check) -> None:
    check()


def test_without_noise_it_finds_the_system() -> None:
    system = hi.Hammerstein(nonlinearity=hi.Polynomial(coefficients=[0, 1, 0.5, 0.25]), linear=hi.Ar(a=[0.5]))
    record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 100)
    found = hi.fit(method.Starter(), record)
    assert list(found.values.values()) == pytest.approx([0.5, 1, 0.5, 0.25], rel=1e-10)


def test_the_configuration_runs() -> None:
    results = hi.run(HERE / "starter.yaml", trials=2)
    assert results.frame()["failed"].sum() == 0
