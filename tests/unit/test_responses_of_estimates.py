"""Whoever holds a linear block and a nonlinearity holds their response, which validation_error scores."""

import numpy as np
import pytest

import hident as hi
from hident.errors import ConfigError
from tests.unit import plans

LAG = hi.Arma(a=[0.5], b=[1, 0.3])
CUBIC = hi.Polynomial(coefficients=[0, 1, 0.5, 0.25])
INPUT = hi.Iid(distribution="uniform", low=-1, high=1)
OTHER = hi.ValidationPercentError(excitation=hi.Iid(distribution="uniform", low=-0.8, high=0.8), samples=400)
KNOWN = hi.KnownDynamics(a=[0.5], b=[1, 0.3])
PREFILTERS = {
    "known": KNOWN,
    "instruments": hi.InstrumentalVariables(order=1, instrument="identity", ma_order=1),
    "least squares": hi.LeastSquares(order=6),
}
SERIES = {"basis": hi.Legendre(interval=[-1, 1]), "terms": {"q0": 6, "alpha": 0}}
KERNEL = {"kernel": "gaussian", "bandwidth": {"h0": 0.1, "alpha": 0}}
BLOCKS = hi.Continuous(a=[0.6], b=[1]), hi.Continuous(a=[1.2, 0.5], b=[1])
QUADRATIC = hi.Polynomial(coefficients=[0, 1, 0.5])


@pytest.mark.parametrize("prefilter", PREFILTERS)
def test_a_nonparametric_estimate_responds_through_the_block_of_its_prefilter(prefilter):
    system = hi.Hammerstein(nonlinearity=CUBIC, linear=LAG)
    record = hi.simulate(system, INPUT, 20_000)
    for estimator in (
        hi.Kernel(**KERNEL, prefilter=PREFILTERS[prefilter]),
        hi.Orthogonal(**SERIES, prefilter=PREFILTERS[prefilter]),
    ):
        assert "response" in estimator.provides()
        found = hi.fit(estimator, record)
        assert found.response is not None
        assert found.linear is not None
        assert found.nonlinearity is not None
        u = np.linspace(-0.9, 0.9, 50)
        np.testing.assert_array_equal(found.response(u, 1.0), found.linear.filter(found.nonlinearity(u)))
        assert hi.score(found, record, error=OTHER)["error"] < 12.0


def test_a_response_follows_the_interval_of_its_record():
    system = hi.Hammerstein(nonlinearity=CUBIC, linear=LAG)
    record = hi.simulate(system, INPUT, 500, dt=0.5)
    found = hi.fit(hi.Kernel(**KERNEL, prefilter=KNOWN), record)
    assert found.response is not None
    u = np.linspace(-0.9, 0.9, 50)
    fine = found.response(np.repeat(u, 2), 0.25)
    np.testing.assert_array_equal(fine[::2], found.response(u, 0.5))


DISCRETE = {
    "two_stage": hi.TwoStage(lags=6, delay=0, degree=3),
    "bilinear_least_squares": hi.BilinearLeastSquares(lags=6, delay=0, degree=3),
    "separable_least_squares": hi.SeparableLeastSquares(lags=2, delay=0, feedback=1, degree=3),
    "voros_hammerstein": hi.VorosHammerstein(n=1, m=2, delay=0, degree=3),
    "prediction_error": hi.PredictionError(
        blocks=[{"kind": "polynomial", "degree": 3}, {"kind": "linear", "nb": 2, "nf": 1, "nk": 0}],
        start="rest",
    ),
    "select": hi.Select(
        by="bic", over={"lags": [2, 6]}, estimator={"kind": "two_stage", "delay": 0, "degree": 3}
    ),
}


@pytest.mark.parametrize("name", DISCRETE)
def test_a_discrete_model_responds_at_its_own_interval_to_inputs_of_another(name):
    system = hi.Hammerstein(nonlinearity=CUBIC, linear=LAG)
    found = hi.fit(DISCRETE[name], hi.simulate(system, INPUT, 500, dt=0.5))
    assert found.response is not None
    u = np.linspace(-0.9, 0.9, 50)
    y = found.response(u, 0.5)
    np.testing.assert_array_equal(found.response(np.repeat(u, 2), 0.25)[::2], y)
    np.testing.assert_array_equal(found.response(u, 1.0), found.response(np.repeat(u, 2), 0.5)[::2])
    with pytest.raises(ValueError, match="do not divide each other"):
        found.response(u, 0.3)


