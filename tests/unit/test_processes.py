"""The processes of examples 3 to 5 of Chen, Hwang and Chang: steady states, responses, failures."""

import math
import pickle
from typing import Annotated, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError
from scipy.integrate import solve_ivp
from scipy.special import lambertw

from hident.config.spec import Of, canonical
from hident.errors import SimulationError
from hident.systems import processes
from hident.systems.base import SystemSpec

system: TypeAdapter[SystemSpec] = TypeAdapter(Annotated[SystemSpec, Of("system")])

NEUTRALISATION: dict[str, Any] = {
    "kind": "ph_neutralisation",
    **{"area": 207, "valve_coefficient": 8.75, "pk_1": 6.35, "pk_2": 10.25},
    **{"wa_1": 3e-3, "wa_2": -3e-2, "wa_3": -3.05e-3, "wb_1": 0, "wb_2": 3e-2, "wb_3": 5e-5},
    **{"q_1": 16.6, "q_2": 0.55, "q_3": 15.6},
}
TANK: dict[str, Any] = {
    "kind": "acid_tank",
    **{"volume": 1, "q_a": 14.2, "q_b": 13.5, "acetic_acid": 1, "propionic_acid": 1, "sodium_hydroxide": 2},
    **{"pk_acetic": 4.75, "pk_propionic": 4.87},
}
REACTOR: dict[str, Any] = {
    "kind": "van_de_vusse",
    **{
        "volume": 1,
        "inlet_flow": 34.3,
        "feed_concentration": 10,
        "k_1": 50,
        "k_2": 100,
        "k_3": 10,
        "delay": 0.02,
    },
}
# The settings, a sampling interval and the input's limits, as the paper tests each of them.
ALL = {
    "ph_neutralisation": (NEUTRALISATION, 2.5, (-15.6, 24.4)),
    "acid_tank": (TANK, 0.001, (-8.5, 11.5)),
    "van_de_vusse": (REACTOR, 0.002, (-34.3, 65.7)),
}
PROCESSES = pytest.mark.parametrize("kind", ALL)


def build(plain: dict[str, Any], **changes: Any) -> Any:
    return system.validate_python({**plain, **changes})


def multistep(kind: str, levels: int = 12, hold: int = 10) -> np.ndarray:
    """A random input over the whole range, which begins with its lowest level: no flow."""
    low, high = ALL[kind][2]
    drawn = np.random.default_rng(7).uniform(low, high, levels)
    drawn[0] = low
    return np.repeat(drawn, hold)


# Steady states


def test_neutralisation_rests_at_the_printed_steady_state():
    values = build(NEUTRALISATION).truth().values
    assert values["steady_input"] == 15.6
    assert round(values["steady_output"], 4) == 7.0258
    assert values["level"] == pytest.approx((32.75 / 8.75) ** 2, rel=1e-14)
    assert values["time_constant"] == pytest.approx(207 * 32.75 / 8.75**2, rel=1e-14)


@pytest.mark.parametrize(("q_b", "ph"), [(13.5, 6.0990), (14.2, 9.4071), (15, 12.7387)])
def test_tank_rests_at_the_printed_steady_states(q_b, ph):
    values = build(TANK, q_b=q_b).truth().values
    assert round(values["steady_output"], 4) == ph
    assert values["time_constant"] == 1 / (14.2 + q_b)
    assert round(float(build(TANK).steady_output(np.array(q_b))), 4) == ph


@pytest.mark.parametrize("plain", [NEUTRALISATION, TANK])
def test_the_steady_output_is_solved_once(plain, monkeypatch):
    solved = 0

    def counting(*arguments):
        nonlocal solved
        solved += 1
        return root(*arguments)

    root = processes._root_in_ph
    monkeypatch.setattr(processes, "_root_in_ph", counting)
    spec = build(plain)
    for _ in range(3):
        spec.truth()
        spec.provides()
    assert solved == 1
    spec.truth().nonlinearity(np.zeros(2))
    assert solved == 2
    assert spec == build(plain)
    assert hash(spec) == hash(build(plain))


