"""Tests of residuals: how often they blame a model that is right, and what they find in one that is wrong."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.stats import binom, chi2
from scipy.stats import f as f_distribution

from hident.errors import EstimationError
from hident.numerics.judgement import judgement
from hident.numerics.parts import joined
from hident.numerics.residuals import (
    Innovations,
    dependence,
    drift,
    nonlinear_functions,
    normality,
    offset,
    regression_test,
    uneven_spread,
    whiteness,
)
from hident.records import needed

QUICK = settings(deadline=None, derandomize=True, max_examples=15)
TRIALS, N, LEVEL = 200, 300, 0.05
NOISES = {
    "white": ([1.0], [1.0]),
    "ar": ([1.0], [1.0, -0.9]),
    "ma": ([1.0, 0.9], [1.0]),
    "arma": ([1.0, 0.5], [1.0, -1.5, 0.8]),
}
# By what makes a sample of a white input one of this kind.
INPUTS = {
    "white": lambda x: x,
    "held": lambda x: np.repeat(x[::15], 15),
    "slow": lambda x: lfilter([1.0], [1.0, -0.95], x),
    "binary": lambda x: np.repeat(np.sign(x[::5]), 5),
    "sines": lambda x: np.sin(np.arange(len(x)) / 6.0) + np.sin(np.arange(len(x)) / 1.7),
}


def coloured(kind, rng, n=N):
    return lfilter(*NOISES[kind], rng.normal(size=n + 300))[300:]


def system(u, *, delay=1):
    """A saturation before a lag."""
    return lfilter([*[0.0] * delay, 0.5], [1.0, -0.5], np.tanh(u))


def share(p_values):
    return float(np.mean(np.array(p_values) < LEVEL))


def is_the_level(found):
    """Whether a share of the trials is no more off the level than one in a thousand such would be."""
    low, high = binom.ppf([0.0005, 0.9995], TRIALS, LEVEL) / TRIALS
    return low <= found <= high


class TestAModelThatIsRight:
    @pytest.mark.parametrize(
        ("noise", "given_input"),
        [
            *((noise, given_input) for noise in NOISES for given_input in ("white", "slow")),
            *(("ar", given_input) for given_input in ("held", "binary", "sines")),
        ],
    )
    def test_is_blamed_for_the_input_as_often_as_the_level_says(self, noise, given_input):
        rng, linear, nonlinear, beyond = np.random.default_rng(1), [], [], []
        for _ in range(TRIALS // 2):
            for part in (rng.normal(size=N), rng.uniform(-2.0, 2.0, size=N)):
                u, e = INPUTS[given_input](part), coloured(noise, rng)
                found = judgement(u, system(u) + 0.1 * e, system(u), level=LEVEL)
                linear.append(needed(found.input).test.p_value)
                beyond.append(np.mean(np.abs(needed(found.input).values) > needed(found.input).band))
                nonlinear.append(needed(found.nonlinearity).p_value)
        assert is_the_level(share(linear))
        # Bonferroni's bound on tests that are much alike.
        assert share(nonlinear) <= binom.ppf(0.9995, TRIALS, LEVEL) / TRIALS
        assert np.mean(beyond) == pytest.approx(LEVEL, abs=0.025)

    @pytest.mark.parametrize("lengths", [(N,), (120, 80, 60, 40)])
    def test_with_white_noise_passes_all_other_tests_at_their_level(self, lengths):
        rng, parts = np.random.default_rng(2), joined(lengths)
        found: dict[str, list[float]] = {}
        for _ in range(TRIALS):
            e, y = rng.normal(size=(2, sum(lengths)))
            innovations = Innovations.of(e, parts)
            trends = drift(e, parts)
            for name, test in {
                "whiteness": whiteness(e, parts).test,
                "normality": normality(innovations.white(e)).test,
                "trend": trends.mean,
                "growth": trends.variance,
                "both": trends.test,
                "offset": offset(e, innovations),
                "spread": uneven_spread(e, y, innovations),
                "input": dependence("y", e, y, innovations).test,
            }.items():
                found.setdefault(name, []).append(test.p_value)
        shares = {name: share(p_values) for name, p_values in found.items()}
        assert {name for name, one in shares.items() if not is_the_level(one)} == set(), shares

    def test_with_coloured_noise_does_not_drift_and_is_normal(self):
        rng = np.random.default_rng(3)
        found: dict[str, list[float]] = {}
        for _ in range(TRIALS):
            e = coloured("ar", rng)
            innovations = Innovations.of(e)
            tests = drift(e).test, offset(e, innovations), normality(innovations.white(e)).test
            for name, test in zip(("drift", "offset", "normality"), tests, strict=True):
                found.setdefault(name, []).append(test.p_value)
        # A trend is not told from slow noise in 300 samples as well as from white one.
        assert all(share(p_values) <= 0.12 for p_values in found.values()), {
            k: share(v) for k, v in found.items()
        }

    def test_would_be_blamed_by_bands_for_white_noise(self):
        """What the correction is for: two slow signals look dependent to the plain band."""
        rng, plain = np.random.default_rng(4), []
        for _ in range(100):
            u, e = INPUTS["slow"](rng.normal(size=N)), coloured("ar", rng)
            found = dependence("u", e, u, Innovations.of(e), level=LEVEL)
            plain.append(np.mean(np.abs(found.values) > 1.96 / np.sqrt(N)))
            assert found.band[0] > 1.5 * 1.96 / np.sqrt(N)
        assert np.mean(plain) > 0.4


class TestAModelThatIsWrong:
    def judged(self, y_hat_of, *, noise="white", n=1000, seed=5, y_of=system):
        rng = np.random.default_rng(seed)
        u = rng.normal(size=n)
        return judgement(u, y_of(u) + 0.1 * coloured(noise, rng, n), y_hat_of(u))

    @pytest.mark.parametrize("noise", ["white", "ar"])
    def test_by_a_delay_is_found_in_the_input(self, noise):
        found = self.judged(lambda u: system(u, delay=2), noise=noise)
        assert needed(found.input).test.p_value < 1e-10
        assert needed(found.input).lags[needed(found.input).largest] == 1

    def test_by_a_missing_square_is_found_in_it_alone(self):
        found = self.judged(system, y_of=lambda u: system(u) + 0.05 * np.r_[0.0, 0.0, u[:-2] ** 2])
        tests = {name: one.test.p_value for name, one in found.nonlinear_input.items()}
        assert tests["u^2"] < 1e-10
        assert found.nonlinear_input["u^2"].lags[found.nonlinear_input["u^2"].largest] == 2
        assert tests["u^3"] > 0.01
        assert needed(found.input).test.p_value > 0.01

    def test_by_a_line_in_place_of_a_saturation_is_found_in_the_cube(self):
        found = self.judged(lambda u: lfilter([0.0, 0.3], [1.0, -0.5], u))
        assert found.nonlinear_input["u^3"].test.p_value < 1e-10
        assert needed(found.nonlinearity).p_value < 1e-10

    @pytest.mark.parametrize(
        ("size", "least"),
        [(0.02, 0.15), (0.05, 0.9)],
    )
    def test_is_found_the_more_often_the_more_it_is_wrong(self, size, least):
        found = [
            needed(
                self.judged(system, seed=seed, y_of=lambda u: system(u) + size * u**2).nonlinearity
            ).p_value
            for seed in range(60)
        ]
        assert np.mean(np.array(found) < 0.01) >= least

    @pytest.mark.parametrize("delay", [1, 60])
    def test_however_fast_it_is_sampled(self, delay):
        """Lags of 20 samples would see nothing of a response that begins after 60."""
        rng = np.random.default_rng(20)
        u = np.repeat(rng.normal(size=200), 20)
        slow = [*[0.0] * delay, 0.05], [1.0, -0.95]
        y, e = lfilter(*slow, np.tanh(u)), 0.05 * coloured("ar", rng, len(u))
        found = judgement(u, y + e, lfilter(*slow, 0.6 * u))
        assert found.nonlinear_input["u^3"].test.p_value < 1e-6
        assert needed(judgement(u, y + e, y).nonlinearity).p_value > 0.01

    def test_in_its_gain_is_not_blamed_for_the_nonlinearity(self):
        rng, found = np.random.default_rng(21), []
        for _ in range(100):
            u, e = rng.uniform(-1.0, 1.0, size=500), 0.02 * rng.normal(size=500)
            y = np.convolve(u, [0.5, 0.5])[:500]
            found.append(needed(judgement(u, y + e, 0.8 * y).nonlinearity).p_value)
        assert share(found) <= binom.ppf(0.9995, 100, LEVEL) / 100

    def test_by_a_drift_is_found_by_its_size(self):
        found = self.judged(system, y_of=lambda u: system(u) + np.linspace(0.0, 0.1, len(u))).drift
        assert found.mean.p_value < 1e-6
        assert found.change == pytest.approx(0.1, abs=0.03)
        assert found.variance.p_value > 0.01

    def test_by_noise_that_grows(self):
        e = np.random.default_rng(6).normal(size=1000) * np.linspace(1.0, 2.0, 1000)
        found = drift(e)
        assert found.variance.p_value < 1e-6
        assert found.growth > 0.5
        assert drift(e[::-1]).growth < -0.5
        assert found.mean.p_value > 0.01

    def test_by_noise_that_depends_on_the_output(self):
        rng = np.random.default_rng(7)
        u, e = rng.normal(size=(2, 1000))
        y = system(u)
        found = judgement(u, y + 0.1 * (1.0 + 2.0 * np.abs(y)) * e, y)
        assert needed(found.spread).p_value < 1e-6
        assert needed(found.input).test.p_value > 0.01

    def test_by_outliers(self):
        e = np.random.default_rng(8).normal(size=1000)
        e[::100] *= 8.0
        found = normality(e)
        assert found.test.p_value < 1e-6
        assert found.excess_kurtosis > 3.0


class TestNumbers:
    def test_of_ljung_and_box(self):
        e = np.random.default_rng(9).normal(size=500)
        c = e - np.mean(e)
        r = np.array([c[k:] @ c[:-k] for k in range(1, 21)]) / (c @ c)
        q = 500 * 502 * np.sum(r**2 / (500 - np.arange(1, 21)))
        found = whiteness(e, level=0.05)
        np.testing.assert_allclose(found.values, r)
        assert found.test.statistic == pytest.approx(q)
        assert found.test.p_value == pytest.approx(chi2.sf(q, 20))
        assert whiteness(e, fitted=3).test.p_value == pytest.approx(chi2.sf(q, 17))
        np.testing.assert_allclose(found.band, 1.96 / np.sqrt(500), rtol=0.03)

    def test_of_the_regression(self):
        rng = np.random.default_rng(10)
        w, columns, others = rng.normal(size=60), rng.normal(size=(60, 3)), rng.normal(size=(60, 2)) + 5.0

        def left(x):
            return float(np.sum((w - x @ np.linalg.lstsq(x, w, rcond=None)[0]) ** 2))

        less, more = left(np.hstack([others, columns])), left(others)
        statistic = ((more - less) / 3) / (less / (60 - 5 - 1))
        found = regression_test(w, columns, [others], spent=1)
        assert found.statistic == pytest.approx(statistic)
        assert found.p_value == pytest.approx(f_distribution.sf(statistic, 3, 54))
        twice = regression_test(w, np.hstack([columns, columns[:, :1]]), [others], spent=1)
        assert twice.p_value == pytest.approx(found.p_value)

    def test_of_the_band_of_two_first_order_signals(self):
        """Bartlett: N var r = (1 + a b)/(1 - a b) for the poles a and b."""
        rng = np.random.default_rng(11)
        e, x = (lfilter([1.0], [1.0, -pole], rng.normal(size=200_000)) for pole in (0.8, 0.5))
        found = dependence("x", e, x, Innovations.of(e), level=0.05)
        assert found.band[0] == pytest.approx(1.96 * np.sqrt(1.4 / 0.6 / 200_000), rel=0.03)

    @QUICK
    @given(
        scale=st.floats(1e-6, 1e6),
        offset=st.floats(-1e3, 1e3),
        u_scale=st.floats(1e-6, 1e6),
        seed=st.integers(0, 99),
    )
    def test_do_not_depend_on_units(self, scale, offset, u_scale, seed):
        rng = np.random.default_rng(seed)
        u, e = rng.normal(size=(2, 200))
        y = system(u)
        one = judgement(u, y + e, y)
        other = judgement(u_scale * (u + offset), scale * (y + e + offset), scale * (y + offset))
        for name in ("whiteness", "input", "normality", "drift"):
            assert getattr(other, name).test.p_value == pytest.approx(
                getattr(one, name).test.p_value, rel=1e-4
            )
        assert needed(other.nonlinearity).p_value == pytest.approx(needed(one.nonlinearity).p_value, rel=1e-4)
        assert needed(other.spread).p_value == pytest.approx(needed(one.spread).p_value, rel=1e-4)


class TestSeveralExperiments:
    LENGTHS = (90, 60, 50)

    def record(self):
        rng = np.random.default_rng(12)
        u, e = rng.normal(size=(2, sum(self.LENGTHS)))
        return u, e, system(u)

    def test_products_stay_inside_of_each(self):
        _, e, _ = self.record()
        e -= np.mean(e)
        found = whiteness(e, joined(self.LENGTHS))
        pieces = [e[part] for part in joined(self.LENGTHS)]
        for k, value in zip(found.lags, found.values, strict=True):
            wanted = sum(piece[t] * piece[t - k] for piece in pieces for t in range(k, len(piece)))
            assert value == pytest.approx(wanted / (e @ e))

    def test_their_order_does_not_matter(self):
        u, e, y = self.record()
        places = joined(self.LENGTHS)
        turned = [np.concatenate([x[places[i]] for i in (2, 0, 1)]) for x in (u, e, y)]
        one = judgement(u, y + e, y, places)
        other = judgement(turned[0], turned[2] + turned[1], turned[2], joined([50, 90, 60]))
        assert one.sentences == other.sentences
        np.testing.assert_allclose(needed(one.input).values, needed(other.input).values, atol=1e-12)
        np.testing.assert_allclose(needed(one.input).band, needed(other.input).band)
        assert one.drift.test.p_value == pytest.approx(other.drift.test.p_value)
        assert needed(one.nonlinearity).p_value == pytest.approx(needed(other.nonlinearity).p_value)

    def test_what_depends_on_the_experiment_before_is_not_seen(self):
        """Every experiment's residuals follow the input of the one before: across, not inside."""
        rng = np.random.default_rng(13)
        u = rng.normal(size=(40, 25))
        e = 0.1 * rng.normal(size=(40, 25))
        e[1:, :2] += u[:-1, -2:]
        inside = dependence("u", e.ravel(), u.ravel(), Innovations.of(e.ravel(), joined([25] * 40)))
        across = dependence("u", e.ravel(), u.ravel(), Innovations.of(e.ravel()))
        assert across.test.p_value < 1e-6
        assert inside.test.p_value > 0.01

    def test_a_trend_is_that_inside_of_each(self):
        rng = np.random.default_rng(14)
        e = 0.1 * rng.normal(size=(4, 100))
        saw = e + np.linspace(0.0, 0.2, 100)
        assert drift(saw.ravel(), joined([100] * 4)).change == pytest.approx(0.2, abs=0.05)
        assert drift(saw.ravel(), joined([100] * 4)).mean.p_value < 1e-6


