"""hident.testing finds what is wrong with a component, and says what to do."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

import hident as hi
from hident import plugins
from hident.config import spec
from hident.config.spec import components
from hident.estimators.base import EstimatorSpec
from hident.records import Truth
from hident.testing import check, checks, plugin
from hident.testing.systems import MemoryContract

plugins.load()
_SOUND = '''
import numpy as np

from hident.config.spec import Real, component
from hident.errors import EstimationError
from hident.estimators.base import POWERS, AtOneInterval, require_usable
from hident.metrics.base import MetricSpec
from hident.records import Estimate
from hident.signals.base import ExcitationSpec, NoiseSpec
from hident.systems.base import NonlinearitySpec, SystemSpec

SEEN = []


@component("estimator", "slope")
class Slope(AtOneInterval):
    """Slope of a line through the origin, by least squares."""

    weight: Real = 1.0
    """A factor."""

    holds = ("nonlinearity",)

    def names(self):
        return ["c_1"]

    def letters(self):
        return {"c": POWERS}

    def fit(self, record, rng=None):
        self.require_experiments(record)
        require_usable(record)
        if len(np.unique(record.u)) < 3:
            raise EstimationError("an input of two levels does not tell a line from other curves")
        c = record.u @ record.y / (record.u @ record.u)
        return Estimate(nonlinearity=np.polynomial.Polynomial([0.0, c]), values=self.named(c))
'''
_FIT = "        c = record.u @ record.y / (record.u @ record.u)\n"
# What is planted in the place of what, and what is said of it.
_FAULTS = {
    "writes": (
        _FIT,
        f"        u = record.u\n        u *= 2\n{_FIT}",
        "fit writes to",
    ),
    "state": (
        _FIT,
        f"{_FIT}        SEEN.append(c)\n        c += 1e-9 * len(SEEN)\n",
        "the same record and stream give another estimate",
    ),
    "holds": ('    holds = ("nonlinearity",)\n', "", "the estimate holds ['nonlinearity']: name it in holds"),
    "lacks": ('("nonlinearity",)', '("nonlinearity", "linear")', "say ['linear'], which the estimate lacks"),
    "crashes": (
        "        if len(np",
        "        record.y[9]\n        if len(np",
        "crashes on a record of 2 samples with IndexError",
    ),
    "dull": ("        require_usable(record)\n", "", "a constant output gives an estimate"),
    "curve": ("        require_usable(record)\n", "", "an output that holds nan gives an estimate"),
    "reason": ('"an input of two levels does not tell a line from other curves"', "", "without a reason"),
    "experiments": (_FIT, _FIT + "        c += record.y[0]\n", "another order of the experiments gives"),
    "silent": (
        "        self.require_experiments(record)\n",
        "",
        "begin it with self.require_experiments(record)",
    ),
    "float": ("self.named(c)", '{"c_1": np.float32(c)}', "are no floats"),
    "letters": (
        '    def letters(self):\n        return {"c": POWERS}\n',
        "",
        "letters() does not say what c_1 are",
    ),
    "summary": (", by least squares.", "", "must be a sentence of 10 to 100 characters"),
    "field": ('    """A factor."""\n', "", "Slope.weight: a text must stand under the field"),
    "batch": (
        "    def fit(self",
        "    def fit_many(self, records):\n"
        "        found = [self.fit(record) for record in records]\n"
        "        later = [Estimate(one.nonlinearity, values={'c_1': 0.0}) for one in found[3:]]\n"
        "        return [*found[:3], *later]\n\n    def fit(self",
        "the estimates of trials [3, 4] depend on the trials beside them",
    ),
}


@pytest.fixture(autouse=True)
def _own_register(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test registers is forgotten after it."""
    register = {str(family): components(family) for family in spec.PLURALS.values()}
    monkeypatch.setattr(spec, "_REGISTER", register)


def _made(folder: Path, text: str) -> Callable[..., EstimatorSpec]:
    (folder / "slope.py").write_text(text, encoding="utf-8")
    made: Callable[..., EstimatorSpec] = plugin(folder / "slope.py").Slope
    return made


