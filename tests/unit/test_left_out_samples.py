"""The estimate at its own samples, each left out, against fits to all other samples."""

from typing import Any

import numpy as np
import pytest

import hident as hi
from hident.errors import EstimationError
from hident.records import Record

SYSTEM = hi.Hammerstein(nonlinearity="mzyk2009", linear=hi.Ar(a=[0.8]))
INPUT = hi.Iid(distribution="uniform", low=-3, high=3)
RECORD: Any = hi.simulate(SYSTEM, INPUT, 30, noise=hi.White(std=0.1))
KERNELS = ("window_half", "window_unit", "triangular", "epanechnikov", "gaussian")
BASES = (
    hi.Trigonometric(interval=[-3, 3]),
    hi.Legendre(interval=[-3, 3]),
    hi.Laguerre(),
    hi.Hermite(),
)
KNOWN = ({"u": 0.7, "value": 2.0}, None)
known_points = pytest.mark.parametrize("known_point", KNOWN, ids=["known point", "none"])


def fit(estimator, record) -> Any:
    """The estimate, with a nonlinearity and its values at the samples left out."""
    return hi.fit(estimator, record)


def fixed_kernel(kernel, h, **fields):
    """A kernel estimate whose bandwidth does not depend on the number of samples."""
    return hi.Kernel(kernel=kernel, bandwidth={"h0": h, "alpha": 0}, **fields)


def fixed_series(basis, **fields):
    return hi.Orthogonal(basis=basis, terms={"q0": 4, "alpha": 0}, **fields)


def refitted(estimator, record, low, high):
    """The inputs from low to high, and the estimate at each from a record without that sample."""
    order = np.argsort(record.u, kind="stable")
    order = order[(record.u[order] >= low) & (record.u[order] <= high)]
    values = []
    for k in order:
        others = np.arange(len(record)) != k
        estimate = fit(estimator, Record(record.u[others], record.y[others]))
        values.append(estimate.nonlinearity(record.u[[k]])[0])
    return record.u[order], np.array(values)


def check(estimator, record=RECORD, low=-2.5, high=2.9, tolerance=1e-10):
    u, values = fit(estimator, record).left_out(low, high)
    inputs, expected = refitted(estimator, record, low, high)
    np.testing.assert_array_equal(u, inputs)
    np.testing.assert_allclose(values, expected, rtol=tolerance, atol=tolerance)


@known_points
@pytest.mark.parametrize("h", [0.001, 0.03, 0.4, 20.0])
@pytest.mark.parametrize("empty", ["nearest", "zero", "mean"])
@pytest.mark.parametrize("kernel", KERNELS)
def test_kernel_estimates_are_those_of_a_fit_without_the_sample(kernel, empty, h, known_point):
    check(fixed_kernel(kernel, h, empty=empty, known_point=known_point))


@pytest.mark.parametrize("h", [0.1, 0.25, 1.0])
@pytest.mark.parametrize("kernel", KERNELS)
def test_kernel_estimates_at_tied_inputs_and_at_the_edges_of_windows(kernel, h):
    rng = np.random.default_rng(3)
    # A lattice without noise in its ties would hide which of them is left out.
    tied = Record(rng.integers(-12, 12, 30) / 4.0, rng.normal(size=30))
    assert len(np.unique(tied.u)) < 30
    order = np.lexsort((tied.y, tied.u))
    check_sorted = Record(tied.u[order], tied.y[order])
    u, values = fit(fixed_kernel(kernel, h), check_sorted).left_out(-3, 3)
    inputs, expected = refitted(fixed_kernel(kernel, h), check_sorted, -3, 3)
    np.testing.assert_array_equal(u, inputs)
    for point in np.unique(u):
        # Tied samples may come in any order.
        np.testing.assert_allclose(np.sort(values[u == point]), np.sort(expected[u == point]), atol=1e-10)


