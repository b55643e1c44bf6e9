"""The verbs from Python: the same numbers as a run of the command line, and the same words."""

import json
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor

import numpy as np
import pandas as pd
import pytest
import yaml

import hident as hi
from hident.config.spec import component
from hident.engine.scores import Scores
from hident.engine.store import MemoryStore, Store
from hident.engine.work import compute
from hident.errors import ConfigError, StoreError, TrialsCrashed
from hident.estimators.base import EstimatorSpec
from hident.signals.streams import NumpyStreams

# What is in use where the tests run is not the matter here.
pytestmark = pytest.mark.filterwarnings("ignore:the arithmetic in use")

SYSTEM = hi.Hammerstein(nonlinearity="mzyk2009", linear=hi.Ar(a=[0.8]))
EXCITATION = hi.Iid(distribution="uniform", low=-6, high=6)
NOISE = hi.White(distribution="uniform", half_width=0.1)
IV = hi.InstrumentalVariables(order=1, instrument="abs")
MADE = {
    "version": 1,
    "title": "Made in Python",
    "seed": 7,
    "trials": 4,
    "system": SYSTEM,
    "excitation": EXCITATION,
    "noise": [NOISE],
    "cases": {"samples": np.array([50, 80])},
    "estimators": {"iv": IV, "known": {"kind": "known_dynamics", "a": [0.8]}},
    "metrics": {"a": hi.Error(of=["a_1"])},
}
WRITTEN = {
    **MADE,
    "system": {"kind": "hammerstein", "nonlinearity": "mzyk2009", "linear": {"kind": "ar", "a": [0.8]}},
    "excitation": {"kind": "iid", "distribution": "uniform", "low": -6, "high": 6},
    "noise": {"kind": "white", "distribution": "uniform", "half_width": 0.1},
    "cases": {"samples": [50, 80]},
    "estimators": {
        "iv": {"kind": "instrumental_variables", "order": 1, "instrument": "abs"},
        "known": {"kind": "known_dynamics", "a": [0.8]},
    },
    "metrics": {"a": {"kind": "error", "of": ["a_1"]}},
}


@pytest.fixture(scope="module")
def results():
    return hi.run(MADE)


def test_a_file_its_path_a_mapping_and_an_experiment_give_the_same_frame(results, tmp_path):
    path = tmp_path / "made.yaml"
    path.write_text(yaml.safe_dump(WRITTEN), encoding="utf-8")
    # In an experiment the cases need not give what it holds itself.
    made = hi.Experiment(**MADE, samples=50)
    for source in (path, str(path), WRITTEN, made):
        pd.testing.assert_frame_equal(hi.run(source).frame(), results.frame(), check_exact=True)


def test_the_frame_is_tidy(results):
    frame = results.frame()
    assert list(frame.columns[:5]) == ["samples", "estimator", "metric", "trials", "failed"]
    assert frame[["samples", "estimator"]].drop_duplicates().shape == (4, 2)
    trials = results.trials_frame()
    assert list(trials.columns) == ["samples", "estimator", "metric", "trial", "value"]
    means = trials.groupby(["samples", "estimator"])["value"].mean()
    np.testing.assert_allclose(means, frame.set_index(["samples", "estimator"])["mean"].loc[means.index])


def test_one_trial_by_hand_is_that_trial_of_the_run(results):
    trials = results.trials_frame().query("samples == 80 and estimator == 'iv'").set_index("trial")["value"]
    for trial in range(4):
        record = hi.simulate(SYSTEM, EXCITATION, 80, noise=NOISE, seed=7, trial=trial)
        estimate = hi.fit(IV, record, seed=7, trial=trial)
        assert hi.score(estimate, record, a=hi.Error(of=["a_1"])) == {"a a_1": trials[trial]}
        assert IV.fit(record).values == estimate.values


def test_trials_seed_and_overrides_stand_in_place_of_the_experiments(results):
    other = hi.run(MADE, trials=2, seed=8, overrides={"system.linear.a": [0.5]})
    assert (other.plan.trials, other.plan.seed) == (2, 8)
    system = other.plan.units[0].data.system
    assert system == hi.Hammerstein(nonlinearity="mzyk2009", linear=hi.Ar(a=[0.5]))
    same = hi.run(MADE, trials=2).trials_frame()
    kept = results.trials_frame().query("trial < 2").reset_index(drop=True)
    pd.testing.assert_frame_equal(same, kept, check_exact=True)