def test_a_static_model_responds_at_any_interval():
    static = hi.PredictionError(blocks=[{"kind": "polynomial", "degree": 3}])
    found = hi.fit(
        static, hi.simulate(hi.Hammerstein(nonlinearity=CUBIC, linear=hi.Fir(b=[1])), INPUT, 500, dt=0.5)
    )
    assert found.response is not None
    u = np.linspace(-0.9, 0.9, 50)
    for dt in (0.25, 0.3):
        np.testing.assert_array_equal(found.response(u, dt), found.response(u, 0.5))


def test_several_experiments_give_a_response_too():
    part = {"excitation": INPUT, "samples": 4000}
    several = hi.Experiments(parts=[{"name": "one", **part}, {"name": "two", **part}])
    system = hi.Hammerstein(nonlinearity=CUBIC, linear=LAG)
    record = hi.simulate(system, several, 8000)
    assert len(record.parts) == 2
    found = hi.fit(hi.Orthogonal(**SERIES, prefilter=PREFILTERS["instruments"]), record)
    assert hi.score(found, record, error=OTHER)["error"] < 15.0


def test_without_a_block_the_error_before_the_run_says_so(tmp_path):
    text = """\
version: 1
title: No block
trials: 2
samples: 200
system: {kind: hammerstein, nonlinearity: abs, linear: {kind: ar, a: [0.5]}}
excitation: {kind: iid, distribution: uniform, low: -1, high: 1}
estimators: {kernel: {kind: kernel, kernel: gaussian, bandwidth: {h0: 1, alpha: 0}}}
metrics: {m: {kind: validation_error, samples: 50, excitation: {kind: sine, period: 9}}}
"""
    (message,) = plans.refusals(tmp_path, text)
    assert (
        "the metric 'validation_error' needs the response of the estimate, which estimator 'kernel' (kernel) "
        "does not give (it gives: left_out, nonlinearity)"
    ) in message


def sines(frequencies):
    first, second = BLOCKS
    system = hi.WienerHammerstein(input_linear=first, nonlinearity=QUADRATIC, output_linear=second)
    stepped = hi.SteppedSine(frequencies=frequencies, periods=2, samples_per_period=64)
    samples = 2 * 64 * len(frequencies)
    return hi.simulate(system, stepped, samples, dt=0.1)


def test_a_rational_gauge_knows_both_blocks_and_so_the_response():
    frequencies = [0.3, 0.6, 1.2, 2.4]
    record = sines(frequencies)
    gauge = {"kind": "rational", "input": [0, 1], "output": [0, 2]}
    known = {"frequencies": frequencies, "order": 2, "coefficients": [0, 1, 0.5]}
    estimator = hi.FrequencyGainIdentification(**known, gauge=gauge)
    assert "response" in estimator.provides()
    steps = hi.Multistep(switching_time=2, std=1, limits=[-2, 2])
    validation = hi.ValidationPercentError(excitation=steps, samples=200)
    assert hi.score(hi.fit(estimator, record), record, error=validation)["error"] < 1e-4
    for other in (None, {"kind": "minimum_phase"}, {"kind": "rational", "input": [1, 1], "output": [0, 2]}):
        spec = hi.FrequencyGainIdentification(**known, gauge=other)
        assert "response" not in spec.provides()
    assert hi.fit(spec, record).response is None


