"""Instrumental variables, least squares, known dynamics, and the prefilter that they serve."""

import re

import numpy as np
import pytest
from pydantic import ValidationError

from hident.errors import EstimationError
from hident.estimators.nonparametric.instrumental_variables import (
    InstrumentalVariables,
    instrumental_variables,
)
from hident.estimators.nonparametric.kernel import Kernel, KernelRegression
from hident.estimators.nonparametric.known_dynamics import KnownDynamics
from hident.estimators.nonparametric.least_squares import LeastSquares, least_squares
from hident.estimators.nonparametric.orthogonal import Orthogonal
from hident.estimators.nonparametric.prefilter import FilteredRecord, prefilter
from hident.linear_blocks import TransferFunction
from hident.records import Record
from hident.systems.nonlinearity import Identity, Power

AR2 = TransferFunction(a=(1.2, -0.5))
ARMA = TransferFunction(b=(1.0, 0.6, -0.2), a=(0.9, -0.4))
RNG = np.random.default_rng(0)


def hammerstein(rng, n, linear, mu, noise=0.0):
    """Input, internal signal and output, uniform input of unit variance, stationary up to 0.9^200."""
    u = rng.uniform(-np.sqrt(3.0), np.sqrt(3.0), n + 200)
    w = mu(u)
    y = linear.filter(w) + noise * rng.normal(size=n + 200)
    return u[200:], w[200:], y[200:]


def block(estimate):
    assert estimate.linear is not None
    return estimate.linear


def characteristic(estimate):
    assert estimate.nonlinearity is not None
    return estimate.nonlinearity


def test_constant_input_to_the_block_is_recovered_exactly():
    y = AR2.filter(np.full(40, 3.0), np.array([-5.0, 2.0]))
    m = np.random.default_rng(1).normal(size=40)
    for estimate in (least_squares(y, 2), instrumental_variables(y, m, 2)):
        np.testing.assert_allclose(
            [estimate.values[name] for name in ("a_1", "a_2", "c")], [1.2, -0.5, 3.0], atol=1e-10
        )
        assert block(estimate).b == (1.0,)
        assert block(estimate).a == (estimate.values["a_1"], estimate.values["a_2"])


@pytest.mark.parametrize("p", [1, 3])
def test_least_squares_solves_its_normal_equations(p):
    y = 5.0 + np.random.default_rng(2).normal(size=60).cumsum()
    found = least_squares(y, p)
    residual = y[p:] - found.values["c"]
    for i, a in enumerate(block(found).a, start=1):
        residual -= a * y[p - i : len(y) - i]
    for i in range(1, p + 1):
        assert residual @ y[p - i : len(y) - i] == pytest.approx(0.0, abs=1e-8)
    assert residual.sum() == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("p", "q"), [(1, 0), (3, 0), (2, 2)])
def test_instruments_are_orthogonal_to_the_residual(p, q):
    rng = np.random.default_rng(3)
    m, y = rng.normal(size=200), rng.normal(size=200).cumsum()
    found = instrumental_variables(y, m, p, q)
    start = p + q
    residual = y[start:] - found.values["c"] * sum(block(found).b)
    for i, a in enumerate(block(found).a, start=1):
        residual -= a * y[start - i : len(y) - i]
    for i in range(1, p + 1):
        assert residual @ m[start - q - i : len(y) - q - i] == pytest.approx(0.0, abs=1e-7)
    assert residual.sum() == pytest.approx(0.0, abs=1e-7)


def test_unit_of_the_output_does_not_matter():
    rng = np.random.default_rng(4)
    u, _, y = hammerstein(rng, 500, AR2, np.sin)
    for estimate in (lambda y: least_squares(y, 2), lambda y: instrumental_variables(y, u, 2)):
        plain, scaled = estimate(y), estimate(1e-9 * y)
        np.testing.assert_allclose(block(scaled).a, block(plain).a, rtol=1e-9)
        assert scaled.values["c"] == pytest.approx(1e-9 * plain.values["c"], rel=1e-9)


def test_instrumental_variables_are_consistent_under_noise_where_least_squares_is_not():
    rng = np.random.default_rng(5)
    linear = TransferFunction(a=(0.8,))
    by_instruments, by_squares = [], []
    for _ in range(40):
        u, _, y = hammerstein(rng, 4000, linear, lambda u: u + 0.5, noise=1.0)
        by_instruments.append(instrumental_variables(y, u, 1).values["a_1"])
        by_squares.append(least_squares(y, 1).values["a_1"])
    # var v = 1/(1 - 0.64) = 2.78 against a noise of 1: least squares tends to 0.8 * 2.78/3.78 = 0.588.
    assert np.mean(by_instruments) == pytest.approx(0.8, abs=0.01)
    assert np.mean(by_squares) == pytest.approx(0.8 * 2.7778 / 3.7778, abs=0.01)


