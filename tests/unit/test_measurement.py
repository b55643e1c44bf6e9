"""A measured record in a configuration: what it stands for, what its trials depend on, what is refused."""

from __future__ import annotations

import json
import os
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import hident as hi
from hident import plugins
from hident.engine.executors import make_executor
from hident.engine.preflight import check_records
from hident.engine.replay import OneTrial
from hident.engine.runner import run, stored
from hident.engine.store import Store
from hident.errors import ConfigError
from hident.numerics.bootstrap import resampled
from hident.reports.output import Outputs
from tests.unit.plans import planned, refusals, replaced

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from hident.engine.experiment import Plan

CONFIG = """\
version: 1
title: A tank
record: {file: tank.csv, input: u, output: y, dt: 4}
trials: 1
estimators:
  two-stage: {kind: two_stage, lags: 3, degree: 2}
metrics:
  b: {kind: value, of: [b_1, b_2]}
"""
BOOTSTRAP = "dt: 4, bootstrap: {kind: block, length: 5}"
# Its numbers are the mean of y and the last sample of what it is given; its model is a constant.
LEVEL = """\
import numpy as np
import hident as hi
from hident.config.spec import component
from hident.estimators.base import AtOneInterval

class Constant:
    def __init__(self, level):
        self.level = level

    def simulate(self, record):
        return np.full(len(record), self.level)

    def predict(self, record, steps=1):
        return self.simulate(record)

@component("estimator", "level")
class Level(AtOneInterval):
    '''The mean of the output.'''
    scale: float = 1.0
    fails: bool = False
    holds = ("model",)

    def names(self):
        return ("mean", "last")

    def fit(self, record, rng=None):
        if self.fails:
            raise hi.EstimationError("no level")
        mean = self.scale * float(np.mean(record.y))
        return hi.Estimate(model=Constant(mean), values=self.named(mean, record.y[-1]))

@component("estimator", "one")
class One(Level):
    '''The mean of the output of one experiment.'''

    def takes_experiments(self):
        return "one"
"""
WITH_MODEL = """\
version: 1
title: A tank, resampled
record: {file: tank.csv, input: u, output: y, dt: 4, bootstrap: {kind: block, length: 5}}
trials: 6
estimators:
  level: level
  half: {kind: level, scale: 0.5}
metrics:
  of: {kind: value, of: [mean, last]}
"""


def _write(path: Path, samples: int = 60, moved: float = 0.0) -> None:
    rng = np.random.default_rng(3)
    u = rng.uniform(-1, 1, samples)
    y = np.convolve(u + u**2, [0.0, 1.0, 0.5])[:samples] + 0.1 * rng.standard_normal(samples)
    y[30] += moved
    rows = "".join(f"{a!r},{b!r},{2 * b!r}\n" for a, b in zip(u.tolist(), y.tolist(), strict=True))
    path.write_text(f"u,y,twice\n{rows}", encoding="utf-8")


