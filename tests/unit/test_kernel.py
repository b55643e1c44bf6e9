import pickle
import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from hident.arrays import Array
from hident.errors import EstimationError
from hident.estimators.nonparametric.kernel import (
    Bandwidth,
    Kernel,
    KernelName,
    KernelRegression,
)
from hident.records import Record

# The definitions of the paper and of the docstring, not those of the code under test.
KERNELS: dict[KernelName, Callable[[Array], Array]] = {
    "window_half": lambda x: np.where(np.abs(x) <= 0.5, 1.0, 0.0),
    "window_unit": lambda x: np.where(np.abs(x) < 1.0, 1.0, 0.0),
    "triangular": lambda x: np.maximum(1.0 - np.abs(x), 0.0),
    "epanechnikov": lambda x: np.maximum(0.75 * (1.0 - x**2), 0.0),
    "gaussian": lambda x: np.exp(-(x**2) / 2.0) / np.sqrt(2.0 * np.pi),
}
every_kernel = pytest.mark.parametrize("kernel", KERNELS)
quick = settings(deadline=None, derandomize=True, max_examples=60)


def nearest(u, y, point):
    distance = np.abs(u - point)
    return y[distance == distance.min()].mean()


def direct_sum(u, y, points, kernel, bandwidth):
    """Eq. (4) as it stands; the nearest samples where no sample has a weight."""
    values = []
    for point in points:
        x = (u - point) / bandwidth
        weights = KERNELS[kernel](x)
        if kernel == "gaussian":
            weights *= np.abs(x).min() <= 8.5
        values.append(weights @ y / weights.sum() if weights.any() else nearest(u, y, point))
    return np.array(values)


# Multiples of 1/8 and bandwidths that are powers of two: ties and points on a window's edge are exact.
eighths = st.integers(-40, 40).map(lambda i: i / 8.0)
samples_on_lattice = st.lists(st.tuples(eighths, st.floats(-100.0, 100.0)), min_size=1, max_size=40)
reals = st.integers(-(10**6), 10**6).map(lambda i: i / 2e5)
samples_anywhere = st.lists(st.tuples(reals, st.floats(-100.0, 100.0)), min_size=1, max_size=40)


@every_kernel
@quick
@given(samples=samples_on_lattice, points=st.lists(eighths, min_size=1), exponent=st.integers(-3, 2))
def test_equals_the_direct_sum_with_ties_and_points_on_edges(kernel, samples, points, exponent):
    u, y = np.array(samples).T
    h = 2.0**exponent
    found = KernelRegression(u, y, kernel=kernel, bandwidth=h)(np.array(points))
    np.testing.assert_allclose(found, direct_sum(u, y, points, kernel, h), rtol=0, atol=1e-10)


@every_kernel
@quick
@given(samples=samples_anywhere, points=st.lists(reals, min_size=1), h=st.floats(1e-2, 1e2))
def test_equals_the_direct_sum_anywhere(kernel, samples, points, h):
    u, y = np.array(samples).T
    # A sample within rounding of an edge may fall on either side of it; a vanishing weight is then noise too.
    x = np.abs(np.subtract.outer(points, u)) / h
    points = np.array(points)[(np.abs(x - np.array([[[0.5]], [[1.0]], [[8.5]]])) > 1e-6).all(axis=(0, 2))]
    found = KernelRegression(u, y, kernel=kernel, bandwidth=h)(points)
    np.testing.assert_allclose(found, direct_sum(u, y, points, kernel, h), rtol=0, atol=1e-10)


@every_kernel
@pytest.mark.parametrize("h", [1e-4, 1e-3, 0.1])
def test_keeps_its_digits_at_many_samples_and_small_bandwidths(kernel, h):
    rng = np.random.default_rng(4)
    u, points = rng.uniform(-6.0, 6.0, 100_000), rng.uniform(-6.0, 6.0, 60)
    y = 3.0 + rng.normal(size=u.size)
    found = KernelRegression(u, y, kernel=kernel, bandwidth=h)(points)
    largest = np.abs(y).max()
    np.testing.assert_allclose(
        found,
        direct_sum(u, y, points, kernel, h),
        rtol=0,
        atol=1e-11 * largest if h == 1e-4 else 1e-12 * largest,
    )