def test_error_of_instrumental_variables_falls_like_n_to_the_minus_half():
    rng = np.random.default_rng(6)
    sizes, errors = np.array([500, 4_000, 32_000]), []
    for n in sizes:
        trials = []
        for _ in range(60):
            u, _, y = hammerstein(rng, n, AR2, lambda u: u, noise=0.3)
            trials.append(np.subtract(block(instrumental_variables(y, u, 2)).a, AR2.a))
        errors.append(np.sqrt(np.mean(np.square(trials))))
    assert np.polyfit(np.log(sizes), np.log(errors), 1)[0] == pytest.approx(-0.5, abs=0.06)


def test_arma_block_is_recovered_from_many_samples():
    u, w, y = hammerstein(np.random.default_rng(7), 400_000, ARMA, lambda u: u**3 + 1.0, noise=0.1)
    found = instrumental_variables(y, u, 2, ma_order=2)
    np.testing.assert_allclose(block(found).a, ARMA.a, atol=0.03)
    np.testing.assert_allclose(block(found).b, ARMA.b, atol=0.03)
    assert found.values["c"] == pytest.approx(w.mean(), abs=0.03)
    assert list(found.values) == ["a_1", "a_2", "b_1", "b_2", "c"]
    # Without the delay of the instruments the moving average biases A.
    assert abs(block(instrumental_variables(y, u, 2)).a[0] - ARMA.a[0]) > 0.1


def test_a_high_order_autoregression_inverts_an_arma_block():
    linear = TransferFunction(b=(1.0, 0.5), a=(0.7,))
    u, w, y = hammerstein(np.random.default_rng(8), 200_000, linear, lambda u: u)
    errors = [
        np.std(prefilter(y, block(instrumental_variables(y, u, p))) - w[p:]) / np.std(w) for p in (1, 12)
    ]
    # Order 1 leaves the impulse response -0.6 * 0.7^k, k = 0, 1, ...
    assert errors[0] == pytest.approx(0.6 / np.sqrt(1.0 - 0.49), rel=0.02)
    assert errors[1] < 0.02


def test_singular_estimates():
    y = AR2.filter(np.random.default_rng(9).normal(size=50))
    singular = (
        r"^Psi'Phi is singular \(condition number inf\): the instruments are uncorrelated with the output, "
        r"or the order is too high; choose an instrument that is odd for an odd nonlinearity and even for an "
        r"even one, or a lower order$"
    )
    with pytest.raises(EstimationError, match=singular):
        instrumental_variables(y, np.zeros(50), 2)
    dependent = (
        r"^the past outputs are linearly dependent: the output hardly varies, the record is too short, "
        r"or the order 2 is too high$"
    )
    with pytest.raises(EstimationError, match=dependent):
        least_squares(np.full(50, 3.0), 2)
    with pytest.raises(EstimationError, match=r"^the output has 50 of 50 samples that are not finite$"):
        least_squares(np.full(50, np.nan), 1)
    with pytest.raises(EstimationError, match=r"^the output has 1 of 50 samples that are not finite$"):
        instrumental_variables(np.where(np.arange(50) == 7, np.inf, y), y, 1)


@pytest.mark.parametrize(
    "spec", [LeastSquares(order=3), InstrumentalVariables(order=2, ma_order=1, instrument=Identity())]
)
def test_shortest_record(spec):
    n = spec.fewest_samples()
    rng = np.random.default_rng(10)
    estimate = spec.fit(Record(rng.normal(size=n), rng.normal(size=n)), RNG)
    assert np.isfinite(list(estimate.values.values())).all()
    with pytest.raises(EstimationError):
        spec.fit(Record(rng.normal(size=n - 1), rng.normal(size=n - 1)), RNG)


@pytest.mark.parametrize(
    "spec",
    [
        LeastSquares(order=2),
        InstrumentalVariables(order=2, instrument=Power(exponent=3)),
        InstrumentalVariables(order=1, ma_order=2, instrument=Identity()),
        KnownDynamics(a=(0.5,), b=(2.0, 0.1)),
    ],
)
def test_linear_estimators_hold_what_they_say(spec):
    u, _, y = hammerstein(np.random.default_rng(11), 300, AR2, lambda u: u)
    u.flags.writeable = y.flags.writeable = False
    estimate = spec.fit(Record(u, y), RNG)
    assert spec.identifies_dynamics
    assert spec.provides() == {"linear", *(f"value {name}" for name in estimate.values)}
    assert estimate.linear is not None and estimate.nonlinearity is None
    expected = {name: value for name, value in estimate.linear.values().items() if name in estimate.values}
    assert expected.items() <= estimate.values.items() and len(expected) >= len(estimate.values) - 1