class TestDelayBetweenBlocks:
    """A delay that moves from one block to the other changes no output, and phases by it."""

    NAMES = ("phase_i_1", "phase_i_2", "phase_o_1_1", "phase_o_2_2", "phase_sum_1_2", "gain_i_1")

    def found(self, tau):
        record = sines([0.5, 1.0])
        omega = np.array([0.5, 1.0])
        metric = hi.TrueResponse(of=self.NAMES)
        true = dict(zip(self.NAMES, hi.score(hi.Estimate(), record, t=metric).values(), strict=True))
        moved = {"phase_i_1": -0.5, "phase_i_2": -1.0, "phase_o_1_1": 0.5, "phase_o_2_2": 2.0}
        values = {name: value + tau * moved.get(name, 0.0) for name, value in true.items()}
        return hi.Estimate(frequencies=omega, values=values), record

    @pytest.mark.parametrize("tau", [-2.0, 0.3, 4.0])
    def test_it_is_taken_off_if_asked(self, tau):
        estimate, record = self.found(tau)
        errors = hi.score(estimate, record, e=hi.ResponseError(of=self.NAMES))
        assert abs(errors["e phase_i_1"] + 0.5 * tau) < 1e-9
        errors = hi.score(estimate, record, e=hi.ResponseError(of=self.NAMES, up_to=["delay"]))
        np.testing.assert_allclose(list(errors.values()), 0.0, atol=1e-9)

    def test_what_no_delay_explains_stays(self):
        estimate, record = self.found(0.3)
        wrong = hi.Estimate(
            frequencies=estimate.frequencies,
            values={**estimate.values, "phase_i_1": estimate.values["phase_i_1"] + 0.4},
        )
        errors = hi.score(wrong, record, e=hi.ResponseError(of=self.NAMES, up_to=["delay"]))
        away = np.array([*errors.values()])[:4]
        turns = np.array([0.5, 1.0, -0.5, -2.0])
        # Least squares leaves what is at right angles to the delay.
        np.testing.assert_allclose(away, 0.4 * (np.eye(4)[0] - turns * turns[0] / (turns @ turns)), atol=1e-9)

    def test_a_phase_has_one_error_whichever_others_are_named(self):
        estimate, record = self.found(0.3)
        values = {**estimate.values, "phase_i_1": estimate.values["phase_i_1"] + 0.4}
        wrong = hi.Estimate(frequencies=estimate.frequencies, values=values)
        together = hi.score(wrong, record, e=hi.ResponseError(of=self.NAMES, up_to=["delay"]))
        for name in self.NAMES:
            alone = hi.score(wrong, record, e=hi.ResponseError(of=[name], up_to=["delay"]))
            assert alone == pytest.approx({f"e {name}": together[f"e {name}"]}, abs=1e-12)

    def test_it_has_no_factor(self):
        with pytest.raises(ConfigError, match=r"can choose no gain \(allowed: delay\)"):
            hi.ResponseError(of=["phase_i_1"], up_to=["gain"])


class TestArgument:
    """The factor of a Wiener system's linear block is one of the nonlinearity's argument."""

    @pytest.mark.parametrize("k", [0.02, 0.7, 40.0])
    def test_the_best_factor_of_the_argument(self, k):
        system = hi.Wiener(nonlinearity=hi.Expression(expression="sin(u) + u/2"), linear=hi.Ar(a=[0.5]))
        record = hi.simulate(system, INPUT, 10)
        estimate = hi.Estimate(nonlinearity=lambda x: np.sin(x / k) + x / k / 2)
        for up_to, most in ((["gain"], 1e-5), (["gain", "sign"], 1e-5)):
            metric = hi.NonlinearityPercentError(interval=[-3, 3], up_to=up_to)
            assert hi.score(estimate, record, e=metric)["e"] < most
        assert hi.score(estimate, record, e=hi.NonlinearityPercentError(interval=[-3, 3]))["e"] > 20.0
        turned = hi.Estimate(nonlinearity=lambda x: np.sin(-x / k) - x / k / 2)
        metric = hi.NonlinearityPercentError(interval=[-3, 3], up_to=["gain"])
        assert hi.score(turned, record, e=metric)["e"] > 90.0
        metric = hi.NonlinearityPercentError(interval=[-3, 3], up_to=["gain", "sign"])
        assert hi.score(turned, record, e=metric)["e"] < 1e-5

    def test_a_factor_of_the_output_is_no_freedom_of_it(self):
        system = hi.Wiener(nonlinearity=hi.Polynomial(coefficients=[0, 1, 0, 0.5]), linear=hi.Ar(a=[0.5]))
        record = hi.simulate(system, INPUT, 10)
        estimate = hi.Estimate(nonlinearity=lambda x: 3.0 * (x + 0.5 * x**3))
        metric = hi.NonlinearityPercentError(interval=[-3, 3], up_to=["gain"])
        assert hi.score(estimate, record, e=metric)["e"] > 1.0

    def test_between_two_blocks_there_is_a_factor_on_either_side(self):
        first, second = BLOCKS
        system = hi.WienerHammerstein(input_linear=first, nonlinearity=QUADRATIC, output_linear=second)
        record = hi.simulate(system, hi.Sine(frequency=1), 8, dt=0.1)
        estimate = hi.Estimate(nonlinearity=lambda x: -3.0 * (x / 4 + 0.5 * (x / 4) ** 2))
        for up_to, least, most in ((["gain"], 50.0, 101.0), (["gain", "sign"], 0.0, 1e-5)):
            metric = hi.NonlinearityPercentError(interval=[-1, 1], up_to=up_to)
            assert least <= hi.score(estimate, record, e=metric)["e"] <= most

    def test_where_the_estimate_ends_its_factors_do(self):
        def ends(x):
            with np.errstate(all="ignore"):
                return np.where(np.abs(x) <= 2.0, 0.5 * x + (0.5 * x) ** 3, np.nan)

        system = hi.Wiener(nonlinearity=hi.Polynomial(coefficients=[0, 1, 0, 1]), linear=hi.Ar(a=[0.5]))
        record = hi.simulate(system, INPUT, 10)
        metric = hi.NonlinearityPercentError(interval=[-1, 1], up_to=["gain"])
        assert hi.score(hi.Estimate(nonlinearity=ends), record, e=metric)["e"] < 1e-5


