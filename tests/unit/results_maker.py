"""Results made by hand, for the tests of tables, figures and verdicts."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from hident import plugins
from hident.engine.experiment import load
from hident.engine.results import Results, Series

CONFIG = """\
version: 1
title: A table
paper: someone2001
trials: {trials}
system: {{kind: hammerstein, nonlinearity: identity, linear: {{kind: ar, a: [0.5]}}}}
excitation: {{kind: iid, distribution: uniform, low: -1, high: 1}}
cases:
  samples: [10, 100, 1000]
{axes}
estimators:
  one: {{kind: kernel, kernel: window_unit, bandwidth: {{h0: 1, alpha: 1/5}}}}
  two: {{kind: kernel, kernel: gaussian, bandwidth: {{h0: 1, alpha: 1/5}}}}
{estimators}
metrics:
  mise: {{kind: mise, interval: [-1, 1], estimators: [one, two]}}
{rest}
"""
PUBLISHED = """\
published:
  paper_trials: {runs}
  cells:
    - table: T
      row: "N={{samples}}"
      quantity: error
      estimator: one
      metric: mise
      statistic: {statistic}
"""


def made(
    folder: Path,
    values: Mapping[tuple[str, str], ArrayLike],
    *,
    rest: str = "",
    axes: str = "",
    estimators: str = "",
    printed: str = "",
    reasons: str = "",
) -> Results:
    """Results with the given trials for (estimator, samples), and ones for all others."""
    plugins.load()
    (folder / "configs").mkdir(exist_ok=True)
    paper = folder / "experiments" / "someone2001"
    paper.mkdir(parents=True, exist_ok=True)
    (paper / "published.csv").write_text("table,row,quantity,printed,note\n" + printed)
    (paper / "reasons.yaml").write_text(reasons or "reasons: []\n")
    trials = np.size(next(iter(values.values()), [1.0, 1.0]))
    path = folder / "configs" / "some.yaml"
    path.write_text(CONFIG.format(trials=trials, rest=rest, axes=axes, estimators=estimators))
    plan = load(path)
    series = [
        Series(
            unit,
            label,
            np.array(values.get((unit.name, str(unit.labels["samples"])), np.ones(trials)), dtype=float),
        )
        for unit in plan.units
        for label in unit.metric_labels
    ]
    return Results(plan, tuple(series))
