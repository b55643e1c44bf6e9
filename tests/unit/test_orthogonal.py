import itertools
import pickle
import tracemalloc

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from hident.config.spec import Of
from hident.errors import ConfigError, EstimationError
from hident.estimators.nonparametric import fourier
from hident.estimators.nonparametric.bases import BasisSpec, Hermite, Laguerre, Legendre, Trigonometric
from hident.estimators.nonparametric.orthogonal import (
    GaussianDensity,
    Orthogonal,
    Terms,
    UniformDensity,
    fit_orthogonal_series,
)
from hident.records import Record

TWO_PI = 2.0 * np.pi
WAVES = Trigonometric(interval=(-TWO_PI, TWO_PI))
BASES = {
    "trigonometric": (Trigonometric(interval=(-1.0, 4.0)), np.linspace(-1.0, 4.0, 401)),
    "legendre": (Legendre(interval=(-1.0, 4.0)), np.linspace(-1.0, 4.0, 401)),
    "laguerre": (Laguerre(), np.linspace(0.0, 60.0, 401)),
    "hermite": (Hermite(), np.linspace(-9.0, 9.0, 401)),
}
every_basis = pytest.mark.parametrize("basis", [basis for basis, _ in BASES.values()], ids=BASES)


def functions(basis, x, q):
    """All functions up to level q at x, one row each."""
    return basis.series(x, np.eye(basis.size(q)))


def inner_products(basis, rule, q):
    nodes, weights = rule
    phi = functions(basis, nodes, q)
    return (phi * weights) @ phi.T


def legendre_nodes(low, high, panels=40):
    x, w = np.polynomial.legendre.leggauss(40)
    edges = np.linspace(low, high, panels + 1)
    half = (high - low) / panels / 2.0
    return (edges[:-1, None] + half * (x + 1.0)).ravel(), np.tile(half * w, panels)


@pytest.mark.parametrize(
    ("basis", "low", "high", "q"),
    [
        (BASES["trigonometric"][0], -1.0, 4.0, 30),
        (BASES["legendre"][0], -1.0, 4.0, 60),
        (Laguerre(), 0.0, 400.0, 60),
        (Hermite(), -25.0, 25.0, 100),
    ],
    ids=BASES,
)
def test_bases_are_orthonormal(basis, low, high, q):
    products = inner_products(basis, legendre_nodes(low, high), q)
    np.testing.assert_allclose(products, np.eye(basis.size(q)), rtol=0, atol=1e-10)


def test_high_orders_where_the_first_function_underflows():
    # The substitution x = t^2 resolves the Laguerre functions' zeros near 0.
    t, w = legendre_nodes(-50.0, 50.0, panels=160)
    for basis, nodes, weights, q in ((Hermite(), t, w, 800), (Laguerre(), t**2, w * np.abs(t), 500)):
        assert functions(basis, nodes[:1], 0) == 0.0
        (highest,) = basis.series(nodes, np.eye(q + 1)[-1:])
        assert weights @ highest**2 == pytest.approx(1.0, abs=1e-10)


def test_trigonometric_basis_is_the_one_of_the_paper():
    u = np.linspace(-TWO_PI, TWO_PI, 51)
    printed = [np.full(51, 1 / np.sqrt(4 * np.pi))]
    for k, wave in itertools.product((1, 2, 3), (np.cos, np.sin)):
        printed.append(wave(k * u / 2) / np.sqrt(2 * np.pi))
    np.testing.assert_allclose(functions(WAVES, u, 3), printed, rtol=0, atol=1e-14)


def test_known_values_of_the_polynomial_bases():
    x = np.array([0.3, 1.7])
    np.testing.assert_allclose(
        functions(Laguerre(), x, 2)[2], np.exp(-x / 2) * (x**2 / 2 - 2 * x + 1), rtol=1e-13
    )
    np.testing.assert_allclose(
        functions(Hermite(), x, 2)[2],
        (4 * x**2 - 2) * np.exp(-(x**2) / 2) / np.sqrt(8 * np.sqrt(np.pi)),
        rtol=1e-13,
    )
    t = (x - 1.0) / 2.0
    np.testing.assert_allclose(
        functions(Legendre(interval=(-1.0, 3.0)), x, 2)[2], np.sqrt(5 / 4) * (3 * t**2 - 1) / 2, rtol=1e-12
    )


@every_basis
def test_sums_are_the_transpose_of_the_series(basis):
    rng = np.random.default_rng(1)
    x, weights = rng.uniform(0.0, 4.0, 70), rng.normal(size=(2, 70))
    np.testing.assert_allclose(
        basis.sums(x, weights, 12), weights @ functions(basis, x, 12).T, rtol=0, atol=1e-12
    )


