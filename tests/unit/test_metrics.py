"""Scores of an estimate against the truth."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hident as hi
from hident.errors import ConfigError
from hident.linear_blocks import TransferFunction
from hident.metrics.disturbance import DisturbanceVariance, DisturbanceVarianceFormula
from hident.metrics.nonlinearity import IntegratedSquaredError, NonlinearityPercentError, quadrature
from hident.metrics.values import Coverage, Error, PercentError, Share, Value
from hident.records import Estimate, Record, Truth
from hident.systems.nonlinearity import Mzyk2009

PI2 = (-2 * np.pi, 2 * np.pi)
MU = Mzyk2009()
ENERGY = 5 * np.pi**3 / 3 - 8 * np.pi
ZERO = Estimate(nonlinearity=np.zeros_like)


def record(u, y=None, **truth):
    u = np.asarray(u, dtype=float)
    return Record(u, u.copy() if y is None else y, truth=Truth(**truth))


def jumping(u=(0.0,)):
    return record(u, nonlinearity=MU, breakpoints=MU.break_points())


@pytest.mark.parametrize(("points", "tolerance"), [(8, 1e-5), (100, 1e-12), (4096, 1e-12)])
def test_the_integral_is_exact_across_the_jump(points, tolerance):
    (found,) = IntegratedSquaredError(interval=PI2, points=points).evaluate(ZERO, jumping())
    assert found == pytest.approx(ENERGY, rel=tolerance)


def test_the_breaks_are_what_makes_it_exact():
    blind = record([0.0], nonlinearity=MU)
    (found,) = IntegratedSquaredError(interval=PI2, points=99 * 8).evaluate(ZERO, blind)
    assert abs(found - ENERGY) > 1e-4


@settings(deadline=None, derandomize=True, max_examples=50)
@given(
    low=st.floats(-5, 4),
    width=st.floats(0.1, 10),
    breaks=st.lists(st.floats(-6, 16), max_size=5).map(sorted),
    points=st.integers(8, 300),
)
def test_quadrature_integrates_polynomials_between_any_breaks(low, width, breaks, points):
    high = low + width
    nodes, weights = quadrature(low, high, breaks, points)
    assert len(nodes) >= points
    assert np.all((nodes > low) & (nodes < high))
    assert weights.sum() == pytest.approx(width, rel=1e-12)
    assert weights @ nodes**5 == pytest.approx((high**6 - low**6) / 6, rel=1e-9, abs=1e-9)


def test_sample_points_stand_for_the_integral_under_a_uniform_input():
    u = np.random.default_rng(0).uniform(*PI2, 200_000)
    (found,) = IntegratedSquaredError(interval=PI2, at="samples").evaluate(ZERO, jumping(u))
    assert found == pytest.approx(ENERGY, rel=0.02)


def test_sample_points_outside_the_interval_do_not_count():
    score = IntegratedSquaredError(interval=(-1.0, 1.0), at="samples")
    inside = record([0.5], nonlinearity=np.abs)
    more = record([0.5, 7.0, -3.0], nonlinearity=np.abs)
    assert score.evaluate(ZERO, inside) == score.evaluate(ZERO, more) == pytest.approx((0.5,))
    assert np.isnan(score.evaluate(ZERO, record([2.0], nonlinearity=np.abs)))


def test_percent_error_of_a_nonlinearity():
    half = Estimate(nonlinearity=lambda u: 0.5 * MU(u))
    (found,) = NonlinearityPercentError(interval=PI2).evaluate(half, jumping())
    assert found == pytest.approx(50.0, rel=1e-12)
    flat = record([0.0], nonlinearity=np.zeros_like)
    assert np.isnan(NonlinearityPercentError(interval=PI2).evaluate(half, flat)[0])


def test_named_values():
    found = Estimate(values={"a_1": 0.9, "a_2": -0.4})
    data = record([0.0], values={"a_1": 0.8, "a_2": -0.2})
    both = ("a_1", "a_2")
    assert Value(of=both).evaluate(found, data) == [0.9, -0.4]
    assert Error(of=both).evaluate(found, data) == pytest.approx([0.1, -0.2])
    assert PercentError(of=both).evaluate(found, data) == pytest.approx((30.0,))
    assert Error(of=both).labels("error") == ("error a_1", "error a_2")
    assert PercentError(of=both).labels("error") == ("error",)
    assert np.isnan(PercentError(of=("a_1",)).evaluate(found, record([0.0], values={"a_1": 0.0}))[0])


def test_shares_and_coverage_are_percentages():
    data = record([0.0], values={"a_1": 0.8, "a_2": -0.2})
    found = Estimate(values={"a_1": 0.9, "a_2": -0.4, "se_a_1": 0.06, "se_a_2": 0.06, "order": 1.0})
    assert Share(of=("order",), equals=1).evaluate(found, data) == [100.0]
    assert Share(of=("order",), equals=2).evaluate(found, data) == [0.0]
    assert [Share(of=("order",), at_most=k).evaluate(found, data) for k in (0.5, 1, 2)] == [
        [0.0],
        [100.0],
        [100.0],
    ]
    both = ("a_1", "a_2")
    assert Coverage(of=both).evaluate(found, data) == [100.0, 0.0]
    assert Coverage(of=both, confidence=0.5).evaluate(found, data) == [0.0, 0.0]
    assert Coverage(of=("a_1",)).needs_of_estimate() == {"value a_1", "value se_a_1"}
    assert Coverage(of=both).labels("c") == ("c a_1", "c a_2")


def test_what_metrics_need():
    assert Error(of=("a_1",)).needs_of_truth() == Error(of=("a_1",)).needs_of_estimate() == {"value a_1"}
    assert Value(of=("a_1",)).needs_of_truth() == frozenset()
    assert IntegratedSquaredError(interval=PI2).needs_of_truth() == {"nonlinearity"}
    assert DisturbanceVariance().needs_of_estimate() == frozenset()
    assert DisturbanceVariance(filtered=True).needs_of_estimate() == {"linear"}


def test_disturbance_variances_agree_with_their_formulas():
    rng = np.random.default_rng(1)
    u, z = rng.normal(0.0, 10.0, 400_000), rng.normal(0.0, 1.0, 400_000)
    block = TransferFunction(a=(0.8,))
    data = record(u, block.filter(u) + z, nonlinearity=lambda x: x, linear=block)
    found = Estimate(linear=block)
    for filtered, value in ((False, 1 + 100 * 0.64 / 0.36), (True, 1.64)):
        (simulated,) = DisturbanceVariance(filtered=filtered).evaluate(found, data)
        formula = DisturbanceVarianceFormula(noise_variance=1, w_variance=100, filtered=filtered)
        assert formula.evaluate(found, data) == pytest.approx((value,), rel=1e-12)
        assert simulated == pytest.approx(value, rel=0.01)


def test_leaving_out_the_square_of_eq_20_gives_the_printed_401():
    formula = DisturbanceVarianceFormula(noise_variance=1, w_variance=100, squared=False)
    data = record([0.0], linear=TransferFunction(a=(0.8,)))
    assert formula.evaluate(Estimate(), data) == pytest.approx((401.0,), rel=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: IntegratedSquaredError(interval=(1, 1)), r"must be \[low, high\] with low < high"),
        (lambda: IntegratedSquaredError(interval=PI2, points=7), "must be greater than or equal to 8"),
        (lambda: Error(of=()), r"must name at least one value, e.g. \[a_1\]"),
        (lambda: Share(of=("order",)), "give either 'equals' or 'at_most'"),
        (lambda: Share(of=("order",), equals=1, at_most=2), "give either 'equals' or 'at_most'"),
    ],
)
def test_messages(make, message):
    with pytest.raises(ConfigError, match=message):
        make()


def test_the_reduction_is_the_error_without_the_prefilter_over_that_with_it():
    system = hi.Hammerstein(nonlinearity="mzyk2009", linear=hi.Ar(a=[0.8]))
    record = hi.simulate(system, hi.Iid(distribution="uniform", low=-6, high=6), 200, noise=hi.White(std=0.1))
    plain = hi.Kernel(kernel="window_unit", bandwidth={"h0": 0.2, "alpha": "1/5"})
    filtered = plain.model_copy(update={"prefilter": hi.LeastSquares(order=1)})
    for at in ("grid", "samples", "left_out_samples"):
        scored = {"at": at, "interval": [-6, 6]}
        error = hi.IntegratedSquaredError(**scored)
        without, left = (hi.score(hi.fit(one, record), record, e=error)["e"] for one in (plain, filtered))
        times = hi.score(hi.fit(filtered, record), record, times=hi.ErrorReduction(**scored))["times"]
        assert times == pytest.approx(without / left, rel=1e-12)


def test_values_of_the_nonlinearity_stand_at_their_inputs():
    metric = hi.NonlinearityValue(at=[0.5, -2], factor=10)
    found = hi.score(hi.Estimate(nonlinearity=np.abs), hi.Record(np.zeros(1), np.zeros(1)), r=metric)
    assert found == {"r 0.5": 5.0, "r -2": 20.0}
