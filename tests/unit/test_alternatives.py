"""Alternatives: the same experiment with one thing changed."""

import pytest

from hident import plugins
from hident.engine.alternatives import alternative_plan, check_alternatives
from hident.engine.experiment import load
from hident.errors import ConfigError
from tests.unit.results_maker import CONFIG, PUBLISHED


def plan_with(folder, alternatives, *, trials=20):
    plugins.load()
    (folder / "configs").mkdir()
    paper = folder / "experiments" / "someone2001"
    paper.mkdir(parents=True)
    (paper / "published.csv").write_text(
        "table,row,quantity,printed,note\n" + "".join(f"T,N={n},error,1,\n" for n in (10, 100, 1000))
    )
    path = folder / "configs" / "a.yaml"
    rest = PUBLISHED.format(runs=1, statistic="mean") + f"alternatives: {alternatives}\n"
    path.write_text(CONFIG.format(trials=trials, axes="", estimators="", rest=rest))
    return load(path)


def test_an_alternative_holds_what_it_changes_and_what_is_judged(tmp_path):
    plan = plan_with(tmp_path, "{pole: {system.linear.a: [0.9]}, more: {estimators.two.bandwidth.h0: 2}}")
    found = alternative_plan(plan, "pole", 7)
    assert [(unit.name, unit.labels["samples"]) for unit in found.units] == [
        ("one", 10),
        ("one", 100),
        ("one", 1000),
    ]
    assert {unit.data.system.linear.a for unit in found.units} == {(0.9,)}
    assert (found.trials, found.seed, alternative_plan(plan, "pole").trials) == (7, 1, 20)
    assert {key for keys in found.keys for key in keys.values()}.isdisjoint(
        key for keys in plan.keys for key in keys.values()
    )
    # Nothing is printed beside the second estimator.
    with pytest.raises(ConfigError, match="changes no estimate that stands beside a printed number"):
        alternative_plan(plan, "more")


def test_a_star_stands_for_every_entry_that_holds_the_rest(tmp_path):
    plan = plan_with(tmp_path, "{h: {estimators.*.bandwidth.h0: 2}, at: {metrics.*.interval: [-1, 0]}}")
    assert {unit.estimator.bandwidth.h0 for unit in alternative_plan(plan, "h").units} == {2.0}
    assert len(alternative_plan(plan, "at").units) == 3


def test_an_alternative_comes_after_the_cases(tmp_path):
    plan = plan_with(tmp_path, "{n: {samples: 500}}")
    assert {unit.data.samples for unit in alternative_plan(plan, "n").units} == {500}


def test_another_statistic_is_an_alternative_too(tmp_path):
    plan = plan_with(tmp_path, "{median: {statistic: median}, same: {statistic: mean}}")
    found = alternative_plan(plan, "median", 5)
    assert {cell.statistic for cell in found.experiment.published.cells} == {"median"}
    assert found.keys == plan.keys
    with pytest.raises(ConfigError, match="is the statistic of every number"):
        alternative_plan(plan, "same")


@pytest.mark.parametrize(
    ("alternatives", "said"),
    [
        ("{a: {noise.std: 1}}", "noise"),
        ("{a: {estimators.*.bandwith: 1}}", "leads nowhere; did you mean 'estimators.*.bandwidth'?"),
        ("{a: {estimators.three.kind: kernel}}", "three"),
        ("{a: {system.linear.a: [0.5]}}", "changes no estimate: it is what the file holds"),
        ("{a: {system.linear.a: [2]}}", "a.yaml:"),
        ("{a: {statistic: mode}}", "must be one of mean, median, std"),
        ("{a: {seed: 2}}", "cannot change 'seed'"),
    ],
)
def test_what_cannot_be_run_is_said(tmp_path, alternatives, said):
    with pytest.raises(ConfigError) as refused:
        check_alternatives(plan_with(tmp_path, alternatives))
    assert said in str(refused.value)


def test_an_alternative_must_set_something(tmp_path):
    with pytest.raises(ConfigError, match=r"alternatives\.a: must set values by their key path"):
        plan_with(tmp_path, "{a: }")