@pytest.mark.parametrize(("n", "q"), [(7, 0), (500, 3), (500, 300), (20_000, 60)])
def test_direct_and_fast_trigonometric_sums_agree(n, q):
    rng = np.random.default_rng(2)
    theta, weights = rng.uniform(-np.pi, np.pi, n), rng.normal(size=(2, n))
    theta[0] = -np.pi
    coefficients = rng.normal(size=(2, q + 1)) + 1j * rng.normal(size=(2, q + 1))
    direct, fast = fourier._direct_sums(theta, weights, q), fourier._fast_sums(theta, weights, q)
    np.testing.assert_allclose(fast, direct, rtol=0, atol=1e-12 * np.abs(weights).sum())
    values = fourier._fast_series(theta, coefficients)
    expected = fourier._direct_series(theta, coefficients)
    np.testing.assert_allclose(values, expected, rtol=0, atol=1e-12 * np.abs(coefficients).sum())
    np.testing.assert_array_equal(values, fourier._fast_series(theta, coefficients))


def test_small_problems_are_summed_directly_and_large_ones_to_the_transform(monkeypatch):
    taken = []
    for name in ("_direct_sums", "_fast_sums", "_direct_series", "_fast_series"):
        monkeypatch.setattr(fourier, name, lambda *_, name=name: taken.append(name))
    for n, q in ((100, 150), (100_000, 150)):
        fourier.trigonometric_sums(np.zeros(n), np.zeros((1, n)), q)
        fourier.trigonometric_series(np.zeros(n), np.zeros((1, q + 1), dtype=complex))
    assert taken == ["_direct_sums", "_direct_series", "_fast_sums", "_fast_series"]


def test_known_density_recovers_a_trigonometric_polynomial():
    # On an equidistant grid the sums are exact integrals: R f has the coefficients of R divided by 4 pi.
    n = 4096
    u = -TWO_PI + 2 * TWO_PI * np.arange(n) / n
    r = 0.5 + np.cos(u / 2) - 2.0 * np.sin(3 * u / 2)
    density = UniformDensity(distribution="uniform", low=-TWO_PI, high=TWO_PI)
    fitted = fit_orthogonal_series(u, r, WAVES, 5, density)
    expected = np.zeros(11)
    expected[[0, 1, 6]] = np.array([0.5 * np.sqrt(2), 1.0, -2.0]) * np.sqrt(2 * np.pi) / (4 * np.pi)
    np.testing.assert_allclose(fitted.coefficients[0], expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(fitted(u), r, rtol=0, atol=1e-11)


def test_error_with_known_density_falls_like_n_to_the_minus_half():
    rng = np.random.default_rng(3)
    points, sizes, errors = np.linspace(-6.0, 6.0, 101), np.array([500, 4_000, 32_000]), []
    density = UniformDensity(distribution="uniform", low=-TWO_PI, high=TWO_PI)
    for n in sizes:
        trials = []
        for _ in range(40):
            u = rng.uniform(-TWO_PI, TWO_PI, n)
            estimate = fit_orthogonal_series(u, np.sin(u), WAVES, 4, density)(points)
            trials.append(estimate - np.sin(points))
        errors.append(np.sqrt(np.mean(np.square(trials))))
    assert np.polyfit(np.log(sizes), np.log(errors), 1)[0] == pytest.approx(-0.5, abs=0.05)


@every_basis
def test_constant_output_gives_the_constant(basis):
    u = np.random.default_rng(4).uniform(0.0, 4.0, 300)
    found = fit_orthogonal_series(u, np.full(300, 2.5), basis, 4)(np.linspace(0.0, 4.0, 33))
    np.testing.assert_allclose(found, 2.5, rtol=1e-12)


@every_basis
def test_shift_scale_and_order_of_the_samples(basis):
    rng = np.random.default_rng(5)
    u, y, points = rng.uniform(0.0, 4.0, 300), rng.normal(size=300), np.linspace(0.5, 3.5, 50)
    for array in (u, y, points):
        array.flags.writeable = False
    plain = fit_orthogonal_series(u, y, basis, 4)(points)
    np.testing.assert_allclose(fit_orthogonal_series(u, y + 7.0, basis, 4)(points), plain + 7.0, rtol=1e-11)
    np.testing.assert_allclose(fit_orthogonal_series(u, -2.0 * y, basis, 4)(points), -2.0 * plain, rtol=1e-11)
    shuffled = rng.permutation(300)
    np.testing.assert_allclose(
        fit_orthogonal_series(u[shuffled], y[shuffled], basis, 4)(points), plain, rtol=0, atol=1e-12
    )


@pytest.mark.parametrize(
    "basis", [Trigonometric(interval=(0.0, 3.0)), Legendre(interval=(0.0, 3.0)), Laguerre()]
)
def test_samples_outside_the_domain_are_left_out_but_counted(basis):
    u, y = np.array([1.0, -0.5, 2.0, -7.0]), np.array([1.0, 2.0, 3.0, 4.0])
    fitted = fit_orthogonal_series(u, y, basis, 3)
    inside = fit_orthogonal_series(u[[0, 2]], y[[0, 2]], basis, 3)
    np.testing.assert_allclose(fitted.coefficients, inside.coefficients / 2.0, rtol=1e-15)


def test_points_outside_the_domain_fail():
    message = r"^1 of 3 points lie outside the domain \[0, 3\] of the trigonometric basis$"
    with pytest.raises(EstimationError, match=message):
        fit_orthogonal_series(np.ones(4), np.ones(4), Trigonometric(interval=(0.0, 3.0)), 2)(
            np.array([0.0, 3.0, 3.1])
        )


def test_zero_denominator_is_not_finite():
    density = UniformDensity(distribution="uniform", low=0.0, high=1.0)
    found = fit_orthogonal_series(np.full(3, 0.5), np.ones(3), WAVES, 0, density)(np.array([0.5, -1.0]))
    assert np.isfinite(found[0]) and not np.isfinite(found[1])


def test_memory_is_a_few_arrays():
    n = 10**6
    rng = np.random.default_rng(6)
    u, y = rng.uniform(-TWO_PI, TWO_PI, n), rng.normal(size=n)
    tracemalloc.start()
    try:
        fit_orthogonal_series(u, y, WAVES, 126)(u)
        assert tracemalloc.get_traced_memory()[1] < 15 * u.nbytes
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("q0", "alpha", "n", "level"), [(8, 0.2, 50, 17), (1, 0.2, 243, 3), (2, 1 / 3, 1000, 20), (5, 0, 99, 5)]
)
def test_cutoff_level(q0, alpha, n, level):
    assert Terms(q0=q0, alpha=alpha).level(n) == level