def test_a_store_is_kept_and_no_other_file_is_written(results, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    hi.run(MADE)
    assert not list(tmp_path.iterdir())
    assert hi.status(MADE) == {"stored": 0, "of": 16, "outputs": "none"}
    first = hi.run(MADE, store=".hident")
    with Store(tmp_path / ".hident").reading() as reader:
        assert reader.count() == 16
    hi.write(first, "out/experiment")
    assert hi.status(MADE) == {"stored": 16, "of": 16, "outputs": "up to date"}
    assert hi.compare("out", "out").differences == ()


def test_run_json_says_how_it_was_computed(tmp_path, monkeypatch):
    def of(results):
        hi.write(results, tmp_path / "out")
        return json.loads((tmp_path / "out/run.json").read_text())["provenance"]

    alone = of(hi.run(MADE))
    assert alone["workers"] == 1
    assert [*alone["seconds"]] == ["records checked", "trials", "tables", "figures"]
    assert "other_arithmetics" not in alone

    def elsewhere(*chunk):
        """As a worker on another machine may say of itself."""
        return compute(*chunk)._replace(worker="elsewhere", arithmetic="another")

    monkeypatch.setattr("hident.engine.runner.compute", elsewhere)
    with ThreadPoolExecutor(2) as threads, pytest.warns(UserWarning, match="another arithmetic"):
        found = hi.run(MADE, executor=threads)
    assert of(found)["other_arithmetics"] == {"another": "elsewhere"}


@pytest.mark.parametrize("store", [3, {}, MemoryStore, object()])
def test_what_is_no_store_is_refused_before_the_run(store):
    with pytest.raises(
        hi.ConfigError, match=r"^store: must be a folder, or an object with the methods trials"
    ):
        hi.run(MADE, store=store)


@pytest.mark.parametrize("executor", ["two", True, object(), 1.5])
def test_what_is_no_executor_is_refused_before_the_run(executor):
    with pytest.raises(hi.ConfigError, match=r"^executor: must be a number of worker processes"):
        hi.run(MADE, executor=executor)


@pytest.mark.parametrize(
    ("trial", "said"),
    [
        (Scores(np.array([-1]), np.zeros((1, 1))), "trial -1 with 1"),
        (Scores(np.array([0]), np.zeros((1, 2))), "trial 0 with 2"),
    ],
)
def test_a_store_that_gives_what_was_not_asked_for_is_told_so(trial, said):
    class Odd(MemoryStore):
        def trials(self, key, below):
            return [trial]

    with pytest.raises(StoreError, match=f"^the store gives {said} values, where trials 0 to 3 have 1: "):
        hi.run(MADE, store=Odd())


def test_an_object_that_keeps_trials_is_a_store(results):
    store = MemoryStore()
    for _ in range(2):
        pd.testing.assert_frame_equal(hi.run(MADE, store=store).frame(), results.frame(), check_exact=True)
    keys = [key for keys in hi.validate(MADE).keys for key in keys.values()]
    assert [sum(len(one.trials) for one in store.trials(key, 9)) for key in keys] == [4] * 4


def test_any_executor_gives_the_same_numbers(results):
    with ThreadPoolExecutor(2) as pool:
        found = hi.run(MADE, executor=pool)
    pd.testing.assert_frame_equal(found.frame(), results.frame(), check_exact=True)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: hi.run("nowhere.yaml"), "nowhere.yaml: no such file"),
        (lambda: hi.run(MADE, trials=0), "trials=0: trials: must be greater than or equal to 1 (got 0)"),
        (
            lambda: hi.run({**MADE, "metrics": {"a": hi.Error(of=["a_2"])}}),
            "experiment: metrics.a: the metric 'error' needs the value a_2 of the system, which "
            "'hammerstein' does not have (it has: linear, nonlinearity, response, value a_1, value b_0)",
        ),
        (
            lambda: hi.simulate(SYSTEM, "idd", 50),
            "simulate: excitation: unknown excitation; did you mean 'iid'? (allowed: experiments, filtered, "
            "iid, multisine, multistep, prbs, sine, staircase, stepped_sine) (got 'idd')",
        ),
        (
            lambda: hi.simulate(hi.Wiener(nonlinearity="abs", linear=hi.Continuous(a=[1])), EXCITATION, 9),
            "simulate: system: a continuous block needs the sampling interval 'dt' of the data",
        ),
        (
            lambda: hi.fit(IV, hi.Record(np.ones(2), np.ones(2))),
            "estimator 'instrumental_variables' needs at least 4 samples, and the record has 2",
        ),
        (
            lambda: hi.fit(hi.CramerRao(lags=2, degree=2, variance=1), hi.Record(np.ones(99), np.ones(99))),
            "estimator 'cramer_rao' needs the linear of the truth, which is not there (it has none)",
        ),
        (
            lambda: hi.score(
                hi.Estimate(values={"a_1": 1}), hi.Record(np.ones(1), np.ones(1)), a=hi.Error(of=["a_1"])
            ),
            "a: the metric 'error' needs the value a_1 of the truth, which is not there (it has none)",
        ),
        (
            lambda: hi.score(
                hi.Estimate(values={"a_1": 1}), hi.Record(np.ones(1), np.ones(1)), b=hi.Value(of=["b_1"])
            ),
            "b: the metric 'value' needs the value b_1 of the estimate, which is not there "
            "(it has: value a_1)",
        ),
    ],
)
def test_what_is_wrong_is_said_in_one_line(call, message):
    with pytest.raises(ConfigError) as caught:
        call()
    assert str(caught.value) == message