class TestHammersteinFactors:
    def test_factor_and_constant_by_hand(self):
        system = hi.Hammerstein(nonlinearity=hi.Polynomial(coefficients=[0, 0, 1]), linear=LAG)
        record = hi.simulate(system, INPUT, 10)
        # u^2 against a constant: what is left is the variance 4/45 of u^2, of E u^4 = 1/5.
        flat = hi.Estimate(nonlinearity=np.ones_like)
        for up_to, expected in (
            (["constant"], 100.0 * np.sqrt(4 / 9)),
            (["gain"], 100.0 * np.sqrt(4 / 9)),
            ([], 100.0 * np.sqrt((1 / 5 - 2 / 3 + 1) * 5)),
        ):
            metric = hi.NonlinearityPercentError(interval=[-1, 1], up_to=up_to)
            assert hi.score(flat, record, e=metric)["e"] == pytest.approx(expected, rel=1e-9)

    @pytest.mark.parametrize("at", ["grid", "samples", "left_out_samples"])
    def test_the_mise_up_to_a_constant(self, at):
        system = hi.Hammerstein(nonlinearity=QUADRATIC, linear=hi.Fir(b=[1, 0.5]))
        record = hi.simulate(system, INPUT, 4000)
        kernel = hi.Kernel(**KERNEL)
        found = hi.fit(kernel, record)
        scores = []
        for up_to in (None, [], ["constant"]):
            metric = hi.IntegratedSquaredError(interval=[-0.8, 0.8], at=at, up_to=up_to)
            scores.append(hi.score(found, record, kernel, e=metric)["e"])
        # The paper's error counts the constant, half of E w = 1/6.
        assert scores[1] == pytest.approx(1.6 / 144 + scores[2], rel=0.3)
        assert scores[0] == scores[2] < 0.3 * scores[1]

    def test_samples_are_no_arguments_of_a_wiener_nonlinearity(self, tmp_path):
        text = """\
version: 1
title: Samples
trials: 2
samples: 200
system: {kind: wiener, nonlinearity: identity, linear: {kind: ar, a: [0.5]}}
excitation: {kind: iid, distribution: uniform, low: -1, high: 1}
estimators: {e: {kind: voros_wiener, n: 1, m: 1, delay: 0, degree: 2}}
metrics: {m: {kind: mise, interval: [-1, 1], at: samples, up_to: [gain]}}
"""
        (message,) = plans.refusals(tmp_path, text)
        assert "is 'at: samples' of the input, and the nonlinearity's argument is the output of a" in message
