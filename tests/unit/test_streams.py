"""Streams: which numbers each role draws in each trial."""

import math
from typing import Annotated, get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from hident.config.expression import FUNCTIONS
from hident.config.spec import Of, Spec, canonical
from hident.engine.trial import Data, Job, generate
from hident.estimators.nonparametric.least_squares import LeastSquares
from hident.metrics.values import Value
from hident.signals.excitation import Filtered, Iid, Multistep, Prbs
from hident.signals.matlab5 import Rand, Randn, twister
from hident.signals.matlab5_streams import Matlab5Streams
from hident.signals.noise import White
from hident.signals.streams import NumpyStreams, Role, StreamsSpec
from hident.systems.blocks import Hammerstein
from hident.systems.linear import Ar, Fir
from hident.systems.nonlinearity import Expression
from tests.unit.tried import tried

ROLES: tuple[Role, ...] = get_args(Role)
SEED, KEY = 1, 2**100 + 5


class Case(Spec):
    """What streams stand in."""

    streams: Annotated[StreamsSpec, Of("streams")]


def matlab5(**fields):
    return Case.model_validate({"streams": {"kind": "matlab5", **fields}}).streams


def refused(**fields):
    """The place and the message with which the fields are refused."""
    with pytest.raises(ValidationError) as caught:
        matlab5(**fields)
    (detail,) = caught.value.errors()
    return ".".join(map(str, detail["loc"])), detail["msg"]


def draws(streams, role, trial, seed=SEED, key=KEY):
    return tuple(streams.generator(role, seed, key, trial).random(3))


# --- numpy


def test_numpy_streams_differ_by_role_trial_seed_and_key():
    streams = NumpyStreams()
    everything = {
        draws(streams, role, trial, seed, key)
        for role in ROLES
        for trial in range(3)
        for seed in (1, 2)
        for key in (3, 4)
    }
    assert len(everything) == 3 * 3 * 2 * 2


@pytest.mark.parametrize(("role", "number"), [("input", 1), ("noise", 2), ("estimator", 3)])
def test_a_role_keeps_its_stream(role, number):
    sequence = np.random.SeedSequence([SEED, KEY], spawn_key=(number, 5))
    assert draws(NumpyStreams(), role, 4) == tuple(np.random.Generator(np.random.PCG64(sequence)).random(3))


def test_a_system_draws_nothing_and_has_no_stream():
    assert refused(system={"state": 1}) == (
        "streams.system",
        "unknown key (allowed: fixed, share, input, noise)",
    )
    assert refused(fixed=["system"]) == ("streams.fixed.0", "must be 'input' or 'noise'")


def test_numpy_streams_start_anew_where_fixed():
    streams = NumpyStreams(fixed=("input",))
    assert draws(streams, "input", 0) == draws(streams, "input", 1)
    assert draws(streams, "noise", 0) != draws(streams, "noise", 1)
    assert [role for role in ROLES if streams.is_fixed(role)] == ["input"]


# --- shared by all cases


def test_what_is_shared_belongs_to_the_hash_of_the_data_and_what_is_not_does_not():
    assert canonical(NumpyStreams()) == {"kind": "numpy"}
    assert canonical(NumpyStreams(share=("noise",))) == {"kind": "numpy", "share": ["noise"]}


def test_a_given_state_cannot_be_shared():
    assert refused(share=["input"], input={"state": 1}) == (
        "streams",
        "input starts from a given state, which all cases share: leave 'share' out",
    )


SHARED = Data(
    samples=60,
    system=Hammerstein(nonlinearity=Expression(expression="u + u**2"), linear=Ar(a=(0.5,))),
    excitation=Iid(distribution="uniform", low=-1.0, high=1.0),
    noise=(White(std=0.1),),
    streams=NumpyStreams(share=("input", "noise")),
)


def changed(**fields):
    return Data(**{name: getattr(SHARED, name) for name in Data.model_fields} | fields)


def noise_of(data, trial):
    """The noise (samples,) of a trial, of variance 1 before its level."""
    (white,) = data.noise
    return (generate(data, 1, trial).y - data.before_noise(1, trial).y) / white.std