def test_reactor_rests_at_the_printed_steady_state():
    values = build(REACTOR).truth().values
    assert round(values["steady_output"], 4) == 1.1172
    assert round(values["gain_change"], 1) == 77.5


@PROCESSES
def test_rates_of_the_literal_equations_vanish_at_the_steady_states(kind):
    spec = build(ALL[kind][0])
    for flow in np.linspace(0, 100, 9):
        state = spec.steady_state(np.array(flow))
        rates = np.array(RATES[kind](0.0, state, flow))
        np.testing.assert_allclose(rates, 0, atol=1e-13 * np.max(np.abs(state)) * 200)


@PROCESSES
def test_steady_curves_work_on_arrays_of_any_shape_and_end_at_zero_flow(kind):
    spec = build(ALL[kind][0])
    low = -spec.steady_input
    curve = spec.gain_curve(np.array([[low, 0.0], [low - 1e-3, 1.0]]))
    assert curve.shape == (2, 2)
    assert curve[0, 1] == 0.0
    assert np.isfinite(curve[[0, 1], [0, 1]]).all()
    assert np.isnan(curve[1, 0])


@pytest.mark.parametrize("plain", [NEUTRALISATION, TANK], ids=lambda plain: plain["kind"])
def test_titration_curves_rise(plain):
    curve = build(plain).steady_output(np.linspace(0, 40, 2001))
    assert np.all(np.diff(curve) > 0)


def test_gain_change_is_where_the_steady_curve_peaks():
    spec = build(REACTOR, k_3=7, volume=0.6)
    flow = spec.gain_change()
    around = spec.steady_output(flow * np.array([0.999, 1.0, 1.001]))
    assert np.argmax(around) == 1
    assert spec.linearised(flow).b[0] == pytest.approx(0, abs=1e-17)
    assert spec.linearised(0.9 * flow).b[0] > 0 > spec.linearised(1.1 * flow).b[0]


# The algebraic pH