class TestWhatCannotBeJudged:
    def test_too_few_residuals(self):
        with pytest.raises(
            EstimationError,
            match="39 residuals, at most 39 in one experiment, are too few to be judged: 40 are needed, "
            "and 20 in one experiment",
        ):
            judgement(np.zeros(39), np.arange(39.0), np.zeros(39))
        with pytest.raises(EstimationError, match="60 residuals, at most 15 in one experiment, are too few"):
            judgement(np.zeros(60), np.arange(60.0), np.zeros(60), joined([15] * 4))

    def test_residuals_that_are_not_finite(self):
        y = np.arange(50.0)
        y[[3, 7]] = np.nan
        with pytest.raises(EstimationError, match="2 of 50 residuals are not finite"):
            judgement(np.zeros(50), y, np.zeros(50))

    def test_rounding(self):
        y = system(np.random.default_rng(15).normal(size=100))
        found = judgement(np.zeros(100), y, y * (1.0 + 1e-15))
        assert found.sentences == (
            "The model gives the output up to rounding: there are no residuals to judge.",
        )
        assert found.sound

    def test_a_constant_input(self):
        e = np.random.default_rng(16).normal(size=100)
        found = judgement(np.ones(100), e + 2.0, np.full(100, 2.0))
        assert found.input is None
        assert found.spread is None
        assert found.nonlinearity is None
        assert "Whether the residuals depend on the input cannot be told: it is constant." in found.sentences

    def test_a_binary_input_has_no_powers(self):
        u = np.sign(np.random.default_rng(17).normal(size=200))
        assert list(nonlinear_functions(u, system(u))) == ["u y", "y^2"]

    def test_a_regressor_that_is_a_sum_of_others(self):
        w = np.random.default_rng(18).normal(size=50)
        one = np.ones((50, 1))
        with pytest.raises(
            EstimationError, match="the signal is a sum of those that the residuals are tested beside"
        ):
            regression_test(w, 2.0 * one, [one])
        with pytest.raises(
            EstimationError, match="5 residuals are too few for 5 regressors and 1 before them"
        ):
            regression_test(w[:5], np.eye(5), spent=1)