def test_known_dynamics():
    spec = KnownDynamics.model_validate({"a": ["4/5"]})
    estimate = spec.fit(Record(np.zeros(3), np.zeros(3)), RNG)
    assert estimate.linear == TransferFunction(b=(1.0,), a=(0.8,))
    assert estimate.values == {"a_1": 0.8, "b_0": 1.0}


def test_prefilter_undoes_an_autoregression():
    w = np.random.default_rng(12).normal(size=100)
    y = AR2.filter(w, np.array([3.0, -1.0]))
    y.flags.writeable = False
    np.testing.assert_allclose(prefilter(y, AR2), w[2:], rtol=0, atol=1e-12)
    gain = TransferFunction(b=(-2.0,), a=AR2.a)
    np.testing.assert_allclose(prefilter(y, gain), -w[2:] / 2.0, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(prefilter(y, TransferFunction()), y)


def test_prefilter_undoes_an_arma_block_after_a_transient():
    w = 2.0 + np.random.default_rng(13).normal(size=300)
    filtered = prefilter(ARMA.filter(w), ARMA)
    assert filtered.shape == (298,)
    # The zeros 0.24 and -0.84 of B leave 0.84^200 of the start.
    np.testing.assert_allclose(filtered[200:], w[202:], rtol=0, atol=1e-12)
    steady = prefilter(np.full(20, 6.0), ARMA)
    np.testing.assert_allclose(steady, 6.0 * 0.5 / 1.4, rtol=1e-13)


@pytest.mark.parametrize(
    ("b", "zeros"), [((1.0, -2.5, 1.0), "2, 0.5"), ((1.0, 0.0, 4.0), "0+2j, 0-2j"), ((1.0, -1.0), "1")]
)
def test_blocks_without_a_stable_inverse(b, zeros):
    message = (
        f"the linear block has no stable inverse: its zeros {zeros} do not all lie inside the unit circle"
    )
    with pytest.raises(EstimationError, match=f"^{re.escape(message)}$"):
        prefilter(np.zeros(10), TransferFunction(b=b))


@pytest.mark.parametrize("b", [(0.0, 1.0), (1e-17, 1.0)])
def test_blocks_without_a_causal_inverse(b):
    message = r"^the linear block has b_0 = 0: it delays its input and has no causal inverse; leave its"
    with pytest.raises(EstimationError, match=message):
        prefilter(np.zeros(10), TransferFunction(b=b))


def test_order_of_a_filtered_record_is_that_of_its_input():
    rng = np.random.default_rng(14)
    u = rng.integers(0, 9, 50).astype(float)
    record = Record(u, u)
    filtered = FilteredRecord.of(record, TransferFunction(a=(0.3, 0.2, 0.1)))
    assert sorted(filtered.order) == list(range(47))
    np.testing.assert_array_equal(filtered.u[filtered.order], np.sort(u[3:]))


def kernel_spec(**fields):
    return Kernel.model_validate({"kernel": "window_unit", "bandwidth": {"h0": 0.5, "alpha": 0.2}, **fields})


INSTRUMENTS = {"kind": "instrumental_variables", "order": 1, "instrument": "identity"}


def test_prefiltered_kernel_is_the_two_stage_method():
    linear = TransferFunction(a=(0.8,))
    u, _, y = hammerstein(np.random.default_rng(15), 300, linear, np.sin)
    spec = kernel_spec(prefilter=INSTRUMENTS)
    parts = {"nonlinearity", "left_out", "unfiltered", "linear", "response"}
    assert spec.provides() == {*parts, "value a_1", "value c"}
    assert spec.fewest_samples() == 4
    estimate = spec.fit(Record(u, y), RNG)
    step1 = instrumental_variables(y, u, 1)
    assert estimate.values == step1.values and estimate.linear == step1.linear
    points = np.linspace(-2.0, 2.0, 41)
    filtered = y[1:] - step1.values["a_1"] * y[:-1]
    expected = KernelRegression(
        u[1:], filtered, kernel="window_unit", bandwidth=0.5 * 299**-0.2, empty="nearest"
    )(points)
    np.testing.assert_allclose(characteristic(estimate)(points), expected, rtol=0, atol=1e-12)


def test_known_block_makes_the_series_estimate_that_of_the_static_system():
    linear = TransferFunction(a=(0.8,))
    u, w, y = hammerstein(np.random.default_rng(16), 300, linear, np.sin)
    fields = {"basis": {"kind": "legendre", "interval": [-2, 2]}, "terms": {"q0": 3, "alpha": 0}}
    prefiltered = Orthogonal.model_validate({**fields, "prefilter": {"kind": "known_dynamics", "a": [0.8]}})
    static = Orthogonal.model_validate(fields)
    points = np.linspace(-1.5, 1.5, 21)
    found = characteristic(prefiltered.fit(Record(u, y), RNG))
    expected = characteristic(static.fit(Record(u[1:], w[1:]), RNG))
    np.testing.assert_allclose(found(points), expected(points), rtol=0, atol=1e-12)


def test_known_point_fixes_the_constant():
    rng = np.random.default_rng(17)
    record = Record(rng.uniform(-1, 1, 100), rng.normal(size=100))
    points = np.linspace(-1.0, 1.0, 21)
    plain = characteristic(kernel_spec().fit(record, RNG))
    anchored = characteristic(kernel_spec(known_point={"u": 0.5, "value": 2}).fit(record, RNG))
    np.testing.assert_allclose(
        anchored(points), plain(points) - plain(np.array([0.5])) + 2.0, rtol=0, atol=1e-12
    )
    series = Orthogonal.model_validate(
        {
            "basis": {"kind": "legendre", "interval": [-1, 1]},
            "terms": {"q0": 1, "alpha": 0},
            "density": {"distribution": "uniform", "low": -1, "high": 0},
            "known_point": {"u": 0.5, "value": 2},
        }
    )
    with pytest.raises(EstimationError, match=r"^the regression at the known point u = 0.5 is -?inf$"):
        series.fit(record, RNG)


def test_prefilter_without_a_linear_block_is_refused():
    with pytest.raises(ValidationError) as error:
        kernel_spec(prefilter={"kind": "kernel", "kernel": "gaussian", "bandwidth": {"h0": 1, "alpha": 0.2}})
    (problem,) = error.value.errors()
    assert problem["loc"] == ("prefilter",)
    assert problem["msg"].startswith("'kernel' does not estimate a linear block (allowed: ")
    assert all(
        kind in problem["msg"] for kind in ("instrumental_variables", "known_dynamics", "least_squares")
    )


@pytest.mark.parametrize(
    ("cls", "fields", "where", "message"),
    [
        (LeastSquares, {"order": 0}, ("order",), "must be greater than or equal to 1"),
        (LeastSquares, {}, ("order",), "is required: Order p of the autoregression"),
        (
            InstrumentalVariables,
            {"order": 1, "instrument": "identity", "ma_order": -1},
            ("ma_order",),
            "must be greater than or equal to 0",
        ),
        (KnownDynamics, {"b": [0, 0]}, ("b",), "must have a coefficient other than zero"),
        (KnownDynamics, {"b": []}, ("b",), "must be a list of at least one number"),
        (
            Kernel,
            {"prefilter": {**INSTRUMENTS, "order": 0}},
            ("prefilter", "order"),
            "must be greater",
        ),
    ],
)
def test_wrong_fields(cls, fields, where, message):
    if cls is Kernel:
        fields = {"kernel": "gaussian", "bandwidth": {"h0": 1, "alpha": 0.2}, **fields}
    with pytest.raises(ValidationError) as error:
        cls.model_validate(fields)
    (problem,) = error.value.errors()
    assert problem["loc"] == where
    assert problem["msg"].startswith(message)


DYNAMICS = [
    InstrumentalVariables(order=1, instrument=Identity()),
    InstrumentalVariables(order=1, instrument=Identity(), ma_order=1),
    LeastSquares(order=1),
]


@pytest.mark.parametrize("estimator", DYNAMICS)
def test_an_input_of_period_two_tells_nothing_of_the_feedback(estimator):
    # From rest, so that the first output alone is not of period two.
    u = np.where(np.arange(90) % 2, -1.0, 1.0)
    record = Record(u, TransferFunction(b=(0.0, 0.7, 0.4)).filter(u))
    with pytest.raises(EstimationError, match=r"^the input follows from its last 1 value, so that"):
        estimator.fit(record, RNG)


def test_a_moving_average_that_no_instrument_is_correlated_with():
    rng = np.random.default_rng(3)
    y = np.zeros(90)
    y[1::2] = 1.0
    message = r"^the instruments are not correlated with what the feedback leaves of the output: the moving"
    with pytest.raises(EstimationError, match=message):
        instrumental_variables(y, rng.normal(size=90), 1, 1)
