"""The true values behind estimated ones, from the configuration of a run where that is still the same."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hident.config.load import read_leniently
from hident.engine.experiment import Plan, load
from hident.errors import HidentError
from hident.ledger.power import without_reports
from hident.ledger.trial_values import Key
from hident.metrics.values import Value


def truths(config: Path, resolved: Mapping[str, Any]) -> dict[Key, float]:
    """The true value of each series that is a value of an estimate, by the keys of its trials.

    None where the file is not there or is not what the run was of, where it names plugins, which would be
    run, and where the method fixes the factor between the blocks in another way than the system.
    """
    try:
        document = read_leniently(config)
        if "plugins" in document.data:
            return {}
        plan = load(document)
    except (HidentError, OSError):
        return {}
    if without_reports(plan.experiment) != without_reports(resolved):
        return {}
    return dict(_of(plan))


def _of(plan: Plan) -> Iterator[tuple[Key, float]]:
    for unit in plan.units:
        at = [str(unit.labels.get(axis.name, "")) for axis in plan.axes]
        own, system = unit.truth().values, unit.data.system.truth().values
        for name, metric in unit.metrics.items():
            if isinstance(metric, Value):
                for label, value in zip(metric.labels(name), metric.of, strict=True):
                    if value in own and own[value] == system.get(value):
                        yield (*at, unit.name, label), float(own[value])