def test_a_sample_alone_in_its_window_fails_where_empty_windows_fail():
    estimate = fit(fixed_kernel("gaussian", 0.01, empty="fail"), RECORD)
    with pytest.raises(EstimationError, match=r"\d+ of 30 points have no sample within the kernel's window"):
        estimate.left_out(-3, 3)


@known_points
@pytest.mark.parametrize("density", ["estimated", {"distribution": "uniform", "low": -3, "high": 3}])
@pytest.mark.parametrize("basis", BASES, ids=lambda basis: basis.kind)
def test_series_are_those_of_a_fit_without_the_sample(basis, density, known_point):
    low = 0.0 if basis.kind == "laguerre" else -2.5
    check(fixed_series(basis, density=density, known_point=known_point), low=low, tolerance=1e-8)


def test_a_point_outside_the_basis_is_refused_as_elsewhere():
    estimate = fit(fixed_series(hi.Laguerre()), RECORD)
    with pytest.raises(EstimationError, match="points lie outside the domain"):
        estimate.left_out(-1, 1)


@pytest.mark.parametrize(
    "make", [lambda **f: fixed_kernel("gaussian", 0.3, **f), lambda **f: fixed_series(BASES[0], **f)]
)
def test_with_a_prefilter_the_filtered_samples_are_left_out_one_by_one(make):
    known = hi.KnownDynamics(a=[0.8])
    u, values = fit(make(prefilter=known), RECORD).left_out(-3, 3)
    filtered = Record(RECORD.u[1:], RECORD.y[1:] - 0.8 * RECORD.y[:-1])
    inputs, expected = refitted(make(), filtered, -3, 3)
    np.testing.assert_array_equal(u, inputs)
    np.testing.assert_allclose(values, expected, rtol=1e-9, atol=1e-9)


def test_the_score_is_the_mean_square_at_the_samples_left_out():
    estimate = fit(fixed_kernel("gaussian", 0.3), RECORD)
    interval = [-2, 2]
    score = hi.score(
        estimate, RECORD, ise=hi.IntegratedSquaredError(at="left_out_samples", interval=interval)
    )
    u, values = refitted(fixed_kernel("gaussian", 0.3), RECORD, *interval)
    error = values - RECORD.truth.nonlinearity(u)
    assert score["ise"] == pytest.approx(4 * np.mean(error**2), rel=1e-10)


def test_without_smoothing_the_score_is_an_error_where_that_at_the_samples_is_the_noise_alone():
    """A window that holds its own sample only: nothing is estimated, and only one of the scores says so."""
    system = hi.Hammerstein(nonlinearity="mzyk2009", linear=hi.Ar(a=[0.0]))
    record = hi.simulate(system, INPUT, 300, noise=hi.White(std=0.01))
    estimate = fit(fixed_kernel("window_unit", 1e-9, empty="mean"), record)
    scores = hi.score(
        estimate,
        record,
        own=hi.IntegratedSquaredError(at="samples", interval=[-3, 3]),
        left_out=hi.IntegratedSquaredError(at="left_out_samples", interval=[-3, 3]),
    )
    assert scores["own"] < 1e-3
    assert scores["left_out"] > 1.0


def test_an_estimator_that_has_no_samples_to_leave_out_is_refused_before_the_run():
    with pytest.raises(hi.ConfigError, match="needs the left_out of the estimate"):
        hi.validate(
            {
                "version": 1,
                "title": "Refused",
                "trials": 1,
                "samples": 100,
                "system": {
                    "kind": "hammerstein",
                    "nonlinearity": "abs",
                    "linear": {"kind": "fir", "b": [1, 0.5]},
                },
                "excitation": {"kind": "iid", "distribution": "uniform", "low": -1, "high": 1},
                "estimators": {"two-stage": {"kind": "two_stage", "lags": 2, "degree": 2}},
                "metrics": {"mise": {"kind": "mise", "at": "left_out_samples", "interval": [-1, 1]}},
            }
        )
