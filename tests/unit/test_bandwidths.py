"""Bandwidths of kernel regression by rules."""

import math

import numpy as np
import pytest

import hident as hi
from hident import plugins
from hident.arrays import Array
from hident.config.spec import Of
from hident.errors import ConfigError, EstimationError
from hident.estimators.nonparametric.bandwidths import RULES, KernelConstants, _Binned, plug_in, rule_of_thumb
from hident.estimators.nonparametric.kernel import _CONSTANTS, KernelRegression
from hident.records import Record, needed

plugins.load()
GAUSSIAN = _CONSTANTS["gaussian"]


def samples(n, m, std, seed=0, low=-3.0, high=3.0) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    u = np.sort(rng.uniform(low, high, n))
    return u, m(u) + rng.normal(0.0, std, n)


@pytest.mark.parametrize("kernel", [*_CONSTANTS])
def test_the_constants_of_the_kernels(kernel):
    """From the kernel itself: the weight of a sample at zero at the points x."""
    x = np.linspace(-9.0, 9.0, 200_001)
    sums = KernelRegression(np.zeros(1), np.ones(1), kernel=kernel, bandwidth=1.0)._sums
    weights = sums.weights(np.zeros(len(x)), x)
    step = x[1] - x[0]
    mass = step * weights.sum()
    assert _CONSTANTS[kernel].roughness == pytest.approx(step * np.sum(weights**2) / mass**2, rel=1e-3)
    assert _CONSTANTS[kernel].variance == pytest.approx(step * np.sum(x**2 * weights) / mass, rel=1e-3)


def test_the_plug_in_bandwidth_approaches_the_optimal_one():
    # The mean of m''^2 = 16 sin(2u)^2 on [-3, 3].
    theta = 8.0 * (1.0 - math.sin(12.0) / 12.0)
    for n, within in ((300, 0.2), (3000, 0.12), (30000, 0.05)):
        ratios = [
            plug_in(*samples(n, lambda u: np.sin(2.0 * u), 0.3, seed), GAUSSIAN)
            / GAUSSIAN.bandwidth(0.09, 6.0, theta, n)
            for seed in range(5)
        ]
        assert abs(np.mean(ratios) - 1.0) < within, (n, ratios)


def test_the_rule_of_thumb_is_optimal_for_a_quartic():
    for n in (200, 20000):
        found = [
            rule_of_thumb(*samples(n, lambda u: u**4 - 3.0 * u**2, 1.0, seed, -1.0, 1.0), GAUSSIAN)
            for seed in range(5)
        ]
        # The central 90 % of [-1, 1]: m'' = 12 u^2 - 6.
        u = np.linspace(-0.9, 0.9, 10001)
        expected = GAUSSIAN.bandwidth(1.0, 2.0, float(np.mean((12.0 * u**2 - 6.0) ** 2)), n)
        np.testing.assert_allclose(np.mean(found), expected, rtol=0.15 if n == 200 else 0.02)