@pytest.mark.parametrize("streams", [NumpyStreams, Matlab5Streams])
def test_only_what_is_shared_is_the_same(streams):
    one, other = (
        changed(noise=(White(std=s),), streams=streams(share=("noise",), fixed=("input",)))
        for s in (0.1, 0.5)
    )
    np.testing.assert_allclose(noise_of(one, 3), noise_of(other, 3), atol=1e-13)
    assert np.all(generate(one, 1, 3).u != generate(other, 1, 3).u)
    both = changed(streams=streams(share=("input",), fixed=("input",)))
    np.testing.assert_array_equal(generate(both, 1, 0).u, generate(both, 1, 7).u)
    # The input is not the noise, and another seed is another of both.
    assert abs(np.corrcoef(generate(SHARED, 1, 3).u, noise_of(SHARED, 3))[0, 1]) < 0.5
    assert np.all(generate(SHARED, 2, 3).u != generate(SHARED, 1, 3).u)


@pytest.mark.parametrize("trial", [0, 1, 7])
def test_the_same_input_and_unit_noise_at_several_levels(trial):
    loud = changed(noise=(White(std=0.5),))
    assert SHARED.key != loud.key
    np.testing.assert_array_equal(generate(SHARED, 1, trial).u, generate(loud, 1, trial).u)
    np.testing.assert_allclose(noise_of(SHARED, trial), noise_of(loud, trial), atol=1e-13)
    assert np.ptp(noise_of(SHARED, trial) - noise_of(SHARED, trial + 1)) > 0.1


@pytest.mark.parametrize(
    "excitation",
    [
        Iid(distribution="uniform", low=-1.0, high=1.0),
        Iid(distribution="gaussian", std=2.0),
        Multistep(switching_time=7.0, std=1.0),
        Prbs(order=5),
        Filtered(excitation=Iid(distribution="gaussian", std=1.0), linear=Ar(a=(0.5,))),
    ],
    ids=lambda one: one.kind,
)
def test_a_longer_record_begins_with_the_input_and_noise_of_a_shorter_one(excitation):
    short, long = (changed(excitation=excitation, samples=n) for n in (60, 200))
    np.testing.assert_allclose(generate(long, 1, 2).u[:60], generate(short, 1, 2).u, rtol=1e-12)
    np.testing.assert_allclose(noise_of(long, 2)[:60], noise_of(short, 2), atol=1e-12)


def test_outputs_of_another_length_differ_by_a_transient_and_from_rest_by_nothing():
    def outputs(linear):
        system = Hammerstein(nonlinearity=Expression(expression="u + u**2"), linear=linear)
        return [changed(system=system, samples=n).before_noise(1, 2).y[:60] for n in (60, 200)]

    short, long = outputs(Ar(a=(0.5,)))
    # What is left of the past is halved with each sample.
    away = short - long
    assert away[0] != 0.0
    np.testing.assert_allclose(away[:20], away[0] * 0.5 ** np.arange(20), rtol=1e-6)
    np.testing.assert_array_equal(*outputs(Ar(a=(0.5,), initial="zero")))


def test_another_system_has_the_same_input():
    other = changed(system=Hammerstein(nonlinearity=Expression(expression="u"), linear=Fir(b=(1.0, 0.5))))
    np.testing.assert_array_equal(generate(SHARED, 1, 3).u, generate(other, 1, 3).u)


def test_without_sharing_the_cases_differ():
    plain, loud = (changed(streams=NumpyStreams(), noise=(White(std=s),)) for s in (0.1, 0.5))
    assert np.all(generate(plain, 1, 0).u != generate(loud, 1, 0).u)


def test_shared_data_depend_on_their_own_case_seed_and_trial_alone():
    alone = generate(SHARED, 1, 5)
    generate(changed(noise=(White(std=0.5),)), 1, 4)
    jobs = [Job(LeastSquares(order=1), (Value(of=("a_1",)),))]
    *_, last = tried(SHARED, jobs, {3: [0], 4: [0], 5: [0]}, 1)
    assert last.values.tolist() == [LeastSquares(order=1).fit(alone).values["a_1"]]
    np.testing.assert_array_equal(generate(SHARED, 1, 5).y, alone.y)


