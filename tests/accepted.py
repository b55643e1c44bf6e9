"""The accepted trials of results/: as the results of a run, and beside trials that the code gives now."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from hident import arithmetic, plugins
from hident.arrays import Array
from hident.engine.experiment import Plan, load
from hident.engine.fingerprint import libraries
from hident.engine.results import Results, Series
from hident.engine.run_files import SENSITIVITY, TRIALS
from hident.engine.runner import run
from hident.ledger.compare import CHANCE
from hident.ledger.sensitivity import RTOL, Sensitivity
from hident.ledger.trial_comparison import TrialComparison
from hident.ledger.trial_values import TrialValues
from hident.ledger.verdicts import Verdict, judge
from hident.run_folder import RunFolder, arithmetic_of

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results"


def accepted_results(config: str) -> Results:
    """The accepted trials of a configuration as its run gave them, but for the reasons of failures."""
    accepted = _values(RESULTS / config)
    plan = _plan(config).changed(trials=accepted.trials)
    named = [(unit, label) for unit in plan.units for label in unit.metric_labels]

    def results(values: Iterable[Array]) -> Results:
        series = (Series(*name, of_one) for name, of_one in zip(named, values, strict=True))
        return Results(plan, tuple(series))

    keys = TrialValues.of(results(itertools.repeat(np.empty(0), len(named)))).series
    return results(accepted.series[key] for key in keys)


@functools.cache
def accepted_verdicts(config: str) -> tuple[Verdict, ...]:
    """The verdicts on the accepted trials, with the published numbers and the reasons as they are now."""
    return judge(accepted_results(config))


def differences(config: str, trials: int, results: Path = RESULTS) -> list[str]:
    """What a few trials of a configuration, run now, differ in beyond what is allowed, a text each.

    They are compared with the accepted ones trial by trial, as ``hident compare --partial`` does.
    """
    plan, accepted = _plan(config), results / config
    ours = TrialValues.of(run(plan.changed(trials=min(trials, plan.trials))))
    sensitivity = Sensitivity.decoded((accepted / SENSITIVITY).read_bytes())
    compared = TrialComparison(
        ours, _values(accepted), RTOL, None if _same_arithmetic(accepted) else sensitivity
    )
    moved = compared.moved(CHANCE / max(len(compared.units), 1))
    return [*compared.unmatched(), *(unit.said for unit in moved if not unit.allowed)]


def _plan(config: str) -> Plan:
    plugins.load()
    return load(ROOT / "configs" / f"{config}.yaml")


@functools.cache
def _values(accepted: Path) -> TrialValues:
    return TrialValues.decoded((accepted / TRIALS).read_bytes())


def _same_arithmetic(accepted: Path) -> bool:
    ours = {"arithmetic": {"identity": arithmetic.identity()}, "libraries": {**libraries()}}
    del ours["libraries"]["arithmetic"]
    return bool(arithmetic_of(ours) == RunFolder(accepted).arithmetic())