def test_what_is_defined_at_a_prompt_runs_here_only(tmp_path, monkeypatch):
    monkeypatch.setattr("hident.config.spec._REGISTER", {**_register()})

    @component("estimator", "at_a_prompt")
    class Typed(EstimatorSpec):
        """Of no file."""

        def names(self):
            return ["a_1"]

        def fit(self, record, rng=None):
            return hi.Estimate(values={"a_1": rng.random()})

    Typed.__module__ = "typed_in"
    source = {**MADE, "estimators": {"typed": Typed()}}
    assert hi.run(source).frame()["trials"].to_list() == [4, 4]
    message = "Typed was defined at a prompt or in a notebook, where a store or a worker process cannot find"
    for given in ({"store": tmp_path}, {"executor": 2}):
        with pytest.raises(ConfigError, match=message):
            hi.run(source, **given)


def test_a_crash_carries_its_traceback(monkeypatch, tmp_path):
    def crash(self, record, rng=None):
        raise RuntimeError("a fault of the method")

    monkeypatch.setattr(hi.KnownDynamics, "fit", crash)
    with pytest.raises(TrialsCrashed, match="a fault of the method") as caught:
        hi.run(MADE)
    assert "in crash" in "".join(caught.value.__notes__)
    assert str(caught.value).endswith(
        "\nWithout a store no trial is kept; with one, a run after the repair resumes."
    )
    with pytest.raises(TrialsCrashed, match="All finished trials are kept; a run after the repair resumes"):
        hi.run(MADE, store=tmp_path)


class _Broken(Executor):
    """An executor whose workers have ended."""

    def submit(self, fn, /, *args, **kwargs):
        future: Future[object] = Future()
        future.set_exception(BrokenExecutor("gone"))
        return future


@pytest.mark.parametrize(
    ("kept", "given"),
    [("Without a store no trial is kept", False), ("All finished trials are kept", True)],
)
def test_a_worker_that_ends_may_lack_the_guard_of_its_script(tmp_path, kept, given):
    with pytest.raises(TrialsCrashed) as caught:
        hi.run(MADE, executor=_Broken(), store=tmp_path if given else None)
    assert str(caught.value) == (
        "a worker process ended abruptly: it was killed, perhaps for want of memory, or an estimator ended "
        "it, or it ran the script that started it from the top, as each worker does, where the call is not "
        f'under `if __name__ == "__main__":`.\n{kept}: run again, with fewer workers if memory is short.'
    )


def _register():
    from hident.config import spec

    return {family: dict(kinds) for family, kinds in spec._REGISTER.items()}


def test_the_schema_takes_variables_in_the_place_of_samples_as_that_of_the_command_line_does():
    assert {"$ref": "#/$defs/variable"} in hi.schema()["properties"]["samples"]["anyOf"]


def test_streams_that_are_defined_at_a_prompt_run_here_only(tmp_path, monkeypatch):
    monkeypatch.setattr("hident.config.spec._REGISTER", {**_register()})

    @component("streams", "at_a_prompt")
    class Typed(NumpyStreams):
        """Of no file."""

    Typed.__module__ = "typed_in"
    with pytest.raises(ConfigError, match="Typed was defined at a prompt or in a notebook"):
        hi.run({**MADE, "streams": Typed()}, store=tmp_path)


def test_what_numbers_at_the_edge_of_arithmetic_lead_to_is_an_error_and_no_warning():
    with pytest.raises(ConfigError, match=r"^experiment: system\.output_linear: "):
        hi.validate(
            {
                "version": 1,
                "title": "tests",
                "trials": 1,
                "dt": 0.1,
                "samples": 50,
                "system": {
                    "kind": "wiener_hammerstein",
                    "input_linear": {"kind": "continuous", "a": [1]},
                    "nonlinearity": "abs",
                    "output_linear": {"kind": "continuous", "a": [105, 5e-324]},
                },
                "excitation": {"kind": "iid", "distribution": "uniform", "low": -1, "high": 1},
                "estimators": {"known": {"kind": "known_dynamics", "a": [0.5]}},
                "metrics": {"a": {"kind": "value", "of": ["a_1"]}},
            }
        )
