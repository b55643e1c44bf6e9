"""The harmonics of a polynomial of a sine."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hident.estimators.frequency.harmonic_map import (
    harmonic_matrix,
    harmonic_matrix_slope,
    powers_in_chebyshev,
    quadrature,
)

QUICK = settings(deadline=None, derandomize=True, max_examples=60)
UNIT = st.floats(-1.5, 1.5)


@QUICK
@given(st.lists(UNIT, min_size=1, max_size=13), st.floats(0.0, 1.5), UNIT, st.floats(-3.0, 3.0))
def test_it_is_the_fourier_series(c, amplitude, offset, phi):
    degree, n = len(c) - 1, 64
    theta = 2 * np.pi * np.arange(n) / n + phi
    spectrum = np.fft.rfft(np.polyval(c[::-1], offset + amplitude * np.sin(theta))) / n
    found = harmonic_matrix(np.array(amplitude), np.array(offset), degree) @ c
    k = np.arange(1, degree + 1)
    # Im[Y e^(jkwt)] has the coefficient -j Y / 2 at k.
    expected = 2j * spectrum[1 : degree + 1]
    size = max(1.0, np.sum(np.abs(c) * 3.0 ** np.arange(degree + 1)))
    assert abs(found[0] - spectrum[0].real) < 1e-14 * size
    turned = found[1:] * quadrature(degree) * np.exp(1j * k * phi)
    np.testing.assert_allclose(turned, expected, rtol=0, atol=1e-14 * size)


def test_the_third_order_is_that_of_the_paper_with_its_signs_mended():
    a, c = 1.3, np.array([50.0, 10.0, 1.0, 0.07])
    found = harmonic_matrix(np.array(a), np.array(0.0), 3) @ c
    expected = [c[0] + c[2] * a**2 / 2, a * (c[1] + 0.75 * c[3] * a**2), c[2] * a**2 / 2, c[3] * a**3 / 4]
    np.testing.assert_allclose(found, expected, rtol=1e-14)
    np.testing.assert_array_equal(quadrature(5), [1, -1j, -1, 1j, 1])


@QUICK
@given(st.integers(1, 9), st.floats(0.1, 1.5), UNIT)
def test_the_slope_is_the_derivative(degree, amplitude, offset):
    h, offset = 1e-5, np.array(offset)
    above, below = (harmonic_matrix(np.array(amplitude + d), offset, degree) for d in (h, -h))
    found = harmonic_matrix_slope(np.array(amplitude), offset, degree)
    np.testing.assert_allclose(
        found, (above - below) / (2 * h), rtol=1e-5, atol=1e-5 * (1 + np.abs(above).max())
    )


def test_the_slope_at_amplitude_zero():
    found = harmonic_matrix_slope(np.array(0.0), np.array(2.0), 2)
    np.testing.assert_array_equal(found, [[0, 0, 0], [0, 1, 4], [0, 0, 0]])


def test_arrays_of_amplitudes_and_offsets_broadcast():
    amplitude, offset = np.array([[0.1, 0.5, 1.0]]), np.array([[-1.0], [2.0]])
    found = harmonic_matrix(amplitude, offset, 4)
    assert found.shape == (2, 3, 5, 5)
    np.testing.assert_array_equal(found[1, 2], harmonic_matrix(amplitude[0, 2], offset[1, 0], 4))


@pytest.mark.parametrize("degree", [0, 1, 5, 12])
def test_powers_are_sums_of_chebyshev_polynomials(degree):
    z = np.linspace(-1, 1, 7)
    chebyshev = np.cos(np.outer(np.arccos(z), np.arange(degree + 1)))
    powers = z[:, None] ** np.arange(degree + 1.0)
    np.testing.assert_allclose(chebyshev @ powers_in_chebyshev(degree).T, powers, atol=1e-13)