@every_kernel
def test_a_point_among_many_gets_what_it_gets_among_few(kernel):
    rng = np.random.default_rng(11)
    u, points = rng.uniform(-6.0, 6.0, 3000), rng.uniform(-7.0, 7.0, 70_000)
    fitted = KernelRegression(u, rng.normal(size=u.size), kernel=kernel, bandwidth=0.05, empty="nearest")
    np.testing.assert_allclose(fitted(points)[::700], fitted(points[::700]), rtol=0, atol=1e-12)


def test_gaussian_keeps_its_digits_in_the_tails():
    rng = np.random.default_rng(5)
    u, points = rng.uniform(0.0, 1.0, 300), np.linspace(-0.84, 1.84, 500)
    y = rng.normal(size=u.size)
    found = KernelRegression(u, y, kernel="gaussian", bandwidth=0.1, empty="fail")(points)
    np.testing.assert_allclose(found, direct_sum(u, y, points, "gaussian", 0.1), rtol=0, atol=1e-12)


@every_kernel
def test_shift_scale_and_order_of_the_samples(kernel):
    rng = np.random.default_rng(6)
    u, y = rng.integers(-64, 64, 500) / 16.0, rng.normal(size=500)
    points = np.linspace(-6.0, 6.0, 301)

    def estimate(u, y, points):
        return KernelRegression(u, y, kernel=kernel, bandwidth=0.25)(points)

    plain = estimate(u, y, points)
    np.testing.assert_allclose(estimate(u, y + 10.0, points), plain + 10.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(estimate(u, -3.0 * y, points), -3.0 * plain, rtol=0, atol=1e-12)
    np.testing.assert_allclose(estimate(u + 1024.0, y, points + 1024.0), plain, rtol=0, atol=1e-12)
    shuffled = rng.permutation(500)
    np.testing.assert_allclose(estimate(u[shuffled], y[shuffled], points), plain, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(estimate(u, y, points[::-1]), plain[::-1])


@every_kernel
def test_constant_output_is_recovered(kernel):
    u = np.random.default_rng(7).normal(size=1000)
    found = KernelRegression(u, np.full(1000, 0.1), kernel=kernel, bandwidth=0.05)(np.linspace(-9, 9, 500))
    np.testing.assert_allclose(found, 0.1, rtol=1e-13)


def test_points_without_a_sample():
    u, y, points = np.array([0.0, 0.0, 4.0]), np.array([1.0, 3.0, 8.0]), np.array([-5.0, 1.5, 2.0, 3.0, 9.0])

    def estimate(empty):
        return KernelRegression(u, y, kernel="window_unit", bandwidth=0.5, empty=empty)(points)

    np.testing.assert_array_equal(estimate("nearest"), [2.0, 2.0, 4.0, 8.0, 8.0])
    np.testing.assert_array_equal(estimate("zero"), np.zeros(5))
    np.testing.assert_array_equal(estimate("mean"), np.full(5, 4.0))
    message = r"^5 of 5 points have no sample within the kernel's window \(bandwidth 0\.5\)$"
    with pytest.raises(EstimationError, match=message):
        estimate("fail")


def test_gaussian_has_no_sample_beyond_its_reach():
    u, y = np.zeros(1), np.ones(1)
    found = KernelRegression(u, y, kernel="gaussian", bandwidth=1.0, empty="zero")(np.array([8.4, 8.6]))
    np.testing.assert_allclose(found, [1.0, 0.0], rtol=1e-13)


def test_output_that_is_not_finite():
    with pytest.raises(EstimationError, match=r"^the output has 1 of 3 samples that are not finite$"):
        KernelRegression(np.arange(3.0), np.array([0, np.inf, 0]), kernel="gaussian", bandwidth=1)(
            np.zeros(1)
        )


def test_given_order_unmodified_input_and_pickle():
    rng = np.random.default_rng(8)
    u, y, points = rng.normal(size=200), rng.normal(size=200), rng.normal(size=100)
    for array in (u, y, points):
        array.flags.writeable = False
    for kernel in KERNELS:
        plain = KernelRegression(u, y, kernel=kernel, bandwidth=0.1, empty="nearest")
        ordered = KernelRegression(u, y, kernel=kernel, bandwidth=0.1, empty="nearest", order=np.argsort(u))
        np.testing.assert_array_equal(ordered(points), plain(points))
        np.testing.assert_array_equal(pickle.loads(pickle.dumps(plain))(points), plain(points))
        assert plain(np.empty(0)).shape == (0,)


def test_many_points_are_evaluated_in_blocks():
    rng = np.random.default_rng(9)
    u, y, points = rng.normal(size=100), rng.normal(size=100), rng.normal(size=300_000)
    fitted = KernelRegression(u, y, kernel="triangular", bandwidth=0.3, empty="nearest")
    np.testing.assert_allclose(fitted(points)[-10:], fitted(points[-10:]), rtol=0, atol=1e-15)


@every_kernel
def test_memory_is_a_few_arrays(kernel):
    n = 10**6
    rng = np.random.default_rng(10)
    u, y = rng.uniform(size=n), rng.normal(size=n)
    tracemalloc.start()
    try:
        KernelRegression(u, y, kernel=kernel, bandwidth=1e-2)(u)
        assert tracemalloc.get_traced_memory()[1] < 15 * u.nbytes
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("kernel", ["window_half", "epanechnikov", "gaussian"])
def test_error_falls_like_n_to_the_minus_two_fifths(kernel):
    rng = np.random.default_rng(11)
    sizes, points = np.array([1_000, 8_000, 64_000]), np.linspace(-0.5, 0.5, 41)
    errors = []
    for n in sizes:
        trials = []
        for _ in range(40):
            u = rng.uniform(-1.0, 1.0, n)
            y = np.sin(3.0 * u) + 0.5 * rng.normal(size=n)
            h = Bandwidth(h0=0.6, alpha=0.2).width(n)
            trials.append(KernelRegression(u, y, kernel=kernel, bandwidth=h)(points) - np.sin(3.0 * points))
        errors.append(np.sqrt(np.mean(np.square(trials))))
    slope = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert slope == pytest.approx(-0.4, abs=0.03)


def test_spec_fits_with_the_bandwidth_of_the_record():
    rng = np.random.default_rng(12)
    record = Record(rng.normal(size=32), rng.normal(size=32))
    spec = Kernel.model_validate(
        {"kernel": "window_unit", "bandwidth": {"h0": 0.5, "alpha": "1/5"}, "empty": "mean"}
    )
    points = np.linspace(-3.0, 3.0, 50)
    expected = KernelRegression(record.u, record.y, kernel="window_unit", bandwidth=0.25, empty="mean")(
        points
    )
    nonlinearity = spec.fit(record, rng).nonlinearity
    assert nonlinearity is not None
    np.testing.assert_allclose(nonlinearity(points), expected, rtol=0, atol=1e-14)
    assert spec.provides() == {"nonlinearity", "left_out"} and spec.fewest_samples() == 1


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        (
            "kernel",
            "window",
            "must be 'window_half', 'window_unit', 'triangular', 'epanechnikov' or 'gaussian'",
        ),
        ("empty", "skip", "must be 'nearest', 'zero', 'mean' or 'fail'"),
        ("bandwidth", {"h0": 0, "alpha": 0.2}, "must be greater than 0"),
        ("bandwidth", {"h0": 1, "alpha": -0.1}, "must be greater than or equal to 0"),
        ("bandwidth", {"h0": 1, "alpha": 1}, "must be less than 1"),
    ],
)
def test_wrong_fields(field, value, message):
    good = {"kernel": "gaussian", "bandwidth": {"h0": 1, "alpha": 0.2}}
    with pytest.raises(ValidationError) as error:
        Kernel.model_validate({**good, field: value})
    assert message in error.value.errors()[0]["msg"]


def test_an_exponent_of_zero_keeps_the_bandwidth():
    assert Bandwidth(h0=0.3, alpha=0.0).width(10**6) == 0.3