# --- matlab5


@pytest.mark.parametrize("trial", [0, 1, 99])
def test_states_are_those_of_the_formulas(trial):
    streams = matlab5(input={"state": "2**trial / 2**trial"}, noise={"state": "100 + trial"})
    for role, state in [("input", 1), ("noise", 101 + trial)]:
        stream = streams.generator(role, SEED, KEY, trial)
        np.testing.assert_array_equal(stream.random(20), Rand(state).random(20))
        np.testing.assert_array_equal(stream.standard_normal(20), Randn(state).standard_normal(20))


@pytest.mark.parametrize("sizes", [(20, 7, 3), (20, 20, 20), (0, 5, 40)])
def test_streams_of_several_trials_are_those_of_each(sizes):
    trials = [7, 0, 3]
    for streams in (NumpyStreams(), matlab5(noise={"state": "trial"}), matlab5(noise={"state": 4})):
        together = streams.generators("noise", SEED, KEY, trials)
        for trial, n, stream in zip(trials, sizes, together, strict=True):
            alone = streams.generator("noise", SEED, KEY, trial)
            for count in (n, 9):
                np.testing.assert_array_equal(stream.standard_normal(count), alone.standard_normal(count))


def test_a_stream_that_cannot_be_had_is_missed_in_its_trial_alone():
    data = Data(
        samples=9,
        system=Hammerstein(nonlinearity=Expression(expression="u"), linear=Fir(b=(1.0,))),
        excitation=Iid(distribution="uniform", low=-3.0, high=3.0),
        noise=(White(std=1.0),),
        streams=matlab5(noise={"state": "3 - trial"}),
    )
    outcomes = tried(data, [Job(LeastSquares(order=1), (Value(of=("a_1",)),))], {t: [0] for t in range(6)}, 1)
    assert [bool(outcome.scores[0].crash) for outcome in outcomes] == [False] * 3 + [True] * 3
    assert "not -1 (the formula '3 - trial' in trial 4)" in outcomes[3].scores[0].failure


def test_the_first_trial_has_the_number_one():
    stream = matlab5(noise={"state": "trial"}).generator("noise", SEED, KEY, 0)
    np.testing.assert_array_equal(stream.standard_normal(9), Randn(1).standard_normal(9))


def test_uniform_numbers_may_come_from_the_twister():
    streams = matlab5(input={"state": "trial", "generator": "twister"})
    stream = streams.generator("input", SEED, KEY, 4)
    np.testing.assert_array_equal(stream.random(20), twister(5).random(20))
    np.testing.assert_array_equal(stream.standard_normal(20), Randn(5).standard_normal(20))


@settings(deadline=None, derandomize=True, max_examples=20)
@given(seed=st.integers(0, 99), key=st.integers(0, 2**128), trial=st.integers(0, 99))
def test_given_states_depend_on_the_trial_only_and_other_roles_are_those_of_numpy(seed, key, trial):
    streams = matlab5(input={"state": 3}, fixed=["noise"])
    assert draws(streams, "input", trial, seed, key) == tuple(Rand(3).random(3))
    plain = NumpyStreams(fixed=("noise",))
    for role in ("noise", "estimator"):
        assert draws(streams, role, trial, seed, key) == draws(plain, role, trial, seed, key)


def test_a_role_is_fixed_if_its_state_does_not_depend_on_the_trial():
    streams = matlab5(input={"state": "3*7"}, noise={"state": "trial"}, fixed=["input"])
    assert [role for role in ROLES if streams.is_fixed(role)] == ["input"]
    assert matlab5(input={"state": 1}, fixed=["input"]).is_fixed("input")


def test_each_call_starts_the_stream_anew():
    streams = matlab5(input={"state": 1})
    assert draws(streams, "input", 0) == draws(streams, "input", 0)


def test_the_states_belong_to_the_hash_of_the_data():
    given = canonical(matlab5(input={"state": 1}, noise={"state": "trial"}))
    assert given == {"kind": "matlab5", "input": {"state": 1}, "noise": {"state": "trial"}}