@pytest.fixture(scope="module", autouse=True)
def level(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of an estimator whose estimate holds a model."""
    path = tmp_path_factory.mktemp("plugin") / "level.py"
    path.write_text(LEVEL, encoding="utf-8")
    plugins.load([path])
    return path


@pytest.fixture(autouse=True)
def folder(tmp_path: Path) -> Path:
    _write(tmp_path / "tank.csv")
    return tmp_path


def _keys(plan: Plan) -> list[str]:
    return [key for keys in plan.keys for key in keys.values()]


def _values(plan: Plan, **options: Any) -> dict[tuple[str, str], list[float]]:
    return {(s.unit.name, s.metric): s.values.tolist() for s in run(plan, **options).series}


def test_the_trial_is_the_record(folder: Path) -> None:
    record = hi.read(folder / "tank.csv", input="u", output="y", dt=4)
    estimate = hi.fit({"kind": "two_stage", "lags": 3, "degree": 2}, record)
    assert _values(planned(folder, CONFIG)) == {
        ("two-stage", "b b_1"): [estimate.values["b_1"]],
        ("two-stage", "b b_2"): [estimate.values["b_2"]],
    }


def test_a_mapping_names_a_file_of_the_current_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    mapping = {
        "version": 1,
        "title": "A tank",
        "record": {"file": "tank.csv", "input": "u", "output": "y", "dt": 4},
        "trials": 1,
        "estimators": {"two-stage": hi.TwoStage(lags=3, degree=2)},
        "metrics": {"b": {"kind": "value", "of": ["b_1", "b_2"]}},
    }
    expected = _values(planned(folder, CONFIG))
    for experiment in (mapping, hi.Experiment(**mapping)):
        found = {(s.unit.name, s.metric): s.values.tolist() for s in hi.run(experiment).series}
        assert found == expected


def test_models_are_judged_on_the_validation_part(folder: Path) -> None:
    text = """\
version: 1
title: A tank, judged by what was kept apart
record: {file: tank.csv, input: u, output: y, dt: 4, estimation: 1..30, validation: 31..60}
trials: 1
estimators: {level: level}
metrics: {rmse: {kind: rmse, on: validation}}
tables:
  one:
    kind: distribution
    title: One trial
    columns: {RMSE: rmse}
    rows: [{label: level, estimator: level, metric: "", metrics: {RMSE: rmse}}]
figures:
  residuals: {kind: residuals, curve: {estimator: level}, on: validation}
"""
    plan = planned(folder, text)
    outputs = Outputs(plan, folder / "out")
    assert outputs.write(run(plan), {}) == ()
    assert (folder / "out/residuals.png").exists()
    record = hi.read(folder / "tank.csv", input="u", output="y", dt=4)
    rmse = float(np.sqrt(np.mean((record.y[30:] - np.mean(record.y[:30])) ** 2)))
    assert f"| level | {rmse:.3g} |" in (folder / "out/table.md").read_text(encoding="utf-8")
    assert "median" not in (folder / "out/table.md").read_text(encoding="utf-8")


def test_tables_name_the_record(folder: Path) -> None:
    plan = planned(folder, CONFIG)
    Outputs(plan, folder / "out").write(run(plan), {})
    said = (folder / "out" / "table.md").read_text(encoding="utf-8")
    sha256 = plan.units[0].data.sha256  # type: ignore[attr-defined]
    record = f"Measured record tank.csv: 60 samples, dt 4, SHA-256 {sha256[:12]}."
    assert f"\n{record}\n" in said
    run_json = json.loads((folder / "out" / "run.json").read_text(encoding="utf-8"))
    assert run_json["experiment"]["records"] == [record]


class TestKeys:
    def test_names_of_files_and_folders_do_not_count(self, folder: Path) -> None:
        keys = _keys(planned(folder, CONFIG))
        elsewhere = folder / "elsewhere"
        elsewhere.mkdir()
        (elsewhere / "renamed.csv").write_bytes((folder / "tank.csv").read_bytes())
        assert _keys(planned(elsewhere, CONFIG, "record.file=renamed.csv")) == keys

    def test_which_of_several_files_is_meant_counts(self, folder: Path) -> None:
        _write(folder / "b.csv", moved=1.0)
        columns = {"output: y": "output: [y, y, twice]"}
        orders = ("[tank.csv, tank.csv, b.csv]", "[tank.csv, b.csv, b.csv]")
        texts = [replaced(CONFIG, {"tank.csv": files, **columns}) for files in orders]
        assert len({*map(str, (_keys(planned(folder, text)) for text in texts))}) == 2

    def test_what_the_file_holds_and_how_it_is_read_count(self, folder: Path) -> None:
        keys = _keys(planned(folder, CONFIG))
        assert set(_keys(planned(folder, CONFIG, "record.dt=2"))).isdisjoint(keys)
        assert set(_keys(planned(folder, CONFIG, "record.output=twice"))).isdisjoint(keys)
        _write(folder / "tank.csv", moved=1e-9)
        assert set(_keys(planned(folder, CONFIG))).isdisjoint(keys)

    def test_a_changed_file_is_computed_again_and_an_unchanged_one_is_not(self, folder: Path) -> None:
        store = Store(folder / "store")
        plan = planned(folder, CONFIG)
        with store.writing() as writer:
            before = _values(plan, store=writer)
        assert stored(planned(folder, CONFIG), store) == [1]
        _write(folder / "tank.csv", moved=1.0)
        changed = planned(folder, CONFIG)
        assert stored(changed, store) == [0]
        with store.writing() as writer:
            assert _values(changed, store=writer) != before
        assert stored(planned(folder, CONFIG), store) == [1]


class TestCases:
    def test_an_axis_patches_the_record(self, folder: Path) -> None:
        plan = planned(folder, f"{CONFIG}cases: {{record.estimation: [1..30, 1..60]}}\n")
        assert [unit.data.samples for unit in plan.units] == [30, 60]
        assert len(set(_keys(plan))) == 2

    def test_a_variable_stands_in_the_record(self, folder: Path) -> None:
        text = replaced(CONFIG, {"output: y": "output: $column"})
        plan = planned(folder, f"{text}cases: {{column: [y, twice]}}\n")
        records = [OneTrial(plan, 0).record(unit.data)[0] for unit in plan.units]
        once, twice = (record.y for record in records if record is not None)
        assert np.array_equal(2 * once, twice)

    def test_an_axis_chooses_between_a_simulation_and_a_record(self, folder: Path) -> None:
        section, axes = (
            CONFIG.splitlines()[2],
            """\
cases:
  source:
    measured: {"record": {file: tank.csv, input: u, output: y, dt: 4}}
    simulated:
      record: null
      samples: 80
      system: {kind: hammerstein, nonlinearity: abs, linear: {kind: fir, b: [0, 1]}}
      excitation: {kind: iid, distribution: uniform, low: -1, high: 1}
""",
        )
        plan = planned(folder, replaced(CONFIG, {f"{section}\n": ""}) + axes)
        assert [unit.data.samples for unit in plan.units] == [60, 80]
        assert _keys(plan)[0] == _keys(planned(folder, CONFIG))[0]

    def test_set_changes_the_record(self, folder: Path) -> None:
        assert planned(folder, CONFIG, "record.dt=0.5").units[0].data.dt == 0.5

    def test_every_value_of_an_estimate(self, folder: Path) -> None:
        text = replaced(CONFIG, {"[b_1, b_2]": "all"})
        assert ("two-stage", "b b_3") in _values(planned(folder, text))


FITTED = """\
  pem:
    kind: prediction_error
    blocks: [{kind: polynomial, degree: 2}, {kind: linear, nb: 2, nf: 0, nk: 1}]
"""


class TestValidation:
    TEXT = replaced(
        CONFIG,
        {
            "dt: 4": "dt: 4, estimation: 1..40, validation: {samples: 41..60}",
            "  two-stage: {kind: two_stage, lags: 3, degree: 2}\n": FITTED,
            "{kind: value, of: [b_1, b_2]}": "{kind: rmse, on: validation, n_init: 2}",
        },
    )

    def test_a_metric_scores_the_validation_part(self, folder: Path) -> None:
        [(error,)] = _values(planned(folder, self.TEXT)).values()
        # The noise has standard deviation 0.1.
        assert 0.05 < error < 0.15

    def test_a_record_without_one_is_refused(self, folder: Path) -> None:
        (said,) = refusals(folder, self.TEXT, "record.validation=null")
        assert "the metric 'rmse' is on a validation record, and this record has none" in said

    def test_bootstraps_spread_as_the_standard_errors_say(self, folder: Path) -> None:
        words = {
            "dt: 4, ": f"{BOOTSTRAP}, ",
            "trials: 1": "trials: 40",
            "{kind: rmse, on: validation, n_init: 2}": "{kind: value, of: [b_1, se_b_1]}",
        }
        values = _values(planned(folder, replaced(self.TEXT, words)))
        spread, error = np.std(values["pem", "b b_1"]), np.mean(values["pem", "b se_b_1"])
        assert 0.6 < spread / error < 1.6


class TestRefusals:
    @pytest.mark.parametrize(
        ("words", "messages"),
        [
            (
                {"trials: 1": "trials: 1\nsamples: 60\nnoise: {kind: white, std: 1}"},
                [
                    "a.yaml:5: samples: cannot stand beside 'record', which takes the place of samples, dt, "
                    "system, excitation, noise, streams (got 60)",
                    "a.yaml:6: noise: cannot stand beside 'record', which takes the place of samples, dt, "
                    "system, excitation, noise, streams",
                ],
            ),
            (
                {"record: {file: tank.csv, input: u, output: y, dt: 4}\n": ""},
                [
                    "a.yaml:1: samples: is required: Length N of the record",
                    "a.yaml:1: system: is required: The true system",
                    "a.yaml:1: excitation: is required: The input signal",
                ],
            ),
            (
                {"tank.csv": "tanks.csv"},
                ["a.yaml:3: record: tanks.csv: cannot be read: no such file or directory"],
            ),
            (
                {"output: y": "output: yy"},
                [
                    "a.yaml:3: record: tank.csv: there is no column 'yy'; did you mean 'y'? "
                    "(the file has: u, y, twice)"
                ],
            ),
            (
                {"dt: 4": "dt: 4, bootstrap: {kind: block, length: 61}"},
                ["a.yaml:3: record: the blocks of its bootstrap have 61 samples, and it has 60"],
            ),
            (
                {"lags: 3": "lags: 50"},
                ["a.yaml:6: estimators.two-stage: needs at least 151 samples, but samples is 60"],
            ),
            (
                {"kind: value": "kind: error"},
                [
                    "a.yaml:8: metrics.b: the metric 'error' needs the value b_1 of the truth: a measured "
                    "record has none",
                    "a.yaml:8: metrics.b: the metric 'error' needs the value b_2 of the truth: a measured "
                    "record has none",
                ],
            ),
            (
                {"trials: 1": "trials: 3"},
                [
                    "a.yaml:4: trials: 3 trials are wanted, and a measured record is trial 0, with no other: "
                    "let 'trials' be 1, or give the record a 'bootstrap', as {kind: block, length: 50}"
                ],
            ),
            (
                {"trials: 1": "trials: 3", "dt: 4": BOOTSTRAP},
                [
                    "a.yaml:6: estimators.two-stage: 3 trials are wanted, and a bootstrap adds residuals to "
                    "what a model simulates, and this estimator (two_stage) gives none"
                ],
            ),
        ],
    )
    def test_before_the_run(self, folder: Path, words: dict[str, str], messages: list[str]) -> None:
        assert refusals(folder, replaced(CONFIG, words)) == messages

    def test_of_a_plan_with_other_trials(self, folder: Path) -> None:
        with pytest.raises(ConfigError, match="2 trials are wanted, and a measured record is trial 0"):
            planned(folder, CONFIG).changed(trials=2)


class TestExperiments:
    """Several files are experiments of one record."""

    TEXT = replaced(CONFIG, {"tank.csv": "[tank.csv, other.csv]"})

    def test_an_estimator_keeps_them_apart(self, folder: Path) -> None:
        _write(folder / "other.csv", samples=40, moved=1.0)
        plan = planned(folder, self.TEXT)
        assert plan.units[0].data.samples == 100
        record, _ = OneTrial(plan, 0).record(plan.units[0].data)
        assert record is not None
        assert list(record.parts) == ["tank", "other"]
        assert len(_values(plan)) == 2

    def test_one_that_takes_one_experiment_is_refused(self, folder: Path) -> None:
        _write(folder / "other.csv", samples=40)
        text = replaced(self.TEXT, {"{kind: two_stage, lags: 3, degree: 2}": "one", "[b_1, b_2]": "[mean]"})
        with pytest.raises(ConfigError, match="one takes a record of one experiment, and this one has 2"):
            check_records(planned(folder, text))

    def test_blocks_do_not_cross_from_one_into_another(self, folder: Path) -> None:
        _write(folder / "other.csv", samples=40, moved=50.0)
        text = replaced(WITH_MODEL, {"tank.csv": "[tank.csv, other.csv]"})
        for trial in range(6):
            record = OneTrial(planned(folder, text), trial).of("level", {}).record
            assert record is not None
            assert np.max(record.y[record.parts["tank"].samples]) < 20


class TestWorkers:
    def test_they_read_the_file_themselves(self, folder: Path, level: Path) -> None:
        plan = planned(folder, WITH_MODEL)
        alone = _values(plan)
        with make_executor(2, [level]) as executor:
            assert _values(plan, executor=executor) == alone

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (lambda path: _write(path, moved=1.0), "is not the one that the run began with: SHA-256"),
            (os.remove, "no such file"),
        ],
        ids=["another", "none"],
    )
    def test_one_with_another_file_ends_the_run(
        self, folder: Path, change: Callable[[Path], None], message: str
    ) -> None:
        plan = planned(folder, CONFIG)
        change(folder / "tank.csv")
        with make_executor(2, []) as executor, pytest.raises(ConfigError, match=message):
            run(plan, executor=executor)

    def test_each_process_reads_it_once(self, folder: Path) -> None:
        plan = planned(folder, CONFIG)
        (folder / "tank.csv").unlink()
        assert len(_values(plan)) == 2


class TestBootstraps:
    def test_trial_0_is_the_record_and_the_others_are_not(self, folder: Path) -> None:
        values = _values(planned(folder, WITH_MODEL))["level", "of last"]
        record = hi.read(folder / "tank.csv", input="u", output="y", dt=4)
        assert values[0] == record.y[-1]
        assert len(set(values)) > 3
        residuals = set(np.round(record.y, 12))
        # A constant and its residuals are samples of the record again.
        assert {round(value, 12) for value in values} <= residuals

    def test_each_estimator_has_its_own_model_and_the_same_blocks(self, folder: Path) -> None:
        plan = planned(folder, WITH_MODEL)
        u = hi.read(folder / "tank.csv", input="u", output="y", dt=4).y
        for trial in range(6):
            one, half = (OneTrial(plan, trial).of(name, {}).record for name in ("level", "half"))
            assert one is not None
            assert half is not None
            np.testing.assert_allclose(one.y, half.y, rtol=0, atol=1e-12)
            assert np.array_equal(one.y, u) == (trial == 0)

    def test_they_depend_on_the_seed_and_the_trial_alone(self, folder: Path) -> None:
        values = _values(planned(folder, WITH_MODEL))
        more = _values(planned(folder, WITH_MODEL, trials=9))
        assert {key: series[:6] for key, series in more.items()} == values
        assert _values(planned(folder, WITH_MODEL, seed=2)) != values
        text = WITH_MODEL.replace("  half: {kind: level, scale: 0.5}\n", "")
        alone = _values(planned(folder, text))
        assert alone == {key: series for key, series in values.items() if key[0] == "level"}

    @pytest.mark.parametrize("perturbation", [0, 1])
    def test_one_trial_again_is_that_of_the_run(self, folder: Path, perturbation: int) -> None:
        plan = planned(folder, WITH_MODEL).changed(perturbation=perturbation)
        values = _values(plan)["half", "of mean"]
        found = [OneTrial(plan, trial).of("half", {}).found for trial in range(6)]
        assert [one.values["mean"] for one in found if one is not None] == values

    def test_perturbed_ones_are_a_last_bit_away(self, folder: Path) -> None:
        plan = planned(folder, WITH_MODEL)
        values, moved = (_values(p)["level", "of last"] for p in (plan, plan.changed(perturbation=1)))
        assert values != moved
        np.testing.assert_allclose(moved, values, rtol=1e-12)

    def test_a_failure_on_the_record_is_that_of_all(self, folder: Path) -> None:
        series = run(planned(folder, replaced(WITH_MODEL, {"scale: 0.5": "fails: true"}))).series[-1]
        assert series.reasons == (("no level", 6),)


class TestBlocks:
    def test_they_are_whole_and_circular(self) -> None:
        found = resampled(np.arange(10.0), 4, np.random.default_rng(1))
        assert len(found) == 10
        steps = np.diff(found) % 10
        inside = [step for i, step in enumerate(steps, 1) if i % 4]
        assert set(inside) == {1.0}

    def test_every_residual_is_as_likely(self) -> None:
        rng = np.random.default_rng(2)
        drawn = np.concatenate([resampled(np.arange(7.0), 3, rng) for _ in range(3000)])
        counts = np.bincount(drawn.astype(int), minlength=7) / len(drawn)
        np.testing.assert_allclose(counts, 1 / 7, atol=0.01)

    def test_one_block_of_all_is_a_rotation(self) -> None:
        found = resampled(np.arange(6.0), 6, np.random.default_rng(3))
        assert all((b - a) % 6 == 1 for a, b in pairwise(found))
