"""Estimates of Hammerstein systems with known basis functions simulate, and are scored on their output."""

from __future__ import annotations

import numpy as np
import pytest

import hident as hi


@pytest.mark.parametrize(
    ("estimator", "feedback"),
    [
        ({"kind": "two_stage", "lags": 2, "degree": 3}, ()),
        ({"kind": "bilinear_least_squares", "lags": 2, "degree": 3}, ()),
        ({"kind": "known_nonlinearity", "lags": 2, "nonlinearity": "cube"}, ()),
        ({"kind": "separable_least_squares", "lags": 2, "degree": 3, "feedback": 1}, (0.5,)),
    ],
)
def test_a_noise_free_record_is_simulated_exactly(estimator, feedback) -> None:
    cubic = hi.Polynomial(coefficients=[0, 0, 0, 1])
    if estimator["kind"] == "known_nonlinearity":
        estimator = {**estimator, "nonlinearity": cubic}
    else:
        cubic = hi.Polynomial(coefficients=[0, 1, 0.5, -0.25])
    linear = hi.TransferFunction(b=(0.0, 0.6, 0.8), a=feedback)
    u = np.random.default_rng(5).uniform(-2, 2, 400)
    record = hi.Record(u, linear.filter(cubic(u)), 0.5)
    estimate = hi.fit(estimator, record)
    assert estimate.response is not None
    np.testing.assert_allclose(estimate.response(u, 0.5), record.y, rtol=0, atol=1e-9)
    assert hi.score(estimate, record, fit=hi.FitIndex())["fit"] == pytest.approx(100, abs=1e-6)
