"""Faults that a review found, each with the input that showed it."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from hident import plugins
from hident.config.spec import component
from hident.engine.trial import Data, Job, run_trials
from hident.errors import EstimationError, SimulationError
from hident.estimators.frequency.gauges import Rational
from hident.estimators.moving_horizon.linear_model import LinearModel
from hident.estimators.moving_horizon.linear_transform import Measured
from hident.estimators.nonparametric.least_squares import LeastSquares
from hident.estimators.voros_hammerstein import VorosHammerstein
from hident.metrics.base import MetricSpec
from hident.metrics.models import has_stable_block
from hident.records import Estimate, Record
from hident.systems.continuous import ContinuousTransferFunction
from hident.systems.linear import TransferFunction

plugins.load()


@component("metric", "cannot_simulate")
class CannotSimulate(MetricSpec):
    """Simulates what cannot be simulated."""

    def evaluate(self, estimate, record):
        raise SimulationError("the tank runs dry")


def test_a_simulation_that_fails_in_a_metric_is_a_failed_trial():
    data = Data.model_validate(
        {
            "samples": 100,
            "system": {
                "kind": "hammerstein",
                "nonlinearity": "identity",
                "linear": {"kind": "ar", "a": [0.5]},
            },
            "excitation": {"kind": "iid", "distribution": "gaussian", "std": 1},
        }
    )
    (outcome,) = run_trials(data, [Job(LeastSquares(order=1), (CannotSimulate(),))], {0: [0]}, 1)
    assert [(s.failure, s.crash) for s in outcome.scores] == [("metric: the tank runs dry", "")]
    assert np.isnan(outcome.values).all()


@pytest.mark.parametrize("n", [1, 2, 10])
def test_a_record_too_short_for_voros_is_left_to_the_general_message(n):
    VorosHammerstein(n=1, m=2, degree=3).check(n, None)


def test_a_delay_as_long_as_the_record_is_refused():
    model = LinearModel.model_validate({"delay": 150, "block": {"n": 1, "horizon": 10}})
    with pytest.raises(ValueError, match=r"^the delay 150 is no shorter than the record, 99\.9: take a"):
        model.check(1000, 0.1)


def test_an_error_that_is_no_number_is_infinite():
    block = ContinuousTransferFunction((1.0,), (1.0,))
    wild = Measured(np.ones(10), lambda x: np.full_like(x, np.nan))
    flat = Measured.directly(np.ones(10))
    with np.errstate(all="ignore"):
        assert wild.error_of(block, np.ones(10), 0.1) == math.inf
        assert flat.error_of(block, np.ones(10), 0.1) == math.inf


def test_an_unstable_discrete_block_is_seen():
    assert not has_stable_block(Estimate(linear=TransferFunction(a=(1.5,))))
    assert has_stable_block(Estimate(linear=TransferFunction(a=(0.5,))))


def test_a_rational_gauge_must_be_proper():
    with pytest.raises(ValidationError, match=r"must be \[m, n\] with m <= n, not \[3, 2\]"):
        Rational.model_validate({"kind": "rational", "input": [3, 2], "output": [0, 2]})


def test_a_structure_search_says_why_the_last_candidate_was_refused():
    spec = LinearModel.model_validate({"block": {"structure": "search", "largest_n": 2, "horizon": 1}})
    rng = np.random.default_rng(1)

    record = Record(np.zeros(300), rng.standard_normal(300), 0.05)
    with pytest.raises(EstimationError, match=r"^no structure up to n = 2 .* \(the last"):
        spec.fit(record, rng)
