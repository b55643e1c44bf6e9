"""Components made in Python: what they take besides what a file holds, and what they say of the rest."""

import numpy as np
import pytest

from hident import plugins
from hident.config.spec import Of
from hident.engine.cases import Cases
from hident.errors import ConfigError
from hident.estimators.nonparametric.known_dynamics import KnownDynamics
from hident.records import Record
from hident.signals.excitation import Iid
from hident.systems.blocks import Hammerstein
from hident.systems.linear import Ar, Fir
from hident.systems.nonlinearity import Abs

plugins.load()
WRITTEN = {"kind": "hammerstein", "nonlinearity": "abs", "linear": {"kind": "ar", "a": [0.5]}}


@pytest.mark.parametrize("nonlinearity", [Abs(), "abs", {"kind": "abs"}])
@pytest.mark.parametrize("linear", [Ar(a=(0.5,)), {"kind": "ar", "a": [0.5]}])
def test_a_component_takes_components_and_their_written_forms(nonlinearity, linear):
    assert Hammerstein(nonlinearity=nonlinearity, linear=linear) == Of("system").validate(WRITTEN)


@pytest.mark.parametrize("b", [np.array([1.0, 2.0]), [np.int64(1), np.float32(2)], (1, 2), ["1", "2"]])
def test_a_component_takes_the_arrays_and_the_numbers_of_numpy(b):
    assert Fir(b=b).b == (1.0, 2.0)
    assert Iid(distribution="gaussian", std=np.int32(2)).std == 2.0


def test_a_component_says_what_is_wrong_in_the_words_of_a_file():
    with pytest.raises(ConfigError) as caught:
        Hammerstein(nonlinearity="asb", linear={"kind": "ar", "a": [2]}, noise=1)  # type: ignore[call-arg]
    first, second, third = str(caught.value).splitlines()
    assert first.startswith("Hammerstein: nonlinearity: unknown nonlinearity; did you mean 'abs'? (allowed: ")
    assert second == "Hammerstein: linear: is unstable: poles 2 lie on or outside the unit circle"
    assert third == "Hammerstein: noise: unknown key (allowed: nonlinearity, linear)"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Ar(a=[2]), "Ar: is unstable: poles 2 lie on or outside the unit circle"),
        (Ar, "Ar: a: is required: Feedback a_1, ..., a_p"),
        (
            lambda: Hammerstein(nonlinearity=Abs(), linear=Abs()),
            "Hammerstein: linear: must be a linear, not the nonlinearity 'abs' "
            "(allowed: ar, arma, continuous, continuous_zpk, fir, sos, zpk)",
        ),
        (
            lambda: Cases(cases={"samples": []}),
            "Cases: cases.samples: must hold at least one value (got [])",
        ),
    ],
)
def test_what_is_wrong_stands_in_one_line(make, message):
    with pytest.raises(ConfigError) as caught:
        make()
    assert str(caught.value) == message


def test_a_record_takes_lists():
    record = Record([1, 2], [3, 4])  # type: ignore[arg-type]
    assert record.u.dtype == record.y.dtype == np.float64
    assert KnownDynamics(a=[0.5]).fit(record).values == {"a_1": 0.5, "b_0": 1.0}


def test_a_truth_and_an_estimate_say_what_they_hold():
    assert Hammerstein(nonlinearity=Abs(), linear=Ar(a=[0.5])).truth().provides() == {
        *("nonlinearity", "linear", "response", "value a_1", "value b_0"),
    }
    assert KnownDynamics(a=[0.5]).fit(Record(np.ones(3), np.ones(3))).provides() == {
        *("linear", "value a_1", "value b_0"),
    }
