"""Statistics over trials, by hand and by definition, and the columns of table.csv."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hident import plugins
from hident.engine.experiment import load
from hident.engine.results import Results, Series

if TYPE_CHECKING:
    from hident.engine.experiment import Statistic, Unit
    from tests.conftest import Lab

plugins.load()


@pytest.fixture
def unit(lab: Lab) -> Unit:
    return load(lab.folder / "tiny.yaml").units[0]


def test_statistics_by_hand(unit: Unit) -> None:
    series = Series(unit, "a", np.array([1.0, np.nan, 2.0, 3.0, 6.0, np.inf]))
    assert series.statistics == pytest.approx(
        {
            "trials": 6,
            "failed": 2,
            "mean": 3.0,
            "std": math.sqrt((4 + 1 + 0 + 9) / 3),
            "se": math.sqrt(14 / 3) / 2,
            "median": 2.5,
            "q05": 1.15,
            "q25": 1.75,
            "q75": 3.75,
            "q95": 5.55,
        }
    )
    assert series.valid.tolist() == [1.0, 2.0, 3.0, 6.0]


def test_one_trial_has_no_spread_and_none_has_nothing(unit: Unit) -> None:
    one = Series(unit, "a", np.array([2.0])).statistics
    assert (one["trials"], one["failed"], one["mean"], one["median"], one["q05"]) == (1, 0, 2.0, 2.0, 2.0)
    assert math.isnan(one["std"])
    assert math.isnan(one["se"])
    none = Series(unit, "a", np.full(3, np.nan)).statistics
    assert (none["trials"], none["failed"]) == (3, 3)
    assert all(math.isnan(value) for name, value in none.items() if name not in ("trials", "failed"))


@pytest.mark.parametrize("statistic", ["mean", "std", "median"])
def test_standard_errors_are_the_spread_of_the_statistic(unit: Unit, statistic: Statistic) -> None:
    rng = np.random.default_rng(3)
    samples = rng.gamma(3.0, size=(4000, 200))
    of_each = {
        "mean": np.mean(samples, axis=1),
        "std": np.std(samples, axis=1, ddof=1),
        "median": np.median(samples, axis=1),
    }[statistic]
    some = [Series(unit, "a", sample) for sample in samples[:400]]
    np.testing.assert_allclose([series.value(statistic) for series in some], of_each[:400], rtol=1e-12)
    spread = np.std(of_each)
    claimed = np.mean([series.standard_error(statistic) for series in some])
    assert claimed == pytest.approx(spread, rel=0.06)


@pytest.mark.parametrize("size", [1e-300, 1.3e-4, 0.1, 7.0, -3e8])
def test_a_spread_below_the_rounding_of_its_values_is_none(unit: Unit, size: float) -> None:
    # The mean of equal numbers is not always one of them.
    for factors in (np.ones(100), 1.0 + 1e-15 * (np.arange(100) % 7)):
        values = np.asarray(size * factors, dtype=np.float64)
        series = Series(unit, "a", values)
        found = series.statistics
        assert (found["std"], found["se"]) == (0.0, 0.0)
        assert {found[name] for name in ("mean", "median", "q05", "q95")} == {values[0]}
        assert [series.standard_error(s) for s in ("mean", "std", "median")] == [0.0, 0.0, 0.0]
        assert series.values is values


def test_a_spread_above_rounding_stays(unit: Unit) -> None:
    values = np.asarray(1.0 + 1e-11 * np.arange(5), dtype=np.float64)
    assert Series(unit, "a", values).statistics["std"] == np.std(values, ddof=1)


def test_standard_error_of_too_few_or_equal_values(unit: Unit) -> None:
    assert math.isnan(Series(unit, "a", np.array([1.0])).standard_error("mean"))
    for statistic in ("mean", "std", "median"):
        assert Series(unit, "a", np.ones(5)).standard_error(statistic) == 0.0


def test_frame_has_the_case_the_names_and_the_statistics(lab: Lab) -> None:
    plan = load(lab.folder / "tiny.yaml")
    series = tuple(Series(unit, "a a_1", np.arange(3.0) + i) for i, unit in enumerate(plan.units))
    results = Results(plan, series)
    frame = results.frame()
    assert list(frame.columns) == [
        *("samples", "estimator", "metric", "trials", "failed", "mean", "std", "se", "median"),
        *("q05", "q25", "q75", "q95"),
    ]
    assert frame["samples"].tolist() == [50, 50, 80, 80]
    assert frame["estimator"].tolist() == ["known", "iv", "known", "iv"]
    assert frame["mean"].tolist() == [1.0, 2.0, 3.0, 4.0]


def test_series_are_selected_by_estimator_metric_and_labels(lab: Lab) -> None:
    plan = load(lab.folder / "tiny.yaml")
    results = Results(plan, tuple(Series(unit, "a a_1", np.zeros(1)) for unit in plan.units))
    assert len(list(results.select())) == 4
    assert [s.unit.name for s in results.select(labels={"samples": 80})] == ["known", "iv"]
    assert [s.unit.labels for s in results.select("iv", "a a_1", {"samples": "50"})] == [{"samples": 50}]
    assert list(results.select(metric="b")) == []
    assert results.labels("samples") == (50, 80)
    assert results.labels("other") == ()


def test_statistics_of_huge_values_warn_of_nothing(unit: Unit) -> None:
    series = Series(unit, "a", np.array([1e308, -1e308, 1e308]))
    assert series.statistics["std"] == math.inf
    assert not math.isfinite(series.standard_error("std"))
