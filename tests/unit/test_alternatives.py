"""Alternatives: the same experiment with one thing changed."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hident import plugins
from hident.engine.alternatives import alternative_plan, alternative_plans
from hident.engine.experiment import load
from hident.engine.results import Results, Series
from hident.engine.runner import run
from hident.engine.trial import generate
from hident.errors import ConfigError
from hident.ledger.mutation import measured, trials_of
from hident.ledger.power import VerdictPower
from tests.unit.results_maker import CONFIG, PUBLISHED


def plan_with(folder, alternatives, *, trials=20) -> Any:
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
    found: Any = alternative_plan(plan, "pole", 7)
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
    limited = plan.changed(trial_timeout=30.0)
    assert alternative_plan(limited, "pole").trial_timeout == 30.0
    # Nothing is printed beside the second estimator.
    with pytest.raises(ConfigError, match="changes no estimate that stands beside a printed number"):
        alternative_plan(plan, "more")


def test_an_alternative_with_another_noise_level_has_the_noise_of_the_configuration(tmp_path):
    plan = plan_with(tmp_path, "{loud: {noise.std: 2}}")
    text = plan.path.read_text() + "noise: {kind: white, std: 1}\n"
    for sharing in ("", "streams: {kind: numpy, share: [noise]}\n"):
        plan.path.write_text(text + sharing)
        shared = load(plan.path)
        ours, theirs = shared.units[0].data, alternative_plan(shared, "loud").units[0].data
        noises = [generate(data, 1, 3).y - data.before_noise(1, 3).y for data in (ours, theirs)]
        assert np.allclose(2.0 * noises[0], noises[1], atol=1e-12) == bool(sharing)
        assert ours.key != theirs.key


def test_a_star_stands_for_every_entry_that_holds_the_rest(tmp_path):
    plan = plan_with(tmp_path, "{h: {estimators.*.bandwidth.h0: 2}, at: {metrics.*.interval: [-1, 0]}}")
    found: Any = alternative_plan(plan, "h")
    assert {unit.estimator.bandwidth.h0 for unit in found.units} == {2.0}
    assert len(alternative_plan(plan, "at").units) == 3


def test_an_alternative_comes_after_the_cases(tmp_path):
    plan = plan_with(tmp_path, "{n: {samples: 500}}")
    assert {unit.data.samples for unit in alternative_plan(plan, "n").units} == {500}


def test_an_alternative_may_be_of_some_cases_alone(tmp_path):
    plan = plan_with(tmp_path, "{a: {at: {samples: [100, 1000]}, system.linear.a: [0.9]}}")
    found: Any = alternative_plan(plan, "a")
    assert [unit.labels["samples"] for unit in found.units] == [100, 1000]
    assert {unit.data.system.linear.a for unit in found.units} == {(0.9,)}


def test_what_it_sets_need_only_be_there_in_its_cases():
    plan = load(Path("configs/chen_table3.yaml"), ["alternatives.everywhere={system.k_1: 100}"])
    found: Any = alternative_plan(plan, "k_1 and k_2 exchanged")
    assert [(unit.labels["process"], unit.data.system.k_1) for unit in found.units] == [
        ("example 5, F = 34.3", 100.0)
    ]
    with pytest.raises(ConfigError, match=r"system\.k_1: unknown key"):
        alternative_plan(plan, "everywhere")


def test_another_statistic_is_an_alternative_too(tmp_path):
    plan = plan_with(tmp_path, "{median: {statistic: median}, same: {statistic: mean}}")
    found: Any = alternative_plan(plan, "median", 5)
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
        ("{a: {at: 3, samples: 5}}", "alternatives.a.at: must name labels of axes"),
        (
            "{a: {at: {sample: 10}, samples: 5}}",
            "at.sample: there is no axis 'sample'; did you mean 'samples'?",
        ),
        ("{a: {at: {samples: [10, 11]}, samples: 5}}", "there is no label '11'"),
    ],
)
def test_what_cannot_be_run_is_said(tmp_path, alternatives, said):
    with pytest.raises(ConfigError) as refused:
        alternative_plans(plan_with(tmp_path, alternatives))
    assert said in str(refused.value)


def test_an_alternative_must_set_something(tmp_path):
    with pytest.raises(ConfigError, match=r"alternatives\.a: must set values by their key path"):
        plan_with(tmp_path, "{a: }")


def test_numbers_and_tables_are_held_against_each_alternative(tmp_path):
    plan = plan_with(
        tmp_path,
        "{near: {system.linear.a: [0.50001]}, "
        "far: {system.nonlinearity: {kind: polynomial, coefficients: [0, 100]}}}",
        trials=60,
    )
    means = {series.unit.labels["samples"]: series.value("mean") for series in run(plan).select("one")}
    text = "".join(f"T,N={n},error,{mean:.6g},\n" for n, mean in means.items())
    (tmp_path / "experiments" / "someone2001" / "published.csv").write_text(
        "table,row,quantity,printed,note\n" + text
    )
    plan = load(plan.path)
    asked = []

    def results(name, alternative):
        asked.append((name, alternative.trials))
        return run(alternative)

    power = measured(plan, alternative_plans(plan, trials_of(plan, 30)), results)
    assert asked == [("itself", 30), ("near", 30), ("far", 30)]
    assert {place[1]: number.excluded for place, number in power.numbers.items()} == {
        f"N={n}": {"near": False, "far": True} for n in (10, 100, 1000)
    }
    near, far = power.mutations
    assert (near.alternative, near.rejected, near.excluding) == ("near", False, 0)
    assert (far.alternative, far.rejected, far.excluding, far.numbers) == ("far", True, 3, 3)
    assert power.score("T") == (1, 2)
    assert VerdictPower.decoded(*(text.encode() for text in power.files().values())) == power


def test_each_of_several_of_ours_on_one_number_is_held_against_an_alternative_by_itself(tmp_path):
    plan = plan_with(tmp_path, "{x: {system.linear.a: [0.50001]}}", trials=60)
    plan.path.write_text(plan.path.read_text().replace("N={samples}", "all N"))
    (tmp_path / "experiments" / "someone2001" / "published.csv").write_text(
        "table,row,quantity,printed,note\nT,all N,error,1.00,\n"
    )
    plan = load(plan.path)
    rng = np.random.default_rng(3)

    def results(name, alternative):
        def values(series):
            lost = name == "itself" and series.unit.labels["samples"] == 1000
            away = name == "x" and series.unit.labels["samples"] != 10
            return rng.normal(9.0 if lost or away else 1.0, 0.1, alternative.trials)

        found = run(alternative)
        return Results(found.plan, tuple(Series(one.unit, one.metric, values(one)) for one in found.series))

    power = measured(plan, alternative_plans(plan, 60), results)
    # The last one differs without the alternative too.
    assert {place[3]: number.excluded["x"] for place, number in power.numbers.items()} == {
        "samples 10": False,
        "samples 100": True,
        "samples 1000": False,
    }
    assert power.mutations[0].excluding == 1
    assert VerdictPower.decoded(*(text.encode() for text in power.files().values())) == power


def changed_by(change, *, first=True):
    """What runs an alternative with its values changed; with ``first`` the plan itself is left as it is."""

    def results(name, alternative):
        found = run(alternative)
        if first and name == "itself":
            return found
        series = (Series(one.unit, one.metric, change(one.values.copy())) for one in found.series)
        return Results(alternative, tuple(series))

    return results


def mutation_of(plan, results):
    (mutation,) = measured(plan, alternative_plans(plan, 40), results).mutations
    return mutation


POLE = "{x: {system.linear.a: [0.9]}}"


def test_a_table_is_rejected_where_every_estimate_fails(tmp_path):
    plan = plan_with(tmp_path, POLE, trials=60)
    mutation = mutation_of(plan, changed_by(lambda values: values * np.nan))
    assert (mutation.rejected, math.isnan(mutation.joint_p)) == (True, True)
    # Where ours fail as well, that says nothing.
    assert not mutation_of(plan, changed_by(lambda values: values * np.nan, first=False)).rejected


def test_numbers_that_few_trials_know_reject_nothing(tmp_path):
    def lost(values):
        values[3:] = np.nan
        return values + 1e6

    mutation = mutation_of(plan_with(tmp_path, POLE, trials=60), changed_by(lost))
    assert (mutation.rejected, math.isnan(mutation.joint_p)) == (False, True)


def test_what_does_not_vary_rejects_by_its_digits(tmp_path):
    plan = plan_with(tmp_path, POLE, trials=60)
    fixed = {"itself": 1.0, "x": 1.0}

    def results(name, alternative):
        return changed_by(lambda values: np.full_like(values, fixed[name]), first=False)(name, alternative)

    (tmp_path / "experiments" / "someone2001" / "published.csv").write_text(
        "table,row,quantity,printed,note\n" + "".join(f"T,N={n},error,1.00,\n" for n in (10, 100, 1000))
    )
    plan = load(plan.path)
    assert not mutation_of(plan, results).rejected
    fixed["x"] = 1.01
    mutation = mutation_of(plan, results)
    assert (mutation.rejected, math.isnan(mutation.joint_p), mutation.excluding) == (True, True, 3)
    # A misprint that ours misses too tells nothing of an alternative.
    fixed["itself"] = 1.02
    assert (mutation_of(plan, results).rejected, mutation_of(plan, results).excluding) == (False, 0)


def test_where_digits_decide_one_that_changes_rejects(tmp_path):
    plan = plan_with(tmp_path, POLE, trials=60)
    text = plan.path.read_text()
    plan.path.write_text(text.replace("paper_trials: 1\n", "paper_trials: 60\n  same_data: true\n"))
    plan = load(plan.path)
    assert plan.experiment.published is not None and plan.experiment.published.same_data
    means = [series.value("mean") for series in run(plan).select("one")]
    rows = zip((10, 100, 1000), means, strict=True)
    (tmp_path / "experiments" / "someone2001" / "published.csv").write_text(
        "table,row,quantity,printed,note\n" + "".join(f"T,N={n},error,{mean:.4f},\n" for n, mean in rows)
    )
    plan = load(plan.path)
    (mutation,) = measured(plan, alternative_plans(plan), changed_by(lambda values: values)).mutations
    assert (mutation.rejected, math.isnan(mutation.joint_p), mutation.excluding) == (True, True, 3)


def test_a_harmless_alternative_excludes_few_numbers_that_agree(tmp_path):
    """As docs/verdicts.md says: about one in twenty."""
    rng = np.random.default_rng(3)
    plan = plan_with(tmp_path, POLE, trials=40)
    found = {name: run(one) for name, one in (("itself", plan), *alternative_plans(plan, 40).items())}
    excluded = []
    for _ in range(300):
        printed = rng.normal(size=3)
        numbers = "".join(
            f"T,N={n},error,{one:.6f},\n" for n, one in zip((10, 100, 1000), printed, strict=True)
        )
        (tmp_path / "experiments" / "someone2001" / "published.csv").write_text(
            f"table,row,quantity,printed,note\n{numbers}"
        )

        def drawn(name, alternative):
            series = (Series(one.unit, one.metric, rng.normal(size=40)) for one in found[name].series)
            return Results(alternative, tuple(series))

        power = measured(load(plan.path), alternative_plans(load(plan.path), 40), drawn)
        excluded += [number.excluded["x"] for number in power.numbers.values()]
    assert 0.015 < np.mean(excluded) < 0.06