def test_gaussian_density_integrates_to_one():
    x, w = legendre_nodes(-20.0, 22.0)
    density = GaussianDensity(distribution="gaussian", mean=1.0, std=2.0)(x)
    assert w @ density == pytest.approx(1.0, abs=1e-12)
    assert w @ (density * (x - 1.0) ** 2) == pytest.approx(4.0, abs=1e-11)


FIELDS = {
    "basis": {"kind": "trigonometric", "interval": ["-2*pi", "2*pi"]},
    "terms": {"q0": 1, "alpha": "1/5"},
}


@pytest.mark.parametrize("distribution", [{"low": "-2*pi", "high": "2*pi"}, {"mean": 0, "std": 3}, None])
def test_spec(distribution):
    rng = np.random.default_rng(7)
    record = Record(rng.uniform(-TWO_PI, TWO_PI, 243), rng.normal(size=243))
    density = None
    fields = dict(FIELDS)
    if distribution:
        name, cls = ("uniform", UniformDensity) if "low" in distribution else ("gaussian", GaussianDensity)
        fields["density"] = {"distribution": name, **distribution}
        density = cls.model_validate(fields["density"])
    spec = Orthogonal.model_validate(fields)
    estimate = pickle.loads(pickle.dumps(spec.fit(record, rng)))
    points = np.linspace(-6.0, 6.0, 30)
    np.testing.assert_array_equal(
        estimate.nonlinearity(points), fit_orthogonal_series(record.u, record.y, WAVES, 3, density)(points)
    )
    assert spec.provides() == {"nonlinearity", "left_out"}
    assert TypeAdapter(Orthogonal).validate_python(spec) == spec


@pytest.mark.parametrize(
    ("fields", "where", "message"),
    [
        (
            {"density": "known"},
            ("density",),
            "must be 'estimated' or a mapping with 'distribution: uniform' or 'gaussian'",
        ),
        (
            {"density": {"distribution": "cauchy"}},
            ("density",),
            "must be 'estimated' or a mapping with 'distribution: uniform' or 'gaussian'",
        ),
        (
            {"density": {"distribution": "uniform", "low": 1, "high": 1}},
            ("density",),
            "'low' must be less than 'high'",
        ),
        (
            {"density": {"distribution": "gaussian", "mean": 0, "std": 0}},
            ("density", "std"),
            "must be greater than 0",
        ),
        (
            {"basis": {"kind": "legendre", "interval": [1, -1]}},
            ("basis", "interval"),
            "must be [low, high] with low < high",
        ),
        ({"terms": {"q0": -1, "alpha": 0.2}}, ("terms", "q0"), "must be greater than 0"),
        ({"terms": {"q0": 1, "alpha": 1}}, ("terms", "alpha"), "must be less than 1"),
    ],
)
def test_wrong_fields(fields, where, message):
    with pytest.raises(ValidationError) as error:
        Orthogonal.model_validate({**FIELDS, **fields})
    (problem,) = error.value.errors()
    assert problem["loc"] == where
    assert problem["msg"] == message


def test_bases_by_kind():
    of_basis = Of("basis")
    assert of_basis.validate("hermite") == Hermite()
    assert isinstance(of_basis.validate({"kind": "legendre", "interval": [0, "pi"]}), BasisSpec)


@pytest.mark.parametrize("distribution", [["uniform"], {}, None, 5])
def test_a_density_of_no_known_distribution_is_refused(distribution):
    with pytest.raises(ConfigError, match=r"density: must be 'estimated' or a mapping with 'distribution"):
        Orthogonal(
            basis={"kind": "legendre", "interval": [-1, 1]},
            terms={"q0": 3, "alpha": 0.2},
            density={"distribution": distribution},
        )
