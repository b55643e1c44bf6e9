"""Every kind of table and figure, where no trial gives a number."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NoReturn

import pytest

from hident import plugins
from hident.engine.experiment import load
from hident.engine.runner import run
from hident.errors import EstimationError, RecordAbsent
from hident.reports.output import Outputs

plugins.load()


def _shortest() -> dict[str, Path]:
    """For each kind of table and of figure the first configuration that has one."""
    found: dict[tuple[str, str], Path] = {}
    for path in sorted((Path(__file__).parents[2] / "configs").glob("*.yaml")):
        try:
            experiment = load(path).experiment
        except RecordAbsent:
            continue
        for sort, reports in (("table", experiment.tables), ("figure", experiment.figures)):
            for spec in reports.values():
                found.setdefault((sort, spec.kind), path)
    return {path.stem: path for path in found.values()}


PATHS = _shortest()


def _fail(*_: Any, **__: Any) -> NoReturn:
    raise EstimationError("it was to fail")


@pytest.mark.parametrize("name", PATHS)
def test_what_has_no_number_is_written_all_the_same(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = load(PATHS[name])
    plan = load(PATHS[name], [], {"trials": min(plan.trials, 2)})
    for estimator in {type(unit.estimator) for unit in plan.units}:
        for method in ("fit", "fit_many"):
            if hasattr(estimator, method):
                monkeypatch.setattr(estimator, method, _fail)
    results = run(plan)
    assert not any(len(series.valid) for series in results.series)
    Outputs(plan, tmp_path).write(results, {})
    assert "failed" in (tmp_path / "table.md").read_text(encoding="utf-8")