@pytest.mark.parametrize("rule", [*RULES])
class TestEachRule:
    def test_follows_the_units(self, rule):
        u, y = samples(300, np.sin, 0.2)
        h = RULES[rule](u, y, GAUSSIAN)
        assert RULES[rule](4.0 * u, y, GAUSSIAN) == pytest.approx(4.0 * h, rel=1e-9)
        assert RULES[rule](u + 10.0, y, GAUSSIAN) == pytest.approx(h, rel=1e-6)
        assert RULES[rule](u, -8.0 * y, GAUSSIAN) == pytest.approx(h, rel=1e-9)
        assert RULES[rule](u, y + 5.0, GAUSSIAN) == pytest.approx(h, rel=1e-6)

    def test_takes_the_constants_of_the_kernel(self, rule):
        u, y = samples(300, np.sin, 0.2)
        ratio = RULES[rule](u, y, KernelConstants(0.5, 1.0 / 3.0)) / RULES[rule](u, y, GAUSSIAN)
        # The canonical bandwidths of Marron and Nolan 1988: (R/mu^2)^(1/5).
        assert ratio == pytest.approx((4.5 / GAUSSIAN.roughness) ** 0.2, rel=1e-12)

    def test_of_a_line_it_is_no_wider_than_the_input(self, rule):
        h = RULES[rule](*samples(100, lambda u: u, 5.0), GAUSSIAN)
        assert 0.3 < h <= 6.0

    def test_what_gives_no_bandwidth_is_said(self, rule):
        u, y = samples(100, lambda u: u**3, 0.0)
        with pytest.raises(
            EstimationError, match=r"^no noise is left beside a smooth curve, so that no band"
        ):
            RULES[rule](u, y, GAUSSIAN)
        with pytest.raises(
            EstimationError, match=r"^a bandwidth from the data needs at least 10 samples, not 9"
        ):
            RULES[rule](u[:9], y[:9], GAUSSIAN)
        few = np.repeat([-1.0, 0.0, 1.0], 30)
        with pytest.raises(EstimationError, match=r"^the input takes too few different values"):
            RULES[rule](few, np.random.default_rng(0).normal(size=90), GAUSSIAN)

    def test_an_estimate_holds_it(self, rule):
        u, y = samples(200, np.sin, 0.2)
        shuffled = np.random.default_rng(1).permutation(200)
        record = Record(u[shuffled], y[shuffled])
        kernel = hi.Kernel(kernel="epanechnikov", bandwidth=rule)
        found = hi.fit(kernel, record)
        h = RULES[rule](u, y, _CONSTANTS["epanechnikov"])
        assert found.values == {"bandwidth": h}
        assert kernel.provides() == found.provides()
        given = hi.fit(hi.Kernel(kernel="epanechnikov", bandwidth={"h0": h, "alpha": 0}), record)
        points = np.linspace(-3.0, 3.0, 50)
        assert np.array_equal(needed(found.nonlinearity)(points), needed(given.nonlinearity)(points))
        assert given.values == {}


def test_moments_on_the_grid_are_the_sums():
    u, y = samples(300, np.sin, 0.2)
    binned = _Binned.of(u, y)
    x = binned.step * np.arange(401)
    d = (x[:, None] - x[None, :]) / 0.3
    for weights in (binned.counts, binned.y):
        for squared in (False, True):
            kernel = np.exp(-0.5 * d**2) ** (1 + squared)
            expected = [(weights[:, None] * kernel * d**r).sum(axis=0) for r in range(4)]
            found = binned._moments(weights, 0.3, 4, squared=squared)
            np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)
    assert binned.counts.sum() == pytest.approx(300)
    assert binned.y.sum() == pytest.approx(y.sum())


def test_a_line_leaves_nothing_of_a_local_line():
    u = np.linspace(0.0, 1.0, 401)
    residual, freedom = _Binned.of(u, 2.0 * u).residual(0.1, 2.0 * u)
    assert abs(residual) < 1e-10
    assert 380 < freedom < 401


def test_what_a_bandwidth_can_be():
    for wrong, message in (
        (
            "plugin",
            "'h0' and 'alpha', or a rule: rule_of_thumb, plug_in; did you mean 'plug_in'?",
        ),
        (0.3, "must be a mapping with 'h0' and 'alpha', or a rule: rule_of_thumb, plug_in"),
    ):
        with pytest.raises(ConfigError) as caught:
            hi.Kernel(kernel="gaussian", bandwidth=wrong)
        assert message in str(caught.value)
    with pytest.raises(ConfigError, match=r"^Kernel: bandwidth.alpha: is required"):
        hi.Kernel(kernel="gaussian", bandwidth={"h0": 1})
    for rule in RULES:
        spec = Of("estimator").validate({"kind": "kernel", "kernel": "gaussian", "bandwidth": rule})
        assert spec == hi.Kernel(kernel="gaussian", bandwidth=rule)