def charges(kind: str, ph: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Electric neutrality as the paper writes it for example 3, and its counterpart for example 4."""
    proton, hydroxide = 10.0**-ph, 10.0 ** (ph - 14)
    if kind == "ph_neutralisation":
        first, second = 10.0 ** (6.35 - ph), 10.0 ** (ph - 10.25)
        return states[:, 1] + hydroxide + states[:, 2] * (1 + 2 * second) / (1 + first + second) - proton
    acetate, propionate, sodium = states.T
    bound = acetate / (1 + 10.0 ** (4.75 - ph)) + propionate / (1 + 10.0 ** (4.87 - ph))
    return np.asarray(sodium + proton - hydroxide - bound)


@pytest.mark.parametrize("kind", ["ph_neutralisation", "acid_tank"])
def test_ph_leaves_no_charge(kind):
    spec = build(ALL[kind][0])
    flows = np.linspace(0, 100, 2000)
    residual = charges(kind, spec.steady_output(flows), spec.steady_state(flows))
    assert np.max(np.abs(residual)) < 1e-12


def test_ph_of_water_acid_and_base():
    spec = build(TANK, acetic_acid=0, propionic_acid=0, sodium_hydroxide=0.2)
    # Half of each stream: 0.1 mol/L of sodium hydroxide; then no base at all.
    base = 14 + math.log10((0.1 + math.sqrt(0.01 + 4e-14)) / 2)
    np.testing.assert_allclose(spec.steady_output(np.array([14.2, 0.0])), [base, 7.0], atol=1e-11)


# Responses


def neutralisation_rates(t, state, q_3):
    h, wa_4, wb_4 = state
    flows = np.array([16.6, 0.55, q_3])
    return [
        (flows.sum() - 8.75 * h**0.5) / 207,
        ((np.array([3e-3, -3e-2, -3.05e-3]) - wa_4) @ flows) / (207 * h),
        ((np.array([0, 3e-2, 5e-5]) - wb_4) @ flows) / (207 * h),
    ]


def tank_rates(t, state, q_b):
    return 14.2 * np.array([1, 1, 0]) + q_b * np.array([0, 0, 2]) - (14.2 + q_b) * np.asarray(state)


def reactor_rates(t, state, flow):
    c_a, c_b = state
    return [-50 * c_a - 10 * c_a**2 + flow * (10 - c_a), 50 * c_a - 100 * c_b - flow * c_b]


RATES = {
    "ph_neutralisation": neutralisation_rates,
    "acid_tank": tank_rates,
    "van_de_vusse": reactor_rates,
}


def reference(kind: str, u: np.ndarray, dt: float, delay: float = 0.0) -> np.ndarray:
    """The states at k dt - delay by DOP853 at a tight tolerance, restarted at every sample."""
    spec = build(ALL[kind][0])
    start = state = spec.steady_state(np.array(spec.steady_input))
    pieces = []
    for flow in spec.steady_input + u:
        piece = solve_ivp(
            RATES[kind], (0, dt), state, "DOP853", args=(flow,), rtol=1e-13, atol=1e-17, dense_output=True
        )
        pieces.append(piece.sol)
        state = piece.y[:, -1]
    times = dt * np.arange(len(u)) - delay
    index = np.floor(times / dt + 1e-9).astype(int)
    return np.array(
        [
            start if k < 0 else pieces[k](max(t - k * dt, 0.0))
            for k, t in zip(index.tolist(), times.tolist(), strict=True)
        ]
    )


@PROCESSES
def test_response_is_that_of_a_tighter_solver_to_1e_8(kind):
    plain, dt, _ = ALL[kind]
    u = multistep(kind)
    spec = build(plain, **({"delay": 0} if kind == "van_de_vusse" else {}))
    states = reference(kind, u, dt)
    expected = spec._measure(states) - spec.truth().values["steady_output"]
    np.testing.assert_allclose(spec.simulate(u, dt), expected, atol=1e-8, rtol=0)


def test_neutralisation_is_exact_by_the_lambert_function():
    # With s = h^0.5 and z = 1 - R s/q: ln z - z falls at the rate R^2/(2 A q), and what the invariants are
    # off their end shrinks by ((s_0/s) (z/z_0))^2.
    spec, dt = build(NEUTRALISATION), 2.5
    u = multistep("ph_neutralisation")
    state = spec.steady_state(np.array(15.6))
    expected = np.empty((len(u), 3))
    for k, q_3 in enumerate(15.6 + u):
        expected[k] = state
        end = spec.steady_state(np.array(q_3))
        total = 16.6 + 0.55 + q_3
        root = math.sqrt(state[0])
        z = 1 - 8.75 * root / total
        fall = 8.75**2 * dt / (2 * 207 * total)
        after = -lambertw(-z * math.exp(-z - fall)).real
        root_after = total / 8.75 * (1 - after)
        shrink = (root / root_after * math.exp(after - z - fall)) ** 2
        state = np.append(root_after**2, end[1:] + shrink * (state - end)[1:])
    y = spec._measure(expected) - spec.truth().values["steady_output"]
    np.testing.assert_allclose(spec.simulate(u, dt), y, atol=1e-8, rtol=0)


@pytest.mark.parametrize("delay", [0.02, 0.0213, 0.0007, 5.0])
def test_delay_need_not_be_a_multiple_of_the_sampling_interval(delay):
    u, dt = multistep("van_de_vusse", 5), 0.002
    spec = build(REACTOR, delay=delay)
    expected = reference("van_de_vusse", u, dt, delay)[:, 1] - spec.truth().values["steady_output"]
    y = spec.simulate(u, dt)
    np.testing.assert_allclose(y, expected, atol=1e-8, rtol=0)
    assert np.all(y[: math.floor(delay / dt) + 1] == 0)


@PROCESSES
def test_stays_at_rest_without_input(kind):
    plain, dt, _ = ALL[kind]
    np.testing.assert_allclose(build(plain).simulate(np.zeros(300), dt), 0, atol=1e-10)


@PROCESSES
def test_settles_on_its_gain_curve(kind):
    plain, dt, (low, high) = ALL[kind]
    spec = build(plain)
    for level in (0.9 * low, 0.3 * high, high):
        end = spec.simulate(np.full(3, level), 2000 * dt)[-1]
        assert end == pytest.approx(float(spec.gain_curve(np.array(level))), abs=1e-8)


@PROCESSES
@settings(deadline=None, derandomize=True, max_examples=8)
@given(fraction=st.lists(st.floats(0, 1), min_size=1, max_size=6), parts=st.integers(2, 5))
def test_a_held_input_may_be_sampled_as_finely_as_one_likes(kind, fraction, parts):
    plain, dt, (low, high) = ALL[kind]
    spec = build(plain)
    u = low + (high - low) * np.array(fraction)
    fine = spec.simulate(np.repeat(u, parts), dt / parts)[::parts]
    np.testing.assert_allclose(fine, spec.simulate(u, dt), atol=1e-8, rtol=0)


@PROCESSES
def test_output_does_not_know_the_future(kind):
    plain, dt, (low, _) = ALL[kind]
    spec, u = build(plain), multistep(kind)
    changed = u.copy()
    changed[50:] = low / 2
    before, after = spec.simulate(u, dt), spec.simulate(changed, dt)
    np.testing.assert_allclose(after[:51], before[:51], atol=1e-8, rtol=0)
    assert np.max(np.abs(after - before)) > 1e-3


def test_streams_of_one_composition_keep_the_ph():
    same = {f"wa_{i}": -4e-4 for i in (1, 2, 3)} | {f"wb_{i}": 5e-4 for i in (1, 2, 3)}
    y = build(NEUTRALISATION, **same).simulate(multistep("ph_neutralisation"), 2.5)
    np.testing.assert_allclose(y, 0, atol=1e-9)


def test_small_signals_obey_the_linearised_reactor():
    spec, dt = build(REACTOR), 0.001
    u = 1e-4 * np.sign(multistep("van_de_vusse", 20))
    linear = spec.linearised(34.3).respond(u, dt)
    np.testing.assert_allclose(spec.simulate(u, dt), linear, atol=1e-4 * np.max(np.abs(linear)))
    slope = float(np.diff(spec.gain_curve(np.array([-1e-3, 1e-3])))[0]) / 2e-3
    assert spec.linearised(34.3).b[0] == pytest.approx(slope, rel=1e-6)


def test_settling_time_is_that_of_a_small_step_without_the_delay():
    spec, dt = build(REACTOR, delay=0), 1e-5
    y = spec.simulate(np.full(10000, 1e-3), dt)
    outside = np.flatnonzero(np.abs(y / y[-1] - 1) > 0.05)
    assert build(REACTOR).settling_time(34.3) == pytest.approx(dt * (outside[-1] + 0.5), abs=2 * dt)


def test_reactor_without_inflow_linearises_and_a_negative_flow_does_not():
    block = build(REACTOR).linearised(0)
    assert block.b == (10 * 50 / (50 * 100), 0)
    with pytest.raises(ValueError, match=r"^the inlet flow must not be negative, not -1$"):
        build(REACTOR).linearised(-1)


# What the other rooms rely on


@PROCESSES
def test_truth_and_pickling(kind):
    plain, dt, _ = ALL[kind]
    spec, u = build(plain), multistep(kind, 3)
    kept = u.copy()
    u.setflags(write=False)
    copy = pickle.loads(pickle.dumps(spec))
    y = spec.simulate(u, dt)
    np.testing.assert_array_equal(copy.simulate(u, dt), y)
    np.testing.assert_array_equal(u, kept)
    truth = pickle.loads(pickle.dumps(spec.truth()))
    np.testing.assert_array_equal(truth.response(u, dt), y)
    np.testing.assert_array_equal(truth.nonlinearity(u), spec.gain_curve(u))
    assert build(canonical(spec)) == spec


@pytest.mark.parametrize(
    ("kind", "more"),
    [
        ("ph_neutralisation", {"level", "time_constant"}),
        ("acid_tank", {"time_constant"}),
        ("van_de_vusse", {"gain_change"}),
    ],
)
def test_provides(kind, more):
    values = {f"value {name}" for name in {"steady_input", "steady_output"} | more}
    assert build(ALL[kind][0]).provides() == {"nonlinearity", "response"} | values


# Messages


@PROCESSES
def test_needs_the_sampling_interval(kind):
    spec = build(ALL[kind][0])
    spec.check(0.1)
    with pytest.raises(
        ValueError, match=r"^a continuous process needs the sampling interval 'dt' of the data$"
    ):
        spec.check(None)


@pytest.mark.parametrize(
    ("plain", "wrong", "message"),
    [
        (NEUTRALISATION, {"area": 0}, "must be greater than 0"),
        (NEUTRALISATION, {"wb_2": -1e-3}, "must be greater than or equal to 0"),
        (NEUTRALISATION, {"q_3": -1}, "must be greater than 0"),
        (TANK, {"volume": -1}, "must be greater than 0"),
        (TANK, {"acetic_acid": -1}, "must be greater than or equal to 0"),
        (REACTOR, {"feed_concentration": 0}, "must be greater than 0"),
        (REACTOR, {"delay": -0.02}, "must be greater than or equal to 0"),
    ],
)
def test_refuses_impossible_conditions(plain, wrong, message):
    with pytest.raises(ValidationError) as caught:
        build(plain, **wrong)
    (problem,) = caught.value.errors()
    assert problem["loc"] == tuple(wrong)
    assert problem["msg"] == message


def test_operating_conditions_have_no_defaults():
    with pytest.raises(ValidationError) as caught:
        system.validate_python({"kind": "ph_neutralisation"})
    assert {error["loc"][0] for error in caught.value.errors()} == set(NEUTRALISATION) - {"kind"}


@PROCESSES
def test_fails_at_a_negative_flow(kind):
    spec = build(ALL[kind][0])
    u = np.array([0.0, 1.0, -spec.steady_input - 0.4, 0.0])
    value = f"{spec.manipulated} would be -0.4 at t = 5; a flow cannot be negative: "
    limit = f"the input must stay at or above {-spec.steady_input:g}"
    with pytest.raises(SimulationError) as caught:
        spec.simulate(u, 2.5)
    assert str(caught.value) == value + limit
    with pytest.raises(SimulationError, match=f"^{spec.manipulated} would be nan at t = 2.5"):
        spec.simulate(np.array([0.0, np.nan]), 2.5)


def test_fails_where_no_ph_solves_the_balance():
    spec = build(TANK, sodium_hydroxide=1000)
    with pytest.raises(SimulationError) as caught:
        spec.simulate(np.zeros(5), 1.0)
    assert str(caught.value) == "the output of the acid_tank process is not finite at t = 0"


def test_fails_when_the_tank_runs_dry():
    spec = build(NEUTRALISATION, valve_coefficient=1000, q_1=1e-9, q_2=1e-9)
    with pytest.raises(SimulationError) as caught:
        spec.simulate(np.repeat([0.0, -15.6], 50), 10.0)
    assert str(caught.value) == "the tank runs dry between t = 500 and 1000, at the flow 0"


def test_a_tank_that_all_but_empties_is_followed():
    spec = build(NEUTRALISATION, q_1=1e-6, q_2=1e-6)
    y = spec.simulate(np.repeat([0.0, -15.6], 50), 2000.0)
    assert y[-1] == pytest.approx(float(spec.gain_curve(np.array(-15.6))), abs=1e-8)


def test_fails_when_the_solver_does():
    def explode(_: float, state: np.ndarray) -> tuple[float, ...]:
        (x,) = state.tolist()
        return (x * x,)

    with pytest.raises(SimulationError, match=r"^the solver of the differential equations fails \(.+\)$"):
        processes._integrate(explode, np.array([1.0]), np.array([0.5, 2.0]))