def test_a_sound_plugin_passes(tmp_path: Path) -> None:
    slope = _made(tmp_path, _SOUND)
    check(slope(weight=2))
    names = [str(one) for one in checks(slope())]
    assert names[0] == "slope is registered"
    assert "slope leaves the record as it is" in names
    assert len({*names}) == len(names)


@pytest.mark.parametrize("fault", _FAULTS)
def test_a_planted_fault_is_found(fault: str, tmp_path: Path) -> None:
    old, new, said = _FAULTS[fault]
    assert _SOUND.count(old) == 1
    slope = _made(tmp_path, _SOUND.replace(old, new))
    with pytest.raises(AssertionError) as caught:
        check(slope())
    assert said in str(caught.value)


def test_what_a_method_promises_besides_is_checked(tmp_path: Path) -> None:
    slope = _made(tmp_path, _SOUND)
    check(slope(), invariances=["scale", "order"])
    looks_back = _SOUND.replace("record.u @ record.y /", "record.u[1:] @ record.y[:-1] /")
    (tmp_path / "other").mkdir()
    slope = _made(tmp_path / "other", looks_back.replace('"slope"', '"late_slope"'))
    with pytest.raises(AssertionError, match="another order of the samples gives another estimate"):
        check(slope(), invariances=["order"])


class _Square(hi.DeadZone):
    """A nonlinearity that is wrong in some way."""

    how: ClassVar[str] = ""

    def __call__(self, u):
        match self.how:
            case "writes":
                u *= u
                return u
            case "shape":
                return u.ravel() ** 2
            case "neighbours":
                return u**2 + np.arange(u.size).reshape(u.shape)
            case _:
                return u**2

    def break_points(self):
        return (1.0, -1.0)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("writes", "it writes to the points"),
        ("shape", "it gives shape (60,)"),
        ("neighbours", "a value depends on the points beside it"),
        ("breaks", "the break points (1.0, -1.0) do not increase"),
        ("class", "another class is the nonlinearity 'dead_zone'"),
    ],
)
def test_faults_of_a_nonlinearity(how: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_Square, "how", how)
    with pytest.raises(AssertionError) as caught:
        check(_Square(low=-1, high=1))
    assert said in str(caught.value)
    # What one writes to, no other is tried on.
    check(hi.Power(exponent=2))


class _Play(hi.Backlash):
    """A nonlinearity with memory that is wrong in some way."""

    how: ClassVar[str] = ""
    calls: ClassVar[list[int]] = []

    def characteristic(self):
        return np.abs if self.how == "function" else None

    def simulate(self, u):
        match self.how:
            case "own":
                return u
            case "shape":
                return u[1:]
            case "ahead":
                return np.roll(u, -1)
            case "remembers":
                self.calls.append(1)
                return u + len(self.calls)
        return super().simulate(u)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("own", "its output is the array of its signal"),
        ("shape", "it gives shape (120,)"),
        ("ahead", "an output depends on later samples"),
        ("remembers", "a state is left behind"),
        ("function", "it says that it is a function of its input"),
    ],
)
def test_faults_of_a_nonlinearity_with_memory(how: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_Play, "how", how)
    found = []
    for one in MemoryContract(_Play(width=0.5)).checks():
        try:
            one()
        except AssertionError as error:
            found.append(str(error))
    assert any(said in message for message in found)


class _Delay(hi.Hammerstein):
    """A system that is wrong in some way."""

    how: ClassVar[str] = ""

    def simulate(self, u, dt=1.0):
        match self.how:
            case "ahead":
                return np.roll(u, -1)
            case "own":
                return u
            case "short":
                return u[1:]
        return 2.0 * u

    def truth(self):
        return Truth(response=lambda u, dt: 3.0 * u, values={"b_0": 2})


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("ahead", "an output depends on later inputs"),
        ("own", "its output is the array of its input"),
        ("short", "its output has (299,)"),
        ("", "the response of the truth is another"),
        ("", "the true values ['b_0'] are no floats"),
    ],
)
def test_faults_of_a_system(how: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_Delay, "how", how)
    system = _Delay(nonlinearity="identity", linear=hi.Fir(b=[1]))
    with pytest.raises(AssertionError) as caught:
        check(system)
    assert said in str(caught.value)


