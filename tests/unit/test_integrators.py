"""Blocks without a static gain: integrators, and blocks whose numerator vanishes at frequency zero."""

import re

import numpy as np
import pytest

import hident as hi
from hident.estimators.normalisation import unit_static_gain
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction
from tests.unit.plans import planned, refusals

U = np.random.default_rng(1).normal(size=300)


class TestDiscrete:
    def test_an_integrator_sums(self):
        block = hi.Arma(a=[1], b=[0, 2], initial="zero")
        np.testing.assert_allclose(
            block.simulate(U), 2 * np.concatenate(([0], np.cumsum(U)[:-1])), atol=1e-12
        )
        past = hi.Ar(a=[1], initial=[5])
        np.testing.assert_allclose(past.simulate(U), 5 + np.cumsum(U), atol=1e-12)

    def test_two_of_them_sum_twice(self):
        block = hi.Ar(a=[2, -1], initial="zero")
        np.testing.assert_allclose(block.simulate(U), np.cumsum(np.cumsum(U)), atol=1e-9)

    @pytest.mark.parametrize(
        ("a", "count"),
        [([1], 1), ([2, -1], 2), ([1.5, -0.5], 1), ([0.1, 0.9], 1), ([1.3, -0.4], 0), ([-1], 0)],
    )
    def test_poles_at_one_are_counted(self, a, count):
        block = TransferFunction(a=tuple(map(float, a)))
        assert block.integrators() == count
        assert block.is_stable() == (a == [1.3, -0.4])
        assert block.is_stable(integrators=True) == (a != [-1])
        assert block.static_gain() == (np.inf if count else 1 / block.denominator.sum())

    @pytest.mark.parametrize("a", [[1], [1.5, -0.5], [2, -1], [0.2, 0.8]])
    def test_a_stationary_start_names_the_remedy(self, a):
        message = (
            "has a pole at 1, an integrator, which has no stationary start: "
            "set 'initial: zero', or give the past outputs"
        )
        with pytest.raises(hi.ConfigError, match=re.escape(message)):
            hi.Ar(a=a)
        assert hi.Ar(a=a, initial="zero").burn_in() == 0

    @pytest.mark.parametrize(
        ("a", "poles"), [([-1], "-1"), ([1.01], "1.01"), ([0, -1], "0+-1j (modulus 1)"), ([2.2, -1.2], "1.2")]
    )
    def test_other_poles_on_or_outside_the_circle_are_refused(self, a, poles):
        with pytest.raises(hi.ConfigError, match=f"is unstable: poles {re.escape(poles)}"):
            hi.Ar(a=a, initial="zero")

    def test_a_wiener_hammerstein_system_starts_both_blocks_alike(self):
        integrator = hi.Ar(a=[1], initial="zero")
        with pytest.raises(hi.ConfigError, match="must start stationary, or both from a given state"):
            hi.WienerHammerstein(input_linear=integrator, nonlinearity="abs", output_linear=hi.Fir(b=[1]))
        rest = hi.Fir(b=[1], initial="zero")
        system = hi.WienerHammerstein(input_linear=integrator, nonlinearity="abs", output_linear=rest)
        np.testing.assert_allclose(system.simulate(U), np.abs(np.cumsum(U)), atol=1e-12)

    def test_it_may_filter_an_excitation(self):
        walk = hi.Filtered(
            excitation=hi.Iid(distribution="gaussian", std=1), linear=hi.Ar(a=[1], initial="zero")
        )
        steps = np.diff(walk.sample(2000, 1.0, np.random.default_rng(2)))
        assert abs(steps.mean()) < 0.1
        assert steps.std() == pytest.approx(1, abs=0.05)

    def test_each_experiment_begins_at_zero(self):
        system = hi.Hammerstein(nonlinearity="abs", linear=hi.Ar(a=[1], initial="zero"))
        parts = [
            {"name": name, "excitation": hi.Staircase(levels=[1], hold=9), "samples": 4} for name in "ab"
        ]
        record = hi.simulate(system, hi.Experiments(parts=parts), 8)
        np.testing.assert_allclose(record.y, [1, 2, 3, 4, 1, 2, 3, 4])

    def test_a_known_integrator_is_undone_before_a_regression(self):
        system = hi.Hammerstein(nonlinearity="abs", linear=hi.Ar(a=[1], initial="zero"))
        record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
        kernel = hi.Kernel(
            kernel="gaussian", bandwidth={"h0": 0.05, "alpha": 0}, prefilter=hi.KnownDynamics(a=[1])
        )
        found = hi.fit(kernel, record).nonlinearity
        assert found is not None
        np.testing.assert_allclose(found(np.array([-0.5, 0.5])), [0.5, 0.5], atol=0.02)


