"""The configurations mean what they meant before there were variables and repeated entries.

What changes the meaning of a configuration changes its first writing under tests/data/version_1 with it.
"""

from pathlib import Path

import pandas as pd
import pytest

from hident import plugins
from hident.config.spec import canonical
from hident.engine.experiment import load

ROOT = Path(__file__).parents[2]
LEFT = ("cases", "estimators", "metrics", "published", "alternatives")
FIRST = sorted((ROOT / "tests" / "data" / "version_1").glob("*.yaml"))


def meaning(path):
    """Everything that a configuration gives: its units, and what is shown and judged of them."""
    plan = load(path)
    units = [
        {
            "labels": {axis: str(label) for axis, label in unit.labels.items()},
            "name": unit.name,
            "data": canonical(unit.data),
            "key": unit.data.key,
            "estimator": canonical(unit.estimator),
            "metrics": {name: canonical(metric) for name, metric in unit.metrics.items()},
        }
        for unit in plan.units
    ]
    whole = canonical(plan.experiment)
    shown = {key: item for key, item in whole.items() if key not in LEFT}
    published = plan.experiment.published
    cells = [
        (cell.table, cell.row, *pair, cell.estimator, cell.statistic, cell.at)
        for cell in (published.cells if published else ())
        for pair in cell.pairs()
    ]
    # The labels as table.csv writes them.
    axes = [axis.name for axis in plan.axes]
    rows = [[unit.labels.get(axis, "") for axis in axes] for unit in plan.units]
    labels = pd.DataFrame(rows, columns=axes).to_csv()
    order = [
        list(whole[section].items()) for section in ("estimators", "metrics", "tables") if section in whole
    ]
    return {
        "axes": axes,
        "units": units,
        **shown,
        "cells": cells,
        "paper_trials": published and published.paper_trials,
        "labels": labels,
        "order": order,
    }


# How much of a search a panel shows, said for its readers only.
SAID_SINCE = " (16 of 64 pairs)"


@pytest.mark.parametrize("path", FIRST, ids=lambda path: path.stem)
def test_a_configuration_gives_the_same_units_tables_and_figures(path):
    plugins.load()
    now = without(meaning(ROOT / "configs" / path.name), SAID_SINCE)
    assert now == meaning(path)


def without(value, text):
    """What was read, without a text that was added to labels."""
    if isinstance(value, dict):
        return {key: without(item, text) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(without(item, text) for item in value)
    return value.replace(text, "") if isinstance(value, str) else value


def test_there_is_a_first_writing_to_compare_with():
    assert len(FIRST) == 38
