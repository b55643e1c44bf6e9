"""The data of a trial depend on the seed, their own part of the case and the trial, and on nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import pytest

from hident import plugins
from hident.arrays import Array
from hident.config.spec import component
from hident.engine.clock import Limit
from hident.engine.experiment import load
from hident.engine.trial import Data, Job, digest, generate
from hident.errors import EstimationError, SimulationError
from hident.estimators.base import EstimatorSpec
from hident.estimators.nonparametric.least_squares import LeastSquares
from hident.metrics.base import MetricSpec
from hident.metrics.values import Value
from hident.records import Estimate, Record, Truth
from hident.signals.base import NoiseSpec
from hident.signals.streams import NumpyStreams, Role
from hident.systems.base import SystemSpec
from tests.unit.tried import Tried, tried

if TYPE_CHECKING:
    from hident.engine.experiment import Plan
    from tests.conftest import Lab

plugins.load()


@component("estimator", "witness")
class Witness(EstimatorSpec):
    """Keeps what it is given."""

    seen: ClassVar[list[tuple[Record, float]]] = []
    gain: float = 1.0
    raises: str = ""

    def names(self) -> list[str]:
        return ["a_1"]

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        match self.raises:
            case "estimation":
                raise EstimationError("diverged")
            case "singular":
                np.linalg.inv(np.zeros((2, 2)))
            case "linalg":
                raise np.linalg.LinAlgError
            case "crash":
                raise ValueError("not a result")
            case "exit":
                raise SystemExit(1)
            case "u" | "y":
                getattr(record, self.raises)[0] = 0.0
        assert rng is not None
        self.seen.append((record, rng.random()))
        return Estimate(values={"a_1": self.gain})


@component("metric", "short")
class Short(MetricSpec):
    """Gives fewer numbers than it has labels."""

    def labels(self, name: str) -> tuple[str, ...]:
        return name, f"{name} too"

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        return [1.0]


@component("noise", "broken")
class Broken(NoiseSpec):
    """Crashes while the data are made."""

    def measure(self, y: Any, rng: np.random.Generator) -> Any:
        raise RuntimeError("no data")


@pytest.fixture(autouse=True)
def _forgetful() -> None:
    Witness.seen.clear()


def _plan(lab: Lab, **changes: Any) -> Plan:
    lab.configure(**changes)
    return load(lab.folder / "tiny.yaml")


def _records(plan: Plan, seed: int = 7) -> dict[tuple[int, int], bytes]:
    return {
        (unit.data.samples, trial): (record.u.tobytes() + record.y.tobytes())
        for unit in plan.units
        for trial in range(3)
        for record in [generate(unit.data, seed, trial)]
    }


def _outcomes(plan: Plan, *jobs: Job, trials: int = 1) -> list[Tried]:
    return tried(plan.units[0].data, jobs, {trial: range(len(jobs)) for trial in range(trials)}, seed=7)


_A = (Value(of=("a_1",)),)


def test_data_depend_on_nothing_but_their_part_of_the_case(lab: Lab) -> None:
    before = _records(_plan(lab))
    assert len(set(before.values())) == 6
    others = {
        "estimators": {"iv": {"kind": "instrumental_variables", "order": 1, "instrument": "sign"}},
        "trials": 100,
        "cases": {"samples": [80, 50]},
        "title": "Another",
    }
    assert _records(_plan(lab, **others, tables={})) == before
    assert not set(_records(_plan(lab), seed=8).values()) & set(before.values())
    assert not set(_records(_plan(lab, noise=[])).values()) & set(before.values())


def test_case_makes_the_same_data_as_a_file_of_its_own(lab: Lab) -> None:
    together = _records(_plan(lab))
    alone = _records(_plan(lab, cases={}, samples=80, tables={}))
    assert alone == {key: value for key, value in together.items() if key[0] == 80}


def test_streams_of_input_noise_and_estimator_are_apart(lab: Lab) -> None:
    data = _plan(lab).units[0].data
    roles: tuple[Role, ...] = ("input", "noise", "estimator")
    draws = {
        data.streams.generator(role, 7, data.key, trial).random() for role in roles for trial in range(3)
    }
    assert len(draws) == 9


def test_fixed_input_is_the_same_in_all_trials(lab: Lab) -> None:
    plan = _plan(lab, streams={"kind": "numpy", "fixed": ["input"]})
    first, second = (generate(plan.units[0].data, 7, trial) for trial in range(2))
    np.testing.assert_array_equal(first.u, second.u)
    assert not np.any(first.y == second.y)


def test_all_estimators_of_a_case_see_one_record_and_draw_their_own_numbers(lab: Lab) -> None:
    jobs = [Job(Witness(gain=gain), _A) for gain in (1.0, 2.0)]
    outcomes = _outcomes(_plan(lab), *jobs)
    assert [outcome.values.tolist() for outcome in outcomes] == [[1.0], [2.0]]
    (first, one), (second, two) = Witness.seen
    assert first is second
    assert one != two


def test_numbers_that_an_estimator_draws_do_not_depend_on_the_others(lab: Lab) -> None:
    plan = _plan(lab)
    job = Job(Witness(gain=2.0), _A)
    _outcomes(plan, job)
    _outcomes(plan, Job(Witness(), _A), job)
    assert Witness.seen[0][1] == Witness.seen[2][1]


@pytest.mark.parametrize(
    ("raises", "why"), [("estimation", "diverged"), ("singular", "Singular matrix"), ("linalg", "singular")]
)
def test_a_failed_estimate_is_a_result(lab: Lab, raises: str, why: str) -> None:
    (outcome,) = _outcomes(_plan(lab), Job(Witness(raises=raises), (*_A, *_A)))
    assert [(score.failure, score.crash) for score in outcome.scores] == [(why, ""), (why, "")]
    assert np.isnan(outcome.values).tolist() == [True, True]


@pytest.mark.parametrize(
    ("raises", "why"),
    [
        ("crash", "ValueError: not a result"),
        ("exit", "SystemExit: 1"),
        ("u", "ValueError: assignment destination is read-only"),
        ("y", "ValueError: assignment destination is read-only"),
    ],
)
def test_a_crash_is_no_result_and_ends_no_other(lab: Lab, raises: str, why: str) -> None:
    crashed, fine = _outcomes(_plan(lab), Job(Witness(raises=raises), _A), Job(Witness(), _A))
    (score,) = crashed.scores
    assert score.failure == why
    assert score.crash.startswith("Traceback")
    assert "in fit" in score.crash
    assert fine.values.tolist() == [1.0]
    assert fine.scores[0].crash == ""


def test_a_crash_while_data_are_made_is_one_of_every_estimator(lab: Lab) -> None:
    plan = _plan(lab, noise="broken")
    outcomes = _outcomes(plan, Job(Witness(), _A), Job(Witness(gain=2.0), _A), trials=2)
    assert [(o.trial, o.job, o.scores[0].failure) for o in outcomes] == [
        (trial, job, "RuntimeError: no data") for trial in range(2) for job in range(2)
    ]


def test_a_metric_that_gives_too_few_numbers_crashes(lab: Lab) -> None:
    (outcome,) = _outcomes(_plan(lab), Job(Witness(), (Short(),)))
    assert outcome.scores[0].failure == "ValueError: the metric 'short' gives 1 values for 2 labels"


def test_digest_depends_on_values_and_not_on_the_order_of_keys() -> None:
    assert digest({"a": 0.1, "b": [1]}) == digest({"b": [1], "a": 0.1})
    different = [{"a": 0.1}, {"a": np.nextafter(0.1, 1.0)}, {"a": 1}, {"a": 1.0}, {"a": "1"}, {"b": 0.1}]
    assert len({digest(value) for value in different}) == len(different)
    assert len(digest({})) == 32


@component("system", "stuck")
class Stuck(SystemSpec):
    """Does not converge."""

    def simulate(self, u: Array, dt: float = 1.0) -> Array:
        raise SimulationError("stopped at t = 3")

    def truth(self) -> Truth:
        return Truth()


def test_a_simulation_that_fails_is_a_failed_trial_of_every_estimator(lab: Lab) -> None:
    data = _plan(lab).units[0].data.model_copy(update={"system": Stuck()})
    jobs = [Job(Witness(), _A), Job(Witness(gain=2.0), (*_A, *_A))]
    outcomes = tried(data, jobs, {0: [0, 1], 1: [1]}, seed=7)
    assert [(o.trial, o.job, o.scores[0].failure, o.scores[0].crash) for o in outcomes] == [
        (0, 0, "stopped at t = 3", ""),
        (0, 1, "stopped at t = 3", ""),
        (1, 1, "stopped at t = 3", ""),
    ]
    assert [len(o.values) for o in outcomes] == [1, 2, 2]
    assert all(np.isnan(o.values).all() for o in outcomes)
    assert not Witness.seen


@component("estimator", "together")
class Together(EstimatorSpec):
    """Fits many records at once: each by its last output, those above the limit fail."""

    limit: float = 1e300
    crash: bool = False
    calls: ClassVar[list[int]] = []

    def draws(self) -> bool:
        return False

    def names(self) -> list[str]:
        return ["a_1"]

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        [found] = self.fit_many([record])
        if isinstance(found, EstimationError):
            raise found
        return found

    def fit_many(self, records: Sequence[Record]) -> list[Estimate | EstimationError]:
        self.calls.append(len(records))
        if self.crash and any(record.y[-1] > self.limit for record in records):
            raise ZeroDivisionError
        return [
            EstimationError(f"{record.y[-1]:g} is too large")
            if record.y[-1] > self.limit
            else Estimate(values={"a_1": float(record.y[-1])})
            for record in records
        ]


@pytest.mark.parametrize("crash", [False, True])
def test_an_estimator_of_many_records_is_asked_for_all_and_fails_where_each_by_itself_fails(
    lab: Lab, crash: bool
) -> None:
    data = _plan(lab).units[0].data
    last = [generate(data, 7, trial).y[-1] for trial in range(6)]
    limit = float(np.median(last))
    Together.calls.clear()
    outcomes = tried(data, [Job(Together(limit=limit, crash=crash), _A)], {t: [0] for t in range(6)}, seed=7)
    # Of the others, one is held against fit.
    assert Together.calls == ([6, 1, 1, 1, 1, 1, 1] if crash else [6, 1])
    for outcome, y in zip(outcomes, last, strict=True):
        failure = "" if y <= limit else "ZeroDivisionError: " if crash else f"{y:g} is too large"
        assert outcome.scores[0].failure == failure
        assert outcome.values[0] == y if y <= limit else np.isnan(outcome.values[0])


class Endless(Together):
    """Never ends where the last output is above the limit; or, of many records at once, always."""

    only_together: bool = False

    def fit_many(self, records: Sequence[Record]) -> list[Estimate | EstimationError]:
        alone = len(records) == 1
        while not (alone if self.only_together else all(record.y[-1] <= self.limit for record in records)):
            pass
        return super().fit_many(records)


@pytest.mark.parametrize("only_together", [False, True])
def test_a_batch_that_takes_too_long_is_made_trial_by_trial_under_the_clock(
    lab: Lab, only_together: bool
) -> None:
    data = _plan(lab).units[0].data
    last = [generate(data, 7, trial).y[-1] for trial in range(3)]
    highest = max(last)
    limit = highest if only_together else sorted(last)[1]
    job = Job(Endless(limit=limit, only_together=only_together), _A)
    outcomes = tried(data, [job], {t: [0] for t in range(3)}, 7, limit=Limit(1.0))
    for outcome, y in zip(outcomes, last, strict=True):
        (score,) = outcome.scores
        assert score.late == (y == highest and not only_together)
        assert score.failure == ("took longer than the trial timeout of 1 s" if score.late else "")
        assert np.isnan(score.values[0]) if score.late else score.values[0] == y


class Doubled(Together):
    """Overrides ``fit`` alone."""

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        return Estimate(values={"a_1": 2.0 * super().fit(record).values["a_1"]})


class Drawing(Together):
    """Draws, and says so."""

    def draws(self) -> bool:
        return True


class Wrong(Together):
    """Has a faulty ``fit_many``."""

    how: str

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        return Estimate(values={"a_1": float(record.y[-1])})

    def fit_many(self, records: Sequence[Record]) -> list[Estimate | EstimationError]:
        found: list[Any] = [self.fit(record) for record in records]
        match self.how:
            case "few":
                return found[1:]
            case "kind":
                return [*found[1:], 0.5]
            case "other":
                return [Estimate(values={"a_1": one.values["a_1"] * (1.0 + 1e-15)}) for one in found]
            case "raises":
                raise AttributeError("a slip")
        raise AssertionError


def test_a_fit_that_a_subclass_writes_is_used_and_so_is_that_of_one_that_draws(lab: Lab) -> None:
    data = _plan(lab).units[0].data
    last = [generate(data, 7, trial).y[-1] for trial in range(4)]
    Together.calls.clear()
    wanted = {trial: [0, 1] for trial in range(4)}
    outcomes = tried(data, [Job(Doubled(), _A), Job(Drawing(), _A)], wanted, seed=7)
    assert [o.values[0] for o in outcomes] == [factor * y for y in last for factor in (2.0, 1.0)]
    assert set(Together.calls) == {1}


class DrawingTogether(Drawing):
    """Draws for many records at once, from the stream of each."""

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        assert rng is not None
        [found] = self.fit_many([record], [rng])
        assert isinstance(found, Estimate)
        return found

    def fit_many(
        self, records: Sequence[Record], rngs: Sequence[np.random.Generator] | None = None
    ) -> list[Estimate | EstimationError]:
        assert rngs is not None
        self.calls.append(len(records))
        return [Estimate(values={"a_1": rng.random()}) for _, rng in zip(records, rngs, strict=True)]


def test_one_that_draws_for_many_records_at_once_draws_as_for_each(lab: Lab) -> None:
    data = _plan(lab).units[0].data
    Together.calls.clear()
    job = Job(DrawingTogether(), _A)
    together = tried(data, [job], {trial: [0] for trial in range(5)}, seed=7)
    # One is held against fit.
    assert Together.calls == [5, 1]
    alone = [one for trial in range(5) for one in tried(data, [job], {trial: [0]}, seed=7)]
    values = [one.values[0] for one in together]
    assert values == [one.values[0] for one in alone]
    assert len({*values}) == 5


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("few", "TypeError: fit_many of Wrong gave 3 estimates for 4 records"),
        ("kind", "TypeError: fit_many of Wrong gave a float where an Estimate or an EstimationError belongs"),
        ("other", "ValueError: fit_many gives a_1 = "),
        ("raises", "AttributeError: a slip"),
    ],
)
def test_a_faulty_fit_many_is_a_crash_of_its_estimator_alone(lab: Lab, how: str, message: str) -> None:
    data = _plan(lab).units[0].data
    wanted = {trial: [0, 1] for trial in range(4)}
    outcomes = tried(data, [Job(Wrong(how=how), _A), Job(Together(), _A)], wanted, seed=7)
    for outcome in outcomes:
        score = outcome.scores[0]
        if outcome.job:
            assert np.isfinite(score.values).all()
        else:
            assert score.crash
            assert score.failure.startswith(message)


@component("noise", "in_place")
class InPlace(NoiseSpec):
    """Adds to the output where it stands."""

    def measure(self, output: Array, rng: np.random.Generator) -> Array:
        output += rng.standard_normal(len(output))
        return output


def test_a_noise_that_works_in_place_leaves_the_other_trials_of_a_fixed_input_alone(lab: Lab) -> None:
    fixed = {"streams": NumpyStreams(fixed=("input",)), "noise": (InPlace(), InPlace())}
    data = _plan(lab).units[0].data.model_copy(update=fixed)
    alone = [generate(data, 7, trial).y[-1] for trial in range(6)]
    outcomes = tried(data, [Job(Together(), _A)], {t: [0] for t in range(6)}, seed=7)
    assert [outcome.values[0] for outcome in outcomes] == alone


def test_trials_of_a_fixed_input_share_it_and_simulate_it_once(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = _plan(lab).units[0].data.model_copy(update={"streams": NumpyStreams(fixed=("input",))})
    simulate, calls = type(data.system).simulate, []

    def counted(self: SystemSpec, u: Array, dt: float) -> Array:
        calls.append(u)
        return simulate(self, u, dt)

    monkeypatch.setattr(type(data.system), "simulate", counted)
    tried(data, [Job(Together(), _A)], {t: [0] for t in range(6)}, seed=7)
    assert len(calls) == 1


def test_a_perturbation_moves_samples_toward_zero_by_one_unit_in_the_last_place(lab: Lab) -> None:
    data = _plan(lab).units[0].data
    plain, moved = generate(data, 7, 3), generate(data, 7, 3, perturbation=1)
    for before, after in ((plain.y, moved.y), (plain.u, moved.u)):
        toward_zero = np.nextafter(before, 0.0)
        assert ((after == before) | (after == toward_zero)).all()
        assert 0.2 < np.mean(after != before) < 0.8
    again = generate(data, 7, 3, perturbation=1)
    np.testing.assert_array_equal(again.y, moved.y)
    others = [generate(data, 7, 3, 2), generate(data, 8, 3, 1), generate(data, 7, 4, 1)]
    plains = [plain, generate(data, 8, 3), generate(data, 7, 4)]
    draws = [o.y != p.y for o, p in zip([moved, *others], [plain, *plains], strict=True)]
    assert len({draw.tobytes() for draw in draws}) == 4


def test_a_perturbed_held_input_keeps_its_levels_apart_and_equal_ones_equal(lab: Lab) -> None:
    lab.configure(
        excitation={"kind": "multistep", "switching_time": 5, "std": 1.25, "limits": [-2.5, 2.5]},
        system={"kind": "hammerstein", "nonlinearity": "identity", "linear": {"kind": "ar", "a": [0.5]}},
        tables={},
    )
    data = load(lab.folder / "tiny.yaml").units[0].data
    plain, moved = generate(data, 7, 0), generate(data, 7, 0, perturbation=1)
    assert (plain.u != moved.u).any()
    np.testing.assert_array_equal(np.diff(plain.u) == 0.0, np.diff(moved.u) == 0.0)


@component("metric", "cannot_simulate")
class CannotSimulate(MetricSpec):
    """Simulates what cannot be simulated."""

    def evaluate(self, estimate, record):
        raise SimulationError("the tank runs dry")


def test_a_simulation_that_fails_in_a_metric_is_a_failed_trial():
    data = Data.model_validate(
        {
            "samples": 100,
            "system": {
                "kind": "hammerstein",
                "nonlinearity": "identity",
                "linear": {"kind": "ar", "a": [0.5]},
            },
            "excitation": {"kind": "iid", "distribution": "gaussian", "std": 1},
        }
    )
    (outcome,) = tried(data, [Job(LeastSquares(order=1), (CannotSimulate(),))], {0: [0]}, 1)
    assert [(s.failure, s.crash) for s in outcome.scores] == [("metric: the tank runs dry", "")]
    assert np.isnan(outcome.values).all()