class TestContinuous:
    DT = 0.25
    T = DT * np.arange(200)

    @pytest.mark.parametrize("delay", [0.0, 0.6])
    def test_an_integrator_of_a_step_is_a_ramp(self, delay):
        block = hi.Continuous(b=[3], integrators=1, delay=delay)
        ramp = 3 * np.maximum(self.T - delay, 0)
        np.testing.assert_allclose(block.simulate(np.ones(200), self.DT), ramp, atol=1e-11)

    def test_two_of_them_give_a_parabola(self):
        block = hi.Continuous(integrators=2)
        np.testing.assert_allclose(block.simulate(np.ones(200), self.DT), self.T**2 / 2, rtol=1e-8, atol=1e-8)

    def test_with_a_lag_it_has_its_closed_form(self):
        # 1/(s (1 + 2 s)): t - 2 (1 - exp(-t/2)).
        block = hi.Continuous(a=[2], integrators=1)
        wanted = self.T - 2 * (1 - np.exp(-self.T / 2))
        np.testing.assert_allclose(block.simulate(np.ones(200), self.DT), wanted, atol=1e-10)

    def test_a_numerator_up_to_the_order_of_all_poles(self):
        # (1 + 5 s)/(s (1 + 2 s)) = 1/s + 3/(1 + 2 s)
        block = hi.Continuous(a=[2], b=[1, 5], integrators=1)
        wanted = self.T + 3 * (1 - np.exp(-self.T / 2))
        np.testing.assert_allclose(block.simulate(np.ones(200), self.DT), wanted, atol=1e-10)

    def test_its_sampled_block_is_a_discrete_integrator(self):
        sampled = ContinuousTransferFunction((1.0,), (2.0,), 0.3, 1).sampled(self.DT)
        assert sampled.integrators() == 1
        assert sampled.is_stable(integrators=True)
        block = hi.Continuous(a=[2], integrators=1, delay=0.3)
        np.testing.assert_allclose(sampled.filter(U), block.simulate(U, self.DT), atol=1e-9)

    def test_its_properties(self):
        block = ContinuousTransferFunction((-1.0,), (2.0,), 0.3, 1)
        assert sorted(block.poles().real) == [-0.5, 0.0]
        assert not block.is_stable()
        assert block.is_stable(integrators=True)
        assert block.static_gain() == -np.inf
        assert block.settling_time() == np.inf
        assert block.scaled(2.0) == ContinuousTransferFunction((-2.0,), (2.0,), 0.3, 1)
        assert block.frequency_response(np.array([2.0]))[0] == pytest.approx(-np.exp(-0.6j) / (2j * (1 + 4j)))

    @pytest.mark.parametrize(
        ("fields", "message"),
        [
            ({}, "needs 'a', the coefficients a_1, ..., a_n of the denominator, or 'integrators'"),
            ({"a": [-2], "integrators": 1}, "is unstable: the poles 0.5 do not lie in the left half plane"),
            ({"b": [1, 1], "integrators": 1}, "the block is improper: the order m = 1 of the numerator must"),
            ({"a": [1], "b": [0, 1], "integrators": 1}, "b_0 = 0 takes an integrator away: leave out the fi"),
            ({"a": [1], "integrators": -1}, "integrators: must be greater than or equal to 0"),
        ],
    )
    def test_what_is_refused(self, fields, message):
        with pytest.raises(hi.ConfigError, match=re.escape(message)):
            hi.Continuous(**fields)

    def test_between_continuous_blocks_there_is_no_equilibrium(self):
        with pytest.raises(
            hi.ConfigError, match="start from the equilibrium, which an integrator does not h"
        ):
            hi.WienerHammerstein(
                input_linear=hi.Continuous(integrators=1),
                nonlinearity="identity",
                output_linear=hi.Continuous(a=[1]),
            )