def test_the_data_of_wang_zhang_ljung():
    data = Data(
        samples=100,
        system=Hammerstein(
            nonlinearity=Expression(expression="u + 2*u**2 + 5*u**3 + 7*u**4 + u**5"),
            linear=Fir(b=(0.0, 1 / math.sqrt(5), -2 / math.sqrt(5)), initial="zero"),
        ),
        excitation=Filtered(
            excitation=Iid(distribution="uniform", low=-3.0, high=3.0),
            linear=Ar(a=(0.5,), initial="zero"),
        ),
        noise=(White(std=1.0),),
        streams=matlab5(input={"state": 1}, noise={"state": "trial"}),
    )
    # Table 1, W = I, of the paper: mean and standard deviation of a and b over 100 trials.
    estimates = []
    for trial in range(100):
        record = generate(data, seed=trial, trial=trial)
        powers = record.u[:, None] ** np.arange(1, 6)
        regressors = np.hstack((powers[1:-1], powers[:-2]))
        theta = np.linalg.lstsq(regressors, record.y[2:], rcond=None)[0].reshape(2, 5)
        left, singular, right = np.linalg.svd(theta)
        sign = np.sign(left[0, 0])
        estimates.append([*sign * left[:, 0], *sign * singular[0] * right[0]])
    mean, std = np.mean(estimates, axis=0), np.std(estimates, axis=0, ddof=1)
    np.testing.assert_array_equal(mean.round(4), [0.4473, -0.8944, 0.9895, 1.9932, 5.0016, 7.0004, 0.9998])
    np.testing.assert_array_equal(std.round(4), [0.0013, 0.0006, 0.1599, 0.0777, 0.0477, 0.0058, 0.0027])


def test_a_random_start_of_a_prbs_can_be_drawn():
    streams = matlab5(input={"state": "trial"})
    records = [Prbs(order=5).sample(40, 1.0, streams.generator("input", 0, 0, trial)) for trial in range(20)]
    assert all(set(u) == {-1.0, 1.0} for u in records)
    assert len({tuple(u) for u in records}) > 10


# --- messages


def test_messages():
    place = "streams.noise.state"
    kind = "must be a whole number, or a formula in the trial's number such as '100 + trial'"
    limits = "a state is a whole number from 0 to 4294967295, not "
    for value in (1.5, True, None, [1]):
        assert refused(noise={"state": value}) == (place, kind)
    assert refused(noise={"state": -1}) == (place, limits + "-1")
    assert refused(noise={"state": 2**32}) == (place, limits + "4294967296")
    assert refused(noise={"state": "trial/2"}) == (
        place,
        limits + "0.5 (the formula 'trial/2' in trial 1)",
    )
    assert refused(noise={"state": "1/0"}) == (place, limits + "inf (the formula '1/0' in trial 1)")
    assert refused(noise={"state": "trail"}) == (
        place,
        "unknown name 'trail' in the formula 'trail'; did you mean 'trial'? "
        f"(allowed: trial, pi, e and the functions {', '.join(FUNCTIONS)})",
    )
    assert refused(noise={}) == (
        place,
        "is required: State from 0 to 2^32 - 1: fixed, or a formula in the number of the trial from 1, "
        "as '100 + trial'",
    )
    assert refused(noise={"state": 1, "generator": "seed"}) == (
        "streams.noise.generator",
        "must be 'state' or 'twister'",
    )
    assert refused(noise=3)[1] == "must be a mapping of keys to values"
    assert refused(fixed=["noise"], noise={"state": "trial"}) == (
        "streams",
        "noise is fixed, but its state 'trial' changes with the trial",
    )


def test_a_formula_that_leaves_the_range_in_a_later_trial_names_the_trial():
    streams = matlab5(noise={"state": "3 - trial"})
    streams.generator("noise", SEED, KEY, 2)
    with pytest.raises(ValueError, match="a state is") as caught:
        streams.generator("noise", SEED, KEY, 3)
    assert str(caught.value) == (
        "a state is a whole number from 0 to 4294967295, not -1 (the formula '3 - trial' in trial 4)"
    )