class _Follows(hi.WienerHammerstein):
    """A system in continuous time that is wrong in some way."""

    how: ClassVar[str] = ""

    def respond(self, waveform, n, dt):
        y = super().respond(waveform, n, dt)
        match self.how:
            case "short":
                return y[1:]
            case "whole":
                return y - y.mean()
            case "random":
                return y + np.random.default_rng().random()
        return y


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("short", "of 300 samples its output has the shape (299,)"),
        ("whole", "a shorter record is not the beginning of a longer one"),
        ("random", "the same signal gives another output"),
    ],
)
def test_faults_of_a_system_that_follows_waveforms(
    how: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_Follows, "how", how)
    block = hi.Continuous(a=[0.5])
    with pytest.raises(AssertionError) as caught:
        check(_Follows(input_linear=block, nonlinearity="abs", output_linear=block), data={"dt": 0.5})
    assert said in str(caught.value)


class _Draws(hi.Iid):
    """An excitation that is wrong in some way."""

    how: ClassVar[str] = ""

    def sample(self, n, dt, rng, burn_in=0):
        match self.how:
            case "own stream":
                rng = np.random.default_rng()
            case "no burn-in":
                burn_in = 0
        return rng.uniform(-1, 1, burn_in + n)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("own stream", "equal generators give other samples"),
        ("no burn-in", "after 7 of burn-in it gives an array of shape (300,)"),
        ("order", "the record depends on burn_in"),
    ],
)
def test_faults_of_an_excitation(how: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_Draws, "how", how)
    with pytest.raises(AssertionError) as caught:
        check(_Draws(distribution="uniform", low=-1, high=1))
    assert said in str(caught.value)


class _Disturbs(hi.White):
    """A noise that draws from a stream of its own, or loses a sample."""

    how: ClassVar[str] = ""

    def measure(self, output, rng):
        if self.how == "short":
            return output[1:]
        return output + np.random.default_rng().normal(size=len(output))


@pytest.mark.parametrize(
    ("how", "said"), [("short", "it makes shape (299,)"), ("", "equal generators give other noise")]
)
def test_faults_of_a_noise(how: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_Disturbs, "how", how)
    with pytest.raises(AssertionError) as caught:
        check(_Disturbs(std=1))
    assert said in str(caught.value)


class _Counts(hi.Error):
    """A metric that is wrong in some way."""

    how: ClassVar[str] = ""

    def evaluate(self, estimate, record):
        match self.how:
            case "labels":
                return (1.0, 2.0)
            case "needs":
                return (float(estimate.nonlinearity(np.ones(1))[0]),)
            case "random":
                return (np.random.default_rng().random(),)
            case "writes":
                record.y[0] = 1.0
        return (1.0,)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("labels", "gives 2 numbers, and has the labels"),
        ("needs", "needs more than needs_of_truth() and needs_of_estimate() say"),
        ("random", "the same estimate scores"),
        ("writes", "evaluate writes to record.y"),
    ],
)
def test_faults_of_a_metric(how: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_Counts, "how", how)
    with pytest.raises(AssertionError) as caught:
        check(_Counts(of=["a_1"]))
    assert said in str(caught.value)


def test_a_metric_on_what_an_estimator_makes() -> None:
    check(hi.Value(of=["a_1"]), estimator=hi.KnownDynamics(a=[0.5]))
    with pytest.raises(AssertionError, match="needs the value se_a_1 of the estimate: give an 'estimator'"):
        check(hi.Value(of=["se_a_1"]))


def test_wrong_data_are_a_configuration_error() -> None:
    with pytest.raises(hi.ConfigError, match="sample: unknown key; did you mean 'samples'"):
        checks(hi.KnownDynamics(a=[0.5]), data={"sample": 3})


def test_an_estimator_that_says_why() -> None:
    with pytest.raises(AssertionError, match="learns_from="):
        check(hi.KnownDynamics(a=[0.5]))
    check(hi.KnownDynamics(a=[0.5]), learns_from=["constant input", "constant output", "period of two"])