class TestSentences:
    def of(self, y_of, noise="white", by="simulation", seed=19):
        rng = np.random.default_rng(seed)
        u = rng.normal(size=2000)
        return judgement(u, y_of(u) + 0.05 * coloured(noise, rng, 2000), system(u), by=by)

    def test_of_a_model_that_is_right(self):
        found = self.of(system)
        assert found.sound
        assert [sentence.rpartition(" (")[0] for sentence in found.sentences] == [
            "The residuals are white up to lag 20",
            "The residuals do not depend linearly on the input",
            "The residuals do not depend on u^2, u^3, |u|, u y, y^2 of the model's past",
            "The residuals do not drift",
            "The spread of the residuals does not depend on the output",
            "The residuals look normal",
        ]

    def test_of_coloured_noise(self):
        found = self.of(system, "ar")
        (said,) = found.complaints
        assert said.startswith("The residuals are not white: lag 1 has the correlation 0.9")
        assert said.endswith(
            "p < 0.001: the noise is coloured; a fit of the simulation error stays consistent, but its "
            "standard errors need the sandwich or an AR model of the noise."
        )
        (said,) = self.of(system, "ar", by="prediction").complaints
        assert said.endswith("p < 0.001: the noise model leaves this unexplained, try a higher order.")

    def test_of_a_wrong_delay(self):
        found = self.of(lambda u: system(u, delay=2))
        assert not found.sound
        assert found.complaints[0].endswith("p < 0.001: what stands below does this too.")
        assert any(
            said.startswith("The residuals depend on the input: lag 1 has the correlation -0.")
            and said.endswith("the linear dynamics leave something out, look at the delay and the orders.")
            for said in found.complaints
        )

    def test_of_a_level_that_is_off(self):
        found = self.of(lambda u: system(u) + 0.03)
        assert any(
            said.startswith("The residuals have the mean 0.0")
            and said.endswith("the level of the model is off.")
            for said in found.complaints
        )
