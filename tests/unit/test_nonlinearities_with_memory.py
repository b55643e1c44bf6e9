"""Backlash and relay: their responses, their starts, and where a function of the input is asked for."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hident as hi
from hident.systems.base import MemorySpec
from tests.unit.plans import planned, refusals

QUICK = settings(deadline=None, derandomize=True, max_examples=50)
signals = st.lists(st.floats(-5, 5), min_size=1, max_size=60).map(np.array)
widths = st.floats(0, 3)
BACKLASH, RELAY = hi.Backlash(width=0.5), hi.Relay(low=-0.3, high=0.4)
BOTH = pytest.mark.parametrize("spec", [BACKLASH, RELAY], ids=lambda spec: spec.kind)


class TestBacklash:
    def test_turns_only_once_the_gap_is_crossed(self):
        # Up to 2, back by the width 1 without a change, then down with the input.
        u = np.array([0, 0.5, 1, 2, 1.75, 1.25, 1, 0, -1, -0.5, 0, 0.5])
        wanted = [0, 0, 0.5, 1.5, 1.5, 1.5, 1.5, 0.5, -0.5, -0.5, -0.5, 0]
        np.testing.assert_array_equal(hi.Backlash(width=1).simulate(u), wanted)

    def test_a_triangle_gives_the_loop_in_closed_form(self):
        up = np.linspace(-2, 2, 401)
        u = np.concatenate((up, up[::-1][1:], up[1:]))
        y = hi.Backlash(width=1, gain=3, initial=-4.5).simulate(u)
        np.testing.assert_allclose(y[:401], 3 * np.maximum(up - 0.5, -1.5), atol=1e-12)
        np.testing.assert_allclose(y[401:801], 3 * np.minimum(up[::-1][1:] + 0.5, 1.5), atol=1e-12)

    @QUICK
    @given(u=signals, width=widths, initial=st.floats(-5, 5))
    def test_stays_within_half_the_gap_and_moves_with_the_input(self, u, width, initial):
        y = hi.Backlash(width=width, initial=initial).simulate(u)
        assert np.all(np.abs(y - u) <= width / 2 * (1 + 1e-12) + 1e-12)
        before = np.concatenate(([initial], y[:-1]))
        moved = y != before
        np.testing.assert_allclose(np.abs(y - u)[moved], width / 2, atol=1e-12)

    @QUICK
    @given(u=signals, width=widths)
    def test_is_odd_and_does_not_depend_on_the_rate(self, u, width):
        y = hi.Backlash(width=width).simulate(u)
        np.testing.assert_array_equal(hi.Backlash(width=width).simulate(-u), -y)
        np.testing.assert_array_equal(hi.Backlash(width=width).simulate(np.repeat(u, 3))[2::3], y)

    @QUICK
    @given(u=signals)
    def test_without_a_gap_it_is_a_gain(self, u):
        np.testing.assert_array_equal(hi.Backlash(width=0, gain=2, initial=7).simulate(u), 2 * u)


class TestRelay:
    def test_switches_at_its_points_and_stays_between_them(self):
        u = np.array([0, 0.9, 1, 0, -0.9, -1, 0, 2, -3])
        wanted = [-1, -1, 1, 1, 1, -1, -1, 1, -1]
        np.testing.assert_array_equal(hi.Relay(low=-1, high=1).simulate(u), wanted)

    @QUICK
    @given(u=signals, low=st.floats(-2, 0), initial=st.sampled_from(["lower", "upper"]))
    def test_is_the_recursion(self, u, low, initial):
        state, wanted = initial == "upper", []
        for value in u:
            state = True if value >= 1 else False if value <= low else state
            wanted.append(5.0 if state else -2.0)
        found = hi.Relay(low=low, high=1, outputs=[-2, 5], initial=initial).simulate(u)
        np.testing.assert_array_equal(found, wanted)


@BOTH
def test_they_leave_the_input_alone_and_survive_pickling(spec):
    u = np.random.default_rng(1).normal(size=50)
    before = u.copy()
    y = spec.simulate(u)
    np.testing.assert_array_equal(u, before)
    assert y.dtype == np.float64
    assert y.shape == u.shape
    assert not np.shares_memory(y, u)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(spec)).simulate(u), y)


@BOTH
def test_they_are_no_functions(spec):
    assert isinstance(spec, MemorySpec)
    assert spec.characteristic() is None
    with pytest.raises(TypeError, match=f"^{spec.kind} has memory: it has a response to a signal, and no"):
        spec(np.zeros(3))


def test_a_static_one_is_its_own_characteristic():
    static = hi.Saturation(low=-1, high=1)
    u = np.linspace(-2, 2, 9)
    assert static.characteristic() is static
    np.testing.assert_array_equal(static.simulate(u), static(u))


AR = hi.Ar(a=[0.5], initial="zero")
U = np.random.default_rng(2).uniform(-1, 1, 60)


@BOTH
def test_the_systems_simulate_them(spec):
    filtered = AR.simulate(U)
    np.testing.assert_array_equal(
        hi.Hammerstein(nonlinearity=spec, linear=AR).simulate(U), AR.simulate(spec.simulate(U))
    )
    np.testing.assert_array_equal(
        hi.Wiener(nonlinearity=spec, linear=AR).simulate(U), spec.simulate(filtered)
    )
    np.testing.assert_array_equal(
        hi.WienerHammerstein(input_linear=AR, nonlinearity=spec, output_linear=AR).simulate(U),
        AR.simulate(spec.simulate(filtered)),
    )
    block = hi.Continuous(a=[2])
    np.testing.assert_array_equal(
        hi.Hammerstein(nonlinearity=spec, linear=block).simulate(U, 0.1),
        block.simulate(spec.simulate(U), 0.1),
    )


@pytest.mark.parametrize(
    "system",
    [
        hi.Hammerstein(nonlinearity=BACKLASH, linear=AR),
        hi.Wiener(nonlinearity=RELAY, linear=AR),
        hi.WienerHammerstein(input_linear=AR, nonlinearity=RELAY, output_linear=AR),
    ],
    ids=lambda system: system.kind,
)
def test_the_truth_has_a_response_and_no_function(system):
    truth = system.truth()
    assert truth.nonlinearity is None
    assert truth.breakpoints == ()
    np.testing.assert_array_equal(truth.response(U, 1.0), system.simulate(U))
    assert "nonlinearity" not in system.provides()


@BOTH
def test_every_experiment_begins_at_the_initial_state(spec):
    system = hi.Hammerstein(nonlinearity=spec, linear=hi.Fir(b=[1, 0.5], initial="zero"))
    steps = hi.Staircase(levels=[1, 0], hold=3)
    parts = [{"name": name, "excitation": steps, "samples": 6} for name in ("first", "second")]
    record = hi.simulate(system, hi.Experiments(parts=parts), 12)
    assert len(record.parts) == 2
    np.testing.assert_array_equal(record.y[:6], record.y[6:])
    np.testing.assert_array_equal(record.y[:6], system.simulate(record.u[:6]))


def test_a_level_before_the_record_is_honoured_by_a_stationary_block():
    system = hi.Hammerstein(nonlinearity=hi.Backlash(width=1), linear=hi.Ar(a=[0.5]))
    steps = hi.Staircase(levels=[3, 2.5], hold=2, initial=3)
    # The play was taken up before: 2.5, of which half the gap is left.
    np.testing.assert_allclose(hi.simulate(system, steps, 4).y, [5, 5, 5, 5], atol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: hi.InstrumentalVariables(order=1, instrument=BACKLASH), "instrument: must be a function"),
        (lambda: hi.KnownNonlinearity(lags=2, nonlinearity=RELAY), "and relay has memory: take a nonlin"),
        (lambda: hi.TwoStage(lags=2, basis=["identity", BACKLASH]), "basis[1]: must be a function of the"),
        (lambda: hi.PolynomialBlock(degree=2, range=[-1, 1], start=RELAY), "start: must be a function of"),
        (
            lambda: hi.WienerHammerstein(
                input_linear=hi.Continuous(a=[1]), nonlinearity=RELAY, output_linear=hi.Continuous(a=[1])
            ),
            "between continuous blocks a nonlinearity must have no memory, and relay has: take discrete bl",
        ),
        (lambda: hi.Backlash(width=-1), "width: must be greater than or equal to 0"),
        (lambda: hi.Backlash(width=1, gain=0), "gain: must not be zero"),
        (lambda: hi.Relay(low=1, high=1), "'low' must be below 'high', not 1 and 1; without hysteresis it"),
        (lambda: hi.Relay(low=0, high=1, initial="up"), "initial: must be 'lower' or 'upper'"),
    ],
)
def test_what_is_refused(make, message):
    with pytest.raises(hi.ConfigError) as caught:
        make()
    assert message in str(caught.value)


CONFIGURATION = """\
version: 1
title: A gear with play
trials: 2
samples: 200
system: {kind: hammerstein, nonlinearity: {kind: backlash, width: 0.5}, linear: {kind: ar, a: [0.5]}}
excitation: {kind: iid, distribution: uniform, low: -1, high: 1}
estimators:
  chain: {kind: prediction_error, blocks: [{kind: polynomial, degree: 1}, {kind: linear, nb: 1, nf: 1}]}
metrics:
  score: METRIC
"""


def test_what_compares_functions_is_refused_by_name(tmp_path):
    text = CONFIGURATION.replace("METRIC", "{kind: mise, interval: [-0.9, 0.9]}")
    assert refusals(tmp_path, text) == [
        "a.yaml:10: metrics.score: the metric 'mise' needs the nonlinearity of the system, which "
        "'hammerstein' does not have: backlash has memory and is no function of its input "
        "(it has: linear, response, value a_1, value b_0)"
    ]


def test_the_whole_model_can_be_scored(tmp_path):
    metric = "{kind: validation_error, excitation: {kind: sine, period: 40}, samples: 200}"
    plan = planned(tmp_path, CONFIGURATION.replace("METRIC", metric))
    values = hi.run(plan.document.data).trials_frame()["value"]
    # A chain of static blocks misses the play.
    assert np.all((values > 5) & (values < 80))