@pytest.mark.parametrize(
    "linear",
    [
        hi.Fir(b=[1, -1]),
        hi.Arma(a=[0.5], b=[0.3, -0.1, -0.2]),
        hi.Continuous(a=[2, 1], b=[0, 1]),
    ],
    ids=lambda linear: linear.kind,
)
def test_systems_without_static_gain_simulate_and_forget_a_level(linear):
    system = hi.Hammerstein(nonlinearity={"kind": "polynomial", "coefficients": [3, 1]}, linear=linear)
    assert linear.transfer_function().static_gain() == 0.0
    record = hi.simulate(system, hi.Staircase(levels=[1, 2], hold=100), 300, dt=0.5)
    np.testing.assert_allclose(record.y[-50:], 0.0, atol=1e-9)


CONFIGURATION = """\
version: 1
title: No static gain
trials: 2
dt: 0.1
samples: 300
system: {kind: hammerstein, nonlinearity: identity, linear: {kind: continuous, BLOCK}}
excitation: {kind: multistep, switching_time: 1, std: 1}
estimators:
  linear: {kind: linear_model, block: {n: 2, m: 1, horizon: 8}}
metrics:
  score: METRIC
"""
BLOCKS = {"a: [3, 2], b: [0, 1]": "b_0 = 0", "a: [3], integrators: 1": "an integrator"}


@pytest.mark.parametrize(("block", "why"), BLOCKS.items())
@pytest.mark.parametrize(
    ("metric", "said"),
    [
        (
            "{kind: linear_percent_error}",
            "leaves the gain apart, and the system's linear block has no static ",
        ),
        ("{kind: settling_time}", "measures from the final value of the step response, and the system's "),
    ],
)
def test_what_needs_a_static_gain_says_so(tmp_path, block, why, metric, said):
    (line,) = refusals(tmp_path, CONFIGURATION.replace("BLOCK", block).replace("METRIC", metric))
    assert said in line
    assert f"static gain ({why})" in line


@pytest.mark.parametrize("block", BLOCKS)
def test_the_whole_model_can_be_scored(tmp_path, block):
    metric = "{kind: validation_error, excitation: {kind: sine, period: 7}, samples: 200}"
    plan = planned(tmp_path, CONFIGURATION.replace("BLOCK", block).replace("METRIC", metric))
    assert hi.run(plan.document.data).frame()["failed"].tolist() == [0]


@pytest.mark.parametrize("linear", [hi.Ar(a=[1], initial="zero"), hi.Continuous(integrators=1)])
def test_no_factor_brings_an_integrator_to_the_static_gain_one(linear):
    truth = hi.Hammerstein(nonlinearity="identity", linear=linear).truth()
    with pytest.raises(ValueError, match=r"^the system's linear block has no static gain$"):
        unit_static_gain().factors(truth, 0.1)


def test_the_formula_of_the_disturbance_needs_a_response_that_ends(tmp_path):
    text = CONFIGURATION.replace("{kind: continuous, BLOCK}", "{kind: ar, a: [1], initial: zero}").replace(
        "METRIC", "{kind: disturbance_variance_formula, noise_variance: 1, w_variance: 1}"
    )
    (line,) = refusals(tmp_path, text)
    assert "which lasts too long: a pole has modulus 1 (at most 0.99999)" in line
